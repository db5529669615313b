"""Other programs get the same arm and the same residual: TOML and URDF by kinematics, ONNX by its own run time."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import pickenv
from pickenv.arm import Pose, forward, load_arm, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import (
    ArmModel,
    BpnnSettings,
    Calibration,
    Conditions,
    ThermalTerm,
    export,
    fit,
    fit_residual,
    provenance,
    random_joints,
    simulated_tracker,
    train_bpnn,
)


@pytest.fixture(scope="module")
def calibration(dynamic) -> Calibration:
    rng = np.random.default_rng(0)
    sets = [simulated_tracker(dynamic, random_joints(dynamic.arm.nominal, n, rng), rng) for n in (60, 64)]
    return fit(dynamic.arm, *sets, known_frames=True, rng=rng, settings=BpnnSettings(epochs=15)).calibration


def same_kinematics(a, b, joints, atol):
    for mine, theirs in zip(forward(a, joints), forward(b, joints), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=atol)


@given(seed=st.integers(0, 2**32 - 1), arm=st.sampled_from(["qiao2026", "ur5", "wam"]))
@settings(max_examples=15, deadline=None)
def test_any_corrected_arm_is_read_back_from_toml_and_urdf(tmp_path_factory, calibration, seed, arm):
    folder, rng, chosen = tmp_path_factory.mktemp("arms"), np.random.default_rng(seed), load_arm(arm)
    geometry = replace(
        chosen.nominal,
        alpha=chosen.nominal.alpha + rng.normal(size=chosen.nominal.joints) * 1e-3,
        theta=chosen.nominal.theta + rng.normal(size=chosen.nominal.joints) * 1e-3,
        base=Pose(rng.normal(size=3), rotation_matrix(rng.normal(size=3))),
        tool=Pose(rng.normal(size=3) * 0.1, rotation_matrix(rng.normal(size=3))),
    )
    odd = {**calibration.record, "source": 'C:\\data\\"odd" --- name\n.csv'}
    moved = replace(calibration, arm=chosen.nominal, model=ArmModel.of(geometry), learnt=None, record=odd)
    again = load_arm(export(moved, folder / "arm.toml", arm=chosen).path)
    joints = random_joints(geometry, 20, rng)
    same_kinematics(again.nominal, geometry, joints, 1e-12)
    np.testing.assert_allclose(again.nominal.lower, geometry.lower, atol=1e-12)
    np.testing.assert_allclose(again.speed, chosen.speed, atol=1e-12)
    # Known frames are the robot's own, and how joint 1 and the flange sit is part of it; fitted ones the instrument's.
    fitted = replace(geometry, base=chosen.nominal.base, tool=chosen.nominal.tool)
    for frames, standing in (("known", geometry), ("fitted", fitted)):
        one = replace(moved, record={**odd, "frames": frames})
        urdf = export(one, folder / f"{frames}.urdf", arm=chosen).path
        told = any("its target" in note for note in export(one, folder / "arm.toml", arm=chosen).notes)
        assert told == (frames == "fitted")  # an arm file keeps both frames as they were found
        same_kinematics(load_arm(f"{urdf}#tool").nominal, standing, joints, 1e-9)


def test_hayatis_beta_survives_the_files(calibration, dynamic, tmp_path):
    geometry = calibration.identified
    beta = np.zeros(6)
    beta[1] = 2e-4
    moved = replace(calibration, model=ArmModel.of(replace(geometry, beta=beta)))
    path = export(moved, tmp_path / "arm.toml", arm=dynamic.arm).path
    assert f"beta_deg = {float(np.degrees(2e-4))!r}" in path.read_text() and path.read_text().count("beta_deg") == 1
    joints = random_joints(geometry, 10, np.random.default_rng(0))
    same_kinematics(load_arm(path).nominal, moved.identified, joints, 1e-12)
    by_urdf = load_arm(f"{export(moved, tmp_path / 'arm.urdf', arm=dynamic.arm).path}#tool").nominal
    same_kinematics(by_urdf, moved.identified, joints, 1e-9)


def test_where_it_comes_from_stands_in_every_file(calibration, dynamic, tmp_path):
    text = export(calibration, tmp_path / "arm.toml", arm=dynamic.arm).path.read_text()
    for fact in (
        calibration.record["data_fingerprint"],
        calibration.arm_fingerprint,
        "learnt residual 'bpnn'",
        "60 poses",
    ):
        assert fact in text
    assert text.startswith("# Arm 'qiao2026'") and 'name = "qiao2026_calibrated"' in text
    urdf = export(calibration, tmp_path / "arm.urdf", arm=dynamic.arm).path.read_text()
    assert urdf.startswith("<?xml") and calibration.record["data_fingerprint"] in urdf
    assert "a2" in provenance(calibration)[3]


@pytest.mark.parametrize("name", ["ur5", "qiao2026", "panda"])
def test_mujoco_loads_a_skeleton_as_it_is(made, name, tmp_path):
    """From the robot's own base, with weights and efforts that a simulator takes; the instrument's frames stay out."""
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is the referee: pip install mujoco")
    arm, rng = load_arm(name), np.random.default_rng(70)
    calibration = made(arm, rng, "fitted")
    path = export(calibration, tmp_path / "arm.urdf", arm=arm).path
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    assert (model.body_mass[1:] > 0).all() and (model.body_inertia[1:] > 0).all()
    own = replace(calibration.identified, base=arm.nominal.base, tool=Pose(np.zeros(3), np.eye(3)))
    for row in random_joints(arm.nominal, 50, rng):
        for joint, value in zip(arm.nominal.joint_names, row, strict=True):
            data.joint(joint).qpos = value
        mujoco.mj_kinematics(model, data)
        np.testing.assert_allclose(data.body(f"link{own.links}").xpos, forward(own, row).position, atol=1e-8)


def onnx_residual(path, feeds):
    onnxruntime = pytest.importorskip("onnxruntime")
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    return session.run(None, feeds)[0]


def test_the_network_runs_elsewhere_to_the_same_digits(calibration, tmp_path):
    pytest.importorskip("onnx")
    path = export(calibration, tmp_path / "residual.onnx").path
    joints = random_joints(calibration.identified, 500, np.random.default_rng(3))
    wanted = calibration.learnt.predict(joints)
    assert np.abs(wanted).max() > 1e-4
    np.testing.assert_allclose(onnx_residual(path, {"joints": joints}), wanted, rtol=0, atol=1e-12)
    np.testing.assert_allclose(onnx_residual(path, {"joints": joints[:1]}), wanted[:1], rtol=0, atol=1e-12)


@pytest.mark.parametrize("conditions", [0, 2])
def test_turning_joints_and_conditions_are_inputs_too(calibration, conditions, tmp_path):
    """UR5: all joints by sine and cosine; positions only, so three outputs."""
    pytest.importorskip("onnx")
    arm, rng = load_arm("ur5"), np.random.default_rng(1)
    joints, known = random_joints(arm.nominal, 64, rng), rng.uniform(0, 20, (64, conditions))
    given = known if conditions else None
    learnt = fit_residual(
        "bpnn",
        joints,
        rng.normal(size=(64, 3)) * 1e-3,
        arm.nominal.prismatic,
        rng,
        conditions=given,
        fitter=lambda x, y, r: train_bpnn(x, y, r, BpnnSettings(epochs=3)),
    )
    assert learnt.inputs.periodic.all()
    moved = replace(calibration, model=ArmModel.of(arm.nominal), learnt=learnt)
    path = export(moved, tmp_path / "residual.onnx").path
    feeds = {"joints": joints} | ({"conditions": known} if conditions else {})
    np.testing.assert_allclose(onnx_residual(path, feeds), learnt.predict(joints, given), rtol=0, atol=1e-12)


def test_what_has_no_onnx_form_is_refused(calibration, dynamic, tmp_path):
    with pytest.raises(InputError, match="no learnt residual"):
        export(calibration.without_residual(), tmp_path / "r.onnx")
    rng = np.random.default_rng(0)
    joints = random_joints(dynamic.arm.nominal, 30, rng)
    rbf = fit_residual("rbf", joints, rng.normal(size=(30, 6)), dynamic.arm.nominal.prismatic, rng)
    with pytest.raises(InputError, match="'rbf' cannot be written as ONNX"):
        export(replace(calibration, learnt=rbf), tmp_path / "r.onnx")
    assert not (tmp_path / "r.onnx").exists()


def test_a_joints_table_is_that_of_the_link_that_moves_just_as_it_does(calibration, tmp_path):
    """Of two links that one joint moves the second has ratio 1, so the first follows it, by half."""
    parts = (
        (Path(pickenv.__file__).parent / "arm/files/arms/qiao2026.toml").read_text(encoding="utf-8").split("[[joints]]")
    )
    kept = [line for line in parts[2].splitlines() if not line.startswith(("lower", "upper", "speed"))]
    parts[2] = "\n".join(kept) + "\nfollows = 3\nratio = 0.5\n\n"
    (tmp_path / "coupled.toml").write_text("[[joints]]".join(parts), encoding="utf-8")
    arm = load_arm(tmp_path / "coupled.toml")
    assert arm.nominal.coupling.joint[:3] == (0, 1, 1) and arm.nominal.coupling.ratio[:3] == (1.0, 0.5, 1.0)
    moved = replace(calibration, arm=arm.nominal, model=ArmModel.of(arm.nominal), learnt=None)
    path = export(moved, tmp_path / "again.toml", arm=arm).path
    again = load_arm(path)
    assert again.nominal.coupling == arm.nominal.coupling and path.read_text().count("follows = 3") == 1
    joints = random_joints(arm.nominal, 10, np.random.default_rng(0))
    same_kinematics(again.nominal, arm.nominal, joints, 1e-12)
    np.testing.assert_allclose(again.nominal.upper, arm.nominal.upper)
    np.testing.assert_allclose(again.speed, arm.speed)


@pytest.mark.parametrize("knows", [False, True])
def test_what_remains_is_terms_and_learnt_residual_each_with_its_own_conditions(calibration, qiao, knows):
    """A residual that was learnt without temperatures is not given the one that the terms need."""
    rng = np.random.default_rng(0)
    joints, warmth = random_joints(qiao.nominal, 40, rng), rng.uniform(0.0, 10.0, (40, 1))
    errors, known = 1e-4 * rng.normal(size=(40, 3)), warmth if knows else None
    learnt = fit_residual("rbf", joints, errors, qiao.nominal.prismatic, rng, conditions=known)
    model = ArmModel.of(qiao.nominal, (ThermalTerm(),))
    change = np.zeros(len(model.parameter_names))
    change[-1] = 23e-6
    model, later = model.displaced(change), random_joints(qiao.nominal, 6, rng)
    warm, known_arm = Conditions(temperature=np.array([8.0])), replace(calibration, model=model, learnt=learnt)
    found = known_arm.compensator(conditions=warm, fast=False).residual(later.reshape(2, 3, 6))
    expected = model.displacement(later, Conditions(temperature=np.full(6, 8.0)))
    expected[:, :3] += learnt.predict(later, np.full((6, 1), 8.0) if knows else None)
    np.testing.assert_allclose(found.reshape(6, 6), expected, atol=1e-15)
    plain = replace(calibration, model=ArmModel.of(qiao.nominal), learnt=None)
    assert plain.compensator().residual is None
