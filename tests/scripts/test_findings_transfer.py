"""Studies of trainings: each is trained once, in one piece of the work, and is what was asked for."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pickenv.base import InputError
from pickenv.experiments import joined, load_experiment, run

STUDY = Path(__file__).parents[2] / "scripts/studies/findings_transfer.toml"


def test_no_two_pieces_train_in_one_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two processes that did would end the run: a folder is locked by the one that trains in it."""
    study, places = load_experiment(STUDY, changes={"folder": str(tmp_path), "trainings": 2}), list[Path]()

    def reached(rng, plant, compensation, *rest):
        return {"arm": np.arange(2), "training": np.arange(2), "error_mm": np.ones(2)}

    known = study.functions["findings.py:carried"].__globals__
    for name, other in {
        "train": lambda training, place, resume: places.append(place),
        "calibration_file": lambda folder: folder / "calibration.npz",
        "reaching": reached,
    }.items():
        monkeypatch.setitem(known, name, other)
    rows = run(study.experiment)
    assert len(places) == len(set(places)) == 6
    assert rows.levels("trained_on", "compensation") == [
        (trained_on, compensation)
        for trained_on in ("calibrated arms", "raw arms", "randomised arms")
        for compensation in ("raw", "best")
    ]


def test_a_training_of_picking_is_judged_at_every_place_by_the_piece_that_trains_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Six processes once judged one training at two places at a time, and both of them had to train it."""
    study = load_experiment(STUDY.with_name("picking_learning.toml"), changes={"folder": str(tmp_path), "canopies": 2})
    known, trained_in = study.functions["picking.py:learning"].__globals__, list[set[Path]]()

    def train(training: object, folder: Path) -> None:
        trained_in[-1].add(folder)
        folder.mkdir(exist_ok=True)
        (folder / "evaluations.json").write_text('[{"steps": 8}]')

    columns = {name: np.ones(2) for name in ("duration_s", "collected", "damaged", "attempted", "reward")}
    for name, other in {"train_once": train, "load_policy": str, "pick_canopies": lambda *_: columns}.items():
        monkeypatch.setitem(known, name, other)
    parts = []
    for piece in study.experiment.pieces():
        trained_in.append(set())
        parts.append(study.experiment.measured(piece))
    assert sum(map(len, trained_in)) == len(set().union(*trained_in)) == 5
    rows = joined(parts).where(policy=("scripted", "PPO"))
    assert {level: len(rows.where(place=level[0], policy=level[1])) for level in rows.levels("place", "policy")} == {
        (place, policy): rows_there
        for place in ("as trained", "rung orchard, arms for judging")
        for policy, rows_there in (("scripted", 2), ("PPO", 2 * 5))
    }


def test_a_kept_training_of_other_steps_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known = load_experiment(STUDY).functions["findings.py:carried"].__globals__
    monkeypatch.setitem(known, "load_policy", lambda path: SimpleNamespace(record={"training": {"steps": 8}}))
    (tmp_path / "policy.npz").touch()
    known["train_once"](SimpleNamespace(steps=8), tmp_path)
    with pytest.raises(InputError, match="was trained for 8 steps, not for 16; give another `folder`"):
        known["train_once"](SimpleNamespace(steps=16), tmp_path)
