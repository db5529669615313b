"""Films of comparisons: choice of moments, captions and images of the frames, and GIF or MP4 files.

A moment is one recorded step of an episode. The captions of a frame (`Film.stated`) are the numbers that are drawn on
it. Units: m, s; mm in captions.
"""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TypeAlias

import numpy as np

from pickenv.arm import Array
from pickenv.arm.kinematics.forward import nominal_points
from pickenv.base import InputError, require, write_whole
from pickenv.inspect.colours import RED, in_words, policy_colours
from pickenv.inspect.runs.recorded_episodes import RecordedEpisodes, RecordedPolicy
from pickenv.inspect.runs.run_folder import load_part, read_run
from pickenv.pictures import shapes
from pickenv.pictures.drawers import painted, strip
from pickenv.pictures.shapes import Solids, arm_at_work, cup_solids, hand_solids, joined_solids
from pickenv.pictures.stage import Dial, Eye, Mesh, Pixels, Rgb, Stage, Words, fitted_eye, seen_along

MOST_MOMENTS = 3.0
"""Largest number of moments from one frame to the next. Viewers could not follow more."""
PAUSE = 9
"""Number of moments for which the last moment of an episode is shown."""
STILL_STEP = 5e-4
"""Distance, m, within which the tool stays from one moment to the next when it has arrived."""
FALLEN = 0.06
"""Distance between the recorded fruit positions of two moments, m, above which they belong to two fruit."""
MISS: dict[bool, Rgb] = {False: RED, True: (255, 128, 128)}
"""Colour of text about a miss, on a light (False) and on a dark (True) background."""
FRUIT = 0.06
"""Diameter with which every fruit is drawn, m. Recordings hold only the positions of fruit."""
SAME_FRUIT = 0.045
"""Smallest distance between two fruit, m. If tools aim at points nearer together, these points count as one fruit."""
LEAVES = 1.25
"""Leaf area per volume of the drawn trees, m²/m³, as in the canopy `li2016`."""
AROUND = 0.16
HALF = (400, 360)
"""Width and height of the part of a frame that shows one policy, px."""
STRIP = 28
"""Height of the line of text below the halves, px."""
GAP = 4
PALETTE = "[a]palettegen=max_colors=112:stats_mode=full[p];[b][p]paletteuse=dither=none:diff_mode=rectangle"
KINDS = {
    ".gif": ("-filter_complex", f"split[a][b];{PALETTE}", "-loop", "0"),
    ".mp4": ("-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "22", "-movflags", "+faststart"),
}
"""Options with which ffmpeg writes each kind of file, by suffix."""

Progress = Callable[[str, int, int], None]


Attempt: TypeAlias = tuple[int, int, int, bool]
"""A policy's attempt at one fruit in one episode, as four values: the moment at which the attempt begins, the moment at
which the gripper closes, the moment at which the fruit is collected or missed, and whether it is collected. The fruit
hangs still until the gripper closes."""


@dataclass(frozen=True)
class FilmCaption:
    """The numbers that a frame states about one policy.

    Attributes:
        label: Name of the policy.
        distance_mm: Distance from the tool to the fruit that it aims for at present, mm.
        miss_mm: Distance from tool to fruit when the gripper last closed, mm; None before it has closed.
        picked: Number of fruit collected since the film began.
        tried: Number of times that the gripper has closed since the film began.
    """

    label: str
    distance_mm: float
    miss_mm: float | None
    picked: int
    tried: int


def plan_film(
    episodes: RecordedEpisodes,
    labels: Sequence[str] = (),
    seconds: float = 12.0,
    frames_per_second: int = 10,
    dark: bool = False,
) -> Film:
    """Choose the moments (recorded steps) of a film from the first episodes of a run, as many as a viewer can follow.

    Args:
        episodes: The run's episodes.
        labels: Labels of the policies to show, from left to right; if empty, the first and the last policy of the run.
        seconds: Length of the film, s.
        frames_per_second: Frames per second.
        dark: Whether the background is dark.

    Raises:
        InputError: If a policy is not in the run, ``seconds`` is not in 1..120, or ``frames_per_second`` not in 1..60.
    """
    if not 1.0 <= seconds <= 120.0 or not 1 <= frames_per_second <= 60:
        raise InputError(
            f"a film of {seconds:g} s at {frames_per_second} frames/s is impossible; give 1 to 120 s, 1 to 60"
        )
    labels_of_run = [policy.label for policy in episodes.policies]
    for label in labels:
        if label not in labels_of_run:
            raise InputError(f"there is no policy '{label}' in this run; give one of {', '.join(labels_of_run)}")
    numbers = [labels_of_run.index(label) for label in labels] or dict.fromkeys((0, len(labels_of_run) - 1))
    policies = tuple(episodes.policies[number] for number in numbers)
    reaching = not any((np.diff(policy.picked, axis=1) > 0).sum(axis=1).max() > 1 for policy in policies)
    reaching &= all(np.isfinite(policy.miss_mm).sum(axis=1).max() <= 1 for policy in policies)
    ways = [_way(policies, episode, reaching) for episode in range(len(episodes.seeds))]
    count = round(seconds * frames_per_second)
    last = max(int((np.cumsum([len(way) for way in ways]) <= count * MOST_MOMENTS).sum()), 1)
    moments = [moment for way in ways[:last] for moment in way]
    frames = tuple(moments[index] for index in np.round(np.linspace(0, len(moments) - 1, count)).astype(int))
    speed = len(moments) * episodes.period * frames_per_second / count
    return Film(episodes, policies, frames, frames_per_second, speed, reaching, dark)


def _way(policies: Sequence[RecordedPolicy], episode: int, reaching: bool) -> list[tuple[int, int]]:
    """Return the moments of an episode to show, as pairs of the indices (from 0) of episode and moment.

    The first moment is the reset. In a reach (``reaching``), the moments stop when all tools stand still.
    Otherwise they stop at the end of the episode. Then the episode's last moment is repeated `PAUSE` times.
    """
    last = max(int(policy.moments[episode]) for policy in policies) - 1
    arrived = last
    if reaching:
        moving = [np.linalg.norm(np.diff(p.tool_position[episode], axis=0), axis=-1) > STILL_STEP for p in policies]
        steps = np.flatnonzero(np.any(moving, axis=0))
        arrived = min(last, int(steps[-1]) + 1 if steps.size else 0)
    return [(episode, moment) for moment in [*range(arrived + 1), *[last] * PAUSE]]


def attempts_of(policy: RecordedPolicy, episode: int) -> list[Attempt]:
    """Return a policy's attempts at fruit in an episode, in the order of time.

    Args:
        policy: The policy's recorded episodes.
        episode: Index of the episode, from 0.
    """
    last = int(policy.moments[episode]) - 1
    picked, fruit = policy.picked[episode], policy.fruit_position[episode]
    closes = [int(t) for t in np.flatnonzero(np.isfinite(policy.miss_mm[episode, : last + 1]))]
    attempts: list[Attempt] = []
    begin = 0
    for close, until in zip(closes, [*closes[1:], last + 1], strict=False):
        before = picked[close - 1] if close else 0
        gains = [t for t in range(close, until) if picked[t] > before]
        jumps = [t for t in range(close + 1, until) if np.linalg.norm(fruit[t] - fruit[t - 1]) > FALLEN]
        end = gains[0] if gains else jumps[0] - 1 if jumps and _follows(policy, episode, close) else close
        attempts.append((begin, close, end, bool(gains)))
        begin = min(end + 1, last)
    return attempts


def _follows(policy: RecordedPolicy, episode: int, close: int) -> bool:
    """Return whether the fruit recorded when the gripper closes is still the fruit at which the tool aimed before.

    ``episode`` and ``close`` are indices, from 0, of the episode and of the moment at which the gripper closes.
    """
    fruit = policy.fruit_position[episode]
    return bool(close and np.linalg.norm(fruit[close] - fruit[close - 1]) < FALLEN)


def _caption(policy: RecordedPolicy, episode: int, moment: int) -> FilmCaption:
    last = policy.moments - 1
    now = min(moment, int(last[episode]))
    past = np.concatenate([policy.miss_mm[:episode].ravel(), policy.miss_mm[episode, : now + 1]])
    past = past[np.isfinite(past)]
    return FilmCaption(
        label=policy.label,
        distance_mm=float(policy.position_error_mm[episode, now]),
        miss_mm=float(past[-1]) if len(past) else None,
        picked=int(policy.picked[np.arange(episode), last[:episode]].sum() + policy.picked[episode, now]),
        tried=len(past),
    )


def grasp_offset(policy: RecordedPolicy, episode: int, close: int) -> Array:
    """Return the vector from the fruit to the tool when the gripper closed ``(3,)``, m, in world axes.

    Args:
        policy: The policy's recorded episodes.
        episode: Index of the episode, from 0.
        close: Index of the moment at which the gripper closed, from 0.
    """
    before = close if _follows(policy, episode, close) else max(close - 1, 0)
    return np.asarray(policy.tool_position[episode, close] - policy.fruit_position[episode, before])


@dataclass(frozen=True, eq=False)
class Film:
    """The plan of a film: everything except its images.

    Attributes:
        episodes: The run's episodes.
        policies: Policies that are shown, from left to right.
        frames: Index of the episode and index of the moment, both from 0, for each frame. A policy whose episode is
            over stays at its last moment.
        frames_per_second: Frames per second.
        speed: Speed of the film as a multiple of the arms' own speed.
        reaching: Whether each episode is a reach for a single fruit.
        dark: Whether the background is dark.
    """

    episodes: RecordedEpisodes
    policies: tuple[RecordedPolicy, ...]
    frames: tuple[tuple[int, int], ...]
    frames_per_second: int
    speed: float
    reaching: bool
    dark: bool

    def stated(self, number: int) -> list[FilmCaption]:
        """Return the captions of all policies in the frame with the index ``number``, from 0."""
        return [_caption(policy, *self.frames[number]) for policy in self.policies]

    @cached_property
    def shown(self) -> list[int]:
        """Indices, from 0, of the episodes that are shown."""
        return sorted({episode for episode, _ in self.frames})

    @cached_property
    def attempts(self) -> list[list[list[Attempt]]]:
        """Attempts at fruit: for each policy of the film a list with one entry per episode, up to the last shown."""
        return [[attempts_of(policy, e) for e in range(self.shown[-1] + 1)] for policy in self.policies]

    @cached_property
    def fruit(self) -> dict[int, Array]:
        """Positions ``(N, 3)``, m, of all fruit at which any policy of the film aims, by episode (index from 0)."""
        fruit = {}
        for episode in self.shown:
            places: list[Array] = []
            for policy, attempts in zip(self.policies, self.attempts, strict=True):
                track = policy.fruit_position[episode]
                for place in [track[0], *(track[begin] for begin, *_ in attempts[episode])]:
                    if all(np.linalg.norm(place - neighbour) > SAME_FRUIT for neighbour in places):
                        places.append(place)
            fruit[episode] = np.array(places)
        return fruit

    @cached_property
    def points(self) -> Array:
        """Points that must be in view ``(N, 3)``, m: fruit, tools, and the arm from its base."""
        parts = [np.concatenate(list(self.fruit.values()))]
        for policy in self.policies:
            parts += [policy.tool_position[self.shown].reshape(-1, 3)]
            if self.episodes.nominal is not None:
                some = policy.joint_command[self.shown][:, ::10].reshape(-1, self.episodes.nominal.joints)
                parts += [nominal_points(self.episodes.nominal, some).reshape(-1, 3)]
        return np.concatenate(parts)

    @cached_property
    def ground(self) -> float:
        """Height of the ground, m."""
        return float(np.floor(2.0 * (self.points[:, 2].min() - 0.2)) / 2.0)

    @cached_property
    def eye(self) -> Eye:
        """Camera above the arm, on the side away from the fruit, as near as it can be with all `points` in view."""
        base = np.zeros(3) if self.episodes.nominal is None else np.asarray(self.episodes.nominal.base.position)
        ahead = np.concatenate(list(self.fruit.values())).mean(axis=0) - base
        ahead = np.array([ahead[0], ahead[1], 0.0]) / max(float(np.hypot(ahead[0], ahead[1])), 1e-9)
        side = np.cross([0.0, 0.0, 1.0], ahead)
        points = np.concatenate([self.points, self.points + np.array([0.0, 0.0, 0.06])])
        return fitted_eye(points, -0.9 * ahead + 0.75 * side + np.array([0.0, 0.0, 0.42]), HALF)

    @cached_property
    def still(self) -> tuple[Mesh, ...]:
        """Meshes that are the same in all frames: ground, pedestal, and trees around the fruit.

        Films of reaches have no trees.
        """
        x, y, _ = self.points.mean(axis=0).tolist()
        parts: tuple[Mesh, ...] = (shapes.ground_around(x, y, self.ground, self.dark),)
        if self.episodes.nominal is not None:
            parts += (shapes.pedestal(self.episodes.nominal, self.ground),)
        if not self.reaching:
            fruit = np.concatenate(list(self.fruit.values()))
            low, high = fruit.min(axis=0) - AROUND, fruit.max(axis=0) + AROUND
            parts += shapes.row_of_trees(tuple(low.tolist()), tuple(high.tolist()), LEAVES, self.ground)
        return parts


def film_stage(film: Film, number: int, side: int) -> Stage:
    """Return the scene (stage) for the part of a frame that shows one policy.

    Args:
        film: The film.
        number: Index of the frame, from 0.
        side: Index of the policy among the film's policies, from 0 on the left.
    """
    policy, caption, (episode, moment) = film.policies[side], film.stated(number)[side], film.frames[number]
    (colour,) = policy_colours([policy.key])
    now = min(moment, int(policy.moments[episode]) - 1)
    solids = joined_solids(
        arm_parts(film.episodes, policy, episode, now, colour), _fruit(film, side, episode, now, caption.picked)
    )
    words = (
        *(Words(line, large=True) for line in in_words(policy.label).replace(" + ", "\n+ ").splitlines()),
        Words(f"picked {caption.picked} of {caption.tried}"),
        Words(f"{caption.distance_mm:.1f} mm to the fruit", "top right"),
        Words(f"ghost: the arm as believed, deviation × {shapes.GAIN}", "bottom left"),
        *_missed(film, side, episode, now),
    )
    label = "no grasp yet" if caption.miss_mm is None else f"miss {caption.miss_mm:.1f} mm"
    dial = Dial(_marks_mm(film, side, episode, now), film.episodes.tolerance_mm, colour, label)
    return Stage(film.eye, *solids, film.still, words, dial, HALF, film.dark)


def arm_parts(episodes: RecordedEpisodes, policy: RecordedPolicy, episode: int, moment: int, colour: Rgb) -> Solids:
    """Return the solids of the true arm with its gripper, and of the ghost (the arm as its controller believes it).

    If the environment has no arm, the solids of the gripper are returned alone.

    Args:
        episodes: The run's episodes.
        policy: The policy's recorded episodes.
        episode: Index of the episode, from 0.
        moment: Index of the moment (recorded step) in the episode, from 0.
        colour: Colour of the true arm, RGB in 0..255.
    """
    tool, axis = policy.tool_position[episode, moment], tool_axis(policy, episode, moment)
    closed = bool(np.isfinite(policy.miss_mm[episode, : moment + 1]).any())
    radius = shapes.CUP_RADIUS
    gripper = hand_solids(tool, axis, radius, closed) if "hand" in episodes.gripper else cup_solids(tool, axis, radius)
    if episodes.nominal is None:
        return gripper
    command = policy.joint_command[episode, moment]
    believed = nominal_points(episodes.nominal, policy.joint_target[episode, moment])[-1]
    return joined_solids(arm_at_work(episodes.nominal, command, tool, axis, believed, colour), gripper)


def tool_axis(policy: RecordedPolicy, episode: int, moment: int) -> Array:
    """Return the tool's direction, a unit vector ``(3,)`` in world axes; it is upwards if the attitude is unknown.

    ``episode`` and ``moment`` are indices from 0.
    """
    axis = policy.tool_rotation[episode, moment, :, 2]
    return axis if np.isfinite(axis).all() else np.array([0.0, 0.0, 1.0])


def _fruit(film: Film, side: int, episode: int, now: int, picked: int) -> Solids:
    """Return the solids of an episode's fruit at one moment, and of a crate with the picked fruit.

    Args:
        film: The film.
        side: Index of the policy among the film's policies, from 0 on the left.
        episode: Index of the episode, from 0.
        now: Index of the moment in the episode, from 0.
        picked: Number of fruit in the crate.
    """
    track, places = film.policies[side].fruit_position[episode], film.fruit[episode].copy()
    present, in_cup, missed = np.ones(len(places), dtype=bool), *np.zeros((2, len(places)), dtype=bool)
    for begin, close, end, taken in film.attempts[side][episode]:
        number = int(np.argmin(np.linalg.norm(film.fruit[episode] - track[begin], axis=1)))
        if begin <= now <= end and (now < close or taken):
            places[number], in_cup[number] = track[now], taken and now >= close
        present[number] = not (taken and now >= end + film.reaching)  # a reach ends in the cup
        missed[number] = not taken and now >= close
    colours = shapes.fruit_colours(len(places))
    colours[missed] = shapes.MISSED_FRUIT
    return joined_solids(
        shapes.fruit_solids(places[present], FRUIT, colours[present], ~in_cup[present]),
        shapes.crate(film.eye, HALF, picked, FRUIT, film.ground),
        *(shapes.sprig(place, FRUIT) for place in film.fruit[episode][: film.reaching]),
    )


def _missed(film: Film, side: int, episode: int, now: int) -> Iterator[Words]:
    """Yield a text for each fruit that a policy has missed up to moment ``now``: the miss in millimetres, at the fruit.

    ``side`` is the index of the policy in the film. All indices are from 0.
    """
    policy = film.policies[side]
    for begin, close, _, taken in film.attempts[side][episode]:
        if not taken and close <= now:
            place = policy.fruit_position[episode, begin] - [0.0, 0.0, 0.75 * FRUIT]
            yield Words(f"missed by {policy.miss_mm[episode, close]:.1f} mm", place, MISS[film.dark])


def _marks_mm(film: Film, side: int, episode: int, now: int) -> Array:
    """Return the tool's position relative to the fruit at each of K closings of a policy's gripper ``(K, 2)``, mm.

    The closings are counted from the run's first episode to moment ``now`` of ``episode``. `seen_along` gives the two
    components, which are across the tool's axis.

    Args:
        film: The film.
        side: Index of the policy among the film's policies, from 0 on the left.
        episode: Index of the episode, from 0.
        now: Index of the moment in the episode, from 0.
    """
    policy, attempts = film.policies[side], film.attempts[side]
    closed = [(e, t) for e in range(episode + 1) for _, t, *_ in attempts[e] if e < episode or t <= now]
    marks = [seen_along(tool_axis(policy, *at), grasp_offset(policy, *at), film.eye.axes()[2]) for at in closed]
    return 1e3 * np.reshape(marks, (-1, 2))


def film(
    run: str | Path,
    out: str | Path = "film.gif",
    *,
    policies: Sequence[str] = (),
    seconds: float = 12.0,
    frames_per_second: int = 10,
    dark: bool = False,
    progress: Progress | None = None,
) -> Film:
    """Write a film of a comparison, in which policies reach for the same fruit side by side.

    Args:
        run: Folder of a run of `pickenv compare`.
        out: File of the film, .gif or .mp4.
        policies: Labels of the policies to show, from left to right; if empty, the first and the last policy of the
            run.
        seconds: Length of the film, s.
        frames_per_second: Frames per second.
        dark: Whether the background is dark.
        progress: Function that is called with the name of the work, the number of frames done, and the number of all
            frames.

    Returns:
        The plan of the film; `Film.stated` gives the captions of each frame.

    Raises:
        InputError: If the run is no comparison, a policy is not in it, or the file's ending is unknown.
        MissingExtra: If a package that draws or writes films is not installed.
    """
    require("matplotlib", "imageio_ffmpeg")
    path = Path(out)
    if path.suffix.lower() not in KINDS:
        raise InputError(f"{path} is no name of a film; let it end in {' or '.join(KINDS)}")
    record = read_run(Path(run))
    if record.kind != "comparison":
        raise InputError(f"{run} is a run of kind '{record.kind}'; give the folder of a run of `pickenv compare`")
    plan = plan_film(load_part(record, RecordedEpisodes), policies, seconds, frames_per_second, dark)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_film(film_pictures(plan, progress), path, frames_per_second)
    return plan


def film_pictures(film: Film, progress: Progress | None = None) -> Iterator[Pixels]:
    """Yield the frames of a film as images ``(height, width, 3)``, RGB in 0..255."""
    episodes, sides = film.episodes, range(len(film.policies))
    width = len(sides) * (HALF[0] + GAP) - GAP
    subject = ", ".join(in_words(name) for name in (episodes.env_id, episodes.plant_name, episodes.gripper) if name)
    words = f"{subject}: the same fruit, {film.speed:.1f} × as fast as the arm"
    below = strip(words, (width, STRIP), film.dark)
    gap = np.full((HALF[1], GAP, 3), below[0, 0], dtype=np.uint8)
    for number in range(len(film.frames)):
        halves = (painted(film_stage(film, number, side)) for side in sides)
        parts = [part for half in halves for part in (half, gap)][:-1]
        yield np.concatenate([np.concatenate(parts, axis=1), below])
        if progress is not None:
            progress("frames", number + 1, len(film.frames))


def write_film(pictures: Iterator[Pixels], path: Path, frames_per_second: int) -> None:
    """Write images (as from `film_pictures`) into a film file with ffmpeg, whole or not at all.

    Raises:
        InputError: If the file cannot be written, or ffmpeg fails. The message has the last line that ffmpeg wrote.
    """
    import imageio_ffmpeg  # type: ignore[import-untyped]

    first = next(pictures)
    height, width = first.shape[:2]
    size = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(frames_per_second))
    quiet = (imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error")

    def write(temporary: Path) -> None:
        command = [*quiet, *size, "-i", "-", *KINDS[path.suffix.lower()], str(temporary)]
        with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
            assert process.stdin is not None
            with suppress(BrokenPipeError):  # then ffmpeg has given up, and says why
                for pixels in chain([first], pictures):
                    process.stdin.write(np.ascontiguousarray(pixels).tobytes())
            errors = process.communicate()[1].decode(errors="replace").strip().splitlines()
        if process.returncode != 0:
            raise InputError(f"{path} could not be written: {errors[-1] if errors else 'ffmpeg failed'}")

    write_whole(path, write)
