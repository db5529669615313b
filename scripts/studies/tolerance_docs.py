"""Print the tables of causes behind docs/tolerance-studies.md, and draw its figure, from both example studies.

    python scripts/studies/tolerance_docs.py --out runs/tolerances

Studies go on where they were stopped. The tables go to docs/_static/tolerance-studies.txt, and
docs/images/study-grades.png is drawn again. The yields are the ledger's (scripts/studies/tolerances.toml).
"""

from pathlib import Path
from typing import Any

import typer

from pickenv.base import InputError, write_text
from pickenv.experiments import load_study, read_summary, run_study
from pickenv.experiments.study_findings import Findings, gather, setting_label, specified, yield_curves
from pickenv.experiments.study_variance import SAMPLES, sobol_of
from pickenv.inspect import save_figure
from pickenv.inspect.colours import percent

ROOT = Path(__file__).parents[2]
TABLES = ROOT / "docs" / "_static" / "tolerance-studies.txt"
STUDIES = ("tolerance_grades", "tolerance_study")


def table(heads: Any, rows: Any) -> str:
    """A Markdown table."""
    return "\n".join(f"| {' | '.join(line)} |" for line in [heads, ["---"] * len(heads), *rows]) + "\n"


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


def main(out: Path = Path("runs/tolerances")) -> None:
    """Print the tables, and put them beside the page."""
    for name in STUDIES:
        run_study(load_study(ROOT / "scripts" / f"{name}.toml"), out / name, executor="batched")
    first, second = (gather(out / name) for name in STUDIES)
    specification = specified(first.protocol.config)
    save_figure(yield_curves(first.yields, "it_grade", specification), ROOT / "docs/images/study-grades.png")
    components = [
        [setting_label(setting), row["group"], *of_share(row, "first_order", "total")]
        for setting in read_summary(out / STUDIES[1])["components"]
        for row in setting["shares"]
    ]
    causes = table(("setting", "drawn anew", "alone", "with interactions"), components)
    groups = "(in Sobol's groups lead errors count as transmission error)"
    matters = f"Which tolerance matters {groups}:\n\n{sensitivities(second)}"
    text = f"Where the differences between arms come from:\n\n{causes}\n{matters}"
    write_text(TABLES, text)
    print(text)


if __name__ == "__main__":
    typer.run(main)
