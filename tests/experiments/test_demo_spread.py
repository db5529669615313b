"""The spread over calibrations that docs/results.md states is what its study prints."""

import json
import re
from pathlib import Path

import pytest

from pickenv.cli import app

ROOT = Path(__file__).parents[2]


@pytest.mark.slow
def test_the_spread_of_the_results_is_what_the_study_finds(tmp_path: Path) -> None:
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
    page = (ROOT / "docs/results.md").read_text(encoding="utf-8")
    for row in table["rows"]:
        (line,) = re.findall(rf"^\| {re.escape(row['policy'])} \| [^|]+ \| [\d.]+ \| [\d.]+ to [\d.]+ \|$", page, re.M)
        shown = [float(number) for number in re.findall(r"\d+\.\d{3}", line)]
        assert shown == [round(x, 3) for x in (row["value"], *row["ci95"], row["std"], *row["range"])]
