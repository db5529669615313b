"""Parametric terms: their derivatives, and that least squares finds the plant's own coefficients."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Pose, forward, joint_jacobian, load_arm, load_plant, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import (
    ArmModel,
    ComplianceTerm,
    Conditions,
    GravityTerm,
    Measurements,
    PeriodicTerm,
    ThermalTerm,
    identify,
    link_model,
    random_joints,
    simulated_tracker,
    with_terms,
)
from pickenv.calibration.model.terms import specification, term_from
from tests.calibration.loads import LoadedCompliance

ALL = tuple(range(6))


@pytest.fixture(scope="module")
def plant():
    """Without what no term says: a boom that bends, and leads."""
    plant = load_plant("qiao2026").without("boom_bending")
    return plant.with_effect(replace(plant.effect("transmission_error"), lead=(0.0,) * 6))


def drive_waves(plant):
    """The plant's own harmonics."""
    harmonics = plant.effect("transmission_error").harmonics
    return PeriodicTerm(tuple(h.joint for h in harmonics), tuple(2 * np.pi / h.period for h in harmonics))


def all_terms(plant):
    return LoadedCompliance(ALL, load=plant.load), drive_waves(plant)


def conditions(count, rng):
    return Conditions(rng.uniform(0, 1, count), rng.uniform(-10, 25, count), None)


def test_a_models_jacobian_is_its_poses_difference(plant):
    rng = np.random.default_rng(0)
    weight = GravityTerm(ALL, (0.0, 0.0, 1.0), payload=True)
    arm = ArmModel.of(plant.arm.nominal, (*all_terms(plant), ThermalTerm(), weight))
    joints, given = random_joints(arm.geometry, 7, rng), conditions(7, rng)
    jacobian = arm.jacobian(joints, given)
    count = len(arm.geometry.parameter_names)
    for k in range(count, len(arm.parameter_names)):
        delta = np.zeros(len(arm.parameter_names))
        delta[k] = 1e-6 if "thermal" not in arm.parameter_names[k] else 1e-8
        moved = arm.displaced(delta)
        change = (moved.pose(joints, given).position - arm.pose(joints, given).position) / delta[k]
        scale = np.abs(jacobian[:, :3, k]).max() + 1e-9
        np.testing.assert_allclose(change, jacobian[:, :3, k], atol=1e-5 * scale, err_msg=arm.parameter_names[k])
    np.testing.assert_allclose(arm.difference(moved), delta, atol=1e-15)


@pytest.mark.parametrize("effect", ["joint_compliance", "transmission_error"])
def test_each_term_is_the_plants_effect_to_first_order(plant, effect):
    """At the plant's own coefficients a term moves the tool as the plant does, to second order."""
    off = [name for name in ("joint_compliance", "transmission_error") if name != effect]
    only = replace(plant.without([*off, "measurement_noise"]), geometry=plant.arm.nominal)
    joints = random_joints(plant.arm.nominal, 300, np.random.default_rng(1))
    terms, coefficients = truth(plant)[effect]
    arm = ArmModel(plant.arm.nominal, terms, np.array(coefficients))
    true, model, bare = only.tool_pose(joints), arm.pose(joints), forward(plant.arm.nominal, joints)
    moved = np.linalg.norm(true.position - bare.position, axis=1)
    left = np.linalg.norm(true.position - model.position, axis=1)
    assert moved.mean() > 5e-5
    assert left.max() < 5e-3 * moved.max() + 1e-7


def truth(plant):
    """Terms and coefficients of the plant's own effects."""
    drive, stiffness = plant.effect("transmission_error"), plant.effect("joint_compliance").stiffness
    waves = drive_waves(plant)
    phases = [v for h in drive.harmonics for v in (h.amplitude * np.cos(h.phase), h.amplitude * np.sin(h.phase))]
    return {
        "joint_compliance": ((LoadedCompliance(tuple(range(6)), load=plant.load),), [1 / k for k in stiffness]),
        "transmission_error": ((waves,), phases),
    }


def test_the_plants_terms_leave_only_noise(plant, exact):
    """200 noisy poses: geometry and terms predict the noise-free plant to micrometres; geometry alone does not.

    The target is mounted truly: where its centre lies no pose tells apart from the tool.
    """
    rng = np.random.default_rng(0)
    centred = plant.with_effect(replace(plant.effect("measurement_noise"), centring_std=0.0))
    data = simulated_tracker(centred, random_joints(plant.arm.nominal, 200, rng), rng)
    arm = ArmModel.of(plant.arm.nominal, all_terms(plant))
    found = identify(with_terms(link_model(plant.arm.nominal), arm), arm, data)
    assert found.converged
    assert found.chi_square / found.degrees_of_freedom == pytest.approx(1.0, abs=0.15)
    joints = random_joints(plant.arm.nominal, 1000, np.random.default_rng(9))
    left = np.linalg.norm(found.arm_model.pose(joints).position - plant.tool_pose(joints).position, axis=1)
    assert left.mean() < 0.03e-3
    bare = identify(link_model(plant.arm.nominal), plant.arm.nominal, data)
    assert (
        np.linalg.norm(bare.arm_model.pose(joints).position - plant.tool_pose(joints).position, axis=1).mean() > 0.3e-3
    )


def test_identified_compliance_is_the_plants(plant):
    """Without noise and without what it cannot be told from, every observable coefficient is the plant's own."""
    rng = np.random.default_rng(2)
    only = plant.without(["transmission_error", "measurement_noise"])
    data = simulated_tracker(only, random_joints(plant.arm.nominal, 200, rng), rng)
    arm = ArmModel.of(plant.arm.nominal, (LoadedCompliance(ALL, load=plant.load),))
    found = identify(with_terms(link_model(plant.arm.nominal), arm), arm, data)
    assert found.converged
    # gravity never loads the rail (it stays level) nor the twist (its axis stays upright and its centre lies on it)
    unloaded = {name for name, absorbed in found.identifiability.dropped.items() if not absorbed}
    assert unloaded == {"compliance2", "compliance6"}
    for i in (0, 2, 3, 4):
        assert found.arm_model.coefficients[i] == pytest.approx(
            1 / plant.effect("joint_compliance").stiffness[i], rel=0.02
        )


def test_unknown_masses_and_stiffnesses_are_no_obstacle(plant):
    """The weight's own shape is enough: compliance is predicted without one mass or stiffness, on a tilted base too."""
    rng = np.random.default_rng(2)
    only = plant.without(["transmission_error", "measurement_noise"])
    data = simulated_tracker(only, random_joints(plant.arm.nominal, 200, rng), rng)
    start = ArmModel.of(plant.arm.nominal, (GravityTerm(ALL, (0.0, 0.0, 1.0)),))
    found = identify(with_terms(link_model(plant.arm.nominal), start), start, data)
    held = random_joints(plant.arm.nominal, 500, rng)
    left = np.linalg.norm(found.arm_model.pose(held).position - only.tool_pose(held).position, axis=1)
    assert found.converged and left.mean() < 5e-6

    turn = rotation_matrix(np.array([0.7, -1.1, 0.4]))  # the tracker's frame: gravity is still against the base's z
    seen = replace(data, position=data.position @ turn.T, rotation=turn @ data.rotation)
    there = replace(plant.arm.nominal, base=Pose(np.zeros(3), turn))
    again = identify(
        with_terms(link_model(there), ArmModel.of(there, start.terms)), ArmModel.of(there, start.terms), seen
    )
    assert again.chi_square == pytest.approx(found.chi_square, rel=1e-3)


def test_drive_errors_and_thermal_growth_are_found_without_noise(plant):
    nominal, rng = plant.arm.nominal, np.random.default_rng(4)
    waves = drive_waves(plant)
    terms = (waves, ThermalTerm())
    true = np.append(rng.normal(size=12) * 3e-4, 23e-6)
    arm = ArmModel(plant.geometry, terms, true)
    joints, given = random_joints(nominal, 200, rng), conditions(200, rng)
    data = Measurements(joints, *arm.pose(joints, given), prismatic=nominal.prismatic, conditions=given)
    start = ArmModel.of(nominal, terms)
    found = identify(with_terms(link_model(nominal), start), start, data)
    assert found.converged and found.chi_square < 1e-3 * found.degrees_of_freedom  # 0.5 um: rank decides to 1e-3
    assert found.arm_model.coefficients[-1] == pytest.approx(23e-6, rel=1e-4)
    np.testing.assert_allclose(found.arm_model.coefficients[:3], true[:3], atol=1e-5)


def test_measured_torques_are_taken_instead_of_gravitys(plant):
    nominal, rng = plant.arm.nominal, np.random.default_rng(5)
    joints = random_joints(nominal, 100, rng)
    given = Conditions(torque=rng.normal(size=(100, 6)) * 20)
    true = np.array([1e-4, 5e-5])
    arm = ArmModel(plant.geometry, (ComplianceTerm((0, 3)),), true)
    data = Measurements(joints, *arm.pose(joints, given), prismatic=nominal.prismatic, conditions=given)
    start = ArmModel.of(nominal, arm.terms)
    found = identify(with_terms(link_model(nominal), start), start, data)
    np.testing.assert_allclose(found.arm_model.coefficients, true, rtol=1e-4)
    with pytest.raises(InputError, match="needs measured torques"):
        start.pose(joints)


def test_recorded_payloads_scale_gravitys_torque(plant):
    """The payload as a condition: an arm calibrated at several payloads predicts another one."""
    nominal, rng = plant.arm.nominal, np.random.default_rng(6)
    loads = [
        replace(plant, load=replace(plant.load, payload=p)).without(["measurement_noise"]) for p in (0.0, 1.0, 2.0)
    ]
    parts = [simulated_tracker(p, random_joints(nominal, 70, rng), rng) for p in loads]
    joints = np.concatenate([p.joints for p in parts])
    given = Conditions(payload=np.repeat([0.0, 1.0, 2.0], 70))
    data = Measurements(
        joints,
        np.concatenate([p.position for p in parts]),
        np.concatenate([p.rotation for p in parts]),
        nominal.prismatic,
        conditions=given,
    )
    start = ArmModel.of(nominal, all_terms(plant))
    found = identify(with_terms(link_model(nominal), start), start, data)
    held = random_joints(nominal, 300, rng)
    third = replace(plant, load=replace(plant.load, payload=1.5)).tool_pose(held)
    predicted = found.arm_model.pose(held, Conditions(payload=np.full(300, 1.5)))
    assert np.linalg.norm(predicted.position - third.position, axis=1).mean() < 5e-5


def test_thermal_growth_needs_a_temperature(plant):
    with pytest.raises(InputError, match="give a temperature column"):
        ArmModel.of(plant.arm.nominal, (ThermalTerm(),)).pose(np.zeros((1, 6)))


def test_terms_survive_a_file(plant):
    for term in (
        drive_waves(plant),
        ThermalTerm(),
        ComplianceTerm((0,)),
        ComplianceTerm((3,), GravityTerm((3,), (0.0, 0.0, 1.0)), (1.0, -2.0)),
        GravityTerm((0, 3), (0.0, 0.0, 1.0), True),
        PeriodicTerm((0, 0, 3), (1.0, 13.37, 2.5), (0.1, 0.02, 0.3)),
    ):
        again = term_from(json.loads(json.dumps(specification(term))))
        assert again == term
        assert again.names(plant.arm.nominal) == term.names(plant.arm.nominal)


def test_several_harmonics_of_several_joints_are_those_of_one_term_each(plant):
    geometry, rng = plant.arm.nominal, np.random.default_rng(8)
    pairs = [(0, 13.5), (3, 1.0), (0, 2.25)]
    joints = random_joints(geometry, 5, rng)
    whole = PeriodicTerm(*(tuple(part) for part in zip(*pairs, strict=True)))
    columns = whole.columns(geometry, joints, Conditions())
    assert columns.shape == (5, 6, 6) and len(set(whole.names(geometry))) == 6
    jacobian = joint_jacobian(geometry, joints)
    for i, (joint, order) in enumerate(pairs):
        angle = order * joints[:, joint]
        for k, wave in enumerate((np.sin(angle), np.cos(angle))):
            np.testing.assert_allclose(columns[..., 2 * i + k], jacobian[..., joint] * wave[:, None], atol=1e-15)


def test_a_coefficients_tolerance_falls_with_the_order_of_a_revolute_joint_only(plant):
    geometry = plant.arm.nominal
    turning, sliding = geometry.prismatic.index(False), geometry.prismatic.index(True)
    found = PeriodicTerm((turning, turning, sliding), (1.0, 20.0, 700.0)).tolerances(geometry)
    np.testing.assert_allclose(found, np.repeat([3e-3, 1.5e-4, 1e-3], 2))


def test_moments_fitted_to_torques_tell_them_at_other_poses():
    """Each joint's own torques, of a mounting that is not upright; joint 1 is not asked for."""
    geometry, rng = load_arm("ur5").nominal, np.random.default_rng(4)
    weight = GravityTerm((1, 2, 4), (0.36, 0.48, 0.8))
    joints = random_joints(geometry, 200, rng)
    columns, owners = weight.torques(geometry, joints, Conditions()), weight.owners(geometry)
    moments, torque = rng.normal(size=len(owners)), rng.normal(size=(200, 6))
    for i in weight.joints:
        torque[:, i] = columns[:, owners == i] @ moments[owners == i]
    seen = Conditions(torque=torque[:100])
    term = weight.weighed(geometry, joints[:100], seen)
    found = term.torques(geometry, joints[100:], Conditions())
    np.testing.assert_allclose(found[:, [1, 2, 4]], torque[100:, [1, 2, 4]], rtol=1e-6, atol=1e-6)
