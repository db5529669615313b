"""The paper's protocol on the dynamic plant: 100 poses for geometry, 200 for the network, 1000 to judge by."""

import numpy as np

from pickenv.arm import forward, noncompensable_error, pose_error
from pickenv.calibration import error_statistics, held_out_r2


def after_compensation(calibration, plant, joints):
    """Mean position error in mm, mean attitude error and its non-compensable part in degrees, of the true tool."""
    command = calibration.compensate(joints)
    error = pose_error(forward(plant.arm.nominal, joints), plant.tool_pose(command))
    floor = noncompensable_error(plant.geometry, command, error)
    degrees = [np.degrees(np.linalg.norm(e[:, 3:], axis=1)).mean() for e in (error, floor)]
    return np.linalg.norm(error[:, :3], axis=1).mean() * 1e3, *degrees


def test_least_squares_leaves_half_a_millimetre_and_the_network_a_fifth(protocol, dynamic):
    """Measured: 0.567 and 0.511 mm after LS (paper 0.549), 0.185 and 0.181 mm after LS+BPNN (paper 0.464)."""
    fit, test = protocol
    ls = after_compensation(fit.calibration.without_residual(), dynamic, test.joints)
    both = after_compensation(fit.calibration, dynamic, test.joints)
    assert 0.50 <= ls[0] <= 0.60
    assert both[0] <= 0.30
    assert both[1] - both[2] <= 0.02  # of the attitude, only what no joint motion removes is left
    assert 0.04 < both[2] < 0.06


def test_raw_error_is_several_times_what_is_left(protocol, dynamic):
    """The paper removes 91 % of 6.30 mm by LS and 93 % by LS+BPNN. Measured: 67 and 71 %, 89 and 90 % of 1.72 mm.

    Raw errors of 6.30 mm are out of Table 1's reach, while the dynamic error is as large as the paper's.
    """
    fit, test = protocol
    raw = pose_error(forward(dynamic.arm.nominal, test.joints), dynamic.tool_pose(test.joints))
    raw_mm = error_statistics(raw[:, :3] * 1e3).mean
    ls = after_compensation(fit.calibration.without_residual(), dynamic, test.joints)[0]
    both = after_compensation(fit.calibration, dynamic, test.joints)[0]
    assert 1.5 < raw_mm < 2.0
    assert ls < 0.36 * raw_mm
    assert both < 0.13 * raw_mm


def test_the_network_explains_what_geometry_cannot(protocol, dynamic):
    fit, test = protocol
    left = test.difference(fit.calibration.identified)
    r2 = held_out_r2(left[:, :3], fit.calibration.learnt.predict(test.joints)[:, :3])
    assert (r2 > 0.7).all()


def test_the_evidence_is_on_record(protocol):
    fit, _ = protocol
    record = fit.calibration.record
    assert (record["poses"], record["rank"], record["residual"]["poses"]) == (100, 16, 200)
    assert set(record["dropped"]) == {"a2", "a3", "a5", "d2", "d4", "d6", "theta2", "theta6"}
    assert record["residual"]["settings"]["epochs"] == 500
    assert record["residual"]["generator"]["bit_generator"] == "PCG64"
    assert {"python", "pickenv", "numpy", "torch"} <= set(record["versions"])
