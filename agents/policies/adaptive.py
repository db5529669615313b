"""A policy that goes on calibrating while it picks: the Kalman filter learns from what the camera saw of past picks.

It drives open loop, corrected by its own estimate of the arm. Once it stands still before a fruit, it averages the
camera's view; when the next episode begins, each arm's filter takes that as one observation of the tool's position.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.agents.policies.policy import ObservationParts, Policy, camera_of, read_observation, with_traits
from pickenv.agents.policies.scripted import ScriptedReach
from pickenv.arm import Array, MeasurementNoise
from pickenv.base import register
from pickenv.calibration import aimed, link_model, random_joints
from pickenv.calibration.identification import extended_kalman_filter

CALIBRATED_PRIOR = 0.2
"""Share of the parameters' tolerances that an adaptive policy expects to be left behind a calibration."""

ARRIVED = 0.02
"""Share of an increment; an arm whose largest action is below it counts as standing."""


class LookingReach(ScriptedReach):
    """Reach where a correction says, look while standing there, and learn from the pictures as the next episode begins.

    Rows of a batch are arms. Subclasses say what is believed of the arms, and how to correct and learn.
    """

    called = "remembering"
    """Its name in sentences."""

    def __init__(self, env: Any) -> None:
        """``env`` gives the nominal arm."""
        super().__init__(env)
        self._count: NDArray[np.int64] = np.zeros(0, dtype=np.int64)

    def reset(self) -> None:
        """Learn from the last episode."""
        super().reset()
        rows = np.flatnonzero(self._count)
        if len(rows):
            self._learn(rows, self._joints[rows], self._sum[rows] / self._count[rows, None])
        self._count = np.zeros(len(self._count), dtype=np.int64)

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action.

        Raises:
            InputError: If the observation holds no camera.
        """
        reading = read_observation(self.geometry, np.atleast_2d(observation))
        camera = camera_of(reading, self.called)
        if len(self._count) != len(camera):
            self._count = np.zeros(len(camera), dtype=np.int64)
        if self._wanted is None:
            self._wanted = self._corrected(self.wanted_joints(reading))
            self._joints: Array = np.zeros_like(reading.joints)
            self._sum: Array = np.zeros_like(camera)
        action = self.action(self._wanted - self.commanded(reading.joints))
        self._note(reading, camera, (np.abs(action).max(axis=-1) < ARRIVED) & self.settled)
        return action[0] if np.ndim(observation) == 1 else action

    def _corrected(self, joints: Array) -> Array:
        """Joint targets that bring each arm, as it is believed to be, to the nominal arm's place at ``joints``."""
        raise NotImplementedError

    def _learn(self, rows: NDArray[np.intp], joints: Array, seen: Array) -> None:
        """Learn that the arms ``rows`` stood at ``joints``, their tools seen at ``seen (rows, 3)`` on average, m."""
        raise NotImplementedError

    def _note(self, reading: ObservationParts, camera: Array, arrived: NDArray[np.bool_]) -> None:
        """Add one picture to the averages of the arms that stand."""
        self._joints = np.where(arrived[:, None], reading.joints, self._joints)
        self._sum += np.where(arrived[:, None], reading.seen - camera, 0.0)
        self._count += arrived


class AdaptiveReach(LookingReach):
    """Reach with an arm model that every pick improves; rows of a batch are arms, each with its own filter.

    Behind a compensator it learns what the compensator leaves: the arm that it sees is the compensated one.
    """

    called = "adaptive"

    def __init__(
        self, env: Any, *, camera_std: float = 1e-3, unmodelled_std: float = 0.5e-3, prior: float = 1.0
    ) -> None:
        """Start the filters from the nominal arm.

        Args:
            env: The environment, which gives the nominal arm.
            camera_std: Standard deviation per axis of what the camera sees, m.
            unmodelled_std: What the geometry cannot explain, m.
            prior: Standard deviation of a parameter before the first pick, in its tolerances; small for a calibrated
                arm.
        """
        super().__init__(env)
        self.camera_std, self.unmodelled_std, self.prior = camera_std, unmodelled_std, prior
        typical = random_joints(self.geometry, 200, np.random.default_rng(0))  # decides only what is identifiable
        model = link_model(self.geometry)
        self.start: extended_kalman_filter.FilterState = extended_kalman_filter.start_filter(
            model, self.geometry, typical, full_pose=False, prior=prior
        )
        self.filters: list[extended_kalman_filter.FilterState] = []

    def _corrected(self, joints: Array) -> Array:
        if len(self.filters) != len(joints):
            self.filters = [self.start] * len(joints)
        return aimed(self.geometry, self.filters, joints)

    def _learn(self, rows: NDArray[np.intp], joints: Array, seen: Array) -> None:
        for i, at, tool in zip(rows, joints, seen, strict=True):
            # The fruit is seen once per episode, the gap in every picture.
            std = float(np.sqrt(self.camera_std**2 * (1.0 + 1.0 / int(self._count[i])) + self.unmodelled_std**2))
            self.filters[i] = extended_kalman_filter.update(self.filters[i], at, tool, MeasurementNoise(std, 0.0))


@register("policy", "adaptive")
@with_traits(("camera",), sequential=True)
def adaptive(env: Any, seed: int, *, camera_noise_mm: float = 0.0, compensation: str = "raw") -> Policy:
    """An adaptive policy that expects this camera noise, and smaller arm errors behind a compensation."""
    prior = 1.0 if compensation == "raw" else CALIBRATED_PRIOR
    return AdaptiveReach(env, camera_std=camera_noise_mm * 1e-3, prior=prior)
