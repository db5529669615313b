"""What the trials of `mutants` come to: a score by room without what makes no difference, on screen and as a page."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Sample:
    """Which mutants were tried.

    Attributes:
        seed: Of the draw.
        most: Of each room; None for the rooms' own numbers, 0 for all.
        known: Whether nothing was tried: what counts is what any sample drew, in files that are the same.
    """

    seed: int
    most: int | None = None
    known: bool = False

    @property
    def options(self) -> str:
        """How to ask for it."""
        if self.known:
            return "--known --also FILE"
        return f"--seed {self.seed}" if self.most is None else f"--sample {self.most} --seed {self.seed}"

    def __str__(self) -> str:
        if self.known:
            return "tried in any sample, in files that are the same since"
        own = "as many of each room as the table says" if self.most is None else f"{self.most or 'all'} of each room"
        return own if self.most == 0 else f"{own}, drawn with seed {self.seed}"


def first_try(files: Iterable[Path]) -> tuple[int | None, dict[str, dict[str, Any]]]:
    """Seed and scores by room of one sample, as runs of some rooms each found it before its survivors were looked at.

    Raises:
        SystemExit: If the runs are not of one seed.
    """
    found = [json.loads(path.read_text(encoding="utf-8")) for path in files]
    if len(seeds := {result["seed"] for result in found}) > 1:
        raise SystemExit(f"the first tries are of seeds {', '.join(map(str, sorted(seeds)))}; give runs of one seed")
    return next(iter(seeds), None), {name: row for result in found for name, row in result["rooms"].items()}


def score_of(row: dict[str, Any]) -> str:
    """A score with its interval."""
    low, high = (f"{100.0 * end:.0f}" for end in row["interval"])
    return f"{100.0 * row['score']:.1f} % ({low} to {high})"


def page_of(
    rows: dict[str, dict[str, Any]],
    sample: Sample,
    survivors: list[str],
    equivalents: Equivalents,
    first: tuple[int | None, dict[str, dict[str, Any]]] = (None, {}),
) -> str:
    """The page with every room's kill rate, what survived, and the changes that make no difference with their reasons.

    Args:
        rows: By room, from `row_of`.
        sample: What was tried.
        survivors: Keys of what the tests did not notice.
        equivalents: What is left out of the score.
        first: Seed and rows of an earlier fresh sample, from `first_try`.
    """
    seed, before = first
    lines = [
        "# Would the tests notice?",
        "",
        "One operator, number, condition or option at a time is changed in the lines that make numbers; a change is",
        "killed if a test of its room fails, or does not end in time (late). The score is the share killed of those",
        "tried, with Wilson's 95 % interval for all mutants of the room. That interval holds for a sample that no test",
        "was written for.",
        "",
    ]
    if before:
        lines += [
            f"**First try** is such a sample, drawn with seed {seed}, scored before any of its survivors was seen: the",
            "honest score of the tests as they were then. Since then tests were written, and code that makes no",
            f"difference was taken out. **Now** counts the changes {sample}:",
            "among them are those that tests were written for, so that its interval says too much. What survived",
            "counts as surviving until it is tried again.",
        ]
    else:
        lines += [f"**Now** counts the changes {sample}. Where survivors were killed since, another seed scores lower."]
    options = sample.options + (" --first FILE" if before else "")
    lines += ["", f'Made by `make mutants ARGS="{options}"`.', ""]
    lines += [
        "| room | mutants | first try: tried | killed | score | now: tried | killed | of these late | score |",
        "|:--|--:|--:|--:|--:|--:|--:|--:|--:|",
    ]
    for name in [*rows, *(name for name in before if name not in rows)]:
        then, now = before.get(name), rows.get(name)
        counts = [str(then[key]) if then else "–" for key in ("tried", "killed")]
        latest = [str(now[key]) if now else "–" for key in ("tried", "killed", "late")]
        mutants = (now or before[name])["mutants"]
        scores = score_of(then) if then else "–", score_of(now) if now else "not tried since"
        lines.append("| " + " | ".join([name, str(mutants), *counts, scores[0], *latest, scores[1]]) + " |")
    lines += ["", f"## What survives now: {len(survivors)}", ""]
    lines += [f"- `{key}`" for key in survivors]
    lines += ["", "## Changes that make no difference", "", "They are left out of the score.", ""]
    lines += ["| file | line | change | why it makes none |", "|:--|:--|:--|:--|"]
    for (path, text, change), reason in sorted(equivalents.items()):
        lines.append(f"| {path} | {code(text)} | {code(change)} | {reason} |")
    return "\n".join(lines) + "\n"


def code(text: str) -> str:
    """Code in a cell of a Markdown table."""
    return "`" + text.replace("|", "\\|") + "`"
