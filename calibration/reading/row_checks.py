"""What no row of a measurement file may be: implausible, a lost target, a repetition; each named by file and line."""

from __future__ import annotations

import numpy as np

from pickenv.arm import Geometry
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.origins import Origins
from pickenv.calibration.reading.csv_table import Table
from pickenv.calibration.reading.description import ColumnDescription
from pickenv.errors import InputError
from pickenv.limits import LIMITS, check_limit
from pickenv.toml_tables import TO_SI

QUANTITIES = {"temperature": "temperature_K", "payload": "payload_kg", "torque": "torque_Nm"}
"""What each recorded condition is, of `pickenv.limits`; a temperature is counted from its reference."""

FARTHEST = 1e4
"""No instrument sees a tool from farther away than this, m."""


def refuse_repeated_joints(given: list[ColumnDescription], joints: Array, geometry: Geometry) -> None:
    """Two joints that read the same number in every row are one column read twice."""
    for i in range(geometry.joints):
        for j in range(i):
            if len(joints) > 2 and np.ptp(joints[:, i]) > 0 and np.array_equal(joints[:, i], joints[:, j]):
                names = [f"joint {k + 1} ({geometry.joint_names[k]}, column '{given[0].joints[k]}')" for k in (j, i)]
                raise InputError(
                    f"{given[0].where}: {names[0]} and {names[1]} hold the same number in every row; name each "
                    "joint's own column"
                )


def refuse_far(table: Table, description: ColumnDescription) -> None:
    """A coordinate beyond `FARTHEST` is no measurement of a tool."""
    values = table.values(description.position)
    far = np.argwhere(np.abs(values) * TO_SI[description.position_unit] > FARTHEST)
    if len(far):
        row, column = far[0]
        raise InputError(
            f"{table.where}: row {table.lines[row]}, column '{description.position[column]}' is "
            f"{values[row, column]:.6g} {description.position_unit}, farther than any instrument sees; correct or "
            "remove the row"
        )


def refuse_origin(table: Table, description: ColumnDescription) -> None:
    """A position of exactly 0, 0, 0 is what trackers write when they have lost the reflector."""
    zero = (table.values(description.position) == 0).all(axis=1)
    if zero.any() and not zero.all():
        raise InputError(
            f"{table.where}: row {table.lines[int(np.argmax(zero))]} holds the position 0, 0, 0, which usually means "
            f"that the tracker lost the reflector ({int(zero.sum())} such rows); remove them"
        )


def refuse_duplicates(joints: Array, found: Observations, origins: Origins) -> None:
    """Refuse rows that repeat another to the last digit: they count twice, and leak into what is held out."""
    whole = np.concatenate([joints, found.readings()], axis=1)
    _, first, inverse, count = np.unique(whole, axis=0, return_index=True, return_inverse=True, return_counts=True)
    again = np.setdiff1d(np.arange(len(whole)), first)
    if len(again):
        row = int(again[0])
        where, line = origins.place(int(first[inverse.ravel()[row]]))
        here, this = origins.place(row)
        raise InputError(
            f"{here}: row {this} repeats row {line}{'' if where == here else f' of {where}'} to the last digit "
            f"({int((count - 1).sum())} repeated rows in all); remove them, they would count twice"
        )


def refuse_implausible_joints(table: Table, geometry: Geometry, i: int, values: Array, column: str, unit: str) -> None:
    """Refuse joints that no such arm can take: almost always degrees read as radians, or millimetres as metres."""
    span = geometry.upper[i] - geometry.lower[i]
    room = span if geometry.prismatic[i] else max(span, 2 * np.pi)
    outside = (values < geometry.lower[i] - room) | (values > geometry.upper[i] + room)
    if outside.any():
        row = int(np.argmax(outside))
        other = {"rad": "deg", "deg": "rad", "m": "mm", "mm": "m"}[unit]
        limits = f"{geometry.lower[i] / TO_SI[unit]:.4g} to {geometry.upper[i] / TO_SI[unit]:.4g} {unit}"
        mixed = f" ({int(outside.sum())} of {len(values)} rows are so)" if not outside.all() else ""
        raise InputError(
            f"{table.where}: row {table.lines[row]}, column '{column}' is {values[row] / TO_SI[unit]:.6g} {unit}, "
            f"but joint {i + 1} ({geometry.joint_names[i]}) moves over {limits}; its unit is probably {other}{mixed}"
        )


def refuse_implausible_conditions(table: Table, name: str, values: Array, columns: tuple[str, ...]) -> None:
    """Refuse temperatures from the reference, payloads and torques ``(N, k)``, SI, that no arm works under."""
    least, most, _ = LIMITS[QUANTITIES[name]]
    rows, places = np.nonzero((values < least) | (values > most))
    if len(rows):
        where = f"{table.where}: row {table.lines[rows[0]]}, column '{columns[places[0]]}' as {QUANTITIES[name]}"
        check_limit(where, float(values[rows[0], places[0]]), QUANTITIES[name])
