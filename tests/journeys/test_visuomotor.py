"""The way *visuomotor*: from an empty folder to the curve of a policy that sees, raw and calibrated.

The block of docs/visuomotor.md runs as it is printed; it prints what the page shows.
"""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.journeys.pages import ENVIRONMENT, ROOT

PAGE = (ROOT / "docs/visuomotor.md").read_text(encoding="utf-8")


def test_from_an_empty_folder_to_the_curve_of_a_policy_that_sees(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    (block,) = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    done = subprocess.run(
        [sys.executable, "-c", block],
        cwd=tmp_path,
        env=ENVIRONMENT | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    if "MuJoCo cannot draw here" in done.stderr:
        pytest.skip("MuJoCo cannot draw on this machine")
    assert done.returncode == 0, done.stderr
    rows = [line.split() for line in done.stdout.splitlines() if line.startswith(("blind", "sees"))]
    picked = {(row[0], row[1]): int(row[3]) for row in rows}
    assert set(picked) == {(name, f"{error}") for name in ("blind", "sees") for error in (0, 5, 10)}
    for name in ("blind", "sees"):
        assert picked[name, "0"] >= 5
        assert picked[name, "0"] >= picked[name, "5"] >= picked[name, "10"]
    assert picked["sees", "10"] > picked["blind", "10"]
    (printed,) = re.findall(r"^```text\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert printed == done.stdout
    said = json.loads((tmp_path / "curve.json").read_text("utf-8"))
    assert {(row["policy"], f"{row['error_mm']}"): row["picked"] for row in said} == picked
