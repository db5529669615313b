"""Do the numbers hold? The ledger of numbers that pages print, drawn from and made again.

    python scripts/claims.py keep RESULT.json...    the numbers of full runs (`pickenv experiment FILE --json`)
    python scripts/claims.py check                  draw ten rows, make them again at a fresh seed, say how many held
    python scripts/claims.py pages                  print the tables of the pages anew from the ledger

`docs/claims.toml` says which experiment, or which other command, makes the numbers of which page, at which smaller size
they are made again, over what they vary and on which constants they depend. A number that is made again from fewer
units varies more than the first; it is held where both lie no farther apart than the root mean square of their
intervals' half widths, on the side of each. Of 95 % intervals about 83 % are then due, whatever the sizes. Numbers of
measured rows are made again from the same rows: they must come out the same, and are counted apart.
"""

import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import typer
from measuring import refuse

from pickenv.base import InputError, listed, share_interval, toml_of, write_json, write_text
from pickenv.base.intervals import EQUAL
from pickenv.experiments import load_experiment, run
from pickenv.experiments.experiment_file import RESERVED, plain_estimates
from pickenv.inspect.colours import said

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
LEDGER, RECORD, PAGE = DOCS / "claims.toml", DOCS / "_static/claims.json", DOCS / "claims.md"
DUE = 0.834
"""Share that is due: two numbers differ by sqrt(2) of what one varies by."""

MARK = re.compile(r"(<!-- claims: (\{[^\n]*\}) -->\n\n)(?:(?!<!--).)*?(\n?<!-- end of claims -->)", re.S)
END = "\n<!-- end of claims -->"
INLINE = re.compile(r"(<!-- claim: (\{[^\n]*?\}) -->).*?(<!-- / -->)", re.S)
app = typer.Typer(add_completion=False)
Row = dict[str, Any]


def entries() -> dict[str, Row]:
    """The ledger's experiments by their name, or that of their file."""
    return {entry.get("name") or Path(entry["file"]).stem: entry for entry in toml_of(LEDGER)[0]["experiment"]}


def entry_of(name: str, known: Mapping[str, Row]) -> Row:
    """The entry of an experiment; an `InputError` names those that there are."""
    if name not in known:
        raise InputError(f"{LEDGER} has no experiment {name}; it has {listed(known)}")
    return known[name]


def record() -> dict[str, list[Row]]:
    """Rows, and what was made again: "rows" and "again"."""
    return dict(json.loads(RECORD.read_text(encoding="utf-8")))


def rows_of(result: Mapping[str, Any], certain: bool = False) -> list[Row]:
    """The rows of an experiment's JSON that have an interval with both ends, each with its levels.

    Where all units are equal there is none; such rows are left out unless ``certain``, and end where they begin. Rows
    of too few units for an interval are always left out.
    """
    rows = []
    for table in result["tables"]:
        for row in table["rows"]:
            levels = {k: v for k, v in row.items() if k not in RESERVED}
            ends = row["ci95"] or ([row["value"]] * 2 if certain else [None])
            sampled = row.get("sampled95") or (ends if row["ci95"] or row["no_interval"] == EQUAL else [None])
            if None not in (*ends, *sampled) and (certain or sampled[0] < sampled[1]):
                about = {"experiment": result["experiment"], "title": table["title"], "levels": levels}
                rows.append(about | {"value": row["value"], "ci95": ends, "sampled95": sampled})
    return rows


def parts_at(result: Mapping[str, Any], way: str) -> list[Any]:
    """What lies at the end of a way: keys with dots between, and `*` for every key."""
    parts: list[Any] = [result]
    for key in way.split("."):
        parts = [part[name] for part in parts for name in (part if key == "*" else [key])]
    return parts


def rows_at(result: Mapping[str, Any], way: str) -> list[Row]:
    """The rows of all lists at the end of a way (`parts_at`); where rows have keys, each has its own as "key"."""
    return [
        row
        for rows in parts_at(result, way)
        for row in ([{"key": key} | row for key, row in rows.items()] if isinstance(rows, dict) else rows)
    ]


def rows_of_command(name: str, entry: Row, result: Mapping[str, Any]) -> list[Row]:
    """The rows of another command's JSON, which the entry says how to read.

    Args:
        name: The entry's.
        entry: "rows", the way to the rows (`rows_at`); "by", the keys of their levels; "numbers", for each title the
            ways to a value and to both ends, or to a pair of ends; "words", the key of what a table says beside a
            number. A row without a value has no such number.
        result: What the command wrote.
    """
    rows = []
    for row in rows_at(result, entry["rows"]):
        for title, (value, *ends) in entry["numbers"].items():
            number, *bounds = (parts_at(row, way)[0] for way in (value, *ends))
            interval = bounds[0] if len(bounds) == 1 else bounds
            if number is not None:
                about = {"experiment": name, "title": title, "levels": {key: row[key] for key in entry["by"]}}
                ci95 = None if not interval or None in interval else interval
                words = {"words": row[entry["words"]]} if row.get(entry.get("words")) else {}
                rows.append(about | {"value": number, "ci95": ci95, "sampled95": ci95} | words)
    return rows


def run_command(entry: Row, options: str, seed: int) -> dict[str, Any]:
    """What another command writes at this size and seed, by `--json` or as that file of its folder that "writes" names.

    Raises:
        InputError: If it fails, with its last words.
    """
    program, *words = shlex.split(f"{entry['command']} {options}")
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out"
        written = out / entry["writes"] if "writes" in entry else Path(folder) / "result.json"
        places = ["--seed", str(seed), "--out", str(out)]
        places += [] if "writes" in entry else ["--json", str(written)]
        command = [str(Path(sys.executable).with_name(program)), *words, *places]
        ended = subprocess.run(command, capture_output=True, text=True, cwd=ROOT)
        if not written.is_file():
            raise InputError(f"{entry['command']}: {ended.stderr[-300:]}")
        return dict(json.loads(written.read_text(encoding="utf-8")))


def key_of(row: Mapping[str, Any]) -> str:
    """What a row is known by."""
    levels = ", ".join(f"{name} {value}" for name, value in row["levels"].items())
    return f"{row['experiment']}: {row['title']}: {levels}"


def holds(first: Mapping[str, Any], again: Mapping[str, Any]) -> bool:
    """Whether two numbers agree, with their intervals over arms: constants are those of the design both times.

    Where neither has an interval they are to be the same, to three digits; one of equal units ends where it begins.
    """
    if first["sampled95"] is again["sampled95"] is None:
        return bool(np.isclose(first["value"], again["value"], rtol=5e-3))
    ends = [(row["value"], row["sampled95"] or [row["value"]] * 2) for row in (first, again)]
    (low, (_, above)), (high, (below, _)) = sorted(ends)
    return bool(high - low <= np.sqrt(np.mean(np.square([above - low, high - below]))))


def same(first: Mapping[str, Any], other: Mapping[str, Any]) -> bool:
    """Whether two numbers and their intervals over arms are equal but for roundings."""
    one, another = ((row["value"], *(row["sampled95"] or ())) for row in (first, other))
    return len(one) == len(another) and bool(np.allclose(one, another, rtol=1e-6, atol=0.0))


def made_again(row: Row, entry: Row, seed: int) -> Row:
    """The same row at another seed and the cheap size, with the "seconds" of processor time that it took.

    Raises:
        InputError: If it is not made at that size.
    """
    begin = sum(os.times()[:4])
    if "command" in entry:
        made_by, options = entry["command"], entry["cheap"].format(**row["levels"])
        rows = rows_of_command(row["experiment"], entry, run_command(entry, options, seed))
    else:
        made_by, rows = entry["file"], rows_made_again(row, entry, seed)
    for again in rows:
        if key_of(again) == key_of(row):
            return again | {"seconds": round(sum(os.times()[:4]) - begin, 1)}
    raise InputError(f"{made_by} makes no row '{key_of(row)}' at its cheap size; give more units in {LEDGER}")


def rows_made_again(row: Row, entry: Row, seed: int) -> list[Row]:
    """The rows of an experiment at another seed; of every factor only the levels that a row needs are measured.

    A level that is none of its factor's, such as a part of what one of them learnt, needs them all.
    """
    path, changes = ROOT / entry["file"], dict(entry["cheap"])
    file = load_experiment(path)
    number = next(number for number in file.numbers if number.title == row["title"])
    settings = {name: levels for name, levels in toml_of(path)[0]["settings"].items() if isinstance(levels, list)}
    for name, levels in {**file.experiment.factors, **settings}.items():
        needed = {row["levels"].get(name), (number.against or {}).get(name)} - {None}
        if needed and needed.issubset(levels):
            changes[name] = [level for level in levels if level in needed]
    experiment = load_experiment(path, seed=seed, changes=changes)
    tables = plain_estimates(experiment.estimates(run(experiment.experiment)))
    return rows_of({"experiment": row["experiment"], "tables": tables}, certain=True)


@app.command()
def keep(results: list[Path]) -> None:
    """Put the numbers of full runs into the ledger, in the place of those of the same experiments.

    What was made again of a number that is now another leaves the record, for it was judged by the old one. The JSON
    of another command than `pickenv experiment` has the name of its entry.
    """
    known = entries()
    kept = record() if RECORD.is_file() else {"rows": [], "again": []}
    for path in results:
        result = json.loads(path.read_text(encoding="utf-8"))
        name = result.get("experiment", path.stem)
        entry = entry_of(name, known)
        printed, titles = entry.get("levels", {}), entry.get("titles") or list(entry["numbers"])
        found = rows_of_command(name, entry, result) if "command" in entry else rows_of(result)
        new = [
            row | {"page": entry["page"], "seed": result.get("seed", 0)}
            for row in found
            if row["title"] in titles and all(row["levels"][level] in shown for level, shown in printed.items())
        ]
        old = {key_of(row): row for row in kept["rows"]}
        kept["rows"] = [row for row in kept["rows"] if row["experiment"] != name] + new
        judged = {key_of(row) for row in kept["rows"] if same(row, old.get(key_of(row), row))}
        kept["again"] = [row for row in kept["again"] if row["claim"] in judged]
    write_json(RECORD, kept)
    write_text(PAGE, page_of(kept, known))


@app.command()
def check(count: int = 10, seed: int | None = None, only: list[str] | None = None) -> None:
    """Draw rows, make them again, and add to the record which of them held; the seed is the date's if left out.

    Each row has a seed of its own, for rows of one seed share its arms and miss together. Rows of this seed that stand
    in the record are not made once more, so that an interrupted run goes on. Entries without a cheap size are not
    drawn.

    Args:
        count: Rows to draw.
        seed: Seed of the drawing.
        only: Experiment to draw from; may be repeated.
    """
    known, kept = entries(), record()
    seed = int(datetime.now(UTC).strftime("%Y%m%d")) if seed is None else seed
    names = {name for name in only or known if "cheap" in entry_of(name, known)}
    numbers = [number for number, row in enumerate(kept["rows"]) if row["experiment"] in names]
    drawn = np.random.default_rng(seed).choice(numbers, min(count, len(numbers)), replace=False).tolist()
    done = {(row["claim"], row["seed"]) for row in kept["again"]}
    try:
        for number in drawn:
            row, own = kept["rows"][number], int(np.random.SeedSequence([seed, number]).generate_state(1)[0])
            if (key_of(row), own) in done:
                print(f"in the record already: {key_of(row)}")
                continue
            again = made_again(row, known[row["experiment"]], own)
            found = {"claim": key_of(row), "seed": own, "held": holds(row, again)}
            kept["again"].append(found | {name: again[name] for name in ("value", "ci95", "seconds")})
            write_json(RECORD, kept)
            word = "held  " if found["held"] else "MISSED"
            print(f"{word} {shown(row)} again {shown(again)}, {again['seconds']} s: {key_of(row)}", flush=True)
    except KeyboardInterrupt:
        print(f"interrupted; the rows above are in the record, and --seed {seed} goes on from there", file=sys.stderr)
        raise
    except InputError as error:
        refuse(f"{key_of(row)}: {error}")
    finally:
        write_text(PAGE, page_of(record(), known))
    print(sentence(kept["again"], known))


@app.command()
def pages() -> None:
    """Print the tables and numbers between the marks of every page anew."""
    rows = record()["rows"]
    for path in sorted([*DOCS.rglob("*.md"), ROOT / "README.md"]):
        text = path.read_text(encoding="utf-8")
        new = MARK.sub(lambda found: f"{found[1]}{table_of(rows, json.loads(found[2]))}{END}", text)
        new = INLINE.sub(lambda found: found[1] + number_of(rows, json.loads(found[2])) + found[3], new)
        if new != text:
            write_text(path, new)
            print(f"wrote {path}")


def shown(row: Mapping[str, Any], digits: int | None = 2, scale: float = 1.0, sign: str = "", unit: str = "") -> str:
    """A number with its interval; without ``digits`` it has three below 1, such as mm, and two above.

    A negative ``scale`` turns a difference round, and so its ends.
    """
    if digits is None:
        digits = 3 if scale * row["value"] < 1.0 else 2
    ends = row["ci95"][::-1] if row["ci95"] and scale < 0.0 else row["ci95"]
    return said(row["value"], ends, digits, scale, sign, unit)


def number_of(rows: Sequence[Row], asked: Mapping[str, Any]) -> str:
    """One number of the ledger in a sentence.

    Args:
        rows: The ledger's.
        asked: "of", the experiment; "title", how its title begins; levels by name; and how `shown` shows it.

    Raises:
        InputError: If no row, or more than one, is meant.
    """
    how = {name: asked[name] for name in ("digits", "scale", "sign", "unit") if name in asked}
    levels = {name: level for name, level in asked.items() if name not in ("of", "title", *how)}
    titled = [row for row in rows if row["experiment"] == asked["of"] and row["title"].startswith(asked["title"])]
    meant = [row for row in titled if levels.items() <= row["levels"].items()]
    if len(meant) != 1:
        raise InputError(f"{len(meant)} rows of the ledger are what {dict(asked)} asks for; name one")
    return shown(meant[0], **how)


def table_of(rows: Sequence[Row], asked: Mapping[str, Any]) -> str:
    """A table of the ledger's rows.

    Args:
        rows: The ledger's.
        asked: "experiment" and "title"; "by", the levels that stand in the lines, with those that are shown; "across",
            the level whose values are the columns, and "columns", those that are shown if not all; "digits", "scale"
            and "sign".
    """
    some = [row for row in rows if (row["experiment"], row["title"]) == (asked["experiment"], asked["title"])]
    across, by = asked["across"], asked["by"]
    columns = asked.get("columns") or list(dict.fromkeys(row["levels"][across] for row in some))
    cells: dict[tuple[Any, ...], dict[str, str]] = {}
    for row in some:
        line = tuple(row["levels"][name] for name in by)
        if all(value in by[name] or not by[name] for name, value in zip(by, line, strict=True)):
            number = shown(row, **{name: asked[name] for name in ("digits", "scale", "sign") if name in asked})
            words = f": {row['words']}" if "words" in row else ""
            cells.setdefault(line, {})[row["levels"][across]] = number + words
    names = {name: re.sub(r"_(mm|kg)$", r" (\1)", name).replace("_", " ") for name in by}
    lines = [[*names.values(), *map(str, columns)], ["---"] * (len(by) + len(columns))]
    for line, found in cells.items():
        words = ["" if level is None else f"{level:g}" if isinstance(level, float) else str(level) for level in line]
        lines.append([*words, *(found.get(column, "") for column in columns)])
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def sentence(again: Sequence[Row], known: Mapping[str, Row]) -> str:
    """The running share, and how many numbers of measured rows came out the same."""
    same = [row for row in again if known[row["claim"].split(": ")[0]].get("same", False)]
    drawn = [row for row in again if row not in same]
    words = "Nothing was made again yet."
    if drawn:
        held = sum(row["held"] for row in drawn)
        low, high = share_interval(held, len(drawn))
        words = (
            f"{held} of {len(drawn)} numbers held when they were made again, {100 * held / len(drawn):.0f} % "
            f"({100 * low:.0f} to {100 * high:.0f}); about {100 * DUE:.0f} % are due, as both numbers vary."
        )
    if same:
        words += f" Of the numbers of measured rows {sum(row['held'] for row in same)} of {len(same)} held."
    return words


def page_of(kept: Mapping[str, Sequence[Row]], known: Mapping[str, Row]) -> str:
    """The page "Do the numbers hold?"."""
    lines = ["| page | experiment | numbers | made again | held |", "|---|---|--:|--:|--:|"]
    for name, entry in known.items():
        numbers = [row for row in kept["rows"] if row["experiment"] == name]
        again = [row for row in kept["again"] if row["claim"].startswith(f"{name}: ")]
        page = f"[{entry['page'].removesuffix('.md')}]({entry['page']})"
        lines.append(f"| {page} | `{name}` | {len(numbers)} | {len(again)} | {sum(row['held'] for row in again)} |")
    text = Path(__file__).with_name("claims_page.md.template").read_text(encoding="utf-8")
    return Template(text).substitute(sentence=sentence(kept["again"], known), table="\n".join(lines))


if __name__ == "__main__":
    app()
