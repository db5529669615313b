"""The drives' harmonics as terminal, page, JSON and saved file show them: orders and amplitudes with uncertainties."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pickenv.calibration.assessment.screen import Block
from pickenv.calibration.identification.harmonics import harmonics_of
from pickenv.calibration.identification.least_squares import Identification

OWN = (
    "they belong to this unit and this session: another robot of the same model, or this one after a repair or in "
    "another set-up, needs its own"
)
"""What a reader must know of them: on a measured arm those of one session made another session worse."""


def harmonic_rows(found: Identification) -> list[dict[str, Any]]:
    """The identified harmonics for JSON, the largest first; amplitudes in degrees or mm, 1 sigma beside."""
    geometry, rows = found.geometry, []
    for item in harmonics_of(found):
        unit, scale = ("mm", 1e3) if geometry.prismatic[item.joint] else ("deg", float(np.degrees(1.0)))
        rows.append(
            {
                "joint": item.joint + 1,
                "name": geometry.joint_names[item.joint],
                "order": item.order,
                "order_std": item.order_std,
                "unit": unit,
                "amplitude": item.amplitude * scale,
                "amplitude_std": item.amplitude_std * scale,
            }
        )
    return rows


def harmonic_block(rows: Sequence[Mapping[str, Any]]) -> Block:
    """The same as a table."""
    header = ("joint", "order (cycles per turn)", "± 1 sigma", "amplitude", "± 1 sigma", "unit")
    cells = []
    for row in rows:
        order_std = "given" if row["order_std"] is None else f"{row['order_std']:.2f}"
        sizes = (f"{row['amplitude']:.5f}", f"{row['amplitude_std']:.5f}")
        cells.append((f"{row['joint']} ({row['name']})", f"{row['order']:.2f}", order_std, *sizes, str(row["unit"])))
    return Block("Harmonics of the drives", header, tuple(cells), OWN)
