"""What calibration buys a policy: the measures of the studies behind docs/findings.md.

Simulated arms of tolerance class coarse that nothing was trained on, each with its own calibration, which is kept and
shared by the studies of one seed. Policies that learnt have trainings of their own; what is missing is trained.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from train_baselines import calibration_file

from pickenv.agents import ServoReach, Training, roll_out, train
from pickenv.arm import forward, plant_at
from pickenv.base import stream
from pickenv.calibration import complete_model, random_joints, start_filter
from pickenv.calibration.compensation.compensator import aimed, taught
from pickenv.experiments import CalibrationPlan, PolicySettings, Rows, calibrate_arm, run_policies
from pickenv.experiments.policies import population_seed
from pickenv.inspect.colours import policy_colours, policy_label
from pickenv.inspect.figures.style import WIDTH, new_figure, plain_decades, rgb
from pickenv.inspect.recordings.details import CAMERA_STD, DAY_HOURS, DRIFTS, LOOK, PRIOR, WALK

TRAINED_ON: dict[str, dict[str, Any]] = {
    "calibrated arms": {"compensate": "calibration.npz"},
    "raw arms": {},
    "randomised arms": {"arguments": {"arms": "per_episode", "tolerances": "coarse"}},
}
WHERE_LS_IS_ENOUGH = "orchard"
"""There drift is what is left, and residual models are left out."""

OPEN_LOOP = ("raw", "ls", "ls_bpnn", "best")

RMSE_MM = (0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0, 6.0, 10.0)
"""RMSE of the camera in space: sqrt(3) times its standard deviation per axis."""


def settings_of(arms: int, episodes: int, epochs: int, seed: int, **changes: Any) -> PolicySettings:
    """A comparison at one seed."""
    instrument = changes.pop("instrument", None)
    plan = CalibrationPlan(epochs=epochs, seed=seed, **({} if instrument is None else {"instrument": instrument}))
    return PolicySettings(arms=arms, episodes=episodes, seeds=(seed,), plan=plan, **changes)


def fits(plant: str, compensation: str, policy: str, **levels: Any) -> bool:
    """Residual models are for plants whose arms come to rest; with a camera a policy needs none of them."""
    enough = ("raw",) if policy == "oracle" else ("raw", "ls") if plant == WHERE_LS_IS_ENOUGH else (compensation,)
    return compensation in enough


def fits_adaptive(plant: str, compensation: str, **levels: Any) -> bool:
    """Behind least squares the filter has little to learn but on arms that drift."""
    return compensation == "raw" or plant == WHERE_LS_IS_ENOUGH


def reaching(
    rng: np.random.Generator, plant: str, compensation: str, policy: str, arms: int, episodes: int, epochs: int,
    folder: str, seed: int, feedback: str = "encoders", instrument: str | None = None,
) -> Any:  # fmt: skip
    """Reaches of one policy: a row for each arm and fruit, in the order in which it met them."""
    chosen: dict[str, Any] = {"plants": (plant,), "compensations": (compensation,), "feedback": (feedback,)}
    settings = settings_of(arms, episodes, epochs, seed, policies=(policy,), instrument=instrument, **chosen)
    rows = run_policies(settings, cache=Path(folder) / "calibrations").columns
    pick, half = rows["episode"] + 1, episodes // 2
    when = np.where(pick == 1, "first pick", np.where(pick <= 8, "picks 2 to 8", "later"))
    kept = ("arm", "training", "error_mm", *(name for name in rows if name.startswith("chance_")))
    return {name: rows[name] for name in kept} | {"pick": pick, "when": np.where(pick > half, "second half", when)}


def carried(
    rng: np.random.Generator, trained_on: str, compensation: str, arms: int, episodes: int, epochs: int, steps: int,
    trainings: int, folder: str, seed: int,
) -> Any:  # fmt: skip
    """Reaches of several trainings of PPO without a camera, on new arms of qiao2026."""
    out = Path(folder) / "transfer" / trained_on.split()[0]
    for number in range(trainings):
        what, place = dict(TRAINED_ON[trained_on]), out / str(number)
        if "compensate" in what:
            what["compensate"] = str(calibration_file(Path(folder)))
        if not (place / "policy.npz").is_file():
            train(Training("ppo", seed=number, steps=steps, **what), place, resume=(place / "checkpoint.pt").is_file())
    return reaching(rng, "qiao2026", compensation, str(out), arms, episodes, epochs, folder, seed)


def noise(
    rng: np.random.Generator, plant: str, gain: float, arms: int, episodes: int, epochs: int, folder: str, seed: int
) -> Any:
    """One row an arm: mean errors of the raw servo by the camera's RMSE, and of the calibrated arm, blind."""
    found = {}
    for compensation in OPEN_LOOP:
        rows = reaching(rng, plant, compensation, "scripted", arms, episodes, epochs, folder, seed)
        found[compensation] = np.bincount(rows["arm"], rows["error_mm"]) / episodes
    for rmse in RMSE_MM:
        camera = {"feedback": "camera", "camera_noise_mm": float(rmse / np.sqrt(3.0)), "tolerances": "coarse"}
        servo = roll_out(
            lambda env, _: ServoReach(env, gain=gain), arms, episodes, seed, plant=plant,
            population_seed=population_seed(seed), **camera,
        )  # fmt: skip
        found[f"{rmse:g}"] = servo.reaches.position_error_mm.reshape(-1, arms).mean(axis=0)
    return found | {"arm": np.arange(arms)}


def noise_curves(rows: Rows) -> Any:
    """What the raw servo leaves by the camera's RMSE, beside the open loop, one panel for each plant."""
    plants, colours = rows.levels("plant"), dict(zip(OPEN_LOOP, rgb(policy_colours(OPEN_LOOP)), strict=True))
    with new_figure(WIDTH, 3.4) as figure:
        panels: Any = figure.subplots(1, len(plants), sharey=True, squeeze=False)[0]
        for axis, (plant,) in zip(panels, plants, strict=True):
            for (gain,), line in zip(rows.levels("gain"), (":", "--", "-"), strict=False):
                some = rows.where(plant=plant, gain=gain)
                axis.plot(
                    RMSE_MM, [some[f"{rmse:g}"].mean() for rmse in RMSE_MM], line, color="0.2", label=f"gain {gain:g}"
                )
            for key, colour in colours.items():
                axis.axhline(some[key].mean(), color=colour, label=f"open loop, {policy_label(key)}")
            axis.set(xscale="log", yscale="log", xlabel="RMSE of the camera (mm)", title=plant)
            for one in (axis.xaxis, axis.yaxis):
                plain_decades(one)
        panels[0].set_ylabel("mean position error (mm)")
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def crossing(table: np.ndarray) -> float:
    """RMSE of the camera, mm, at which a servo is as bad as the open loop; of rows (open loop, servo by RMSE)."""
    mean = table.mean(axis=0)
    gap, x = np.log(mean[1:] / mean[0]), np.log(RMSE_MM)
    above = np.flatnonzero((gap[:-1] < 0) & (gap[1:] >= 0))
    if not len(above):
        return float("nan")
    i = int(above[0])
    return float(x[i] - gap[i] * (x[i + 1] - x[i]) / (gap[i + 1] - gap[i]))


def day(rng: np.random.Generator, arms: int, picks: int, epochs: int, seed: int) -> Any:
    """A day in the orchard: the arm warms up and the machine sinks; a row for each method, arm and pick."""
    settings = settings_of(arms, 1, epochs, seed)
    plants = settings.population("orchard", seed)
    nominal, dt = plants.arm.nominal, DAY_HOURS * 3600.0 / picks
    draws = np.random.default_rng(stream(seed, "picks"))
    goals = random_joints(nominal, picks * arms, draws).reshape(picks, arms, -1)
    looks = draws.normal(size=(picks, arms, 3)) * CAMERA_STD
    workshop = plants.without(DRIFTS)  # firm ground, and the temperature at which the arm was built
    fitted = [calibrate_arm(plant_at(workshop, i), "ls", settings.plan, i).compensator() for i in range(arms)]
    seen = goals.reshape(-1, nominal.joints)[:300]
    first = start_filter(complete_model(nominal), nominal, seen, full_pose=False, prior=PRIOR)
    parts = []
    for method in ("raw", "calibrated in the workshop", "and adapted online"):
        state, filters = plants.initial_state(np, list(goals[0].T)), [first] * arms
        for k, target in enumerate(goals):
            wanted = forward(nominal, target).position
            if method == "and adapted online":
                target = aimed(nominal, filters, target)
            command = target if method == "raw" else np.stack([f(q) for f, q in zip(fitted, target, strict=True)])
            state, frame = plants.advance(np, state, list(command.T), dt)
            tool = np.stack(np.broadcast_arrays(*frame[9:12]), axis=-1)
            if method == "and adapted online":
                filters = taught(filters, target, tool + looks[k], LOOK, WALK, dt)
            error = np.linalg.norm(tool - wanted, axis=-1) * 1e3
            parts.append((np.full(arms, method), np.arange(arms), np.full(arms, (k + 1.0) * dt / 3600.0), error))
    names = ("method", "arm", "time_h", "error_mm")
    found = {name: np.concatenate(each) for name, each in zip(names, zip(*parts, strict=True), strict=True)}
    part = np.where(found["time_h"] <= DAY_HOURS / 8, "first hour", "between")
    return found | {"part": np.where(found["time_h"] > DAY_HOURS * 3 / 4, "last two hours", part)}
