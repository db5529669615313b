"""Does plain PPO learn to reach with any arm if it moves the tool? Trainings on arms that ship, and on others' URDFs.

Each is judged on its ideal arm, and on an arm with coarse tolerances, raw and behind least squares; beside it what was
learnt on another arm, and what PPO learns that moves joints. Simulated.
"""

import math
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import PPO

from pickenv.agents import tuned
from pickenv.base import run_seed
from pickenv.experiments import reaches_behind
from pickenv.wrappers import make_sb3_vec

TOOL, JOINTS = "pickenv/ReachTool-v0", "pickenv/ReachScaled-v0"
TEACHER = "ur5e"
"""The arm whose policy is tried on all others."""
BY_POSITION = ("so101", "so101/so101_new_calib.urdf#gripper_frame_link")
"""Arms of five joints, of whose tool the position alone is moved."""


def arguments_of(name: str, arm: str, kind: str) -> dict[str, Any]:
    """An environment's arguments for an arm, "ideal" or "coarse"; its name may be a path in the folder of data."""
    place = f"{Path(os.environ['PICKENV_DATA']) / arm}" if "/" in arm else arm
    position = {"actions": "position"} if name == TOOL and arm in BY_POSITION else {}
    return {"plant": f"{kind}:{place}"} | position


@cache
def learnt(name: str, arm: str, own: int, steps: int) -> Callable[[Any], Any]:
    """What PPO learns on the ideal arm with the shipped parameters, from a training's own seed."""
    parameters = tuned("ppo", name)
    del parameters["n_timesteps"]
    envs = make_sb3_vec(name, parameters.pop("n_envs"), **arguments_of(name, arm, "ideal"))
    model = PPO(env=envs, seed=own, device="cpu", **parameters).learn(steps)
    return lambda seen: model.predict(seen, deterministic=True)[0]


def fits(training: int, arm: str, policy: str) -> bool:
    """An arm of five joints has another action than the teacher's."""
    return policy != f"of {TEACHER}" or arm not in BY_POSITION


def measure(
    rng: np.random.Generator, training: int, arm: str, policy: str, steps: int, fruit: int, seed: int
) -> dict[str, Any]:
    """Errors of one training at the end of its reaches; trainings of seed 0 have the seeds 0, 1, ..., as elsewhere."""
    name, own = JOINTS if policy == "moving joints" else TOOL, run_seed(seed % 2**16) + training
    act = learnt(name, TEACHER if policy == f"of {TEACHER}" else arm, own, steps)
    how: dict[str, Any] = {"id": name, "episodes": fruit, "seed": own}
    reaches = reaches_behind(act, ["raw"], **how, **arguments_of(name, arm, "ideal"))["raw"]
    row = {"raw_mm": math.nan, "ls_mm": math.nan, "success": float(reaches.success.mean())}
    row["median_mm"] = float(np.median(reaches.position_error_mm))
    if policy == "its own":
        behind = reaches_behind(act, ["raw", "ls"], **how, **arguments_of(name, arm, "coarse"))
        row |= {f"{method}_mm": float(ends.position_error_mm.mean()) for method, ends in behind.items()}
    return row
