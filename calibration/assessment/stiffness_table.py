"""Joint stiffnesses as terminal, page, JSON and saved file show them: k = 1/c of the compliance c that was found."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pickenv.calibration.assessment.screen import Block, figure
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.model.arm_model import Conditions
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.terms import ComplianceTerm

TOLD = 2.0
"""A compliance below so many of its standard uncertainties gives no stiffness, only what it is at least."""

NOTE = (
    "from torques; where none are known, as at a target, those of the arm's own weight are taken, which were fitted to "
    "the measured ones and leave of them what the last column says"
)


def stiffness_rows(found: Identification, data: Observations) -> list[dict[str, Any]]:
    """The identified stiffnesses for JSON, joint by joint; N*m/rad and N*m, or N/m and N, 1 sigma beside.

    Args:
        found: The identification.
        data: The rows it was fitted to.
    """
    model, rows = found.arm_model, []
    geometry = model.geometry
    value = dict(zip(model.parameter_names[len(geometry.parameter_names) :], model.coefficients, strict=True))
    spread = dict(zip(found.identifiability.kept_names, np.sqrt(np.diag(found.covariance)), strict=True))
    for term in model.terms:
        if not isinstance(term, ComplianceTerm):
            continue
        measured = data.conditions.torque
        bare = Conditions(payload=data.conditions.payload, temperature=data.conditions.temperature)
        expected = None if measured is None else term.torques(geometry, data.joints, bare)
        for joint, name in zip(term.joints, term.names(geometry), strict=True):
            c, std = float(value[name]), float(spread.get(name, np.inf))
            told = c > TOLD * std
            row = {
                "joint": joint + 1,
                "name": geometry.joint_names[joint],
                "unit": "N/m" if geometry.prismatic[joint] else "N*m/rad",
                "stiffness": 1.0 / c if told else None,
                "stiffness_std": std / c**2 if told else None,
                "at_least": 1.0 / (max(c, 0.0) + TOLD * std),
            }
            if measured is not None and expected is not None:
                row["torque_rms"] = _rms(measured[:, joint])
                row["torque_left_rms"] = _rms(measured[:, joint] - expected[:, joint])
            rows.append(row)
    return rows


def stiffness_block(rows: Sequence[Mapping[str, Any]]) -> Block:
    """The same as a table."""
    header = ("joint", "stiffness", "± 1 sigma", "unit", "torques, RMS", "of these left")
    cells = []
    for row in rows:
        told = row["stiffness"] is not None
        sizes = (figure(row["stiffness"]), figure(row["stiffness_std"])) if told else ("", "")
        least = f", at least {figure(row['at_least'])}" if row["at_least"] else ""
        unit = row["unit"] if told else f"{row['unit']}; not told{least}"
        torques = [figure(row[key]) if key in row else "" for key in ("torque_rms", "torque_left_rms")]
        cells.append((f"{row['joint']} ({row['name']})", *sizes, unit, *torques))
    return Block("Stiffnesses of the joints", header, tuple(cells), NOTE)


def _rms(values: Any) -> float:
    return float(np.sqrt(np.mean(values**2)))
