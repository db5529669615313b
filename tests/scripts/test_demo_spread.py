"""The spread over calibrations that docs/results.md states is what `scripts/demo_spread.py` prints."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import t as student_t

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

from demo_spread import sentence, spread  # noqa: E402


def test_a_calibration_counts_once() -> None:
    means = np.array([0.15, 0.17, 0.16, 0.19, 0.14, 0.18, 0.16, 0.15, 0.17, 0.16])
    found = spread(means)
    half = student_t.ppf(0.975, 9) * means.std(ddof=1) / np.sqrt(10)
    assert found["ci95"] == pytest.approx((means.mean() - half, means.mean() + half), abs=0.003)
    assert (found["low"], found["high"], found["calibrations"]) == (0.14, 0.19, 10)
    assert found["std"] == pytest.approx(means.std(ddof=1))
    assert sentence("LS", found).startswith("LS: mean of means 0.163 mm (95 % interval 0.15")
    assert sentence("LS", found).endswith("standard deviation 0.015 mm, range 0.140 to 0.190 mm")


def test_few_calibrations_have_no_interval() -> None:
    found = spread(np.array([0.1, 0.2, 0.3]))
    assert found["ci95"] is None and "no interval: fewer than 10 calibrations" in sentence("LS", found)


@pytest.mark.slow
def test_the_spread_of_the_results_is_what_the_script_prints(tmp_path: Path) -> None:
    """Ten calibrations, some minutes."""
    command = [sys.executable, ROOT / "scripts/demo_spread.py", "--json", tmp_path / "spread.json"]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    results = (ROOT / "docs/results.md").read_text(encoding="utf-8")
    lines = [line.strip() for line in done.stdout.splitlines() if "mean of means" in line]
    assert len(lines) == 3 and all(f"- {line}" in results for line in lines)
    told = json.loads((tmp_path / "spread.json").read_text(encoding="utf-8"))
    for key, means in told["means_mm"].items():
        assert told["spread_mm"][key]["mean"] == pytest.approx(np.mean(means))
