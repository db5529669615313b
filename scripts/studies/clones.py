"""Does a cloned policy that sees need a calibrated arm? `pickenv experiment scripts/studies/clones.toml`.

Networks learn to take the fruit of `pickenv/PickScene-v0` from demonstrations by an exact arm, by one that errs, and by
the same calibrated. Each acts by its wrist camera's pictures, on other arms, raw and calibrated, and with a camera that
is not where it was. The script, which looks at nothing, takes the same fruit. Simulated.
"""

from typing import Any

import numpy as np
from scene import calibrate, made, pick

from pickenv.agents import SIGHT, ClonedScene, ScriptedScene, ServoScene, clone, recorded_episode

RAW_MM = 10.0
"""Mean error of the arms that demonstrate while they err."""

ERRORS, CAMERAS = (0.0, 5.0, 10.0), (1.5, 3.0, 6.0)
"""Mean errors of the arms that are judged, mm; and how far their cameras are from where they were demonstrated, with an
exact arm, standard deviation per axis in mm, with as many sixths of a degree."""

STEPS = {True: 230, False: 120}
"""After which an episode ends, of the script and of others: the slowest success takes 190 and 60."""


def demonstrated(robot: str, kind: str, count: int, rng: np.random.Generator) -> list[tuple[Any, Any]]:
    """Observations and actions of demonstrations that took their fruit.

    Args:
        robot: Name of the plant.
        kind: "perfect", "raw" or "calibrated".
        count: How many are tried.
        rng: Draws the arm and its fruit.
    """
    population, *seeds = rng.integers(2**31, size=1 + count).tolist()
    env = made(robot, population, 0.0 if kind == "perfect" else RAW_MM, STEPS[False], **SIGHT)
    if kind == "calibrated":
        calibrate(env, rng)
    policy, taken = ServoScene(env), []
    for seed in seeds:
        row, information = recorded_episode(env, policy, seed)
        if information["is_success"]:
            taken.append((row["observations"], row["actions"]))
    env.close()
    return taken


def measure(
    rng: np.random.Generator, training: int, robot: str, policy: str, demonstrations: int, arms: int, fruit: int
) -> list[dict[str, Any]]:
    """One policy of one robot: a row for each arm, error, use and fruit.

    Args:
        rng: Draws arms, demonstrations and fruit.
        training: Number of the training.
        robot: Name of the plant.
        policy: Which demonstrations it learnt from: "perfect", "raw" or "calibrated"; "script" learnt nothing.
        demonstrations: How many are tried.
        arms: How many arms it is judged on.
        fruit: How many of each arm.
    """
    rows = []
    judged, learnt = rng.spawn(2)  # the same arms and fruit for all policies
    network: Any = None
    for arm in range(arms):
        population, *seeds = judged.integers(2**31, size=1 + fruit).tolist()
        uses = [(use, error, 0.0) for use in ("raw", "LS") for error in ERRORS]
        uses += [("raw", 0.0, off) for off in CAMERAS if policy != "script"]
        for use, error_mm, camera_mm in uses:
            place = SIGHT | {"feedback": "encoders", "camera_mm": camera_mm, "camera_deg": camera_mm / 6.0}
            env = made(robot, population, error_mm, STEPS[policy == "script"], **place)
            if use == "LS":
                calibrate(env, np.random.default_rng(population))
            if network is None and policy != "script":
                taken = demonstrated(robot, policy, demonstrations, learnt)
                network = clone(taken, env, seed=int(learnt.integers(2**31)))
            acting: Any = ScriptedScene(env) if policy == "script" else ClonedScene(env, network)
            levels = {"use": use, "error_mm": error_mm, "camera_mm": camera_mm}
            levels |= {"arm": arms * training + arm}  # no two trainings share one
            rows += [levels | {"fruit": number} | pick(env, acting, seed) for number, seed in enumerate(seeds)]
            env.close()
    return rows
