"""Random numbers that are looked up, not drawn: each is a hash of (seed, episode, stream, draw).

So an environment's numbers depend on its own seed alone: not on how many environments run beside it, on which executor,
or on how many numbers the others have used. The hash is the finaliser of splitmix64 (Steele, Lea and Flood 2014, with
Stafford's constants), applied to a Weyl sequence; uniform numbers are equal to the bit on all executors.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from pickenv.arm.kinematics.forward import Scalar
from pickenv.envs.shared.backends import MASK, Executor

GOLDEN = 0x9E3779B97F4A7C15
"""2^64 divided by the golden ratio, odd: the step of the Weyl sequence."""

GOAL, FRUIT, CAMERA, ARM, DRAWN, START, JOINTS = range(1, 8)
"""Streams of one episode: the wanted pose, the fruit as the camera saw it, the camera in each step, the true arm, what
else is drawn for the episode, where it starts, the joints' readings in each step."""


def mixed(x: Executor, word: Scalar) -> Scalar:
    """A 64-bit word with its bits thoroughly mixed, one to one."""
    word = x.times(word ^ x.shifted(word, 30), 0xBF58476D1CE4E5B9)
    word = x.times(word ^ x.shifted(word, 27), 0x94D049BB133111EB)
    return word ^ x.shifted(word, 31)


def episode_key(x: Executor, seed: Scalar, episode: Scalar) -> Scalar:
    """Key of an episode: 64-bit words (or arrays of them) in, a word out."""
    first = mixed(x, x.plus(seed, x.word(GOLDEN)))
    return mixed(x, x.plus(first, x.times(episode, GOLDEN)))


def stream_key(x: Executor, key: Scalar, stream: int) -> Scalar:
    """Key of one of an episode's streams."""
    return mixed(x, x.plus(key, x.word(stream * GOLDEN)))


def uniform(x: Executor, key: Scalar, draw: Scalar) -> Scalar:
    """Uniform number in [0, 1): the one numbered ``draw`` of the stream ``key``; an int, or words like ``key``."""
    step = x.word(draw * GOLDEN) if isinstance(draw, int) else x.times(draw, GOLDEN)
    return x.unit(mixed(x, x.plus(key, step)))


def normal(x: Executor, key: Scalar, draw: Scalar) -> Scalar:
    """Standard normal number (Box and Muller 1958); it uses up the uniform numbers 2 ``draw`` and 2 ``draw`` + 1."""
    first = 2 * draw if isinstance(draw, int) else x.times(draw, 2)
    second = first + 1 if isinstance(draw, int) else x.plus(first, x.word(1))
    radius = x.m.sqrt(-2.0 * x.m.log(1.0 - uniform(x, key, first)))
    return radius * x.m.cos(math.tau * uniform(x, key, second))


def seed_word(seed: int) -> int:
    """A seed of any size as 64 bits; seeds below 2^64 stay as they are."""
    word = 0
    while True:
        word ^= seed & MASK
        seed >>= 64
        if not seed:
            return word


def fresh_seed(generator: Any) -> int:
    """A seed for an environment that was given none, from its own generator."""
    return int(generator.integers(2**63))


def words_of_state(state: Mapping[str, Any]) -> list[int]:
    """The state of a generator of Gymnasium's (PCG64) as six words of 64 bits."""
    inner = state["state"]
    wide = [word for number in (inner["state"], inner["inc"]) for word in (number >> 64, number & MASK)]
    return [*wide, state["has_uint32"], state["uinteger"]]


def state_of_words(words: Iterable[int]) -> dict[str, Any]:
    """The inverse of `words_of_state`."""
    high, low, high_step, low_step, has, last = map(int, words)
    numbers = {"state": high << 64 | low, "inc": high_step << 64 | low_step}
    return {"bit_generator": "PCG64", "state": numbers, "has_uint32": has, "uinteger": last}
