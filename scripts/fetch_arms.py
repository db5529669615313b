"""What a task's success hides: Fetch's tasks count within 50 mm, whatever the arm; here its arm errs by millimetres.

The arm of Gymnasium-Robotics' FetchReach and FetchPickAndPlace is taken as the nominal one. True arms are drawn about
it, in the shape of a tolerance class, and scaled so that the tool errs by the asked millimetres on average near the
start; each is calibrated from poses of a simulated tracker (LS, base and tool known). To reach, a proportional rule
drives the believed tool to the goal. To pick, it sees the object until the hand closes: it goes above it, down, closes
and carries the believed tool to the goal, while the true fingers touch. Draws success against the distance within which
a reach counts, and prints a table of reaches at one error and one of picks at several, with 95 % intervals over arms.

Needs gymnasium-robotics (pip install gymnasium-robotics). Run: python scripts/fetch_arms.py [--seed 0] [--json FILE]
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import typer
from matplotlib.figure import Figure
from measuring import ROOT, JsonFile, markdown_table

from pickenv.arm import (
    Arm,
    Array,
    Geometry,
    Plant,
    draw_plants,
    erring_by,
    geometry_in_mujoco,
    joints_in_mujoco,
    load_tolerances,
    plant_at,
)
from pickenv.arm.effects.drives import MeasurementNoise
from pickenv.base import InputError, clustered_share_interval, crossed_interval, mean_interval, run_seed, write_json
from pickenv.calibration import fit, simulated_tracker
from pickenv.inspect import new_figure, percent, save_figure
from pickenv.inspect.figures.style import COLUMN, LINES
from pickenv.wrappers import Compensate, Miscalibrate

Rule = Callable[[Mapping[str, Array], int], tuple[Array, float]]
Task = Callable[[Any, Plant, Compensate | None, Sequence[int]], Array]

SITE = "robot0:grip"
JOINTS = (
    *("torso_lift", "shoulder_pan", "shoulder_lift", "upperarm_roll"),
    *("elbow_flex", "forearm_roll", "wrist_flex", "wrist_roll"),
)
GAIN = 20.0
"""Of the rule, per metre: 0.05 m away it moves at full speed."""

STEPS, POSES = 50, 60
"""Steps of an episode, poses measured."""

DOWN, CLOSE, LIFT, ABOVE = 14, 22, 27, 0.1
"""At these steps of a pick the hand goes down, closes and lifts; until then it stays so far above the object, m."""

ERRORS_MM, NEAR_MM = [3.0, 10.0, 20.0, 30.0, 40.0], 10.0
"""Mean errors of the arms that pick, and within how much a pick is counted besides the environment's own."""

SPAN, RISE = 0.5, 0.02
"""How far from the start joints go for them: those that turn, rad, and the torso, m."""

PAST = 0.05
"""How far past their limits a correction may take joints that turn, rad; the torso may go `RISE` past its own."""

OWN_MM = 50.0
"""Within so many millimetres the environments themselves count success."""


def fetch(task: str = "Reach") -> Any:
    """The environment.

    Raises:
        InputError: If Gymnasium-Robotics is not installed.
    """
    try:
        import gymnasium_robotics
    except ImportError as error:
        raise InputError("Fetch needs Gymnasium-Robotics; pip install gymnasium-robotics") from error
    gym.register_envs(gymnasium_robotics)
    return gym.make(f"Fetch{task}-v4", max_episode_steps=STEPS)


def started(env: Any) -> tuple[Geometry, Array]:
    """The nominal arm, and its joints at the start ``(n,)``."""
    env.reset(seed=0)
    inner = env.unwrapped
    nominal = geometry_in_mujoco(inner.model, SITE, [f"robot0:{name}_joint" for name in JOINTS], inner.data)
    lower = np.minimum(nominal.lower, 0.0)  # the environment starts with its torso below the model's own limit
    return replace(nominal, lower=lower), joints_in_mujoco(inner.model, inner.data, nominal)


def around(nominal: Geometry, start: Array, rng: np.random.Generator) -> Array:
    """Poses near the start ``(POSES, n)``."""
    span = np.where(nominal.prismatic, RISE, SPAN)
    return start + span * rng.uniform(-1.0, 1.0, (POSES, len(start)))


def arms_of(nominal: Geometry, start: Array, millimetres: float, count: int, seed: int) -> list[Plant]:
    """Arms whose tools err by so many millimetres on average, near the start."""
    rng = np.random.default_rng(seed)
    arm = Arm("fetch", "Gymnasium-Robotics", nominal, None, np.ones(nominal.joints))
    noise = MeasurementNoise(15e-6, 2e-4)
    drawn = draw_plants(Plant("fetch", arm, nominal, effects=(noise,)), load_tolerances("medium"), count, rng)
    poses = around(nominal, start, rng)
    arms = (erring_by(plant_at(drawn, i), millimetres * 1e-3, poses) for i in range(count))
    return [replace(plant, effects=(noise,)) for plant in arms]


def calibrated(plant: Plant, start: Array, rng: np.random.Generator) -> Compensate:
    """What corrects this arm's commands, by LS from poses of a tracker."""
    joints = around(plant.arm.nominal, start, rng)
    return fit(plant.arm, simulated_tracker(plant, joints, rng), known_frames=True).calibration.compensator()


def reaching(observation: Mapping[str, Array], step: int) -> tuple[Array, float]:
    """How far the believed tool is to go, m, and what the hand does: nothing."""
    return observation["desired_goal"] - observation["achieved_goal"], 0.0


def picking(observation: Mapping[str, Array], step: int) -> tuple[Array, float]:
    """How far the believed tool is to go, m, and whether the hand opens (1) or closes (-1)."""
    tool, thing = observation["observation"][:3], observation["observation"][3:6]
    if step < CLOSE:
        return thing + np.array([0.0, 0.0, ABOVE if step < DOWN else 0.0]) - tool, 1.0
    return (observation["desired_goal"] if step >= LIFT else tool) - tool, -1.0


def episodes(env: Any, rule: Rule, seeds: Sequence[int]) -> list[Any]:
    """Last observation and `info` of episodes with these seeds."""
    ends = []
    for seed in seeds:
        observation, info = env.reset(seed=seed)
        for step in range(STEPS):
            gap, hand = rule(observation, step)
            action = np.append(np.clip(GAIN * gap, -1.0, 1.0), hand).astype(np.float32)
            observation, *_, info = env.step(action)
        ends.append((observation, info))
    return ends


def reaches(env: Any, plant: Plant, compensator: Compensate | None, seeds: Sequence[int]) -> Array:
    """True distances from the goal at the end of reaches with these seeds ``(n,)``, mm."""
    wrapped = Miscalibrate(env, plant.arm.nominal, plant, compensator)
    return np.array([info["true_distance_mm"] for _, info in episodes(wrapped, reaching, seeds)])


def picks(env: Any, plant: Plant, compensator: Compensate | None, seeds: Sequence[int]) -> Array:
    """Distances of the object from the goal at the end of picks with these seeds ``(n,)``, mm."""
    wrapped = Miscalibrate(env, plant.arm.nominal, plant, compensator, contact=True)
    ends = [end["achieved_goal"] - end["desired_goal"] for end, _ in episodes(wrapped, picking, seeds)]
    return np.asarray(np.linalg.norm(ends, axis=1) * 1e3)


def compared(env: Any, task: Task, plants: list[Plant], start: Array, seeds: Sequence[int]) -> dict[str, Array]:
    """Distances ``(arms, n)`` of the raw arms and of the same calibrated, mm."""
    raw = [task(env, plant, None, seeds) for plant in plants]
    pairs = zip(plants, np.random.default_rng(seeds[0]).spawn(len(plants)), strict=True)
    better = [task(env, plant, calibrated(plant, start, rng), seeds) for plant, rng in pairs]
    return {"raw": np.array(raw), "calibrated": np.array(better)}


def share(distances: Array, most: float) -> dict[str, Any]:
    """The share of distances ``(arms, n)`` that are within so much, with its 95 % interval over arms."""
    within = (distances < most).sum(axis=1)
    return {"share": float(np.mean(distances < most)), "ci95": clustered_share_interval(within, distances.shape[1])}


def picked(arms: int, seeds: Sequence[int], errors_mm: Sequence[float]) -> dict[float, dict[str, Array]]:
    """Distances ``(arms, n)`` of picks, by the arms' error and what was done about it, mm."""
    env = fetch("PickAndPlace")
    nominal, start = started(env)
    # Torso and shoulder come to their limits, which are soft; beyond them a compensator would correct nothing.
    past = np.where(nominal.prismatic, RISE, PAST)
    nominal = replace(nominal, lower=nominal.lower - past, upper=nominal.upper + past)
    perfect = picks(env, replace(arms_of(nominal, start, 1.0, 1, seeds[0])[0], geometry=nominal), None, seeds)[None]
    distances = {0.0: {"raw": perfect, "calibrated": perfect}}
    for error_mm in errors_mm:
        distances[error_mm] = compared(env, picks, arms_of(nominal, start, error_mm, arms, seeds[0]), start, seeds)
    return distances


def drawn(ends: Mapping[str, Array], millimetres: float) -> Figure:
    """Success against the distance within which a reach counts; bands reach from the worst arm to the best."""
    within = np.geomspace(0.1, OWN_MM, 60)
    with new_figure(COLUMN, 3.2) as figure:
        axes = figure.add_subplot()
        for (name, values), line in zip(ends.items(), LINES, strict=False):
            shares = 100.0 * np.array([(values <= most).mean(axis=1) for most in within])
            mean = [100.0 * np.mean(values <= most) for most in within]
            (curve,) = axes.plot(within, mean, linestyle=line, label=name)
            bounds = shares.min(axis=1), shares.max(axis=1)
            axes.fill_between(within, *bounds, color=curve.get_color(), alpha=0.2, linewidth=0)
        axes.set(xscale="log", xlabel="a reach counts within (mm)", ylabel="success (%)", ylim=(0, 102))
        axes.set_title(f"FetchReach, arm of {millimetres:g} mm")
        axes.set_xticks([0.1, 1, 3, 10, 50], ["0.1", "1", "3", "10", "50"])
        figure.legend(loc="outside lower center")
    return figure


def main(
    out: Annotated[Path, typer.Option(help="Folder for the figure.")] = ROOT / "runs/fetch_arms",
    millimetres: Annotated[float, typer.Option(help="Mean error of the tools that reach.", min=0.01)] = 3.0,
    error: Annotated[list[float], typer.Option(help="Mean error of tools that pick, mm; may be repeated.")] = ERRORS_MM,
    arms: Annotated[int, typer.Option(help="Arms drawn.", min=2)] = 12,
    count: Annotated[int, typer.Option(help="Reaches and picks of each.", min=2)] = 25,
    seed: Annotated[int, typer.Option(help="Seed of arms, calibrations and episodes.", min=0)] = 0,
    json_file: JsonFile = None,
) -> None:
    """Reach, draw and print; pick and print."""
    env = fetch()
    nominal, start = started(env)
    seeds = [run_seed(seed % 2**16) + number for number in range(count)]
    plants = arms_of(nominal, start, millimetres, arms, seeds[0])
    ends = {"as the environment has it": reaches(env, replace(plants[0], geometry=nominal), None, seeds)[None]}
    names = f"{millimetres:g} mm arm, raw", "the same, calibrated (LS)"
    ends |= zip(names, compared(env, reaches, plants, start, seeds).values(), strict=True)
    bounds = (OWN_MM, 5.0, 3.0, 1.0)
    heads = ("arm", "mean error (mm)", *(f"within {most:g} mm" for most in bounds))
    rows = [
        (name, f"{values.mean():.2f}", *(f"{np.mean(values <= most):.0%}" for most in bounds))
        for name, values in ends.items()
    ]
    print(markdown_table(heads, rows, ("arm",)))
    save_figure(drawn(ends, millimetres), out / "success.png")
    shares: list[dict[str, Any]] = [
        {"error_mm": millimetres, "judged": f"{name}, within {most:g} mm"} | share(values, most)
        for millimetres, both in picked(arms, seeds, error).items()
        for most in (OWN_MM, NEAR_MM)
        for name, values in both.items()
    ]
    lines: dict[str, list[str]] = {}
    for row in shares:
        lines.setdefault(f"{row['error_mm']:g}", []).append(percent(row["share"], *(row["ci95"] or (None, None))))
    heads = ("mean error (mm)", *dict.fromkeys(row["judged"] for row in shares))
    print(markdown_table(heads, [(error, *cells) for error, cells in lines.items()], ()))
    if json_file is not None:
        reached = [
            {"arm": n, "mean_mm": mm.mean(), "ci95": crossed_interval(mm) if len(mm) > 1 else mean_interval(mm[0])}
            for n, mm in ends.items()
        ]
        write_json(json_file, {"seed": seed, "reaches": reached, "picks": shares})


if __name__ == "__main__":
    typer.run(main)
