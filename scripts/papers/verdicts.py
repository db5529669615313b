"""Verdicts on what a paper states: what they are, and how pages and screens say them.

``reproduced``: what the paper states comes out of our run; ``fitted``: a constant of ours was chosen so that it does;
``not reproduced``: it does not, or nobody could say. A reason with figures stands beside each.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

REPRODUCED, NOT, FITTED = "reproduced", "not reproduced", "fitted"


def judged(verdict: str, reason: str, rows: Sequence[Mapping[str, Any]], **more: Any) -> dict[str, Any]:
    """A table with its verdict, as it goes into JSON."""
    return {"verdict": verdict, "reason": reason, "rows": list(rows), **more}


def said(name: str, table: Mapping[str, Any]) -> str:
    """A title with its verdict."""
    return f"{name}: {table['verdict'].upper()}. {table['reason']}"


def headline(result: Mapping[str, Any]) -> str:
    """How many of tables, equations and figures came out again."""
    kinds = [kind for kind in ("tables", "equations", "claims", "figures", "experiments") if kind in result]
    each = [part["verdict"] for kind in kinds for part in result[kind].values()]
    return (
        f"Of {len(each)} {', '.join(kinds[:-1])} and {kinds[-1]} {each.count('reproduced')} are reproduced, "
        f"{each.count('fitted')} fitted, {each.count('not reproduced')} not reproduced"
    )
