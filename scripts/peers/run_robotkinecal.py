"""robotkinecal as its README uses it: an arm from a URDF, observations as points, default settings."""

import contextlib
import io
import tempfile
from pathlib import Path

import numpy as np
import roboticstoolbox as rtb
from problem import Clock, Problem, Solved, main
from robotkinecal import SerialRobotKineCal


def solve(problem: Problem) -> Solved:
    """One calibration, the arm being loaded."""
    np.random.seed(0)  # the package draws the bases of its twists
    words = io.StringIO()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "arm.urdf"
        path.write_text(problem.urdf, encoding="utf-8")
        robot = rtb.ERobot.URDF(str(path))
    with contextlib.redirect_stdout(words):
        clock = Clock()
        calibration = SerialRobotKineCal(robot, ee_name="tool")
        calibration.set_observations(list(problem.joints), list(problem.position))
        clock.solver_starts()
        result = calibration.solve()
        times = clock.stopped()
    tip = calibration.N_JOINTS + 1
    dropped = words.getvalue().count("is not identifiable") // result.nb_iterations_executed
    ends = {(True, False): "", (False, True): "reports divergence"}
    return Solved(
        **times,
        predict=lambda joints: np.array([calibration.forward_kinematics(tip, q).t for q in joints]),
        parameters=calibration.N_PARAMS - dropped,
        iterations=f"{result.nb_iterations_executed} iterations",
        note=ends.get((result.has_converged, result.is_diverging), "not converged"),
    )


if __name__ == "__main__":
    main(solve)
