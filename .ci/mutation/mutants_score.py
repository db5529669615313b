"""What the trials of `mutants` come to: a score by room without what makes no difference, on screen and as a page."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterable, Mapping
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
        from pickenv.base import share_interval  # late: see WARM in mutants

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


def summary_of(
    now: Iterable[Score], samples: Iterable[Score], survivors: list[str], equivalents: Equivalents
) -> dict[str, Any]:
    """Every room's scores, what survived, and the changes that make no difference with their reasons.

    Args:
        now: By room, of all that is known of today's files.
        samples: Of fresh samples, in the order in which they were drawn.
        survivors: Keys of what the tests did not notice.
        equivalents: What is left out of the score.
    """

    def row(one: Score) -> dict[str, Any]:
        return {key: value for key, value in asdict(one).items() if key != "room"} | {"score": one.share}

    rooms: dict[str, Any] = {one.room: {"first": None, "fresh": [], "now": row(one)} for one in now}
    for one in samples:
        room = rooms.setdefault(one.room, {"first": None, "fresh": [], "now": None})
        if room["first"] is None:
            room["first"] = row(one)
        else:
            room["fresh"].append(row(one))
    makes_none = [
        {"file": path, "line": text, "change": change, "reason": reason}
        for (path, text, change), reason in sorted(equivalents.items())
    ]
    return {"rooms": rooms, "survivors": survivors, "make_no_difference": makes_none}


def page_of(summary: Mapping[str, Any]) -> str:
    """The page: what the rooms come to together, and where each stands."""
    rooms = summary["rooms"].values()
    parts = {
        "first try: samples that no test was written for": [room["first"] for room in rooms],
        "fresh since: further such samples": [one for room in rooms for one in room["fresh"]],
        "now: every change ever tried, in files that are the same since": [room["now"] for room in rooms],
    }
    lines = []
    for label, scores in parts.items():
        tried, killed = (sum(one[key] for one in scores if one) for key in ("tried", "killed"))
        lines.append(f"| {label} | {tried} | {killed} | {killed / max(tried, 1):.1%} |".replace("%", " %"))
    count = len(summary["survivors"])
    return PAGE.format(
        rooms=len(rooms),
        rows="\n".join(lines),
        survive=f"{count} change survives" if count == 1 else f"{count} changes survive",
        none=len(summary["make_no_difference"]),
    )


PAGE = """# Would the tests notice?

One operator, number, condition or option at a time is changed in the lines that make numbers. A change is
killed if a test of its room fails or does not end in time. Of {rooms} rooms together, each sampled alike
whatever its size:

| changes | tried | killed | share |
|:--|--:|--:|--:|
{rows}

The first line is the honest one: the tests as they were before any survivor was seen. Tests were then written
for what survived, so that the last line says too much. {survive} now.

[mutants.json](_static/mutants.json) has every room's score with Wilson's 95 % interval, what survives, and
{none} changes that make no difference, with their reasons.

Made by `make mutants ARGS=--known`, which tries nothing; samples are tried by
`make mutants ARGS="--room ROOM --sample 10 --seed SEED"`, survivors anew by `make mutants ARGS=--again`.
"""
