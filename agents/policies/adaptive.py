"""Policies that go on calibrating while they pick: a Kalman filter learns from what was seen or felt of past picks.

In Reach such a policy drives open loop, corrected by its own estimate of the arm. Once it stands still before a fruit,
it averages the camera's view; when the next episode begins, each arm's filter takes that as one observation of the
tool's position. In Pick every fruit that the gripper took is one observation.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.agents.policies.policy import ObservationParts, Policy, camera_of, read_observation, with_traits
from pickenv.agents.policies.scripted import AT, ScriptedPick, ScriptedReach
from pickenv.arm import Array, MeasurementNoise
from pickenv.base import InputError, register
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
            self.learn(rows, self._joints[rows], self._sum[rows] / self._count[rows, None], self._count[rows])
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
            wanted = self.wanted_joints(reading)
            self.meet(len(wanted))
            self._wanted = self.corrected(np.arange(len(wanted)), wanted)
            self._joints: Array = np.zeros_like(reading.joints)
            self._sum: Array = np.zeros_like(camera)
        action = self.action(self._wanted - self.commanded(reading.joints))
        self._note(reading, camera, (np.abs(action).max(axis=-1) < ARRIVED) & self.settled)
        return action[0] if np.ndim(observation) == 1 else action

    def meet(self, arms: int) -> None:
        """Begin anew with so many arms, unless there are as many already."""
        raise NotImplementedError

    def corrected(self, rows: NDArray[np.intp], joints: Array) -> Array:
        """Joint targets that bring the arms ``rows``, as believed, to the place of the nominal arm at ``joints``."""
        raise NotImplementedError

    def learn(self, rows: NDArray[np.intp], joints: Array, seen: Array, looks: NDArray[Any]) -> None:
        """Learn where arms' tools were.

        Args:
            rows: Numbers of the arms.
            joints: Joints at which they stood ``(rows, n)``, rad or m.
            seen: Mean position at which each tool was seen ``(rows, 3)``, m.
            looks: Number of pictures behind each mean ``(rows,)``.
        """
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
        self.start: extended_kalman_filter.FilterState = extended_kalman_filter.start_filter(
            link_model(self.geometry), self.geometry, typical, full_pose=False, prior=prior
        )
        self.filters: list[extended_kalman_filter.FilterState] = []

    def meet(self, arms: int) -> None:
        """Begin with the nominal arm, unless there are as many arms already."""
        if len(self.filters) != arms:
            self.filters = [self.start] * arms

    def corrected(self, rows: NDArray[np.intp], joints: Array) -> Array:
        """As in `LookingReach`: by the arms that the filters believe in."""
        return aimed(self.geometry, [self.filters[row] for row in rows], joints)

    def learn(self, rows: NDArray[np.intp], joints: Array, seen: Array, looks: NDArray[Any]) -> None:
        """As in `LookingReach`: each filter takes one observation."""
        for i, at, tool, count in zip(rows, joints, seen, looks, strict=True):
            # The fruit is seen once per episode, the gap in every picture.
            std = float(np.sqrt(self.camera_std**2 * (1.0 + 1.0 / int(count)) + self.unmodelled_std**2))
            self.filters[i] = extended_kalman_filter.update(self.filters[i], at, tool, MeasurementNoise(std, 0.0))


class FeelingPick(ScriptedPick):
    """Pick as scripted, aimed beside each fruit by what the gripper felt of the fruit that the same arm took before.

    Several canopies follow each other with `reset` in between; another arm wants another policy. Fruit that the gripper
    missed teaches nothing.
    """

    def __init__(self, env: Any, memory: LookingReach, **how: Any) -> None:
        """Pick in ``env``, a `pickenv/Pick-v0` with `feedback="gripper"`.

        Args:
            env: The environment, single or native vector.
            memory: What learns the arms and corrects by them; its arms are the environment's.
            how: Arguments of `ScriptedPick`, but for `patience`: what is learnt is of arms that have arrived.

        Raises:
            InputError: If the gripper of ``env`` feels nothing.
        """
        if env.unwrapped.orchard.felt is None:
            raise InputError("this policy learns from the gripper; make the environment with feedback='gripper'")
        super().__init__(env, **how)
        self.memory = memory

    def reset(self) -> None:
        """Forget the last canopy, but not the arm."""
        super().reset()
        self._held: NDArray[np.bool_] = np.zeros(0, dtype=np.bool_)

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action; what the gripper has just taken is learnt from first."""
        values = np.atleast_2d(np.asarray(observation, dtype=float))
        held = values[:, -6] + values[:, -5] > 0.5
        if len(self._held) == len(held):
            rows = np.flatnonzero(held & ~self._held)
            if len(rows):
                self.memory.learn(rows, self._way[rows, AT], self._fruit[rows] - values[rows, -3:], np.ones(len(rows)))
        self._held = held
        return super().act(observation)

    def _corrected(self, rows: Any, at: Array) -> Array:
        self.memory.meet(len(self._fruit))
        return self.memory.corrected(np.atleast_1d(rows), np.atleast_2d(at)).reshape(at.shape)


@register("policy", "adaptive")
@with_traits(("camera",), sequential=True)
def adaptive(env: Any, seed: int, *, camera_noise_mm: float = 0.0, compensation: str = "raw") -> Policy:
    """An adaptive policy that expects this camera noise, and smaller arm errors behind a compensation."""
    prior = 1.0 if compensation == "raw" else CALIBRATED_PRIOR
    return AdaptiveReach(env, camera_std=camera_noise_mm * 1e-3, prior=prior)
