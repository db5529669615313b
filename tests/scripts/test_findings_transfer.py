"""The study of trainings: each is trained once, in one piece of the work, and is what was asked for."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pickenv.base import InputError
from pickenv.experiments import load_experiment, run

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


def test_a_kept_training_of_other_steps_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    known = load_experiment(STUDY).functions["findings.py:carried"].__globals__
    monkeypatch.setitem(known, "load_policy", lambda path: SimpleNamespace(record={"training": {"steps": 8}}))
    (tmp_path / "policy.npz").touch()
    known["train_once"](SimpleNamespace(steps=8), tmp_path)
    with pytest.raises(InputError, match="was trained for 8 steps, not for 16; give another `folder`"):
        known["train_once"](SimpleNamespace(steps=16), tmp_path)
