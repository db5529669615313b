"""The situation of an episode: delays and noise of acting and sensing, hours since switch-on, and the start.

Each of these is a number, or a range from which every episode draws a number. The functions work on components (one
float, array or tensor for each number of a vector), as in `pickenv.envs.shared.simulation`. Arguments left at
their defaults cost no time and change no bit of the results. Units: s, rad, m.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from pickenv.arm import Scalar, Scalars, chosen, clipped
from pickenv.base import InputError, shown
from pickenv.envs.shared.backends import DRAWN, START, Executor, stream_key, uniform

CONTROL_PERIOD = 0.1
"""Default time between two actions, s: multiplied by a joint's speed in the arm file, it is the largest increment."""

MOST_STEPS, MOST_HOURS = 20, 1000.0

Components = tuple[Scalar, ...]
Given = float | Sequence[float]  # a number, or a range as [least, largest]


class Span(NamedTuple):
    """Range of a number that each episode draws uniformly.

    If both ends are equal, the number is constant. If both ends are ints, the number is whole.
    """

    low: float
    high: float

    @property
    def varies(self) -> bool:
        """Whether the number is drawn for each episode, which is so if the ends differ."""
        return self.low != self.high


@dataclass(frozen=True)
class Situation:
    """Delays, noise and start of an environment's episodes; SI units.

    Attributes:
        period: Time between two actions, s.
        latency: Number of periods by which readings of joints and camera are late.
        delay: Number of periods by which actions are late.
        joint_noise: Standard deviation of a joint's reading, rad or m.
        hours: Time for which the arm has been switched on when an episode begins, h.
        spread: Share of each joint's range, about mid-range, from which starts are drawn.
    """

    period: Span
    latency: Span
    delay: Span
    joint_noise: Span
    hours: Span
    spread: float

    @cached_property
    def drawn(self) -> tuple[str, ...]:
        """Names of the attributes that are drawn for each episode."""
        values = ((part.name, getattr(self, part.name)) for part in fields(self))
        return tuple(name for name, value in values if isinstance(value, Span) and value.varies)

    @property
    def frames_per_second(self) -> float:
        """Steps per second of simulated time, the frame rate of recordings; the lowest rate if the period varies."""
        return round(1.0 / self.period.high, 6)

    @property
    def plain(self) -> bool:
        """Whether no episode draws anything: no number, no start and no joint noise."""
        return not (self.drawn or self.spread or self.joint_noise.high)

    def widths(self, joints: int, sensed: int) -> tuple[int, int, int]:
        """Return three counts of numbers that a state stores: values drawn, delayed actions, delayed readings.

        Args:
            joints: Count of the numbers in an action, the gripper's included.
            sensed: Count of the numbers in a reading of joints and camera.
        """
        return len(self.drawn), int(self.delay.high) * joints, int(self.latency.high) * sensed

    def value(self, name: str, drawn: Components) -> Scalar:
        """Return the number that the attribute ``name`` has in an episode: drawn if it varies, else its constant.

        ``drawn`` has the numbers that were drawn for the episode, in the order of the attribute `drawn`.
        """
        return drawn[self.drawn.index(name)] if name in self.drawn else getattr(self, name).low


def make_situation(
    control_period_s: Given = CONTROL_PERIOD,
    latency: Given = 0,
    action_delay: Given = 0,
    joint_noise: Given = 0.0,
    hours_on: Given = 0.0,
    start_spread: float = 0.0,
) -> Situation:
    """Check the arguments, which `pickenv/Reach-v0` explains, and return the situation.

    Actions and readings are late by at most `MOST_STEPS` periods, because late ones have to be stored.

    Raises:
        InputError: If a number is outside the range that the environment allows. The message names the argument and
            this range.
    """
    noise = _span("joint_noise", joint_noise, 0.0, 100.0)
    if isinstance(start_spread, Sequence | np.ndarray):
        raise InputError(f"start_spread is {shown(start_spread)}; give one number from 0 to 1")
    return Situation(
        period=_span("control_period_s", control_period_s, 1e-3, 10.0),
        latency=_span("latency", latency, 0, MOST_STEPS),
        delay=_span("action_delay", action_delay, 0, MOST_STEPS),
        joint_noise=Span(noise.low * 1e-3, noise.high * 1e-3),
        hours=_span("hours_on", hours_on, 0.0, MOST_HOURS),
        spread=_span("start_spread", start_spread, 0.0, 1.0).low,
    )


def _span(name: str, given: Any, least: float, most: float) -> Span:
    """Check a number or a range, and return it as a `Span`.

    Args:
        name: Name of the argument, for the message.
        given: The number, or the range as [least, largest].
        least: Smallest number allowed. If it is an int, the ends must be whole numbers.
        most: Largest number allowed.
    """
    ends = tuple(given) if isinstance(given, Sequence | np.ndarray) and not isinstance(given, str) else (given, given)
    kind: Any = (int, np.integer) if isinstance(least, int) else Real
    numbers = all(isinstance(end, kind) and not isinstance(end, bool) for end in ends)
    if len(ends) != 2 or not numbers or not least <= ends[0] <= ends[1] <= most:
        noun = "whole number" if isinstance(least, int) else "number"
        raise InputError(f"{name} is {shown(given)}; give a {noun} from {least:g} to {most:g}, or [least, largest]")
    return Span(*(type(least)(end) for end in ends))


def drawn_values(x: Executor, setting: Situation, key: Scalar) -> Components:
    """Draw the numbers of the situation that vary, for the episode with the key ``key``, as `Situation.drawn` has them.

    Numbers that stand for whole numbers still have a fraction, which later comparisons cut off.
    """
    stream, names = stream_key(x, key, DRAWN), [part.name for part in fields(setting)]
    spans = ((names.index(name), *getattr(setting, name)) for name in setting.drawn)
    return tuple([low + (high - low + isinstance(low, int)) * uniform(x, stream, i) for i, low, high in spans])


def drawn_start(
    x: Executor, setting: Situation, key: Scalar, lower: Sequence[float], upper: Sequence[float]
) -> list[Scalar]:
    """Draw the joints, rad or m, at which an episode starts, uniformly about the middle of each joint's range.

    Args:
        x: The executor.
        setting: The situation; its `spread` is the share of each range that starts are drawn from.
        key: Key of the episode.
        lower: Lower ends of the ranges, rad or m.
        upper: Upper ends of the ranges, rad or m.
    """
    stream, half = stream_key(x, key, START), 0.5 * setting.spread
    limits = enumerate(zip(lower, upper, strict=True))
    return [low + (high - low) * ((0.5 - half) + setting.spread * uniform(x, stream, i)) for i, (low, high) in limits]


def in_period(x: Executor, setting: Situation, drawn: Components, action: Scalars) -> Scalars:
    """Multiply an action by the ratio of the episode's period to the longest period.

    So a short period moves the arm less. ``drawn`` has the numbers that were drawn for the episode.
    """
    if not setting.period.varies:
        return action
    share = setting.value("period", drawn) / setting.period.high
    return [clipped(x.m, value, -1.0, 1.0) * share for value in action]


def late(
    x: Executor, setting: Situation, name: str, drawn: Components, past: Components, fresh: Scalars
) -> tuple[Scalars, Components]:
    """Delay an action or a reading: return the value that takes effect or arrives now, and the pending values.

    Pending values have not taken effect or arrived yet; they are in one tuple, latest first.

    Args:
        x: The executor.
        setting: The situation.
        name: "delay" for actions, "latency" for readings.
        drawn: Numbers drawn for the episode, in the order of `Situation.drawn`.
        past: Actions or readings that were pending before, latest first.
        fresh: The policy's present action, or the present reading.
    """
    if not getattr(setting, name).high:
        return fresh, past
    width, queue = len(fresh), (*fresh, *past)
    lag, queued = setting.value(name, drawn), queue[: len(past)]
    if name not in setting.drawn:
        return queue[lag * width : (lag + 1) * width], queued
    out = list(fresh)
    for steps in range(1, len(past) // width + 1):
        older = queue[steps * width : (steps + 1) * width]
        out = [chosen(x.m, lag >= steps, old, new) for old, new in zip(older, out, strict=True)]
    return out, queued
