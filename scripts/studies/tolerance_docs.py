"""Print the tables of docs/tolerance-studies.md anew, from both example studies at six seeds.

    python scripts/studies/tolerance_docs.py --out runs/seeds

The tables are of seed 0; the others say how far they may be trusted. Studies go on where they were stopped. What stands
between the two marks in the page is replaced, and docs/images/study-grades.png is drawn again.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import typer
from study_seeds import agreement, in_groups, sentence, sentence_of_groups

from pickenv.base import InputError, write_text
from pickenv.experiments import load_study, read_summary
from pickenv.experiments.study_figures import yield_curves
from pickenv.experiments.study_findings import Findings, gather, setting_label, specified
from pickenv.experiments.study_variance import SAMPLES, sobol_of
from pickenv.inspect import save_figure
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
    return "\n".join(f"| {' | '.join(line)} |" for line in [heads, ["---"] * len(heads), *rows]) + "\n"


def crossed(rows: Sequence[Row], heads: Sequence[str], across: str) -> str:
    """Yields of settings as a table: values of ``heads`` name its lines, ``across`` its columns."""
    lines: dict[tuple[str, ...], dict[str, str]] = {}
    for row in rows:
        load = f"{row['payload_kg']:g} kg" if row["payload_kg"] else "none"
        words = {"class": row["tolerances"], "tracker noise": f"{row['noise_mm']:g} mm", "payload": load}
        cell = percent(row["yield"], row["yield_low"], row["yield_high"], 1)
        lines.setdefault(tuple(words[head] for head in heads), {})[across.format(**row)] = cell
    columns = next(iter(lines.values()))
    return table([*heads, *columns], ([*line, *cells.values()] for line, cells in lines.items()))


def of_share(row: Row, *keys: str) -> list[str]:
    """Shares with their intervals, percent."""
    ends = [[None if row[end] is None else 100 * row[end] for end in (f"{k}_low", f"{k}_high")] for k in keys]
    return [estimated(100 * row[key], low, high, 0, " %") for key, (low, high) in zip(keys, ends, strict=True)]


def components(summary: Row) -> str:
    """Where the differences between arms come from."""
    rows = [
        (setting_label(setting), row["group"], *of_share(row, "first_order", "total"))
        for setting in summary["components"] for row in setting["shares"]
    ]  # fmt: skip
    return table(("setting", "drawn anew", "alone", "with interactions"), rows)


def sensitivities(findings: Findings) -> str:
    """Shares by regression beside Sobol's indices, and the parameters that matter most."""
    parts, protocol = [], findings.protocol
    for number, shares in findings.sensitivities.items():
        if isinstance(shares, str):
            raise InputError(shares)
        kinds, single = ([row for row in shares if row["level"] == level] for level in ("kind", "parameter"))
        indices = {row["group"]: row for row in sobol_of(protocol, protocol.settings[number], SAMPLES)}
        rows = []
        for row in kinds:
            index = indices.get(row["parameter"])
            exact = ["-", "-"] if index is None else of_share(index, "first_order", "total")
            rows.append((row["parameter"], *of_share(row, "share"), *exact))
        lines = table(("tolerance", "share by regression", "Sobol, first order", "Sobol, total"), rows)
        most = ", ".join(f"`{row['parameter']}` {of_share(row, 'share')[0]}" for row in single[:MATTERS])
        about = f"adjusted R² {single[0]['r2_adjusted']:.2f}; largest single parameters: {most}"
        parts.append(f"{findings.label(number)} ({about}):\n\n{lines}")
    return "\n".join(parts)


def placements(findings: Findings) -> str:
    """Where the paper's own arm stands."""
    rows = [
        (findings.label(number), f"{p.error_mm:.2f} mm", percent(p.percentile, *p.interval))
        for number, p in findings.placements.items() if not isinstance(p, str)
    ]  # fmt: skip
    return table(("setting", "its mean error", "arms with a smaller error at the same fruit and poses"), rows)


def printed(out: Path) -> str:
    """Everything between the marks."""
    one, other = (load_study(ROOT / "scripts" / f"{name}.toml") for name in STUDIES)
    groups = in_groups(one, range(GROUPS * len(SEEDS)), len(SEEDS), out / STUDIES[0])
    counts = [sentence(f"`{STUDIES[0]}.toml`", SEEDS, groups[0])]
    counts += [sentence_of_groups(f"`{STUDIES[0]}.toml`", len(SEEDS), groups)]
    counts += [sentence(f"`{STUDIES[1]}.toml`", SEEDS, agreement(other, SEEDS, out / STUDIES[1]))]
    first, second = (gather(out / name / f"seed-{SEEDS[0]}") for name in STUDIES)
    save_figure(yield_curves(first.yields, "it_grade", specified(one)), ROOT / "docs/images/study-grades.png")
    raw = [row for row in first.yields if row["method"] == "raw"]
    ls = [row for row in second.yields if row["method"] == "ls" and row["it_grade"] == 12]
    ls.sort(key=lambda row: (row["noise_mm"], row["payload_kg"], row["poses"]))
    parts = {
        f"Uncalibrated, a fruit counts within {one.radius_mm:g} mm (`{STUDIES[0]}.toml`)": crossed(
            raw, ["class"], "IT{it_grade}"
        ),
        f"Calibrated by least squares, a fruit counts within {other.radius_mm:g} mm (`{STUDIES[1]}.toml`, class "
        "medium, IT12)": crossed(ls, ["tracker noise", "payload"], "{poses} poses"),
        "Where the differences between arms come from": components(read_summary(out / STUDIES[1] / f"seed-{SEEDS[0]}")),
        "Which tolerance matters (in Sobol's groups lead errors count as transmission error)": sensitivities(second),
        "The arm of the paper's Table 1 in its population": placements(second),
        "At other seeds": "".join(f"- {count}\n" for count in counts),
    }
    return "\n".join(f"{title}:\n\n{part}" for title, part in parts.items())


def main(out: Path = Path("runs/seeds")) -> None:
    """Print the tables, and put them into the page."""
    text, page = printed(out), PAGE.read_text(encoding="utf-8")
    before, mark, rest = page.partition(MARKS[0])
    _, end, after = rest.partition(MARKS[1])
    if not mark or not end:
        raise InputError(f"{PAGE} has no marks {MARKS[0]} and {MARKS[1]}; put them back")
    write_text(PAGE, f"{before}{mark}\n\n{text}\n{end}{after}")
    print(text)


if __name__ == "__main__":
    typer.run(main)
