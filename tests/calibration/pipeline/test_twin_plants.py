"""A calibrated arm as a plant: it is where the calibration says, and its arms lie as far apart as the data allow."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest
import torch

from pickenv.arm import (
    Coupling,
    draw_plants,
    forward,
    it_tolerance,
    load_arm,
    load_plant,
    load_tolerances,
    plant_at,
    plants_on,
    pose_error,
    read_twin,
    write_twin,
)
from pickenv.arm.effects.structure import StickBand
from pickenv.base import InputError, write_container
from pickenv.calibration import (
    Choices,
    ComplianceTerm,
    GravityTerm,
    Measurements,
    PeriodicTerm,
    ThermalTerm,
    calibrate,
    random_joints,
    simulated_tracker,
    twin,
)
from pickenv.calibration.pipeline.calibration import PoseUncertainty
from pickenv.calibration.pipeline.twin import ASSUMED, SMOOTH, repeated_std, scatter_of
from pickenv.calibration.residuals.gaussian_process import feature_process
from tests.calibration.twins import found_by_hand, kernel, learnt_by_hand, process_by_hand

QIAO, UR5 = load_arm("qiao2026"), load_arm("ur5")
MEDIUM = load_tolerances("medium")
TERMS = {
    "none": (),
    "periodic": (PeriodicTerm((0, 3, 3), (1.0, 13.5, 2.0)),),
    "gravity": (GravityTerm((0, 3), (0.0, 0.0, 1.0)),),
    "compliance of measured torques": (
        ComplianceTerm((0, 3), GravityTerm((0, 3), (0.0, 0.0, 1.0)), tuple(np.linspace(1.0, 3.0, 43).tolist())),
    ),
    "several": (GravityTerm((0,), (0.0, 0.0, 1.0)), PeriodicTerm((5,), (3.0,))),
}


def draw(arm, count=40, seed=3):
    return np.random.default_rng(seed).uniform(arm.nominal.lower, arm.nominal.upper, (count, arm.nominal.joints))


def matrices(pose):
    """Homogeneous matrices of poses."""
    found = np.zeros((*pose.position.shape[:-1], 4, 4))
    found[..., :3, :3], found[..., :3, 3], found[..., 3, 3] = pose.rotation, pose.position, 1.0
    return found


def carried(calibration, arm, pose):
    """Poses in the instrument's frame, brought into the arm's own: as they stand to the aligned nominal arm."""
    before = matrices(arm.nominal.base) @ np.linalg.inv(matrices(calibration.nominal.base))
    behind = np.linalg.inv(matrices(calibration.nominal.tool)) @ matrices(arm.nominal.tool)
    return before @ matrices(pose) @ behind


@pytest.mark.parametrize("kind", TERMS)
@pytest.mark.parametrize("fitted", [True, False])
def test_geometry_and_terms_are_those_of_the_calibration(kind, fitted):
    terms = TERMS[kind]
    weighed = [term for term in terms if isinstance(term, ComplianceTerm) and term.weight is not None]
    if weighed:  # as many moments as the weight has
        count = len(weighed[0].weight.moments(QIAO.nominal))
        terms = (replace(weighed[0], moments=tuple(np.linspace(1.0, 3.0, count).tolist())),)
    found = found_by_hand(QIAO, np.random.default_rng(1), terms=terms, fitted=fitted)
    plant, joints = twin(found, QIAO).without(["residual"]), draw(QIAO)
    wanted = carried(found, QIAO, found.model.pose(joints))
    np.testing.assert_allclose(matrices(plant.tool_pose(joints)), wanted, rtol=0, atol=3e-7)
    moved = np.linalg.norm(wanted[:, :3, 3] - forward(QIAO.nominal, joints).position, axis=-1)
    assert moved.mean() > 1e-5  # else it would show nothing
    if kind != "none":
        bare = carried(found, QIAO, forward(found.identified, joints))
        assert np.abs(wanted - bare).max() > 2e-6


@pytest.mark.parametrize(("outputs", "periodic"), [(3, False), (6, False), (3, True)])
def test_the_residual_s_mean_is_the_process_as_near_as_that_is_sure_of_itself(outputs, periodic):
    """To the nanometre it is the mean of the waves, turned into the arm's own axes."""
    rng = np.random.default_rng(2)
    learnt = learnt_by_hand(QIAO, rng, outputs, periodic)
    found = found_by_hand(QIAO, rng, learnt=learnt)
    plant, joints = twin(found, QIAO), draw(QIAO, 200)
    turn = QIAO.nominal.base.rotation @ found.nominal.base.rotation.T
    moved = pose_error(plant.without(["residual"]).tool_pose(joints), plant.tool_pose(joints))[:, :outputs]
    moved = (moved.reshape(200, -1, 3) @ turn).reshape(200, outputs)  # back into the instrument's axes
    frequency, weights, _ = feature_process(learnt.model, SMOOTH, np.random.default_rng(0))
    angle = np.einsum("nf,ofk->onk", learnt.inputs(joints), frequency)
    mean = np.einsum("onk,ok->no", np.concatenate([np.cos(angle), np.sin(angle)], axis=-1), weights)
    mean += learnt.model.output_mean
    np.testing.assert_allclose(moved, mean, rtol=0, atol=2e-9)
    far = np.sqrt(np.mean((moved - learnt.predict(joints)) ** 2, axis=0))
    assert np.all(far < np.sqrt(np.mean(unsure(learnt.model, learnt.inputs(joints)) ** 2, axis=0)))


def unsure(process, there):
    """Standard deviation of a process at new inputs (Rasmussen and Williams eq (2.24))."""
    deviations = []
    for j, (length, size, noise) in enumerate(
        zip(process.length_scales, process.amplitude, process.noise, strict=True)
    ):
        matrix = kernel(process.rows, process.rows, length, size) + noise**2 * np.eye(len(process.rows))
        across = kernel(there, process.rows, length, size)
        variance = size**2 - np.sum(across * np.linalg.solve(matrix, across.T).T, axis=1)
        deviations.append(np.sqrt(np.maximum(variance, 0.0)) * process.output_std[j])
    return np.stack(deviations, axis=-1)


def test_waves_have_the_posterior_of_the_process():
    """Mean and covariance at new inputs against the textbook's formulas (Rasmussen and Williams eqs (2.23)-(2.24))."""
    rng = np.random.default_rng(4)
    rows, there = rng.standard_normal((50, 2)), rng.standard_normal((30, 2))
    process = process_by_hand(rows, rng)
    frequency, weights, factor = feature_process(process, 512, np.random.default_rng(0))
    for j in range(3):
        angle = there @ frequency[j]
        feature = np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
        length, size, noise = process.length_scales[j], process.amplitude[j], process.noise[j]
        matrix = kernel(rows, rows, length, size) + noise**2 * np.eye(50)
        across = kernel(there, rows, length, size)
        target = matrix @ process.weights[j]
        mean = across @ np.linalg.solve(matrix, target) * process.output_std[j]
        covariance = kernel(there, there, length, size) - across @ np.linalg.solve(matrix, across.T)
        plain = 1.0 / np.sqrt(512)  # what waves drawn without any care would leave
        np.testing.assert_allclose(feature @ weights[j], mean, rtol=0, atol=plain * process.output_std[j])
        drawn = feature @ factor[j] / process.output_std[j]
        np.testing.assert_allclose(drawn @ drawn.T, covariance, rtol=0, atol=plain * size**2)


def spread(arms, joints, count):
    """Tool positions of every arm of a batch ``(count, poses, 3)``."""
    return np.array([plant_at(arms, i).tool_pose(joints).position for i in range(count)])


def test_drawn_geometries_have_the_covariance_that_was_found():
    rng = np.random.default_rng(5)
    names = ("base_x", "base_rz", "a2", "theta3", "alpha3", "tool_y")
    root = rng.standard_normal((6, 6)) * 2e-5
    found = found_by_hand(QIAO, rng, parameters=names, covariance=root @ root.T)
    joints, count = draw(QIAO, 6), 1500
    arms = draw_plants(twin(found, QIAO).without(["residual"]), MEDIUM, count, np.random.default_rng(0))
    positions = spread(arms, joints, count)
    covariance = PoseUncertainty(names, root @ root.T, 0.0, 0.0).pose_covariance(found.model, joints)[:, :3, :3]
    turn = QIAO.nominal.base.rotation @ found.nominal.base.rotation.T
    for seen, wanted in zip(np.moveaxis(positions, 1, 0), covariance, strict=True):
        wanted = turn @ wanted @ turn.T
        scale = np.sqrt(np.outer(np.diag(wanted), np.diag(wanted)))
        # the tool is carried along by up to 2 cm, so that angles weigh a little more or less than at the measured point
        np.testing.assert_allclose(np.cov(seen.T) / scale, wanted / scale, rtol=0, atol=0.25)


def test_what_was_not_identified_is_drawn_without_moving_what_was_measured():
    data = simulated_tracker(load_plant("geometry_only"), draw(QIAO, 40), np.random.default_rng(0))
    result = calibrate(QIAO, data, choices=Choices(terms="none", residual="none", fit="full"))
    lost = set(result.calibration.record["dropped"])
    assert lost
    plant = result.plant().without(["residual"])
    known = replace(plant.posterior, factor=np.zeros_like(plant.posterior.factor))
    arms = draw_plants(replace(plant, posterior=known), MEDIUM, 200, np.random.default_rng(1))
    for name in sorted(lost):
        parameter, place = re.fullmatch(r"([a-z]+)(\d+)", name).groups()
        values = getattr(arms.geometry, parameter)[:, int(place) - (parameter in ("theta", "d"))]
        half = MEDIUM.angle
        if parameter in ("a", "d"):
            nominal = abs(getattr(QIAO.nominal, parameter)[int(place) - (parameter == "d")])
            half = float(it_tolerance(MEDIUM.it_grade, max(nominal, MEDIUM.least_length))) / 2.0
        far = np.abs(values - getattr(plant.geometry, parameter)[int(place) - (parameter in ("theta", "d"))])
        assert 0.9 * half < far.max() <= half
    seen = spread(arms, data.joints, 20)
    assert np.abs(seen - plant.tool_pose(data.joints).position).max() < 3e-6


@pytest.mark.slow
def test_with_priors_what_rows_do_not_tell_is_drawn_as_wide_as_was_expected():
    """Nothing is dropped then: the posterior is as wide as the prior there, and moves nothing that was measured."""
    data = simulated_tracker(load_plant("geometry_only"), draw(QIAO, 40), np.random.default_rng(0))
    result = calibrate(QIAO, data, choices=Choices(terms="none", residual="none"))
    found = result.fit.identification
    assert not result.calibration.record["dropped"]
    arms = draw_plants(result.plant().without(["residual"]), MEDIUM, 400, np.random.default_rng(1))
    known = dict(
        zip(found.identifiability.names, zip(found.standard_deviation, found.narrowed, strict=True), strict=True)
    )
    links = [re.fullmatch(r"(alpha|a|d|theta)(\d+)", name) for name in known]
    for parameter, place in (link.groups() for link in links if link is not None):
        std, _ = known[parameter + place]
        values = getattr(arms.geometry, parameter)[:, int(place) - (parameter in ("theta", "d"))]
        assert values.std() == pytest.approx(std, rel=0.15)
    assert all(known[name][1] < 0.02 for name in ("theta2", "theta5")) and known["d2"][0] > 4e-4
    seen = spread(arms, data.joints, 20)
    assert np.abs(seen - result.plant().without(["residual"]).tool_pose(data.joints).position).max() < 4e-5


def test_positions_alone_leave_the_tools_attitude_where_it_stands():
    """Rows of a target's positions do not know how the tool is turned; no drawn arm may turn it about."""
    poses = simulated_tracker(load_plant("coarse:ur5"), draw(UR5, 60), np.random.default_rng(0))
    data = Measurements(poses.joints, poses.position + np.array([0.2, -0.1, 0.4]), None, UR5.nominal.prismatic)
    plant = calibrate(UR5, data, choices=Choices(terms="none", residual="none")).plant()
    arms = draw_plants(plant, MEDIUM, 20, np.random.default_rng(1))
    joints = draw(UR5, 50, seed=4)
    off = np.array([pose_error(forward(UR5.nominal, joints), plant_at(arms, i).tool_pose(joints)) for i in range(20)])
    best = pose_error(forward(UR5.nominal, joints), plant.tool_pose(joints))
    turned, wanted = (np.degrees(np.linalg.norm(error[..., 3:], axis=-1)) for error in (off, best))
    assert turned.max() < wanted.max() + 1.0
    assert "the rows say nothing of tool_rx, tool_ry, tool_rz" in " ".join(plant.posterior.notes)
    assert plant.name == "ur5_twin"


def test_arm_i_does_not_depend_on_how_many_are_drawn_nor_on_what_is_off():
    rng = np.random.default_rng(6)
    plant = twin(found_by_hand(QIAO, rng, learnt=learnt_by_hand(QIAO, rng), terms=TERMS["several"]), QIAO)
    joints = draw(QIAO, 5)
    few, many = (draw_plants(plant, MEDIUM, count, np.random.default_rng(0)) for count in (3, 9))
    bare = draw_plants(plant.without(["residual", "boom_bending"]), MEDIUM, 3, np.random.default_rng(0))
    for i in range(3):
        one, same = plant_at(few, i), plant_at(many, i)
        np.testing.assert_array_equal(one.tool_pose(joints).position, same.tool_pose(joints).position)
        np.testing.assert_array_equal(one.geometry.theta, plant_at(bare, i).geometry.theta)
    assert "residual" not in bare.names and "boom_bending" not in bare.names and "gravity_yield" in bare.names
    with pytest.raises(InputError, match="already a batch"):
        draw_plants(few, MEDIUM, 2, rng)


def test_arms_scatter_from_pose_to_pose_by_what_no_smooth_function_tells():
    """Neither learnt nor rows: all that held-out errors show beyond the instrument is the arm's own scatter."""
    found = found_by_hand(QIAO, np.random.default_rng(7), parameters=("a2",), covariance=np.zeros((1, 1)))
    plant, joints = twin(found, QIAO), draw(QIAO, 300)
    arms, count = draw_plants(plant, MEDIUM, 30, np.random.default_rng(0)), 30
    bare = draw_plants(plant.without(["residual"]), MEDIUM, 30, np.random.default_rng(0))
    moved = spread(arms, joints, count) - spread(bare, joints, count)
    own = np.sqrt((3e-5) ** 2 - (15e-6) ** 2)  # what is left of 0.03 mm when an assumed tracker's 0.015 mm is taken off
    assert moved.std() == pytest.approx(own, rel=0.05)
    again = plant_at(arms, 0).tool_pose(joints).position
    np.testing.assert_array_equal(again, plant_at(arms, 0).tool_pose(joints).position)
    near = plant_at(arms, 0).tool_pose(joints + 0.05).position - plant_at(bare, 0).tool_pose(joints + 0.05).position
    assert abs(np.corrcoef(near.ravel(), moved[0].ravel())[0, 1]) < 0.25


def rows_with_repeats(std, position_std, repeats=4, poses=50):
    rng = np.random.default_rng(8)
    joints = np.repeat(draw(QIAO, poses), repeats, axis=0)
    position = forward(QIAO.nominal, joints).position + rng.normal(0.0, std, (len(joints), 3))
    return Measurements(joints, position, None, QIAO.nominal.prismatic, position_std=position_std, std_stated=True)


def test_repeats_say_what_is_the_instrument_s():
    assert repeated_std(rows_with_repeats(2e-5, 1e-5)) == pytest.approx(2e-5, rel=0.1)
    assert repeated_std(rows_with_repeats(2e-5, 1e-5, repeats=1)) is None
    worse, better = scatter_of(rows_with_repeats(2e-5, 1e-5)), scatter_of(rows_with_repeats(5e-6, 1e-5))
    assert worse[0] == 1e-5 and "repeats scatter by 0.02" in worse[2]
    assert better[0] == pytest.approx(5e-6, rel=0.1) and better[2].startswith("repeats")
    assert "no repeats" in scatter_of(rows_with_repeats(2e-5, 1e-5, repeats=1))[2]
    assert scatter_of(rows_with_repeats(5e-6, 1e-5, repeats=1), repeat=3e-6 * math.sqrt(3))[0] == 3e-6


def test_an_instrument_said_worse_than_the_rows_scatter_has_no_more_than_they_have():
    """Rows of 0.02 mm from an instrument that is said to have 1 mm; the process may take some of it for smooth."""
    rows = rows_with_repeats(2e-5, 1e-3, repeats=1, poses=100)  # none repeated: only the model's rest tells it
    result = calibrate(QIAO, rows, choices=Choices(terms="none", residual="none"))
    plant = result.plant()
    assert 0.0 < plant.effect("measurement_noise").position_std < 2.2e-5
    assert plant.effect("measurement_noise").attitude_std == rows.attitude_std
    assert any("scatter less than 1.0000 mm" in note for note in plant.posterior.notes)


def plant_by_hand():
    rng = np.random.default_rng(9)
    names = ("base_x", "base_ry", "a2", "theta3", "tool_y")
    found = found_by_hand(
        QIAO, rng, terms=TERMS["several"], learnt=learnt_by_hand(QIAO, rng, 6), parameters=names,
        covariance=np.diag([1e-5] * 5) ** 2, dropped={"theta1": {"base_x": 0.3}},
    )  # fmt: skip
    return twin(found, QIAO)


def test_one_arm_alone_is_the_same_on_floats_arrays_and_tensors():
    plant, joints = plant_by_hand(), draw(QIAO, 12)
    arms = draw_plants(plant, MEDIUM, 12, np.random.default_rng(0))
    together = np.stack(np.broadcast_arrays(*arms.tool_frame(np, list(joints.T))))
    tensors = plants_on(arms, torch.as_tensor).tool_frame(torch, torch.from_numpy(joints.copy()).unbind(-1))
    np.testing.assert_allclose(torch.stack(tuple(tensors)).numpy(), together, rtol=0, atol=2e-9)
    for i in range(12):
        alone = plant_at(arms, i).tool_frame(math, joints[i].tolist())
        assert all(isinstance(value, float) for value in alone)
        np.testing.assert_allclose(alone, together[:, i], rtol=0, atol=1e-12)
    some = plants_on(arms, lambda values: values[[7, 2]]).tool_frame(np, list(joints[[7, 2]].T))
    np.testing.assert_array_equal(np.stack(np.broadcast_arrays(*some)), together[:, [7, 2]])
    fixed = np.stack(plant.tool_frame(np, list(joints.T)))
    one = torch.stack(tuple(plant.tool_frame(torch, torch.from_numpy(joints.copy()).unbind(-1))))
    np.testing.assert_allclose(one.numpy(), fixed, rtol=0, atol=2e-9)


def test_a_file_gives_the_plant_back_to_the_bit(tmp_path):
    plant, joints = plant_by_hand(), draw(QIAO, 20)
    back = load_plant(write_twin(plant, tmp_path / "arm.npz"))
    np.testing.assert_array_equal(back.tool_pose(joints).position, plant.tool_pose(joints).position)
    one, other = (draw_plants(each, MEDIUM, 3, np.random.default_rng(1)) for each in (plant, back))
    np.testing.assert_array_equal(one.tool_pose(joints[:3]).position, other.tool_pose(joints[:3]).position)
    assert back.posterior.notes == plant.posterior.notes and back.arm.fingerprint() == QIAO.fingerprint()
    assert load_plant(tmp_path / "arm.npz", without=["residual"]).effect("residual") is None
    with pytest.raises(InputError, match="unknown effect 'wind'"):
        load_plant(tmp_path / "arm.npz", without=["wind"])


def test_files_that_are_no_twin_are_refused_in_a_sentence(tmp_path):
    found = found_by_hand(QIAO, np.random.default_rng(0))
    with pytest.raises(InputError, match=r"holds a calibration, not a twin; run `pickenv twin`"):
        read_twin(found.save(tmp_path / "calibration.npz"))
    path = write_twin(plant_by_hand(), tmp_path / "arm.npz")
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    (tmp_path / "damaged.npz").write_bytes(content)
    with pytest.raises(InputError, match="seal does not hold"):
        read_twin(tmp_path / "damaged.npz")
    with pytest.raises(InputError, match="does not exist"):
        load_plant(tmp_path / "nothing.npz")
    with pytest.raises(InputError, match="was not made of a calibration"):
        write_twin(load_plant("qiao2026"), tmp_path / "preset.npz")
    with pytest.raises(InputError, match=r"has the effects .*, its calibration found .*; write it as it was made"):
        write_twin(plant_by_hand().without("measurement_noise").with_effect(StickBand((), ())), tmp_path / "arm.npz")
    write_container(tmp_path / "empty.npz", "twin", {}, {})
    with pytest.raises(InputError, match=r"not a twin file or is damaged \('joint_names' is missing\)"):
        read_twin(tmp_path / "empty.npz")


def test_what_cannot_become_a_plant_is_refused_in_a_sentence():
    rng = np.random.default_rng(10)
    found = found_by_hand(QIAO, rng)
    with pytest.raises(InputError, match="belongs to arm 'qiao2026' with another geometry than 'ur5'"):
        twin(found, UR5)
    network = replace(learnt_by_hand(QIAO, rng), kind="bpnn", model=object())
    with pytest.raises(InputError, match=r"'bpnn' of the calibration does not know how sure it is; .*`rows`"):
        twin(replace(found, learnt=network), QIAO)
    with pytest.raises(InputError, match="how surely its parameters are known"):
        twin(replace(found, record={}), QIAO)
    tied = Coupling((0, 1, 2, 3, 4, 5), (1.0, 1.0, 1.0, 1.0, 1.0, 2.0), QIAO.nominal.prismatic)
    coupled = replace(QIAO, nominal=replace(QIAO.nominal, coupling=tied), true=None)
    with pytest.raises(InputError, match="moves several links"):
        twin(found_by_hand(coupled, rng, fitted=False), coupled)
    torques = found_by_hand(QIAO, rng, terms=(ComplianceTerm((0,)),))
    with pytest.raises(InputError, match="needs measured torques"):
        twin(torques, QIAO)


def test_what_stays_out_is_said():
    plant = twin(found_by_hand(QIAO, np.random.default_rng(11), terms=(ThermalTerm(),)), QIAO)
    assert any("reference temperature" in note for note in plant.posterior.notes)
    assert any("base and tool were fitted" in note for note in plant.posterior.notes)
    told = twin(found_by_hand(QIAO, np.random.default_rng(11), fitted=False), QIAO).posterior.notes
    assert not any("base and tool" in note for note in told) and any(ASSUMED[2] in note for note in told)


@pytest.mark.slow
def test_a_result_makes_its_plant_and_its_arms():
    rng = np.random.default_rng(12)
    data = simulated_tracker(load_plant("qiao2026"), random_joints(QIAO.nominal, 60, rng), rng)
    result = calibrate(QIAO, data, choices=Choices(terms="none", residual="none"))
    plant, joints = result.plant(), result.test.joints
    left = np.sqrt(np.mean(np.sum((result.test.position - plant.tool_pose(joints).position) ** 2, axis=1)))
    assert left < result.best.rms * 1e-3  # a process on what remains of the rows takes part, though none was learnt
    arms = result.sample(4, seed=0)
    again = draw_plants(plant, MEDIUM, 4, np.random.default_rng(0))
    np.testing.assert_array_equal(arms.geometry.a, again.geometry.a)
    assert result.calibration.record["scatter"]["position_std"] == plant.effect("measurement_noise").position_std
