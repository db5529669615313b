"""Learned policies as files: the actor's weights in a NumPy archive, run by NumPy, loaded without executing code."""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agents.scaling import Scaling, flattened
from pickenv.arm import Arm
from pickenv.arm.geometry import Array
from pickenv.errors import InputError
from pickenv.files import write_whole

FORMAT = 1
"""Version of the file format."""

DAMAGE = (OSError, EOFError, ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile, zlib.error)
"""What reading a file that is no policy can raise."""


def _relu(values: Array) -> Array:
    return np.maximum(values, 0.0)


def _tanh(values: Array) -> Array:
    return np.asarray(np.tanh(values))


ACTIVATIONS = {"tanh": _tanh, "relu": _relu}
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
    scaling: Scaling
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
        values = flattened(observation)
        if self.scaling.goal and not isinstance(observation, dict):
            values = self._goal(values)
        self.scaling.check(values.shape[-1])
        layer = np.asarray(self.scaling.observe(values, np), dtype=float)
        for i, (weight, bias) in enumerate(zip(self.weights, self.biases, strict=True)):
            layer = layer @ weight + bias
            if i + 1 < len(self.weights):
                layer = ACTIVATIONS[self.activation](layer)
        action = np.tanh(layer) if self.squashed else layer.clip(-1.0, 1.0)
        return np.asarray(action * self.scaling.share(values, np), dtype=np.float32)

    def _goal(self, values: Any) -> Any:
        """A flat observation as the goal environment would give it."""
        n, camera = self.scaling.joints, self.scaling.camera
        if values.shape[-1] != n + 12 + 3 * camera:
            return values  # `Scaling.check` says what is wrong
        achieved = values[..., n + 3 : n + 6] - values[..., n + 12 :] if camera else values[..., n : n + 3]
        parts = (values[..., : n + 3], values[..., n + 9 : n + 12], achieved, values[..., n + 3 : n + 6])
        return np.concatenate(parts, axis=-1)

    def save(self, path: str | Path) -> Path:
        """Write one file (NumPy archive, no pickle), whole or not at all; ``.npz`` is appended if missing."""
        header = {
            "format": FORMAT,
            "kind": "policy",
            "algorithm": self.algorithm,
            "arm": self.arm,
            "arm_fingerprint": self.arm_fingerprint,
            "scaling": asdict(self.scaling),
            "activation": self.activation,
            "squashed": self.squashed,
            "record": dict(self.record),
        }
        arrays = {f"weight{i}": np.asarray(value, dtype=np.float32) for i, value in enumerate(self.weights)}
        arrays |= {f"bias{i}": np.asarray(value, dtype=np.float32) for i, value in enumerate(self.biases)}

        def write(temporary: Path) -> None:
            with temporary.open("wb") as file:
                np.savez(file, allow_pickle=False, header=np.array(json.dumps(header)), **arrays)

        path = Path(path)
        return write_whole(path if path.suffix == ".npz" else path.with_name(path.name + ".npz"), write)


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
    path = Path(name)
    if path.suffix != ".npz":
        path = BASELINES / f"{name}.npz"
    if not path.is_file():
        raise InputError(
            f"unknown policy '{name}'; give one of {', '.join(shipped_baselines()) or 'none shipped'}, or a file "
            "(.npz) that `pickenv train` wrote"
        )
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            arrays = {key: archive[key] for key in archive.files}
        header = json.loads(str(arrays.pop("header")))
        if header["kind"] != "policy":
            raise KeyError("kind")
        newer = int(header["format"]) > FORMAT
        layers = sum(key.startswith("weight") for key in arrays)
        policy = LearnedPolicy(
            algorithm=header["algorithm"],
            arm=header["arm"],
            arm_fingerprint=header["arm_fingerprint"],
            scaling=Scaling(**header["scaling"]),
            activation=header["activation"],
            squashed=bool(header["squashed"]),
            weights=tuple(arrays[f"weight{i}"].astype(float) for i in range(layers)),
            biases=tuple(arrays[f"bias{i}"].astype(float) for i in range(layers)),
            record=header["record"],
        )
        fits = layers > 0 and policy.weights[0].shape[0] == policy.scaling.features
        if not fits or policy.activation not in ACTIVATIONS:
            raise ValueError("its layers do not fit together")
    except DAMAGE as error:
        raise InputError(f"{path} is not a policy file or is damaged ({error}); train it again") from error
    if newer:
        raise InputError(f"{path} has format {header['format']}, this program reads up to {FORMAT}; update pickenv")
    if arm is not None and policy.arm_fingerprint != arm.fingerprint():
        raise InputError(f"{path} was trained for arm '{policy.arm}', not for '{arm.name}'; train one for this arm")
    return policy
