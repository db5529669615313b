"""The table of PPO on `pickenv/ReachTool-v0` in docs/learning.md is that of the file that its study wrote."""

from __future__ import annotations

import csv
import re
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest

DOCS = Path(__file__).resolve().parents[3] / "docs"


def test_every_row_is_the_mean_of_its_five_trainings_and_all_arms_are_learnt() -> None:
    trainings = defaultdict(list)
    with (DOCS / "_static/reach-tool.csv").open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            trainings[Path(row["arm"]).name.partition("#")[0], row["policy"]].append(row)

    def mean(arm: str, policy: str, column: str) -> float:
        rows = trainings[arm, policy]
        assert len(rows) == 5
        return float(np.mean([float(row[column]) for row in rows]))

    page = re.sub(r"<!--.*?-->| \([^()]+ to [^()]+\)", "", (DOCS / "learning.md").read_text(encoding="utf-8"))
    lines = re.findall(r"^\| (.+\d) \|$", page[page.index("| arm | tool: median") :].split("\n\n")[0], re.MULTILINE)
    assert len(lines) == len({arm for arm, _ in trainings}) == 12
    for line in lines:
        name, *cells = line.split(" | ")
        arm = name.partition(",")[0].strip("`")
        tool, taken, joints, others, raw, ls = map(float, cells)
        assert tool == round(mean(arm, "its own", "median_mm"), 5) <= 0.1
        assert taken == round(100 * mean(arm, "its own", "success"), 1) >= 98.0
        assert others == round(100 * mean(arm, "moving joints", "success"), 1)
        np.testing.assert_allclose(joints, mean(arm, "moving joints", "median_mm"), rtol=5e-3, atol=5e-6)
        assert [raw, ls] == [round(mean(arm, "its own", f"{name}_mm"), 2) for name in ("raw", "ls")]
    worst = max(
        float(row["median_mm"]) for (_, policy), rows in trainings.items() if policy == "its own" for row in rows
    )
    assert f"The worst training leaves {worst:.4f} mm" in page


def test_the_pages_line_makes_the_environments() -> None:
    pytest.importorskip("stable_baselines3")
    from pickenv.wrappers import make_sb3_vec

    page = (DOCS / "learning.md").read_text(encoding="utf-8")
    (line,) = re.findall(r'^envs = make_sb3_vec\("pickenv/ReachTool-v0".*$', page, re.MULTILINE)
    names = {"make_sb3_vec": make_sb3_vec}
    exec(line, names)
    assert names["envs"].num_envs == 64 and names["envs"].action_space.shape == (6,)
