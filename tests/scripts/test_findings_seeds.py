"""What other seeds say of the findings: the page is made of its numbers, and no sentence turns round."""

import importlib
import json
from pathlib import Path

import pandas as pd
import pytest

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend("scripts/policies")
    return importlib.import_module("findings_seeds")


@pytest.fixture(scope="module")
def by_seed():
    return json.loads((DOCS / "_static/findings-seeds.json").read_text(encoding="utf-8"))


def test_the_page_is_made_of_its_numbers(script, by_seed):
    assert "\n".join(script.page_lines(by_seed)) + "\n" == (DOCS / "findings-seeds.md").read_text(encoding="utf-8")


def test_intervals_that_hold_are_counted(script, by_seed):
    """By a table of all pairs of seeds; an open end holds what lies on its side."""
    rows = [{"seed": seed, **claim} for seed, claims in enumerate(by_seed) for claim in claims.values()]
    table = pd.DataFrame(rows)
    table[["low", "high"]] = [ends or (None, None) for ends in table.ci95]
    table["low"], table["high"] = table.low.astype(float), table.high.astype(float)
    pairs = table[table.ci95.notna()].merge(table[["what", "seed", "value"]], on="what", suffixes=("", "_other"))
    pairs = pairs[pairs.seed != pairs.seed_other]
    held = ~(pairs.value_other < pairs.low) & ~(pairs.value_other > pairs.high)
    expected = held.groupby(pairs.kind).agg(["sum", "count"])
    found = script.counted(by_seed)
    assert {kind: tuple(row) for kind, row in expected.iterrows()} == {k: v for k, v in found.items() if k != "all"}
    assert found["all"] == (held.sum(), len(held)) and held.mean() > 0.83


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


def test_open_ends_hold_their_side(script):
    assert script.holds([None, 2.0], -9.0) and script.holds([1.0, None], 9.0) and not script.holds([1.0, 2.0], 2.1)
    assert not script.holds(None, 1.0)
