"""The batched executor does what the reference does arm by arm: the same rows, to rounding."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from pickenv.arm import TOLERANCES, plant_at
from pickenv.base import InputError
from pickenv.experiments import Noise, load_study, prepared_study, run_study, study_batched
from pickenv.experiments.study import OK, evaluate_arm, evaluate_chunk
from pickenv.experiments.study_batched import judge_batch

AGREEMENT = 1e-9
"""Relative; what rounding leaves is about 1e-12."""


SINGLE = 64 * 2.0**-24
"""The same of a plant whose waves are taken in single precision: half a unit in the last place of a phase of 64 rad."""


def compare(config, agreement=AGREEMENT):
    """Both executors' rows; they must agree. Returns the reference's."""
    protocol = prepared_study(config)
    for chunk in config.chunks():
        one, other = evaluate_chunk(protocol, chunk).arrow(), evaluate_chunk(protocol, chunk, judge=judge_batch).arrow()
        assert one.schema == other.schema and one.num_rows == other.num_rows
        for name in one.column_names:
            expected, found = one[name].to_numpy(), other[name].to_numpy()
            if expected.dtype.kind == "f":
                np.testing.assert_allclose(found, expected, rtol=agreement, err_msg=name)
            else:
                np.testing.assert_array_equal(found, expected, err_msg=name)
    return one


def test_batches_agree_with_arms_one_by_one(study_file):
    config = load_study(study_file(("arms = 12", "arms = 8")))
    trackers = (Noise(0.015, 0.012), Noise(0.0, 0.0), Noise(0.2, 0.0))
    compare(replace(config, noise=trackers, it_grades=(12,), poses=(12, 25)))


def test_batches_of_arms_measured_in_time_agree_with_arms_one_by_one(study_file):
    """Each comes by its own way to poses of its own, with its own friction, warming up and sinking."""
    config = load_study(study_file(("qiao2026", "orchard"), ("arms = 12", "arms = 3"), ("fruit = 8", "fruit = 4")))
    rows = compare(replace(config, it_grades=(12,), poses=(12,)))
    ideal = compare(replace(config, it_grades=(12,), poses=(12,), instrument="ideal"))
    calibrated = rows["method"].to_numpy() == "ls"
    apart = (rows["error_mean_mm"].to_numpy() - ideal["error_mean_mm"].to_numpy())[calibrated]
    assert (np.abs(apart) > 1e-3).all()  # an arm not yet warm and its stops are in what it is calibrated with


def test_ordinary_arms_are_finished_in_the_batch(study_file, monkeypatch):
    """Handing an arm over mends whatever the batch did wrong, at twenty times its cost; here none may need it."""
    protocol = prepared_study(load_study(study_file()))
    handed: list[object] = []
    monkeypatch.setattr(
        "pickenv.experiments.study.evaluate_arm", lambda *given: handed.append(given) or evaluate_arm(*given)
    )
    for setting in protocol.settings:
        if setting.method == "ls":
            given = [protocol.circumstances(number) for number in range(4)]
            judge_batch(protocol, [setting], protocol.draw(setting, range(4)), given)[0]
            alone = judge_batch(protocol, [setting], protocol.draw(setting, range(1)), given[:1])[0]
            assert alone["position"].shape == (1, protocol.config.fruit)
    assert not handed


@pytest.mark.parametrize("rows", [12, 5])
def test_what_most_arms_identify_is_kept_and_who_they_are_is_known(rows):
    """By the rank of the columns so far, NumPy's; a column that others make up is left out, and what is beyond rank."""
    rng = np.random.default_rng(rows)
    matrices = rng.normal(size=(7, rows, 6))
    matrices[:, :, 3] = matrices[:, :, 0] - 2.0 * matrices[:, :, 1]
    matrices[2, :, 3], matrices[2, :, 4] = rng.normal(size=rows), 3.0 * matrices[2, :, 1]
    kept, usual = study_batched._usual_parameters(torch.as_tensor(matrices))
    rank = [0, *(np.linalg.matrix_rank(matrices[0, :, : k + 1]) for k in range(6))]
    np.testing.assert_array_equal(kept, [k for k in range(6) if rank[k + 1] > rank[k]])
    np.testing.assert_array_equal(usual, np.arange(7) != 2)


def test_no_tracker_enters_where_none_errs(study_file, monkeypatch):
    """An arm that is handed over, however often, sees the same perfect tracker as the batch."""
    protocol = prepared_study(load_study(study_file()))
    (setting,) = (s for s in protocol.settings if (s.method, s.poses, s.payload_kg, s.it_grade) == ("ls", 12, 0.0, 14))
    given = [protocol.circumstances(number) for number in range(6)]
    perfect = [one.perfect for one in given]
    arms = protocol.draw(setting, range(6))
    expected = judge_batch(protocol, [setting], arms, perfect)[0]["position"]
    assert not np.allclose(judge_batch(protocol, [setting], arms, given)[0]["position"], expected, rtol=1e-6)
    monkeypatch.setattr(study_batched, "STEPS", 1)  # nobody converges: all are handed over
    np.testing.assert_allclose(judge_batch(protocol, [setting], arms, perfect)[0]["position"], expected, rtol=AGREEMENT)


def test_arms_that_go_through_in_several_blocks_keep_their_order(study_file, monkeypatch):
    protocol = prepared_study(load_study(study_file()))
    setting, arms = protocol.settings[0], protocol.draw(protocol.settings[0], range(5))
    given = [protocol.circumstances(number) for number in range(5)]
    whole = judge_batch(protocol, [setting], arms, given)[0]["position"]
    monkeypatch.setitem(study_batched.BLOCKS, "cpu", 1)  # an arm at a time
    np.testing.assert_allclose(judge_batch(protocol, [setting], arms, given)[0]["position"], whole, rtol=AGREEMENT)


def test_an_arm_whose_poses_show_other_parameters_is_handed_over(study_file):
    """Poses in which two joints stand still cannot tell all that other arms' poses tell."""
    protocol = prepared_study(load_study(study_file()))
    setting = next(s for s in protocol.settings if s.method == "ls")
    given = [protocol.circumstances(number) for number in range(4)]
    still = given[1].poses.copy()
    still[:, 3:5] = 0.3
    given[1] = replace(given[1], poses=still)
    arms = protocol.draw(setting, range(4))
    together = judge_batch(protocol, [setting], arms, given)[0]
    alone = [evaluate_arm(protocol, [setting], plant_at(arms, i), one)[0] for i, one in enumerate(given)]
    expected = np.concatenate([part["position"] for part in alone])
    np.testing.assert_allclose(together["position"], expected, rtol=AGREEMENT)


@pytest.mark.thorough
@pytest.mark.parametrize("plant", ["qiao2026", "orchard"])
def test_hundreds_of_batched_arms_agree_in_many_settings(study_file, plant):
    config = load_study(
        study_file(('"qiao2026"', f'"{plant}"'), ('["medium"]', '["medium", "coarse"]'), ("arms = 12", "arms = 200"))
    )
    table = compare(replace(config, chunk=200, fruit=30, poses=(10, 30)))
    assert table["status"].to_pylist().count(OK) > 0.8 * table.num_rows


@pytest.mark.parametrize(
    "plant", [pytest.param("orchard", marks=pytest.mark.slow), "field", "geometry_only", "li2016_slave"]
)
def test_batches_agree_for_other_plants(study_file, plant):
    config = load_study(study_file(('"qiao2026"', f'"{plant}"'), ("[0.0, 0.5]", "[0.0]"), ("[8, 14]", "[12]")))
    compare(replace(config, arms=3, fruit=4, poses=(20,)), SINGLE if plant == "field" else AGREEMENT)


@pytest.mark.parametrize(
    ("degrees", "radius"), [(2.0, "1.0"), (2.0, "6.0"), pytest.param(90.0, "1.0", marks=pytest.mark.slow)]
)
def test_arms_far_from_their_design_have_the_same_status(study_file, tmp_path, degrees, radius):
    """At two degrees some fruit are out of reach, by more or less than the radius; at ninety most arms need more than
    plain steps, or are not found."""
    path = tmp_path / "hopeless.toml"
    text = (TOLERANCES / "medium.toml").read_text(encoding="utf-8")
    path.write_text(text.replace("half_width_deg = 0.03", f"half_width_deg = {degrees}"), encoding="utf-8")
    changes = (
        ('"medium"', f'"{path}"'),
        ("[8, 14]", "[12]"),
        ("[12, 20]", "[20]"),
        ("radius_mm = 1.0", f"radius_mm = {radius}"),
    )
    config = load_study(study_file(*changes))
    table = compare(replace(config, arms=6, chunk=6, payload_kg=(0.0,), methods=("ls",)))
    assert len(set(table["status"].to_pylist())) > 1


def test_an_arm_is_handed_over_rather_than_left_unconverged(study_file, monkeypatch):
    """With two steps allowed no arm is finished in the batch, and all rows still agree."""
    monkeypatch.setattr(study_batched, "STEPS", 2)
    compare(replace(load_study(study_file()), arms=4, it_grades=(12,), poses=(20,), methods=("ls",)))


def test_blocks_change_nothing_but_rounding(study_file, monkeypatch):
    protocol = prepared_study(replace(load_study(study_file()), it_grades=(12,), poses=(12,)))
    whole = evaluate_chunk(protocol, 0, judge=judge_batch).arrow()
    monkeypatch.setitem(study_batched.BLOCKS, "cpu", 50)  # two arms at a time
    parts = evaluate_chunk(protocol, 0, judge=judge_batch).arrow()
    assert parts.column_names == whole.column_names
    np.testing.assert_array_equal(parts["arm"], whole["arm"])
    np.testing.assert_allclose(parts["error_mean_mm"], whole["error_mean_mm"], rtol=AGREEMENT)


def test_what_the_batch_cannot_do_is_refused(study_file, tmp_path):
    learnt = load_study(study_file(('"raw", "ls"', '"ls", "ls+rbf"')))
    with pytest.raises(InputError, match=r"batched executor has no ls\+rbf.*joblib"):
        run_study(learnt, tmp_path / "out", executor="batched")
    with pytest.raises(InputError, match="unknown device 'tpu'"):
        run_study(load_study(study_file()), tmp_path / "out", executor="batched", device="tpu")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_batches_in_several_processes_give_the_same_table(study_file, tmp_path):
    config = load_study(study_file())
    alone = run_study(config, tmp_path / "one", executor="batched")
    shared = run_study(config, tmp_path / "two", executor="batched", workers=2)
    assert shared["table_sha256"] == alone["table_sha256"]


@pytest.mark.thorough
def test_memory_does_not_grow_with_the_number_of_arms(study_file, tmp_path):
    peaks = [peak_memory(study_file, tmp_path / f"{arms}", arms) for arms in (20_000, 80_000)]
    assert abs(peaks[1] - peaks[0]) < 100.0, peaks


def peak_memory(study_file, out: Path, arms: int) -> float:
    """Largest memory of a study without calibration, MB, in a process of its own."""
    import subprocess
    import sys

    changes = [("arms = 12", f"arms = {arms}"), ("chunk = 5", "chunk = 5000"), ('"raw", "ls"', '"raw"')]
    path = study_file(*changes, ("[0.0, 0.5]", "[0.0]"), ("[8, 14]", "[12]"))
    code = f"""
import resource, sys
from pathlib import Path
from pickenv.experiments.study import load_study
from pickenv.experiments.study_rows import run_study
run_study(load_study({str(path)!r}), Path({str(out)!r}), executor="batched")
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
"""
    ran = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    return float(ran.stdout)
