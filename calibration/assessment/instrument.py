"""What a verdict says of the instruments: numbers of theirs that the rows contradict, and lengths that nobody measured.

A wire whose zero is off by millimetres leaves small misses all the same, for anchor and links take it up; the arm is
then wrong where nobody looks. So what is said to be known is tried as an unknown once the arm is fitted.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from pickenv.calibration.assessment.screen import Block, figure
from pickenv.calibration.identification.alignment import apart
from pickenv.calibration.identification.least_squares import Identification, identify
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.error_model import ErrorModel
from pickenv.calibration.model.kinds.distances import DistanceObservations
from pickenv.calibration.model.observations import Observations, origins_of
from pickenv.calibration.model.pixels import PixelObservations, with_lens
from pickenv.calibration.model.stacked import OWN, InstrumentStation, Stacked

CONTRADICTED = 5.0
"""A number that lies so many standard deviations from what is said of it is wrong, or something else is."""

MATTERS = 0.03
"""It matters where the rows are missed by so much less without it."""

LENS_MATTERS = 0.2
"""A lens has nine numbers, which take up some of anything; it is in doubt where pixels are missed by so much less."""


def with_zeros_fitted(data: Observations) -> Iterator[tuple[str, DistanceObservations, Observations]]:
    """Each wire's zero that is said to be known: its name as an unknown, the wire, and the data with it unknown."""
    if isinstance(data, DistanceObservations):
        if data.zero_std == 0.0 and data.surface != "plane" and np.ptp(data.length) > 0.0 and data.scale_std == 0.0:
            yield "zero", data, replace(data, zero_std=np.inf)
    elif isinstance(data, Stacked):
        for i, station in enumerate(data.stations):
            for name, part, other in with_zeros_fitted(station.data):
                stations = (*data.stations[:i], replace(station, data=other), *data.stations[i + 1 :])
                yield name + station.suffix, part, replace(data, stations=stations)


def said_of_instruments(
    model: ErrorModel, found: Identification, data: Observations
) -> Iterator[tuple[Literal["fail", "caution"], str]]:
    """What a reader must know of them, by weight.

    Args:
        model: What was identified, without further terms.
        found: The identification.
        data: What it was made from.
    """
    for name, wire, other in with_zeros_fitted(data):
        freed = identify(model, found.arm_model, [other])
        kept = freed.identifiability.kept_names
        if name not in kept:
            continue
        value, std = freed.unknowns[name], float(np.sqrt(freed.covariance[kept.index(name), kept.index(name)]))
        less = 1.0 - np.sqrt(freed.chi_square / max(found.chi_square, 1e-300))
        if abs(value - wire.zero) > CONTRADICTED * std and less > MATTERS:
            yield (
                "fail",
                f"{wire.source}: the wire's zero is taken as {wire.zero * 1e3:.4g} mm, but the rows say "
                f"{value * 1e3:.4g} ± {std * 1e3:.2g} mm, and the links have taken up the difference; say zero = "
                '"fitted" in [wire]',
            )
    if isinstance(data, PixelObservations) and not data.lens_std.any():
        other = with_lens(data, "free")
        freed = identify(model, found.arm_model, [other])
        given, fitted = (
            np.sqrt(np.mean(views.pixel_errors(fit.arm_model, np.array(list(fit.unknowns.values()))) ** 2))
            for views, fit in ((data, found), (other, freed))
        )
        if freed.converged and fitted < (1.0 - LENS_MATTERS) * given:
            yield (
                "caution",
                f"the lens as given leaves {given:.3g} px per coordinate, a fitted one {fitted:.3g} px: give "
                "--lens free, or calibrate the camera anew",
            )
    if data.miss_unit == "deg":
        yield (
            "caution",
            "directions tell no length: all lengths of the arm are nominal; add an instrument that sees some",
        )
    elif not data.sized:
        yield (
            "caution",
            "no known length takes part, so the arm's size is that of its nominal longest link; add a known spacing, "
            "radius or length, or another instrument",
        )


def set_ups_of(found: Identification, data: Observations) -> list[dict[str, Any]]:
    """Each set-up of several files: number, files, rows, and its own frames with how far from the first's, mm and deg.

    Args:
        found: The identification.
        data: What it was made from.
    """
    rows: list[dict[str, Any]] = []
    for station in data.stations if isinstance(data, Stacked) else (InstrumentStation(data),):
        unknowns = np.array([found.unknowns[name] for name in station.unknowns()])
        there = station.seen(found.arm_model, station.parted(unknowns)[1]).geometry
        moved = {name: apart(getattr(found.geometry, name), getattr(there, name)) for name in station.frames}
        origins = origins_of(station.data)
        row: dict[str, Any] = {
            "number": station.number,
            "files": [origins.files[i] for i in np.unique(origins.file).tolist()],
            "rows": len(station.data.joints),
            "own": {name: {"mm": m * 1e3, "deg": float(np.degrees(angle))} for name, (m, angle) in moved.items()},
        }
        rows.append(row)
    return rows if sum(len(row["files"]) for row in rows) > 1 else []


def set_up_block(set_ups: Sequence[Mapping[str, Any]], asked: str | None) -> Block:
    """The set-ups for screens.

    Args:
        set_ups: What `set_ups_of` says.
        asked: What each file was said to have of its own; None where the rows told it.
    """
    rows = []
    for each in set_ups:
        own = {name: f"{figure(moved['mm'])} mm, {figure(moved['deg'])} deg" for name, moved in each["own"].items()}
        cells = [own.get(name, "") for name in OWN]
        rows.append((str(each["number"]), ", ".join(each["files"]), str(each["rows"]), *cells))
    note = "as the rows tell" if asked is None else f"as asked by --stations {asked}"
    heads = ("set-up", "files", "rows fitted", "its own base, away by", "its own tool, away by")
    return Block("Set-ups", heads, tuple(rows), f"{note}; base2_x and the like are parameters of set-up 2")


def said_of_conditions(model: ArmModel, learnt: bool, data: Observations) -> Iterator[tuple[Literal["note"], str]]:
    """A note on payloads, temperatures and torques that were recorded and change nothing that the model predicts.

    Args:
        model: The calibrated arm.
        learnt: Whether a learnt residual takes payload and temperature.
        data: Rows that it was fitted to.
    """
    known = {name: values for name, values in vars(data.conditions).items() if values is not None and len(values)}
    before = model.pose(data.joints, data.conditions) if known else None
    unused = [
        name
        for name, values in known.items()
        if not (learnt and name != "torque")
        and before is not None
        and np.array_equal(
            model.pose(data.joints, replace(data.conditions, **{name: values + 1.0})).position, before.position
        )
    ]
    if unused:
        yield "note", f"nothing that was fitted depends on what was recorded of {' and '.join(unused)} (see --terms)"
