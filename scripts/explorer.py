"""The error fields that docs/explorer.md turns: every shipped plant, raw and calibrated, over its workspace.

Each plant is measured and calibrated as `pickenv.experiments.calibrate_arm` does it, with its defaults. Positions are
kept in whole millimetres and errors in whole micrometres, in the base frame.

Run: MKL_CBWR=COMPATIBLE python scripts/explorer.py [--out docs/_static/explorer-fields.js]
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import typer
from measuring import ROOT

from pickenv.arm import Array, Plant, drawn_parts, forward, load_plant, nominal_points, pose_error, shipped_plants
from pickenv.base import write_text
from pickenv.calibration import random_joints
from pickenv.experiments import CalibrationPlan, compensators
from pickenv.experiments.methods import METHODS
from pickenv.inspect import field_grid
from pickenv.inspect.colours import policy_label, viridis
from pickenv.inspect.figures.plot_errors import field_gain
from pickenv.inspect.runs.comparison_summary import error_spread, scale_end

FIELDS = ROOT / "docs/_static/explorer-fields.js"
ASSIGNED = "window.explorerFields = "
"""The file is a script and no JSON: a browser loads no other data from a page that no server sends."""

PLAN = CalibrationPlan()
STEP, SMALL = 0.1, {"so101": 0.04}
"""Distance between the places of a grid, m; less for a small arm."""

NEVER_UPRIGHT, PLACES = ("li2016_master", "li2016_slave"), 300
"""Arms whose tools lie, so that no grid of upright tools can be reached: joints are drawn for so many places."""


def places(plant: Plant) -> Array:
    """Joints ``(F, n)`` at which the nominal arm's tool stands upright on a grid, or random ones."""
    nominal = plant.arm.nominal
    if plant.arm.name in NEVER_UPRIGHT:
        return random_joints(nominal, PLACES, np.random.default_rng(PLAN.seed))
    return field_grid(nominal, SMALL.get(plant.arm.name, STEP), PLAN.seed).joints


def field(plant: Plant, joints: Array) -> dict[str, Any]:
    """What the page says of a plant, and draws: true minus wanted tool positions behind each method's calibration."""
    wanted, stages = forward(plant.arm.nominal, joints), {}
    for method in METHODS:
        senders = compensators(plant, method, PLAN)
        sent = joints if senders is None else senders[0](joints)
        stages[policy_label(method)] = pose_error(wanted, plant.tool_pose(sent))[:, :3]
    lengths = {label: 1e3 * np.linalg.norm(error, axis=1) for label, error in stages.items()}
    top = scale_end(lengths["raw"])
    fields = [
        {"label": label, "mean_mm": round(mean, 3), "largest_mm": round(most, 3), "errors_um": whole(1e6 * error)}
        for label, error in stages.items()
        for mean, *_, most in [error_spread(lengths[label])]
    ]
    scale = {"scale_mm": round(top, 3), "gain": field_gain(SMALL.get(plant.arm.name, STEP), top)}
    return {"plant": plant.name, "arm": plant.arm.name, **scale, "stages": fields}


def whole(values: Array) -> Any:
    """Rounded to whole numbers, as lists."""
    return np.rint(values).astype(int).tolist()


def drawn(plant: Plant, joints: Array) -> Any:
    """The nominal arm at each place, as corners of a line ``(F, K, 3)``, mm: base first, tool last."""
    points = nominal_points(plant.arm.nominal, joints)
    return whole(1e3 * points[:, [*drawn_parts(points), -1]])


def main(out: Path = FIELDS) -> None:
    """Make all fields, and write them."""
    plants = [load_plant(name) for name in shipped_plants()]
    joints = {plant.arm.name: places(plant) for plant in plants}
    content = {
        "seed": PLAN.seed,
        "poses": [PLAN.identification_poses, PLAN.residual_poses],
        "colours": viridis(np.linspace(0.0, 1.0, 17)).tolist(),
        "arms": {plant.arm.name: drawn(plant, joints[plant.arm.name]) for plant in plants},
        "plants": [field(plant, joints[plant.arm.name]) for plant in plants],
    }
    write_text(out, ASSIGNED + json.dumps(content, separators=(",", ":")) + ";\n")


if __name__ == "__main__":
    typer.run(main)
