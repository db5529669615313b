"""Learned policies: an actor's weights in one file with a checksum, loaded without executing code and run by NumPy."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from pickenv.agents.policies.policy import ReachController, joined_parts
from pickenv.arm import Arm, Array, load_arm
from pickenv.base import InputError, npz_path, read_container, refusing_damage, write_container
from pickenv.wrappers import Scaling, ToolSteps, joined_observation

KIND = "policy"
FORMAT = 2
"""Version of the policy file's format."""

REMAKE = "run `pickenv train` to make one anew"


ACTIVATIONS: Mapping[str, Callable[[Array], Array]] = {"tanh": np.tanh, "relu": lambda values: np.maximum(values, 0.0)}
BASELINES = Path(__file__).parent / "baselines"


@dataclass(frozen=True, eq=False, kw_only=True)
class Actor:
    """Network layers of a trained policy, with the algorithm and the arm of its training.

    Attributes:
        algorithm: Algorithm that trained the policy.
        arm: Name of the arm for which the policy was trained.
        arm_fingerprint: Hash of that arm's nominal geometry.
        weights: Weight matrix ``(inputs, outputs)`` of each layer.
        biases: Bias vector ``(outputs,)`` of each layer.
        record: Record of the training: settings, seeds, versions.
    """

    algorithm: str
    arm: str
    arm_fingerprint: str
    weights: tuple[Array, ...]
    biases: tuple[Array, ...]
    record: Mapping[str, Any]

    def through_layers(self, values: Array, activation: str) -> Array:
        """Return the last layer's output for inputs ``(..., inputs)``.

        ``activation`` is the name of the function after each layer but the last, a key of `ACTIVATIONS`.
        """
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            values = values @ weight + bias
            if i + 1 < len(self.weights):
                values = ACTIVATIONS[activation](values)
        return values

    def write(
        self, path: str | Path, kind: str, version: int, header: Mapping[str, Any], arrays: Mapping[str, Array]
    ) -> Path:
        """Write the policy to one file with a checksum (`pickenv.base.container`), completely or not at all.

        Args:
            path: File; ``.npz`` is appended if missing.
            kind: Name of the kind of policy, by which `read_actor` recognises the file.
            version: Version of the file's format.
            header: Entries of the header besides the entries of the actor.
            arrays: Arrays besides weights and biases, stored in single precision.

        Returns:
            Path of the file.
        """
        texts = {"algorithm": self.algorithm, "arm": self.arm, "arm_fingerprint": self.arm_fingerprint}
        layers = {"weight": self.weights, "bias": self.biases}
        layered = {f"{name}{i}": part for name, parts in layers.items() for i, part in enumerate(parts)}
        single = {name: np.asarray(part, dtype=np.float32) for name, part in (*arrays.items(), *layered.items())}
        header = {**texts, **header, "record": dict(self.record)}
        return write_container(npz_path(path), kind, header, single, version=version)


def actor_parts(
    header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]], inputs: int, outputs: int, others: int = 0
) -> dict[str, Any]:
    """Return the attributes of an `Actor` from the content of a policy file.

    Args:
        header: Header of the file.
        arrays: Arrays of the file by name.
        inputs: Number of inputs of the first layer.
        outputs: Number of outputs of the last layer.
        others: Number of arrays that belong to no layer.

    Raises:
        Exception: Any type of exception, if the file does not hold an `Actor`.
    """
    layers = (len(arrays) - others) // 2
    weights, biases = (tuple(arrays[f"{name}{i}"].astype(float) for i in range(layers)) for name in ("weight", "bias"))
    widths = [inputs, *(len(bias) for bias in biases)]
    if layers == 0 or len(arrays) != 2 * layers + others or widths[-1] != outputs:
        raise InputError(f"its layers have {widths} numbers, but must lead to {outputs}")
    for i, (weight, bias) in enumerate(zip(weights, biases, strict=True)):
        if weight.shape != (widths[i], widths[i + 1]) or bias.shape != (widths[i + 1],):
            raise InputError(f"its layer {i + 1} does not fit to the layer before")
        if not (np.isfinite(weight).all() and np.isfinite(bias).all()):
            raise InputError(f"its layer {i + 1} holds numbers that are not finite")
    texts = {name: str(header[name]) for name in ("algorithm", "arm", "arm_fingerprint")}
    return {**texts, "weights": weights, "biases": biases, "record": dict(header["record"])}


AnyActor = TypeVar("AnyActor", bound=Actor)
Parts = Callable[[Mapping[str, Any], Mapping[str, NDArray[Any]]], AnyActor]


def read_actor(name: str | Path, arm: Arm | None, kind: str, version: int, make: Parts[AnyActor]) -> AnyActor:
    """Read a policy file of one kind.

    Args:
        name: Name of a shipped baseline, or path of a policy file.
        arm: Arm for which the policy must have been trained; None to skip this check.
        kind: Name of the kind of policy that the file must hold, as `Actor.write` stored it.
        version: Newest version of the file's format that is read.
        make: Function that makes the policy from the file's header and arrays. If it cannot, it raises any type of
            exception.

    Raises:
        InputError: If the file is missing, damaged, newer than this program, or of another arm.
    """
    path = policy_path(name)
    container = read_container(path, kind, remake=REMAKE, version=version)
    with refusing_damage(path, f"a {kind}{' file' * (kind == KIND)}", REMAKE):
        policy = make(container.header, container.arrays)
    if arm is not None and policy.arm_fingerprint != arm.fingerprint():
        raise InputError(f"{path} was trained for arm '{policy.arm}', not for '{arm.name}'; train one for this arm")
    return policy


@dataclass(frozen=True, eq=False, kw_only=True)
class LearnedPolicy(Actor):
    """Trained feed-forward actor that acts deterministically.

    Attributes:
        scaling: Scaling of observations and actions.
        activation: Activation of the hidden layers, one of `ACTIVATIONS`.
        squashed: Whether the output passes through a hyperbolic tangent; otherwise it is clipped to -1 to 1.
    """

    scaling: Scaling | ToolSteps
    activation: str
    squashed: bool

    @property
    def moves_tool(self) -> bool:
        """Whether the policy was trained on `pickenv/ReachTool-v0`."""
        return isinstance(self.scaling, Scaling) and self.scaling.tool > 0

    def reset(self) -> None:
        """Do nothing: the policy keeps no state."""

    def act(self, observation: Any) -> NDArray[np.float32]:
        """Return actions ``(..., n)`` for observations ``(..., k)``, or for goal observations (dictionaries).

        A policy for `pickenv/ReachTool-v0` reads and returns scaled numbers, as this environment gives and takes them.
        For any other environment, the policy scales its observations and actions by `scaling`.

        Raises:
            InputError: If the observation is of another kind than the observations of the training.
        """
        values, scaling = joined_observation(observation), self.scaling
        if isinstance(scaling, Scaling) and not isinstance(observation, dict):
            scaling = replace(scaling, goal=False)  # a flat observation holds the gap that its goal observation would
        scaled = self.moves_tool
        scaling.check(values.shape[-1], scaled)
        seen = values if scaled else scaling.observe(values, np)
        layer = self.through_layers(np.asarray(seen, dtype=float), self.activation)
        action = np.tanh(layer) if self.squashed else layer.clip(-1.0, 1.0)
        return np.asarray(action if scaled else scaling.commands(values, action), dtype=np.float32)

    def save(self, path: str | Path) -> Path:
        """Write the policy to one file with a checksum; ``.npz`` is appended if missing."""
        scaling = asdict(self.scaling) if isinstance(self.scaling, Scaling) else self.scaling.header
        header = {"scaling": scaling, "activation": self.activation, "squashed": self.squashed}
        return self.write(path, KIND, FORMAT, header, {})


class LearnedReach(ReachController):
    """Trained actor that first corrects its observations for the delays of readings and actions.

    Joints and gaps are predicted from the actions already sent; see `ReachController`.
    """

    def __init__(self, env: Any, policy: LearnedPolicy) -> None:
        """Read the nominal arm and the delays from ``env``; ``policy`` is the trained actor."""
        super().__init__(env)
        self.policy = policy

    def act(self, observation: Any) -> NDArray[np.float32]:
        """Return actions as `LearnedPolicy.act` does; goal observations are used without correction."""
        if not self.lag or isinstance(observation, dict):
            return self.policy.act(observation)
        shares = self.policy.act(joined_parts(self.geometry, self.present(observation)))
        self.sent(shares)
        return shares


def shipped_baselines() -> list[str]:
    """Return the names of the policies that come with pickenv."""
    return sorted(path.stem for path in BASELINES.glob("*.npz"))


def load_policy(name: str | Path, arm: Arm | None = None) -> LearnedPolicy:
    """Load a shipped baseline or a policy file; nothing in it is executed.

    Args:
        name: Name of a shipped baseline, or path of a policy file (.npz).
        arm: Arm for which the policy must have been trained; None to skip this check.

    Raises:
        InputError: If the file is missing, damaged, newer than this program, or of another arm.
    """
    return read_actor(name, arm, KIND, FORMAT, _from_parts)


def policy_path(name: str | Path) -> Path:
    """Return the path of a shipped baseline, or the given path of a policy file.

    Raises:
        InputError: If there is no such baseline or file.
    """
    path = Path(name) if Path(name).suffix == ".npz" else BASELINES / f"{name}.npz"
    if path.is_file():
        return path
    names = ", ".join(shipped_baselines())
    raise InputError(f"unknown policy '{name}'; give one of {names}, or a file (.npz) that `pickenv train` wrote")


def _from_parts(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> LearnedPolicy:
    """Make the policy that a file's header and arrays describe; raise any type of exception if they describe none."""
    scaling: Scaling | ToolSteps
    if "increment" in header["scaling"]:  # a picking policy moves the tool of an arm that has a name
        scaling = ToolSteps(load_arm(header["arm"]).nominal, np.array(header["scaling"]["increment"], dtype=float))
    else:
        scaling = Scaling(**header["scaling"])
    parts = actor_parts(header, arrays, scaling.features, scaling.outputs)
    if header["activation"] not in ACTIVATIONS:
        raise InputError(f"its activation is {header['activation']!r}, not {' or '.join(ACTIVATIONS)}")
    return LearnedPolicy(**parts, scaling=scaling, activation=header["activation"], squashed=bool(header["squashed"]))
