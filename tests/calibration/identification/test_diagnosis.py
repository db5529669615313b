"""What is wrong with a whole data set is said in one sentence; what every kind of measurement calibrates to."""

import re
from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Pose, forward, load_arm, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import (
    Choices,
    DistanceObservations,
    Lens,
    PixelObservations,
    ReflectorObservations,
    calibrate,
    contiguous_folds,
    random_joints,
    same_poses,
    simulated_tracker,
)
from pickenv.calibration.identification.diagnosis import mixed_unit, without_blind_views
from pickenv.calibration.model.observations import choose
from tests.calibration.simulated_instruments import tilt

PLAIN = Choices(terms="none", residual="none")


@pytest.fixture(scope="module")
def data(table_1):
    rng = np.random.default_rng(0)
    return replace(simulated_tracker(table_1, random_joints(table_1.geometry, 80, rng), rng), source="tracker.csv")


def judged(arm, data, choices=PLAIN):
    whole = data
    train, test = choose(whole, None, np.random.default_rng(0))
    return calibrate(arm, whole.select(np.sort(train)), test=whole.select(test), choices=choices)


@pytest.fixture(scope="module")
def others(table_1):
    """Rows to judge by."""
    rng = np.random.default_rng(9)
    return replace(simulated_tracker(table_1, random_joints(table_1.geometry, 40, rng), rng), source="others.csv")


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
    "outliers": (outliers, None),
    "joint in radians": (radians_among_degrees, "joint 4 (J4 end rotation) is read in rad there and in deg elsewhere"),
    "position in metres": (metres_among_millimetres, "the position is read in m there and in mm elsewhere"),
    "slide in millimetres": (
        millimetres_among_metres_in_a_slide,
        "joint 3 (J3 telescopic boom) is read in m there and in mm elsewhere",
    ),
}


@pytest.mark.parametrize("count", [1, 6])
@pytest.mark.parametrize("case", SPOILT)
@pytest.mark.parametrize("held_out", [False, True], ids=["training", "held out"])
def test_rows_that_are_grossly_off_are_left_out_with_their_reason(qiao, data, others, case, count, held_out):
    spoil, why = SPOILT[case]
    rows = np.arange(1, 1 + 5 * count, 5)
    train, test = (data, spoil(others, rows)) if held_out else (spoil(data, rows), others)
    found = calibrate(qiao, train, test=test, choices=PLAIN)
    file = "others.csv" if held_out else "tracker.csv"
    assert sorted((item.file, item.line, item.held_out, item.why) for item in found.left_out) == [
        (file, row + 1, held_out, why) for row in rows
    ]
    ((weight, said),) = [finding for finding in found.quality.findings if "far off" in finding[1]]
    assert said.startswith(f"{count} of 120 rows {'is' if count == 1 else 'are'} far off, by up to ")
    assert weight == ("note" if why is None and count == 1 else "caution" if why else weight)
    assert ("fit only if " in said) == (why is not None) and (why or "left out") in said
    assert found.position["geometric"].mean < 0.05


@pytest.mark.parametrize(
    ("sigma", "explained"),
    [([7.9] * 8 + [50.0] * 2, True), ([7.9] * 7 + [50.0] * 3, False), ([8.0] * 10, False), ([8.5] * 10, False)],
    ids=["eight of ten", "seven of ten", "just too far", "too far"],
)
def test_a_unit_explains_rows_where_it_brings_eight_of_ten_within_eight_deviations(qiao, data, sigma, explained):
    def sigma_of(read):
        moved = (read.position != data.position[:10]).all()
        return np.array(sigma) if moved else np.full(10, 50.0)

    why = mixed_unit(qiao, sigma_of, data, np.arange(10))
    assert (why is not None and why.startswith("the position is read in")) == explained and (why is None) != explained


@pytest.mark.parametrize("count", [1, 8])
def test_robust_fits_leave_them_out_and_list_them(qiao, data, others, count):
    rows = np.arange(1, 1 + 4 * count, 4)
    clean = calibrate(qiao, data, test=others, choices=PLAIN)
    found = calibrate(qiao, outliers(data, rows), test=outliers(others, rows), choices=PLAIN)
    listed = found.as_dict()["left_out_rows"]
    assert sorted((item["file"], item["line"], item["held_out"]) for item in listed) == [
        (file, row + 1, held_out) for file, held_out in (("others.csv", True), ("tracker.csv", False)) for row in rows
    ]
    assert (len(found.train.joints), len(found.test.joints)) == (80 - count, 40 - count)
    assert found.position["geometric"].mean < 1.5 * clean.position["geometric"].mean
    assert all(f"tracker.csv: row {row + 1} (training): 100 mm" in found.report() for row in rows)
    assert found.calibration.record["left_out"][0].startswith(("others.csv:", "tracker.csv:"))


@pytest.mark.parametrize("count", [1, 8])
def test_rows_far_off_are_kept_where_asked_and_listed_all_the_same(qiao, data, others, count):
    rows = np.arange(1, 1 + 4 * count, 4)
    there, here = calibrate(qiao, outliers(data, rows), test=others, choices=PLAIN), replace(PLAIN, robust=False)
    found = calibrate(qiao, outliers(data, rows), test=others, choices=here)
    assert [(item.line, item.held_out) for item in found.left_out] == [
        (item.line, item.held_out) for item in there.left_out
    ]
    assert all(item.kept for item in found.left_out) and len(found.train.joints) == 80
    assert found.position["geometric"].mean > 3 * there.position["geometric"].mean
    assert found.quality.grade != "good" and "kept all the same" in found.report()
    assert "Rows far off, and kept" in found.report() and found.calibration.record["left_out"] == []


def test_a_fifth_off_one_way_and_small_outliers_are_seen_without_asking(qiao, dynamic):
    """50 mm one way in a fifth of the rows once pulled the fit to itself; 5 mm, ten times the scatter, went unseen."""
    rng = np.random.default_rng(3)
    data = simulated_tracker(dynamic, random_joints(dynamic.geometry, 120, rng), rng)
    clean = judged(qiao, data)
    for rows, size in ((np.arange(0, 100, 4), 0.05), (np.array([17]), 0.005)):
        position = data.position.copy()
        position[rows, 1] += size
        found = judged(qiao, replace(data, position=position))
        assert sorted(item.line for item in found.left_out) == [row + 1 for row in rows]
        assert found.position["geometric"].mean < 1.3 * clean.position["geometric"].mean


@pytest.mark.parametrize("kind", ["reflectors", "wire"])
def test_rows_far_off_of_any_kind_are_left_out(qiao, kind):
    """One row in twenty is gross; the others calibrate the arm as if it had not been there."""
    rng = np.random.default_rng(5)
    joints = random_joints(qiao.nominal, 160, rng)
    pose = forward(qiao.true, joints)
    rows = np.sort(rng.choice(120, 8, replace=False))
    if kind == "reflectors":
        points = pose.position[:, None] + np.einsum("nij,kj->nki", pose.rotation, TRIAD)
        points += rng.normal(size=points.shape) * 2e-5
        clean = ReflectorObservations(joints, points, np.ones((160, 3), dtype=bool), 2e-5)
        points = points.copy()
        points[rows, 1] += 0.05
        bad = replace(clean, points=points)
    else:
        length = np.linalg.norm(pose.position - np.array([1.5, -2.0, 0.3]), axis=1) + rng.normal(size=160) * 1e-4
        clean, length = DistanceObservations(joints, length, 1e-4), length.copy()
        length[rows] -= 0.05
        bad = replace(clean, length=length)
    here, there = np.arange(120), np.arange(120, 160)
    want = calibrate(qiao, clean.select(here), test=clean.select(there), choices=PLAIN)
    found = calibrate(qiao, bad.select(here), test=bad.select(there), choices=PLAIN)
    assert not want.left_out
    assert sorted(item.line for item in found.left_out) == [row + 1 for row in rows]
    assert found.position["geometric"].rms < 1.2 * want.position["geometric"].rms


def test_good_data_raise_no_alarm(qiao, data, dynamic):
    assert judged(qiao, data).position["geometric"].mean < 0.05
    rng = np.random.default_rng(1)
    judged(qiao, simulated_tracker(dynamic, random_joints(dynamic.arm.nominal, 100, rng), rng))


def test_rows_of_another_set_up_are_recognised(qiao, data, others):
    turn = rotation_matrix([0.0, 0.0, 0.4])
    moved = replace(others, position=others.position @ turn.T + [0.5, 0.0, 0.0], rotation=turn @ others.rotation)
    with pytest.raises(InputError, match=r"others.csv: .*another set-up .*base moved by .* mm and 22\.9 deg"):
        calibrate(qiao, data, test=moved, choices=PLAIN)
    metres = replace(others, position=others.position * 1e3)
    with pytest.raises(InputError, match=r"others.csv: the held-out rows fit .* only if the position is read in mm"):
        calibrate(qiao, data, test=metres, choices=PLAIN)
    shuffled = replace(others, joints=np.roll(others.joints, 1, axis=0))
    with pytest.raises(InputError, match=r"others.csv: most held-out rows miss by .* no other place of base or tool"):
        calibrate(qiao, data, test=shuffled, choices=PLAIN)


def stuck(qiao, plant, joints, count=60):
    """Poses whose named joints stand in the middle of their range, to fit and as many to judge by."""
    rng = np.random.default_rng(0)
    commands = random_joints(qiao.nominal, 2 * count, rng)
    commands[:, joints] = (qiao.nominal.lower + qiao.nominal.upper)[joints] / 2
    return tuple(simulated_tracker(plant, half, rng) for half in np.split(commands, 2))


@pytest.mark.parametrize("count", [60, 20])
def test_poses_that_show_too_little_say_where_they_tell_nothing(qiao, table_1, count):
    """Four joints stood still: the poses measured are known to micrometres, what the joints reach is not."""
    still = [2, 3, 4, 5]
    seen, others = stuck(qiao, table_1, still)
    found = calibrate(qiao, seen.select(np.arange(count)), test=others, choices=replace(PLAIN, frames="fitted"))
    workspace = found.quality.workspace
    assert workspace.thin == tuple(qiao.nominal.joint_names[i] for i in still)
    assert workspace.measured.calibrated < 1e-5 and workspace.measured.narrowed > 0.95
    assert workspace.declared.calibrated > 1e-3 and workspace.declared.narrowed < 0.2
    assert found.quality.grade == "with care" and workspace.reservation in found.report()
    assert f"move {', '.join(workspace.thin)} further" in workspace.reservation


def test_the_error_expected_where_a_joint_stood_still_is_that_of_the_arm(qiao, table_1):
    """In the arm's own frame such poses still better the drawing over all joint limits, and by how much is said."""
    seen, others = stuck(qiao, table_1, [5])
    found = calibrate(qiao, seen, test=others, choices=PLAIN)
    joints = random_joints(qiao.nominal, 400, np.random.default_rng(1))
    true = table_1.tool_pose(joints).position
    off = found.calibration.predict(joints).position - true, forward(qiao.nominal, joints).position - true
    calibrated, drawn = (np.sqrt(np.mean(np.sum(errors**2, axis=1))) for errors in off)
    workspace = found.quality.workspace
    low, high = workspace.declared.calibrated_ends
    assert workspace.thin == (qiao.nominal.joint_names[5],) and found.quality.grade == "good"
    assert low < calibrated < high and calibrated < 0.5 * drawn
    assert drawn == pytest.approx(workspace.declared.nominal, rel=0.2)


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
    whole = ReflectorObservations(joints, points, seen, 2e-5)
    train, test = choose(whole, 20, rng)
    found = calibrate(qiao, whole.select(train), test=whole.select(test), choices=PLAIN)
    assert found.position["nominal"].mean > 0.4 and found.position["geometric"].mean < 0.06
    assert found.as_dict()["kind"] == "reflectors"
    wrong = replace(whole, joints=-joints)
    with pytest.raises(InputError, match="signs"):
        calibrate(qiao, wrong.select(train), test=wrong.select(test), choices=PLAIN)


@pytest.mark.slow
def test_draw_wires_are_calibrated(qiao):
    rng = np.random.default_rng(0)
    joints = random_joints(qiao.nominal, 200, rng)
    length = np.linalg.norm(forward(qiao.true, joints).position - np.array([1.5, -2.0, 0.3]), axis=1)
    whole = DistanceObservations(joints, length + rng.normal(size=200) * 1e-4, 1e-4)
    train, test = choose(whole, None, rng)
    found = calibrate(qiao, whole.select(train), test=whole.select(test), choices=PLAIN)
    assert found.position["nominal"].rms > 0.25 and found.position["geometric"].rms < 0.14
    wrong = replace(whole, length=whole.length * 1e3)
    with pytest.raises(InputError, match="units"):
        calibrate(qiao, wrong.select(train), test=wrong.select(test), choices=PLAIN)


def test_an_unknown_term_or_residual_is_named(qiao, data):
    with pytest.raises(InputError, match="unknown terms 'gravitation'; give auto, none, or some of compliance"):
        judged(qiao, data, replace(PLAIN, terms="gravitation"))
    with pytest.raises(InputError, match="there is no residual 'net'; give one of bpnn, rbf, gp"):
        judged(qiao, data, replace(PLAIN, residual="net"))


def test_an_automatic_choice_finds_the_weight_of_a_compliant_arm(dynamic):
    """Terms and residual are chosen within the training rows; the held-out error falls from geometry on."""
    rng = np.random.default_rng(2)
    arm = load_arm("qiao2026")
    whole = simulated_tracker(dynamic, random_joints(arm.nominal, 250, rng), rng)
    train, test = contiguous_folds(whole.groups, same_poses(whole.joints), 5)[3]
    found = calibrate(arm, whole.select(train), test=whole.select(test), choices=Choices(residual="none"))
    assert "gravity" in found.terms[0] and found.best_model == f"geometry+{found.terms[0]}"
    assert found.position[found.best_model].rms < 0.6 * found.position["geometric"].rms
    saved = found.fit.calibration
    left = saved.predict(whole.joints).position - dynamic.tool_pose(whole.joints).position
    assert np.linalg.norm(left, axis=1).mean() * 1e3 < 0.8 * found.position["geometric"].mean


def test_directions_far_off_are_listed_in_degrees():
    arm, rng = load_arm("ur5"), np.random.default_rng(0)
    data = tilt(3)(arm.nominal, 120, rng, 1.0)
    turned = data.components.copy()
    turned[40] = rotation_matrix([0.0, 0.2, 0.0]) @ turned[40]
    found = calibrate(arm, replace(data, components=turned), choices=PLAIN)
    (item,) = found.left_out
    wanted = np.degrees(np.linalg.norm(turned[40] - data.components[40]))
    assert item.line == 41 and item.unit == "deg" and item.miss.endswith(" deg")
    assert float(item.miss.split()[0]) == pytest.approx(wanted, rel=0.02)
    assert f"far off, by up to {item.miss}" in found.report()


def test_numbers_that_are_none_are_named_whatever_was_measured(qiao):
    rng = np.random.default_rng(0)
    joints = random_joints(qiao.nominal, 40, rng)
    points, seen = rng.normal(size=(40, 2, 3)), np.ones((40, 2), dtype=bool)
    points[7, 1, 2] = np.nan
    data = ReflectorObservations(joints, points, seen, 1e-5)
    with pytest.raises(InputError, match="row 8: what was read is no finite number"):
        calibrate(qiao, data, choices=PLAIN)
    seen[7, 1] = False  # a reflector that was lost may hold anything
    with pytest.raises(InputError, match="check the arm, the units"):
        calibrate(qiao, data, choices=PLAIN)


def test_a_verdict_counts_rows_and_not_what_was_read_in_them(qiao):
    rng = np.random.default_rng(1)
    joints = random_joints(qiao.nominal, 100, rng)
    pose = forward(qiao.true, joints)
    points = pose.position[:, None] + np.einsum("nij,kj->nki", pose.rotation, TRIAD)
    points += 2e-5 * rng.normal(size=points.shape)
    data = ReflectorObservations(joints, points, np.ones((100, 3), dtype=bool), 2e-5)
    found = calibrate(qiao, data.select(np.arange(70)), test=data.select(np.arange(70, 100)), choices=PLAIN)
    assert found.quality.reason.startswith("on 30 held-out rows the error falls") and len(found.errors["nominal"]) == 90


def test_views_of_few_corners_or_of_corners_near_one_line_are_left_out_and_four_must_stay():
    """Corners as wide as 0.05 of their length across it, and six of them, are enough; a table's corners all count."""
    circle = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
    corners = np.stack([np.stack([100 * np.cos(circle), 100 * w * np.sin(circle)], 1) for w in (1, 1, 1, 0.06, 0.04)])
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])  # whichever way they lie
    seen = np.ones((5, 8), dtype=bool)
    seen[0, 6:] = False
    views = PixelObservations(
        joints=np.zeros((5, 6)),
        corners=corners @ turn.T + [320.0, 240.0],
        seen=seen,
        board=np.zeros((8, 3)),
        camera=Lens(np.zeros(9), (640, 480)),
        lens_std=np.zeros(9),
        std=np.ones((5, 8)),
        pictures=np.full(5, "board.png"),
    )
    kept, (left,) = without_blind_views(views)
    np.testing.assert_array_equal(kept.corners, views.corners[:4])
    assert left.why == "its 8 corners lie near one line, and do not tell how the board is turned"
    seen[0, 5:] = False
    with pytest.raises(InputError, match="3 of 5 views show enough of the board, of which 4 are needed"):
        without_blind_views(views)
    table = replace(views, pictures=None)
    assert without_blind_views(table) == (table, ())
    seen[1:3, 1:] = False
    with pytest.raises(InputError, match="1 of 5 views"):
        without_blind_views(views)


@pytest.mark.parametrize(("moved", "words"), [(slice(55, 80), "from row 56 on"), (slice(0, 24), "up to row 24")])
def test_an_instrument_that_was_moved_so_far_that_its_rows_are_left_out_is_said_too(exact, moved, words):
    """Rows far off are so from the move on. As many of them anywhere are no move."""
    data = exact(load_arm("ur5e").nominal, 80)
    for rows in (moved, np.random.default_rng(1).permutation(80)[:24]):
        position = data.position + 5e-5 * np.random.default_rng(3).normal(size=(80, 3))
        position[rows] += [0.0, 0.03, 0.0]
        knocked = replace(data, position=position, position_std=5e-5, attitude_std=1e-2, source="knocked.csv")
        text = calibrate(load_arm("ur5e"), knocked, choices=PLAIN).report()
        assert (f"knocked.csv: all rows {words} are far off" in text) == (rows is moved), text
        assert ("the instrument was probably moved" in text) == (rows is moved)


@pytest.mark.parametrize("positions", [False, True])
@pytest.mark.parametrize(("path", "line"), [("step", 41), ("turn", 45), ("still", None), ("drift", None)])
def test_an_instrument_that_was_moved_within_the_file_is_said(exact, path, line, positions):
    """A tripod that somebody knocks is no part of the arm, while a drift and a good file are no move."""
    arm = load_arm("ur5e")
    rng, names = np.random.default_rng(3), arm.nominal.parameter_names
    data = exact(arm.nominal.displaced(2e-4 * rng.normal(size=len(names))), 80)
    position = data.position + 5e-5 * rng.normal(size=(80, 3))
    moved = (np.arange(80) >= (line or 0) - 1)[:, None]
    position = {
        "step": position + moved * [0.0, 0.003, 0.0],
        "turn": np.where(moved, position @ rotation_matrix([0.0, 0.004, 0.003]).T, position),
        "still": position,
        "drift": position + np.linspace(0.0, 0.003, 80)[:, None] * [0.0, 1.0, 0.0],
    }[path]
    data = replace(data, position=position, position_std=5e-5, attitude_std=1e-2, source="knocked.csv")
    data = data.positions_only() if positions else data
    found = calibrate(arm, data, choices=PLAIN)
    text = found.report()
    if line is None:
        assert "another base" not in text
    else:
        said = [int(row) for row in re.findall(r"knocked\.csv: from row (\d+) on its rows fit another base", text)]
        assert said and abs(said[0] - line) <= 2  # a row next to the step may be held out
        assert found.quality.grade == "with care"
