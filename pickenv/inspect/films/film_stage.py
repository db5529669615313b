"""One policy's half of a film's frame as a stage to draw, from what a comparison recorded. Units: m, mm where said."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pickenv.arm import Array
from pickenv.arm.kinematics.forward import nominal_points, true_points
from pickenv.inspect.colours import RED, policy_colours
from pickenv.inspect.films.film_plan import Attempt, FilmCaption, FilmFrame, FilmPlan, attempts_of, grasp_offset
from pickenv.inspect.runs.recorded_episodes import RecordedEpisodes, RecordedPolicy
from pickenv.pictures.arm_shapes import (
    CUP_RADIUS,
    GAIN,
    Solids,
    arm_look,
    arm_solids,
    cup_solids,
    ghost_points,
    ghost_solids,
    hand_solids,
    joined_solids,
)
from pickenv.pictures.stage import Dial, Eye, Mesh, Rgb, Stage, Words, fitted_eye
from pickenv.pictures.tree_shapes import (
    MISSED_FRUIT,
    crate,
    fruit_colours,
    fruit_solids,
    ground_around,
    pedestal,
    row_of_trees,
    sprig,
)

MISS: dict[bool, Rgb] = {False: RED, True: (255, 128, 128)}
"""Of words about a miss, on light and on dark pages."""
FRUIT = 0.06
"""Diameter that is drawn; recordings know of places alone."""
SAME_FRUIT = 0.045
"""Fruit nearer to one another than this, when a tool sets out for them, are one."""
LEAVES = 1.25
"""Leaf area of the trees that are drawn, m²/m³: that of the canopy `li2016`."""
AROUND = 0.16


@dataclass(frozen=True, eq=False)
class FilmSet:
    """What stays the same throughout a film.

    Attributes:
        episodes: The run's episodes.
        plan: The film's frames.
        size: Width and height of one half, px.
        dark: Whether the background is dark.
    """

    episodes: RecordedEpisodes
    plan: FilmPlan
    size: tuple[int, int]
    dark: bool

    @cached_property
    def shown(self) -> list[int]:
        """Episodes that are shown."""
        return sorted({frame.episode for frame in self.plan.frames})

    @cached_property
    def attempts(self) -> list[list[list[Attempt]]]:
        """Of each policy of the film and each episode of the run up to the last one shown."""
        last = self.shown[-1] + 1
        return [[attempts_of(self.episodes.policies[p], e) for e in range(last)] for p in self.plan.policies]

    @cached_property
    def fruit(self) -> dict[int, Array]:
        """Fruit of each episode shown ``(N, 3)``, wherever a policy of the film goes for it."""
        found = {}
        for episode in self.shown:
            places: list[Array] = []
            for policy, attempts in zip(self.plan.policies, self.attempts, strict=True):
                track = self.episodes.policies[policy].fruit_position[episode]
                for place in [track[0], *(track[attempt.begin] for attempt in attempts[episode])]:
                    if all(np.linalg.norm(place - other) > SAME_FRUIT for other in places):
                        places.append(place)
            found[episode] = np.array(places)
        return found

    @cached_property
    def points(self) -> Array:
        """Points that must be in sight ``(N, 3)``: fruit, tools, and the arm's base."""
        parts = [np.concatenate(list(self.fruit.values()))]
        for policy in (self.episodes.policies[number] for number in self.plan.policies):
            parts += [policy.tool_position[self.shown].reshape(-1, 3)]
            if self.episodes.nominal is not None:
                some = policy.joint_command[self.shown][:, ::10].reshape(-1, self.episodes.nominal.joints)
                parts += [nominal_points(self.episodes.nominal, some).reshape(-1, 3)]
        return np.concatenate(parts)

    @cached_property
    def ground(self) -> float:
        """Height of the ground."""
        return float(np.floor(2.0 * (self.points[:, 2].min() - 0.2)) / 2.0)

    @cached_property
    def eye(self) -> Eye:
        """From behind the arm, to its side and above it, near enough to see all."""
        base = np.zeros(3) if self.episodes.nominal is None else np.asarray(self.episodes.nominal.base.position)
        ahead = np.concatenate(list(self.fruit.values())).mean(axis=0) - base
        ahead = np.array([ahead[0], ahead[1], 0.0]) / max(float(np.hypot(ahead[0], ahead[1])), 1e-9)
        side = np.cross([0.0, 0.0, 1.0], ahead)
        seen = np.concatenate([self.points, self.points + np.array([0.0, 0.0, 0.06])])
        return fitted_eye(seen, -0.9 * ahead + 0.75 * side + np.array([0.0, 0.0, 0.42]), self.size)

    @cached_property
    def still(self) -> tuple[Mesh, ...]:
        """Ground, pedestal, and trees around the fruit."""
        middle = self.points.mean(axis=0)
        parts: tuple[Mesh, ...] = (ground_around(float(middle[0]), float(middle[1]), self.ground, self.dark),)
        if self.episodes.nominal is not None:
            x, y, z = (float(value) for value in self.episodes.nominal.base.position)
            parts += (pedestal(x, y, self.ground, z, float(arm_look(self.episodes.nominal).radius[0])),)
        if not self.plan.reaching:
            fruit = np.concatenate(list(self.fruit.values()))
            low, high = fruit.min(axis=0) - AROUND, fruit.max(axis=0) + AROUND
            parts += row_of_trees(_triple(low), _triple(high), LEAVES, self.ground)
        return parts


def _triple(values: Array) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def film_stage(film_set: FilmSet, frame: FilmFrame, side: int) -> Stage:
    """One half of a frame.

    Args:
        film_set: What stays the same.
        frame: The frame.
        side: Number of the policy among those of the film.
    """
    episodes = film_set.episodes
    policy = episodes.policies[film_set.plan.policies[side]]
    (colour,) = policy_colours([policy.key])
    now = min(frame.moment, int(policy.moments[frame.episode]) - 1)
    stated = frame.stated[side]
    solids = joined_solids(
        arm_parts(episodes, policy, frame.episode, now, colour),
        _fruit(film_set, side, frame.episode, now, stated),
    )
    words: tuple[Words, ...] = (
        Words(policy.label, large=True),
        Words(f"picked {stated.picked} of {stated.tried}"),
        Words(f"{stated.distance_mm:.1f} mm to the fruit", "top right"),
        Words(f"ghost: the arm as believed, deviation × {GAIN}", "bottom left"),
    )
    dial = _dial(film_set, side, frame, now, colour, stated)
    words += tuple(_missed(film_set, side, frame.episode, now))
    return Stage(film_set.eye, *solids, film_set.still, words, dial, film_set.size, film_set.dark)


def arm_parts(episodes: RecordedEpisodes, policy: RecordedPolicy, episode: int, moment: int, colour: Rgb) -> Solids:
    """The true arm in its policy's colour with its gripper, and the ghost; the gripper alone where there is no arm."""
    tool, axis = policy.tool_position[episode, moment], tool_axis(policy, episode, moment)
    closed = bool(np.isfinite(policy.miss_mm[episode, : moment + 1]).any())
    hand = "hand" in episodes.gripper
    gripper = hand_solids(tool, axis, CUP_RADIUS, closed) if hand else cup_solids(tool, axis, CUP_RADIUS)
    if episodes.nominal is None:
        return gripper
    look, command = arm_look(episodes.nominal), policy.joint_command[episode, moment]
    believed = nominal_points(episodes.nominal, policy.joint_target[episode, moment])[-1]
    true = arm_solids(look, true_points(episodes.nominal, command, tool), axis, colour)
    return joined_solids(true, gripper, ghost_solids(look, ghost_points(episodes.nominal, command, tool, believed)))


def tool_axis(policy: RecordedPolicy, episode: int, moment: int) -> Array:
    """Direction in which the tool points ``(3,)``; upwards where its attitude is not known."""
    axis = policy.tool_rotation[episode, moment, :, 2]
    return axis if np.isfinite(axis).all() else np.array([0.0, 0.0, 1.0])


def _fruit(film_set: FilmSet, side: int, episode: int, now: int, stated: FilmCaption) -> Solids:
    """Fruit of the episode as this policy has left it, and a crate with what it has picked."""
    policy = film_set.episodes.policies[film_set.plan.policies[side]]
    attempts, track = film_set.attempts[side][episode], policy.fruit_position[episode]
    places, missed = film_set.fruit[episode].copy(), np.zeros(len(film_set.fruit[episode]), dtype=bool)
    there, held = np.ones(len(places), dtype=bool), np.zeros(len(places), dtype=bool)
    for attempt in attempts:
        number = int(np.argmin(np.linalg.norm(film_set.fruit[episode] - track[attempt.begin], axis=1)))
        if attempt.begin <= now <= attempt.end and (now < attempt.close or attempt.taken):
            places[number], held[number] = track[now], attempt.taken and now >= attempt.close
        there[number] = not (attempt.taken and now >= attempt.end + film_set.plan.reaching)  # a reach ends in the cup
        missed[number] = not attempt.taken and now >= attempt.close
    colours = fruit_colours(len(places))
    colours[missed] = MISSED_FRUIT
    loose = there & held
    hanging = there & ~held
    parts = [
        fruit_solids(places[hanging], FRUIT, colours[hanging]),
        fruit_solids(places[loose], FRUIT, colours[loose], stems=False),
        crate(film_set.eye, film_set.size, stated.picked, FRUIT, film_set.ground),
    ]
    if film_set.plan.reaching:
        parts += [sprig(place, FRUIT) for place in film_set.fruit[episode][:1]]
    return joined_solids(*parts)


def _missed(film_set: FilmSet, side: int, episode: int, now: int) -> Iterator[Words]:
    """How far off the gripper was, at each fruit that it has missed."""
    policy = film_set.episodes.policies[film_set.plan.policies[side]]
    for attempt in film_set.attempts[side][episode]:
        if not attempt.taken and attempt.close <= now:
            place = policy.fruit_position[episode, attempt.begin] - [0.0, 0.0, 0.75 * FRUIT]
            yield Words(f"missed by {policy.miss_mm[episode, attempt.close]:.1f} mm", place, MISS[film_set.dark])


def _dial(film_set: FilmSet, side: int, frame: FilmFrame, now: int, colour: Rgb, stated: FilmCaption) -> Dial:
    """Where the tool was, seen from the fruit, whenever the gripper has closed so far; the last time largest."""
    policy = film_set.episodes.policies[film_set.plan.policies[side]]
    done = [(e, a) for e in range(frame.episode) for a in film_set.attempts[side][e]]
    done += [(frame.episode, a) for a in film_set.attempts[side][frame.episode] if a.close <= now]
    marks = [
        seen_along(tool_axis(policy, episode, attempt.close), grasp_offset(policy, episode, attempt), film_set.eye)
        for episode, attempt in done
    ]
    label = "no grasp yet" if stated.miss_mm is None else f"miss {stated.miss_mm:.1f} mm"
    return Dial(1e3 * np.reshape(marks, (-1, 2)), film_set.episodes.tolerance_mm, colour, label)


def seen_along(axis: Array, offset: Array, eye: Eye) -> Array:
    """The part of an offset across the tool's axis, to the right and away from the eye ``(2,)``."""
    right = np.cross(eye.axes()[2], axis)
    right /= max(float(np.linalg.norm(right)), 1e-9)
    return np.array([offset @ right, offset @ np.cross(axis, right)])


def halves(film_set: FilmSet, frame: FilmFrame) -> Sequence[Stage]:
    """All halves of a frame, left first."""
    return [film_stage(film_set, frame, side) for side in range(len(film_set.plan.policies))]
