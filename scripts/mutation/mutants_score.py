"""What the trials of `mutants` come to: a score by room without what makes no difference, on screen and as a page."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

EQUIVALENT = Path(__file__).with_name("mutants_equivalent.toml")

Equivalents = dict[tuple[str, str, str], str]
"""Changes that make no difference, by file, line as it stands and change: why each makes none."""


def read_equivalents() -> Equivalents:
    """What `EQUIVALENT` says."""
    tables = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8")).get("equivalent", [])
    return {(t["file"], t["line"], change): t["reason"] for t in tables for change in t["changes"]}


def table(rows: dict[str, dict[str, Any]]) -> str:
    """The score by room, with Wilson's interval; what took too long counts as killed."""
    lines = [
        f"{'room':<14} {'mutants':>8} {'tried':>6} {'killed':>7} {'of these late':>14} {'score':>7}  95 % interval"
    ]
    for name, row in rows.items():
        low, high = row["interval"]
        lines.append(
            f"{name:<14} {row['mutants']:>8} {row['tried']:>6} {row['killed']:>7} {row['late']:>14} "
            f"{row['score']:>7.1%}  {low:.1%} to {high:.1%}"
        )
    return "\n".join(lines)


def row_of(mutants: int, verdicts: list[str]) -> dict[str, Any]:
    """The score of some verdicts."""
    from pickenv.intervals import share_interval  # late: see WARM in mutants

    late, killed = verdicts.count("took too long"), len(verdicts) - verdicts.count("passed")
    return {
        "mutants": mutants,
        "tried": len(verdicts),
        "killed": killed,
        "late": late,
        "score": killed / len(verdicts),
        "interval": share_interval(killed, len(verdicts)),
    }


def page_of(
    rows: dict[str, dict[str, Any]], sample: int | None, seed: int, survivors: list[str], equivalents: Equivalents
) -> str:
    """The page with every room's kill rate, what survived, and the changes that make no difference with their reasons.

    Args:
        rows: By room, from `row_of`.
        sample: Mutants of each room; None for the rooms' own numbers, 0 for all.
        seed: Seed of the sample.
        survivors: Keys of what the tests did not notice.
        equivalents: What is left out of the score.
    """
    own = f"as many of each room as the table says, drawn with seed {seed}"
    drawn = own if sample is None else f"{sample} of each room, drawn with seed {seed}" if sample else "all"
    wanted = f"--seed {seed}" if sample is None else f"--sample {sample} --seed {seed}" if sample else "--sample 0"
    lines = [
        "# Would the tests notice?",
        "",
        "One operator, number, condition or option at a time is changed in the lines that make numbers; a change is",
        "killed if a test of its room fails, or does not end in time (late). The score is the share killed of those",
        f"tried, {drawn}. In brackets stands Wilson's 95 % interval for all mutants of the room. It holds for a sample",
        "that no test was written for: where survivors of this one were killed since, another seed scores lower.",
        "",
        f'Made by `make mutants ARGS="{wanted}"`.',
        "",
        "| room | mutants | tried | killed | of these late | score (95 % interval) |",
        "|:--|--:|--:|--:|--:|--:|",
    ]
    for name, row in rows.items():
        low, high = (f"{100.0 * end:.0f}" for end in row["interval"])
        score = f"{100.0 * row['score']:.1f} % ({low} to {high})"
        lines.append(f"| {name} | {row['mutants']} | {row['tried']} | {row['killed']} | {row['late']} | {score} |")
    lines += ["", f"## What survived: {len(survivors)}", ""]
    lines += [f"- `{key}`" for key in survivors]
    lines += ["", "## Changes that make no difference", "", "They are left out of the score.", ""]
    lines += ["| file | line | change | why it makes none |", "|:--|:--|:--|:--|"]
    for (path, text, change), reason in sorted(equivalents.items()):
        lines.append(f"| {path} | {code(text)} | {code(change)} | {reason} |")
    return "\n".join(lines) + "\n"


def code(text: str) -> str:
    """Code in a cell of a Markdown table."""
    return "`" + text.replace("|", "\\|") + "`"
