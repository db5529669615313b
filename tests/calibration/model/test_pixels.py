"""Corners in pictures as observations: derivatives, both mounts, unknown lenses, and what a view cannot tell."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pickenv.arm import Geometry, Pose, forward, load_arm, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import (
    ArmModel,
    Board,
    Identification,
    Lens,
    PixelObservations,
    checked_rows,
    frames_model,
    identify,
    pose_carrier,
    prior_model,
    projected,
    random_joints,
)
from pickenv.calibration.assessment.instrument import said_of_instruments
from pickenv.calibration.identification.diagnosis import without_blind_views
from pickenv.calibration.identification.robust import rough_start
from pickenv.calibration.identification.solve import solve
from pickenv.calibration.model.arm_model import fitted_model, joints_of_finished_poses
from pickenv.calibration.model.pixels import board_poses

BOARD = Board(kind="charuco", columns=6, rows=8, square=0.03, marker=0.022, dictionary="5x5_100")
LENS = Lens(np.array([620.0, 622.0, 323.0, 238.0, -0.08, 0.05, 0.0008, -0.0005, 0.01]), (640, 480))
MOUNTS = ("hand", "world")


def carried(mount: str, views: int, seed: int) -> tuple[Geometry, np.ndarray]:
    """A free-moving arm whose tool sees the board, or is it, in front of the camera in every view."""
    rng = np.random.default_rng(seed)
    base = Pose(np.array([0.3, -0.2, 0.1]), rotation_matrix(np.array([0.2, -0.5, 0.4])))
    tool = Pose(np.array([0.02, 0.05, 0.08]), rotation_matrix(np.array([-0.3, 0.2, 0.7])))
    turn = rotation_matrix(rng.normal(0, 0.35, (views, 3)))
    middle = np.append(np.array(BOARD.size) / 2, 0.0)
    place = np.array([0.0, 0.0, 0.4]) + rng.normal(0, 0.03, (views, 3)) - turn @ middle  # the board before the camera
    wanted = Pose(place, turn)
    if mount == "hand":  # the camera before the board
        back = np.swapaxes(turn, 1, 2)
        wanted = Pose(-(back @ place[..., None])[..., 0], back)
    inner = base.rotation.T @ wanted.rotation @ tool.rotation.T
    flange = Pose((wanted.position - base.position) @ base.rotation - inner @ tool.position, inner)
    geometry = replace(pose_carrier().nominal, base=base, tool=tool)
    return geometry, joints_of_finished_poses(flange)


def views_of(
    mount: str, views: int = 12, seed: int = 0, noise: float = 0.0, lens: Lens = LENS, free: bool = False
) -> tuple[Geometry, PixelObservations]:
    geometry, joints = carried(mount, views, seed)
    count = len(BOARD.corners)
    data = PixelObservations(
        joints=joints,
        corners=np.zeros((views, count, 2)),
        seen=np.random.default_rng(seed).random((views, count)) < 0.8,
        board=BOARD.corners,
        camera=lens,
        lens_std=np.full(9, np.inf if free else 0.0),
        std=np.full((views, count), max(noise, 0.1)),
        mount=mount,  # type: ignore[arg-type]
    )
    found = projected(LENS.values, data.in_camera(ArmModel.of(geometry)))
    return geometry, replace(data, corners=found + np.random.default_rng(seed).normal(0, 1.0, found.shape) * noise)


def test_a_pose_is_the_joints_of_its_carrier() -> None:
    rng = np.random.default_rng(0)
    poses = Pose(rng.normal(size=(20, 3)), rotation_matrix(rng.normal(size=(20, 3))))
    found = forward(pose_carrier().nominal, joints_of_finished_poses(poses))
    np.testing.assert_allclose(found.position, poses.position, atol=1e-12)
    np.testing.assert_allclose(found.rotation, poses.rotation, atol=1e-12)


@pytest.mark.parametrize("mount", MOUNTS)
def test_the_right_arm_sees_the_corners_where_they_are(mount: str) -> None:
    geometry, data = views_of(mount)
    model = ArmModel.of(geometry)
    assert np.abs(data.residual(model, data.start(model))).max() < 1e-9
    assert (data.in_camera(model)[..., 2] > 0.2).all()
    poses = board_poses(data)
    tool = forward(geometry, data.joints)
    if mount == "hand":
        tool = Pose(-np.einsum("nji,nj->ni", tool.rotation, tool.position), np.swapaxes(tool.rotation, 1, 2))
    np.testing.assert_allclose(poses.position, tool.position, atol=1e-6)
    np.testing.assert_allclose(poses.rotation, tool.rotation, atol=1e-6)


@pytest.mark.parametrize("mount", MOUNTS)
def test_jacobians_are_the_residuals_slopes(mount: str) -> None:
    geometry, data = views_of(mount, views=3, free=True)
    data = replace(data, lens_std=np.array([5.0, 5.0, np.inf, 0.0, 0.1, np.inf, 0.01, 0.0, np.inf]))
    model, own = ArmModel.of(geometry), data.start(ArmModel.of(geometry))
    by_arm, by_lens = data.jacobian(model, own)
    h = 1e-7
    for k in range(by_arm.shape[1]):
        step = np.zeros(by_arm.shape[1])
        step[k] = h
        slope = (data.residual(model.displaced(step), own) - data.residual(model.displaced(-step), own)) / (2 * h)
        np.testing.assert_allclose(-by_arm[:, k], slope, atol=1e-3 * max(1.0, np.abs(slope).max()))
    for k in range(len(own)):
        step = np.zeros(len(own))
        step[k] = 1e-6
        slope = (data.residual(model, own + step) - data.residual(model, own - step)) / 2e-6
        np.testing.assert_allclose(-by_lens[:, k], slope, atol=1e-4 * max(1.0, np.abs(slope).max()))


@pytest.mark.parametrize("mount", MOUNTS)
@pytest.mark.parametrize("margin", [0.0, 40.0])
def test_corners_are_visible_that_opencv_puts_into_the_picture(mount: str, margin: float) -> None:
    """Boards near and far to the side: not seen at a slant, nor where a lens folds the world's edge inwards."""
    folding = Lens(np.array([620.0, 622.0, 400.0, 238.0, -0.33, 0.0, 0.0, 0.0, 0.0]), (640, 480))
    geometry, data = views_of(mount, 150, 1, lens=folding)
    rng = np.random.default_rng(2)
    joints = data.joints + rng.normal(0.0, 1.0, data.joints.shape) * np.array([0.2, 0.2, 0.1, 0.5, 0.5, 0.5])
    data, model = replace(data, joints=joints), ArmModel.of(geometry)
    points, (width, height) = data.in_camera(model), folding.size
    fx, fy, cx, cy, *distortion = folding.values
    matrix = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    expected, folded = np.zeros(points.shape[:2], dtype=bool), 0
    for view, corners in enumerate(points):
        inwards = np.cross(corners[1] - corners[0], corners[-1] - corners[0])
        middle = corners.mean(axis=0)
        facing = inwards @ middle > 0.5 * np.linalg.norm(inwards) * np.linalg.norm(middle)
        for k, (x, y, z) in enumerate(corners):
            if facing and z > 0.0:
                place = cv2.projectPoints(corners[k], np.zeros(3), np.zeros(3), matrix, np.array(distortion))[0]
                u, v = place.ravel()
                near = abs(fx * x / z + cx - width / 2) < width and abs(fy * y / z + cy - height / 2) < height
                inside = margin <= u <= width - 1 - margin and margin <= v <= height - 1 - margin
                expected[view, k], folded = near and inside, folded + (inside and not near)
    found = data.visible(model, np.zeros(0), margin)
    np.testing.assert_array_equal(found, expected)
    assert 0.05 < found.mean() < 0.95 and folded > 20


def test_of_finished_poses_base_and_tool_alone_are_fitted() -> None:
    """What carries them has no links to find; of an arm these are fitted too, and its frames unless they are known."""
    ends = {}
    for arm in (pose_carrier(), load_arm("ur5")):
        for known in (False, True):
            names = fitted_model(arm.name, arm.nominal, known).names
            ends[arm.name == "ur5", known] = {name.partition("_")[0] for name in names}
    assert ends[False, False] == ends[False, True] == {"base", "tool"}
    assert ends[True, False] > {"base", "tool"} and not ends[True, True] & {"base", "tool"}


@pytest.mark.parametrize("mount", MOUNTS)
def test_the_boards_poses_alone_show_base_and_tool(mount: str) -> None:
    """Of an arm that only carries poses, from nothing known of either frame."""
    geometry, data = views_of(mount)
    found = rough_start(pose_carrier().nominal, data)
    for here, there in ((found.base, geometry.base), (found.tool, geometry.tool)):
        np.testing.assert_allclose(here.position, there.position, atol=1e-5)
        np.testing.assert_allclose(here.rotation, there.rotation, atol=1e-5)


@pytest.mark.parametrize("mount", MOUNTS)
def test_frames_are_found_within_their_uncertainty(mount: str) -> None:
    truth, data = views_of(mount, noise=0.3, seed=3)
    start = truth.displaced(np.concatenate([np.zeros(5 * 6), [0.01, -0.02, 0.015, 0.03, -0.02, 0.02] * 2]))
    found = identify(frames_model(truth), start, [data], max_iterations=60)
    assert found.converged
    assert found.chi_square / found.degrees_of_freedom == pytest.approx(1.0, abs=0.15)
    off = found.geometry.difference(truth)[30:]
    assert np.abs(off / found.standard_deviation).max() < 4.0


def test_an_unknown_lens_is_found_with_the_frames() -> None:
    guess = Lens(np.array([600.0, 600.0, 320.0, 240.0, 0, 0, 0, 0, 0]), (640, 480))
    truth, data = views_of("hand", views=30, noise=0.2, seed=5, lens=guess, free=True)
    found = identify(frames_model(truth), truth, [data], max_iterations=60)
    names = list(found.unknowns)
    assert names == list(data.unknowns())
    own = np.array(list(found.unknowns.values()))
    off, std = (own - LENS.values)[:4], found.standard_deviation[:4]
    assert np.abs(off / std).max() < 4.5  # distortions that these views hardly tell apart stand in for one another
    seen = data.in_camera(ArmModel.of(truth))[data.seen]
    theirs, ours = (projected(values, seen) for values in (LENS.values, own))
    assert np.sqrt(np.mean((ours - theirs - (ours - theirs).mean(axis=0)) ** 2)) < 0.3
    assert np.sqrt(np.mean(data.pixel_errors(found.arm_model, own) ** 2)) == pytest.approx(0.2, rel=0.05)


def test_a_prior_holds_what_views_do_not_show() -> None:
    """One view tells hardly anything of a lens: with a prior it stays where it was believed, and is no surer."""
    truth, data = views_of("hand", views=4, noise=0.2, seed=2)
    data = replace(data, lens_std=np.array([2.0, 2.0, 2.0, 2.0, 0.01, 0.01, 0.001, 0.001, 0.01]))
    found = identify(frames_model(truth), truth, [data], max_iterations=60)
    own = np.array(list(found.unknowns.values()))
    assert np.abs((own - data.camera.values) / data.lens_std).max() < 3.5


def test_misses_are_metres_at_the_board() -> None:
    geometry, data = views_of("world")
    model = ArmModel.of(geometry)
    pixels = data.pixel_errors(model, data.start(model))
    assert np.abs(pixels).max() < 1e-9
    shifted = replace(data, corners=data.corners + np.array([1.0, 0.0]))
    depth = data.in_camera(model)[data.seen][:, 2]
    np.testing.assert_allclose(shifted.misses(model, data.start(model))[:, 0], depth / 620.0, atol=1e-9)
    assert len(shifted.rows_of_misses) == data.seen.sum()


def test_views_are_chosen_whole() -> None:
    _, data = views_of("world")
    some = data.select(np.array([3, 1]))
    np.testing.assert_array_equal(some.corners[0], data.corners[3])
    np.testing.assert_array_equal(some.seen, data.seen[[3, 1]])
    assert len(some.std) == 2 and some.origins is not None


@pytest.mark.parametrize("mount", MOUNTS)
def test_a_board_taken_for_a_turned_one_is_left_out(mount: str) -> None:
    """Its corners are found, each in another's place; the other views say where the board is."""
    _, data = views_of(mount, views=16, noise=0.3)
    corners, seen = data.corners.copy(), data.seen.copy()
    corners[[3, 11]], seen[[3, 11]] = corners[[3, 11], ::-1], seen[[3, 11], ::-1]
    none = data.select(np.arange(0))
    kept, _, left = checked_rows(pose_carrier(), data, none, known=False, robust=True)
    assert len(kept.joints) == 16 and not left
    kept, _, left = checked_rows(
        pose_carrier(), replace(data, corners=corners, seen=seen), none, known=False, robust=True
    )
    assert sorted(item.line for item in left) == [4, 12]
    np.testing.assert_array_equal(kept.joints, np.delete(data.joints, [3, 11], axis=0))


def test_a_lens_that_is_not_the_cameras_own_is_said_to_be_one() -> None:
    """And the right one is not, nor one that is fitted already."""
    other = replace(LENS, values=LENS.values * np.where(np.arange(9) < 2, 1.1, 1.0))
    for lens, free, said in ((LENS, False, 0), (other, False, 1), (other, True, 0)):
        geometry, data = views_of("hand", noise=0.2, lens=lens, free=free)
        model = frames_model(geometry)
        found = identify(model, geometry, [data])
        words = [text for _, text in said_of_instruments(model, found, data)]
        assert len(words) == said
        if said:
            errors = data.pixel_errors(found.arm_model, np.zeros(0))
            assert words[0].startswith(
                f"the lens as given leaves {np.sqrt(np.mean(errors**2)):.3g} px per coordinate, "
            )
            assert "a fitted one 0.19" in words[0] or "a fitted one 0.2" in words[0]


# Points in space instead of a board, of which a view shows only a few.

GOLDEN = (1.0 + np.sqrt(5.0)) / 2.0
EDGES = np.array([[0.0, a / GOLDEN, b * GOLDEN] for a in (-1.0, 1.0) for b in (-1.0, 1.0)])
CUBE = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
DODECAHEDRON = 0.03 * np.concatenate([CUBE, EDGES, np.roll(EDGES, 1, axis=1), np.roll(EDGES, 2, axis=1)])
"""Twenty points within 52 mm, four to twelve of them on the near side."""
EYES = {
    "world": Pose(np.array([1.2, 0.1, 0.4]), np.array([[0.0, 0.0, -1.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])),
    "hand": Pose(np.array([0.5, 0.1, 0.1]), rotation_matrix(np.array([0.2, 0.1, -0.3]))),
}
"""Where the frame of the instrument stands: a camera before the arm, or the points beside it."""


def balls_of(mount: str, seed: int, noise: float = 0.3) -> tuple[Geometry, PixelObservations]:
    """A UR5 with links off by 1 mm, and 40 views of the near half of a ball of points."""
    rng, nominal = np.random.default_rng(seed), load_arm("ur5").nominal
    sizes = np.concatenate([np.repeat([1e-3, 5e-4, 1e-3, 5e-4], nominal.links), np.zeros(nominal.links + 12)])
    there, tool = EYES[mount], Pose(np.array([0.02, 0.01, 0.12]), rotation_matrix(np.array([0.3, -0.2, 0.5])))
    true = nominal.displaced(sizes * rng.normal(size=len(sizes)))
    base = Pose(there.rotation.T @ (true.base.position - there.position), there.rotation.T @ true.base.rotation)
    true, joints = replace(true, base=base, tool=tool), random_joints(nominal, 8000, rng)
    blank = np.zeros((len(joints), 20, 2))
    everything = PixelObservations(
        joints, blank, blank[..., 0] == 0.0, DODECAHEDRON, LENS, np.zeros(9), blank[..., 0] + 0.3, mount
    )  # type: ignore[arg-type]
    model = ArmModel.of(true)
    points = everything.in_camera(model)
    far = np.linalg.norm(points, axis=2)
    good = everything.visible(model, np.zeros(0), 5.0).all(axis=1) & (np.abs(far.mean(axis=1) - 0.7) < 0.45)
    rows = np.flatnonzero(good)[:40]
    corners = projected(LENS.values, points[rows]) + noise * rng.normal(size=(len(rows), 20, 2))
    near = np.argsort(np.argsort(far[rows], axis=1), axis=1) < 10
    return true, replace(everything.select(rows), corners=corners, seen=near)


def showing(data: PixelObservations, counts: tuple[int, ...], seed: int) -> PixelObservations:
    """The views with so many of their points, in turn."""
    order = (
        np.where(data.seen, np.random.default_rng(seed).random(data.seen.shape), 2.0).argsort(axis=1).argsort(axis=1)
    )
    return replace(data, seen=data.seen & (order < np.resize(counts, len(order))[:, None]))


def fitted(data: PixelObservations) -> Identification:
    return solve(prior_model("ur5", rough_start(load_arm("ur5").nominal, data), known=False), data)


def missed_elsewhere(found: Identification, true: Geometry, data: PixelObservations) -> float:
    """What the points on the tool are missed by in the camera's frame, m RMS, at joints where no view was taken."""
    elsewhere = replace(data, joints=data.joints + 0.1 * np.random.default_rng(9).normal(size=data.joints.shape))
    errors = elsewhere.in_camera(found.arm_model) - elsewhere.in_camera(ArmModel.of(true))
    return float(np.sqrt(np.mean(np.sum(errors**2, axis=-1))))


@pytest.mark.parametrize("points", ["ball", "flat, turned", "board"])
@pytest.mark.parametrize("count", [4, 5, 6, 12, 20])
def test_a_view_of_four_points_or_more_shows_where_they_are(points: str, count: int) -> None:
    """Exactly without noise, for points in space, in a tilted plane and on a board, whichever are seen."""
    rng = np.random.default_rng(count)
    places = DODECAHEDRON if points == "ball" else np.append(rng.uniform(-0.05, 0.05, (20, 2)), np.zeros((20, 1)), 1)
    if points == "flat, turned":
        places = places @ rotation_matrix(np.array([0.3, 0.4, 0.1])).T + [0.03, -0.02, 0.01]
    turn = rotation_matrix(rng.normal(0.0, 0.5 if points != "ball" else 2.0, (50, 3)))
    place = np.column_stack([rng.normal(0.0, 0.05, (50, 2)), rng.uniform(0.3, 0.6, 50)])
    found = projected(LENS.values, places @ np.swapaxes(turn, 1, 2) + place[:, None])
    seen = rng.random((50, 20)).argsort(axis=1) < count
    blank = np.zeros((50, 6))
    data = PixelObservations(blank, found, seen, places, LENS, np.zeros(9), np.ones((50, 20)))
    poses = board_poses(data.select(data.starters()))
    clear = data.starters()
    wrong = np.linalg.norm(poses.rotation - turn[clear], axis=(1, 2)) > 1e-3
    assert wrong.mean() <= (0.1 if count < 6 else 0.0)  # of four points some attitudes are nearly as good


@pytest.mark.parametrize("mount", ["hand", pytest.param("world", marks=pytest.mark.slow)])
def test_few_points_a_view_find_an_arm_nearly_as_well_as_all(mount: str) -> None:
    """With three to seven of the ten near points, half the equations: the tool is missed by less than twice as much."""
    errors = []
    for seed in range(3):
        true, full = balls_of(mount, seed)
        errors.append([missed_elsewhere(fitted(d), true, full) for d in (showing(full, (3, 4, 5, 6, 7), seed), full)])
    few, most = np.sqrt(np.mean(np.array(errors) ** 2, axis=0))
    assert few < 2.0 * most and few < 1e-3, (few, most)


@pytest.mark.parametrize("mount", ["world", pytest.param("hand", marks=pytest.mark.slow)])
def test_single_points_make_an_arm_surer(mount: str) -> None:
    """Twenty views of five points start the fit, and twenty of one point each join it."""
    errors = []
    for seed in range(4):
        true, full = balls_of(mount, seed)
        data = showing(full, (5, 1), seed)
        kept, left = without_blind_views(data)
        assert kept is data and not left
        several = data.select(data.seen.sum(axis=1) > 1)
        both, without = fitted(data), fitted(several)
        assert np.mean(np.log(both.standard_deviation)) < np.mean(np.log(without.standard_deviation)) - 0.05
        errors.append([missed_elsewhere(found, true, full) for found in (both, without)])
    surer, without_them = np.sqrt(np.mean(np.array(errors) ** 2, axis=0))
    assert surer < without_them


def test_views_without_four_points_cannot_start_a_fit() -> None:
    _, full = balls_of("world", 0)
    with pytest.raises(InputError, match="none of 40 views shows 4 points"):
        rough_start(load_arm("ur5").nominal, showing(full, (3, 2, 1), 0))
