"""The arithmetic that the simulation runs on: Python floats, NumPy arrays, torch tensors, or machine code.

An executor bundles the functions that kinematics uses with the arithmetic of 64-bit integers modulo 2^64 for the random
streams. `pickenv.arm.kinematics.forward` has the functions that math, NumPy and torch name differently. torch is
imported only when its executor is first used.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Scalar
from pickenv.base import require

Flags = NDArray[np.bool_]
"""Array of booleans, for example one per environment or one per fruit."""

Rows = NDArray[np.intp]
"""Array of indices of environments, counted from 0."""

MASK = 2**64 - 1


@dataclass(frozen=True)
class Executor:
    """One kind of arithmetic to run the simulation with.

    Attributes:
        name: "floats", "numpy", "torch" or "compiled".
        m: Namespace with sin, cos, sqrt, log, log10.
        times: Product of 64-bit words with a constant, modulo 2^64.
        plus: Sum of two 64-bit words, modulo 2^64.
        shifted: A 64-bit word shifted to the right by a constant number of bits, filled with zeros.
        unit: Uniform number in [0, 1) from the upper 53 bits of a word.
        word: The 64-bit word of a Python integer, modulo 2^64.
        spares_constants: Whether factors and summands that are always 0 or 1 (`pickenv.envs.shared.task.Exact`) are
            skipped. That pays off if every operation runs on a whole array.
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
        """Pickle and copy the executor by its name, since modules and lambdas cannot be pickled."""
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
"""The executor of one environment on Python floats: the fastest way to take a single step."""

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
"""The executor of many environments on NumPy arrays: one array per component, with one entry per environment."""


@lru_cache(maxsize=1)
def torch_executor() -> Executor:
    """Return the executor of many environments on torch tensors, on any device; 64-bit words are stored as int64."""
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
    """Return the executor with this name: "floats", "numpy" or "torch"."""
    return torch_executor() if name == "torch" else {executor.name: executor for executor in (FLOATS, NUMPY)}[name]


def signed(number: int) -> int:
    """Return the int64 with the same 64 bits as ``number``."""
    number &= MASK
    return number - (1 << 64) if number >> 63 else number


# Random numbers that are looked up, not drawn: each is a hash of (seed, episode, stream, draw). So an environment's
# numbers depend on its own seed alone: not on how many environments run beside it, on which executor, or on how many
# numbers the others have used. The hash is the finaliser of splitmix64 (Steele, Lea and Flood 2014, with Stafford's
# constants), applied to a Weyl sequence; uniform numbers are equal to the bit on all executors.


GOLDEN = 0x9E3779B97F4A7C15
"""Step of the Weyl sequence: an odd integer near 2^64 divided by the golden ratio."""

GOAL, FRUIT, CAMERA, ARM, DRAWN, START, JOINTS = range(1, 8)


def mixed(x: Executor, word: Scalar) -> Scalar:
    """Mix the bits of a 64-bit word by the finaliser of splitmix64, which is one-to-one."""
    word = x.times(word ^ x.shifted(word, 30), 0xBF58476D1CE4E5B9)
    word = x.times(word ^ x.shifted(word, 27), 0x94D049BB133111EB)
    return word ^ x.shifted(word, 31)


def episode_key(x: Executor, seed: Scalar, episode: Scalar) -> Scalar:
    """Compute the key of an episode, a 64-bit word, from 64-bit words: its seed, and its index from 0.

    Both may be arrays, with one entry per environment.
    """
    first = mixed(x, x.plus(seed, x.word(GOLDEN)))
    return mixed(x, x.plus(first, x.times(episode, GOLDEN)))


def stream_key(x: Executor, key: Scalar, stream: int) -> Scalar:
    """Compute the key of one random stream of the episode with the key ``key``.

    The stream `GOAL` is for the wanted pose, `FRUIT` for the noise of the fruit as the camera saw it, and `CAMERA` for
    the camera's noise in each step. `ARM` is for the choice of the true arm, `DRAWN` for the numbers of the situation,
    `START` for the start, and `JOINTS` for the noise of joint readings in each step.
    """
    return mixed(x, x.plus(key, x.word(stream * GOLDEN)))


def uniform(x: Executor, key: Scalar, draw: Scalar) -> Scalar:
    """Return the uniform number in [0, 1) with the index ``draw`` of the random stream with the key ``key``.

    ``draw`` counts from 0 and is an int or 64-bit words.
    """
    step = x.word(draw * GOLDEN) if isinstance(draw, int) else x.times(draw, GOLDEN)
    return x.unit(mixed(x, x.plus(key, step)))


def normal(x: Executor, key: Scalar, draw: Scalar) -> Scalar:
    """Return the standard normal number with index ``draw`` (from 0) of the stream ``key`` (Box and Muller 1958).

    It is computed from the stream's uniform numbers with the indices 2 ``draw`` and 2 ``draw`` + 1.
    """
    first = 2 * draw if isinstance(draw, int) else x.times(draw, 2)
    second = first + 1 if isinstance(draw, int) else x.plus(first, x.word(1))
    radius = x.m.sqrt(-2.0 * x.m.log(1.0 - uniform(x, key, first)))
    return radius * x.m.cos(math.tau * uniform(x, key, second))


def seed_word(seed: int) -> int:
    """Reduce a seed of any size to a 64-bit word; seeds below 2^64 stay as they are."""
    word = seed & MASK
    while seed := seed >> 64:
        word ^= seed & MASK
    return word


def fresh_seed(generator: Any) -> int:
    """Draw a seed from an environment's own generator, for a reset without a seed."""
    return int(generator.integers(2**63))


def words_of_state(state: Mapping[str, Any]) -> list[int]:
    """Convert the state of a Gymnasium generator (PCG64) to six 64-bit words."""
    inner = state["state"]
    wide = [word for number in (inner["state"], inner["inc"]) for word in (number >> 64, number & MASK)]
    return [*wide, state["has_uint32"], state["uinteger"]]


def state_of_words(words: Iterable[int]) -> dict[str, Any]:
    """Convert the six words that `words_of_state` returned back to the state of a generator (PCG64)."""
    high, low, high_step, low_step, has, last = map(int, words)
    numbers = {"state": high << 64 | low, "inc": high_step << 64 | low_step}
    return {"bit_generator": "PCG64", "state": numbers, "has_uint32": has, "uinteger": last}
