"""FIGAROH as its UR10 example uses it: base parameters by QR, closed-form frames, then Levenberg-Marquardt.

It is given the nominal arm and finds base and tool itself: MINPACK sizes its first step by the start, and from an arm
that is aligned already, where all unknowns start at zero, it creeps (minutes instead of seconds).
"""

import contextlib
import io
import tempfile
from pathlib import Path

import matplotlib

matplotlib.use("Agg")

import numpy as np
from figaroh.calibration.base_calibration import BaseCalibration
from figaroh.calibration.calibration_tools import calc_updated_fkm
from figaroh.tools.load_robot import load_robot
from problem import Clock, Problem, Solved, main

CONFIG = """
schema_version: "2.0"
robot:
  name: arm
  properties:
    joints:
      active_joints: [{joints}]
tasks:
  calibration:
    enabled: true
    type: kinematic_calibration
    parameters: {{calibration_level: full_params, include_non_geometric: false, outlier_threshold: 0.02}}
    kinematics: {{base_frame: universe, tool_frame: tool}}
    measurements:
      markers:
        - {{name: reflector, measurable_dof: [true, true, true, false, false, false], sensor_type: tracker}}
      poses: {{base_pose: [0, 0, 0, 0, 0, 0], tool_pose: [0, 0, 0, 0, 0, 0]}}
    data: {{source_file: {data}, number_of_samples: {count}}}
"""


class Calibration(BaseCalibration):
    """The cost function of the package's UR10 example."""

    def cost_function(self, var: np.ndarray) -> np.ndarray:
        """Log-map residuals of all samples."""
        estimated = calc_updated_fkm(self.model, self.data, var, self.q_measured, self.calib_config)
        return self.apply_measurement_weighting(
            self._compute_logmap_residuals(self.PEE_measured, estimated), pos_weight=1.0, orient_weight=0.5
        )


def solve(problem: Problem) -> Solved:
    """One calibration, the arm and its files being there."""
    names = [f"joint_{i + 1}" for i in range(len(problem.alpha))]
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        arm, data, config = (Path(folder) / name for name in ("arm.urdf", "data.csv", "config.yaml"))
        arm.write_text(problem.nominal_urdf, encoding="utf-8")
        table = np.concatenate([problem.position, problem.joints], axis=1)
        header = ",".join(["x1", "y1", "z1", *names])
        np.savetxt(data, table, delimiter=",", header=header, comments="", fmt="%.17g")
        text = CONFIG.format(joints=", ".join(names), data=data, count=len(table))
        config.write_text(text, encoding="utf-8")
        robot = load_robot(str(arm), package_dirs=folder)
        clock = Clock()
        calibration = Calibration(robot, str(config))
        calibration.calib_config |= {"known_baseframe": False, "known_tipframe": False}  # no file can hold these two
        calibration.initialize()
        clock.solver_starts()
        result = calibration.solve(enable_logging=False)
        times = clock.stopped()

    def predict(joints: np.ndarray) -> np.ndarray:
        settings = dict(calibration.calib_config, NbSample=len(joints))
        flat = calc_updated_fkm(calibration.model, calibration.data, result.x, joints, settings)
        return flat.reshape(3, -1).T

    excluded = calibration.evaluation_metrics["n_outliers"]
    return Solved(
        **times,
        predict=predict,
        parameters=len(result.x),
        iterations=f"{result.nfev} residual evaluations",
        note=("" if result.success else f"not converged: {result.message}; ")
        + (f"{excluded} samples excluded as outliers" if excluded else ""),
    )


if __name__ == "__main__":
    main(solve)
