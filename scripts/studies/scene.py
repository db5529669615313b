"""What an arm's error costs when it takes a hanging fruit by touch: `pickenv experiment scripts/studies/scene.toml`.

The scripted policy of `pickenv/PickScene-v0` on arms whose parts err by more and more, paired: raw, calibrated, and raw
with a policy that sees the fruit in the wrist camera's pictures, whose camera is where it is said to be or is not.
Simulated.
"""

from dataclasses import replace
from typing import Any

import gymnasium as gym
import numpy as np

from pickenv.agents import ScriptedScene, SeeingScene
from pickenv.agents.evaluation.contenders import run_episodes
from pickenv.arm import Array
from pickenv.arm.effects.drives import MeasurementNoise
from pickenv.calibration import fit, random_joints, simulated_tracker

POSES, POSITION, ATTITUDE = 60, 15e-6, 2e-4
"""Poses of a calibration, and noise of the tracker per axis, m, and of its attitude, rad."""

SEES: dict[str, Any] = {"obs_type": "pixels_environment_state_agent_pos", "cameras": ["wrist"], "pixels": 96}
OFF = {"camera_mm": 3.0, "camera_deg": 0.5}
"""How far a camera is from where it is said to be, per axis."""

USES: dict[str, dict[str, Any]] = {"raw": {}, "LS": {}, "sees": SEES, "sees, camera off": SEES | OFF}
"""What is compared, on the same arms and fruit, with the arguments of its environment."""

ERRORS = (0.0, 2.0, 4.0, 6.0, 8.0, 10.0)
"""Errors that have columns of their own for `half`, mm."""


def pick(env: Any, policy: ScriptedScene, seed: int) -> dict[str, Any]:
    """One fruit: whether it was picked, and how far beside the true tool's axis it was when the cup first met it, mm.

    Args:
        env: The environment.
        policy: What acts in it.
        seed: Seed of the episode.

    Returns:
        "success"; "met", 1 where the cup met the fruit; "lateral_mm", 0 where it did not.
    """
    last = run_episodes(env, policy, [seed])[0][-1]
    lateral, axial = last.info["grasp_lateral_mm"], last.info["grasp_axial_mm"]
    met = float((lateral, axial) != (0.0, 0.0))
    return {"success": float(last.info["is_success"]), "met": met, "lateral_mm": lateral}


def calibrate(env: Any, rng: np.random.Generator) -> None:
    """Put a calibration of its present arm, by a simulated tracker, between policy and environment.

    Args:
        env: The environment.
        rng: Draws poses and noise.
    """
    plant: Any = replace(env.unwrapped.plant, effects=(MeasurementNoise(POSITION, ATTITUDE),))
    tracked = simulated_tracker(plant, random_joints(plant.arm.nominal, POSES, rng), rng)
    env.unwrapped.compensator = fit(plant.arm, tracked, known_frames=True).calibration.compensator()


def made(robot: str, population: int, error_mm: float, steps: int, **arguments: Any) -> gym.Env[Any, Any]:
    """The environment of one arm of class coarse whose tool errs by so much; an episode ends after ``steps``."""
    own: dict[str, Any] = {"plant": f"coarse:{robot}", "population_seed": population, "error_mm": error_mm}
    return gym.make("pickenv/PickScene-v0", max_episode_steps=steps, **own, **arguments)


def measure(
    rng: np.random.Generator, arm: int, robot: str, error_mm: float, fruit: int, steps: int
) -> list[dict[str, Any]]:
    """One arm of one robot at one error: a row for each use and fruit.

    Args:
        rng: Draws the arm, its calibration and its fruit, which are the same at every error.
        arm: Number of the arm.
        robot: Name of the plant; tolerances are of class coarse.
        error_mm: Mean error of its tool, mm.
        fruit: How many.
        steps: After which an episode ends.
    """
    population, *fruit_seeds = rng.integers(2**31, size=1 + fruit).tolist()
    rows = []
    for use, arguments in USES.items():
        env = made(robot, population, error_mm, steps, **arguments)
        if use == "LS":
            calibrate(env, rng)
        policy = SeeingScene(env) if arguments else ScriptedScene(env)
        for number, seed in enumerate(fruit_seeds):
            row: dict[str, Any] = {"use": use, "fruit": number} | pick(env, policy, seed)
            at = {f"{error:g}": float(error == error_mm) for error in ERRORS}
            row |= {f"tried_{name}": tried for name, tried in at.items()}
            rows.append(row | {f"success_{name}": tried * row["success"] for name, tried in at.items()})
        env.close()
    return rows


def half(table: Array) -> float:
    """The error at which half of the fruit is picked, mm: on straight lines between shares that never rise.

    Args:
        table: Means of "tried_0", ..., "success_0", ... of each arm ``(arms, 2 len(ERRORS))``.

    Returns:
        The least error that was tried if less is picked even there, and the largest if more is.
    """
    tried, success = table.mean(axis=0).reshape(2, -1)
    measured = tried > 0.0
    shares = np.minimum.accumulate(success[measured] / tried[measured])
    return float(np.interp(-0.5, -shares, np.array(ERRORS)[measured]))
