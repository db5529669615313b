"""`pickenv experiment`: units × factors → rows → numbers with intervals, from a file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from pickenv.base import InputError, separate, write_json
from pickenv.commands.handing_over import deliver
from pickenv.commands.showing import print_table, progress_bars


def experiment(
    file: Annotated[
        Path, typer.Argument(help="Experiment (.toml); the Python code that it names is executed.", show_default=False)
    ],
    quick: Annotated[bool, typer.Option("--quick", help="The file's own small sizes: minutes.")] = False,
    seed: Annotated[int | None, typer.Option(help="Seed of everything random; the file's if left out.", min=0)] = None,
    seeds: Annotated[
        int,
        typer.Option(help="Seeds to run at; how often intervals of one hold the numbers of another is said.", min=1),
    ] = 1,
    change: Annotated[
        list[str] | None,
        typer.Option("--set", help='A unit, factor or setting: arm=20, method=["raw"]; may be repeated.'),
    ] = None,
    executor: Annotated[str, typer.Option(help="What computes: serial, loky, ray, dask; no number changes.")] = "loky",
    workers: Annotated[int | None, typer.Option(help="Processes; one per core if left out.", min=1)] = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for what is done; what was cut off goes on. runs/NAME if left out.")
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the numbers to this file.")] = None,
    table: Annotated[Path | None, typer.Option(help="Write the rows as .csv or .parquet.")] = None,
    figures: Annotated[Path | None, typer.Option(help="Folder for the file's figures.")] = None,
) -> None:
    """Measure units at every combination of factors, and print the numbers that the file asks for."""
    from pickenv.experiments import run
    from pickenv.experiments.engine import RECORD, write_rows
    from pickenv.experiments.experiment_file import held_by_seeds, load_experiment, number_table, plain_estimates

    folder = out or Path("runs") / file.stem
    separate({"FILE": file}, {"--out": folder / RECORD, "--json": json_file, "--table": table})
    changes = dict(map(_change, change or []))
    found = load_experiment(file, quick=quick, seed=seed, changes=changes)
    first = found.experiment.seed
    others: list[list[dict[str, Any]]] = []
    with progress_bars() as report:
        for further in range(first + seeds - 1, first, -1):  # the first comes last, so that the folder's rows are its
            other = load_experiment(file, quick=quick, seed=further, changes=changes)
            others.insert(0, other.estimates(run(other.experiment, folder, backend=executor, workers=workers)))
            report("seeds", len(others), seeds)
        rows = run(found.experiment, folder, backend=executor, workers=workers, progress=report)
    tables = found.estimates(rows)
    held = held_by_seeds([tables, *others])
    content = {
        "title": found.title,
        "experiment": file.stem,
        "seed": found.experiment.seed,
        "quick": quick,
        "rows": len(rows),
        "tables": plain_estimates(tables),
        "other_seeds": [plain_estimates(other) for other in others],
        "held": [{"title": title, "held": count, "of": of} for title, count, of in held if of],
    }

    def show() -> None:
        print(found.title)
        for number, made in zip(found.numbers, tables, strict=True):
            if number.x is not None:  # lines are for the figure
                continue
            if not made["rows"]:
                print(f"{made['title']}: no rows to make it of")
                continue
            heads, cells = number_table(number, made["rows"])
            print_table(made["title"], heads, cells, words=number.by)
        for title, count, of in held:
            if of:
                print(f"{title}: {count} of {of} intervals hold another seed's number; about 83 % are due")

    def draw(place: Path) -> list[Path]:
        from pickenv.inspect import save_figure
        from pickenv.inspect.figures.plot_estimates import estimates_figure

        drawn = {name: function(rows) for name, function in found.figures.items()}
        for number, made in zip(found.numbers, tables, strict=True):
            if number.figure is not None and made["rows"]:
                axes: Any = {"x": number.x, "colour": None if number.x else number.across, "panels": number.panels}
                drawn[number.figure] = estimates_figure(
                    made["rows"], number.title, number.by, **axes, log=number.log, scale=number.scale
                )
        return [save_figure(figure, place / f"{name}.png") for name, figure in drawn.items()]

    saves: list[Any] = [
        (json_file, lambda path: write_json(path, content)),
        (table, lambda path: write_rows(path, rows)),
        (figures, draw),
    ]
    deliver(saves, show)


def _change(text: str) -> tuple[str, Any]:
    """A name and its value, as TOML has it; a text needs no quotes."""
    import tomllib

    name, mark, value = text.partition("=")
    if not mark or not name:
        raise InputError(f"--set is '{text}'; give NAME=VALUE, such as arm=20")
    try:
        return name, tomllib.loads(f"value = {value}")["value"]
    except tomllib.TOMLDecodeError:
        return name, value
