"""The spread over calibrations that the ledger holds, and docs/results.md prints, is what its study finds."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pickenv.cli import app
from pickenv.experiments import load_experiment, run

ROOT = Path(__file__).parents[2]


@pytest.mark.thorough
def test_the_spread_of_the_ledger_is_what_the_study_finds(tmp_path: Path) -> None:
    """Ten calibrations, some minutes."""
    words = [
        str(ROOT / "scripts/studies/demo_spread.toml"),
        "--out",
        str(tmp_path),
        "--json",
        str(tmp_path / "found.json"),
    ]
    app(["experiment", *words, "--executor", "serial"], standalone_mode=False)
    (table,) = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))["tables"]
    ledger = json.loads((ROOT / "docs/_static/claims.json").read_text(encoding="utf-8"))["rows"]
    kept = {row["levels"]["policy"]: row for row in ledger if row["experiment"] == "demo_spread"}
    assert set(kept) == {row["policy"] for row in table["rows"]}
    for row in table["rows"]:
        shown = [kept[row["policy"]]["value"], *kept[row["policy"]]["ci95"]]
        assert shown == pytest.approx([row["value"], *row["ci95"]], abs=5e-4)


def test_another_seed_is_another_calibration(monkeypatch: pytest.MonkeyPatch) -> None:
    """The ledger makes the numbers again at a fresh seed."""

    def demonstrated(settings):
        return SimpleNamespace(reaches={"raw": SimpleNamespace(position_error_mm=np.array([settings.seed]))})

    found = []
    for seed in (0, 7):
        study = load_experiment(ROOT / "scripts/studies/demo_spread.toml", seed=seed, changes={"calibration": 3})
        monkeypatch.setitem(study.functions["demo_spread.py:measure"].__globals__, "run_demo", demonstrated)
        found += run(study.experiment)["error_mm"].tolist()
    assert len(set(found)) == 6
    assert found[:3] == np.random.SeedSequence(0).generate_state(10)[:3].tolist()  # those that the pages print


def test_another_seed_is_another_twin_and_other_arms(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of the study whose policies learn on a twin: trainings are numbered, as in other studies."""
    asked = []
    study = load_experiment(ROOT / "scripts/studies/twin_randomisation.toml", seed=7)
    known = study.functions["twin_randomisation.py:measure"].__globals__
    monkeypatch.setitem(known, "twin", lambda seed: asked.append(seed) or "ideal")
    monkeypatch.setitem(known, "judged", lambda policy, picks, given, fixed, seed: asked.append(seed) or np.ones(picks))
    study.experiment.measured(study.experiment.pieces()[0])
    assert asked == [7, 7, 7]


def test_only_a_policy_with_a_memory_is_judged_by_picks(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without one there is a single number for each kind of arms, of all fruit."""
    study = load_experiment(ROOT / "scripts/studies/twin_randomisation.toml")
    known = study.functions["twin_randomisation.py:measure"].__globals__
    for name, stand_in in {"twin": "ideal", "trained": None}.items():
        monkeypatch.setitem(known, name, lambda *arguments, stand_in=stand_in: stand_in)
    monkeypatch.setitem(known, "judged", lambda policy, picks, given, fixed, seed: 1.0 + np.arange(picks))
    for picks, parts in {1: {"without memory": 1.0}, 20: {"first pick": 1.0, "picks 11 to 20": 15.5}}.items():
        piece = next(piece for piece in study.experiment.pieces() if piece[0]["picks"] == picks)
        rows = study.experiment.measured(piece)
        places = {
            f"{place}, {part}": mm for place in ("twin, held out", "the measured arm") for part, mm in parts.items()
        }
        assert dict(zip(rows["judged"].tolist(), rows["error_mm"].tolist(), strict=True)) == places
        assert len(rows) == len(places)
