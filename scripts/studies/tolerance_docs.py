"""Print the tables behind docs/tolerance-studies.md anew, from both example studies at six seeds.

    python scripts/studies/tolerance_docs.py --out runs/seeds

The tables are of seed 0; the others say how far they may be trusted. Studies go on where they were stopped. All tables
go to docs/_static/tolerance-studies.txt, the one between the two marks in the page is replaced, and
docs/images/study-grades.png is drawn again.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer
from study_seeds import agreement, in_groups, sentence, sentence_of_groups

from pickenv.base import InputError, write_text
from pickenv.experiments import load_study, read_summary
from pickenv.experiments.study_findings import Findings, gather, setting_label, specified, yield_curves
from pickenv.experiments.study_variance import SAMPLES, sobol_of
from pickenv.inspect import save_figure
from pickenv.inspect.runs.number_words import percent

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "tolerance-studies.md"
TABLES = ROOT / "docs" / "_static" / "tolerance-studies.txt"
MARKS = ("<!-- tables: python scripts/studies/tolerance_docs.py -->", "<!-- end of tables -->")
STUDIES = ("tolerance_grades", "tolerance_study")
SEEDS = tuple(range(6))


def table(heads: Any, rows: Any) -> str:
    """A Markdown table."""
    return "\n".join(f"| {' | '.join(line)} |" for line in [heads, ["---"] * len(heads), *rows]) + "\n"


def crossed(rows: list[dict[str, Any]], heads: list[str], across: str) -> str:
    """Yields of settings as a table: values of ``heads`` name its lines, ``across`` its columns."""
    lines: dict[tuple[str, ...], dict[str, str]] = {}
    for row in rows:
        load = f"{row['payload_kg']:g} kg" if row["payload_kg"] else "none"
        words = {"class": row["tolerances"], "tracker noise": f"{row['noise_mm']:g} mm", "payload": load}
        cell = percent(row["yield"], row["yield_low"], row["yield_high"], 1)
        lines.setdefault(tuple(words[head] for head in heads), {})[across.format(**row)] = cell
    return table([*heads, *next(iter(lines.values()))], ([*line, *cells.values()] for line, cells in lines.items()))


def of_share(row: dict[str, Any], *keys: str) -> list[str]:
    """Shares with their intervals, percent."""
    return [percent(row[key], row[f"{key}_low"], row[f"{key}_high"]) for key in keys]


def sensitivities(findings: Findings) -> str:
    """Shares by regression beside Sobol's indices, and the parameters that matter most."""
    parts, protocol = [], findings.protocol
    for number, shares in findings.sensitivities.items():
        if isinstance(shares, str):
            raise InputError(shares)
        kinds, single = ([row for row in shares if row["level"] == level] for level in ("kind", "parameter"))
        indices = {row["group"]: row for row in sobol_of(protocol, protocol.settings[number], SAMPLES)}
        exact = {group: of_share(index, "first_order", "total") for group, index in indices.items()}
        rows = [(r["parameter"], *of_share(r, "share"), *exact.get(r["parameter"], ("-", "-"))) for r in kinds]
        lines = table(("tolerance", "share by regression", "Sobol, first order", "Sobol, total"), rows)
        most = ", ".join(f"`{row['parameter']}` {of_share(row, 'share')[0]}" for row in single[:6])
        about = f"adjusted R² {single[0]['r2_adjusted']:.2f}; largest single parameters: {most}"
        parts.append(f"{findings.label(number)} ({about}):\n\n{lines}")
    return "\n".join(parts)


def printed(out: Path) -> tuple[str, str]:
    """The table between the marks of the page, and all tables."""
    one, other = (load_study(ROOT / "scripts" / f"{name}.toml") for name in STUDIES)
    groups = in_groups(one, range(10 * len(SEEDS)), len(SEEDS), out / STUDIES[0])  # ten, of the quicker study
    grades, study = (f"`{name}.toml`" for name in STUDIES)
    counts = [sentence(grades, SEEDS, groups[0]), sentence_of_groups(grades, len(SEEDS), groups)]
    counts.append(sentence(study, SEEDS, agreement(other, SEEDS, out / STUDIES[1])))
    first, second = (gather(out / name / f"seed-{SEEDS[0]}") for name in STUDIES)
    save_figure(yield_curves(first.yields, "it_grade", specified(one)), ROOT / "docs/images/study-grades.png")
    raw = [row for row in first.yields if row["method"] == "raw"]
    ls = [row for row in second.yields if row["method"] == "ls" and row["it_grade"] == 12]
    ls.sort(key=lambda row: (row["noise_mm"], row["payload_kg"], row["poses"]))
    components: list[list[str]] = []
    for setting in read_summary(out / STUDIES[1] / f"seed-{SEEDS[0]}")["components"]:
        label = setting_label(setting)
        components += [[label, row["group"], *of_share(row, "first_order", "total")] for row in setting["shares"]]
    own = {number: place for number, place in second.placements.items() if not isinstance(place, str)}
    places = [(second.label(n), f"{p.error_mm:.2f} mm", percent(p.percentile, *p.interval)) for n, p in own.items()]
    smaller = ("setting", "its mean error", "arms with a smaller error at the same fruit and poses")
    near = [f"a fruit counts within {config.radius_mm:g} mm" for config in (one, other)]
    by_pose_count = crossed(ls, ["tracker noise", "payload"], "{poses} poses")
    by_cause = table(("setting", "drawn anew", "alone", "with interactions"), components)
    parts = {
        f"Uncalibrated, {near[0]} ({grades})": crossed(raw, ["class"], "IT{it_grade}"),
        f"Calibrated by least squares, {near[1]} ({study}, class medium, IT12)": by_pose_count,
        "Where the differences between arms come from": by_cause,
        "Which tolerance matters (in Sobol's groups lead errors count as transmission error)": sensitivities(second),
        "The arm of the paper's Table 1 in its population": table(smaller, places),
        "At other seeds": "".join(f"- {count}\n" for count in counts),
    }
    return by_pose_count, "\n".join(f"{title}:\n\n{part}" for title, part in parts.items())


def main(out: Path = Path("runs/seeds")) -> None:
    """Print the tables, and put them into the page and beside it."""
    (before, rest), (shown, text) = PAGE.read_text(encoding="utf-8").split(MARKS[0]), printed(out)
    write_text(PAGE, f"{before}{MARKS[0]}\n\n{shown}\n{MARKS[1]}{rest.split(MARKS[1])[1]}")
    write_text(TABLES, text)
    print(text)


if __name__ == "__main__":
    typer.run(main)
