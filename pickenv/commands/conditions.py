"""`pickenv conditions`: how a calibration's accuracy changes with payload, temperature and hour of day."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pickenv.base import check_limit, command_line, obey, separate, write_json
from pickenv.commands.handing_over import deliver

WIDE = 170
"""Characters of a table of five levels with their intervals."""


def conditions(
    subject: Annotated[str, typer.Argument(help="Plant preset or plant file (.toml), or fitted calibration (.npz).")],
    plant: Annotated[str, typer.Option(help="The simulated arm that a calibration is judged on.")] = "orchard",
    payload: Annotated[float, typer.Option(help="Largest payload, kg.", min=0.0)] = 0.5,
    weather: Annotated[float, typer.Option(help="How much cooler or warmer a day may be, K.", min=0.0)] = 10.0,
    hours: Annotated[float, typer.Option(help="Length of a working day, h.", min=0.0)] = 8.0,
    arms: Annotated[int, typer.Option(help="Drawn arms; fewer than 10 have no intervals.", min=1)] = 10,
    tolerances: Annotated[str, typer.Option(help="Tolerance class that arms are drawn from.")] = "medium",
    sessions: Annotated[int, typer.Option(help="Training sessions, each under other conditions.", min=2)] = 12,
    poses: Annotated[int, typer.Option(help="Poses of a session.", min=5)] = 25,
    residual: Annotated[str, typer.Option(help="What learns the rest: {residual}.")] = "rbf",
    allow: Annotated[
        list[str] | None, typer.Option(help="Judge the calibration in spite of this: fitted-frames, do-not-use.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of everything random.", min=0)] = 0,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
    out: Annotated[Path | None, typer.Option(help="Run folder with figure and page.")] = None,
) -> None:
    """How accuracy changes with payload, temperature and hour, and what a calibration that is told them leaves."""
    from pickenv.arm import load_plant
    from pickenv.calibration import Calibration
    from pickenv.commands.showing import print_table, progress_bars, with_options
    from pickenv.experiments.conditions_study import ConditionRanges, ConditionsSettings, conditions_study
    from pickenv.inspect.runs.run_folder import CONDITIONS, RECORD, REPORT, recorded_run

    numbers = {"--payload": (payload, "payload_kg"), "--hours": (hours, "hours"), "--arms": (arms, "arms")}
    numbers |= {"--weather": (weather, "weather_K"), "--poses": (poses, "poses"), "--sessions": (sessions, "poses")}
    for option, (value, quantity) in (numbers | {"--seed": (seed, "seed")}).items():
        check_limit(option, value, quantity)
    judged = subject.endswith(".npz")
    folder = [] if out is None else [out / RECORD, out / CONDITIONS]
    separate({"SUBJECT": subject, "--plant": plant}, {"--out": folder, "--json": json_file})
    machine = load_plant(plant if judged else subject)
    fitted = Calibration.load(subject, machine.arm) if judged else None
    if fitted is not None:
        obey(fitted.reservations(), allow or ())
    ranges = ConditionRanges(payload, weather, hours)
    settings = ConditionsSettings(ranges, arms, tolerances, sessions, poses, residual, seed)
    with progress_bars() as report:
        result = conditions_study(machine, settings, fitted, report)
    options: dict[str, object] = {"payload": payload, "weather": weather, "hours": hours}
    options |= {"sessions": sessions, "poses": poses}
    options |= {"plant": plant} if judged else {"arms": arms, "tolerances": tolerances, "residual": residual}
    command = command_line("pickenv", "conditions", subject, **options, seed=seed)

    def write_run(folder: Path) -> list[Path]:
        from pickenv.base import write_text
        from pickenv.inspect import write_drawings
        from pickenv.inspect.reports.conditions_report import drawings, page

        with recorded_run(folder, "conditions", command, seed) as run:
            written = [write_json(folder / CONDITIONS, result)]
            written += write_drawings(drawings(run), folder / "figures")
            return [*written, write_text(folder / REPORT, page(run))]

    def show() -> None:
        from pickenv.inspect.reports.conditions_report import condition_tables, conditions_in_words

        for title, heads, rows in condition_tables(result):
            print_table(title, heads, rows, words=("method",), width=WIDE)
        print(with_options("\n".join(conditions_in_words(result))))

    deliver([(json_file, lambda path: write_json(path, result)), (out, write_run)], show)
