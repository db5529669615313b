"""Randomise around what is known, or around a guess? Small policies, trained on a twin's draws and on invented ranges.

The simulated arm of Qiao 2026 is measured at 100 poses and calibrated; its twin gives arms to train on. Beside it the
same policies learn on arms of invented ranges, as domain randomisation does. A policy without a memory sees the wanted
pose alone and says how far to aim beside it (`pickenv.wrappers.SameArm`, runs of one pick); one with a window sees as
well what a camera saw at the picks before, 20 in a run. PPO, gamma 0, the environment's own dense reward. All are
judged on draws of the twin that they never saw and on the arm that was measured. Simulated.
"""

from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO

from pickenv.agents.training.networks import HistoryPolicy
from pickenv.arm import load_plant, write_twin
from pickenv.base import run_seed, seed_words, stream, torch_on_one_thread
from pickenv.calibration import calibrate, random_joints, simulated_tracker
from pickenv.wrappers import SameArmVector, Sb3Vec

POSES, TOGETHER, ARMS, PICKS = 100, 512, 1024, 20
LOOK_MM = 0.3
"""Noise of the camera's mean of a fruit, per axis: some ten looks of 1 mm."""

NOMINAL, TWIN = "nothing: the nominal solution", "draws of the twin"
INVENTED: dict[str, dict[str, Any]] = {
    **{f"invented, class {name}": {"plant": "qiao2026", "tolerances": name} for name in ("fine", "medium", "coarse")},
    "invented, class medium, no compliance": {"plant": "ideal", "tolerances": "medium"},
}


@cache
def twin(seed: int) -> str:
    """A file with the twin of the measured arm, from a tracker's poses with everything that the pipeline finds."""
    plant, rng = load_plant("qiao2026"), np.random.default_rng(seed)
    result = calibrate(plant.arm, simulated_tracker(plant, random_joints(plant.arm.nominal, POSES, rng), rng))
    return str(write_twin(result.plant(), Path(mkdtemp()) / "twin.npz"))


def environment(given: dict[str, Any], picks: int, seed: int, fixed: bool = False) -> SameArmVector:
    """Runs of ``picks`` on arms drawn by ``seed``, or on the plant's own arm."""
    arms: dict[str, Any] = {} if fixed else {"arms": "per_episode", "population": ARMS, "population_seed": seed}
    camera: dict[str, Any] = {"feedback": "camera", "camera_noise_mm": LOOK_MM, "fruit_noise_mm": 0.0}
    envs = gym.make_vec("pickenv/Reach-v0", num_envs=TOGETHER, **given, **arms, **camera)
    return SameArmVector(envs, picks=picks, window=picks, looks=1, reward="true")


def trained(given: dict[str, Any], picks: int, seed: int, steps: int) -> PPO:
    """The policy that PPO finds on a population of arms."""
    env = Sb3Vec(environment(given, picks, seed_words(stream(seed, "arms", 3), 1)[0]))
    settings = {"n_steps": 5, "batch_size": 640, "n_epochs": 5, "gamma": 0.0, "gae_lambda": 1.0}
    common = {"learning_rate": lambda left: 1e-3 * left, "seed": seed, "device": "cpu"}
    kind = "MlpPolicy" if picks == 1 else HistoryPolicy
    model = PPO(kind, env, policy_kwargs={"log_std_init": -2.0, "net_arch": [64, 64]}, **settings, **common)  # type: ignore[arg-type]
    return model.learn(steps)


def judged(policy: PPO | None, picks: int, given: dict[str, Any], fixed: bool, seed: int) -> Any:
    """Mean error of each pick of a run over arms and fruit that no training saw ``(picks,)``, mm."""
    envs = environment(given, picks, seed_words(stream(seed, "arms", 4), 1)[0], fixed)
    errors = np.zeros((max(1, 10 // picks), picks))
    for run in range(len(errors)):
        seen, _ = envs.reset(seed=seed_words(stream(seed, "fruit", run), TOGETHER))
        for pick in range(picks):
            action = np.zeros((TOGETHER, 3)) if policy is None else policy.predict(seen, deterministic=True)[0]
            seen, _, _, _, infos = envs.step(action)
            errors[run, pick] = infos.get("final_info", infos)["position_error_mm"].mean()
    return errors.mean(axis=0)


def fits(training: int, trained_on: str, picks: int) -> bool:
    """The nominal solution needs no training and has no memory."""
    return trained_on != NOMINAL or picks == 1


def measure(
    rng: np.random.Generator, training: int, trained_on: str, picks: int, steps: int, seed: int
) -> list[dict[str, Any]]:
    """One training, judged on both kinds of arms; with a memory, at the first pick of a run and at its last ten."""
    own: dict[str, Any] = {"plant": twin(seed)}
    with torch_on_one_thread():
        policy = None
        if trained_on != NOMINAL:
            drawn = own if trained_on == TWIN else INVENTED[trained_on]
            policy = trained(drawn, picks, run_seed(seed % 2**16) + training, steps)
        rows = []
        for place, where in {"twin, held out": (own, False), "the measured arm": ({"plant": "qiao2026"}, True)}.items():
            errors = judged(policy, picks, *where, seed)
            parts = {"first pick": errors[:1], "picks 11 to 20": errors[PICKS // 2 :]}
            parts = parts if picks > 1 else {"without memory": errors}
            rows += [{"judged": f"{place}, {when}", "error_mm": float(each.mean())} for when, each in parts.items()]
    return rows
