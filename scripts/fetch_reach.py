"""What a task's success hides: FetchReach counts a reach within 50 mm, whatever the arm; here its arm errs by 3 mm.

The arm of Gymnasium-Robotics' FetchReach is taken as the nominal one. True arms are drawn about it, in the shape of a
tolerance class, and scaled so that the tool errs by the asked millimetres on average over the reaches; each is
calibrated from poses of a simulated tracker (LS, base and tool known). A proportional rule drives the believed tool to
the goal. Draws success against the distance within which a reach counts, and prints the table.

Needs gymnasium-robotics (pip install gymnasium-robotics). Run: python scripts/fetch_reach.py [--out runs/fetch_reach]
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import matplotlib
import numpy as np
import typer
from matplotlib.figure import Figure
from measuring import ROOT, markdown_table

from pickenv.arm import (
    Arm,
    Array,
    Geometry,
    Plant,
    draw_plants,
    forward,
    geometry_in_mujoco,
    joints_in_mujoco,
    load_tolerances,
    plant_at,
)
from pickenv.arm.effects.drives import MeasurementNoise
from pickenv.base import InputError, write_json
from pickenv.calibration import fit, simulated_tracker
from pickenv.inspect import save_figure
from pickenv.inspect.figures.style import COLUMN, LINES, STYLE
from pickenv.wrappers import Compensate, Miscalibrate

SITE = "robot0:grip"
JOINTS = (
    *("torso_lift", "shoulder_pan", "shoulder_lift", "upperarm_roll"),
    *("elbow_flex", "forearm_roll", "wrist_flex", "wrist_roll"),
)
GAIN = 20.0
"""Of the rule, per metre: 0.05 m away it moves at full speed."""

STEPS, SEED, POSES = 50, 0, 60
"""Steps of a reach, seed of everything, poses measured."""

SPAN, RISE = 0.5, 0.02
"""How far from the start joints go for them: those that turn, rad, and the torso, m."""

OWN_MM = 50.0
"""Within so many millimetres the environment itself counts a reach."""


def fetch() -> Any:
    """The environment.

    Raises:
        InputError: If Gymnasium-Robotics is not installed.
    """
    try:
        import gymnasium_robotics
    except ImportError as error:
        raise InputError("FetchReach needs Gymnasium-Robotics; pip install gymnasium-robotics") from error
    gym.register_envs(gymnasium_robotics)
    return gym.make("FetchReach-v4", max_episode_steps=STEPS)


def started(env: Any) -> tuple[Geometry, Array]:
    """The nominal arm, and its joints at the start ``(n,)``."""
    env.reset(seed=SEED)
    inner = env.unwrapped
    nominal = geometry_in_mujoco(inner.model, SITE, [f"robot0:{name}_joint" for name in JOINTS], inner.data)
    lower = np.minimum(nominal.lower, 0.0)  # the environment starts with its torso below the model's own limit
    return replace(nominal, lower=lower), joints_in_mujoco(inner.model, inner.data, nominal)


def around(nominal: Geometry, start: Array, rng: np.random.Generator) -> Array:
    """Poses near the start ``(POSES, n)``."""
    span = np.where(nominal.prismatic, RISE, SPAN)
    return start + span * rng.uniform(-1.0, 1.0, (POSES, len(start)))


def arms_of(nominal: Geometry, start: Array, millimetres: float, count: int) -> list[Plant]:
    """Arms whose tools err by so many millimetres on average, near the start."""
    rng = np.random.default_rng(SEED)
    arm = Arm("fetch", "Gymnasium-Robotics", nominal, None, np.ones(nominal.joints))
    noise = MeasurementNoise(15e-6, 2e-4)
    drawn = draw_plants(Plant("fetch", arm, nominal, effects=(noise,)), load_tolerances("medium"), count, rng)
    poses = around(nominal, start, rng)
    believed, found = forward(nominal, poses).position, []
    for i in range(count):
        plant = plant_at(drawn, i)
        delta = nominal.difference(plant.geometry)
        for _ in range(3):  # errors are nearly linear in the deviations
            plant = replace(plant, geometry=nominal.displaced(delta))
            error = np.linalg.norm(plant.tool_pose(poses).position - believed, axis=1).mean()
            delta = delta * (millimetres * 1e-3 / error)
        found.append(replace(plant, geometry=nominal.displaced(delta)))
    return found


def calibrated(plant: Plant, start: Array, rng: np.random.Generator) -> Compensate:
    """What corrects this arm's commands, by LS from poses of a tracker."""
    joints = around(plant.arm.nominal, start, rng)
    return fit(plant.arm, simulated_tracker(plant, joints, rng), known_frames=True).calibration.compensator()


def reaches(env: Any, plant: Plant, compensator: Compensate | None, count: int) -> Array:
    """True distances from the goal at the end of reaches ``(count,)``, mm."""
    wrapped = Miscalibrate(env, plant.arm.nominal, plant, compensator)
    ends = []
    for number in range(count):
        observation, info = wrapped.reset(seed=number)
        for _ in range(STEPS):
            gap = observation["desired_goal"] - observation["achieved_goal"]
            observation, _, _, _, info = wrapped.step(np.append(np.clip(GAIN * gap, -1.0, 1.0), 0.0).astype(np.float32))
        ends.append(float(info["true_distance_mm"]))
    return np.array(ends)


def drawn(ends: Mapping[str, Array], millimetres: float) -> Figure:
    """Success against the distance within which a reach counts; bands reach from the worst arm to the best."""
    within = np.geomspace(0.1, OWN_MM, 60)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(COLUMN, 3.2), layout="constrained")
        axes = figure.add_subplot()
        for (name, values), line in zip(ends.items(), LINES, strict=False):
            share = [np.mean(values <= most) for most in within]
            (shown,) = axes.plot(within, 100.0 * np.array(share), linestyle=line, label=name)
            each = np.array([(values <= most).mean(axis=1) for most in within])
            axes.fill_between(
                within,
                100.0 * each.min(axis=1),
                100.0 * each.max(axis=1),
                color=shown.get_color(),
                alpha=0.2,
                linewidth=0,
            )
        axes.set(xscale="log", xlabel="a reach counts within (mm)", ylabel="success (%)", ylim=(0, 102))
        axes.set_title(f"FetchReach, arm of {millimetres:g} mm")
        axes.set_xticks([0.1, 1, 3, 10, 50], ["0.1", "1", "3", "10", "50"])
        figure.legend(loc="outside lower center")
    return figure


def main(
    out: Annotated[Path, typer.Option(help="Folder for figure and figures.")] = ROOT / "runs/fetch_reach",
    millimetres: Annotated[float, typer.Option(help="Mean error of the arms' tools.", min=0.01)] = 3.0,
    arms: Annotated[int, typer.Option(help="Arms drawn.", min=2)] = 12,
    count: Annotated[int, typer.Option(help="Reaches of each.", min=2)] = 25,
) -> None:
    """Reach, draw and print."""
    env = fetch()
    nominal, start = started(env)
    plants = arms_of(nominal, start, millimetres, arms)
    streams = np.random.default_rng(SEED).spawn(arms)
    perfect = replace(plants[0], geometry=nominal)
    ends = {
        "as the environment has it": reaches(env, perfect, None, count)[None],
        f"{millimetres:g} mm arm, raw": np.array([reaches(env, plant, None, count) for plant in plants]),
        "the same, calibrated (LS)": np.array(
            [
                reaches(env, plant, calibrated(plant, start, rng), count)
                for plant, rng in zip(plants, streams, strict=True)
            ]
        ),
    }
    bounds = (OWN_MM, 5.0, 3.0, 1.0)
    heads = ("arm", "mean error (mm)", *(f"within {most:g} mm" for most in bounds))
    rows = [
        (name, f"{values.mean():.2f}", *(f"{np.mean(values <= most):.0%}" for most in bounds))
        for name, values in ends.items()
    ]
    print(markdown_table(heads, rows, ("arm",)))
    write_json(out / "ends.json", {name: values.tolist() for name, values in ends.items()})
    save_figure(drawn(ends, millimetres), out / "success.png")


if __name__ == "__main__":
    typer.run(main)
