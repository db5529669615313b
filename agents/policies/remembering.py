"""Policies that remember what the camera saw at past picks, and aim by it: learned calibration while picking.

They are trained on `pickenv.wrappers.SameArm`: before each pick they say how far to aim beside the fruit. A recurrent
policy (LSTM) sees the last pick and keeps a state; a policy with a window sees the last picks and weighs them by how
near they were (attention). Both are a few matrices in one verified file, run by NumPy; nothing in it is executed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.agents.policies.adaptive import LookingReach
from pickenv.agents.policies.learned import REMAKE, Actor, actor_parts, policy_path, read_actor
from pickenv.arm import Arm, Array, forward
from pickenv.base import InputError, read_container
from pickenv.wrappers import PickMemory
from pickenv.wrappers.same_arm import scaled_joints

REMEMBERING, REMEMBERING_FORMAT = "policy with a memory", 1

HEADS = 4
"""Number of attention heads: ways in which a window's picks are weighed."""

STEEPEST = 20.0
"""Largest size of a weight's logarithm."""

LSTM = ("input", "input_bias", "state", "state_bias")
WINDOW = ("near", "near_bias", "query", "key", "value", "value_bias")
"""Arrays of the two kinds of memory, inputs first."""

State = tuple[Array, Array]
"""State of a recurrent policy: its output and its cell, ``(N, units)`` each."""


def attended(xp: Any, given: Mapping[str, Any], memory: PickMemory, seen: Any) -> Any:
    """Features of a window's picks for the next one, on NumPy or torch.

    Args:
        xp: numpy or torch.
        given: Arrays by their names in `WINDOW`.
        memory: How observations are laid out.
        seen: Observations ``(N, inputs)``.

    Returns:
        Joints to go to, the picks' errors and what was made of them, weighed by each head, and the share of the window
        that is filled ``(N, features)``.
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
    """An LSTM's next state, gates in torch's order: input, forget, cell, output (Hochreiter and Schmidhuber 1997)."""
    out, cell = state
    gates = seen @ given["input"] + given["input_bias"] + out @ given["state"] + given["state_bias"]
    take, keep, new, give = np.split(gates, 4, axis=-1)
    take, keep, give = (1.0 / (1.0 + np.exp(-part)) for part in (take, keep, give))
    cell = keep * cell + take * np.tanh(new)
    return give * np.tanh(cell), cell


@dataclass(frozen=True, eq=False, kw_only=True)
class RememberingPolicy(Actor):
    """A trained actor with a memory, acting without noise; its layers come after the memory.

    Attributes:
        memory: How its observations are laid out.
        arrays: Arrays of `LSTM` or of `WINDOW`, by name.
    """

    memory: PickMemory
    arrays: Mapping[str, Array]

    @property
    def recurrent(self) -> bool:
        """Whether the policy keeps a state (LSTM) rather than a window."""
        return set(self.arrays) == set(LSTM)

    def begin(self, rows: int) -> State:
        """The state of ``rows`` arms that have not picked yet; an empty one for a policy with a window."""
        units = len(self.arrays["state"]) if self.recurrent else 0
        return np.zeros((rows, units)), np.zeros((rows, units))

    def aim(self, seen: NDArray[Any], state: State) -> tuple[NDArray[np.float32], State]:
        """Shifts beside the fruit to aim by, as `pickenv.wrappers.SameArmVector` takes it, and the next state.

        Args:
            seen: Observations ``(N, inputs)`` of that wrapper.
            state: State from `begin`, or after the pick before.

        Raises:
            InputError: If the observations have another length.
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
        """Write one verified file; ``.npz`` is appended if missing."""
        return self.write(path, REMEMBERING, REMEMBERING_FORMAT, {"memory": asdict(self.memory)}, self.arrays)


def load_remembering(name: str | Path, arm: Arm | None = None) -> RememberingPolicy:
    """Read a policy with a memory by the name of a shipped baseline or from a path; nothing in it is executed.

    Args:
        name: Name or path.
        arm: If given, the arm that it must have been trained for.

    Raises:
        InputError: If it is missing, damaged, newer than this program, or of another arm.
    """
    return read_actor(name, arm, REMEMBERING, REMEMBERING_FORMAT, _policy_of)


def remembers(name: str | Path) -> bool:
    """Whether a shipped baseline or a file holds a policy with a memory; errors as for `load_policy`."""
    return read_container(policy_path(name), None, remake=REMAKE).kind == REMEMBERING


class RememberingReach(LookingReach):
    """Reach with the nominal arm, aimed beside the fruit by what a policy with a memory made of past picks.

    Behind a compensator it sees what the compensator leaves, which is not what it was trained on.
    """

    def __init__(self, env: Any, policy: RememberingPolicy) -> None:
        """``env`` gives the nominal arm."""
        super().__init__(env)
        self.policy = policy
        self._tokens: NDArray[np.float32] = policy.memory.empty(0)
        self._state = policy.begin(0)

    def meet(self, arms: int) -> None:
        """Begin with arms that have not picked yet, unless there are as many already."""
        if len(self._tokens) != arms:
            self._tokens, self._state = self.policy.memory.empty(arms), self.policy.begin(arms)

    def corrected(self, rows: NDArray[np.intp], joints: Array) -> Array:
        """As in `LookingReach`: beside the fruit by what the policy says."""
        observations = self.policy.memory.shown(scaled_joints(self.geometry, joints), self._tokens[rows])
        actions, state = self.policy.aim(observations, (self._state[0][rows], self._state[1][rows]))
        self._state[0][rows], self._state[1][rows] = state
        return self.policy.memory.aim(self.geometry, joints, actions)

    def learn(self, rows: NDArray[np.intp], joints: Array, seen: Array, looks: NDArray[Any]) -> None:
        """As in `LookingReach`: one more pick to remember."""
        error = seen - forward(self.geometry, joints).position
        self._tokens = self._tokens.copy()
        self._tokens[rows] = self.policy.memory.after(self._tokens[rows], scaled_joints(self.geometry, joints), error)


def _policy_of(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> RememberingPolicy:
    """The policy that a file's parts make; raises an error of any kind where they make none."""
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
