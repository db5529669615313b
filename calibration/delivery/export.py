"""Handing a calibration over: one function, one kind of file each.

What a file cannot hold of a calibration is told with it (`Delivery.notes`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from pickenv.arm import Arm, load_arm, shipped_arms
from pickenv.calibration.delivery.arm_mjcf import export_mjcf
from pickenv.calibration.delivery.arm_toml import write_arm_toml
from pickenv.calibration.delivery.arm_urdf import write_arm_urdf
from pickenv.calibration.delivery.dh_tables import dh_table
from pickenv.calibration.delivery.joint_offsets import joint_offsets
from pickenv.calibration.delivery.lerobot_file import onto_lerobot
from pickenv.calibration.delivery.offset_files import offset_table, ros2_offsets
from pickenv.calibration.delivery.onnx_network import write_onnx
from pickenv.calibration.delivery.onto_kinematics_yaml import onto_kinematics_yaml, ur_kinematics_yaml
from pickenv.calibration.delivery.onto_mjcf import onto_mjcf
from pickenv.calibration.delivery.onto_urdf import onto_urdf, urdf_correction
from pickenv.calibration.delivery.origin_lines import Document, left_out
from pickenv.calibration.delivery.static_transforms import static_transforms
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.errors import InputError
from pickenv.files import write_whole

KINDS = (
    *("toml", "urdf", "mjcf", "onnx", "kinematics-yaml", "table"),
    *("offsets", "ros2-control", "lerobot", "transforms"),
)
"""What a calibration is handed over as."""

BY_ENDING = {".toml": "toml", ".urdf": "urdf", ".xml": "mjcf", ".onnx": "onnx"}
"""Kinds that a new file's name tells."""

BY_OWN_ENDING = {
    ".urdf": "urdf",
    ".xml": "mjcf",
    ".yaml": "kinematics-yaml",
    ".yml": "kinematics-yaml",
    ".json": "lerobot",
}
"""Kinds that the name of the robot's own file tells."""


@dataclass(frozen=True)
class Delivery:
    """A file handed over.

    Attributes:
        path: The file.
        notes: What it holds of the calibration, and what it does not, a sentence each.
        beside: Files written with it.
    """

    path: Path
    notes: tuple[str, ...]
    beside: tuple[Path, ...] = ()


def export(
    calibration: Calibration,
    out: str | Path,
    *,
    kind: str | None = None,
    onto: str | Path | None = None,
    arm: Arm | None = None,
    counts_per_turn: int | None = None,
    sample: int = 0,
    seed: int = 0,
) -> Delivery:
    """Write a calibration as a robot, a controller, a simulator or another program reads it.

    Args:
        calibration: The calibration.
        out: The file to write.
        kind: One of `KINDS`; told by the name of ``onto`` or ``out`` where left out.
        onto: The robot's own file (URDF, kinematics YAML, LeRobot's JSON, a description with ros2_control), in which
            only what the calibration corrects is changed; of "robot.urdf#link" the link is the tip.
        arm: The arm, whose speeds a new arm file or URDF tells; found by its name where it is a shipped one.
        counts_per_turn: Encoder counts per turn, for tables of offsets.
        sample: Arms that the data allow, written beside a new MJCF (see `export_mjcf`).
        seed: Of the sample.

    Raises:
        InputError: If the kind is unknown, cannot hold the calibration, or the robot's own file is another arm's.
    """
    out = Path(out)
    own, tip = _own_file(onto)
    if own is not None and own.exists() and not own.is_file():
        raise InputError(f"{own} is no file on a disk; give --onto the robot's own file")
    chosen = kind or _kind(own, out)
    if chosen not in KINDS:
        raise InputError(f"there is no kind '{chosen}' of file; give one of {', '.join(KINDS)}")
    if counts_per_turn is not None and (chosen != "offsets" or counts_per_turn < 1):
        raise InputError("counts per turn are a whole number above zero and belong to --as offsets")
    if own is not None and chosen in ("toml", "onnx", "table", "offsets"):
        raise InputError(f"a file of kind '{chosen}' is written anew; leave --onto out, or give another --as")
    if sample and (chosen != "mjcf" or own is not None):
        raise InputError("--sample goes with a new MJCF; leave it and --onto out, or give --as mjcf")
    if own is None and chosen == "lerobot":
        raise InputError(
            "a LeRobot file keeps ids and ranges of your motors; give --onto the one that lerobot-calibrate wrote"
        )
    if chosen == "mjcf" and own is None:
        first, *others = export_mjcf(calibration, _arm(calibration, arm), out, sample=sample, seed=seed)
        return _delivered(calibration, first, _new_file_notes(calibration, chosen), tuple(others))
    if chosen in ("toml", "onnx") or (chosen == "urdf" and own is None):
        writers: dict[str, Callable[[], Path]] = {
            "toml": lambda: write_arm_toml(calibration, _arm(calibration, arm), out),
            "urdf": lambda: write_arm_urdf(calibration, _arm(calibration, arm), out),
            "onnx": lambda: write_onnx(calibration, out),
        }
        return _delivered(calibration, writers[chosen](), _new_file_notes(calibration, chosen))
    makers: dict[str, Callable[[], Document]] = {
        "urdf": lambda: onto_urdf(calibration, Path(str(own)), tip, out),
        "mjcf": lambda: onto_mjcf(calibration, Path(str(own)), tip, out),
        "kinematics-yaml": lambda: (
            ur_kinematics_yaml(calibration) if own is None else onto_kinematics_yaml(calibration, own)
        ),
        "table": lambda: dh_table(calibration, out),
        "offsets": lambda: offset_table(calibration, joint_offsets(calibration), out, counts_per_turn),
        "ros2-control": lambda: ros2_offsets(calibration, joint_offsets(calibration), own),
        "lerobot": lambda: onto_lerobot(joint_offsets(calibration), Path(str(own))),
        "transforms": lambda: _transforms(calibration, own, tip),
    }
    document = makers[chosen]()
    path = write_whole(out, lambda temporary: temporary.write_bytes(document.data))
    return _delivered(calibration, path, document.notes)


def _delivered(calibration: Calibration, path: Path, notes: Sequence[str], beside: tuple[Path, ...] = ()) -> Delivery:
    """What was written, with what the calibration's rows do not tell."""
    caution = calibration.caution
    return Delivery(path, (*(() if caution is None else (f"caution: {caution}",)), *notes), beside)


def _own_file(onto: str | Path | None) -> tuple[Path | None, str | None]:
    """The robot's own file and the link named behind it."""
    if onto is None:
        return None, None
    path, mark, tip = str(onto).rpartition("#")
    return (Path(path), tip or None) if mark and path else (Path(onto), None)


def _kind(own: Path | None, out: Path) -> str:
    endings, path = (BY_ENDING, out) if own is None else (BY_OWN_ENDING, own)
    if path.suffix == ".xacro":
        raise InputError(
            f"{path} is a xacro, which takes its numbers from elsewhere; give --onto its kinematics YAML, or the URDF "
            "that xacro makes of it"
        )
    found = endings.get(path.suffix.lower())
    if found is None:
        raise InputError(f"the name {path} does not tell what to write; give --as one of {', '.join(KINDS)}")
    return found


def _arm(calibration: Calibration, arm: Arm | None) -> Arm:
    """The arm, whose joint speeds no calibration holds."""
    if arm is None and calibration.arm_name in shipped_arms():
        shipped = load_arm(calibration.arm_name)
        arm = shipped if shipped.fingerprint() == calibration.arm_fingerprint else None
    if arm is None:
        raise InputError(f"a new arm file tells joint speeds too; give --arm the file of '{calibration.arm_name}'")
    calibration.refuse_another(arm)
    return arm


def _transforms(calibration: Calibration, own: Path | None, tip: str | None) -> Document:
    if own is None:
        return static_transforms(calibration)
    if own.suffix.lower() != ".urdf":
        raise InputError(f"{own} has no named frames; give --onto the robot's URDF, or leave it out")
    return static_transforms(calibration, *urdf_correction(calibration, own, tip))


def _new_file_notes(calibration: Calibration, kind: str) -> tuple[str, ...]:
    if kind == "onnx":
        return ()
    notes = []
    left = left_out(calibration)
    if left:
        notes.append(f"not in the file, because no geometry can hold it: {', '.join(left)}")
    if kind in ("urdf", "mjcf"):
        notes.append(
            "a skeleton without meshes or true masses, from the robot's base; --onto patches a robot's own file"
        )
    return tuple(notes)
