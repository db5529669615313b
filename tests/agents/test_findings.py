"""docs/findings.md and docs/results.md say the same, name their seeds, and each finding is a message with its proof."""

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


def test_every_finding_is_a_few_sentences_with_a_chart_or_a_table() -> None:
    *findings, made = FINDINGS.split("\n## ")[1:]
    assert len(findings) >= 8 and made.startswith("How they were made")
    for each in findings:
        message, sentence, shown, *rest = each.strip().split("\n\n")
        assert "\n" not in message and re.search(r"[.]$", sentence)
        assert len(re.findall(r"[a-z)]\. [A-Z]", sentence)) <= 2
        if shown.startswith("!["):
            (name,) = re.findall(r"\((images/.+\.png)\)", shown)
            assert (ROOT / "docs" / name).is_file()
            assert not rest or rest[0].startswith("<details>"), "a chart's numbers are folded"
        else:
            assert shown.startswith("<!-- claims: ")


@pytest.mark.parametrize("text", ["bootstrap", "not significant"])
def test_what_fell_is_gone(text: str) -> None:
    assert text not in FINDINGS
