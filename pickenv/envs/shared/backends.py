"""The arithmetic that the simulation runs on: Python floats, NumPy arrays, torch tensors, or machine code.

An executor bundles the namespace of kinematics (`pickenv.arm.kinematics.backend` has what the three spell
differently) with 64-bit integers modulo 2^64 for the random streams. torch is imported when its executor is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from types import ModuleType

import numpy as np

from pickenv.arm.kinematics.forward import Scalar as Scalar
from pickenv.base import require

MASK = 2**64 - 1


@dataclass(frozen=True)
class Executor:
    """One way to run the simulation.

    Attributes:
        name: "floats", "numpy", "torch" or "compiled".
        m: Namespace with sin, cos, sqrt, log, log10.
        times: Product of 64-bit words with a constant, modulo 2^64.
        plus: Sum of two 64-bit words, modulo 2^64.
        shifted: A 64-bit word shifted to the right by a constant, zeros moving in.
        unit: Uniform number in [0, 1) from the upper 53 bits of a word.
        word: A 64-bit word from Python integers in [0, 2^64).
        spares_constants: Whether `pickenv.envs.shared.task` pays: where every operation walks through an array.
    """

    name: str
    m: ModuleType
    times: Callable[[Scalar, int], Scalar]
    plus: Callable[[Scalar, Scalar], Scalar]
    shifted: Callable[[Scalar, int], Scalar]
    unit: Callable[[Scalar], Scalar]
    word: Callable[[int], Scalar]
    spares_constants: bool = False

    def __reduce__(self) -> tuple[Callable[[str], Executor], tuple[str]]:
        """Pickled and copied by name: modules and lambdas are neither."""
        return executor_named, (self.name,)


FLOATS = Executor(
    name="floats",
    m=math,
    times=lambda word, constant: (word * constant) & MASK,
    plus=lambda word, other: (word + other) & MASK,
    shifted=lambda word, bits: word >> bits,
    unit=lambda word: (word >> 11) * 2.0**-53,
    word=lambda number: number & MASK,
)
"""One environment on Python floats: the fastest way to take a single step."""

NUMPY = Executor(
    name="numpy",
    m=np,
    times=lambda word, constant: word * np.uint64(constant),
    plus=lambda word, other: word + other,
    shifted=lambda word, bits: word >> np.uint64(bits),
    unit=lambda word: (word >> np.uint64(11)).astype(np.float64) * 2.0**-53,
    word=lambda number: np.uint64(number & MASK),
    spares_constants=True,
)
"""Batches of environments as NumPy arrays, one array per component."""


@lru_cache(maxsize=1)
def torch_executor() -> Executor:
    """Batches of environments as torch tensors on any device; 64-bit words are kept in int64."""
    require("torch")
    import torch

    def shifted(word: Scalar, bits: int) -> Scalar:
        return (word >> bits) & ((1 << (64 - bits)) - 1)

    return Executor(
        name="torch",
        m=torch,
        times=lambda word, constant: word * signed(constant),
        plus=lambda word, other: word + other,
        shifted=shifted,
        unit=lambda word: shifted(word, 11).to(torch.float64) * 2.0**-53,
        word=signed,
    )


def executor_named(name: str) -> Executor:
    """One of the executors, by its name."""
    return torch_executor() if name == "torch" else {one.name: one for one in (FLOATS, NUMPY)}[name]


def signed(number: int) -> int:
    """The int64 that has the same 64 bits as ``number``."""
    number &= MASK
    return number - (1 << 64) if number >> 63 else number
