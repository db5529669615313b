"""The one way from rows to a result: whoever asks, from files or arrays, gets the same numbers."""

import json
import sys
from dataclasses import replace
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import pickenv
from pickenv.arm import forward, write_urdf
from pickenv.base import InputError
from pickenv.calibration import Calibration, Choices, DistanceObservations, calibrate, random_joints, simulated_tracker
from pickenv.calibration.pipeline import stages
from pickenv.cli import app

PLAIN = Choices(terms="none", residual="none")


@pytest.fixture(scope="module")
def sets(dynamic):
    rng = np.random.default_rng(0)
    return [simulated_tracker(dynamic, random_joints(dynamic.geometry, n, rng), rng) for n in (60, 20)]


@pytest.fixture(scope="module")
def result(dynamic, sets):
    return calibrate(dynamic.arm, sets[0], test=sets[1], choices=PLAIN, unit="17")


def told(result):
    return {key: value for key, value in result.as_dict().items() if key != "solve_seconds"}


def test_every_stage_hands_on_a_new_draft_and_leaves_the_old(dynamic, sets):
    draft = stages.Draft(dynamic.arm, PLAIN, *sets, np.random.default_rng(0))
    for stage in (stages._check, stages._identify, stages._add_terms, stages._learn):
        before = dict(vars(draft))
        handed = stage(draft)
        assert vars(draft) == before and handed.arm is dynamic.arm
        draft = handed
    assert list(draft.fits) == ["geometry"] and draft.fits["geometry"].identification.prior.proper


def test_the_command_and_the_function_give_the_same_numbers(dynamic, sets, tmp_path):
    files = [data.write_csv(tmp_path / f"{name}.csv") for data, name in zip(sets, ("train", "test"), strict=True)]
    out = tmp_path / "told.json"
    words = ["calibrate", files[0], "--arm", "qiao2026", "--test", files[1], "--terms", "none", "--residual", "none"]
    done = CliRunner().invoke(app, [str(word) for word in [*words, "--json", out]])
    assert done.exit_code == 0, done.output
    mine = pickenv.calibrate("qiao2026", files[0], test=[files[1]], choices=PLAIN)
    said = json.loads(out.read_text(encoding="utf-8"))
    assert json.loads(json.dumps(told(mine))) == {key: value for key, value in said.items() if key != "solve_seconds"}
    assert str(mine).splitlines()[0] in done.output


def test_rows_are_held_out_by_the_seed(dynamic, sets):
    def held(seed):
        found = calibrate(dynamic.arm, sets[0], choices=replace(PLAIN, seed=seed))
        assert (len(found.train), len(found.test)) == (48, 12)
        return found.test.joints.tolist()

    assert held(0) == held(0) != held(1)


def test_poses_of_its_own_teach_the_named_network_as_in_the_paper(dynamic, sets):
    settings = pickenv.calibration.BpnnSettings(epochs=3)
    choices = Choices("none", "bpnn", frames="known", learn_from=sets[0], settings=settings)
    found = calibrate(dynamic.arm, sets[0], test=sets[1], choices=choices)
    assert list(found.errors) == ["nominal", "geometric", "geometry+bpnn"] and found.gate == ()
    assert found.calibration.record["residual"]["settings"]["epochs"] == 3


def test_a_result_is_used_saved_exported_and_shown(dynamic, result, tmp_path, unwritten):
    assert str(result) == result.summary() and "verdict" in str(result)
    joints = random_joints(dynamic.geometry, 1, np.random.default_rng(1))[0]
    saved = Calibration.load(result.save(tmp_path / "arm"), dynamic.arm, "17")
    np.testing.assert_array_equal(result.compensator()(joints), saved.compensator()(joints))
    written = result.export(tmp_path / "arm.toml")
    assert pickenv.load_arm(written).nominal.joints == dynamic.geometry.joints
    urdf = result.export(tmp_path / "arm.urdf")
    own = write_urdf(dynamic.arm.nominal, tmp_path / "own.urdf")
    patched = result.export(tmp_path / "patched.urdf", onto=f"{own}#tool")
    poses = [forward(pickenv.load_arm(f"{path}#tool").nominal, joints) for path in (urdf, patched)]
    np.testing.assert_allclose(poses[0].position, poses[1].position, atol=1e-9)
    with unwritten():
        page = result.write_page(tmp_path / "page.html").read_text(encoding="utf-8")
    assert f"{result.best.mean:#.4g}" in page
    with pytest.raises(InputError, match="does not tell what to write"):
        result.export(tmp_path / "arm")


@pytest.mark.slow
def test_wires_take_the_same_way_and_have_a_page(qiao, tmp_path):
    rng = np.random.default_rng(0)
    joints = random_joints(qiao.nominal, 120, rng)
    anchor = np.array([2.0, 1.0, 0.5])
    length = np.linalg.norm(pickenv.arm.forward(qiao.nominal, joints).position - anchor, axis=1)
    wire = DistanceObservations(joints, length + 1e-4 * rng.normal(size=120), 1e-4)
    found = calibrate(qiao, wire, choices=Choices(terms="none"))
    assert found.best.mean < 0.5 and found.train.kind == wire.kind
    page = found.write_page(tmp_path / "page.html").read_text(encoding="utf-8")
    assert f"{found.best.mean:#.4g}" in page and "anchor of the wire" in page
    assert np.isfinite(found.uncertainty.standard(found.calibration.model, joints[:3])[0]).all()


def test_the_pipeline_enters_no_module_twice_but_for_frames_and_the_workspace(dynamic, sets, tmp_path):
    """Each module does its part once, in one go; the priors stand about frames fitted first, the verdict at the end."""
    entered: list[str] = []
    files = [str(data.write_csv(tmp_path / f"{i}.csv")) for i, data in enumerate(sets)]

    def note(frame, event, _):
        caller, file = frame.f_back, frame.f_code.co_filename
        ours = "/calibration/" in file and file != stages.__file__ and caller is not None
        if event == "call" and ours and caller.f_code.co_filename == stages.__file__ and entered[-1:] != [file]:
            entered.append(file)

    sys.setprofile(note)
    try:
        calibrate(dynamic.arm, files[:1], test=files[1:], choices=PLAIN)
    finally:
        sys.setprofile(None)
    names = [Path(file).stem for file in entered]
    assert names[0] == "read" and names[-1] == "result"
    rows = ("read", "measurements", "observations")  # files are read, train and test, and their rows picked out
    way = [name for name, _ in groupby(name for name in names if name not in rows)]
    assert way[0] == "diagnosis" and len(way) > 5
    assert {name for name in way if way.count(name) > 1} <= {"fitting"}


def blind(data, name):
    values = getattr(data, name).copy()
    values[[3, 7], 2] = np.nan
    return replace(data, **{name: values})


@pytest.mark.parametrize(
    ("spoilt", "sentence"),
    [
        (lambda train, test, wire: {"data": np.zeros((9, 6))}, "ndarray are no measurements; give files"),
        (lambda train, test, wire: {"data": blind(train, "joints")}, "rows 4, 8: joints is no finite number"),
        (lambda train, test, wire: {"test": blind(test, "position")}, "rows 4, 8: position is no finite number"),
        (lambda train, test, wire: {"data": replace(train, joints=train.joints[:, :5])}, "'qiao2026' has 6 joints"),
        (lambda train, test, wire: {"test": wire}, "holds pose, but wire lengths, to judge by, distance"),
        (lambda train, test, wire: {"data": wire}, "wire lengths holds distance, but .* to judge by, pose"),
        (
            lambda train, test, wire: {"choices": replace(PLAIN, frames="lost")},
            "frames is 'lost'; give known",
        ),
        (lambda train, test, wire: {"split": "halves", "test": None}, "split is 'halves'; give random or blocked"),
        (lambda train, test, wire: {"data": []}, "no measurement file was given"),
    ],
    ids=["array", "joint", "position", "joints", "kind held out", "kind", "frames", "split", "no file"],
)
def test_what_is_no_calibration_is_refused_in_one_sentence(dynamic, sets, spoilt, sentence):
    wire = DistanceObservations(sets[0].joints, np.ones(len(sets[0])), 1e-4)
    given = {"data": sets[0], "test": sets[1], "choices": PLAIN} | spoilt(*sets, wire)
    with pytest.raises(InputError, match=sentence):
        calibrate(dynamic.arm, given.pop("data"), **given)


def test_an_arm_is_named_by_its_file_too(dynamic, sets, result):
    path = pickenv.arm.files.arm_file.ARMS / "qiao2026.toml"
    for name in (path, str(path)):
        assert calibrate(name, sets[0], test=sets[1], choices=PLAIN).best.mean == result.best.mean


def test_errors_are_expected_where_the_arm_is_said_to_work(dynamic, sets):
    narrow = "q1=-20:20,q2=-100:100"
    over = {}
    for workspace in (None, narrow):
        choices = Choices(terms="none", residual="none", workspace=workspace)
        over[workspace] = calibrate(dynamic.arm, sets[0], test=sets[1], choices=choices).quality.workspace.declared
    assert over[None].region == "the joint limits" and over[narrow].region == f"workspace {narrow}"
    assert over[narrow].calibrated != over[None].calibrated
