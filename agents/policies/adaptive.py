"""Policies that calibrate the arm while they pick: a Kalman filter per arm learns from each pick.

In `pickenv/Reach-v0` such a policy drives open loop to joint targets, corrected by its own estimate of the arm. Once
the arm stands still at a fruit, the policy averages the camera's measurements. When the next episode begins, each arm's
filter takes this average as one measurement of the tool's position. In `pickenv/Pick-v0` every fruit that the gripper
took gives one measurement.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.agents.policies.policy import Policy, camera_of, read_observation
from pickenv.agents.policies.scripted import AT, ScriptedPick, ScriptedReach
from pickenv.arm import Array, MeasurementNoise
from pickenv.base import InputError, register
from pickenv.calibration import aimed, link_model, random_joints
from pickenv.calibration.identification import extended_kalman_filter

CALIBRATED_PRIOR = 0.2
"""Prior standard deviation of the parameters' errors after a calibration, as a share of their tolerances."""

ARRIVED = 0.02
"""An arm counts as standing still if its largest action is below this share of a joint increment."""


class LookingReach(ScriptedReach):
    """Base class of reach policies that learn each arm's errors from the camera at past fruit.

    The policy drives to corrected joint targets, and averages the camera's measurements while the arm stands there. It
    learns from the average when the next episode begins. Each observation of a batch is of another arm. Subclasses
    define how the arms are modelled, corrected and learnt: `meet`, `corrected` and `learn`.
    """

    called = "remembering"
    """Kind of the policy, as error messages name it."""

    def __init__(self, env: Any) -> None:
        """Read the nominal arm from ``env``."""
        self._count: NDArray[np.int64] = np.zeros(0, dtype=np.int64)
        super().__init__(env)

    def reset(self) -> None:
        """Learn from the last episode and prepare for the next."""
        super().reset()
        rows = np.flatnonzero(self._count)
        if len(rows):
            self.learn(rows, self._joints[rows], self._sum[rows] / self._count[rows, None], self._count[rows])
        self._count = np.zeros(len(self._count), dtype=np.int64)

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the next action ``(n,)``, or actions ``(N, n)`` for N observations.

        Raises:
            InputError: If the observation holds no camera measurement.
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
        arrived = (np.abs(action).max(axis=-1) < ARRIVED) & self.settled
        self._joints = np.where(arrived[:, None], reading.joints, self._joints)
        self._sum += np.where(arrived[:, None], reading.seen - camera, 0.0)
        self._count += arrived
        return action[0] if np.ndim(observation) == 1 else action

    def meet(self, arms: int) -> None:
        """Make models of ``arms`` arms that have not picked yet, unless the policy already has that many."""
        raise NotImplementedError

    def corrected(self, rows: NDArray[np.intp], joints: Array) -> Array:
        """Return joint targets ``(r, n)`` that put the modelled arms' tools where the nominal tool is at ``joints``.

        Args:
            rows: Indices of the arms ``(r,)``, from 0.
            joints: Joint values of the nominal arm ``(r, n)``, rad or m.
        """
        raise NotImplementedError

    def learn(self, rows: NDArray[np.intp], joints: Array, seen: Array, looks: NDArray[Any]) -> None:
        """Update the models of arms with measured tool positions.

        Args:
            rows: Indices of the arms ``(r,)``, from 0.
            joints: Joint values at which the arms stood ``(r, n)``, rad or m.
            seen: Mean measured position of each tool ``(r, 3)``, m, base frame.
            looks: Number of measurements averaged in each mean ``(r,)``.
        """
        raise NotImplementedError


class AdaptiveReach(LookingReach):
    """Reach policy that updates a Kalman filter of each arm's parameters after every pick.

    Each observation of a batch is of another arm. With a compensator, the filter models the errors that remain after
    compensation.
    """

    called = "adaptive"

    def __init__(
        self, env: Any, *, camera_std: float = 1e-3, unmodelled_std: float = 0.5e-3, prior: float = 1.0
    ) -> None:
        """Start the filters from the nominal arm.

        Args:
            env: Environment, which gives the nominal arm.
            camera_std: Standard deviation of the camera's noise per axis, m.
            unmodelled_std: Standard deviation per axis of the position errors that the geometry cannot explain, m.
            prior: Standard deviation of each parameter before the first pick, in units of its tolerance; small for a
                calibrated arm.
        """
        super().__init__(env)
        self.camera_std, self.unmodelled_std, self.prior = camera_std, unmodelled_std, prior
        typical = random_joints(self.geometry, 200, np.random.default_rng(0))  # decides only what is identifiable
        self.start: extended_kalman_filter.FilterState = extended_kalman_filter.start_filter(
            link_model(self.geometry), self.geometry, typical, full_pose=False, prior=prior
        )
        self.filters: list[extended_kalman_filter.FilterState] = []

    def meet(self, arms: int) -> None:
        """Start ``arms`` filters from the nominal arm, unless there are that many already."""
        if len(self.filters) != arms:
            self.filters = [self.start] * arms

    def corrected(self, rows: NDArray[np.intp], joints: Array) -> Array:
        """Return joint targets ``(r, n)`` by the filters' arm models; see `LookingReach.corrected`."""
        return aimed(self.geometry, [self.filters[row] for row in rows], joints)

    def learn(self, rows: NDArray[np.intp], joints: Array, seen: Array, looks: NDArray[Any]) -> None:
        """Update each arm's filter with one measured tool position; `LookingReach.learn` explains the arguments."""
        for i, at, tool, count in zip(rows, joints, seen, looks, strict=True):
            # The fruit is seen once per episode, the gap in every picture.
            std = float(np.sqrt(self.camera_std**2 * (1.0 + 1.0 / int(count)) + self.unmodelled_std**2))
            self.filters[i] = extended_kalman_filter.update(self.filters[i], at, tool, MeasurementNoise(std, 0.0))


class FeelingPick(ScriptedPick):
    """`ScriptedPick` that corrects its aim by what the gripper measured at earlier fruit of the same arm.

    Call `reset` between canopies, and make a new policy for another arm. The policy learns nothing from fruit that the
    gripper missed.
    """

    def __init__(self, env: Any, memory: LookingReach, **how: Any) -> None:
        """Make the policy for ``env``, a `pickenv/Pick-v0` with `feedback="gripper"`.

        Args:
            env: Environment, single or native vector.
            memory: Policy that models the arms of ``env`` and corrects their joint targets.
            how: Keyword arguments of `ScriptedPick` except `patience`, because the policy learns only after the arm has
                arrived.

        Raises:
            InputError: If the gripper of ``env`` measures nothing.
        """
        if env.unwrapped.orchard.felt is None:
            raise InputError("this policy learns from the gripper; make the environment with feedback='gripper'")
        super().__init__(env, **how)
        self.memory = memory

    def reset(self) -> None:
        """Forget the last canopy, but keep what was learnt about the arm."""
        super().reset()
        self._held: NDArray[np.bool_] = np.zeros(0, dtype=np.bool_)

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the next action ``(..., n + 1)``, after learning from fruit that the gripper has just taken."""
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
def adaptive(env: Any, seed: int, *, camera_noise_mm: float = 0.0, compensation: str = "raw") -> Policy:
    """Make an `AdaptiveReach` for a level of camera noise; with a compensation it assumes smaller arm errors.

    Args:
        env: Environment, which gives the nominal arm.
        seed: Not used.
        camera_noise_mm: Standard deviation of the camera's noise, mm per axis.
        compensation: Name of the compensation between the policy and the arm, such as "ls"; "raw" for none.
    """
    prior = 1.0 if compensation == "raw" else CALIBRATED_PRIOR
    return AdaptiveReach(env, camera_std=camera_noise_mm * 1e-3, prior=prior)


vars(adaptive).update(feedback=("camera",), sequential=True)
