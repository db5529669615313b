"""What is wrong with a whole data set is said in one sentence; what every kind of measurement calibrates to."""

from dataclasses import replace

import numpy as np
import pytest

from calibration import random_joints, simulated_tracker
from calibration.held_out import Choices, judge
from calibration.observations import (
    DistanceObservations,
    PoseObservations,
    ReflectorObservations,
)
from calibration.rows import choose, select
from pickenv.arm import Pose, forward, load_arm, rotation_matrix
from pickenv.errors import InputError

PLAIN = Choices(terms="none", residual="none")


@pytest.fixture(scope="module")
def data(table_1):
    rng = np.random.default_rng(0)
    return replace(simulated_tracker(table_1, random_joints(table_1.geometry, 80, rng), rng), source="tracker.csv")


def judged(arm, data, choices=PLAIN):
    whole = PoseObservations(data)
    train, test = choose(whole, "random", None, np.random.default_rng(0))
    return judge(arm, select(whole, np.sort(train)), select(whole, test), choices)


def outliers(data, rows):
    position = data.position.copy()
    position[rows] += np.array([0.0, 0.1, 0.0])
    return replace(data, position=position)


def radians_among_degrees(data, rows):
    joints = data.joints.copy()
    joints[rows, 3] = np.radians(joints[rows, 3])
    return replace(data, joints=joints)


def metres_among_millimetres(data, rows):
    position = data.position.copy()
    position[rows] *= 1e-3
    return replace(data, position=position)


def millimetres_among_metres_in_a_slide(data, rows):
    joints = data.joints.copy()
    joints[rows, 2] *= 1e-3
    return replace(data, joints=joints)


SPOILT = {
    "outliers": (outliers, r"off by up to 100 mm where the others agree within"),
    "joint in radians": (radians_among_degrees, r"fit only if joint 4 \(J4 end rotation\) is read in rad there"),
    "position in metres": (
        metres_among_millimetres,
        r"fit only if the position is read in m there and in mm elsewhere",
    ),
    "slide in millimetres": (
        millimetres_among_metres_in_a_slide,
        r"fit only if joint 3 \(J3 telescopic boom\) is read in m",
    ),
}


@pytest.mark.parametrize("count", [1, 6])
@pytest.mark.parametrize("case", SPOILT)
def test_rows_that_are_grossly_off_are_named(qiao, data, case, count):
    spoil, said = SPOILT[case]
    rows = np.arange(5, 5 + 7 * count, 7)
    with pytest.raises(InputError, match=said) as caught:
        judge(qiao, PoseObservations(spoil(data, rows)), PoseObservations(data), PLAIN)
    assert "\n" not in str(caught.value) and str(caught.value).startswith("tracker.csv")
    assert all(str(row + 1) in str(caught.value) for row in rows[:1])


@pytest.mark.parametrize("count", [1, 8])
def test_robust_fits_leave_them_out_and_list_them(qiao, data, exact, count):
    rows = np.arange(5, 5 + 7 * count, 7)
    clean = judge(qiao, PoseObservations(data), PoseObservations(exact(qiao.true, 200, 9)), PLAIN)
    robust = judge(
        qiao,
        PoseObservations(outliers(data, rows)),
        PoseObservations(exact(qiao.true, 200, 9)),
        replace(PLAIN, robust=True),
    )
    assert sorted(robust.as_dict()["outlier_rows"]) == rows.tolist()
    assert robust.train_rows == 80 - count
    assert robust.position["geometric"].mean < 1.5 * clean.position["geometric"].mean
    assert f"{count} outliers in 80 poses" in robust.report()


def test_good_data_raise_no_alarm(qiao, data, dynamic):
    assert judged(qiao, data).position["geometric"].mean < 0.05
    rng = np.random.default_rng(1)
    judged(qiao, simulated_tracker(dynamic, random_joints(dynamic.arm.nominal, 100, rng), rng))


def test_poses_that_show_too_little_say_what_they_lose(qiao, table_1):
    rng = np.random.default_rng(0)
    joints = random_joints(qiao.nominal, 60, rng)
    joints[:, [2, 3, 4, 5]] = (qiao.nominal.lower + qiao.nominal.upper)[[2, 3, 4, 5]] / 2
    seen = PoseObservations(simulated_tracker(table_1, joints, rng))
    with pytest.raises(InputError, match=r"show \d+ of the 24 parameters .*J4 end rotation.* hardly move") as caught:
        judge(qiao, seen, seen, PLAIN)
    assert "\n" not in str(caught.value)


def test_poses_that_miss_a_little_are_reported(qiao, table_1):
    rng = np.random.default_rng(0)
    joints = random_joints(qiao.nominal, 60, rng)
    joints[:, 5] = 0.1
    seen = PoseObservations(simulated_tracker(table_1, joints, rng))
    found = judge(qiao, seen, seen, PLAIN)
    assert 0 < len(found.lost) <= 5 and "full-range poses would also show" in found.report()


TRIAD = np.array([[50.0, 0.0, 20.0], [-40.0, 60.0, 0.0], [-30.0, -50.0, 35.0]]) * 1e-3


def far(geometry):
    rng = np.random.default_rng(3)
    return replace(geometry, base=Pose(rng.uniform(-4, 4, 3), rotation_matrix(rng.normal(size=3))))


def test_reflectors_are_calibrated_from_anywhere(qiao):
    there, rng = far(qiao.true), np.random.default_rng(0)
    joints = random_joints(qiao.nominal, 80, rng)
    pose = forward(there, joints)
    points = (
        pose.position[:, None] + np.einsum("nij,kj->nki", pose.rotation, TRIAD) + rng.normal(size=(80, 3, 3)) * 2e-5
    )
    seen = rng.uniform(size=(80, 3)) > 0.1
    whole = ReflectorObservations(joints, points, seen, np.eye(3) * 2e-5**2)
    train, test = choose(whole, "random", 20, rng)
    found = judge(qiao, select(whole, train), select(whole, test), PLAIN)
    assert found.position["nominal"].mean > 0.4 and found.position["geometric"].mean < 0.06
    assert found.as_dict()["measurement_kind"] == "reflectors"
    wrong = replace(whole, joints=-joints)
    with pytest.raises(InputError, match="signs"):
        judge(qiao, wrong, wrong, PLAIN)


def test_draw_wires_are_calibrated(qiao):
    rng = np.random.default_rng(0)
    joints = random_joints(qiao.nominal, 200, rng)
    length = np.linalg.norm(forward(qiao.true, joints).position - np.array([1.5, -2.0, 0.3]), axis=1)
    whole = DistanceObservations(joints, length + rng.normal(size=200) * 1e-4, 1e-4)
    train, test = choose(whole, "random", None, rng)
    found = judge(qiao, select(whole, train), select(whole, test), PLAIN)
    assert found.position["nominal"].rms > 0.25 and found.position["geometric"].rms < 0.14
    wrong = replace(whole, length=whole.length * 1e3)
    with pytest.raises(InputError, match="units"):
        judge(qiao, wrong, wrong, PLAIN)


def test_an_unknown_term_or_residual_is_named(qiao, data):
    with pytest.raises(InputError, match="unknown terms 'gravitation'; give auto or some of gravity"):
        judged(qiao, data, replace(PLAIN, terms="gravitation"))
    with pytest.raises(InputError, match="unknown residual model 'net'; give auto, none or one of"):
        judged(qiao, data, replace(PLAIN, residual="net"))


def test_an_automatic_choice_finds_the_weight_of_a_compliant_arm(dynamic):
    """Terms and residual are chosen within the training rows; the held-out error falls from geometry on."""
    rng = np.random.default_rng(2)
    arm = load_arm("qiao2026")
    whole = PoseObservations(simulated_tracker(dynamic, random_joints(arm.nominal, 250, rng), rng))
    train, test = choose(whole, "blocked", None, rng)
    found = judge(arm, select(whole, train), select(whole, test), Choices(residual="none"))
    assert "gravity" in found.terms.chosen and found.best_model == f"geometry+{found.terms.chosen}"
    assert found.position[found.best_model].rms < 0.6 * found.position["geometric"].rms
    saved = found.fit.calibration
    left = saved.predict(whole.joints).position - dynamic.tool_pose(whole.joints).position
    assert np.linalg.norm(left, axis=1).mean() * 1e3 < 0.8 * found.position["geometric"].mean
