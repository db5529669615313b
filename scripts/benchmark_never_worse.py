"""Is a calibration by the default command ever worse than the drawing? Judged where the true arm is known.

Each case calibrates by `pickenv.calibrate` as a user does, without options, and looks at the arm with the eyes of who
knows its truth: a maker's factory calibration, a generator's own parameters, rows that were never fitted. What a case
may leave at most stands beside what it left.

The case `kinhec` needs `pip install kinhec`. Tables are printed as Markdown.

Run: python scripts/benchmark_never_worse.py [--only CASE] [--json FILE] [--data DIR] [--sequences 8] [--arms 30]
"""

import sys
import time
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from measuring import DATA, ROOT, DataFolder, JsonFile, markdown_table, refuse
from never_worse.cases import CASES, Row, Settings

from pickenv.base import InputError, write_json

FIGURES = ("nominal", "least squares", "calibrated", "at most")
WORDS = ("unit", "in its 95 %", "verdict", "meets")


def said(value: float | None) -> str:
    """A figure, to three digits."""
    return "" if value is None else f"{value:#.3g}".rstrip(".")


def cells(row: Row) -> list[str]:
    """A row as it is printed."""
    share = "" if row.within95 is None else f"{100 * row.within95:.0f} %"
    meets = {None: "", True: "yes", False: "NO"}[row.meets]
    figures = [said(value) for value in (row.nominal, row.plain, row.calibrated, row.at_most)]
    return [row.subject, row.where, *figures, row.unit, share, row.grade or "", meets]


def main(
    only: Annotated[list[str] | None, typer.Option(help=f"A case, of {', '.join(CASES)}; all by default.")] = None,
    json_file: JsonFile = None,
    data: DataFolder = DATA,
    out: Annotated[Path, typer.Option(help="Where generated sequences are kept.")] = ROOT / "runs/never_worse",
    seed: Annotated[int, typer.Option(help="Seed of everything that is drawn.")] = 0,
    sequences: Annotated[int, typer.Option(help="KinHEC sequences of each arm.", min=1)] = 8,
    arms: Annotated[int, typer.Option(help="Printed SO-101 that are drawn.", min=1)] = 30,
) -> None:
    """Run the cases and print a table of each, as Markdown."""
    names = only or list(CASES)
    if unknown := set(names) - set(CASES):
        refuse(f"there is no case '{min(unknown)}'; give {', '.join(CASES)}")
    figures: dict[str, Any] = {}
    for name in names:
        begin = time.perf_counter()
        step = partial(print, f"{name}:", file=sys.stderr)
        try:
            rows = CASES[name](Settings(data.resolve(), out, seed, sequences, arms, step))
        except InputError as error:
            refuse(f"{name}: {error}")
        seconds = time.perf_counter() - begin
        figures[name] = {"seconds": seconds, "rows": [asdict(row) | {"meets": row.meets} for row in rows]}
        table = markdown_table(("fitted", "judged", *FIGURES, *WORDS), map(cells, rows), ("fitted", "judged", *WORDS))
        print(f"{name}, {seconds:.1f} s\n\n{table}\n", flush=True)
    if json_file is not None:
        write_json(json_file, {"seed": seed, "cases": figures})


if __name__ == "__main__":
    typer.run(main)
