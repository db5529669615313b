"""Policies that learn an arm's errors while they pick: by a Kalman filter per arm, or by a memory of past picks.

In `pickenv/Reach-v0` a policy with a filter drives open loop to joint targets, corrected by its own estimate of the
arm. Once the arm stands still at a fruit, the policy averages the camera's measurements. When the next episode begins,
each arm's filter takes this average as one measurement of the tool's position. In `pickenv/Pick-v0` every fruit that
the gripper took gives one measurement.

Policies with a memory are trained on `pickenv.wrappers.SameArm`. Before each pick they choose an offset from the fruit,
at which the arm then aims. A recurrent policy (LSTM) observes the last pick and keeps a state. A policy with a window
observes the last picks and weighs them by attention. The weights depend on the joints of these picks and of the next.
Both kinds are stored as a few matrices in one file with a checksum, and run by NumPy. Nothing in the file is executed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.agents.policies.learned import REMAKE, Actor, actor_parts, policy_path, read_actor
from pickenv.agents.policies.policy import Policy, camera_of, read_observation
from pickenv.agents.policies.scripted import AT, ScriptedPick, ScriptedReach
from pickenv.arm import Arm, Array, MeasurementNoise, forward
from pickenv.base import InputError, read_container, register
from pickenv.calibration import aimed, link_model, random_joints
from pickenv.calibration.identification import solve
from pickenv.wrappers import PickMemory
from pickenv.wrappers.same_arm import scaled_joints

CALIBRATED_PRIOR = 0.2


class LookingReach(ScriptedReach):
    """Base class of reach policies that learn each arm's errors from the camera at past fruit.

    The policy drives to corrected joint targets, and averages the camera's measurements while the arm stands there. It
    learns from the average when the next episode begins. Each observation of a batch belongs to a different arm.
    Subclasses define how the arms are modelled, corrected and learnt: `meet`, `corrected` and `learn`.

    Attributes:
        called: Kind of the policy, as error messages name it.
        ARRIVED: An arm counts as standing still if its largest action is below this share of a joint increment.
    """

    called, ARRIVED = "remembering", 0.02

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
        arrived = (np.abs(action).max(axis=-1) < self.ARRIVED) & self.settled
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

    Each observation of a batch belongs to a different arm. With a compensator, the filter models the errors that remain
    after compensation.
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
        self.start: solve.FilterState = solve.start_filter(
            link_model(self.geometry), self.geometry, typical, full_pose=False, prior=prior
        )
        self.filters: list[solve.FilterState] = []

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
            self.filters[i] = solve.update(self.filters[i], at, tool, MeasurementNoise(std, 0.0))


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

    With a compensation, the prior standard deviation of each parameter is `CALIBRATED_PRIOR` times its tolerance.

    Args:
        env: Environment, which gives the nominal arm.
        seed: Not used.
        camera_noise_mm: Standard deviation of the camera's noise, mm per axis.
        compensation: Name of the compensation between the policy and the arm, such as "ls"; "raw" for none.
    """
    prior = 1.0 if compensation == "raw" else CALIBRATED_PRIOR
    return AdaptiveReach(env, camera_std=camera_noise_mm * 1e-3, prior=prior)


vars(adaptive).update(feedback=("camera",), sequential=True)


REMEMBERING, REMEMBERING_FORMAT = "policy with a memory", 1

HEADS, STEEPEST = 4, 20.0

LSTM = ("input", "input_bias", "state", "state_bias")
WINDOW = ("near", "near_bias", "query", "key", "value", "value_bias")

State = tuple[Array, Array]


def attended(xp: Any, given: Mapping[str, Any], memory: PickMemory, seen: Any) -> Any:
    """Compute the attention features of a window of past picks for the next pick, on NumPy or torch.

    Each of `HEADS` heads weighs the picks of a window in its own way. `STEEPEST` is the largest absolute value of an
    attention logit, the logarithm of an unnormalised weight.

    Args:
        xp: The module numpy or torch.
        given: Weight arrays by the names in `WINDOW`.
        memory: Layout of the observations: the window of past picks and the next pick.
        seen: Observations ``(N, inputs)``.

    Returns:
        Features ``(N, features)``, joined from three parts. The first part is the scaled joints of the next pick. The
        second part is each head's weighted means of past errors and learnt features. The third part is the filled share
        of the window.
    """
    n, window = memory.joints, memory.window
    goal = seen[:, :n]
    tokens = seen[:, n:].reshape(-1, window, memory.token)
    joints, error, filled = tokens[..., :n], tokens[..., n : n + 3], tokens[..., n + 3]
    near = xp.tanh(joints @ given["near"] + given["near_bias"])
    key = (near @ given["key"]).reshape(-1, window, HEADS, given["key"].shape[1] // HEADS)
    question = xp.tanh(goal @ given["near"] + given["near_bias"])
    query = (question @ given["query"]).reshape(-1, 1, HEADS, key.shape[-1])
    weights = xp.exp(xp.clip((key * query).sum(-1), -STEEPEST, STEEPEST)) * filled[..., None]
    weights = weights / (weights.sum(1)[:, None] + 1e-12)
    features = xp.tanh(xp.concatenate((near, error), -1) @ given["value"] + given["value_bias"])
    value = xp.concatenate((error, features), -1)
    pooled = (weights[..., None] * value[:, :, None]).sum(1)
    return xp.concatenate((goal, pooled.reshape(len(seen), -1), filled.sum(1)[:, None] / window), -1)


def stepped(given: Mapping[str, Array], seen: Array, state: State) -> State:
    """Return an LSTM's next state (Hochreiter and Schmidhuber 1997).

    The gates are in torch's order: input, forget, cell, output.

    Args:
        given: Weight arrays by the names in `LSTM`.
        seen: Observations ``(N, inputs)``.
        state: Present state: the hidden output and the cell state, ``(N, units)`` each.
    """
    out, cell = state
    gates = seen @ given["input"] + given["input_bias"] + out @ given["state"] + given["state_bias"]
    take, keep, new, give = np.split(gates, 4, axis=-1)
    take, keep, give = (1.0 / (1.0 + np.exp(-part)) for part in (take, keep, give))
    cell = keep * cell + take * np.tanh(new)
    return give * np.tanh(cell), cell


@dataclass(frozen=True, eq=False, kw_only=True)
class RememberingPolicy(Actor):
    """Trained actor that remembers past picks and acts deterministically.

    An LSTM or attention reads the observations, and the network layers of `Actor` read the result.

    Attributes:
        memory: Layout of the observations: past picks and the next pick.
        arrays: Weight arrays of the memory, by the names in `LSTM` or `WINDOW`. These names begin with the layers next
            to the inputs.
    """

    memory: PickMemory
    arrays: Mapping[str, Array]

    @property
    def recurrent(self) -> bool:
        """Whether the policy keeps a state (LSTM) rather than a window."""
        return set(self.arrays) == set(LSTM)

    def begin(self, rows: int) -> State:
        """Return the policy's first state, before any pick; ``rows`` is the number of arms.

        A policy that looks at the last picks, in place of a memory of its own, has an empty state.
        """
        units = len(self.arrays["state"]) if self.recurrent else 0
        return np.zeros((rows, units)), np.zeros((rows, units))

    def aim(self, seen: NDArray[Any], state: State) -> tuple[NDArray[np.float32], State]:
        """Return where to aim beside the next fruit of N arms, and the new state of the policy.

        The offsets from the fruit are actions of `pickenv.wrappers.SameArmVector`.

        Args:
            seen: Observations ``(N, inputs)`` of `SameArmVector`, one per arm.
            state: State from `begin`, or the state returned at the last pick.

        Raises:
            InputError: If the observations have another length than the observations of the training.
        """
        if seen.shape[-1] != self.memory.inputs:
            lengths = f"{self.memory.inputs} numbers, but was given {seen.shape[-1]}"
            raise InputError(f"the policy reads {lengths}; use the window and the arm of its training")
        values = np.asarray(seen, dtype=float)
        if self.recurrent:
            state = stepped(self.arrays, values, state)
            layer = state[0]
        else:
            layer = attended(np, self.arrays, self.memory, values)
        return self.through_layers(layer, "tanh").clip(-1.0, 1.0).astype(np.float32), state

    def save(self, path: str | Path) -> Path:
        """Write the policy to one file with a checksum; ``.npz`` is appended if missing."""
        return self.write(path, REMEMBERING, REMEMBERING_FORMAT, {"memory": asdict(self.memory)}, self.arrays)


def load_remembering(name: str | Path, arm: Arm | None = None) -> RememberingPolicy:
    """Load a shipped baseline or a policy file with a memory; nothing in it is executed.

    Args:
        name: Name of a shipped baseline, or path of a policy file (.npz).
        arm: Arm for which the policy must have been trained; None to skip this check.

    Raises:
        InputError: If the file is missing, damaged, newer than this program, or of another arm.
    """
    return read_actor(name, arm, REMEMBERING, REMEMBERING_FORMAT, _policy_of)


def remembers(name: str | Path) -> bool:
    """Return whether a shipped baseline or a policy file holds a policy with a memory.

    Raises:
        InputError: If there is no such baseline or file, or the file is damaged.
    """
    return read_container(policy_path(name), None, remake=REMAKE).kind == REMEMBERING


class RememberingReach(LookingReach):
    """Reach policy that aims the nominal arm beside the fruit, at an offset that a policy with a memory chooses.

    With a compensator, the policy observes the errors that remain after compensation, although it was not trained on
    such errors.
    """

    def __init__(self, env: Any, policy: RememberingPolicy) -> None:
        """Read the nominal arm from ``env``; ``policy`` chooses the offsets."""
        super().__init__(env)
        self.policy = policy
        self._tokens: NDArray[np.float32] = policy.memory.empty(0)
        self._state = policy.begin(0)

    def meet(self, arms: int) -> None:
        """Make memories for ``arms`` arms that have not picked yet, unless there are that many already."""
        if len(self._tokens) != arms:
            self._tokens, self._state = self.policy.memory.empty(arms), self.policy.begin(arms)

    def corrected(self, rows: NDArray[np.intp], joints: Array) -> Array:
        """Return joint targets ``(r, n)`` with the nominal tool beside its position at ``joints``.

        The policy chooses the offset of each arm; see `LookingReach.corrected` for the arguments.
        """
        observations = self.policy.memory.shown(scaled_joints(self.geometry, joints), self._tokens[rows])
        actions, state = self.policy.aim(observations, (self._state[0][rows], self._state[1][rows]))
        self._state[0][rows], self._state[1][rows] = state
        return self.policy.memory.aim(self.geometry, joints, actions)

    def learn(self, rows: NDArray[np.intp], joints: Array, seen: Array, looks: NDArray[Any]) -> None:
        """Store one more pick of each arm; `LookingReach.learn` explains the arguments."""
        error = seen - forward(self.geometry, joints).position
        self._tokens = self._tokens.copy()
        self._tokens[rows] = self.policy.memory.after(self._tokens[rows], scaled_joints(self.geometry, joints), error)


def _policy_of(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> RememberingPolicy:
    """Make the policy that a file's header and arrays describe; raise any type of exception if they describe none."""
    kind = LSTM if "state" in arrays else WINDOW
    if not all(np.isfinite(arrays[name]).all() for name in kind):
        raise InputError("its memory holds numbers that are not finite")
    policy = RememberingPolicy(
        **actor_parts(header, arrays, len(arrays["weight0"]), 3, len(kind)),
        memory=PickMemory(**header["memory"]),
        arrays={name: arrays[name].astype(float) for name in kind},
    )
    policy.aim(np.zeros((1, policy.memory.inputs)), policy.begin(1))  # shapes that do not fit raise here
    return policy
