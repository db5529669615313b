"""What yields where an arm slides: finite elements and MuJoCo's equilibrium referee couple, twist and bearings."""

import math
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pickenv.arm import (
    Load,
    chain_of,
    draw_plants,
    frames,
    load_plant,
    load_tolerances,
    plant_at,
    pose_of,
    rotation_matrix,
)
from pickenv.arm.effects.effect import Loads
from pickenv.arm.effects.structure import Bearing, BoomBending, BoomCouple, BoomTorsion, SlideCompliance
from pickenv.base import GRAVITY

BARE = load_plant("geometry_only")
LOAD = Load(
    (4.0, 3.0, 2.4, 0.9, 0.6, 0.5),
    ((0.06, 0, 0), (0, 0, -0.08), (0, 0, -0.35), (0.02, 0.03, -0.03), (0, 0, -0.04), (0.05, 0, -0.06)),
    0.3,
)
EI, GJ, OUT, DENSITY = 2.56e4, 1.44e4, 0.4, 1.8
BENT = {
    "boom_bending": BoomBending(2, OUT, EI, 2.0, DENSITY),
    "boom_couple": BoomCouple(2, OUT, EI),
    "boom_torsion": BoomTorsion(2, OUT, GJ),
}
SLIDES = SlideCompliance((Bearing(1, 2e7, 0.2), Bearing(2, 1e7, 1.2, 0.4), Bearing(4, 3e6, 0.3, 0.05)))
Q = [
    [0.1, 0.3, 0.7, 0.4, 0.1, 0.5],
    [-0.4, 0.1, 0.0, -1.2, 0.0, -2.0],
    [0.7, 0.6, 0.8, 1.2, 0.2, 3.0],
]


def arm(load=LOAD, **effects):
    return replace(BARE, load=load, effects=tuple(effects.values()))


def behind(q, joint):
    """Links of the straight arm as poses, and the masses behind a joint with their places in the world."""
    links = [pose_of(frame) for frame in frames(np, chain_of(BARE.geometry), q)[1:]]
    masses = [
        (mass, link.position + link.rotation @ np.array(centre))
        for mass, link, centre in zip(LOAD.mass, links, LOAD.centre, strict=True)
    ][joint:]
    return links, [*masses, (LOAD.payload, links[-1].position)]


def beam(length, force, moment, weight, elements=60):
    """Tip displacement and rotation of a cantilever along z by finite elements, in the boom's axes.

    Euler-Bernoulli in both planes and Saint-Venant torsion; consistent loads of the weight per length.
    """
    h = length / elements
    size = 6 * (elements + 1)  # ux, uy, uz, rx, ry, rz of each node
    k, f = np.zeros((size, size)), np.zeros(size)
    plane = (
        EI
        / h**3
        * np.array(
            [
                [12, 6 * h, -12, 6 * h],
                [6 * h, 4 * h**2, -6 * h, 2 * h**2],
                [-12, -6 * h, 12, -6 * h],
                [6 * h, 2 * h**2, -6 * h, 4 * h**2],
            ]
        )
    )
    own = h * np.array([0.5, h / 12, 0.5, -h / 12])
    for e in range(elements):
        for u, r, sign in ((0, 4, 1.0), (1, 3, -1.0)):  # x bends about y, y about minus x
            at = [6 * e + u, 6 * e + r, 6 * e + 6 + u, 6 * e + 6 + r]
            signs = np.array([1.0, sign, 1.0, sign])
            k[np.ix_(at, at)] += plane * np.outer(signs, signs)
            f[at] += weight[u] * own * signs
        for u, stiffness in ((5, GJ / h), (2, 1e12)):
            at = [6 * e + u, 6 * e + 6 + u]
            k[np.ix_(at, at)] += stiffness * np.array([[1, -1], [-1, 1]])
    f[-6:-3] += force
    f[-3:] += moment
    found = np.linalg.solve(k[6:, 6:], f[6:])[-6:]
    return found[:3], found[3:]


@pytest.mark.parametrize("q", Q)
def test_bending_couple_and_twist_are_those_of_a_beam_of_finite_elements(q):
    links, masses = behind(q, 3)
    straight, tip = links[-1], links[2]
    down = tip.rotation.T @ np.array([0, 0, -GRAVITY])
    hung = sum(mass for mass, _ in masses)
    moment = sum(np.cross(tip.rotation.T @ (point - tip.position), mass * down) for mass, point in masses)
    across = down * [1, 1, 0]
    moved, turned = beam(OUT + q[2], hung * across, moment, DENSITY * across)
    turn = tip.rotation @ rotation_matrix(turned) @ tip.rotation.T
    expected = tip.position + tip.rotation @ moved + turn @ (straight.position - tip.position)
    load, bending = LOAD, replace(BENT["boom_bending"], end_mass=hung - LOAD.payload)
    found = arm(load, **(BENT | {"boom_bending": bending})).tool_pose(q)
    sag = np.linalg.norm(expected - straight.position)
    assert sag > 5e-5
    np.testing.assert_allclose(found.position, expected, rtol=0, atol=2e-3 * sag)  # small angles, one after the other
    np.testing.assert_allclose(found.rotation, turn @ straight.rotation, rtol=0, atol=2e-6)


def equilibrium(q, slides):
    """Tool of the arm whose slides hang in springs, at rest in MuJoCo: every link but slides is rigid."""
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, -GRAVITY]
    spec.compiler.degree = False
    links, _ = behind(q, 0)
    parent, before = spec.worldbody, (np.zeros(3), np.eye(3))
    count = 0
    for i, link in enumerate(links):
        rotation = before[1].T @ link.rotation
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, rotation.ravel())
        body = parent.add_body(pos=before[1].T @ (link.position - before[0]), quat=quat)
        body.mass, body.ipos, body.inertia = LOAD.mass[i], LOAD.centre[i], [0.01, 0.01, 0.01]
        body.explicitinertial = True
        bearing = next((each for each in slides.bearings if each.joint == i), None)
        if bearing is not None:
            span, arm_length = bearing.span, 0.0
            if bearing.overhang is not None:
                span = bearing.span - q[i]
                arm_length = bearing.overhang + q[i] + span / 2
            centre = [0, 0, -arm_length]
            for axis in np.eye(3)[:2]:
                body.add_joint(type=mujoco.mjtJoint.mjJNT_SLIDE, axis=axis, stiffness=2 * bearing.stiffness)
            for axis in np.eye(3):
                stiffness = bearing.stiffness * span**2 / 2
                body.add_joint(type=mujoco.mjtJoint.mjJNT_HINGE, axis=axis, pos=centre, stiffness=stiffness)
            count += 5
        parent, before = body, (link.position, link.rotation)
    held = parent.add_body(name="tool")
    held.mass, held.inertia, held.explicitinertial = LOAD.payload, [1e-9] * 3, True
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(50):  # Newton on spring forces against gravity, slopes by differences

        def unbalanced(x):
            data.qpos[:] = x
            data.qvel[:] = 0
            mujoco.mj_forward(model, data)
            return data.qfrc_passive - data.qfrc_bias

        here = data.qpos.copy()
        left = unbalanced(here)
        if np.abs(left).max() < 1e-9:
            break
        slope = np.stack([(unbalanced(here + h) - unbalanced(here - h)) / 2e-6 for h in 1e-6 * np.eye(count)], 1)
        data.qpos[:] = here - np.linalg.solve(slope, left)
    unbalanced(data.qpos.copy())
    tool = model.body("tool").id
    return data.xpos[tool].copy(), data.xmat[tool].reshape(3, 3).copy()


@pytest.mark.parametrize("q", Q)
def test_slides_rest_where_mujoco_finds_them(q):
    position, rotation = equilibrium(q, SLIDES)
    straight, found = BARE.tool_pose(q), arm(slide_compliance=SLIDES).tool_pose(q)
    sunk = np.linalg.norm(position - straight.position)
    assert sunk > 1e-5
    np.testing.assert_allclose(found.position, position, rtol=0, atol=5e-3 * sunk)  # loads of the straight arm
    np.testing.assert_allclose(found.rotation, rotation, rtol=0, atol=2e-6)


def test_bearings_that_come_closer_yield_more_and_those_of_a_carriage_do_not():
    stiff = replace(LOAD, mass=(0.0,) * 6, payload=1.0)
    for overhang, grows in ((0.4, True), (None, False)):
        turns = []
        for out in (0.0, 0.4, 0.8):
            loose = arm(stiff, slide_compliance=SlideCompliance((Bearing(2, 1e7, 1.2, overhang),)))
            q = [0.0, 0.3, out, 0.0, 0.1, 0.0]
            turns.append(np.abs(loose.tool_pose(q).rotation - BARE.tool_pose(q).rotation).max())
        assert (turns[2] > 3 * turns[0]) == grows


@pytest.mark.parametrize("seed", range(4))
def test_a_boom_and_a_slide_of_any_attitude_yield_by_the_vectors_of_moment_and_weight(seed):
    """No part of a turn or a shift is left out, as where the boom is level: Rodrigues' formula and cross products."""
    rng = np.random.default_rng(seed)
    rotation, place = Rotation.random(random_state=seed), rng.normal(size=3)
    z, q = rotation.as_matrix()[:, 2], [0.0, 0.2, 0.3]
    frame = (*rotation.as_matrix().T.ravel().tolist(), *place.tolist())
    masses = rng.uniform(1.0, 9.0, 4)
    centres = rng.normal(size=(4, 2))
    weights = [(m, m * x, m * y) for m, (x, y) in zip(masses, centres, strict=True)]

    def moment(i, about):
        return np.cross([*(centres[i] - about[:2]), 0.0], [0.0, 0.0, -GRAVITY * masses[i]])

    hung = moment(3, place)
    along, length = hung @ z * z, 0.3 + 0.5
    bend = length / 7e3 * (hung - along)
    span, arm_length = 1.1 - 0.3, 0.2 + 0.3 + 0.4
    give = 2.0 / (5e5 * span**2) * moment(2, place - arm_length * z)
    sunk = GRAVITY * masses[2] / (2 * 5e5) * (z[2] * z - [0.0, 0.0, 1.0])
    slides = SlideCompliance((Bearing(2, 5e5, 1.1, 0.2),))
    at = SimpleNamespace(m=math, loads=Loads(weights, []), joints=q)
    for effect, turn, moved in (
        (BoomCouple(2, 0.5, 7e3), bend, np.cross(bend, length / 2 * z)),
        (BoomTorsion(2, 0.5, 9e3), length / 9e3 * along, np.zeros(3)),
        (slides, give, sunk + np.cross(give, arm_length * z)),
    ):
        flexure = effect.flexure(at)
        assert flexure(1, frame) == frame
        found = flexure(2, frame)
        np.testing.assert_allclose(found[9:], place + moved, rtol=0, atol=1e-12)
        expected = (Rotation.from_rotvec(turn) * rotation).as_matrix()
        np.testing.assert_allclose(np.reshape(found[:9], (3, 3)).T, expected, rtol=0, atol=1e-12)


def test_what_hangs_below_the_tip_of_a_level_boom_neither_bends_nor_twists_it():
    """The centre of all that hangs lies under the tip: gravity has no moment about it."""
    q = [0.0, 0.3, 0.5, 0.0, 0.1, 0.0]
    links, _ = behind(q, 0)
    tip, last = links[2], links[5]
    below = tip.position - [0, 0, 0.2]
    load = Load((4.0, 3.0, 2.4, 0.0, 0.0, 2.0), (*LOAD.centre[:5], tuple(last.rotation.T @ (below - last.position))))
    for name in ("boom_couple", "boom_torsion"):
        found, straight = arm(load, **{name: BENT[name]}).tool_pose(q), BARE.tool_pose(q)
        np.testing.assert_allclose(found.position, straight.position, rtol=0, atol=1e-12)
        assert np.abs(arm(**{name: BENT[name]}).tool_pose(q).position - straight.position).max() > 1e-6


@pytest.mark.parametrize("effects", [BENT, {"slide_compliance": SLIDES}], ids=["boom", "slides"])
def test_floats_arrays_and_tensors_agree_and_tensors_have_a_slope(effects):
    plant = arm(**effects)
    q = np.array(Q)
    floats = np.array([plant.tool_frame(math, row) for row in Q])
    arrays = np.stack(np.broadcast_arrays(*plant.tool_frame(np, list(q.T))), -1)
    tensors = torch.tensor(q, requires_grad=True)
    found = torch.stack(plant.tool_frame(torch, tensors.unbind(-1)), -1)
    np.testing.assert_allclose(arrays, floats, rtol=0, atol=1e-15)
    np.testing.assert_allclose(found.detach().numpy(), floats, rtol=0, atol=1e-14)
    (slope,) = torch.autograd.grad(found[:, 9:].sum(), tensors)
    for joint in range(6):
        step = 1e-6 * np.eye(6)[joint]
        ends = [np.stack(plant.tool_frame(np, list((q + s * step).T))[9:]).sum(0) for s in (1, -1)]
        np.testing.assert_allclose(slope[:, joint], (ends[0] - ends[1]) / 2e-6, rtol=0, atol=1e-7)


def test_arms_have_bearings_of_their_own_and_one_tube_each():
    plant = arm(**BENT, slide_compliance=SLIDES)
    medium = load_tolerances("medium")
    arms = draw_plants(plant, medium, 400, np.random.default_rng(3))
    logs = np.log(
        [
            each.stiffness / own.stiffness
            for each, own in zip(arms.effect("slide_compliance").bearings, SLIDES.bearings, strict=True)
        ]
    )
    np.testing.assert_allclose(logs.std(axis=1), medium.spread.joint_stiffness, rtol=0.12)
    assert np.abs(np.corrcoef(logs)[np.triu_indices(3, 1)]).max() < 0.2
    one = plant_at(arms, 7)
    factor = one.effect("boom_bending").flexural_rigidity / EI
    assert factor != 1.0
    assert one.effect("boom_couple").flexural_rigidity / EI == pytest.approx(factor)
    assert one.effect("boom_torsion").torsional_rigidity / GJ == pytest.approx(factor)
