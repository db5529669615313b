"""Writes films of comparisons: GIF for pages, MP4 for players."""

from __future__ import annotations

import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import chain
from pathlib import Path

import numpy as np

from pickenv.base import InputError, require
from pickenv.inspect.films.film_plan import FilmPlan, plan_film
from pickenv.inspect.films.film_stage import FilmSet, halves
from pickenv.inspect.runs.recorded_episodes import RecordedEpisodes
from pickenv.inspect.runs.run_folder import load_part, read_run
from pickenv.pictures.drawers import painted
from pickenv.pictures.lettering import strip
from pickenv.pictures.stage import Pixels

HALF = (400, 360)
"""Width and height of one half, px."""
STRIP = 28
"""Height of the line of words below the halves, px."""
GAP = 4
KINDS = {
    ".gif": (
        "-filter_complex",
        "split[a][b];[a]palettegen=max_colors=112:stats_mode=full[p];[b][p]paletteuse=dither=none:diff_mode=rectangle",
        "-loop",
        "0",
    ),
    ".mp4": ("-c:v", "libx264", "-pix_fmt", "yuv420p", "-crf", "22", "-movflags", "+faststart"),
}
"""How ffmpeg writes each kind of file."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Film:
    """What was written.

    Attributes:
        path: The file.
        plan: What each of its frames states.
    """

    path: Path
    plan: FilmPlan


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
    """Write a film of a comparison: the same fruit, one policy beside the other.

    Args:
        run: Folder that `pickenv compare --out` wrote.
        out: The film; its ending says what it is, .gif or .mp4.
        policies: Labels of the policies to show, left first; the run's first and last where none are named.
        seconds: Length of the film.
        frames_per_second: Frames of each second.
        dark: Whether the background is dark.
        progress: Called with (stage, done, in all).

    Raises:
        InputError: If the run is no comparison, a policy is not in it, or the file's ending is unknown.
        MissingExtra: If what draws or writes films is not installed.
    """
    require("matplotlib", "imageio_ffmpeg")
    path = Path(out)
    if path.suffix.lower() not in KINDS:
        raise InputError(f"{path} is no name of a film; let it end in {' or '.join(KINDS)}")
    record = read_run(Path(run))
    if record.kind != "comparison":
        raise InputError(f"{run} is a run of kind '{record.kind}'; give a folder that `pickenv compare --out` wrote")
    episodes = load_part(record, RecordedEpisodes)
    plan = plan_film(episodes, policies, seconds, frames_per_second)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_film(film_pictures(episodes, plan, dark=dark, progress=progress), path, frames_per_second)
    return Film(path, plan)


def film_pictures(
    episodes: RecordedEpisodes, plan: FilmPlan, *, dark: bool = False, progress: Progress | None = None
) -> Iterator[Pixels]:
    """The frames of a film, ``(height, width, 3)``."""
    film_set = FilmSet(episodes, plan, HALF, dark)
    width = len(plan.policies) * (HALF[0] + GAP) - GAP
    plant = f", plant {episodes.plant_name}" if episodes.plant_name else ""
    below = strip(
        f"{episodes.env_id}{plant}, gripper {episodes.gripper}: the same fruit, {plan.speed:.1f} × as fast as the arm",
        (width, STRIP),
        dark,
    )
    gap = np.full((HALF[1], GAP, 3), below[0, 0], dtype=np.uint8)
    for number, frame in enumerate(plan.frames, start=1):
        parts = [part for stage in halves(film_set, frame) for part in (painted(stage), gap)][:-1]
        yield np.concatenate([np.concatenate(parts, axis=1), below])
        if progress is not None:
            progress("frames", number, len(plan.frames))


def write_film(pictures: Iterator[Pixels], path: Path, frames_per_second: int) -> None:
    """Let ffmpeg write the pictures into a file.

    Raises:
        InputError: If it cannot; with its last words.
    """
    import imageio_ffmpeg  # type: ignore[import-untyped]

    first = next(pictures)
    height, width = first.shape[:2]
    size = ("-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(frames_per_second))
    quiet = (imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error")
    command = [*quiet, *size, "-i", "-", *KINDS[path.suffix.lower()], str(path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdin is not None
        with suppress(BrokenPipeError):  # then ffmpeg has given up, and says why
            for pixels in chain([first], pictures):
                process.stdin.write(np.ascontiguousarray(pixels).tobytes())
        said = process.communicate()[1].decode(errors="replace").strip().splitlines()
    if process.returncode != 0:
        raise InputError(f"{path} could not be written: {said[-1] if said else 'ffmpeg failed'}")
