"""More poses like those of a first measurement: they can be measured, and tell more than as many drawn at random."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from pickenv.arm import Arm, Geometry, Pose, forward, load_arm, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import (
    Board,
    DistanceObservations,
    ErrorModel,
    InstrumentStation,
    Lens,
    Measurements,
    Observations,
    PixelObservations,
    Stacked,
    complete_model,
    identify,
    plan_like,
    projected,
    random_joints,
)
from pickenv.calibration.planning.plan import PosePlan, exchange
from pickenv.cli import app
from tests.calibration.simulated_instruments import KINDS, PLACE, STD, from_anchor, from_plane, points_at

LENS = Lens(np.array([620.0, 622.0, 323.0, 238.0, -0.08, 0.05, 0.0008, -0.0005, 0.01]), (640, 480))
BOARD = Board(kind="charuco", columns=7, rows=5, square=0.025, marker=0.018, dictionary="5x5_100").corners
NEAR_TIP = (0.028, -0.017, 0.064)
"""Where the tool point is said to be, which a fit begins from: on the last joint's axis it would show less."""
HOME = np.array([0.3, -1.2, 1.4, -1.7, -1.5, 0.4])
PIXEL_STD = 0.3
FIRST, COUNT, DRAWS = 14, 16, 16


@pytest.fixture(scope="module")
def ur5() -> Arm:
    return load_arm("ur5")


def after(first: Pose, second: Pose) -> Pose:
    return Pose(first.position + first.rotation @ second.position, first.rotation @ second.rotation)


def back(pose: Pose) -> Pose:
    return Pose(-pose.rotation.T @ pose.position, pose.rotation.T)


def camera_set_up(geometry: Geometry, mount: str) -> Geometry:
    """Base and tool such that at `HOME` the board lies before the camera, 0.35 m away."""
    look = Pose(np.array([0.02, 0.03, 0.05]), rotation_matrix(np.array([0.1, -0.2, 0.3])))
    board = Pose(np.array([-0.07, -0.05, 0.35]), rotation_matrix(np.array([0.2, -0.1, 0.1])))
    flange = forward(replace(geometry, tool=Pose(np.zeros(3), np.eye(3))), HOME)
    seen = board if mount == "world" else back(board)  # of board or camera, in the frame of what stands still
    base = after(after(seen, back(look)), back(after(back(geometry.base), flange)))
    return replace(geometry, base=base, tool=look)


def camera_points(geometry: Geometry, joints: np.ndarray, mount: str) -> np.ndarray:
    """The corners in the camera's frame ``(N, K, 3)``, written out here."""
    tool = forward(geometry, joints)
    if mount == "world":
        return np.einsum("nij,kj->nki", tool.rotation, BOARD) + tool.position[:, None]
    return np.einsum("nji,nkj->nki", tool.rotation, BOARD[None] - tool.position[:, None])


def facing_and_inside(points: np.ndarray) -> np.ndarray:
    """Which corners are in front, inside the picture, on the printed side ``(N, K)``; nearly sixty degrees at most."""
    x, y = points[:, 5] - points[:, 0], points[:, -1] - points[:, 5]
    normal = np.cross(x, y)
    middle = points.mean(axis=1)
    cosine = (normal * middle).sum(-1) / np.linalg.norm(normal, axis=-1) / np.linalg.norm(middle, axis=-1)
    ahead = (points[..., 2] > 0.01) & (np.abs(points[..., :2]) < 0.7 * points[..., 2:]).all(-1)
    places = projected(LENS.values, np.where(ahead[..., None], points, [0.0, 0.0, 1.0]))
    inside = ((places >= 0.0) & (places <= np.array(LENS.size) - 1.0)).all(-1)
    return np.asarray(ahead & inside & (cosine > 0.49)[:, None])


def views(geometry: Geometry, joints: np.ndarray, mount: str, rng: np.random.Generator) -> PixelObservations:
    points = camera_points(geometry, joints, mount)
    seen = facing_and_inside(points)
    places = projected(LENS.values, np.where(seen[..., None], points, [0.0, 0.0, 1.0]))
    noise = PIXEL_STD * rng.normal(size=places.shape)
    std = np.full(seen.shape, PIXEL_STD)
    return PixelObservations(joints, places + noise, seen, BOARD, LENS, np.zeros(9), std, mount=mount)  # type: ignore[arg-type]


def wire_at(geometry: Geometry, joints: np.ndarray, rng: np.random.Generator) -> DistanceObservations:
    """A wire of exact scale, whose zero, tool point and anchor are to be found."""
    length = from_anchor(points_at(geometry, joints))[:, 0] + 4e-3 + STD * rng.normal(size=len(joints))
    return DistanceObservations(joints, length, STD, zero_std=np.inf, tip=NEAR_TIP, tip_std=np.inf)


def touched(geometry: Geometry, joints: np.ndarray, rng: np.random.Generator) -> Observations:
    """The point touched again from near these joints: the arm is jogged until the tip is there."""
    wanted = PLACE + STD * rng.normal(size=(len(joints), 3))
    for _ in range(30):
        now = points_at(geometry, joints)
        if np.abs(now - wanted).max() < 1e-9:
            break
        slope = np.stack([(points_at(geometry, joints + s) - now) / 1e-7 for s in np.eye(6) * 1e-7], -1)
        joints = joints + np.einsum("nij,nj->ni", np.linalg.pinv(slope, rcond=1e-3), wanted - now)
    assert np.abs(points_at(geometry, joints) - wanted).max() < 1e-8
    one: Any = KINDS["touches"](geometry, 1, rng)
    return replace(one, joints=joints, socket=np.zeros(len(joints), dtype=np.int64), tip=NEAR_TIP)  # type: ignore[no-any-return]


def instrument(kind: str, arm: Arm) -> tuple[Geometry, Callable[..., Any], np.ndarray]:
    """The arm where the instrument has it, what is read on any arm at joints, and the first joints."""
    rng = np.random.default_rng(0)
    if kind == "wire":
        return arm.nominal, wire_at, random_joints(arm.nominal, FIRST, rng)
    if kind == "touches":
        return arm.nominal, touched, KINDS["touches"](arm.nominal, FIRST, rng).joints
    mount = kind.split()[1]
    geometry = camera_set_up(arm.nominal, mount)
    near = HOME + 0.2 * rng.normal(size=(200, 6))
    good = facing_and_inside(camera_points(geometry, near, mount)).mean(axis=1) > 0.6
    return geometry, lambda g, joints, rng: views(g, joints, mount, rng), near[good][:FIRST]


def planned(kind: str, arm: Arm) -> tuple[PosePlan, Geometry, Callable[..., Any], np.ndarray]:
    geometry, read, first = instrument(kind, arm)
    data = read(geometry, first, np.random.default_rng(1))
    plan = plan_like(
        arm, data, COUNT, np.random.default_rng(2), candidates=600, criterion="test-poses", test_joints=None
    )
    return plan, geometry, read, first


def planned_model(plan: PosePlan, nominal: Geometry, sized: bool) -> tuple[ErrorModel, np.ndarray]:
    """The parameters planned for, with the link that is held where no length is known, and which are planned for."""
    whole = complete_model(nominal)
    lengths = {f"a{i}": abs(a) for i, a in enumerate(nominal.a)} | {
        f"d{i + 1}": abs(d) for i, d in enumerate(nominal.d)
    }
    held = set() if sized else {max(lengths, key=lambda name: float(lengths[name]))} - set(plan.parameters)
    assert sized or len(held) == 1
    used = [k for k, name in enumerate(whole.names) if name in plan.parameters or name in held]
    names = tuple(whole.names[k] for k in used)
    return ErrorModel(whole.columns[used], names, whole.tolerance[used]), np.array([name not in held for name in names])


CASES = ("wire", "touches", "camera hand", "camera world")
SLOW = [pytest.param(kind, marks=pytest.mark.slow) for kind in ("touches", "camera world")]


@pytest.mark.parametrize("kind", ["wire", "camera hand", *SLOW])
def test_planned_poses_tell_more_and_calibrations_confirm_it(kind: str, ur5: Arm) -> None:
    """The error of arms that are calibrated with them, against arms calibrated with random ones of the candidates."""
    plan, geometry, read, first = planned(kind, ur5)
    assert plan.predicted_error < 0.95 * plan.random_predicted_error
    model, kept = planned_model(plan, ur5.nominal, sized=kind != "touches")
    rng = np.random.default_rng(3)
    errors: dict[str, list[float]] = {"planned": [], "random": []}
    for _ in range(DRAWS):
        off = np.zeros(len(geometry.parameter_names))
        off[model.columns[kept]] = 0.5 * model.tolerance[kept] * rng.normal(size=sum(kept))
        true = geometry.displaced(off)
        drawn = plan.design.joints[rng.choice(len(plan.design.joints), COUNT, replace=False)]
        for name, joints in (("planned", plan.joints), ("random", drawn)):
            data = read(true, np.concatenate([first, joints]), rng)
            found = identify(model, geometry, [data], max_iterations=60, rank_tolerance=1e-7)
            assert found.converged and found.identifiability.kept_names == plan.parameters
            left = forward(found.geometry, plan.design.joints).position - forward(true, plan.design.joints).position
            errors[name].append(float(np.mean(np.sum(left**2, axis=1))))
    rms = {name: float(np.sqrt(np.mean(values))) for name, values in errors.items()}
    assert rms["planned"] < rms["random"]
    assert rms["planned"] == pytest.approx(plan.predicted_error, rel=0.35)


@pytest.mark.parametrize("mount", ["hand", "world"])
def test_every_planned_view_sees_the_board(mount: str, ur5: Arm) -> None:
    plan, geometry, _, first = planned(f"camera {mount}", ur5)
    for joints in (plan.joints, plan.design.joints):
        points = camera_points(geometry, joints, mount)
        assert (facing_and_inside(points).mean(axis=1) >= 0.5).all()
        depth, depths = (camera_points(geometry, q, mount)[..., 2].mean(axis=1) for q in (joints, first))
        assert depth.min() > depths.min() / 1.6 and depth.max() < depths.max() * 1.6
    assert ((plan.joints > ur5.nominal.lower) & (plan.joints < ur5.nominal.upper)).all()


@pytest.mark.parametrize("kind", sorted(KINDS))
def test_every_kind_is_planned_where_it_can_be_measured(kind: str, ur5: Arm) -> None:
    data: Any = KINDS[kind](ur5.nominal, 25, np.random.default_rng(0), 1.0)
    plan = plan_like(ur5, data, 12, np.random.default_rng(1), candidates=200)
    assert plan.joints.shape == (12, 6) and len(plan.design.joints) == 200
    assert ((plan.joints > ur5.nominal.lower) & (plan.joints < ur5.nominal.upper)).all()
    assert set(data.unknowns()) - set(plan.parameters) <= set(data.unknowns()) and plan.predicted_error > 0.0
    points = points_at(ur5.nominal, plan.design.joints)
    if kind == "touches":
        assert np.linalg.norm(points - PLACE, axis=1).max() < 1e-3
    if kind in ("bar", "sphere"):
        assert np.abs(from_anchor(points) - 0.7).max() < 1e-3
    if kind == "plane":
        assert np.abs(from_plane(points)).max() < 1e-3
    if kind == "dial":  # within its stroke
        assert from_plane(points).min() > -0.1015 and from_plane(points).max() < -0.0885
    if kind == "wire":  # as far as it was pulled
        ends = [f(from_anchor(points_at(ur5.nominal, data.joints))) for f in (np.min, np.max)]
        assert ends[0] - 1e-3 < from_anchor(points).min() and from_anchor(points).max() < ends[1] + 1e-3


def test_what_is_known_already_is_not_asked_again() -> None:
    """With one direction known, the exchange spends its poses on the other."""
    rows = np.zeros((40, 1, 2))
    rows[:20, 0, 0] = rows[20:, 0, 1] = 1.0
    chosen, _ = exchange(rows, 6, np.random.default_rng(0), known=np.diag([1e4, 0.0]))
    assert (chosen >= 20).sum() == 6
    evenly, _ = exchange(rows, 6, np.random.default_rng(0))
    assert (evenly >= 20).sum() == 3


def test_the_predicted_error_is_that_of_all_rows_together(ur5: Arm) -> None:
    """Positions, whose Jacobian by the tool is written out: first rows and planned poses in one information matrix."""
    nominal, rng = ur5.nominal, np.random.default_rng(0)
    joints = random_joints(nominal, 20, rng)
    data = Measurements(joints, forward(nominal, joints).position, None, nominal.prismatic, position_std=1e-4)
    plan = plan_like(ur5, data, 15, rng, candidates=300, criterion="test-poses", curve=True)
    whole = complete_model(nominal)
    columns = [k for k, name in zip(whole.columns, whole.names, strict=True) if name in plan.parameters]

    def slopes(q: np.ndarray) -> np.ndarray:
        steps = np.zeros((len(columns), len(nominal.parameter_names)))
        steps[np.arange(len(columns)), columns] = 1e-6
        moved = [forward(nominal.displaced(s), q).position - forward(nominal.displaced(-s), q).position for s in steps]
        return np.stack(moved, axis=-1) / 2e-6

    seen = slopes(np.concatenate([data.joints, plan.joints])).reshape(-1, len(columns)) / 1e-4
    field = slopes(plan.design.joints).reshape(-1, len(columns))
    covariance = np.linalg.inv(seen.T @ seen)
    wanted = np.sqrt(np.einsum("ij,jk,ik->", field, covariance, field) / len(plan.design.joints))
    assert plan.predicted_error == pytest.approx(wanted, rel=1e-3)
    each, weight = slopes(plan.design.joints) / 1e-4, field.T @ field
    for place in range(0, 15, 3):  # no other candidate in place of a planned pose makes it smaller
        rest = np.delete(plan.chosen, place)
        without = sum(r.T @ r for r in (slopes(data.joints).reshape(-1, len(columns)) / 1e-4, *each[rest]))
        traces = np.trace(np.linalg.solve(without + np.swapaxes(each, 1, 2) @ each, weight), axis1=1, axis2=2)
        traces[rest] = np.inf
        assert traces[plan.chosen[place]] <= traces.min() * (1.0 + 1e-5)
    sizes, errors, _ = zip(*plan.curve, strict=True)
    assert sizes == (7, 15, 30, 60, 120)
    assert list(errors[1:]) == sorted(errors[1:], reverse=True) and errors[1] > errors[-1]
    assert plan.curve[1][1] == plan.predicted_error


def test_faults_of_a_first_measurement_are_named(ur5: Arm) -> None:
    wire: Any = KINDS["wire"](ur5.nominal, 25, np.random.default_rng(0), 1.0)
    both = Stacked((InstrumentStation(wire), InstrumentStation(wire, 2)))
    for data, options, words in (
        (both, {}, "plan for one instrument"),
        (wire, {"criterion": "best"}, "criterion is 'best'"),
        (wire, {"candidates": 20}, "too few to choose 12 from"),
        (wire.select(np.arange(9)), {"count": 1}, "too few for"),
    ):
        given: dict[str, Any] = {"count": 12, "candidates": 200, **options}
        with pytest.raises(InputError, match=words):
            plan_like(ur5, data, given.pop("count"), np.random.default_rng(0), **given)


def test_the_curve_begins_with_poses_that_are_enough(ur5: Arm) -> None:
    """Half of the planned poses would leave the parameters open, with no number for their error."""
    geometry, read, first = instrument("wire", ur5)
    data = read(geometry, first, np.random.default_rng(1))
    plan = plan_like(ur5, data, 12, np.random.default_rng(2), candidates=100, curve=True)
    assert plan.curve[0][0] == 12  # 12 and the 14 first lengths are one more than the 25 unknowns
    assert np.isfinite(plan.curve).all()


DESCRIPTION = """
description = "A wire"

[joints]
columns = ["q1", "q2", "q3", "q4", "q5", "q6"]
unit = "rad"

[wire]
columns = ["length"]
unit = "mm"
std_mm = 0.05
"""


def test_the_command_plans_like_a_file(ur5: Arm, tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    joints = random_joints(ur5.nominal, 30, rng)
    length = np.linalg.norm(forward(ur5.nominal, joints).position - [0.5, -0.9, 0.3], axis=1) * 1e3
    table = np.column_stack([joints, length + 0.05 * rng.normal(size=30)])
    np.savetxt(tmp_path / "first.csv", table, delimiter=",", header="q1,q2,q3,q4,q5,q6,length", comments="")
    (tmp_path / "wire.toml").write_text(DESCRIPTION)

    def call(*words: object) -> Any:
        return CliRunner().invoke(app, ["plan-poses", "--arm", "ur5", *map(str, words)])

    like = ["--like", tmp_path / "first.csv", "--columns", tmp_path / "wire.toml", "--n", 12]
    done = call(*like, "--out", tmp_path / "p.csv", "--json", tmp_path / "p.json", "--candidates", 300, "--curve")
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "p.json").read_text())
    assert found["kind"] == "wire" and found["first_rows"] == 30 and "anchor_x" in found["parameters"]
    assert found["predicted_error_mm"] < found["random_predicted_error_mm"]
    assert f"{found['predicted_error_mm']:.4f} mm RMS" in done.output and "how many poses?" in done.output
    rows = np.loadtxt(tmp_path / "p.csv", delimiter=",", skiprows=1)
    assert rows.shape == (12, 6)
    again = call(
        *like, "--from", tmp_path / "p.csv", "--n", 4, "--json", tmp_path / "l.json", "--out", tmp_path / "l.csv"
    )
    assert again.exit_code == 0, again.output
    lines = json.loads((tmp_path / "l.json").read_text())["lines"]
    assert len(set(lines)) == 4
    np.testing.assert_allclose(np.loadtxt(tmp_path / "l.csv", delimiter=",", skiprows=1), rows[np.array(lines) - 2])
    assert "leave out --kind" in str(call(*like, "--kind", "pose").exception or call(*like, "--kind", "pose").output)
