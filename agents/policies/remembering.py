"""Policies that remember what the camera saw at past picks, and aim by it: learned calibration while picking.

What they learnt on is `pickenv.wrappers.SameArm`: before each pick they say how far to aim beside the fruit. One that
is recurrent (LSTM) sees the last pick and keeps a state, one with a window sees the last picks and weighs them by how
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
from pickenv.agents.policies.learned import REMAKE, check_trained_for, layer_arrays, policy_path
from pickenv.arm import Arm, Array, forward
from pickenv.base import InputError, npz_path, read_container, refusing_damage, write_container
from pickenv.wrappers import PickMemory
from pickenv.wrappers.same_arm import scaled_joints

REMEMBERING, REMEMBERING_FORMAT = "policy with a memory", 1

HEADS = 4
"""Ways in which a window's picks are weighed."""

STEEPEST = 20.0
"""Largest size of a weight's logarithm."""

LSTM = ("input", "input_bias", "state", "state_bias")
WINDOW = ("near", "near_bias", "query", "key", "value", "value_bias")
"""Arrays of the two kinds of memory, inputs first."""

State = tuple[Array, Array]
"""Of a recurrent policy: what it puts out and what it keeps, ``(N, units)`` each."""


def attended(xp: Any, given: Mapping[str, Any], memory: PickMemory, seen: Any) -> Any:
    """What a window's picks say about the next one, on NumPy or torch.

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
    here = seen[:, :n]
    tokens = seen[:, n:].reshape(-1, window, memory.token)
    joints, error, known = tokens[..., :n], tokens[..., n : n + 3], tokens[..., n + 3]
    near = xp.tanh(joints @ given["near"] + given["near_bias"])
    key = (near @ given["key"]).reshape(-1, window, HEADS, given["key"].shape[1] // HEADS)
    asked = xp.tanh(here @ given["near"] + given["near_bias"]) @ given["query"]
    query = asked.reshape(-1, 1, HEADS, key.shape[-1])
    weights = xp.exp(xp.clip((key * query).sum(-1), -STEEPEST, STEEPEST)) * known[..., None]
    weights = weights / (weights.sum(1)[:, None] + 1e-12)
    made = xp.tanh(xp.concatenate((near, error), -1) @ given["value"] + given["value_bias"])
    value = xp.concatenate((error, made), -1)
    pooled = (weights[..., None] * value[:, :, None]).sum(1)
    return xp.concatenate((here, pooled.reshape(len(seen), -1), known.sum(1)[:, None] / window), -1)


def stepped(given: Mapping[str, Array], seen: Array, state: State) -> State:
    """An LSTM's next state, gates in torch's order: input, forget, cell, output (Hochreiter and Schmidhuber 1997)."""
    out, cell = state
    gates = seen @ given["input"] + given["input_bias"] + out @ given["state"] + given["state_bias"]
    take, keep, new, give = np.split(gates, 4, axis=-1)
    take, keep, give = (1.0 / (1.0 + np.exp(-part)) for part in (take, keep, give))
    cell = keep * cell + take * np.tanh(new)
    return give * np.tanh(cell), cell


@dataclass(frozen=True, eq=False)
class RememberingPolicy:
    """A trained actor with a memory, acting without noise.

    Attributes:
        algorithm: What trained it.
        arm: Name of the arm it was trained for.
        arm_fingerprint: Hash of that arm's nominal geometry.
        memory: How its observations are laid out.
        arrays: Arrays of `LSTM` or of `WINDOW`, by name.
        weights: One matrix ``(inputs, outputs)`` per layer after the memory.
        biases: One vector per layer.
        record: How it was trained: settings, seeds, versions.
    """

    algorithm: str
    arm: str
    arm_fingerprint: str
    memory: PickMemory
    arrays: Mapping[str, Array]
    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    record: Mapping[str, Any]

    @property
    def recurrent(self) -> bool:
        """Whether it keeps a state."""
        return set(self.arrays) == set(LSTM)

    def begin(self, rows: int) -> State:
        """The state of arms that have not picked yet; nothing of a policy with a window."""
        units = len(self.arrays["state"]) if self.recurrent else 0
        return np.zeros((rows, units)), np.zeros((rows, units))

    def aim(self, seen: NDArray[Any], state: State) -> tuple[NDArray[np.float32], State]:
        """How far to aim beside the fruit, as `pickenv.wrappers.SameArmVector` takes it, and the next state.

        Args:
            seen: Observations ``(N, inputs)`` of that wrapper.
            state: From `begin`, or of the pick before.

        Raises:
            InputError: If the observations have another length.
        """
        if seen.shape[-1] != self.memory.inputs:
            raise InputError(
                f"the policy was trained on observations of {self.memory.inputs} numbers, but was given "
                f"{seen.shape[-1]}; use the window and the arm of its training"
            )
        values = np.asarray(seen, dtype=float)
        if self.recurrent:
            state = stepped(self.arrays, values, state)
            layer = state[0]
        else:
            layer = attended(np, self.arrays, self.memory, values)
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            layer = layer @ weight + bias
            layer = np.tanh(layer) if i + 1 < len(self.weights) else layer
        return layer.clip(-1.0, 1.0).astype(np.float32), state

    def save(self, path: str | Path) -> Path:
        """Write one verified file (`pickenv.base.container`), whole or not at all; ``.npz`` is appended if missing."""
        header = {
            "algorithm": self.algorithm,
            "arm": self.arm,
            "arm_fingerprint": self.arm_fingerprint,
            "memory": asdict(self.memory),
            "record": dict(self.record),
        }
        arrays = {name: np.asarray(value, dtype=np.float32) for name, value in self.arrays.items()}
        arrays |= layer_arrays(self.weights, self.biases)
        return write_container(npz_path(path), REMEMBERING, header, arrays, version=REMEMBERING_FORMAT)


def load_remembering(name: str | Path, arm: Arm | None = None) -> RememberingPolicy:
    """Read a policy with a memory by the name of a shipped baseline or from a path; nothing in it is executed.

    Args:
        name: Name or path.
        arm: If given, the arm that it must have been trained for.

    Raises:
        InputError: If it is missing, damaged, newer than this program, or of another arm.
    """
    path = policy_path(name)
    found = read_container(path, REMEMBERING, remake=REMAKE, version=REMEMBERING_FORMAT)
    with refusing_damage(path, f"a {REMEMBERING}", REMAKE):
        policy = _policy_of(found.header, found.arrays)
    check_trained_for(arm, path, policy.arm, policy.arm_fingerprint)
    return policy


def remembers(name: str | Path) -> bool:
    """Whether a shipped baseline or a file is of a policy with a memory; False where it is no such file at all."""
    try:
        path = policy_path(name)
    except InputError:
        return False
    return read_container(path, None, remake=REMAKE).kind == REMEMBERING


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

    def _corrected(self, joints: Array) -> Array:
        if len(self._tokens) != len(joints):
            self._tokens, self._state = self.policy.memory.empty(len(joints)), self.policy.begin(len(joints))
        seen = self.policy.memory.shown(scaled_joints(self.geometry, joints), self._tokens)
        actions, self._state = self.policy.aim(seen, self._state)
        return self.policy.memory.aim(self.geometry, joints, actions)

    def _learn(self, rows: NDArray[np.intp], joints: Array, seen: Array) -> None:
        error = seen - forward(self.geometry, joints).position
        self._tokens = self._tokens.copy()
        self._tokens[rows] = self.policy.memory.after(self._tokens[rows], scaled_joints(self.geometry, joints), error)


def _policy_of(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> RememberingPolicy:
    """The policy that a file's parts make; raises anything at all where they make none."""
    kind = LSTM if "state" in arrays else WINDOW
    layers = (len(arrays) - len(kind)) // 2
    weights, biases = ([arrays[f"{name}{i}"].astype(float) for i in range(layers)] for name in ("weight", "bias"))
    if len(arrays) != len(kind) + 2 * layers or layers == 0 or weights[-1].shape[1] != 3:
        raise InputError("its arrays are not those of a memory and of layers that lead to three numbers")
    if not all(np.isfinite(value).all() for value in arrays.values()):
        raise InputError("its arrays hold numbers that are not finite")
    policy = RememberingPolicy(
        algorithm=str(header["algorithm"]),
        arm=str(header["arm"]),
        arm_fingerprint=str(header["arm_fingerprint"]),
        memory=PickMemory(**header["memory"]),
        arrays={name: arrays[name].astype(float) for name in kind},
        weights=tuple(weights),
        biases=tuple(biases),
        record=dict(header["record"]),
    )
    policy.aim(np.zeros((1, policy.memory.inputs)), policy.begin(1))  # shapes that do not fit raise here
    return policy
