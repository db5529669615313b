"""Our own CSV files: what is written is read back."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import load_arm, load_instrument, load_plant, rotation_vector
from pickenv.base import InputError
from pickenv.calibration import Conditions, Measurements, random_joints, read_measurements, simulated_tracker

ULP = 4e-16  # degrees are written, radians kept: one rounding each way


@pytest.fixture
def noisy(dynamic):
    rng = np.random.default_rng(0)
    return simulated_tracker(dynamic, random_joints(dynamic.arm.nominal, 50, rng), rng)


@pytest.mark.parametrize("positions", [False, True])
def test_a_trip_through_a_file_keeps_every_digit(tmp_path, noisy, dynamic, positions):
    data = noisy.positions_only() if positions else noisy
    path = data.write_csv(tmp_path / "tracker.csv")
    back = read_measurements(path, dynamic.arm.nominal)
    np.testing.assert_allclose(back.joints, data.joints, rtol=ULP, atol=0)
    np.testing.assert_allclose(back.position, data.position, rtol=ULP, atol=0)
    assert back.kind == data.kind and back.source == str(path) and len(back) == 50
    if not positions:
        np.testing.assert_allclose(back.rotation, data.rotation, atol=1e-15)
    assert back.fingerprint() == data.fingerprint()


def test_a_file_is_read_with_the_arm_as_with_its_geometry_and_with_nothing_else(tmp_path, noisy, dynamic):
    path = noisy.write_csv(tmp_path / "tracker.csv")
    with_arm, with_geometry = (read_measurements(path, arm) for arm in (dynamic.arm, dynamic.arm.nominal))
    assert with_arm.fingerprint() == with_geometry.fingerprint()
    with pytest.raises(InputError, match=r"^geometry is 'ur5e'; give the arm, as `pickenv.load_arm` returns it$"):
        read_measurements(path, "ur5e")


def test_the_file_names_every_unit(noisy, tmp_path):
    names, values = noisy.table()
    joints = ["q1_deg", "q2_mm", "q3_mm", "q4_deg", "q5_mm", "q6_deg"]
    assert names == [*joints, "x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"]
    with noisy.write_csv(tmp_path / "tracker.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows[0] == [*names, "frames"] and {row[-1] for row in rows[1:]} == {"known"}
    assert np.array_equal(np.array([row[:-1] for row in rows[1:]], dtype=float), values)
    np.testing.assert_allclose(values[:, -3:], np.degrees(rotation_vector(noisy.rotation)))


@pytest.mark.parametrize("units", [("rad", "m"), ("deg", "mm"), ("rad", "mm"), ("deg", "m")])
def test_our_format_takes_either_unit_of_each_kind(tmp_path, noisy, qiao, units):
    angle, length = units
    names, values = noisy.table()
    scale = [
        (np.pi / 180 if angle == "rad" else 1) if n.endswith("deg") else (1e-3 if length == "m" else 1) for n in names
    ]
    renamed = [n.replace("deg", angle).replace("mm", length) for n in names]
    path = tmp_path / "tracker.csv"
    with path.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([renamed, *(values * scale).tolist()])
    back = read_measurements(path, qiao.nominal)
    np.testing.assert_allclose(back.joints, noisy.joints, rtol=1e-15)
    np.testing.assert_allclose(back.position, noisy.position, rtol=1e-15)
    np.testing.assert_allclose(back.rotation, noisy.rotation, atol=1e-15)


def test_the_fingerprint_sees_a_nanometre_and_the_kind(noisy):
    nudged = Measurements(noisy.joints, noisy.position + 2e-9, noisy.rotation, noisy.prismatic)
    prints = {noisy.fingerprint(), nudged.fingerprint(), noisy.positions_only().fingerprint()}
    assert len(prints | {noisy.select(range(49)).fingerprint()}) == 4
    assert noisy.select(np.arange(50)).fingerprint() == noisy.fingerprint()


def test_rows_are_selected_by_index_or_mask(noisy):
    mask = np.arange(50) % 7 == 0
    by_mask, by_index = noisy.select(mask), noisy.select(np.flatnonzero(mask))
    assert by_mask.fingerprint() == by_index.fingerprint() and len(by_mask) == 8
    assert (noisy.rows_per_pose, noisy.positions_only().rows_per_pose) == (6, 3)


def test_random_joints_fill_the_ranges():
    for name in ("qiao2026", "ur5", "wam"):
        geometry = load_arm(name).nominal
        q = random_joints(geometry, 4000, np.random.default_rng(1))
        share = (q - geometry.lower) / (geometry.upper - geometry.lower)
        assert share.min() >= 0 and share.max() <= 1
        np.testing.assert_allclose(share.mean(axis=0), 0.5, atol=0.02)
        np.testing.assert_allclose(share.std(axis=0), 1 / np.sqrt(12), atol=0.01)


def test_the_simulated_tracker_has_the_plants_noise(dynamic):
    q = np.broadcast_to(random_joints(dynamic.arm.nominal, 1, np.random.default_rng(0)), (5000, 6))
    seen = simulated_tracker(dynamic, q, np.random.default_rng(1))
    true = dynamic.tool_pose(q[0])
    std = 15e-6 + 0.7e-6 * np.linalg.norm(true.position - load_instrument("laser_tracker").stand)
    np.testing.assert_allclose(seen.position.std(axis=0), std, rtol=0.05)
    np.testing.assert_allclose(seen.position.mean(axis=0), true.position, atol=4 * 12.7e-6)  # the target's mounting
    turns = rotation_vector(seen.rotation @ true.rotation.T)
    np.testing.assert_allclose(turns.std(axis=0), np.radians(0.012), rtol=0.05)
    assert seen.position_std == pytest.approx(std, rel=1e-3) and seen.attitude_std == pytest.approx(np.radians(0.012))
    exact = simulated_tracker(load_plant("geometry_only"), q, np.random.default_rng(1))
    assert np.ptp(exact.position, axis=0).max() == 0 and exact.position_std > 0


@pytest.mark.parametrize(
    ("joints", "said"),
    [
        (np.zeros((3, 5)), r"shape \(3, 5\); give \(N, 6\)"),
        (np.zeros(6), "one row per pose"),
        (np.vstack([np.zeros(6), [0, 0, np.nan, 0, 0, 0]]), "the joints of pose 1 are .*nan"),
    ],
)
def test_no_campaign_visits_impossible_joints(dynamic, joints, said):
    with pytest.raises(InputError, match=said):
        simulated_tracker(dynamic, joints, np.random.default_rng(0))


def test_an_empty_file_is_no_instrument(dynamic, tmp_path):
    (tmp_path / "empty.toml").write_text("")
    with pytest.raises(InputError, match="stand_mm"):
        simulated_tracker(dynamic, np.zeros((1, 6)), np.random.default_rng(0), str(tmp_path / "empty.toml"))


def test_what_was_recorded_beside_the_poses_goes_into_the_file_and_back(tmp_path, noisy, dynamic):
    known = Conditions(payload=np.linspace(0.0, 3.0, 50), temperature=np.linspace(-5.0, 15.0, 50))
    path = replace(noisy, conditions=known).write_csv(tmp_path / "tracker.csv")
    back = read_measurements(path, dynamic.arm.nominal).conditions
    np.testing.assert_allclose(back.payload, known.payload, atol=1e-12)
    np.testing.assert_allclose(back.temperature, known.temperature, atol=1e-12)
