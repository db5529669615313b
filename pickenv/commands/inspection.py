"""Commands that show finished runs: `pickenv inspect`, `pickenv figures` and `pickenv report`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Option

import pickenv
from pickenv.base import InputError, file_sha256, separate, write_text

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
    from pickenv.inspect.recordings import open_recording as opening

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
        current = [path for path in current if path == _path_of(record, policy)]
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

    Of the evaluation's plants and kinds of feedback the first is recorded. ``policy`` is the policy's name, or None for
    the evaluation's first.
    """
    from pickenv.experiments.policies import reaches_in
    from pickenv.experiments.policy_tables import read_episodes

    rows, name = read_episodes(run), _shown_policy(run, policy)
    plant, feedback = rows.where(policy=name).levels("plant", "feedback")[0]
    cells = rows.where(policy=name, plant=plant, feedback=feedback, training=0)
    return pickenv.inspect.inspect_evaluation(
        {behind: reaches_in(cells.where(compensation=behind)) for (behind,) in cells.levels("compensation")},
        pickenv.load_plant(plant),
        _path_of(run, policy),
        seed=int(rows["seed"][0]),
    )


def _shown_policy(run: pickenv.inspect.Run, policy: str | None) -> str:
    """Return the policy of an evaluation to show: ``policy`` if given, else the first.

    Raises:
        InputError: If the evaluation has no such policy.
    """
    from pickenv.experiments.policy_tables import read_episodes

    names = [name for (name,) in read_episodes(run).levels("policy")]
    if policy is not None and policy not in names:
        raise InputError(f"{run.folder} holds no policy '{policy}'; it holds {', '.join(names)}")
    return policy or names[0]


def _path_of(run: pickenv.inspect.Run, policy: str | None) -> Path:
    """Return the path of the recording of one policy of an evaluation; None stands for the evaluation's first."""
    from pickenv.inspect.colours import policy_key

    return run.folder / f"{policy_key(_shown_policy(run, policy))}.rrd"


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
    separate(
        {"RUN": _numbers(run)}, {"--out": [folder / f"{d.name}.{suffix}" for d in drawings for suffix in suffixes]}
    )
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
    from pickenv.inspect.recordings.open_recording import viewer_picture
    from pickenv.inspect.runs.run_folder import added_to

    record = pickenv.inspect.read_run(run)
    path = out or run / "report.html"
    separate({"RUN": _numbers(run)}, {"--out": path})
    with added_to(record):
        print(f"wrote {write_text(path, pickenv.inspect.page_of(record, viewer_picture if picture else None))}")


def _numbers(run: Path) -> list[Path]:
    """Return the files of a run from which figures and pages are made; no output may replace one of these."""
    return [path for path in run.rglob("*") if path.is_file() and path.suffix not in MADE_FROM_NUMBERS]
