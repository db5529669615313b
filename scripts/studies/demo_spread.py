"""What `pickenv demo` prints is of one calibration; how far would another lie from it? Simulated."""

from typing import Any

import numpy as np

from pickenv.demo import DemoSettings, run_demo
from pickenv.inspect.colours import policy_label


def measure(
    rng: np.random.Generator, calibration: int, calibrations: int, epochs: int, seed: int
) -> list[dict[str, Any]]:
    """The mean error of each policy of one calibration of the same arm, with poses, noise and fruit of its own."""
    own = int(np.random.SeedSequence(seed).generate_state(calibrations)[calibration])
    result = run_demo(DemoSettings(seed=own, epochs=epochs, grid_step=0.5, gain_poses=0))
    return [
        {"policy": policy_label(key), "error_mm": float(run.position_error_mm.mean())}
        for key, run in result.reaches.items()
    ]
