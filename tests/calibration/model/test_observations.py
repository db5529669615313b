"""Reflectors, draw wires and sockets: each kind's derivatives, and what each kind identifies."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Pose, forward, joint_jacobian, load_arm, rotation_matrix
from pickenv.calibration import (
    ArmModel,
    DistanceObservations,
    ErrorModel,
    Measurements,
    ReflectorObservations,
    SocketObservations,
    align,
    complete_model,
    frames_model,
    identify,
    random_joints,
)

TRIAD = np.array([[50.0, 0.0, 20.0], [-40.0, 60.0, 0.0], [-30.0, -50.0, 35.0]]) * 1e-3


def poses_from_reflectors(points: np.ndarray, reference: np.ndarray) -> Pose:
    """Poses that carry the ``reference`` reflectors ``(k, 3)`` onto ``points`` ``(N, k, 3)``: Kabsch 1976, batched."""
    centre, middle = points.mean(axis=1), reference.mean(axis=0)
    u, _, vt = np.linalg.svd(np.einsum("nki,kj->nij", points - centre[:, None], reference - middle))
    rotation = u * np.stack([np.ones(len(u)), np.ones(len(u)), np.linalg.det(u @ vt)], -1)[:, None] @ vt
    return Pose(centre - rotation @ middle, rotation)


def far(geometry, seed):
    """The arm in an instrument's frame, with a tool turned and shifted."""
    rng = np.random.default_rng(seed)
    base = Pose(rng.uniform(-4, 4, 3), rotation_matrix(rng.normal(size=3)))
    tool = Pose(geometry.tool.position + rng.uniform(-0.1, 0.1, 3), rotation_matrix(rng.normal(size=3)))
    return replace(geometry, base=base, tool=tool)


def reflectors(geometry, count=60, seed=0, lost=0.0, local=TRIAD):
    rng = np.random.default_rng(seed)
    joints = random_joints(geometry, count, rng)
    pose = forward(geometry, joints)
    points = pose.position[:, None] + np.einsum("nij,kj->nki", pose.rotation, local)
    seen = rng.uniform(size=points.shape[:2]) >= lost
    points = np.where(seen[..., None], points, np.nan if lost else 0.0)
    return ReflectorObservations(joints, points, seen, 15e-6)


def wire(geometry, count=80, seed=0, anchor=(1.5, -2.0, 0.3)):
    joints = random_joints(geometry, count, np.random.default_rng(seed))
    length = np.linalg.norm(forward(geometry, joints).position - np.array(anchor), axis=1)
    return DistanceObservations(joints, length, 2e-5)


def sockets(geometry, per_socket=25, seed=0, spacing=0.2, places=2):
    """Joints that put the tool's origin into sockets, two and two `spacing` apart, with attitudes of all kinds."""
    rng = np.random.default_rng(seed)
    centre = (geometry.lower + geometry.upper) / 2 + 0.3 * (geometry.upper - geometry.lower) * rng.uniform(-0.5, 0.5)
    joints, socket, pairs = [], [], []
    for place in range(places):
        shift = rng.uniform(-0.1, 0.1, geometry.joints) * (geometry.upper - geometry.lower)
        middle = forward(geometry, centre + shift).position
        along = rng.normal(size=3)
        for i, side in enumerate((-0.5, 0.5)):
            end = middle + side * spacing * along / np.linalg.norm(along)
            found = 0
            while found < per_socket:
                q = place_tool(geometry, random_joints(geometry, 1, rng)[0], end)
                if q is not None:
                    joints.append(q)
                    socket.append(2 * place + i)
                    found += 1
        pairs.append((2 * place, 2 * place + 1))
    return SocketObservations(np.array(joints), np.array(socket), np.array(pairs), np.full(places, spacing))


def place_tool(geometry, q, target):
    """Newton steps on the position alone; None where they do not end."""
    for _ in range(30):
        miss = target - forward(geometry, q).position
        if np.linalg.norm(miss) < 1e-13:
            break
        q = q + np.linalg.pinv(joint_jacobian(geometry, q)[:3], rcond=1e-2) @ miss
    return q if np.linalg.norm(miss) < 1e-11 and np.linalg.norm(q) < 20 else None


KINDS = {
    "pose": lambda g: exact_poses(g, 12),
    "position": lambda g: exact_poses(g, 12).positions_only(),
    "reflectors": lambda g: reflectors(g, 12, lost=0.2),
    "distance": lambda g: wire(g, 12),
    "sockets": lambda g: sockets(g, 4),
}


def exact_poses(geometry, count, seed=0):
    joints = random_joints(geometry, count, np.random.default_rng(seed))
    return Measurements(joints, *forward(geometry, joints), prismatic=geometry.prismatic)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("arm", ["qiao2026", "ur5"])
def test_derivatives_are_the_residuals_differences(arm, kind):
    geometry = load_arm(arm).nominal
    data = KINDS[kind](far(geometry, 1))
    rng = np.random.default_rng(0)
    model = ArmModel.of(far(geometry, 1)).displaced(rng.normal(size=len(geometry.parameter_names)) * 1e-2)
    unknowns = data.start(model) + rng.normal(size=len(data.unknowns())) * 1e-2
    by_model, by_unknown = data.jacobian(model, unknowns)
    # whitened rows are in standard uncertainties of some 15 um: compare relative to the largest derivative
    step = 1e-6
    for k, name in enumerate(model.parameter_names):
        delta = np.zeros(len(model.parameter_names))
        delta[k] = step
        up, down = (data.residual(model.displaced(s * delta), unknowns) for s in (1, -1))
        # residual is measured minus predicted; the attitude error's curvature is of second order in the error itself
        scale = np.abs(by_model).max()
        close = 3e-2 if kind == "pose" else 1e-6
        np.testing.assert_allclose((down - up) / (2 * step), by_model[:, k], atol=close * scale, err_msg=name)
    for k, name in enumerate(data.unknowns()):
        delta = np.zeros(len(unknowns))
        delta[k] = step
        up, down = (data.residual(model, unknowns + s * delta) for s in (1, -1))
        scale = np.abs(by_unknown).max()
        np.testing.assert_allclose((down - up) / (2 * step), by_unknown[:, k], atol=1e-6 * scale, err_msg=name)


@pytest.mark.parametrize("lost", [0.0, 0.25])
def test_three_reflectors_identify_all_24_of_the_hybrid_arm(qiao, exact, lost):
    """Base and tool pose included: the triad replaces a pose sensor, and its own shape is found besides."""
    true = far(qiao.true, 2)
    data = reflectors(true, 80, lost=lost)
    start = ArmModel.of(replace(qiao.nominal, base=true.base, tool=true.tool))
    found = identify(complete_model(qiao.nominal), start, [data])
    assert found.converged
    assert found.chi_square < 1e-6 * found.degrees_of_freedom
    # 24 of the arm with base and tool, and of the triad's nine coordinates the three that are its shape
    assert found.identifiability.rank == 24 + 3
    local = np.array([found.unknowns[name] for name in data.unknowns()]).reshape(3, 3)
    for i, j in ((0, 1), (1, 2), (2, 0)):
        expected = np.linalg.norm(TRIAD[i] - TRIAD[j])
        assert np.linalg.norm(local[i] - local[j]) == pytest.approx(expected, abs=1e-9)
    # what it predicts of a reflector is right anywhere
    other = reflectors(true, 200, seed=9)
    left = other.misses(found.arm_model, local.ravel()).reshape(other.points.shape)
    assert np.abs(left).max() < 1e-7


def test_known_reflectors_give_poses():
    rng = np.random.default_rng(0)
    rotation = rotation_matrix(rng.normal(size=(50, 3)))
    position = rng.normal(size=(50, 3))
    points = position[:, None] + np.einsum("nij,kj->nki", rotation, TRIAD)
    pose = poses_from_reflectors(points, TRIAD)
    np.testing.assert_allclose(pose.position, position, atol=1e-12)
    np.testing.assert_allclose(pose.rotation, rotation, atol=1e-12)


def test_lost_reflectors_weigh_nothing(qiao):
    whole, some = reflectors(qiao.true, 40), reflectors(qiao.true, 40, lost=0.3)
    model = ArmModel.of(qiao.nominal)
    assert np.isfinite(some.residual(model, some.start(model))).all()
    filled = replace(whole, points=np.where(some.seen[..., None], whole.points, 99.0), seen=some.seen)
    np.testing.assert_array_equal(filled.residual(model, TRIAD.ravel()), some.residual(model, TRIAD.ravel()))


def test_a_draw_wire_calibrates_an_arm_and_finds_its_own_anchor(qiao):
    """One length per pose, no frame anywhere: base pose is unobservable, what remains is exact."""
    data = wire(qiao.true, 150)
    found = identify(complete_model(qiao.nominal), qiao.nominal, [data])
    assert found.converged and found.chi_square < 1e-6 * found.degrees_of_freedom
    assert not any(name.startswith("anchor") for name in found.identifiability.dropped)
    assert {"base_x", "base_y", "base_z", "base_rx", "base_ry", "base_rz"} <= set(found.identifiability.dropped)
    other = wire(qiao.true, 300, seed=5)
    anchor = np.array([found.unknowns[f"anchor_{axis}"] for axis in "xyz"])
    assert np.abs(other.residual(found.arm_model, anchor)).max() * other.std < 1e-8


def test_sockets_calibrate_an_arm_without_any_metrology():
    ur5 = load_arm("ur5")
    rng = np.random.default_rng(4)
    names = ur5.nominal.parameter_names
    small = np.array([1e-3 if not name.startswith(("base", "tool")) else 0.0 for name in names])
    true = ur5.nominal.displaced(rng.normal(size=len(names)) * small)
    data = sockets(true, 40, places=3)
    found = identify(complete_model(ur5.nominal), ur5.nominal, [data])
    assert found.converged and found.chi_square < 1e-6 * found.degrees_of_freedom
    other = sockets(true, 5, seed=8, places=2, spacing=0.3)
    model = found.arm_model
    assert np.abs(other.residual(model, other.start(model))).max() * other.std < 1e-6


def test_without_a_known_spacing_the_scale_is_not_observable():
    ur5 = load_arm("ur5")
    data = sockets(ur5.nominal, 40, places=2)
    blind = replace(data, pairs=np.zeros((0, 2), dtype=np.int64), spacing=np.zeros(0))
    ranks = [identify(complete_model(ur5.nominal), ur5.nominal, [part]).identifiability.rank for part in (data, blind)]
    assert ranks[0] == ranks[1] + 1


def test_kinds_mix_and_each_adds_what_it_sees(qiao):
    """A draw wire and a few positions in the tracker's frame: together they know what either lacks."""
    positions = exact_poses(qiao.true, 30, seed=3).positions_only()
    lengths = wire(qiao.true, 120)
    both = identify(complete_model(qiao.nominal), qiao.nominal, [positions, lengths])
    assert both.converged and both.kind == "position+distance"
    assert both.chi_square < 1e-6 * both.degrees_of_freedom
    alone = identify(complete_model(qiao.nominal), qiao.nominal, [positions])
    assert both.identifiability.rank == alone.identifiability.rank + 3  # the anchor


def test_weights_decide_between_contradicting_instruments(qiao):
    """Two instruments that disagree by 1 mm: the surer one wins by the ratio of their variances."""
    sure = exact_poses(qiao.nominal, 40, seed=1)
    unsure = exact_poses(qiao.nominal, 40, seed=2)
    sure = replace(sure, position_std=1e-5)
    unsure = replace(unsure, position=unsure.position + np.array([1e-3, 0, 0]), position_std=1e-4)
    frames = frames_model(qiao.nominal)
    shift = ErrorModel(frames.columns[:1], frames.names[:1], frames.tolerance[:1])
    found = identify(shift, qiao.nominal, [sure, unsure])
    assert found.delta[0] == pytest.approx(1e-3 / 101, rel=1e-6)


def test_a_triad_of_known_shape_is_a_pose_sensor(qiao):
    """A triad of known shape is a pose sensor: poses from it calibrate like poses."""
    true = far(qiao.true, 3)
    data = reflectors(true, 80)
    pose = poses_from_reflectors(data.points, TRIAD)
    measured = Measurements(data.joints, pose.position, pose.rotation, qiao.nominal.prismatic)
    aligned = align(qiao.nominal, measured, frames_model(qiao.nominal))
    found = identify(complete_model(qiao.nominal), aligned.geometry, measured)
    assert found.converged and found.identifiability.rank == 24


def test_a_block_without_the_last_socket_of_a_pair_is_still_of_the_same_sockets():
    data = sockets(load_arm("ur5").nominal, per_socket=2)
    block = data.select(data.socket < 3)
    model = ArmModel.of(load_arm("ur5").nominal)
    assert block.unknowns() == data.unknowns()
    assert np.isfinite(block.residual(model, data.start(model))).all()
