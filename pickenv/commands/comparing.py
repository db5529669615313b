"""Commands that compare policies and show finished runs: compare, film, inspect, figures and report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import Annotated, Any

from typer import Argument, Option

import pickenv
from pickenv.base import InputError, command_line, count_of, file_sha256, screen_width, separate, write_json, write_text
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
        f"{count_of(len(episodes.seeds), 'episode')} of {episodes.env_id}, the same for all; "
        f"gripper {episodes.gripper}",
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


MADE_FROM_NUMBERS = (".html", ".svg", ".png", ".pdf")
"""Suffixes of pages and pictures, which can be made again from a run's numbers."""


def inspect(
    run: Path,
    web: Annotated[bool, Option("--web")] = False,
    connect: str | None = None,
    serve: int | None = None,
    policy: str | None = None,
) -> None:
    """Open a run's recording in the Rerun viewer; if there is none yet, it is made from the run's numbers.

    Args:
        run: Run folder, or a recording (.rrd).
        web: Serve the recording to a browser on this machine.
        connect: Send the recording to the viewer at this address.
        serve: Serve the recording to viewers that connect to this port.
        policy: Policy of an evaluation to show; its first if left out.

    Examples:
        pickenv inspect runs/demo
        pickenv inspect runs/demo --web

    More: recordings.md
    """
    from pickenv.inspect.recordings import viewing as opening

    if web + (connect is not None) + (serve is not None) > 1:
        raise InputError("--web, --connect and --serve exclude each other; give one of them")
    paths = recordings_of(run, policy)
    for path in paths:
        opening.check_recording(path)
    if connect is not None:
        opening.send(paths, connect)
    elif serve is not None:
        opening.serve(paths, serve)
    elif web:
        opening.open_web(paths)
    else:
        opening.open_native(paths)


def recordings_of(run: Path, policy: str | None = None) -> list[Path]:
    """Return the recordings of a run folder; one is made if there is none. For a recording (.rrd), return its path.

    Args:
        run: Run folder, or a recording.
        policy: Policy of an evaluation, whose recording is then made; the evaluation's first if None.

    Raises:
        InputError: If there is no such run, or nothing in it that can be recorded.
    """
    from pickenv.inspect.runs.run_folder import RECORD, added_to

    if run.is_file() or run.suffix == ".rrd":
        if policy is not None:
            raise InputError(f"{run} is one recording, so it has no --policy {policy}; leave --policy out")
        return [run]
    recordings = sorted(run.glob("*.rrd"))
    if recordings and policy is None and not (run / RECORD).is_file():
        return recordings
    record = pickenv.inspect.read_run(run)
    current = [path for path in recordings if (record.files or {}).get(path.name) == file_sha256(path)]
    if record.kind == "evaluation":  # a recording per policy
        current = [path for path in current if path == _shown(record, policy)[1]]
    if current and (policy is None or record.kind == "evaluation"):
        return current
    with added_to(record):
        return [_record(record, policy)]


def _record(run: pickenv.inspect.Run, policy: str | None) -> Path:
    from pickenv.inspect.runs.run_folder import load_part

    if run.kind == "evaluation":
        return _record_evaluation(run, policy)
    if policy is not None:
        raise InputError(f"{run.folder} holds no evaluation, so it has no --policy {policy}; leave --policy out")
    if run.kind == "comparison":
        from pickenv.inspect.recordings.policy_recording import record_policies

        return record_policies(load_part(run, pickenv.inspect.RecordedEpisodes), run.folder / "comparison.rrd")
    if run.kind == "demo":
        return pickenv.inspect.record_comparison(load_part(run, pickenv.inspect.Comparison), run.folder / "errors.rrd")
    if run.kind == "study":
        return pickenv.experiments.record_study(run.folder, 0, run.folder / "arms.rrd")
    raise InputError(f"a run of kind '{run.kind}' has no recording; see its figures with `pickenv report {run.folder}`")


def _record_evaluation(run: pickenv.inspect.Run, policy: str | None) -> Path:
    """Record one policy of an evaluation with every compensation, and return the recording's path.

    Only the evaluation's first plant and first kind of feedback are recorded. ``policy`` is the policy's name, or None
    for the evaluation's first.
    """
    from pickenv.experiments.policies import reaches_in
    from pickenv.experiments.policy_tables import read_episodes

    rows, (name, path) = read_episodes(run), _shown(run, policy)
    plant, feedback = rows.where(policy=name).levels("plant", "feedback")[0]
    cells = rows.where(policy=name, plant=plant, feedback=feedback, training=0)
    return pickenv.inspect.inspect_evaluation(
        {behind: reaches_in(cells.where(compensation=behind)) for (behind,) in cells.levels("compensation")},
        pickenv.load_plant(plant),
        path,
        seed=int(rows["seed"][0]),
    )


def _shown(run: pickenv.inspect.Run, policy: str | None) -> tuple[str, Path]:
    """Return the policy of an evaluation to show, ``policy`` if given, else the first, and its recording's path.

    Raises:
        InputError: If the evaluation has no such policy.
    """
    from pickenv.experiments.policy_tables import read_episodes
    from pickenv.inspect.colours import policy_key

    names = [name for (name,) in read_episodes(run).levels("policy")]
    if policy is not None and policy not in names:
        raise InputError(f"{run.folder} holds no policy '{policy}'; it holds {', '.join(names)}")
    name = policy or names[0]
    return name, run.folder / f"{policy_key(name)}.rrd"


def figures(run: Path, out: Path | None = None, formats: Annotated[str, Option("--format")] = "svg,png") -> None:
    """Draw every figure that a run's numbers allow, for papers and reports; say which figures are left out.

    Args:
        run: Run folder.
        out: Folder for the figures; RUN/figures if left out.
        formats: Formats, joined by commas: svg, png, pdf.

    Examples:
        pickenv figures runs/demo --format pdf --out figures

    More: figures-and-reports.md
    """
    from pickenv.inspect.runs.run_folder import added_to

    record, folder = pickenv.inspect.read_run(run), out or run / "figures"
    drawings, suffixes = pickenv.inspect.drawings_of(record), formats.split(",")
    files = [folder / f"{drawing.name}.{suffix}" for drawing in drawings for suffix in suffixes]
    separate({"RUN": _numbers(run)}, {"--out": files})
    with added_to(record):
        written = pickenv.inspect.write_drawings(drawings, folder, suffixes)
    for path in written:
        print(f"wrote {path}")
    for drawing in drawings:
        if drawing.draw is None:
            print(f"left out {drawing.name}: {drawing.caption}")


def report(
    run: Path,
    out: Path | None = None,
    picture: Annotated[bool, Option("--picture/--no-picture")] = True,
) -> None:
    """Write a run's report: one HTML file that needs no network, with the verdict first, then the evidence.

    Args:
        run: Run folder.
        out: File to write (.html); RUN/report.html if left out.
        picture: Include a picture of the recording as the viewer draws it.

    Examples:
        pickenv report runs/demo

    More: figures-and-reports.md
    """
    from pickenv.inspect.recordings.viewing import viewer_picture
    from pickenv.inspect.runs.run_folder import added_to

    record = pickenv.inspect.read_run(run)
    path = out or run / "report.html"
    separate({"RUN": _numbers(run)}, {"--out": path})
    with added_to(record):
        print(f"wrote {write_text(path, pickenv.inspect.page_of(record, viewer_picture if picture else None))}")


def _numbers(run: Path) -> list[Path]:
    """Return the files of a run from which figures and pages are made; no output may replace one of these."""
    return [path for path in run.rglob("*") if path.is_file() and path.suffix not in MADE_FROM_NUMBERS]
