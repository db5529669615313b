"""Print the tables of docs/tolerance-studies.md anew, from both example studies at six seeds.

    python scripts/studies/tolerance_docs.py --out runs/seeds

The tables are of seed 0; the others say how far they may be trusted. Studies go on where they were stopped. What stands
between the two marks in the page is replaced, and docs/images/study-grades.png is drawn again.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from study_seeds import agreement, in_groups, sentence, sentence_of_groups

from pickenv.errors import InputError
from pickenv.experiments.study import load_study
from pickenv.experiments.study_figures import yield_curves
from pickenv.experiments.study_findings import Findings, gather, setting_label, specified
from pickenv.experiments.study_rows import read_summary
from pickenv.experiments.study_variance import SAMPLES, sobol_of
from pickenv.files import write_text
from pickenv.inspect.figures.style import save_figure
from pickenv.inspect.reports.report_words import estimated, percent

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tolerance-studies.md"
MARKS = ("<!-- tables: python scripts/studies/tolerance_docs.py -->", "<!-- end of tables -->")
STUDIES = ("tolerance_grades", "tolerance_study")
SEEDS = tuple(range(6))
GROUPS = 10
"""Groups of as many seeds, the first of them `SEEDS`, in which the quicker study is run."""
MATTERS = 6
"""Parameters in the table of shares."""

Row = dict[str, Any]


def table(heads: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [heads, ["---"] * len(heads), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines) + "\n"


def crossed(rows: Sequence[Row], down: Callable[[Row], Sequence[str]], across: Callable[[Row], str]) -> str:
    """Yields of settings as a table: what ``down`` says of a setting names its line, ``across`` its column."""
    columns = list(dict.fromkeys(across(row) for row in rows))
    lines: dict[tuple[str, ...], dict[str, str]] = {}
    for row in rows:
        cell = percent(row["yield"], row["yield_low"], row["yield_high"], 1)
        lines.setdefault(tuple(down(row)), {})[across(row)] = cell
    heads = ["class"] if len(next(iter(lines))) == 1 else ["tracker noise", "payload"]
    return table([*heads, *columns], ([*line, *(cells[c] for c in columns)] for line, cells in lines.items()))


def grades(found: Findings) -> str:
    """Yields against the grade, raw arms."""
    rows = [row for row in found.yields.to_pylist() if row["method"] == "raw"]
    return crossed(rows, lambda row: (row["tolerances"],), lambda row: f"IT{row['it_grade']}")


def poses(found: Findings) -> str:
    """Yields against the number of poses, at IT12."""
    rows = [row for row in found.yields.to_pylist() if row["method"] == "ls" and row["it_grade"] == 12]
    rows.sort(key=lambda row: (row["noise_mm"], row["payload_kg"], row["poses"]))

    def down(row: Row) -> tuple[str, str]:
        return f"{row['noise_mm']:g} mm", f"{row['payload_kg']:g} kg" if row["payload_kg"] else "none"

    return crossed(rows, down, lambda row: f"{row['poses']} poses")


def of_share(row: Row, key: str) -> str:
    """A share with its interval, percent."""
    low, high = (None if row[end] is None else 100 * row[end] for end in (f"{key}_low", f"{key}_high"))
    return estimated(100 * row[key], low, high, 0, " %")


def components(summary: Row) -> str:
    """Where the differences between arms come from."""
    rows = [
        (setting_label(setting), row["group"], of_share(row, "first_order"), of_share(row, "total"))
        for setting in summary["components"]
        for row in setting["shares"]
    ]
    return table(("setting", "drawn anew", "alone", "with interactions"), rows)


def sensitivities(found: Findings) -> str:
    """Shares by regression beside Sobol's indices, and the parameters that matter most."""
    parts = []
    for number, shares in found.sensitivities.items():
        if isinstance(shares, str):
            raise InputError(shares)
        kinds = {row["parameter"]: row for row in shares.to_pylist() if row["level"] == "kind"}
        single = [row for row in shares.to_pylist() if row["level"] == "parameter"][:MATTERS]
        indices = {row["group"]: row for row in sobol_of(found.protocol, found.protocol.settings[number], SAMPLES)}
        rows = []
        for kind, row in kinds.items():
            index = indices.get(kind)
            exact = ("-", "-") if index is None else (of_share(index, "first_order"), of_share(index, "total"))
            rows.append((kind, of_share(row, "share"), *exact))
        heads = ("tolerance", "share by regression", "Sobol, first order", "Sobol, total")
        most = ", ".join(f"`{row['parameter']}` {of_share(row, 'share')}" for row in single)
        label, r2 = setting_label(found.row(number)), single[0]["r2_adjusted"]
        parts.append(f"{label} (adjusted R² {r2:.2f}; largest single parameters: {most}):\n\n{table(heads, rows)}")
    return "\n".join(parts)


def placements(found: Findings) -> str:
    """Where the paper's own arm stands."""
    rows = []
    for number, placement in found.placements.items():
        if isinstance(placement, str):
            raise InputError(placement)
        share = percent(placement.percentile, *placement.interval)
        rows.append((setting_label(found.row(number)), f"{placement.error_mm:.2f} mm", share))
    return table(("setting", "its mean error", "arms with a smaller error at the same fruit and poses"), rows)


def printed(out: Path) -> str:
    """Everything between the marks."""
    said, found = [], {}
    for name in STUDIES:
        config = load_study(ROOT / "scripts" / f"{name}.toml")
        said.append("- " + sentence(f"`{name}.toml`", SEEDS, agreement(config, SEEDS, out / name)))
        if name == STUDIES[0]:
            groups = in_groups(config, range(GROUPS * len(SEEDS)), len(SEEDS), out / name)
            said.append("- " + sentence_of_groups(f"`{name}.toml`", len(SEEDS), groups))
        found[name] = gather(out / name / f"seed-{SEEDS[0]}")
    first, second = (found[name] for name in STUDIES)
    save_figure(yield_curves(first.yields, "it_grade", specified(first.config)), ROOT / "docs/images/study-grades.png")
    summary = read_summary(out / STUDIES[1] / f"seed-{SEEDS[0]}")
    return "\n".join(
        (
            f"Uncalibrated, a fruit counts within {first.config.radius_mm:g} mm (`{STUDIES[0]}.toml`):\n",
            grades(first),
            f"Calibrated by least squares, a fruit counts within {second.config.radius_mm:g} mm (`{STUDIES[1]}.toml`, "
            "class medium, IT12):\n",
            poses(second),
            "Where the differences between arms come from:\n",
            components(summary),
            "Which tolerance matters (in Sobol's groups lead errors count as transmission error):\n",
            sensitivities(second),
            "The arm of the paper's Table 1 in its population:\n",
            placements(second),
            "At other seeds:\n",
            "\n".join(said) + "\n",
        )
    )


def replaced(page: str, text: str) -> str:
    """The page with other text between its marks."""
    before, mark, rest = page.partition(MARKS[0])
    _, end, after = rest.partition(MARKS[1])
    if not mark or not end:
        raise InputError(f"{PAGE} has no marks {MARKS[0]} and {MARKS[1]}; put them back")
    return f"{before}{mark}\n\n{text}\n{end}{after}"


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("runs/seeds"))
    arguments = parser.parse_args()
    text = printed(arguments.out)
    write_text(PAGE, replaced(PAGE.read_text(encoding="utf-8"), text))
    print(text)


if __name__ == "__main__":
    main()
