"""pybotics as its calibration notebook uses it: SciPy on the norms of the position errors, lengths in mm.

All DH parameters, the reflector's offset and the world frame are freed; the notebook frees joint offsets only, which
cannot reach the accuracy that is compared here.
"""

import numpy as np
import scipy.optimize
from problem import Clock, Problem, Solved, main
from pybotics.kinematic_chain import MDHKinematicChain
from pybotics.optimization import OptimizationHandler, optimize_accuracy
from pybotics.robot import Robot
from pybotics.tool import Tool

EVALUATIONS = 200


def in_mm(pose: np.ndarray) -> np.ndarray:
    """A pose ``(4, 4)`` with its position in mm."""
    return np.block([[pose[:3, :3], pose[:3, 3:] * 1e3], [pose[3:]]])


def solve(problem: Problem) -> Solved:
    """One calibration, the arm being made."""
    table = np.stack([problem.alpha, problem.a * 1e3, problem.theta, problem.d * 1e3], axis=1)
    robot = Robot(
        MDHKinematicChain.from_parameters(table), tool=Tool(in_mm(problem.tool)), world_frame=in_mm(problem.base)
    )
    position = problem.position * 1e3
    clock = Clock()
    handler = OptimizationHandler(
        robot,
        kinematic_chain_mask=[True] * table.size,
        tool_mask=[True, True, True, False, False, False],
        world_mask=[True] * 6,
    )
    start = handler.generate_optimization_vector()
    clock.solver_starts()
    result = scipy.optimize.least_squares(
        optimize_accuracy, start, args=(handler, problem.joints, position), max_nfev=EVALUATIONS
    )
    handler.apply_optimization_vector(result.x)
    times = clock.stopped()
    return Solved(
        **times,
        predict=lambda joints: np.array([handler.robot.fk(q)[:3, 3] for q in joints]) * 1e-3,
        parameters=len(start),
        iterations=f"{result.nfev} evaluations with {result.njev} finite-difference Jacobians",
        note="" if result.status > 0 else f"stopped at {EVALUATIONS} evaluations, not converged",
    )


if __name__ == "__main__":
    main(solve)
