"""The measured robots: their files, arms and column descriptions, and how their rows become a problem."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pickenv.arm import Arm, load_arm
from pickenv.calibration.identification.diagnosis import checked_rows
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import Observations, equally_spaced
from pickenv.calibration.reading.read import read_observations
from pickenv.errors import InputError


@dataclass(frozen=True)
class RealSet:
    """One file, or some, of one robot.

    Attributes:
        robot: As tables name it.
        arm: Arm name or file; {} is the folder of the data sets.
        columns: Column description.
        files: Rows, as a pattern below the folder of the data sets.
        poses: Rows of other poses to judge by, likewise; empty where there are none.
        published: What others published of these poses, or of the rows where there are no others, mean in mm.
    """

    robot: str
    arm: str
    columns: str
    files: str
    poses: str = ""
    published: float | None = None

    def found(self, data: Path) -> tuple[list[Path], list[Path]]:
        """Files of the rows, and of the other poses.

        Raises:
            InputError: If there are none.
        """
        both = [sorted(data.glob(pattern)) if pattern else [] for pattern in (self.files, self.poses)]
        for pattern, files in zip((self.files, self.poses), both, strict=True):
            if pattern and not files:
                raise InputError(f"no {pattern} in {data}; name the folder of the data sets in PICKENV_DATA")
        return both[0], both[1]

    def load(self, data: Path) -> tuple[Arm, Observations, Observations | None]:
        """The arm, the rows and the other poses.

        Raises:
            InputError: If there are no such files, or they cannot be read.
        """
        arm = load_arm(self.arm.format(data))
        rows, poses = (
            read_observations(files, arm.nominal, self.columns).observations if files else None
            for files in self.found(data)
        )
        assert rows is not None
        return arm, rows, poses


JACOBI, LANDGRAF = "ur5_wam_jacobi2025/{}/*{}*cleaned.csv", "ur10_ipa_landgraf2021/Series_{}/measurements_{}.csv"
GRIDS, POSES = ([JACOBI.format(arm, kind) for arm in ("UR5", "WAM")] for kind in ("grid", "random"))
PLAIN, REPEATS = "ur10_landgraf2021", "ur10_landgraf2021_repeats"

SETS = {
    "ur5": RealSet("UR5", "ur5", "ur5_jacobi2025", GRIDS[0], POSES[0], 0.1549),
    "wam": RealSet("WAM", "wam", "wam_jacobi2025", GRIDS[1], POSES[1], 2.92),
    "ur10_a": RealSet("UR10, series A", "ur10", PLAIN, LANDGRAF.format("A", "grid")),
    "ur10_b": RealSet("UR10, series B", "ur10", REPEATS, LANDGRAF.format("B", "joint_configurations")),
    "ur10_c": RealSet("UR10, series C", "ur10", REPEATS, LANDGRAF.format("C", "random_poses")),
    "ur10_d": RealSet("UR10, series D", "ur10", REPEATS, LANDGRAF.format("D", "iso_cubes")),
    "panda": RealSet(
        "Panda, balls in sockets",
        "{}/mukca_sockets/urdf/panda.urdf#ball_link",
        "mukca_sockets",
        "mukca_sockets/data/panda_1/*/hole_*.csv",
        published=0.347,
    ),
    "positioner": RealSet(
        "two-axis positioner, camera", "positioner", "positioner_rct", "positioner_rct/*.yaml", published=1.74
    ),
}  # type: dict[str, RealSet]
"""Every measured robot, by name."""


def learnable(arm: Arm, rows: Observations, most: int) -> Measurements:
    """Poses or positions for a comparison of models: at most so many, equally spaced, without those that are far off.

    Raises:
        InputError: If something else was measured, from which no residual is learnt and no twin is made.
    """
    if not isinstance(rows, Measurements):
        raise InputError(f"{rows.source} holds {rows.kind}: only of poses and positions a twin is made")
    some = rows.select(equally_spaced(len(rows), most)) if len(rows) > most else rows
    return checked_rows(arm, some, some.select(np.arange(0)), known=some.frames == "known", robust=True)[0]
