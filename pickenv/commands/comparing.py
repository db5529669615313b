"""`pickenv compare`: policies for the same fruit, told apart; `pickenv film`: two of them as a moving picture."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from pickenv.base import separate, write_json
from pickenv.commands.showing import CommandOfNames, deliver, print_table, progress_bars

if TYPE_CHECKING:
    from pickenv.inspect.runs.recorded_episodes import RecordedEpisodes

SEVERAL = ("--compensate", "--label")
"""Options that may be followed by several values."""


class SeveralValues(CommandOfNames):
    """A command whose options `SEVERAL` take all values up to the next option, or may be repeated."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Repeat such an option for each of its values."""
        spread: list[str] = []
        option = ""
        for word in args:
            if word.startswith("--"):
                option = word
                spread += [] if word in SEVERAL else [word]
            else:
                spread += [option, word] if option in SEVERAL else [word]
        return super().parse_args(ctx, spread)


def compare(
    policies: Annotated[
        list[str],
        Argument(
            metavar="POLICY...",
            help="{policy}, a shipped baseline, a policy file (.npz), a model of "
            "Stable-Baselines3 (.zip), a Python file with make_policy(env, seed), a calibration (the scripted policy "
            "behind it), or the folder of a training or of a comparison.",
        ),
    ],
    compensate: Annotated[
        list[str] | None,
        Option(
            metavar="CAL...",
            help="A calibration for each policy, in the same order: none, a file, or a file and #ls for its least "
            "squares alone; one policy is taken with each of several.",
        ),
    ] = None,
    label: Annotated[list[str] | None, Option(metavar="NAME...", help="A name for each policy.")] = None,
    env: Annotated[str, Option(help="Id of the environment.")] = "pickenv/Reach-v0",
    episodes: Annotated[int, Option(help="Episodes of each policy.", min=1)] = 20,
    seed: Annotated[int, Option(help="Seed of fruit, and of policies that draw.", min=0)] = 0,
    gripper: Annotated[
        str, Option(help="Gripper that says whether a reach picks; a name, or a file of kind {gripper}.")
    ] = "li_cup",
    plant: Annotated[str | None, Option(help="Plant preset or file; the environment's if left out.")] = None,
    feedback: Annotated[str | None, Option(help="encoders or camera.")] = None,
    camera_noise: Annotated[float | None, Option(help="Noise of what the camera sees, mm per axis.")] = None,
    grid_step: Annotated[float, Option(help="Distance of the error field's goals, m.", min=0.01)] = 0.1,
    allow: Annotated[
        list[str] | None, Option(help="Use a calibration in spite of this: fitted-frames, do-not-use.")
    ] = None,
    out: Annotated[Path | None, Option(help="Run folder: recording, page, figures, every episode.")] = None,
    json_file: Annotated[Path | None, Option("--json", help="Write the numbers to this file.")] = None,
) -> None:
    """Compare policies, raw or calibrated, for the same fruit: who ends nearer, where, by how much, does it matter.

    Examples:
        pickenv compare scripted scripted --compensate none my_arm.npz --episodes 20 --out runs/compare

    More: comparing-policies.md
    """
    from pickenv.agents import compare as run
    from pickenv.agents.evaluation.compare import write_comparison
    from pickenv.inspect.runs.comparison_summary import content_of_comparison
    from pickenv.inspect.runs.run_folder import RECORD

    read = [word.partition("#")[0] for word in [*policies, *(compensate or [])]]
    separate({"POLICY": read, "--plant": plant}, {"--out": None if out is None else out / RECORD, "--json": json_file})
    arguments: dict[str, Any] = {"plant": plant, "feedback": feedback, "camera_noise_mm": camera_noise}
    with progress_bars() as report:
        comparison = run(
            policies,
            env,
            compensate=compensate or (),
            labels=label or (),
            episodes=episodes,
            seed=seed,
            gripper=gripper,
            grid_step=grid_step,
            allow=allow or (),
            progress=report,
            **{name: value for name, value in arguments.items() if value is not None},
        )
    deliver(
        [
            (json_file, lambda path: write_json(path, content_of_comparison(comparison.episodes))),
            (out, lambda folder: write_comparison(comparison, folder)),
        ],
        lambda: _print_comparison(comparison.episodes),
    )


def _print_comparison(episodes: RecordedEpisodes) -> None:
    from pickenv.inspect.runs import comparison_summary

    rows, lines = comparison_summary.policy_cells(episodes), comparison_summary.difference_cells(episodes)
    title = f"{len(episodes.seeds)} episodes of {episodes.env_id}, the same for all; gripper {episodes.gripper}"
    print_table(title, comparison_summary.HEADS, rows, words=("policy",), caption=comparison_summary.INTERVALS)
    if lines:
        heads = comparison_summary.DIFFERENCES
        print_table("Fruit by fruit, the later policy minus the earlier one", heads, lines, words=("from", "to"))
    print(f"{comparison_summary.outcome_sentence(episodes)}. {comparison_summary.explanation(episodes)}")


def film(
    run: Annotated[Path, Argument(help="Run folder of `pickenv compare`.")],
    out: Annotated[Path, Option(help="File to write, .gif or .mp4.")] = Path("film.gif"),
    policy: Annotated[
        list[str] | None,
        Option(help="Policy to show, as the run names it, left first; its first and last if left out."),
    ] = None,
    seconds: Annotated[float, Option(help="Length of the film, s.")] = 12.0,
    fps: Annotated[int, Option(help="Frames per second.")] = 10,
    dark: Annotated[bool, Option("--dark", help="Draw on a dark background.")] = False,
) -> None:
    """Make a film of a comparison: two policies side by side at the same fruit, with misses in mm and fruit picked.

    Examples:
        pickenv film runs/compare --out film.gif

    More: films.md
    """
    from pickenv.inspect import film as make_film
    from pickenv.pictures.drawers import why_plain

    separate({}, {"--out": out})
    with progress_bars("frames") as report:
        movie = make_film(
            run, out, policies=policy or (), seconds=seconds, frames_per_second=fps, dark=dark, progress=report
        )
    plain = why_plain()
    if plain is not None:
        print(plain)
    counted = ", ".join(f"{stated.label} picks {stated.picked} of {stated.tried}" for stated in movie.stated(-1))
    size = f"{out.stat().st_size / 1e6:.1f} MB"
    print(f"{out}: {len(movie.frames)} frames, {size}; {counted}; {movie.speed:.1f} x as fast as the arm")
