"""Studies that train: every seed has trainings of its own, and those of seed 0 have the seeds 0, 1, …"""

from pathlib import Path

import numpy as np
import pytest

from pickenv.base import run_seed
from pickenv.experiments import load_experiment

STUDIES = Path(__file__).parents[2] / "scripts/studies"
ONE = {"training": 2, "steps": 8}
CASES = {
    "reach_tool": ("learnt", 2, ONE | {"arm": "ur5e", "policy": "its own", "fruit": 2}),
    "calibrating_while_picking": (
        *("trained", 1),
        {"training": 2, "plant": "field", "policy": "window", "arms": 2, "runs": 1, "folder": ""},
    ),
    "twin_randomisation": ("trained", 2, ONE | {"trained_on": "invented, class fine", "picks": 1}),
    "picking_learning": (
        *("train_once", 0),
        ONE | {"place": ["as trained"], "policy": "PPO", "canopies": 2, "folder": ""},
    ),
    "findings_transfer": (
        *("train_once", 0),
        {"trained_on": "raw arms", "compensation": [], "arms": 2, "episodes": 1, "epochs": 1}
        | {"steps": 8, "trainings": 3, "folder": ""},
    ),
}
"""What trains in a study, where its seed stands among the arguments, and one piece of the work."""


class TrainedError(Exception):
    """Ends a piece where its last training begins."""


@pytest.mark.parametrize("study", CASES)
@pytest.mark.parametrize("seed", [0, 1, 7])
def test_a_training_has_a_seed_of_the_studys_seed(study: str, seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    trainer, place, levels = CASES[study]
    file, seeds = load_experiment(STUDIES / f"{study}.toml", seed=seed), list[int]()
    measure = next(iter(file.functions.values()))

    def train(*arguments: object) -> None:
        seeds.append(getattr(arguments[place], "seed", arguments[place]))
        if len(seeds) == levels.get("trainings", 1):
            raise TrainedError

    monkeypatch.setitem(measure.__globals__, trainer, train)
    monkeypatch.setitem(measure.__globals__, "twin", str)
    with pytest.raises(TrainedError):
        measure(np.random.default_rng(0), **levels, seed=seed)
    assert seeds == [run_seed(seed) + number for number in ([2] if "training" in levels else range(3))]
