"""Randomise around what is known, or around a guess? A small policy, trained on a twin's draws and on invented ranges.

The simulated arm of Qiao 2026 is measured at 100 poses and calibrated; its twin gives the arms to train on. Beside it
the same policy learns on arms drawn about the nominal one from a tolerance class, as domain randomisation does. A
policy chooses, for a wanted pose, how far to move its joint target from the nominal solution; it sees neither arm nor
error. PPO, one decision per episode, the environment's own dense reward. Both are judged on draws of the twin that they
never saw, on invented arms that they never saw, and on the arm that was measured. Trainings are short.

Run: python scripts/policies/twin_randomisation.py [--steps 400000] [--out runs/twin_randomisation]
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import typer
from stable_baselines3 import PPO
from stable_baselines3.common.vec_env import VecEnv

import pickenv
from pickenv.arm import Array, load_plant, write_twin
from pickenv.calibration import Result, calibrate, random_joints, simulated_tracker
from pickenv.files import write_json
from pickenv.intervals import mean_interval
from pickenv.threads import torch_on_one_thread

ROOT = Path(__file__).parents[2]
SEED, POSES, TOGETHER, ARMS = 0, 100, 256, 256
REACH = 0.05
"""Share of one action's largest increment that the policy may move a joint target by: 5 mrad, 2.5 mm."""

JUDGED = 20
"""Batches of goals to judge by."""

TRAIN, JUDGE = 1, 2
"""Seeds of the populations."""


class Offsets(VecEnv):
    """Many one-decision episodes at a time: a wanted pose is seen, a joint offset is given, the error is rewarded."""

    def __init__(self, plant: str, population: int, rng: np.random.Generator, fixed: bool = False) -> None:
        arms: dict[str, Any] = {} if fixed else {"arms": "per_episode", "population": ARMS}
        if not fixed:
            arms["population_seed"] = population
        self.envs = gym.make_vec("pickenv/Reach-v0", num_envs=TOGETHER, plant=plant, **arms)
        task: Any = self.envs.unwrapped.task  # type: ignore[attr-defined]
        self.low, self.high, self.rng = np.array(task.lower), np.array(task.upper), rng
        self.errors = np.zeros(TOGETHER)
        n = len(self.low)
        seen = gym.spaces.Box(-1.0, 1.0, (n,), np.float32)
        super().__init__(TOGETHER, seen, gym.spaces.Box(-1.0, 1.0, (n,), np.float32))

    def reset(self) -> Any:
        """New poses, and new arms."""
        share = self.rng.uniform(0.05, 0.95, (TOGETHER, len(self.low)))
        joints = self.low + share * (self.high - self.low)
        self.envs.reset(options={"start_joints": joints, "goal_joints": joints})
        return (2.0 * share - 1.0).astype(np.float32)

    def step_async(self, actions: Array) -> None:
        """Take the offsets."""
        self.offsets = REACH * np.clip(actions, -1.0, 1.0)

    def step_wait(self) -> Any:
        """Move, and begin anew."""
        _, reward, _, _, infos = self.envs.step(self.offsets.astype(np.float32))
        self.errors = np.array(infos["position_error_mm"])
        observation = self.reset()
        return observation, np.asarray(reward, dtype=np.float32), np.ones(TOGETHER, dtype=bool), [{}] * TOGETHER

    def close(self) -> None:
        """Close the environments."""
        self.envs.close()

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """Never."""
        return [False] * TOGETHER

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """None is offered."""
        raise NotImplementedError(method_name)

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Of drawing alone."""
        return [None] * TOGETHER

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """None is offered."""
        raise NotImplementedError(attr_name)


def measured() -> Result:
    """The arm, calibrated from a tracker's poses with everything that the pipeline finds."""
    plant, rng = load_plant("qiao2026"), np.random.default_rng(SEED)
    data = simulated_tracker(plant, random_joints(plant.arm.nominal, POSES, rng), rng)
    return calibrate(plant.arm, data)


def trained(plant: str, steps: int) -> PPO:
    """The policy that PPO finds on a population of arms."""
    env = Offsets(plant, TRAIN, np.random.default_rng(SEED))
    settings = {"n_steps": 8, "batch_size": 512, "n_epochs": 10, "gamma": 0.0, "learning_rate": 1e-3}
    model = PPO("MlpPolicy", env, seed=SEED, policy_kwargs={"log_std_init": -2.0}, **settings)  # type: ignore[arg-type]
    model.learn(steps)
    env.close()
    return model


def judged(policy: PPO | None, plant: str, fixed: bool = False) -> tuple[float, list[float]]:
    """Mean error over new goals and new arms, mm, and its 95 % interval."""
    env = Offsets(plant, JUDGE, np.random.default_rng(SEED + 1), fixed)
    seen, errors = env.reset(), []
    for _ in range(JUDGED):
        action = np.zeros(seen.shape) if policy is None else policy.predict(seen, deterministic=True)[0]
        env.step_async(np.asarray(action))
        seen = env.step_wait()[0]
        errors.append(env.errors)
    env.close()
    values = np.concatenate(errors)
    return float(values.mean()), list(mean_interval(values) or ())


def main(
    steps: Annotated[int, typer.Option(help="Decisions that each policy learns from.", min=2048)] = 400_000,
    out: Annotated[Path, typer.Option(help="Folder for twin and figures.")] = ROOT / "runs/twin_randomisation",
) -> None:
    """Calibrate, train, judge and print."""
    result = measured()
    print(f"calibrated: {result.best_model}, {result.best.mean:.3f} mm on rows held out; pickenv {pickenv.__version__}")
    twin = str(write_twin(result.plant(), out / "twin.npz"))
    with torch_on_one_thread():
        policies = {
            "none (nominal solution)": None,
            "invented ranges (medium tolerances)": trained("qiao2026", steps),
            "draws of the twin": trained(twin, steps),
        }
    places = {"twin, draws held out": (twin, False), "invented arms held out": ("qiao2026", False)}
    places["the measured arm"] = ("qiao2026", True)
    found: dict[str, Any] = {}
    print(f"| policy trained on | {' | '.join(places)} |\n|{'---|' * (len(places) + 1)}")
    for name, policy in policies.items():
        found[name] = {place: judged(policy, *where) for place, where in places.items()}
        cells = (f"{mean:.3f} ({ends[0]:.3f} to {ends[1]:.3f})" for mean, ends in found[name].values())
        print(f"| {name} | {' | '.join(cells)} |")
    write_json(out / "errors_mm.json", {"steps": steps, "errors": found})


if __name__ == "__main__":
    typer.run(main)
