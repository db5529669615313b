"""Every cell of the benchmark's tables and every key of its JSON, recomputed from figures that are made up here."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from pickenv.calibration import error_statistics
from pickenv.experiments import BenchSettings, Rows, robot_tables, robots


def made_gains(rng, robot, split, refused, rows=(90, 200)):
    gains = []
    for model, step in robots.BEFORE.items():
        before, measured, predicted = rng.uniform(0.2, 3.0), *rng.uniform(-0.1, 0.9, 2)
        gains.append(
            {"robot": robot, "split": split, "model": model, "before": step, "nominal_mm": 2.0 * before}
            | {"before_mm": before, "held_out_mm": before * (1.0 - measured), "measured_reduction": measured}
            | {"ci95": (measured - 0.0512, measured + 0.0398), "predicted_reduction": predicted}
            | {"predicted_ci95": None if model == "LS" else (predicted - 0.25, predicted + 0.125)}
            | {"refused_draws": refused, "rows": rows[0], "rows_in_file": rows[1]}
        )
    return gains


@pytest.fixture
def found():
    rng = np.random.default_rng(1)
    gains = made_gains(rng, "UR5", "random", 1) + made_gains(rng, "UR5", "blocks", 2)
    gains += made_gains(rng, "UR10, series A", "blocks", 4, (80, 80))
    models = {"nominal": (4.0, 3.5, 4.5), "LS": (0.8, 0.7, 0.9), "best": (0.6, 0.5, 0.7)}
    measured = [
        {"row": row, "model": model, "value_mm": value, "low_mm": low, "high_mm": high, "used": used, "rows": rows}
        for row, used, rows in (("ur5_random", "nothing added", 321), ("wam_poses", "gravity; gravity, bpnn", 20))
        for model, (value, low, high) in models.items()
    ]
    return SimpleNamespace(
        settings=BenchSettings(rows=90, folds=3, draws=4),
        gains=gains,
        models=Rows.of(measured),
        skipped={"wam_poses": "no data"},
    )


def test_a_gains_row_holds_what_blocks_remove_for_the_demonstration(found):
    content = robot_tables.bench_json(**vars(found))
    rows = content["rows"]
    assert rows == found.gains and len(rows) == 12
    assert content["settings"]["folds"] == 3
    assert content["skipped"] == {"wam_poses": "no data"}
    arms = robot_tables.blocked_json(found.gains, 3, "2026-01-01")["arms"]
    assert [(arm["arm"], arm["rows"], arm["rows_in_file"]) for arm in arms] == [
        ("UR5", 90, 200),
        ("UR10, series A", 80, 80),
    ]
    for arm in arms:
        ls, *others = (row for row in rows if (row["robot"], row["split"]) == (arm["arm"], "blocks"))
        assert arm["ls_mm"] == pytest.approx(ls["held_out_mm"], abs=5e-4)
        assert list(arm["removed"]) == [row["model"] for row in others]
        for row in others:
            assert arm["removed"][row["model"]] == pytest.approx([row["measured_reduction"], *row["ci95"]], abs=5e-4)


def test_every_cell_is_its_figure(found):
    split = {"random": "3 random parts", "blocks": "blocks"}
    for row, gain in zip(robot_tables.gain_cells(found.gains, 3), found.gains, strict=True):
        assert list(row[:3]) == [gain["robot"], split[gain["split"]], gain["model"]]
        assert list(row[3:5]) == [f"{gain['before_mm']:.3f}", f"{gain['held_out_mm']:.3f}"]
        predicted, measured = gain["predicted_reduction"], gain["measured_reduction"]
        for cell, value, ends in ((row[5], predicted, gain["predicted_ci95"]), (row[6], measured, gain["ci95"])):
            shown = [float(number) for number in re.findall(r"-?[\d.]+", cell)]
            assert shown == pytest.approx([100 * value, *(100 * end for end in ends or ())], abs=0.0501)
            assert re.fullmatch(r"\S+ %( \(\S+ to \S+\))?", cell)
        assert float(row[7]) == pytest.approx(100 * (predicted - measured), abs=0.0501) and row[7][0] in "+-"


@pytest.mark.parametrize(("folds", "words"), [(2, "2 random parts"), (5, "random fifths")])
def test_the_table_of_gains_says_into_how_many_parts_the_rows_were_split(found, folds, words):
    assert {cells[1] for cells in robot_tables.gain_cells(found.gains, folds)} == {words, "blocks"}


def test_the_sentence_under_the_gains_counts_them(found):
    said, right = robot_tables.agreement_words(found.gains, found.settings), []
    blocks = [gain for gain in found.gains if gain["split"] == "blocks"]
    for gain in blocks:
        if gain["model"] in ("LS + BPNN", "LS + GP"):
            right.append((gain["predicted_reduction"] > 0) == (gain["measured_reduction"] > 0))
    robots_ = len({gain["robot"] for gain in blocks})
    assert said.startswith(f"{len(blocks)} gains on blocks of {robots_} set")
    assert f"is right in {100 * np.mean(right):.0f} %." in said
    assert "3 folds, 4 arms drawn for each (7 could not be calibrated" in said
    assert said.endswith("equally spaced in the file: UR5 90 of 200, UR10, series A 80.")
    alone = made_gains(np.random.default_rng(0), "UR5", "random", 0, (90, 90))
    assert robot_tables.agreement_words(alone, found.settings).startswith("3 folds, 4 arms")
    assert robot_tables.agreement_words([], found.settings) == ""


def gained(robot, predicted, measured, model="LS + GP", split="blocks"):
    facts = {"robot": robot, "split": split, "model": model}
    return facts | {"predicted_reduction": predicted, "measured_reduction": measured}


def test_a_prediction_stands_beside_the_mean_of_the_other_robots():
    """What a twin says is worth something where it is nearer than who knows the other robots only."""
    gains = [gained("a", 0.30, 0.32), gained("b", 0.10, 0.05), gained("c", 0.60, 0.56)]
    gains += [gained(robot, 0.0, measured, "LS + terms") for robot, measured in (("a", 0.3), ("b", 0.32), ("c", 0.31))]
    gains += [gained("a", 0.9, 0.1, split="random")]  # rows among those that the fit saw say nothing of blocks
    found = robot_tables.agreement(gains)
    gp, terms = found["models"]
    assert found["gains"] == 6 and (gp["robots"], terms["robots"]) == (3, 3)
    assert (gp["median_points"], gp["worst_points"]) == (pytest.approx(4.0), pytest.approx(5.0))
    assert gp["null_worst_points"] == pytest.approx(100 * abs((0.32 + 0.56) / 2 - 0.05))
    assert terms["median_points"] == pytest.approx(31.0) and terms["null_median_points"] < 2.0
    assert "Of LS + terms a twin promises nothing" in robot_tables.points_words(found)


@pytest.mark.parametrize("how", ["random", "blocks", "poses"])
@pytest.mark.parametrize("statistic", ["rms", "mean"])
def test_a_row_states_each_model_with_its_interval_or_over_splits_with_its_range(how, statistic, monkeypatch):
    """Calibrations whose errors are made up: of n splits n errors, or one judgement with its interval."""
    asked, blocks = [], np.arange(60) // 6

    def calibrate(arm, rows, *, test=None, split=None, choices):
        errors = np.random.default_rng(len(asked)).gamma(3.0, 0.1, 60)
        asked.append((test, split, choices))
        position = {
            name: error_statistics(k * errors, blocks) for name, k in (("nominal", 4), ("geometric", 2), ("last", 1))
        }
        return SimpleNamespace(
            position=position, best_model=f"geometry+{len(asked)}", held_out=SimpleNamespace(used=["geometry"] * 10)
        )

    def load(self, data):
        return "arm", SimpleNamespace(joints=np.zeros((77, 6))), "poses"

    monkeypatch.setattr(robots, "calibrate", calibrate)
    monkeypatch.setattr(robots.RealSet, "load", load)
    monkeypatch.setitem(robots.SPREAD, "made", robots.SpreadRow("ur5", how, "auto", "gp", statistic))
    models = {row["model"]: row for row in robots.model_errors(None, "made", BenchSettings(splits=4, seed=9), None)}
    every = [np.random.default_rng(i).gamma(3.0, 0.1, 60) for i in range(4)]
    size = {"rms": lambda errors: np.sqrt(np.mean(errors**2)), "mean": np.mean}[statistic]
    for name, k in (("nominal", 4), ("LS", 2), ("best", 1)):
        if how == "random":
            sizes = [size(k * errors) for errors in every]
            expected = [np.mean(sizes), min(sizes), max(sizes)]
        else:
            ends = getattr(error_statistics(k * every[0], blocks), f"{statistic}_ci95")
            expected = [size(k * every[0]), *ends]
        model = models[name]
        assert [model["value_mm"], model["low_mm"], model["high_mm"]] == pytest.approx(expected)
        assert model["rows"] == 77
    choices = [each[2] for each in asked]
    assert {(c.terms, c.residual) for c in choices} == {("auto", "gp")}
    if how == "random":
        assert [c.seed for c in choices] == np.random.SeedSequence(9).generate_state(4).tolist()
        assert model["used"] == "1; 2; 3; 4"
    else:
        assert [each[:2] for each in asked] == [("poses", "random") if how == "poses" else (None, "blocked")]
        assert model["used"] == "nothing added"
