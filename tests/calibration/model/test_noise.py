"""Scatter found from the rows: by channel, among neighbours, and what equations of one picture share."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest

from pickenv.arm import forward, load_arm
from pickenv.calibration import ArmModel, Measurements, random_joints
from pickenv.calibration.model.noise_and_priors import (
    ALIKE,
    FREE,
    RowNoise,
    counted,
    neighbours,
    noise_of,
    stated_noise,
)

UR5 = load_arm("ur5").nominal
ARM = ArmModel.of(UR5)


def measured(joints, error):
    pose = forward(UR5, joints)
    return Measurements(joints, pose.position + error[:, :3], pose.rotation, UR5.prismatic, 1e-5, 1e-4)


def smooth(joints, length, rng, waves=400):
    """A Gaussian process of unit variance and this length at joints (N, n), three outputs."""
    frequency = rng.standard_normal((joints.shape[1], waves)) / length
    phase = rng.uniform(0, 2 * np.pi, waves)
    return np.sqrt(2.0 / waves) * np.cos(joints @ frequency + phase) @ rng.standard_normal((waves, 3))


def test_each_channel_has_the_scatter_that_its_rows_show():
    rng = np.random.default_rng(1)
    data = measured(random_joints(UR5, 400, rng), 5e-5 * rng.standard_normal((400, 3)))
    noise = noise_of(data, ARM, np.zeros(0), np.zeros(2400))
    assert noise.channels[0] == pytest.approx(5.0, rel=0.1) and noise.channels[1] < 0.1  # attitudes are exact here
    assert noise.share == 0.0 and noise.common == 1.0


def test_what_a_fit_has_used_of_the_rows_shows_no_scatter():
    rng = np.random.default_rng(2)
    data = measured(random_joints(UR5, 40, rng), 5e-5 * rng.standard_normal((40, 3)))
    free, used = (noise_of(data, ARM, np.zeros(0), np.full(240, part)).channels[0] for part in (0.0, 0.5))
    assert used == pytest.approx(np.sqrt(2.0) * free, rel=0.05)


def test_what_neighbours_share_is_told_from_what_each_row_has():
    rng = np.random.default_rng(3)
    joints = random_joints(UR5, 300, rng) * 0.1
    field, white = smooth(joints, 0.4, rng), rng.standard_normal((300, 3))
    alike = noise_of(measured(joints, 1e-4 * field).positions_only(), ARM, np.zeros(0), np.zeros(3 * len(joints)))
    apart = noise_of(measured(joints, 1e-4 * white).positions_only(), ARM, np.zeros(0), np.zeros(3 * len(joints)))
    assert alike.share >= 0.8 and 0.2 <= alike.length <= 0.8 and alike.common > 1.5
    assert apart.share == 0.0


def test_rows_of_one_pose_count_as_their_number():
    joints = np.repeat(random_joints(UR5, 7, np.random.default_rng(4)), 5, axis=0)
    assert neighbours(joints, 0.05) == pytest.approx(np.full(35, 5.0), abs=1e-6)


def test_a_cluster_weighs_less_than_rows_that_stand_apart():
    """Of an error that is alike nearby, 400 rows of one cluster are one fact, and 40 wide rows forty."""
    rng = np.random.default_rng(5)
    wide, close = random_joints(UR5, 40, rng), random_joints(UR5, 1, rng) + 0.02 * rng.standard_normal((400, 6))
    joints = np.concatenate([wide, close])
    noise = noise_of(
        measured(joints, 1e-4 * smooth(joints, 0.3, rng)).positions_only(), ARM, np.zeros(0), np.zeros(3 * len(joints))
    )
    variance = noise.scatter.reshape(440, 3)[:, 0] ** 2
    assert noise.share > 0.5
    assert (400 / variance[40:].mean()) < 0.3 * (40 / variance[:40].mean())


@dataclass(frozen=True)
class Pictures:
    """Rows of many equations each, all of which see the pose of their row."""

    joints: Any
    effect: Any
    values: Any

    def equations(self):
        rows, count = self.effect.shape[:2]
        return np.repeat(np.arange(rows), count), np.zeros(rows * count, dtype=np.int64)

    def residual(self, model, unknowns):
        return self.values.ravel()

    def jacobian(self, model, unknowns):
        columns = np.zeros((self.values.size, len(model.parameter_names)))
        columns[:, 5 * model.geometry.links + 6 :][:, :6] = self.effect.reshape(-1, 6)
        return columns, np.zeros((self.values.size, 0))

    def by_tool(self, model, unknowns):
        return self.effect.reshape(-1, 6)


@pytest.fixture(scope="module")
def pictures():
    rng = np.random.default_rng(6)
    effect = rng.standard_normal((60, 40, 6)) * 1e3
    pose = rng.standard_normal((60, 6)) * np.repeat([2e-3, 5e-3], 3)
    values = np.einsum("nij,nj->ni", effect, pose) + 3.0 * rng.standard_normal((60, 40))
    return Pictures(random_joints(UR5, 60, rng), effect, values)


def test_the_pose_behind_a_picture_errs_for_all_of_its_corners(pictures):
    noise = noise_of(pictures, ARM, np.zeros(0), np.zeros(2400))
    assert noise.channels[0] == pytest.approx(3.0, rel=0.05)
    assert noise.pose_std == pytest.approx((2e-3, 5e-3), rel=0.2)


def test_whitened_pictures_scatter_alike_in_every_direction(pictures):
    noise = noise_of(pictures, ARM, np.zeros(0), np.zeros(2400))
    white = noise.whiten(np.column_stack([pictures.values.ravel(), pictures.effect.reshape(-1, 6)]))
    assert np.mean(white[:, 0] ** 2) == pytest.approx(1.0, rel=0.05)
    basis = np.linalg.qr(white[:, 1:].reshape(60, 40, 6))[0]
    along = np.einsum("nij,ni->nj", basis, white[:, 0].reshape(60, 40))
    assert np.mean(along**2) == pytest.approx(1.0, rel=0.2)  # the pose's own directions too


def test_a_prior_behind_the_rows_is_not_weighed():
    noise = replace(stated_noise(measured(np.zeros((2, 6)), np.zeros((2, 3)))), scatter=np.full(12, 2.0))
    assert noise.whiten(np.ones(14)).tolist() == [0.5] * 12 + [1.0] * 2
    assert isinstance(noise, RowNoise)


def test_a_row_far_from_others_counts_fully_and_no_row_counts_more_than_once():
    rng = np.random.default_rng(3)
    apart = rng.uniform(-2.0, 2.0, (30, 6))
    cluster = apart[0] + 1e-3 * rng.normal(size=(30, 6))
    weights = counted(np.vstack([apart[1:], cluster]))
    assert weights.max() <= 1.0 and weights[:29].min() > 3.0 * weights[29:].max()
    facts = 1.0 / neighbours(plane := rng.normal(size=(300, 2)), ALIKE)
    full = counted(plane) == 1.0  # of rows that thin out, a quarter counts fully: those with the most room
    assert facts[full].sum() / facts.sum() == pytest.approx(FREE, abs=0.01)
