"""Arms by name or by file: TOML (`arm_file`), URDF (`urdf`), MJCF (`mjcf`) or a UR controller's YAML (`ur_yaml`)."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

from pickenv.arm.files.arm import Arm
from pickenv.arm.files.arm_file import ARMS, read_arm
from pickenv.toml_tables import file_named, shipped_in


def shipped_arms() -> list[str]:
    """Names of the arms that come with pickenv."""
    return shipped_in(ARMS)


def load_arm(name: str | Path) -> Arm:
    """Read an arm by name (a shipped one), or from a path to a TOML, URDF, MJCF or UR kinematics file.

    Args:
        name: "ur5", "arm.toml", "arm.urdf#tip_link", "arm.xml#body_or_site", or "default_kinematics.yaml" as
            `ur_description` has it. Without a tip the arm ends at its flange; its source then says at which link.

    Raises:
        InputError: If the arm is unknown, or its file is malformed; the message names the file and the joint or key.
    """
    stem, _, tip = str(name).partition("#")
    match Path(stem).suffix:
        case ".urdf":
            from pickenv.arm.files.urdf import load_urdf

            return load_urdf(stem, tip or None)
        case ".xml":
            from pickenv.arm.files.mjcf import load_mjcf

            return load_mjcf(stem, tip or None)
        case ".yaml" | ".yml":
            from pickenv.arm.files.ur_yaml import load_ur_yaml

            return load_ur_yaml(stem)
    path = file_named("arm", name, ARMS, ".toml, .urdf, .xml, .yaml")
    return _read(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=32)
def _read(path: Path, _modified: int) -> Arm:
    return read_arm(path)
