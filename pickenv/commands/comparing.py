"""`pickenv compare` compares policies on the same fruit; `pickenv film` makes a film of two of them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import Annotated, Any

from typer import Argument, Option

import pickenv
from pickenv.base import InputError, command_line, screen_width, separate, write_json
from pickenv.commands import showing
from pickenv.commands.learning import NO_CAMERA

SEVERAL = ("--compensate", "--label")
"""Options that may be followed by several values."""


class SeveralValues(showing.CommandOfNames):
    """A command whose options `SEVERAL` take all values up to the next option; these options may also be repeated."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parse the words ``args`` of a command line, after repeating each option of `SEVERAL` before each value."""
        spread: list[str] = []
        option = ""
        for word, after in zip(args, [*args[1:], "--"], strict=True):
            name, equals, value = word.partition("=")
            if name in SEVERAL:
                if not equals and after.startswith("--"):
                    raise InputError(f"{name} has no value; give one or more, or leave it out")
                option = name
                spread += [name, value] if equals else []
            elif word.startswith("--"):
                option = word
                spread.append(word)
            else:
                spread += [option, word] if option in SEVERAL else [word]
        return super().parse_args(ctx, spread)


def compare(
    policies: Annotated[list[str], Argument(metavar="POLICY...")],
    compensate: Annotated[list[str] | None, Option(metavar="CAL...")] = None,
    label: Annotated[list[str] | None, Option(metavar="NAME...")] = None,
    env: str = "pickenv/Reach-v0",
    episodes: Annotated[int, Option(min=1)] = 20,
    seed: Annotated[int, Option(min=0)] = 0,
    gripper: str = "li_cup",
    plant: str | None = None,
    feedback: str | None = None,
    camera_noise: float | None = None,
    grid_step: Annotated[float, Option(min=0.01)] = 0.1,
    allow: list[str] | None = None,
    details: Annotated[bool, Option("--details")] = False,
    out: Path | None = None,
    json_file: Annotated[Path | None, Option("--json")] = None,
) -> None:
    """Compare policies, raw or calibrated, on the same fruit: which ends nearer, where, by how much, does it matter?

    Args:
        policies: {policy}, a shipped baseline, a policy file (.npz), a model of Stable-Baselines3 (.zip), a Python file
            with make_policy(env, seed), a calibration (the scripted policy with it), or the folder of a training.
        compensate: A calibration for each policy, in the same order: none, a file, or a file and #ls for its least
            squares alone; a single policy is combined with each of several calibrations.
        label: A name for each policy.
        env: Id of the environment.
        episodes: Number of episodes of each policy.
        seed: Seed of fruit, and of policies with random actions.
        gripper: Gripper that decides whether a reach picks, and that picks in pickenv/Pick-v0; a name, or a file of
            kind {gripper}.
        plant: Plant preset or file; the environment's if left out.
        feedback: encoders or camera.
        camera_noise: Standard deviation of the camera's measurements, mm per axis.
        grid_step: Distance between neighbouring points of the error field of reaches, m.
        allow: Use a calibration in spite of this reservation: fitted-frames, do-not-use.
        details: Print medians, 95th percentiles, and the differences fruit by fruit as well.
        out: Run folder: recording, page, figures, every episode.
        json_file: Write the numbers to this file.

    Examples:
        pickenv compare scripted scripted --compensate none my_arm.npz --episodes 20 --out runs/compare

    More: comparing-policies.md
    """
    typed = dict(locals())
    from pickenv.agents.evaluation.compare import write_comparison
    from pickenv.inspect.runs.comparison_summary import content_of_comparison
    from pickenv.inspect.runs.run_folder import RECORD

    read = [word.partition("#")[0] for word in [*policies, *(compensate or [])]]
    separate({"POLICY": read, "--plant": plant}, {"--out": None if out is None else out / RECORD, "--json": json_file})
    if camera_noise is not None and feedback != "camera":
        raise InputError(NO_CAMERA)
    of_env = {"plant": plant, "feedback": feedback, "camera_noise_mm": camera_noise}
    how: dict[str, Any] = showing.arguments_for(pickenv.compare, typed)
    how |= {name: value for name, value in of_env.items() if value is not None}
    with showing.progress_bars() as report:
        comparison = pickenv.compare(policies, progress=report, **how)
    showing.deliver(
        [
            (json_file, lambda path: write_json(path, content_of_comparison(comparison.episodes))),
            (out, lambda folder: write_comparison(comparison, folder)),
        ],
        lambda: _print_comparison(comparison.episodes, details),
        "see it: the same command with --out RUN, then pickenv inspect RUN"
        if out is None
        else f"see it: {command_line('pickenv', 'inspect', out)}",
        "" if details else "medians, and the differences fruit by fruit",
    )


BRIEF = (0, 1, 4, 6)
"""Indices (from 0) of the columns of the table of policies that are printed without `--details`."""


def _print_comparison(episodes: pickenv.inspect.RecordedEpisodes, details: bool) -> None:
    from pickenv.inspect.runs import comparison_summary

    showing.print_verdict(f"{comparison_summary.outcome_sentence(episodes)}.")
    print(fill(comparison_summary.explanation(episodes), screen_width()))
    rows, lines = comparison_summary.policy_cells(episodes), comparison_summary.difference_cells(episodes)
    heads: Sequence[str] = comparison_summary.HEADS
    shown = range(len(heads)) if details else BRIEF
    showing.print_table(
        f"{len(episodes.seeds)} episodes of {episodes.env_id}, the same for all; gripper {episodes.gripper}",
        [heads[i] for i in shown],
        [[row[i] for i in shown] for row in rows],
        words=("policy",),
        caption=comparison_summary.INTERVALS,
        most=None if details else showing.MOST,
    )
    if lines and details:
        heads = comparison_summary.DIFFERENCES
        title = "Fruit by fruit, the later policy minus the earlier one"
        showing.print_table(title, heads, lines, words=("from", "to"))


def film(
    run: Path,
    out: Path = Path("film.gif"),
    policy: list[str] | None = None,
    seconds: float = 12.0,
    fps: int = 10,
    dark: Annotated[bool, Option("--dark")] = False,
) -> None:
    """Make a film of a comparison: two policies side by side at the same fruit, with errors in mm and fruit picked.

    Args:
        run: Run folder of `pickenv compare`.
        out: File to write, .gif or .mp4.
        policy: Policy to show, as the run names it; the first is on the left. The run's first and last if left out.
        seconds: Length of the film, s.
        fps: Frames per second.
        dark: Draw on a dark background.

    Examples:
        pickenv film runs/compare --out film.gif

    More: films.md
    """
    from pickenv.pictures.drawers import why_plain

    separate({}, {"--out": out})
    with showing.progress_bars("frames") as report:
        movie = pickenv.film(
            run, out, policies=policy or (), seconds=seconds, frames_per_second=fps, dark=dark, progress=report
        )
    plain = why_plain()
    if plain is not None:
        print(plain)
    counted = ", ".join(f"{stated.label} picks {stated.picked} of {stated.tried}" for stated in movie.stated(-1))
    size = f"{out.stat().st_size / 1e6:.1f} MB"
    print(f"{out}: {len(movie.frames)} frames, {size}; {counted}; {movie.speed:.1f} x as fast as the arm")
