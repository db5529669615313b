"""The orchard is cheap to enter: SciPy and scikit-image load where they are used."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def loaded_after(code: str) -> set[str]:
    command = [sys.executable, "-c", f"import sys; {code}; print(*sys.modules)"]
    return set(subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout.split())


def test_entering_loads_neither_scipy_nor_scikit_image() -> None:
    assert not {"scipy", "skimage", "torch", "matplotlib"} & loaded_after("import pickenv.orchard")


def test_a_picking_step_needs_only_numpy() -> None:
    code = (
        "import numpy as np; from pickenv.orchard import *; rng = np.random.default_rng(0); "
        "capture_probability(load_gripper('li_cup'), 0.0, 0.0, 0.0); "
        "measured_positions(load_camera('d455f'), [0, 1, 0], [0, 0, 0], rng.normal(size=5)); "
        "swing(load_branch('apple'), [0, 0, 0], [0, 0, 0], 0.2, 0.1); "
        "sample_strength(load_detachment('apple'), (), rng)"
    )
    assert not {"scipy", "skimage"} & loaded_after(code)
