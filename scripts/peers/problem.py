"""What the workers share: the problem that they are given, and how they are timed and judged.

A worker runs in the environment of its own package, so this file needs NumPy only. Metres and radians.
"""

import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np


class Problem(SimpleNamespace):
    """One calibration problem, as `peer_problem` of benchmark_calibration.py writes it; its lists are arrays.

    Attributes:
        alpha: Modified DH parameters of the arm to start from, as are a, theta and d ``(n,)``.
        a: See alpha.
        theta: See alpha.
        d: See alpha.
        base: Pose of the arm in the instrument's frame ``(4, 4)``; it was fitted already.
        tool: Pose of the reflector in the last link ``(4, 4)``; it was fitted already.
        urdf: The same arm as a URDF: links base, link1..n and tool, joints joint_1..n.
        nominal_urdf: The arm as its maker describes it, for packages that find base and tool themselves.
        joints: Joints for the fit ``(N, n)``.
        position: Measured positions for the fit ``(N, 3)``.
        held_out_joints: Joints of the held-out rows.
        held_out_position: Measured positions of the held-out rows.
        random_joints: Joints of the further test poses.
        random_position: Measured positions of the further test poses.
        runs: How often to repeat the fit.
    """


class Solved(SimpleNamespace):
    """One run of a package.

    Attributes:
        seconds: From the loaded arm and data to the calibrated arm.
        solve_seconds: Of this, the package's solver call alone.
        cpu_seconds: Processor time of the whole, of all threads; a busy machine lengthens it less.
        predict: Positions ``(N, 3)`` of the calibrated arm at joints ``(N, n)``.
        parameters: Number of free parameters.
        iterations: What the package did, in its own words.
        note: What else a reader must know; empty if nothing.
    """


def errors_mm(solved: Solved, joints: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Euclidean position errors ``(N,)``, mm."""
    return np.linalg.norm(solved.predict(joints) - position, axis=1) * 1e3


def main(solve: Callable[[Problem], Solved]) -> None:
    """Read the problem named first on the command line, solve it, and write the result to the file named second."""
    content = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    problem = Problem(**{key: np.array(v) if isinstance(v, list) else v for key, v in content.items()})
    solved = [solve(problem) for _ in range(problem.runs)]
    last = solved[-1]
    held_out = errors_mm(last, problem.held_out_joints, problem.held_out_position)
    random = errors_mm(last, problem.random_joints, problem.random_position)
    times = ("seconds", "solve_seconds", "cpu_seconds")
    result: dict[str, Any] = {
        **{name: statistics.median(getattr(run, name) for run in solved) for name in times},
        "best_seconds": min(run.seconds for run in solved),
        "runs": problem.runs,
        "poses": len(problem.joints),
        "parameters": last.parameters,
        "iterations": last.iterations,
        "held_out_rms_mm": float(np.sqrt(np.mean(held_out**2))),
        "random_poses_mean_mm": float(np.mean(random)),
        "remark": last.note,
    }
    Path(sys.argv[2]).write_text(json.dumps(result), encoding="utf-8")


class Clock:
    """Time since it was made, of which a package's solver call is the last part."""

    def __init__(self) -> None:
        self._begin, self._cpu = time.perf_counter(), time.process_time()
        self._solver = self._begin

    def solver_starts(self) -> None:
        """From here on the solver works."""
        self._solver = time.perf_counter()

    def stopped(self) -> dict[str, float]:
        """Times of `Solved` up to here, s."""
        now, cpu = time.perf_counter(), time.process_time()
        times = {"seconds": now - self._begin, "solve_seconds": now - self._solver}
        return times | {"cpu_seconds": cpu - self._cpu}
