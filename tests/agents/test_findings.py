"""docs/findings.md and docs/results.md say the same, name their seeds, and show every figure."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FINDINGS = (ROOT / "docs" / "findings.md").read_text(encoding="utf-8")
RESULTS = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")


def test_both_say_on_how_many_arms_and_fruit() -> None:
    (said,) = re.findall(r"Final position errors of (\d+) arms per plant, (\d+) fruit each", FINDINGS)
    assert f"Policies on {said[0]} arms" in RESULTS and f"({said[1]} fruit each" in RESULTS
    assert "Seed 0" in FINDINGS and "seed 0" in RESULTS


def test_every_finding_is_one_sentence_and_one_figure_that_is_there() -> None:
    findings = FINDINGS.split("\n## Appendix: tables")[0].split("\n## ")[1:]
    assert len(findings) >= 4
    for each in findings:
        _, sentence, picture = each.strip().split("\n\n")
        assert len(re.findall(r"[a-z)]\. [A-Z]", sentence)) <= 1
        (name,) = re.findall(r"\((images/.+\.png)\)", picture)
        assert (ROOT / "docs" / name).is_file()


@pytest.mark.parametrize("text", ["bootstrap", "not significant"])
def test_what_fell_is_gone(text: str) -> None:
    assert text not in FINDINGS
