"""Clock offsets of KinHEC's track "temporal" (MIT): pickenv's beside KinHEC's own cross-correlation of angular speeds.

KinHEC simulates joint logs and a noisy hand camera, whose clock is ahead by a planted offset. Both programs get the
same camera poses. pickenv reads the joints as they were logged, KinHEC the flange poses as the robot reports them.
"""

import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from pickenv.arm import load_arm, rotation_vector
from pickenv.base import InputError
from pickenv.calibration import read_observations
from pickenv.calibration.model.observations import Clocks

ARMS, OFFSETS, HERTZ, JITTERS = ("ur5", "ur10e"), (0.025, 0.05, 0.1, 0.2), (10.0, 30.0), (0.0, 0.005)

COLUMNS = """
[recording]
time = "t"
unit = "s"
joints = "joints.csv"
joints_time = "t"
joints_unit = "s"

[joints]
columns = ["j1", "j2", "j3", "j4", "j5", "j6"]
unit = "rad"

[position]
columns = ["x", "y", "z"]
unit = "m"

[rotation]
columns = ["rx", "ry", "rz"]
convention = "rotation_vector"
unit = "rad"
"""


def main() -> None:
    """Print the median error of both, and the share of true offsets within two of pickenv's standard uncertainties."""
    if find_spec("kinhec") is None:
        print("skipped: kinhec is not installed; pip install kinhec")
        return
    import yaml
    from kinhec import plans, se3, solvers
    from kinhec.generator import generate_sequence
    from kinhec.io import Sequence

    spec = yaml.safe_load((Path(plans.__file__).parent / "configs" / "medium.yaml").read_text(encoding="utf-8"))
    names = ("robots", "time_offset_s", "camera_rate_hz", "jitter_std_s")
    spec["tracks"]["temporal"] |= dict(zip(names, (ARMS, OFFSETS, HERTZ, JITTERS), strict=True))
    errors, within = [], []
    for plan in plans.plan_temporal(spec):
        record = generate_sequence(plan)
        data = Sequence(record.manifest, record.robot_table, record.camera_table)
        theirs, _ = solvers.estimate_time_offset(
            data.robot.t, data.robot.T_base_ee_meas, data.camera.t, data.camera.T_cam_target_meas
        )
        cameras = se3.inverse(data.camera.T_cam_target_meas)
        with tempfile.TemporaryDirectory() as folder:
            try:
                clocks = offset_of(plan.robot, data.robot.t, data.robot.q_meas, data.camera.t, cameras, Path(folder))
            except InputError as error:
                print(f"{plan.level}: refused: {error}")
                continue
        ours = clocks.offset - data.time_offset
        errors.append([abs(ours), abs(theirs - data.time_offset)])
        within.append(abs(ours) < 2.0 * clocks.offset_std)
    ours, theirs = 1e3 * np.median(errors, axis=0)
    worst = 1e3 * np.percentile(errors, 90, axis=0)
    print(f"{len(errors)} recordings of {len(ARMS)} arms; the clock's offset, ms: median and 90th percentile of errors")
    print(f"pickenv {ours:.2f}, {worst[0]:.2f}; {100 * np.mean(within):.0f} % within two standard uncertainties")
    print(f"KinHEC's cross-correlation {theirs:.2f}, {worst[1]:.2f}")


def offset_of(
    arm: str, stamps: np.ndarray, joints: np.ndarray, times: np.ndarray, cameras: np.ndarray, folder: Path
) -> Clocks:
    """What pickenv finds of the clocks, from both logs as files; poses of the camera in the board's frame."""
    names = "t,j1,j2,j3,j4,j5,j6"
    np.savetxt(folder / "joints.csv", np.c_[stamps, joints], "%.9f", ",", header=names, comments="")
    some = np.isfinite(cameras).all(axis=(1, 2)) & np.r_[True, np.diff(times) > 0.0]
    pose = np.c_[times, cameras[:, :3, 3], rotation_vector(cameras[:, :3, :3])][some]
    np.savetxt(folder / "camera.csv", pose, "%.9f", ",", header="t,x,y,z,rx,ry,rz", comments="")
    (folder / "columns.toml").write_text(COLUMNS, encoding="utf-8")
    rows = read_observations([folder / "camera.csv"], load_arm(arm).nominal, folder / "columns.toml")
    assert rows.origins is not None
    return rows.origins.clocks[0]


if __name__ == "__main__":
    main()
