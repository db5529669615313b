"""Small workspaces: the rung that is taken is better than the nominal arm on fresh rows of the same box, or none is."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import least_squares
from typer.testing import CliRunner

from pickenv.arm import Pose, forward, inverse, load_arm
from pickenv.arm.effects.structure import Load
from pickenv.calibration import Calibration, Choices, DistanceObservations, Measurements, calibrate
from pickenv.calibration.identification.alignment import align
from pickenv.calibration.identification.ladder import PART_CLASS, RUNGS, ZERO_CLASS, climb, rung_of
from pickenv.calibration.model.arm_model import ArmModel, Conditions
from pickenv.calibration.model.coverage import pose_coverage, refuse_lost
from pickenv.calibration.model.error_model import complete_model, frames_model
from pickenv.calibration.model.terms import ComplianceTerm, GravityTerm
from pickenv.cli import app
from pickenv.errors import InputError

ARM = load_arm("ur10")
MASS = (7.1, 12.7, 4.3, 2.0, 2.0, 0.4)
CENTRE = ((0, 0, 0), (0.3, 0, 0.1), (0.28, 0, 0.05), (0, -0.01, 0.01), (0, 0.01, 0.01), (0, 0, -0.03))
YIELDS = ComplianceTerm(tuple(range(6)), Load(MASS, CENTRE, 2.0))
STIFFNESS = np.array([25e3, 18e3, 12e3, 8e3, 8e3, 8e3])
NOISE = 1e-4
SIDE = 0.3
"""Of the box, m."""

MIDDLE = forward(ARM.nominal, np.array([0.2, -1.2, 1.6, -1.9, -1.5, 0.3]))
PLAIN = Choices(residual="none")
OUTPUTS = {"out": "cal.npz", "json": "cal.json", "report": "cal.html"}


def true_arm(rng, size=1.0):
    """Links off by 0.3 mm and mrad, joint zeros by 2 mrad, joints that yield."""
    names = ARM.nominal.parameter_names
    zeros, frames = (np.array([name.startswith(first) for name in names]) for first in ("theta", ("base", "tool")))
    moved = rng.normal(size=len(names)) * 3e-4 + zeros * rng.normal(size=len(names)) * 2e-3
    return ArmModel(ARM.nominal.displaced(size * np.where(frames, 0.0, moved)), (YIELDS,), size / STIFFNESS)


def in_box(rng, rows):
    """Joints that hold the tool upright somewhere in the box, as over a conveyor."""
    place = MIDDLE.position + rng.uniform(-SIDE / 2, SIDE / 2, (rows, 3))
    found = inverse(ARM.nominal, Pose(place, np.broadcast_to(MIDDLE.rotation, (rows, 3, 3))))
    return found.joints[found.reached]


def measured(rng, true, joints):
    place = true.pose(joints, Conditions()).position + rng.normal(size=(len(joints), 3)) * NOISE
    return Measurements(joints, place, None, ARM.nominal.prismatic, position_std=NOISE)


def box_set(seed, size=1.0):
    """An arm in the box: rows to fit, and fresh ones of the same box."""
    rng = np.random.default_rng(seed)
    true = true_arm(rng, size)
    return measured(rng, true, in_box(rng, 40)), measured(rng, true, in_box(rng, 100))


def rms(errors):
    return 1e3 * float(np.sqrt(np.mean(np.sum(errors[:, :3] ** 2, axis=1))))


@pytest.fixture(scope="module")
def box():
    return box_set(0)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_a_rung_is_better_than_nominal_where_the_full_geometry_is_refused(seed):
    train, fresh = box_set(seed)
    aligned = align(ARM.nominal, train, frames_model(ARM.nominal)).geometry
    with pytest.raises(InputError, match=r"these poses show \d+ of the \d+ parameters"):
        refuse_lost(pose_coverage(complete_model(aligned), aligned, train), aligned, train)
    result = calibrate(ARM, train, test=fresh, choices=PLAIN)
    before, *_, after = result.errors.values()
    assert rms(after) < 0.8 * rms(before)
    assert result.ladder.chosen in RUNGS and result.quality.grade == "with care"
    assert result.as_dict()["fit"]["chosen"] == result.calibration.record["fit"] == result.ladder.chosen
    tried = result.ladder.blocked_rms
    below = [name for name in tried if name != result.ladder.chosen and tried[name] < tried[result.ladder.chosen]]
    assert all(RUNGS.index(name) > RUNGS.index(result.ladder.chosen) for name in below)
    assert f"--fit {result.ladder.chosen}" in result.report()


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_an_arm_as_its_data_sheet_says_gets_nothing_worse_than_nominal(seed):
    train, fresh = box_set(seed, size=0.0)
    with pytest.raises(InputError, match=r"nothing that can be fitted \(offsets, .*\) is better than the nominal arm"):
        calibrate(ARM, train, test=fresh, choices=PLAIN)


def test_poses_of_the_whole_workspace_take_the_full_geometry():
    rng = np.random.default_rng(5)
    true = true_arm(rng)
    joints = rng.uniform(-1.5, 1.5, (60, 6)) + np.array([0.0, -1.2, 1.2, -0.8, 1.0, 0.0])
    result = calibrate(ARM, measured(rng, true, joints), choices=replace(PLAIN, terms="none"))
    assert result.ladder is None and result.calibration.record["fit"] == "full" and result.as_dict()["fit"] is None


@pytest.mark.parametrize("name", RUNGS)
def test_a_rung_that_is_asked_for_fits_what_it_says(box, name):
    result = calibrate(ARM, box[0], test=box[1], choices=replace(PLAIN, fit=name))
    assert result.calibration.record["fit"] == name and "as asked for" in result.report()
    before, *_, after = result.errors.values()
    assert rms(after) < rms(before)
    identified, nominal = result.calibration.identified, result.calibration.nominal
    zeros_only = name in ("offsets", "compliance")
    assert (np.array_equal(identified.a, nominal.a) and np.array_equal(identified.alpha, nominal.alpha)) == zeros_only
    assert not np.array_equal(identified.theta, nominal.theta)
    kinds = [type(term) for term in result.calibration.model.terms]
    assert kinds == [GravityTerm] * (name == "compliance")


def test_torques_give_the_compliance_of_their_rung(box):
    torque = YIELDS.torques(ARM.nominal, box[0].joints, Conditions())
    train = replace(box[0], conditions=Conditions(torque=torque))
    (term,) = rung_of("compliance", ARM, ARM.nominal, train, False).start.terms
    assert isinstance(term, ComplianceTerm) and term.weight is not None


def test_offsets_are_the_least_squares_of_rows_and_priors(box):
    """Recomputed by SciPy: base and tool free, zeros expected within their class, weighed by what is left."""
    train = box[0]
    start = align(ARM.nominal, train, frames_model(ARM.nominal)).geometry
    rung = rung_of("offsets", ARM, start, train, False)
    found = rung.identify(train)
    zeros = [f"theta{i}" for i in range(1, 7)]
    assert set(rung.model.names) == {*frames_model(start).names, *zeros}
    names = found.identifiability.kept_names
    assert set(zeros) <= set(names)
    places = [start.parameter_names.index(name) for name in names]
    held = np.array([name in zeros for name in names])

    def left(x):
        delta = np.zeros(len(start.parameter_names))
        delta[places] = x * 1e-3
        miss = (train.position - forward(start.displaced(delta), train.joints).position) / NOISE
        return np.r_[miss.ravel(), x[held] * found.scatter / ZERO_CLASS]

    solved = least_squares(left, np.zeros(len(names)), xtol=1e-12, ftol=1e-12, gtol=1e-12)
    assert found.chi_square == pytest.approx(2 * solved.cost, rel=1e-3)
    moved = dict(zip(rung.model.names, found.delta, strict=True))
    np.testing.assert_allclose([moved[name] for name in zeros], solved.x[held] * 1e-3, rtol=0.02, atol=2e-5)


def test_priors_are_tolerance_classes_and_parameters_they_hold_are_not_called_measured(box):
    rung = rung_of("reduced", ARM, ARM.nominal, box[0], True)
    for name, std in zip(rung.model.names, rung.std, strict=True):
        assert std == pytest.approx(1e-3 * (ZERO_CLASS if name.startswith("theta") else PART_CLASS))
    result = calibrate(ARM, box[0], test=box[1], choices=replace(PLAIN, fit="reduced"))
    std = {row["name"]: row["std"] for row in result.parameters() if row["name"].startswith("a")}
    states = result.quality.states.geometry
    scale = {name: np.degrees(1e-3) if name.startswith("alpha") else 1.0 for name in std}
    assert all((states[name] == "held by its prior") == (std[name] > 0.5 * scale[name]) for name in std)
    assert "held by its prior" in states.values() and "held by their prior" in result.report()


def test_what_does_not_go_with_a_rung_is_refused_in_a_sentence(box):
    train, fresh = box
    with pytest.raises(InputError, match="fit is 'half'; give auto, offsets, compliance, reduced or full"):
        calibrate(ARM, train, test=fresh, choices=replace(PLAIN, fit="half"))
    with pytest.raises(InputError, match=r"--terms gravity goes with all of the geometry, .* joint offsets are"):
        calibrate(ARM, train, test=fresh, choices=replace(PLAIN, fit="offsets", terms="gravity"))
    wire = DistanceObservations(train.joints, np.linalg.norm(train.position, axis=1), 1e-4)
    with pytest.raises(InputError, match="--fit offsets is for poses and positions"):
        calibrate(
            ARM, wire.select(np.arange(20)), test=wire.select(np.arange(20, 30)), choices=replace(PLAIN, fit="offsets")
        )
    with pytest.raises(InputError, match=r"these poses show \d+ of the \d+ parameters"):
        calibrate(ARM, train.select(np.arange(19)), test=fresh, choices=PLAIN)
    with pytest.raises(InputError, match="nothing that can be fitted"):
        climb(ARM, ARM.nominal, measured(np.random.default_rng(0), ArmModel.of(ARM.nominal), train.joints), True)


def test_the_command_takes_the_rung_and_its_file_is_applied(box, tmp_path):
    files = [part.write_csv(tmp_path / f"{name}.csv") for name, part in zip(("train", "test"), box, strict=True)]
    options = ["--arm", "ur10", "--test", str(files[1]), "--residual", "none", "--fit", "compliance"]
    outputs = {f"--{key}": str(tmp_path / name) for key, name in OUTPUTS.items()}
    options += [text for pair in outputs.items() for text in pair]
    ran = CliRunner().invoke(app, ["calibrate", str(files[0]), *options])
    assert ran.exit_code == 0, ran.output
    assert "Fitted: joint offsets and compliance (--fit compliance), as asked for" in ran.output
    assert json.loads((tmp_path / "cal.json").read_text())["fit"]["chosen"] == "compliance"
    assert "offsets and compliance (--fit compliance), as asked for" in (tmp_path / "cal.html").read_text()
    again = Calibration.load(tmp_path / "cal.npz", ARM)
    wanted = forward(again.nominal, box[1].joints).position
    assert rms(again.predict(again.compensate(box[1].joints)).position - wanted) < 1e-2
