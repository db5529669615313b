"""The spread over calibrations that the ledger holds, and docs/results.md prints, is what its study finds."""

import json
from pathlib import Path

import pytest

from pickenv.cli import app

ROOT = Path(__file__).parents[2]


@pytest.mark.thorough
def test_the_spread_of_the_ledger_is_what_the_study_finds(tmp_path: Path) -> None:
    """Ten calibrations, some minutes."""
    words = [
        str(ROOT / "scripts/studies/demo_spread.toml"),
        "--out",
        str(tmp_path),
        "--json",
        str(tmp_path / "found.json"),
    ]
    app(["experiment", *words, "--executor", "serial"], standalone_mode=False)
    (table,) = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))["tables"]
    ledger = json.loads((ROOT / "docs/_static/claims.json").read_text(encoding="utf-8"))["rows"]
    kept = {row["levels"]["policy"]: row for row in ledger if row["experiment"] == "demo_spread"}
    assert set(kept) == {row["policy"] for row in table["rows"]}
    for row in table["rows"]:
        shown = [kept[row["policy"]]["value"], *kept[row["policy"]]["ci95"]]
        assert shown == pytest.approx([row["value"], *row["ci95"]], abs=5e-4)
