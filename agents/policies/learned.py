"""Learned policies as files: the actor's weights in one verified file, run by NumPy, loaded without executing code."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Arm, Array, load_arm
from pickenv.base import InputError, npz_path, read_container, refusing_damage, write_container
from pickenv.wrappers.gap import Scaling, joined_observation
from pickenv.wrappers.tool_steps import ToolSteps

KIND = "policy"
FORMAT = 2
"""Version of the file's content."""

REMAKE = "run `pickenv train` to make one anew"


ACTIVATIONS: Mapping[str, Callable[[Array], Array]] = {"tanh": np.tanh, "relu": lambda values: np.maximum(values, 0.0)}
BASELINES = Path(__file__).parent / "baselines"


@dataclass(frozen=True, eq=False)
class LearnedPolicy:
    """A trained actor, acting without noise.

    Attributes:
        algorithm: What trained it.
        arm: Name of the arm it was trained for.
        arm_fingerprint: Hash of that arm's nominal geometry.
        scaling: What it sees, and what its actions are multiplied by.
        activation: Of the hidden layers, of `ACTIVATIONS`.
        squashed: Whether the last layer ends in a hyperbolic tangent; else actions are clipped.
        weights: One matrix ``(inputs, outputs)`` per layer.
        biases: One vector per layer.
        record: How it was trained: settings, seeds, versions.
    """

    algorithm: str
    arm: str
    arm_fingerprint: str
    scaling: Scaling | ToolSteps
    activation: str
    squashed: bool
    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    record: Mapping[str, Any]

    def reset(self) -> None:
        """Nothing to forget."""

    def act(self, observation: Any) -> NDArray[np.float32]:
        """Actions ``(..., n)`` for observations ``(..., k)``, or for goal observations.

        Raises:
            InputError: If the observation is not of the kind that it was trained on.
        """
        values, scaling = joined_observation(observation), self.scaling
        if isinstance(scaling, Scaling) and not isinstance(observation, dict):
            scaling = replace(scaling, goal=False)  # a flat observation holds the gap that its goal observation would
        scaling.check(values.shape[-1])
        layer = np.asarray(scaling.observe(values, np), dtype=float)
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            layer = layer @ weight + bias
            if i + 1 < len(self.weights):
                layer = ACTIVATIONS[self.activation](layer)
        action = np.tanh(layer) if self.squashed else layer.clip(-1.0, 1.0)
        return np.asarray(scaling.commands(values, action), dtype=np.float32)

    def save(self, path: str | Path) -> Path:
        """Write one verified file (`pickenv.base.container`), whole or not at all; ``.npz`` is appended if missing."""
        header = {
            "algorithm": self.algorithm,
            "arm": self.arm,
            "arm_fingerprint": self.arm_fingerprint,
            "scaling": asdict(self.scaling) if isinstance(self.scaling, Scaling) else self.scaling.header,
            "activation": self.activation,
            "squashed": self.squashed,
            "record": dict(self.record),
        }
        return write_container(npz_path(path), KIND, header, layer_arrays(self.weights, self.biases), version=FORMAT)


def shipped_baselines() -> list[str]:
    """Names of the policies that come with pickenv."""
    return sorted(path.stem for path in BASELINES.glob("*.npz"))


def load_policy(name: str | Path, arm: Arm | None = None) -> LearnedPolicy:
    """Read a policy by the name of a shipped baseline or from a path; nothing in it is executed.

    Args:
        name: Name or path.
        arm: If given, the arm that it must have been trained for.

    Raises:
        InputError: If it is missing, damaged, newer than this program, or of another arm.
    """
    path = policy_path(name)
    found = read_container(path, KIND, remake=REMAKE, version=FORMAT)
    with refusing_damage(path, f"a {KIND} file", REMAKE):
        policy = _from_parts(found.header, found.arrays)
    check_trained_for(arm, path, policy.arm, policy.arm_fingerprint)
    return policy


def check_trained_for(arm: Arm | None, path: Path, name: str, fingerprint: str) -> None:
    """Refuse a file's policy, trained for the arm of this name and fingerprint, where another arm is given.

    Raises:
        InputError: If it is another.
    """
    if arm is not None and fingerprint != arm.fingerprint():
        raise InputError(f"{path} was trained for arm '{name}', not for '{arm.name}'; train one for this arm")


def layer_arrays(weights: Sequence[Array], biases: Sequence[Array]) -> dict[str, NDArray[np.float32]]:
    """Layers as a file holds them, in single precision."""
    named = ((name, values) for name, values in (("weight", weights), ("bias", biases)))
    return {f"{name}{i}": np.asarray(each, dtype=np.float32) for name, values in named for i, each in enumerate(values)}


def policy_path(name: str | Path) -> Path:
    """File of a shipped baseline, or the path that was given.

    Raises:
        InputError: If there is neither.
    """
    path = Path(name) if Path(name).suffix == ".npz" else BASELINES / f"{name}.npz"
    if path.is_file():
        return path
    raise InputError(
        f"unknown policy '{name}'; give one of {', '.join(shipped_baselines()) or 'none shipped'}, or a file "
        "(.npz) that `pickenv train` wrote"
    )


def _from_parts(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> LearnedPolicy:
    """The policy that a file's parts make; raises anything at all where they make none."""
    layers = len(arrays) // 2
    scaling: Scaling | ToolSteps
    if "increment" in header["scaling"]:  # a picking policy moves the tool of an arm that has a name
        scaling = ToolSteps(load_arm(header["arm"]).nominal, np.array(header["scaling"]["increment"], dtype=float))
    else:
        scaling = Scaling(**header["scaling"])
    weights, biases = ([arrays[f"{name}{i}"] for i in range(layers)] for name in ("weight", "bias"))
    widths = [scaling.features, *(len(bias) for bias in biases)]
    if layers == 0 or len(arrays) != 2 * layers or widths[-1] != scaling.outputs:
        raise InputError(f"its layers have {widths} numbers, but must lead to {scaling.outputs}")
    for i, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        if weight.shape != (widths[i], widths[i + 1]) or bias.shape != (widths[i + 1],):
            raise InputError(f"its layer {i + 1} does not fit to the layer before")
        if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            raise InputError(f"its layer {i + 1} holds numbers that are not finite")
    if header["activation"] not in ACTIVATIONS:
        raise InputError(f"its activation is {header['activation']!r}, not {' or '.join(ACTIVATIONS)}")
    return LearnedPolicy(
        algorithm=str(header["algorithm"]),
        arm=str(header["arm"]),
        arm_fingerprint=str(header["arm_fingerprint"]),
        scaling=scaling,
        activation=header["activation"],
        squashed=bool(header["squashed"]),
        weights=tuple(weight.astype(float) for weight in weights),
        biases=tuple(bias.astype(float) for bias in biases),
        record=dict(header["record"]),
    )
