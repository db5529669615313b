"""Parts of the benchmark of calibrations with made-up calibrations: rows, seeds, squares of errors, and progress."""

from types import SimpleNamespace

import numpy as np
import pytest

from pickenv.calibration import Measurements
from pickenv.experiments import BenchSettings, gains, robot_tables, robots


def test_a_fold_is_of_the_rows_and_the_seeds_of_its_set_and_split(monkeypatch, tmp_path):
    """Every row is held out once; random folds are shuffled, and no two folds of any set share a seed."""
    calls, asked = {}, []
    some = Measurements(np.arange(23.0)[:, None], np.zeros((23, 3)), None, (False,))

    def judged(arm, chosen, rows, draws, seed):
        calls[row, number] = rows, tuple(seed.generate_state(4).tolist())
        assert (arm, len(chosen), draws) == ("arm", 23, 7)
        return [{"LS": 0.1 * rows[1]}, {"LS": 0.2 * rows[1]}], 2

    monkeypatch.setattr(
        robots.RealSet, "load", lambda self, data: ("arm", SimpleNamespace(joints=np.zeros((31, 6))), None)
    )
    monkeypatch.setattr(robots, "learnable", lambda arm, rows, most: asked.append(most) or some)
    monkeypatch.setattr(robots, "judged_fold", judged)
    settings = BenchSettings(rows=24, folds=3, draws=7, seed=5)
    for row in ("gain_wam_random", "gain_wam_blocks", "gain_ur5_random"):
        for number in range(3):
            columns = robots.fold_errors(None, row, number, settings, tmp_path)
            held = calls[row, number][0][1]
            assert columns["drawn"].tolist() == [0] * len(held) + [1] * len(held)
            assert columns["at"].tolist() == [*held, *held]
            np.testing.assert_array_equal(columns["LS"], np.concatenate([0.1 * held, 0.2 * held]))
            for name, value in {"rows_in_file": 31, "rows": 23, "refused": 2}.items():
                assert columns[name].tolist() == [value] * 2 * len(held)
    for row in ("gain_wam_random", "gain_wam_blocks", "gain_ur5_random"):
        parts = [rows for (name, _), (rows, _) in calls.items() if name == row]
        held = np.concatenate([rows[1] for rows in parts])
        assert sorted(held.tolist()) == list(range(23)) and (held.tolist() == list(range(23))) == ("blocks" in row)
        assert all(sorted([*fitted, *others]) == list(range(23)) for fitted, others in parts)
    assert len({seed for _, seed in calls.values()}) == 9 and set(asked) == {24}
    one, other = (calls[f"gain_{name}_random", 0][0][1].tolist() for name in ("wam", "ur5"))
    assert one != other
    before = dict(calls)
    robots.fold_errors(None, row, number, settings, tmp_path)
    assert calls["gain_ur5_random", 2][1] == before["gain_ur5_random", 2][1]


def test_progress_counts_what_was_done_before_and_what_is_done_now(monkeypatch, tmp_path):
    for kind in ("grid", "random"):
        file = tmp_path / f"ur5_wam_jacobi2025/UR5/3D_UR5_uncalibrated_{kind}_cleaned.csv"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(kind)
    monkeypatch.setattr(robots, "model_errors", lambda rng, row, settings, data: [{"model": row}])
    for begun in (0, 2):
        told: list[tuple[str, int, int]] = []
        robots.run_bench(
            ["ur5_random", "ur5_blocks"], BenchSettings(), tmp_path, tmp_path / "out",
            progress=lambda *step, told=told: told.append(step),
        )  # fmt: skip
        assert told == [("models", done, 2) for done in range(begun, 3)]


def test_what_models_leave_are_squares_of_positions_and_residuals_are_learnt_of_positions_alone(monkeypatch):
    """Geometry, terms, and networks upon the geometry: made-up errors of three lengths and three angles each."""
    rng = np.random.default_rng(0)
    left = {name: rng.normal(size=(5, 6)) for name in ("nominal", "geometric", "terms", "bpnn", "gp")}
    sets = [SimpleNamespace(name=name, positions_only=lambda name=name: f"{name} positions") for name in ("a", "b")]

    def calibrated(arm, train, *, test, choices):
        assert (train, test) == tuple(sets) and (choices.residual, choices.robust) == ("none", False)
        fit = SimpleNamespace(calibration=SimpleNamespace(errors=lambda rows: left["terms"] if rows is test else None))
        return SimpleNamespace(errors=left, fit=fit, geometric="geometry")

    def learnt(fit, kind, rows, rng, settings):
        assert (fit, rows, settings) == ("geometry", "a positions", None)
        return SimpleNamespace(
            calibration=SimpleNamespace(errors=lambda rows: left[kind] if rows == "b positions" else None)
        )

    monkeypatch.setattr(gains, "calibrate", calibrated)
    monkeypatch.setattr(gains, "fit_remainder", learnt)
    found, _ = gains.left_by_models("arm", *sets, rng)
    names = {"nominal": "nominal", "LS": "geometric", "LS + terms": "terms", "LS + BPNN": "bpnn", "LS + GP": "gp"}
    assert list(found) == list(names)
    for name, source in names.items():
        np.testing.assert_allclose(found[name], [x * x + y * y + z * z for x, y, z, *_ in left[source]])


@pytest.mark.parametrize("turned", [True, False])
def test_an_arm_is_seen_at_the_joints_of_the_rows_with_attitudes_where_they_have_any(turned, monkeypatch):
    rng = np.random.default_rng(0)
    rotation = np.broadcast_to(np.eye(3), (4, 3, 3))
    rows = Measurements(rng.normal(size=(4, 6)), rng.normal(size=(4, 3)), rotation if turned else None, [False] * 6)

    def tracked(plant, joints, rng):
        assert plant == "plant" and joints is rows.joints
        return SimpleNamespace(position=rows.position + 1.0, rotation=-rotation)

    monkeypatch.setattr(gains, "simulated_tracker", tracked)
    seen = gains.as_measured("plant", rows, rng)
    np.testing.assert_array_equal(seen.position, rows.position + 1.0)
    assert (seen.rotation is not None) == turned
    if turned:
        np.testing.assert_array_equal(seen.rotation, -rotation)


@pytest.mark.parametrize(
    ("values", "shown"),
    [
        ((1.0, None, None), "1.00"),
        ((0.99949, 0.9, 1.25), "0.999 (0.900 to 1.250)"),
        ((12.3449, 11.0, 13.0), "12.34 (11.00 to 13.00)"),
    ],
)
def test_below_a_millimetre_micrometres_are_shown_and_else_hundredths(values, shown):
    low, high = (np.nan if end is None else end for end in values[1:])
    columns = {"value_mm": values[0], "low_mm": low, "high_mm": high, "used": "none", "model": "any"}
    rows = robots.Rows({name: np.full(3, value) for name, value in ({"row": "ur5_random"} | columns).items()})
    assert robot_tables.spread_cells(rows)[0][1] == shown


def test_without_gains_nothing_agrees_or_differs():
    said = robot_tables.agreement([])
    assert (said["sets"], said["gains"], said["learnt_on_blocks"]) == (0, 0, 0)
    assert said["models"] == [] and said["sign_right"] is None
