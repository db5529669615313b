"""The demonstration over several calibrations: each with poses, noise, network and fruit of its own, on the same arm.

What `pickenv demo` prints is of one calibration; this says how far another would lie from it.

Run: python scripts/demo_spread.py [--calibrations 10] [--json FILE]
"""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import typer
from measuring import JsonFile
from rich.progress import track

from pickenv.arm.kinematics.geometry import Array
from pickenv.demo import DemoSettings, run_demo
from pickenv.files import write_json
from pickenv.inspect.colours import policy_label
from pickenv.inspect.reports.report_words import between
from pickenv.intervals import LEAST, mean_interval

SEED = 0


def spread(means: Array) -> dict[str, Any]:
    """Mean, its 95 % interval, standard deviation and range of one mean error per calibration ``(C,)``."""
    return {
        "mean": float(means.mean()),
        "ci95": mean_interval(means),
        "std": float(means.std(ddof=1)),
        "low": float(means.min()),
        "high": float(means.max()),
        "calibrations": len(means),
    }


def sentence(label: str, found: dict[str, Any]) -> str:
    """One policy in words."""
    no = f"no interval: fewer than {LEAST} calibrations"
    said = no if found["ci95"] is None else f"95 % interval {between(*found['ci95'], 3)}"
    return (
        f"{label}: mean of means {found['mean']:.3f} mm ({said}), standard deviation {found['std']:.3f} mm, range "
        f"{between(found['low'], found['high'], 3)} mm"
    )


def main(
    calibrations: Annotated[int, typer.Option(help="How many; each has 100 fruit.", min=2)] = 10,
    json_file: JsonFile = None,
    epochs: Annotated[int, typer.Option(help="Passes of each network's training; the paper's by default.")] = 500,
) -> None:
    """Run them and print a line for each policy."""
    means: dict[str, list[float]] = {}
    for seed in track(np.random.SeedSequence(SEED).generate_state(calibrations), description="calibrations"):
        result = run_demo(DemoSettings(seed=int(seed), epochs=epochs, grid_step=0.5, gain_poses=0))
        for key, run in result.reaches.items():
            means.setdefault(key, []).append(float(run.position_error_mm.mean()))
    found = {key: spread(np.array(values)) for key, values in means.items()}
    print(f"over {calibrations} calibrations of one arm (own poses, noise, network and fruit):")
    for key, each in found.items():
        print(f"  {sentence(policy_label(key), each)}")
    if json_file is not None:
        write_json(json_file, {"seed": SEED, "means_mm": means, "spread_mm": found})


if __name__ == "__main__":
    typer.run(main)
