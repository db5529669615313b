"""What a film of a comparison states, frame by frame: which moment, how far off, how many fruit are picked.

The same data make the pictures and the tests; nothing here draws. Units: m, s; mm in what is stated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pickenv.arm import Array
from pickenv.base import InputError
from pickenv.inspect.runs.recorded_episodes import RecordedEpisodes, RecordedPolicy

MOST_MOMENTS = 3.0
"""Moments from one frame to the next at most: with more, nobody could follow."""
PAUSE = 9
"""Moments for which an episode's end stays in sight."""
STILL_STEP = 5e-4
"""A tool that moves less than this between two moments has arrived, m."""
FALLEN = 0.06
"""A fruit that is this far from where it was a moment before is another fruit, m."""


@dataclass(frozen=True)
class Attempt:
    """One fruit that a policy goes for, in one episode.

    Attributes:
        begin: First moment at which it does.
        close: Moment at which the gripper closes; the fruit was where it is `begin` to `close` - 1.
        end: Last moment: the fruit is collected, or the gripper closed beside it.
        taken: Whether it was collected.
    """

    begin: int
    close: int
    end: int
    taken: bool


@dataclass(frozen=True)
class FilmCaption:
    """What a frame states of one policy.

    Attributes:
        label: Name of the policy.
        distance_mm: From the tool to the fruit that it goes for, now.
        miss_mm: From the tool to the fruit when the gripper closed last; None before it has.
        picked: Fruit collected since the film began.
        tried: Fruit on which the gripper has closed since then.
    """

    label: str
    distance_mm: float
    miss_mm: float | None
    picked: int
    tried: int


@dataclass(frozen=True)
class FilmFrame:
    """One frame.

    Attributes:
        episode: Number of the episode in the run.
        moment: Number of the moment; a policy whose episode is over stays at its last one.
        stated: One entry per policy.
    """

    episode: int
    moment: int
    stated: tuple[FilmCaption, ...]


@dataclass(frozen=True)
class FilmPlan:
    """A film, but for its pictures.

    Attributes:
        frames: In their order.
        frames_per_second: How fast they follow one another.
        speed: How many times as fast as the arms moved.
        policies: Numbers of the policies in the run, left first.
        reaching: Whether each episode is for one fruit.
    """

    frames: tuple[FilmFrame, ...]
    frames_per_second: int
    speed: float
    policies: tuple[int, ...]
    reaching: bool


def plan_film(
    episodes: RecordedEpisodes, labels: Sequence[str] = (), seconds: float = 12.0, frames_per_second: int = 10
) -> FilmPlan:
    """Choose the moments of a film: the first episodes of the run, as many as can be followed.

    Args:
        episodes: The run's episodes.
        labels: Policies to show, left first; the first and the last of the run where none are named.
        seconds: Length of the film.
        frames_per_second: Frames of each second.

    Raises:
        InputError: If a policy is not in the run, or the length is impossible.
    """
    if not 1.0 <= seconds <= 120.0 or not 1 <= frames_per_second <= 60:
        raise InputError(
            f"a film of {seconds:g} s at {frames_per_second} frames/s is impossible; give 1 to 120 s, 1 to 60"
        )
    chosen = _chosen(episodes, labels)
    policies = [episodes.policies[number] for number in chosen]
    reaching = not any((np.diff(policy.picked, axis=1) > 0).sum(axis=1).max() > 1 for policy in policies)
    reaching &= all(np.isfinite(policy.miss_mm).sum(axis=1).max() <= 1 for policy in policies)
    ways = [_way(policies, episode, reaching) for episode in range(len(episodes.seeds))]
    count = round(seconds * frames_per_second)
    total = np.cumsum([len(way) for way in ways])
    shown = max(int((total <= count * MOST_MOMENTS).sum()), 1)
    moments = [(episode, moment) for episode in range(shown) for moment in ways[episode]]
    picks = np.round(np.linspace(0, len(moments) - 1, count)).astype(int)
    frames = tuple(_frame(policies, *moments[index]) for index in picks)
    speed = len(moments) * episodes.period * frames_per_second / count
    return FilmPlan(frames, frames_per_second, speed, chosen, reaching)


def _chosen(episodes: RecordedEpisodes, labels: Sequence[str]) -> tuple[int, ...]:
    known = [policy.label for policy in episodes.policies]
    for label in labels:
        if label not in known:
            raise InputError(f"there is no policy '{label}' in this run; give one of {', '.join(known)}")
    if labels:
        return tuple(known.index(label) for label in labels)
    return (0, len(known) - 1) if len(known) > 1 else (0,)


def _way(policies: Sequence[RecordedPolicy], episode: int, reaching: bool) -> list[int]:
    """Moments of one episode that are shown: until all tools stand, then its end for a while."""
    last = max(int(policy.moments[episode]) for policy in policies) - 1
    arrived = last
    if reaching:
        moving = [np.linalg.norm(np.diff(p.tool_position[episode], axis=0), axis=-1) > STILL_STEP for p in policies]
        steps = np.flatnonzero(np.any(moving, axis=0))
        arrived = min(last, int(steps[-1]) + 1 if steps.size else 0)
    return [*range(arrived + 1), *[last] * PAUSE]


def attempts_of(policy: RecordedPolicy, episode: int) -> list[Attempt]:
    """The fruit that a policy goes for in an episode, one after the other."""
    last = int(policy.moments[episode]) - 1
    picked, fruit = policy.picked[episode], policy.fruit_position[episode]
    closes = [int(t) for t in np.flatnonzero(np.isfinite(policy.miss_mm[episode, : last + 1]))]
    found, begin = [], 0
    for number, close in enumerate(closes):
        until = closes[number + 1] if number + 1 < len(closes) else last + 1
        before = picked[close - 1] if close else 0
        gains = [t for t in range(close, until) if picked[t] > before]
        jumps = [t for t in range(close + 1, until) if np.linalg.norm(fruit[t] - fruit[t - 1]) > FALLEN]
        end = gains[0] if gains else jumps[0] - 1 if jumps and _follows(policy, episode, close) else close
        found.append(Attempt(begin, close, end, bool(gains)))
        begin = min(end + 1, last)
    return found


def _follows(policy: RecordedPolicy, episode: int, close: int) -> bool:
    """Whether the fruit that the tool went for is still the one after the gripper has closed."""
    fruit = policy.fruit_position[episode]
    return bool(close and np.linalg.norm(fruit[close] - fruit[close - 1]) < FALLEN)


def _frame(policies: Sequence[RecordedPolicy], episode: int, moment: int) -> FilmFrame:
    return FilmFrame(episode, moment, tuple(_stated(policy, episode, moment) for policy in policies))


def _stated(policy: RecordedPolicy, episode: int, moment: int) -> FilmCaption:
    last = policy.moments - 1
    now = min(moment, int(last[episode]))
    rows = np.arange(episode)
    past = np.concatenate([policy.miss_mm[:episode].ravel(), policy.miss_mm[episode, : now + 1]])
    past = past[np.isfinite(past)]
    return FilmCaption(
        label=policy.label,
        distance_mm=float(policy.position_error_mm[episode, now]),
        miss_mm=float(past[-1]) if len(past) else None,
        picked=int(policy.picked[rows, last[:episode]].sum() + policy.picked[episode, now]),
        tried=len(past),
    )


def grasp_offset(policy: RecordedPolicy, episode: int, attempt: Attempt) -> Array:
    """From the fruit to the tool when the gripper closed ``(3,)``, m."""
    close = attempt.close
    seen = close if _follows(policy, episode, close) else max(close - 1, 0)
    return np.asarray(policy.tool_position[episode, close] - policy.fruit_position[episode, seen])
