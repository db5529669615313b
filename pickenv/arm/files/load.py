"""Arms by name or by file: TOML (`arm_file`) or URDF (`urdf`)."""

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
    """Read an arm by name (a shipped one), or from a path to a TOML or URDF file ("arm.urdf#tip_link").

    Raises:
        InputError: If the arm is unknown, or its file is malformed; the message names the file and the joint or key.
    """
    stem, _, tip = str(name).partition("#")
    if stem.endswith(".urdf"):
        from pickenv.arm.files.urdf import load_urdf

        return load_urdf(stem, tip or None)
    path = file_named("arm", name, ARMS, ".toml, .urdf")
    return _read(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=32)
def _read(path: Path, _modified: int) -> Arm:
    return read_arm(path)
