"""Picking on the leaderboard: scripted policies before canopies of `pickenv/Pick-v0`, by calibration and by gripper.

The arms are those of the reaching task on the same plant, with their calibrations; canopies depend on seed, arm and
number alone, so that every calibration meets the same fruit.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.agents.evaluation.calibrated import COMPENSATIONS, compensators
from pickenv.agents.evaluation.grid import GridSettings, population
from pickenv.agents.evaluation.reaches import moments_of
from pickenv.agents.policies.pick_policy import HASTY, ScriptedPick
from pickenv.agents.policies.policy import Policy
from pickenv.envs.picking.pick import PickEnv
from pickenv.envs.shared.situation import CONTROL_PERIOD
from pickenv.intervals import interquartile_estimate, mean_interval
from pickenv.seeds import seed_words, stream

PICK_PLANT = "field"
"""Plant of the picking task."""

PICKERS: Mapping[str, Callable[[Any], Policy]] = {"scripted": ScriptedPick, "hasty": partial(ScriptedPick, **HASTY)}
"""Who picks: gently and after waiting for the arm to settle, and neither."""


@dataclass(frozen=True)
class PickTally:
    """What one policy did with one arm and gripper, over all its canopies.

    Attributes:
        attempted: Fruit that the gripper closed on.
        collected: Fruit collected undamaged.
        seconds: Time that it took, without the ways between canopies.
        errors_mm: Distance of fruit and true tool at each grasp, mm.
        tilts_deg: The tool's angle with the vertical at each grasp, deg.
    """

    attempted: int
    collected: int
    seconds: float
    errors_mm: tuple[float, ...]
    tilts_deg: tuple[float, ...]


def picks(env: PickEnv, make: Callable[[Any], Policy], arm: int, seeds: Sequence[int], steps: int) -> PickTally:
    """Let a policy pick canopy after canopy with one arm of the environment's population."""
    attempted = collected = passed = 0
    errors, tilts = [], []
    policy = make(env)
    for seed in seeds:
        before = 0
        for moment in moments_of(env, policy, seed, options={"arm": arm}, steps=steps):
            info = moment.info
            if info["attempted"] > before:
                before = info["attempted"]
                errors.append(float(np.hypot(info["grasp_lateral_mm"], info["grasp_axial_mm"])))
                tilts.append(float(info["tilt_deg"]))
            passed += 1
        passed -= 1  # the first moment is the reset
        attempted, collected = attempted + info["attempted"], collected + info["collected"]
    return PickTally(attempted, collected, passed * CONTROL_PERIOD, tuple(errors), tuple(tilts))


def pick_tallies(settings: GridSettings, canopies: int, folder: Path | None) -> dict[str, list[PickTally]]:
    """Tallies of every picker, calibration and gripper, one per arm; keys join the three names by a slash.

    Args:
        settings: Arms, seed and calibrations; the plants are not used.
        canopies: Canopies for each arm.
        folder: Where calibrations are kept, or None.
    """
    arms = range(settings.arms)
    fitted = {
        name: compensators(population(settings, PICK_PLANT), name, settings.protocol, folder) for name in COMPENSATIONS
    }
    found: dict[str, list[PickTally]] = {}
    for gripper in settings.grippers:
        env = PickEnv(
            plant=PICK_PLANT,
            gripper=gripper,
            arms="per_episode",
            tolerances=settings.tolerances,
            population=settings.arms,
            population_seed=settings.population_seed,
        )
        for (name, make), compensation, arm in product(PICKERS.items(), COMPENSATIONS, arms):
            installed = fitted[compensation]
            env.compensator = None if installed is None else installed[arm]
            seeds = seed_words(stream(settings.seed, "picks", arm), canopies)
            tally = picks(env, make, arm, seeds, LONGEST_CANOPY)
            found.setdefault(f"{name}/{compensation}/{gripper}", []).append(tally)
    return found


LONGEST_CANOPY = 400
"""Steps after which a canopy is left, as in `pickenv/Pick-v0`."""


def pick_rows(seeds: Sequence[int], tallies: Sequence[Mapping[str, Sequence[PickTally]]]) -> list[dict[str, Any]]:
    """One row per picker and calibration, best picks per hour with the first gripper first.

    Args:
        seeds: Of the tallies.
        tallies: As `pick_tallies` gives them, one mapping per seed.
    """
    joined: dict[tuple[str, str], dict[str, list[PickTally]]] = {}
    for key in tallies[0]:
        name, compensation, gripper = key.split("/")
        joined.setdefault((name, compensation), {})[gripper] = [tally for each in tallies for tally in each[key]]
    rows = []
    for (name, compensation), by_gripper in joined.items():
        each = list(zip(*by_gripper.values(), strict=True))  # arms, with a tally per gripper
        errors = np.array([np.mean([e for tally in arm for e in tally.errors_mm] or [np.nan]) for arm in each])
        errors = errors[np.isfinite(errors)]
        middle = interquartile_estimate(errors, stream(0, "leaderboard"))
        rates = {g: np.array([3600.0 * t.collected / t.seconds for t in some]) for g, some in by_gripper.items()}
        success = {
            g: sum(t.collected for t in some) / max(1, sum(t.attempted for t in some)) for g, some in by_gripper.items()
        }
        ends = {gripper: mean_interval(rate) for gripper, rate in rates.items()}
        rows.append(
            {
                "task": f"pickenv/Pick-v0, {PICK_PLANT}",
                "policy": name,
                "feedback": "encoders",
                "compensation": compensation,
                "mean_mm": float(errors.mean()),
                "iqm_mm": middle.value,
                "attitude_deg": float(np.mean([t for arm in each for tally in arm for t in tally.tilts_deg])),
                "success": next(iter(success.values())),
                "success_by_gripper": success,
                "ci95_mm": None if middle.ci95 is None else list(middle.ci95),
                "picks_per_hour": {gripper: float(rate.mean()) for gripper, rate in rates.items()},
                "picks_per_hour_ci95": {gripper: None if e is None else list(e) for gripper, e in ends.items()},
                "seeds": sorted(seeds),
                "arms": len(each),
                "attempts": sum(tally.attempted for arm in each for tally in arm),
            }
        )
    return sorted(rows, key=lambda row: -next(iter(row["picks_per_hour"].values())))
