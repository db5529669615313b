"""Randomise around what is known, or around a guess? Small policies, trained on a twin's draws and on invented ranges.

The simulated arm of Qiao 2026 is measured at 100 poses and calibrated; its twin gives arms to train on. Beside it the
same policies learn on arms of invented ranges, as domain randomisation does: three tolerance classes about the nominal
arm with its compliance, and one without it. A policy without a memory sees the wanted pose alone and says how far to
aim beside it (`pickenv.wrappers.SameArm`, runs of one pick); one with a window sees as well what a camera saw at the
picks before, 20 in a run. PPO, gamma 0, the environment's own dense reward. All are judged on draws of the twin that
they never saw and on the arm that was measured. Five training seeds, 0 to 4; brackets hold the least and the largest
of them. Simulated.

Run: python scripts/policies/twin_randomisation.py [--steps 102400] [--out runs/twin_randomisation]
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import typer
from stable_baselines3 import PPO

import pickenv
from pickenv.agents.training.history import HistoryPolicy
from pickenv.arm import load_plant, write_twin
from pickenv.calibration import Result, calibrate, random_joints, simulated_tracker
from pickenv.experiments.policy_tables import with_interval
from pickenv.files import write_json
from pickenv.seeds import seed_words, stream
from pickenv.threads import torch_on_one_thread
from pickenv.wrappers import SameArmVector
from pickenv.wrappers.sb3 import Sb3Vec

ROOT = Path(__file__).parents[2]
SEED, POSES, TOGETHER, ARMS, PICKS = 0, 100, 512, 1024, 20
SEEDS = tuple(range(5))
LOOK_MM = 0.3
"""Noise of the camera's mean of a fruit, per axis: some ten looks of 1 mm."""

TWIN, NOTHING = "draws of the twin", "nothing: the nominal solution"
TRAINED: dict[str, dict[str, Any]] = {
    TWIN: {},
    "invented, class fine": {"plant": "qiao2026", "tolerances": "fine"},
    "invented, class medium": {"plant": "qiao2026", "tolerances": "medium"},
    "invented, class coarse": {"plant": "qiao2026", "tolerances": "coarse"},
    "invented, class medium, no compliance": {"plant": "ideal", "tolerances": "medium"},
}
MEMORIES = {"none": 1, "window": PICKS}
"""Picks of a run, and of the window."""

SHOWN = {"twin, held out": ("twin", False), "the measured arm": ("qiao2026", True)}
LAST = slice(PICKS // 2, PICKS)
"""Picks of a run that a policy with a memory is judged by beside the first."""


def environment(given: dict[str, Any], picks: int, seed: int, fixed: bool = False) -> SameArmVector:
    """Runs of ``picks`` on arms drawn by ``seed``, or on the plant's own arm."""
    arms: dict[str, Any] = {} if fixed else {"arms": "per_episode", "population": ARMS, "population_seed": seed}
    plant = given if not fixed else {"plant": given["plant"]}
    camera: dict[str, Any] = {"feedback": "camera", "camera_noise_mm": LOOK_MM, "fruit_noise_mm": 0.0}
    envs = gym.make_vec("pickenv/Reach-v0", num_envs=TOGETHER, **plant, **arms, **camera)
    return SameArmVector(envs, picks=picks, window=picks, looks=1)


def measured() -> Result:
    """The arm, calibrated from a tracker's poses with everything that the pipeline finds."""
    plant, rng = load_plant("qiao2026"), np.random.default_rng(SEED)
    data = simulated_tracker(plant, random_joints(plant.arm.nominal, POSES, rng), rng)
    return calibrate(plant.arm, data)


def trained(given: dict[str, Any], picks: int, seed: int, steps: int) -> PPO:
    """The policy that PPO finds on a population of arms."""
    env = Sb3Vec(environment(given, picks, seed_words(stream(seed, "arms", 3), 1)[0]))
    settings = {"n_steps": 5, "batch_size": 640, "n_epochs": 5, "gamma": 0.0, "gae_lambda": 1.0}
    common = {"learning_rate": lambda left: 1e-3 * left, "seed": seed, "device": "cpu"}
    kind = "MlpPolicy" if picks == 1 else HistoryPolicy
    model = PPO(kind, env, policy_kwargs={"log_std_init": -2.0, "net_arch": [64, 64]}, **settings, **common)  # type: ignore[arg-type]
    return model.learn(steps)


def judged(policy: PPO | None, picks: int, given: dict[str, Any], fixed: bool) -> list[float]:
    """Mean error of each pick of a run over arms and fruit that no training saw, mm."""
    envs = environment(given, picks, seed_words(stream(SEED, "arms", 4), 1)[0], fixed)
    errors = np.zeros((max(1, 10 // picks), picks))
    for run in range(len(errors)):
        seen, _ = envs.reset(seed=seed_words(stream(SEED, "fruit", run), TOGETHER))
        for pick in range(picks):
            action = np.zeros((TOGETHER, 3)) if policy is None else policy.predict(seen, deterministic=True)[0]
            seen, _, _, _, infos = envs.step(action)
            errors[run, pick] = infos.get("final_info", infos)["position_error_mm"].mean()
    return [float(value) for value in errors.mean(axis=0)]


def table(found: dict[str, Any]) -> str:
    """The table in Markdown: means over trainings, and the least and the largest of them."""
    heads = [f"{place}, {when}" for place in SHOWN for when in ("first pick", "picks 11 to 20")]
    lines = [f"| trained on | memory | {' | '.join(heads)} |", f"|---|---|{'---|' * len(heads)}"]
    for what, memories in found.items():
        for memory, places in memories.items():
            cells = []
            for place in SHOWN:
                each = np.array(places[place])
                for picks in (slice(0, 1), LAST):
                    values = each[:, picks].mean(axis=1) if each.shape[1] > 1 else each[:, 0]
                    span = (float(values.min()), float(values.max())) if len(values) > 1 else None
                    cells.append(with_interval(float(values.mean()), span, 3))
            lines.append(f"| {what} | {memory} | {' | '.join(cells)} |")
    return "\n".join(lines)


def main(
    steps: Annotated[int, typer.Option(help="Picks that each policy learns from.", min=2560)] = 102_400,
    out: Annotated[Path, typer.Option(help="Folder for twin and figures; what is there is not trained again.")] = (
        ROOT / "runs/twin_randomisation"
    ),
) -> None:
    """Calibrate, train, judge and print; goes on where it was cut off."""
    twin = out / "twin.npz"
    if not twin.is_file():
        result = measured()
        print(f"calibrated: {result.best_model}, {result.best.mean:.3f} mm on rows held out; {pickenv.__version__}")
        write_twin(result.plant(), twin)
    plants = {"twin": {"plant": str(twin)}, "qiao2026": {"plant": "qiao2026"}}
    places = {place: (plants[name], fixed) for place, (name, fixed) in SHOWN.items()}
    found: dict[str, Any] = {NOTHING: {"none": {place: [judged(None, 1, *where)] for place, where in places.items()}}}
    for what, given in TRAINED.items():
        found[what] = {}
        for memory, picks in MEMORIES.items():
            rows: dict[str, list[list[float]]] = {place: [] for place in SHOWN}
            for seed in SEEDS:
                kept = out / f"{what.replace(', ', '-').replace(' ', '-')}-{memory}-{seed}-{steps}.json"
                if not kept.is_file():
                    with torch_on_one_thread():
                        policy = trained(given or plants["twin"], picks, seed, steps)
                        write_json(kept, {place: judged(policy, picks, *where) for place, where in places.items()})
                    print(f"done: {what}, memory {memory}, seed {seed}", flush=True)
                for place, errors in json.loads(kept.read_text(encoding="utf-8")).items():
                    rows[place].append(errors)
            found[what][memory] = rows
    print(table(found))
    write_json(out / "errors_mm.json", {"steps": steps, "seeds": list(SEEDS), "mm_by_pick": found})


if __name__ == "__main__":
    typer.run(main)
