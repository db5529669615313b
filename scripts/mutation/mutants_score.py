"""What the trials of `mutants` come to: a score by room without what makes no difference, on screen and as a page."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

EQUIVALENT = Path(__file__).with_name("mutants_equivalent.toml")

Equivalents = dict[tuple[str, str, str], str]
"""Changes that make no difference, by file, line as it stands and change: why each makes none."""


def read_equivalents() -> Equivalents:
    """What `EQUIVALENT` says."""
    tables = tomllib.loads(EQUIVALENT.read_text(encoding="utf-8")).get("equivalent", [])
    return {(t["file"], t["line"], change): t["reason"] for t in tables for change in t["changes"]}


@dataclass(frozen=True)
class Score:
    """What the trials of a room came to.

    Attributes:
        room: Its name.
        mutants: How many it has that matter.
        tried: How many were tried.
        killed: How many of these the tests noticed.
        late: How many of the killed by tests that did not end in time.
        seed: Of the sample that they are; None for all that were ever tried.
    """

    room: str
    mutants: int
    tried: int
    killed: int
    late: int
    seed: int | None = None

    @property
    def share(self) -> str:
        """Killed in percent of those tried, with Wilson's 95 % interval."""
        from pickenv.intervals import share_interval  # late: see WARM in mutants

        low, high = share_interval(self.killed, self.tried)
        return f"{self.killed / self.tried:.1%} ({100.0 * low:.0f} to {100.0 * high:.0f})".replace("%", " %")


def score_of(room: str, mutants: int, verdicts: list[str], seed: int | None = None) -> Score:
    """The score of some verdicts; what took too long counts as killed."""
    killed = len(verdicts) - verdicts.count("passed")
    return Score(room, mutants, len(verdicts), killed, verdicts.count("took too long"), seed)


def table(scores: Iterable[Score]) -> str:
    """The score by room."""
    lines = [f"{'room':<14} {'mutants':>8} {'tried':>6} {'killed':>7} {'of these late':>14}  score (95 % interval)"]
    for one in scores:
        lines.append(f"{one.room:<14} {one.mutants:>8} {one.tried:>6} {one.killed:>7} {one.late:>14}  {one.share}")
    return "\n".join(lines)


def as_lines(samples: Iterable[Score], mutants: dict[str, dict[str, Any]]) -> str:
    """Scores of samples and verdicts by mutant as JSON, one on a line, verdicts in alphabetical order."""

    def line(value: object) -> str:
        return json.dumps(value, ensure_ascii=False)

    scores = ",\n".join(line(asdict(one)) for one in samples)
    verdicts = ",\n".join(f"{line(key)}: {line(mutants[key])}" for key in sorted(mutants))
    return f'{{"samples": [\n{scores}\n],\n"mutants": {{\n{verdicts}\n}}}}\n'


PAGE = """# Would the tests notice?

One operator, number, condition or option at a time is changed in the lines that make numbers; a change is
killed if a test of its room fails, or does not end in time (late). The score is the share killed of those
tried, with Wilson's 95 % interval for all mutants of the room. That interval holds for a sample that no test
was written for.

**First try** is such a sample, scored before any of its survivors was seen: the honest score of the tests as
they were then. Since then tests were written, and code that makes no difference was taken out. **Fresh since**
are further such samples, each drawn with a new seed after that, in their order. **Now** counts the changes tried
in any sample, in files that are the same since: among them are those that tests were written for, so that its
interval says too much. What survived counts as surviving until it is tried again.

Made by `make mutants ARGS=--known` of what `scripts/mutation/mutants_kept.json` holds, which tries nothing; samples
are tried by `make mutants ARGS="--room ROOM --sample 10 --seed SEED"`, survivors anew by `make mutants ARGS=--again`.

| room | mutants | first try: seed | score | fresh since: seed | score | now: tried | killed | of these late | score |
|:--|--:|--:|--:|--:|--:|--:|--:|--:|--:|
"""


def page_of(now: Iterable[Score], samples: Iterable[Score], survivors: list[str], equivalents: Equivalents) -> str:
    """The page with every room's kill rate, what survived, and the changes that make no difference with their reasons.

    Args:
        now: By room, of all that is known of today's files.
        samples: Of fresh samples, in the order in which they were drawn.
        survivors: Keys of what the tests did not notice.
        equivalents: What is left out of the score.
    """
    fresh: dict[str, list[Score]] = {}
    for one in samples:
        fresh.setdefault(one.room, []).append(one)
    latest = {one.room: one for one in now}
    lines = [PAGE.rstrip()]
    for room in latest | fresh:
        drawn = fresh.get(room, [])
        cells = [room, str((latest.get(room) or drawn[-1]).mutants)]
        for some in (drawn[:1], drawn[1:]):
            cells += ["; ".join(str(one.seed) for one in some) or "–"]
            cells += ["; ".join(f"{one.killed} of {one.tried}: {one.share}" for one in some) or "–"]
        one = latest.get(room)
        cells += [str(one.tried), str(one.killed), str(one.late), one.share] if one else ["–"] * 3 + ["not tried since"]
        lines.append("| " + " | ".join(cells) + " |")
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
