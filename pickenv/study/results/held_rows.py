"""Which of a study's settings stand for the rest: those in which all that is not shown has its middle value."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pickenv.study.design.config import RAW

Row = Mapping[str, Any]

VARIED = ("it_grade", "poses", "noise_mm", "payload_kg")
"""What a study may vary, beside tolerance class and method."""


def held(rows: Sequence[Row], shown: Sequence[str]) -> list[Row]:
    """The rows in which everything that is not shown stands at its middle value; raw arms have no poses and noise."""
    calibrated = [row for row in rows if row["method"] != RAW] or rows
    middle = {}
    for name in ("tolerances", *VARIED):
        values = list(dict.fromkeys(row[name] for row in calibrated))
        middle[name] = values[(len(values) - 1) // 2]

    def fits(row: Row) -> bool:
        free = ("poses", "noise_mm") if row["method"] == RAW else ()
        return all(row[name] == value for name, value in middle.items() if name not in (*shown, *free))

    return [row for row in rows if fits(row)]
