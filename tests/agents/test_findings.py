"""docs/findings.md and docs/results.md say the same, name their seeds, and show every figure."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FINDINGS = (ROOT / "docs" / "findings.md").read_text(encoding="utf-8")
RESULTS = (ROOT / "docs" / "results.md").read_text(encoding="utf-8")
POLICIES = {"scripted": "scripted", "PPO": "ppo_encoders", "visual servo": "servo", "PPO, camera": "ppo_camera"}
CALIBRATIONS = {"LS+Gaussian process": "LS+GP"}


def table(text: str, head: str) -> list[dict[str, str]]:
    """The rows of the first table of a page whose head begins so."""
    lines = text[text.index(f"\n| {head}") + 1 :].split("\n\n")[0].splitlines()
    heads, _, *rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [dict(zip(heads, row, strict=True)) for row in rows]


@pytest.mark.parametrize("plant", ["qiao2026", "field"])
def test_the_results_show_what_the_findings_found(plant: str) -> None:
    found = {
        (row["policy"], row["feedback"], row["calibration"]): row["mean"]
        for row in table(FINDINGS, "plant | policy | feedback | calibration")
        if row["plant"] == plant
    }
    rows = table(RESULTS, f"policy on `{plant}` | feedback | raw")
    assert rows
    for row in rows:
        policy = row.pop(f"policy on `{plant}`")
        name = POLICIES["PPO, camera" if (policy, row["feedback"]) == ("PPO", "camera") else policy]
        for label, cell in row.items():
            if label != "feedback":
                assert cell == found[name, row["feedback"], CALIBRATIONS.get(label, label)]


def test_both_say_on_how_many_arms_and_fruit() -> None:
    (said,) = re.findall(r"Final position errors of (\d+) arms per plant, (\d+) fruit each", FINDINGS)
    assert f"Policies on {said[0]} arms" in RESULTS and f"({said[1]} fruit each" in RESULTS
    assert "seed 0" in FINDINGS and "seed 0" in RESULTS


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
