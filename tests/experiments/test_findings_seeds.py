"""What other seeds say of the findings: the page counts what the file holds, and no sentence turns round."""

import json
import re
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def by_seed():
    return json.loads((DOCS / "_static/findings-seeds.json").read_text(encoding="utf-8"))


def test_the_page_counts_the_intervals_that_hold(by_seed):
    """Of all pairs of seeds; an open end holds what lies on its side."""
    held = []
    for one, other in permutations(by_seed, 2):
        for what, claim in one.items():
            if claim["ci95"] is not None and what in other:
                low, high = (np.nan if end is None else end for end in claim["ci95"])
                held.append(not other[what]["value"] < low and not other[what]["value"] > high)
    page = (DOCS / "findings-seeds.md").read_text(encoding="utf-8")
    (shown,) = re.findall(r"^\| all \| (\d+) \| (\d+) \|", page, re.MULTILINE)
    assert tuple(map(int, shown)) == (sum(held), len(held)) and np.mean(held) > 0.83


def test_no_sentence_turns_round_at_another_seed(by_seed):
    """The order of calibrations, and the sign of every change that is said, are those of the page at each seed."""
    for claims in by_seed:
        for plant in ("qiao2026", "field"):
            order = ("raw", "LS", "LS+BPNN", "LS+GP")
            left = [claims[f"{plant}, scripted, {key}, mean error, mm"]["value"] for key in order]
            assert left == sorted(left, reverse=True)
        for what, claim in claims.items():
            if (claim["said"] and "change" in what) or claim["kind"] == "instrument":
                assert claim["value"] < 0.0 and claim["ci95"][1] < 0.0, what
