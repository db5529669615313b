"""Parametric terms worked out by hand: the work of weights, sizes of tolerances, cantilevers, and moments by name."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import (
    Pose,
    chain_of,
    forward,
    frames,
    joint_jacobian,
    load_arm,
    rotation_matrix,
    split_joints,
)
from pickenv.calibration import (
    ComplianceTerm,
    Conditions,
    GravityTerm,
    ThermalTerm,
    plain_term,
    random_joints,
)


def turned(name):
    """An arm on a tilted base."""
    nominal = load_arm(name).nominal
    return replace(nominal, base=Pose(np.array([0.3, -0.2, 0.5]), rotation_matrix([0.4, -0.3, 0.8])))


@pytest.mark.parametrize("name", ["qiao2026", "ur5", "li2016_slave"])
def test_a_torque_is_what_the_weight_loses_of_its_height(name):
    """Virtual work: of a mass at a link's origin, of a moment along its axes, of the payload at the tool."""
    geometry, rng, step = turned(name), np.random.default_rng(0), 1e-6
    up = np.array([0.36, 0.48, 0.8])
    weight = GravityTerm(tuple(range(geometry.joints)), tuple(up.tolist()), payload=True)
    joints, payload = random_joints(geometry, 5, rng), rng.uniform(0.5, 2.0, 5)
    against = geometry.base.rotation @ up

    def height(q, link, moment):
        if moment == "p":
            return payload * (forward(geometry, q).position @ against)
        found = frames(np, chain_of(geometry), split_joints(geometry.joints, q))[link + 1]
        row = {"x": 0, "y": 3, "z": 6, "m": 9}[moment]
        return sum(part * size for part, size in zip(found[row : row + 3], against, strict=True))

    torques = weight.torques(geometry, joints, Conditions(payload=payload))
    moments = weight.moments(geometry)
    assert torques.shape == (5, len(moments)) and {moment for *_, moment in moments} >= {"m", "p"}
    for k, (joint, link, moment) in enumerate(moments):
        moved = step * (np.arange(geometry.joints) == joint)
        lost = (height(joints - moved, link, moment) - height(joints + moved, link, moment)) / (2 * step)
        np.testing.assert_allclose(torques[:, k], lost, atol=1e-8, err_msg=str((joint, link, moment)))
    columns = weight.columns(geometry, joints, Conditions(payload=payload))
    jacobian = joint_jacobian(geometry, joints)
    for k, (joint, *_) in enumerate(moments):
        np.testing.assert_allclose(columns[..., k], jacobian[..., joint] * torques[:, [k]], atol=1e-12)


def test_moments_are_named_by_joint_and_link_and_the_mass_on_a_joints_own_axis_is_none(qiao):
    """A mass at the origin of the link that turns exerts nothing; a slide feels the mass of its own link alone."""
    ur5 = load_arm("ur5").nominal
    named = GravityTerm((4, 5), (0.0, 0.0, 1.0)).names(ur5)
    parts = ["5_5x", "5_5y", "5_5z", "5_6m", "5_6x", "5_6y", "5_6z", "6_6x", "6_6y", "6_6z"]
    assert named == tuple(f"gravity{part}" for part in parts)
    assert GravityTerm((1, 4), (0.0, 0.0, 1.0)).names(qiao.nominal) == ("gravity2_2m", "gravity5_5m")
    with_payload = GravityTerm((1, 5), (0.0, 0.0, 1.0), True).names(qiao.nominal)
    assert with_payload == tuple(f"gravity{end}" for end in ["2_2m", "2_7p", "6_6x", "6_6y", "6_6z", "6_7p"])


def test_tolerances_are_a_millimetre_or_a_milliradian_of_what_usually_acts(qiao):
    """1 mrad at 10 N*m, 1 mm at 100 N; 1 mm of 1 m at 20 K."""
    geometry = qiao.nominal
    slides = np.array(geometry.prismatic)
    np.testing.assert_allclose(
        ComplianceTerm(tuple(range(6))).tolerances(geometry), np.where(slides, 1e-3 / 100, 1e-3 / 10)
    )
    np.testing.assert_allclose(ThermalTerm().tolerances(geometry) * 20.0, 1e-3)
    weight = GravityTerm((0, 1), (0.0, 0.0, 1.0))
    np.testing.assert_allclose(weight.tolerances(geometry), np.full(len(weight.names(geometry)), 1e-3))


@pytest.mark.parametrize(("payload", "counts"), [(None, False), ([1.2, 1.2, 1.2], False), ([0.0, 0.4, 0.2], True)])
def test_a_recorded_payload_is_a_load_of_its_own_where_it_varies(qiao, exact, payload, counts):
    """By any weight: one that stays is part of the arm's own."""
    data = replace(exact(qiao.true, 3), conditions=Conditions(payload=None if payload is None else np.array(payload)))
    assert plain_term("gravity", qiao, data).payload == counts


def test_up_is_the_worlds_in_the_base_of_an_arm_that_stands_tilted(qiao, exact):
    arm = replace(qiao, nominal=turned("qiao2026"))
    np.testing.assert_allclose(plain_term("gravity", arm, exact(qiao.true, 3)).up, arm.nominal.base.rotation[2])


@pytest.mark.parametrize("name", ["qiao2026", "ur5"])
def test_warmth_lengthens_all_links_and_what_has_slid_out(name):
    geometry, rng = turned(name), np.random.default_rng(0)
    joints, warmth, growth = random_joints(geometry, 6, rng), rng.uniform(-20, 20, 6), 1e-7
    columns = ThermalTerm().columns(geometry, joints, Conditions(temperature=warmth))
    for row in range(6):
        share = 1.0 + growth * warmth[row]
        longer = replace(geometry, a=geometry.a * share, d=geometry.d * share)
        there = forward(longer, joints[row] * np.where(geometry.prismatic, share, 1.0)).position
        moved = (there - forward(geometry, joints[row]).position) / growth
        np.testing.assert_allclose(columns[row, :3, 0], moved, atol=1e-4)


def test_moments_that_the_poses_hardly_show_are_left_at_zero():
    """Poses within a milliradian of one another: by a pseudo-inverse that cuts off at a thousandth, joint by joint."""
    geometry, rng = load_arm("ur5").nominal, np.random.default_rng(0)
    weight = GravityTerm((1, 2), (0.0, 0.0, 1.0))
    joints = 0.5 + 1e-3 * rng.normal(size=(80, 6))
    torque = rng.normal(size=(80, 6))
    moments = np.array(weight.weighed(geometry, joints, Conditions(torque=torque)).moments)
    columns, owners = weight.torques(geometry, joints, Conditions()), weight.owners(geometry)
    for i in (1, 2):
        expected = np.linalg.pinv(columns[:, owners == i], rcond=1e-3) @ torque[:, i]
        np.testing.assert_allclose(moments[owners == i], expected, rtol=1e-6, atol=1e-9)
    assert np.abs(moments).max() < 50 * np.abs(torque).max()
