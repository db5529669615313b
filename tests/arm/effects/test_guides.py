"""What yields where an arm slides: finite elements and MuJoCo's equilibrium referee couple, twist and bearings."""

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pickenv.arm import (
    Load,
    Pose,
    chain_of,
    draw_plants,
    frames,
    load_plant,
    load_tolerances,
    plant_at,
    pose_of,
    rotation_matrix,
)
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
SLIDES = SlideCompliance(
    (Bearing(1, 2e7, 0.2, 0.15), Bearing(2, 1e7, 1.2, 0.06, 0.4), Bearing(4, 3e6, 0.3, 0.06, 0.05))
)
Q = [
    [0.1, 0.3, 0.7, 0.4, 0.1, 0.5],
    [-0.4, 0.1, 0.0, -1.2, 0.0, -2.0],
    [0.7, 0.6, 0.8, 1.2, 0.2, 3.0],
]


def arm(load=LOAD, bare=BARE, **effects):
    return replace(bare, load=load, effects=tuple(effects.values()))


def stood(seed):
    """The arm on a base of any attitude, so that no boom and no slide is level."""
    base = BARE.geometry.base
    turned = Pose(base.position, Rotation.random(random_state=seed).as_matrix() @ base.rotation)
    return replace(BARE, geometry=replace(BARE.geometry, base=turned))


def behind(q, joint, bare=BARE):
    """Links of the straight arm as poses, and the masses behind a joint with their places in the world."""
    links = [pose_of(frame) for frame in frames(np, chain_of(bare.geometry), q)[1:]]
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


@pytest.mark.parametrize("bare", [BARE, *map(stood, range(4))], ids=["upright", *"abcd"])
@pytest.mark.parametrize("q", Q)
def test_bending_couple_and_twist_are_those_of_a_beam_of_finite_elements(q, bare):
    links, masses = behind(q, 3, bare)
    straight, tip = links[-1], links[2]
    down = tip.rotation.T @ np.array([0, 0, -GRAVITY])
    hung = sum(mass for mass, _ in masses)
    moment = sum(np.cross(tip.rotation.T @ (point - tip.position), mass * down) for mass, point in masses)
    across = down * [1, 1, 0]
    moved, turned = beam(OUT + q[2], hung * across, moment, DENSITY * across)
    turn = tip.rotation @ rotation_matrix(turned) @ tip.rotation.T
    expected = tip.position + tip.rotation @ moved + turn @ (straight.position - tip.position)
    load, bending = LOAD, replace(BENT["boom_bending"], end_mass=hung - LOAD.payload)
    found = arm(load, bare, **(BENT | {"boom_bending": bending})).tool_pose(q)
    sag = np.linalg.norm(expected - straight.position)
    assert sag > (5e-5 if bare is BARE else 2e-5)  # tilted, less of the weight is across
    np.testing.assert_allclose(found.position, expected, rtol=0, atol=2e-3 * sag)  # small angles, one after the other
    np.testing.assert_allclose(found.rotation, turn @ straight.rotation, rtol=0, atol=2e-6)


def pads_of(bearing, out, rng):
    """Where the four pads of a guide touch its link, from the link's origin, m; to which side of the axis is drawn."""
    span, reach = bearing.span, 0.0
    if bearing.overhang is not None:
        span = bearing.span - out
        reach = bearing.overhang + out + span / 2
    side = rng.uniform(0.0, np.pi)
    across = bearing.width / 2 * np.array([np.cos(side), np.sin(side), 0.0])
    return [[0, 0, -reach + along] + sign * across for along in (-span / 2, span / 2) for sign in (-1, 1)]


def equilibrium(bare, q, slides, rng):
    """Tool of the arm at rest in MuJoCo whose sliding links hang in point springs: every link is rigid.

    A link may shift across its axis and turn in any way; all that holds it are its pads, each half a bearing's spring
    across the axis. MuJoCo is told neither a stiffness against turning nor where a link turns about.
    """
    spec = mujoco.MjSpec()
    spec.option.gravity = [0, 0, -GRAVITY]
    spec.compiler.degree = False
    links, _ = behind(q, 0, bare)
    parent, before, springs, count = spec.worldbody, (np.zeros(3), np.eye(3)), [], 0
    for i, link in enumerate(links):
        place, rotation = before[1].T @ (link.position - before[0]), before[1].T @ link.rotation
        quat = np.zeros(4)
        mujoco.mju_mat2Quat(quat, rotation.ravel())
        body = parent.add_body(name=f"link {i}", pos=place, quat=quat)
        body.mass, body.ipos, body.inertia = LOAD.mass[i], LOAD.centre[i], [0.01, 0.01, 0.01]
        body.explicitinertial = True
        bearing = next((each for each in slides.bearings if each.joint == i), None)
        if bearing is not None:
            for kind, axes in ((mujoco.mjtJoint.mjJNT_SLIDE, np.eye(3)[:2]), (mujoco.mjtJoint.mjJNT_HINGE, np.eye(3))):
                for axis in axes:
                    body.add_joint(type=kind, axis=axis)
            for k, pad in enumerate(pads_of(bearing, q[i], rng)):
                names = f"pad {i} {k}", f"guide {i} {k}"
                body.add_site(name=names[0], pos=pad)
                parent.add_site(name=names[1], pos=place + rotation @ pad)
                springs.append((*names, rotation[:, 2], bearing.stiffness / 2))
            count += 5
        parent, before = body, (link.position, link.rotation)
    held = parent.add_body(name="tool")
    held.mass, held.inertia, held.explicitinertial = LOAD.payload, [1e-9] * 3, True
    model = spec.compile()
    data = mujoco.MjData(model)

    def unbalanced(x):
        data.qpos[:], data.qvel[:] = x, 0
        mujoco.mj_forward(model, data)
        force = -data.qfrc_bias
        for pad, guide, axis, stiffness in springs:
            ends = [model.site(name).id for name in (pad, guide)]
            bodies = [model.site_bodyid[end] for end in ends]
            along = data.xmat[bodies[1]].reshape(3, 3) @ axis
            apart = data.site_xpos[ends[0]] - data.site_xpos[ends[1]]
            push = -stiffness * (apart - along * (along @ apart))
            for end, on, sign in zip(ends, bodies, (1.0, -1.0), strict=True):
                mujoco.mj_applyFT(model, data, sign * push, np.zeros(3), data.site_xpos[end], on, force)
        return force

    for _ in range(50):  # Newton on spring forces against gravity, slopes by differences
        here = data.qpos.copy()
        left = unbalanced(here)
        if np.abs(left).max() < 1e-9:
            break
        slope = np.stack([(unbalanced(here + h) - unbalanced(here - h)) / 2e-6 for h in 1e-6 * np.eye(count)], 1)
        data.qpos[:] = here - np.linalg.solve(slope, left)
    unbalanced(data.qpos.copy())
    tool = model.body("tool").id
    return data.xpos[tool].copy(), data.xmat[tool].reshape(3, 3).copy()


@pytest.mark.slow
def test_slides_rest_where_mujoco_finds_them_in_their_springs():
    """Twenty poses on a base of any attitude, pads anywhere around the axis: within a tenth of a micrometre."""
    rng = np.random.default_rng(19)
    low, high = np.minimum(BARE.geometry.lower, 3.0), np.minimum(BARE.geometry.upper, 3.0)
    sunk, apart, turned = [], [], []
    for k, q in enumerate(rng.uniform(low, high, (20, 6))):
        bare = stood(k)
        position, rotation = equilibrium(bare, q, SLIDES, rng)
        straight, found = bare.tool_pose(q), arm(bare=bare, slide_compliance=SLIDES).tool_pose(q)
        sunk.append(np.linalg.norm(position - straight.position))
        apart.append(np.linalg.norm(found.position - position))
        turned.append(np.abs(found.rotation - rotation).max())
    assert np.mean(sunk) > 3e-5
    assert max(apart) < 1e-7 and max(turned) < 2e-7


def test_bearings_that_come_closer_yield_more_and_those_of_a_carriage_do_not():
    """And about the slide's axis a link yields the same however far its bearings are apart."""
    stiff = replace(LOAD, mass=(0.0,) * 6, payload=1.0)
    q, along = [0.0, 0.3, 0.0, 0.0, 0.1, 0.0], 2
    for overhang, grows in ((0.4, True), (None, False)):
        turns = []
        for q[2] in (0.0, 0.4, 0.8):
            loose = arm(stiff, slide_compliance=SlideCompliance((Bearing(2, 1e7, 1.2, 0.06, overhang),)))
            z = pose_of(frames(np, chain_of(BARE.geometry), q)[3]).rotation[:, along]
            turn = Rotation.from_matrix(loose.tool_pose(q).rotation @ BARE.tool_pose(q).rotation.T).as_rotvec()
            turns.append((np.linalg.norm(turn - turn @ z * z), turn @ z))
        across, about = np.transpose(turns)
        assert (across[2] > 3 * across[0]) == grows
        np.testing.assert_allclose(about, about[0], rtol=1e-6)


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
