"""An option that would have no effect is refused by its name; a new option's pair goes into `IDLE`."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import load_plant, write_twin
from pickenv.calibration import Choices, calibrate, fit, random_joints, simulated_tracker

EXPERIMENT = 'title = "t"\nmeasure = "idle_measure.py:measure"\nunits = { arm = 2 }\n'
TARGETS = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg\n10,-60,60,-90,-90,10\n"
TRAIN = "train --steps 1 --out train"

IDLE = [
    ("calibrate rows.csv --arm ur5e --force", "--force"),
    ("calibrate rows.csv --arm ur5e --residual gp", "--residual gp"),
    ("calibrate rows.csv --arm ur5e --payload 1 0 0 50 --terms none", "--payload"),
    ("calibrate rows.csv --columns ical_charuco --payload 1 0 0 50", "--payload"),
    ("calibrate rows.csv --arm ur5e --fit full --workspace x=300:600", "--workspace"),
    ("calibrate rows.csv --arm ur5e --test rows.csv --split blocked", "--split blocked"),
    ("calibrate rows.csv --columns ical_charuco --fit offsets", "--fit offsets"),
    ("calibrate rows.csv --columns ical_charuco --tolerances cobot", "--tolerances"),
    ("calibrate rows.csv --arm ur5e --lens-out lens.yaml", "--lens-out"),
    ("calibrate rows.csv --arm ur5 --columns ur5_jacobi2025 --lens-out lens.yaml", "--lens-out"),
    ("plan-poses --arm ur5e --from targets.csv --candidates 50", "--candidates"),
    ("plan-poses --arm ur5e --columns ur5_jacobi2025", "--columns"),
    ("verify cal.npz rows.csv --refit-rows 4", "--refit-rows 4"),
    ("apply cal.npz targets.csv --arm ur5e --frame instrument", "--frame"),
    ("apply cal.npz targets.csv --arm ur5e --payload-kg 3", "--payload-kg"),
    ("apply cal.npz targets.csv --arm ur5e --temperature-k 3", "--temperature-k"),
    ("export cal.npz --out arm.xml --seed 3", "--seed"),
    ("export cal.npz --out arm.toml --sample 3", "--sample"),
    ("export cal.npz --out arm.yaml --onto own.yaml#tool0", "#tool0 of --onto"),
    ("twin cal.npz --seed 3", "--seed"),
    ("twin cal.npz --columns ur5_jacobi2025", "--columns"),
    ("iso9283 --arm ur5e", "--arm"),
    ("iso9283 --allow do-not-use", "--allow"),
    ("conditions cal.npz --arms 3", "--arms"),
    (f"{TRAIN} --allow do-not-use", "--allow"),
    (f"{TRAIN} --plant coarse:ur5e --randomise fine", "--randomise"),
    (f"{TRAIN} --env pickenv/Pick-v0 --fruit-noise 1", "--fruit-noise"),
    ("evaluate --compensation ls --epochs 3", "--epochs"),
    ("evaluate --compensation raw --cache kept", "--cache"),
    ("evaluate --plant coarse:ur5e --tolerances fine", "--tolerances"),
    ("evaluate --plant twin.npz --tolerances fine --compensation raw --arms 1 --episodes 1", "--tolerances"),
    ("compare scripted --allow do-not-use", "--allow"),
    ("compare scripted --camera-noise 1", "--camera-noise"),
    ("compare random --env CartPole-v1 --grid-step 0.3", "--grid-step"),
    ("experiment file.toml --executor serial --workers 2", "--workers 2"),
    ("experiment file.toml --quick", "--quick"),
    ("experiment file.toml --figures drawn", "--figures"),
    ("study new.toml --executor serial --workers 2", "--workers 2"),
    ("study new.toml --executor batched --device cuda --workers 2", "--workers"),
    ("study new.toml --sobol --no-report", "--sobol"),
    ("bench policies --quick --workers 2", "--workers 2"),
    ("bench policies --quick --plant orchard --split train", "--split train"),
    ("bench policies --quick --plant orchard --split test", "--split test"),
    ("inspect run --web --serve 9876", "--web"),
]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with rows of a UR5e, its calibration by least squares, a twin of it, targets, and an experiment."""
    folder, plant, rng = tmp_path_factory.mktemp("idle"), load_plant("ideal:ur5e"), np.random.default_rng(0)
    rows = simulated_tracker(plant, random_joints(plant.arm.nominal, 30, rng), rng)
    rows.write_csv(folder / "rows.csv")
    fit(plant.arm, rows, known_frames=True).calibration.save(folder / "cal.npz")
    with_priors = calibrate(plant.arm, rows, choices=Choices(terms="none", residual="none"))
    write_twin(with_priors.plant(), folder / "twin.npz")
    measure = "def measure(**_): return {}"
    texts = {"targets.csv": TARGETS, "file.toml": EXPERIMENT, "idle_measure.py": measure, "own.yaml": ""}
    for name, text in texts.items():
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize(("line", "option"), IDLE)
def test_an_option_without_effect_is_refused_by_its_name(
    line: str, option: str, files: Path, typed: Callable[..., object], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(files)
    monkeypatch.setattr("sys.dont_write_bytecode", True)  # of the measure's module
    before = sorted(files.iterdir())
    code, _, said = typed(*line.split())
    assert code == 2 and option in said.splitlines()[-1], said
    assert sorted(files.iterdir()) == before, "something was written"
