"""The two studies of the harvester's eyes run from end to end, in small."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pickenv import experiments
from pickenv.base import toml_of
from pickenv.experiments import load_experiment
from pickenv.orchard import load_sight_errors

ROOT = Path(__file__).parents[2]


def run(script: str, *words: object) -> None:
    command = [sys.executable, f"scripts/studies/{script}.py", *map(str, words)]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)


@pytest.mark.slow
def test_a_table_of_errors_is_made_from_pictures_and_can_be_read(tmp_path: Path) -> None:
    out, told = tmp_path / "sight.toml", tmp_path / "sight.json"
    run("measure_sight", "--trees", 12, "--canopy", "li2016_bare", "--out", out, "--json", told)
    tables, _ = toml_of(out)
    assert sorted(tables) == ["li2016_bare-circles", "li2016_bare-li2016"]
    shipped = load_sight_errors("li2016_bare-circles")
    assert set(tables["li2016_bare-circles"]) <= set(
        toml_of(ROOT / "pickenv/orchard/presets/sight.toml")[0][shipped.name]
    )
    rows = json.loads(told.read_text(encoding="utf-8"))["rows"]
    assert [row["detector"] for row in rows] == ["li2016", "circles"]
    for row in rows:
        recall, (low, high) = row["recall"], row["recall_ci95"]
        assert (
            0.85 < recall <= 1.0
            and low < recall <= high
            and row["fruit"] == tables[f"li2016_bare-{row['detector']}"]["fruit"]
        )


@pytest.mark.slow
def test_the_same_trees_are_worked_with_each_pair_of_eyes() -> None:
    """Fruit is lost from stage to stage; ideal eyes locate all of it, and send no arm to where there is none."""
    found = load_experiment(ROOT / "scripts/studies/harvest_sight.toml", quick=True)
    rows = experiments.run(found.experiment)
    assert len(rows.levels("vision", "way", "detector")) == 2 + 4 + 4
    stages = np.array(
        [rows[stage] for stage in ("present", "visible", "located", "reachable", "attached", "collected")]
    )
    assert (np.diff(stages, axis=0) <= 0).all()
    ideal = rows.where(vision="ideal")
    assert (ideal["located"] == ideal["present"]).all() and not ideal["misled"].any()
    for way in ("raw", "optimised"):
        trees = [
            rows.where(vision="measured_errors", way=way, detector=name)["present"] for name in ("li2016", "circles")
        ]
        assert (trees[0] == trees[1]).all()
