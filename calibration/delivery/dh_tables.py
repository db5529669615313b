"""The corrected parameters as a plain table: modified and standard DH, before, after, change, standard deviation.

Modified (Craig): Rot(x, alpha) Trans(x, a) Rot(y, beta) Rot(z, theta) Trans(z, d), row i leads from link i - 1 to i.
Standard (Denavit, Hartenberg): Rot(z, theta) Trans(z, d) Trans(x, a) Rot(x, alpha) Rot(y, beta): the same factors,
grouped anew, so alpha, a and beta stand a row earlier; what comes before the first and after the last is the table's
row 0 and, in the last row, what the tool holds of it (zero here). Hayati's beta is zero where no axes are parallel.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm import Geometry, rotation_vector
from pickenv.arm.kinematics.geometry import FRAME_PARAMETERS, LINK_PARAMETERS
from pickenv.calibration.delivery.offset_files import table_bytes
from pickenv.calibration.delivery.origin_lines import Document, left_out, provenance
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.pipeline.uncertainty import uncertainty_from

TABLE_FORMAT = "pickenv DH parameters 1"
BEHIND = ("alpha", "a", "beta")
"""Parameters that standard tables have a row earlier."""


def dh_table(calibration: Calibration, out: Path) -> Document:
    """The table as CSV, or as JSON where ``out`` ends so; angles in degrees, lengths in mm.

    Standard deviations are empty where a parameter kept its nominal value.
    """
    rows = _rows(calibration)
    notes = [
        "parameters without a standard deviation were not identified and keep their nominal values; others absorb them",
    ]
    left = left_out(calibration)
    if left:
        notes.append(f"not in the table, because no geometry can hold it: {', '.join(left)}")
    return Document(table_bytes(rows, out, TABLE_FORMAT, (*provenance(calibration), *notes)), tuple(notes))


def _rows(calibration: Calibration) -> list[dict[str, Any]]:
    nominal, found = calibration.nominal, calibration.identified
    sure = uncertainty_from(calibration.record)
    known = {} if sure is None else dict(zip(sure.names, np.sqrt(np.diag(sure.covariance)), strict=True))

    def row(table: str, number: int, label: str, name: str, values: tuple[float, float], angle: bool) -> dict[str, Any]:
        scale = float(np.degrees(1.0)) if angle else 1e3
        before, after = (float(value * scale) for value in values)
        return {
            "table": table,
            "row": number,
            "joint": label,
            "parameter": name.rstrip("0123456789"),
            "unit": "deg" if angle else "mm",
            "nominal": before,
            "corrected": after,
            "change": after - before,
            "standard_deviation": float(known[name] * scale) if name in known else None,
        }

    rows = []
    for table in ("modified", "standard"):
        for i in range(found.links):
            for kind in LINK_PARAMETERS:
                early = kind in BEHIND
                place = i if table == "modified" or not early else i + 1
                name = f"{kind}{place if early else i + 1}"
                values = [float(getattr(g, kind)[place]) if place < found.links else 0.0 for g in (nominal, found)]
                angle = kind not in ("a", "d")
                rows.append(row(table, i + 1, found.link_names[i], name, (values[0], values[1]), angle))
        if table == "standard":
            for kind in BEHIND:
                values = [float(getattr(g, kind)[0]) for g in (nominal, found)]
                rows.append(row(table, 0, "base", f"{kind}0", (values[0], values[1]), kind != "a"))
    for frame in ("base", "tool"):
        for i, axis in enumerate(FRAME_PARAMETERS):
            values = [_frame(g, frame)[i] for g in (nominal, found)]
            rows.append(row(frame, 0, frame, f"{frame}_{axis}", (values[0], values[1]), i > 2))
    return rows


def _frame(geometry: Geometry, which: str) -> list[float]:
    """Position and rotation vector of base or tool, m and rad (6,)."""
    pose = getattr(geometry, which)
    return [*pose.position.tolist(), *rotation_vector(pose.rotation).tolist()]
