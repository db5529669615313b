"""What every file that holds a corrected arm says of where it comes from, and of what it does not hold."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from pickenv.calibration.pipeline.calibration import Calibration


@dataclass(frozen=True, eq=False)
class Document:
    """A file to be written.

    Attributes:
        data: Its bytes.
        notes: What it holds of a calibration, and what it does not, a sentence each.
    """

    data: bytes
    notes: tuple[str, ...] = ()


def provenance(calibration: Calibration) -> tuple[str, ...]:
    """Where a corrected arm comes from, one fact per line."""
    record = calibration.record
    lines = [
        f"Arm '{calibration.arm_name}' as calibrated by pickenv; do not edit, calibrate again.",
        f"nominal geometry: fingerprint {calibration.arm_fingerprint}",
        f"data: {record.get('source', 'unknown')}, {record.get('poses', '?')} poses ({record.get('kind', '?')}), "
        f"fingerprint {record.get('data_fingerprint', 'unknown')}",
        f"identified parameters: {record.get('rank', '?')}; redundant ones keep their nominal values: "
        + (", ".join(record.get("dropped", {})) or "none"),
    ]
    versions: Mapping[str, Any] = record.get("versions", {})
    if versions:
        lines.append("versions: " + ", ".join(f"{name} {value}" for name, value in versions.items()))
    left = left_out(calibration)
    if left:
        lines.append(f"not in this file, because no geometry can hold it: {', '.join(left)}")
    return tuple(lines)


def left_out(calibration: Calibration) -> list[str]:
    """What a calibration knows beside its geometry, which files of rigid links cannot hold."""
    found = [type(term).__name__ for term in calibration.model.terms]
    if calibration.learnt is not None:
        found.append(f"learnt residual '{calibration.learnt.kind}'")
    return found
