"""Does plain PPO learn to reach with any arm if it moves the tool? Trainings on arms that ship, and on others' URDFs.

Each is judged on its own arm without error, on one with coarse tolerances, raw and behind least squares, and on its own
arm with what was learnt on another. Simulated.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from stable_baselines3 import PPO

from pickenv.agents import tuned
from pickenv.experiments import reaches_behind
from pickenv.wrappers import make_sb3_vec

NAME = "pickenv/ReachTool-v0"
TEACHER = "ur5e"
"""The arm whose policy is tried on all others."""
BY_POSITION = ("so101", "so101/so101_new_calib.urdf#gripper_frame_link")
"""Arms of five joints."""


def arguments_of(arm: str, kind: str) -> dict[str, Any]:
    """The environment's arguments for an arm, "ideal" or "coarse"; its name may be a path in the folder of data."""
    place = f"{Path(os.environ['PICKENV_DATA']) / arm}" if "/" in arm else arm
    return {"plant": f"{kind}:{place}"} | ({"actions": "position"} if arm in BY_POSITION else {})


@cache
def learnt(arm: str, training: int, steps: int) -> Callable[[Any], Any]:
    """What PPO learns on the ideal arm with the shipped parameters."""
    parameters = tuned("ppo", NAME)
    del parameters["n_timesteps"]
    envs = make_sb3_vec(NAME, parameters.pop("n_envs"), **arguments_of(arm, "ideal"))
    model = PPO(env=envs, seed=training, device="cpu", **parameters).learn(steps)
    return lambda seen: model.predict(seen, deterministic=True)[0]


def measure(rng: np.random.Generator, training: int, arm: str, steps: int, fruit: int) -> list[dict[str, Any]]:
    """Errors of one training at the end of its reaches."""
    rows, teachers = [], {"its own": arm} if arm in BY_POSITION else {"its own": arm, f"of {TEACHER}": TEACHER}
    for policy, teacher in teachers.items():
        act = learnt(teacher, training, steps)

        def ends(kind: str, *compensations: str, act: Callable[[Any], Any] = act) -> Any:
            given = arguments_of(arm, kind) | {"episodes": fruit, "seed": training}
            return reaches_behind(act, compensations, id=NAME, **given)

        ideal, coarse = ends("ideal", "raw")["raw"], ends("coarse", "raw", "ls")
        rows.append(
            {
                "policy": policy,
                "median_mm": float(np.median(ideal.position_error_mm)),
                "success": float(ideal.success.mean()),
                "raw_mm": float(coarse["raw"].position_error_mm.mean()),
                "ls_mm": float(coarse["ls"].position_error_mm.mean()),
            }
        )
    return rows
