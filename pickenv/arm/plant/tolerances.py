"""How arms of one design differ: tolerance classes, and draws of any number of different true arms.

Lengths follow ISO 286-1: IT = k (0.45 D^(1/3) + 0.001 D) um up to 500 mm, k (0.004 D + 2.1) um above, with D in mm.
Sizes of effects spread log-normally about the plant's own. Inside everything is m, rad, K, s.
"""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np

from pickenv.arm.effects.effect import Draws, standard_normal_of
from pickenv.arm.kinematics.forward import forward
from pickenv.arm.kinematics.geometry import LINK_PARAMETERS, Array, Geometry
from pickenv.arm.plant.plant import Plant
from pickenv.arm.plant.twin_file import twin_arms
from pickenv.base import InputError, toml_tables

TOLERANCES = Path(__file__).parent / "tolerance_classes"

GRADES = {5: 7, 6: 10, 7: 16, 8: 25, 9: 40, 10: 64, 11: 100, 12: 160, 13: 250, 14: 400, 15: 640, 16: 1000, 17: 1600}
"""Tolerance of each IT grade in units of the standard tolerance factor i (ISO 286-1, table 1)."""

SPARE = 64
"""Number of waves of drives for which random columns are kept, so that later columns stay in their places."""

GRADE = toml_tables.WHOLE.within(min(GRADES), max(GRADES))
LogSize = Annotated[float, toml_tables.NUMBER.not_negative]


@toml_tables.toml_table
class SpreadTable:
    """The table [spread] of a tolerance file: the standard deviation of the logarithm of each size, 0 if left out."""

    joint_stiffness: LogSize = 0.0
    flexural_rigidity: LogSize = 0.0
    transmission_error: LogSize = 0.0
    roller_clearance: LogSize = 0.0
    backlash: LogSize = 0.0
    friction: LogSize = 0.0
    warm_up_time: LogSize = 0.0
    ground_stiffness: LogSize = 0.0
    sinkage: LogSize = 0.0
    frequency: LogSize = 0.0
    damping: LogSize = 0.0


@toml_tables.toml_table
class SizesTable:
    """The table [sizes] of a tolerance file: the sizes of the effects of an arm that has no plant of its own.

    Attributes:
        turning_sag: How far a revolute joint yields under the arm's own weight where its torque is largest, rad.
        sliding_sag: How far a slide yields under the arm's own weight where its force is largest, m.
        turning_gap: Backlash of a revolute joint, rad.
        sliding_gap: Backlash of a slide, m.
        preload_share: Share of a joint's largest torque above which gravity holds its gap closed.
        expansion: Coefficient of linear expansion of the links, 1/K.
        warm_up: Time constant of the warm-up, s.
    """

    turning_sag: Annotated[float, toml_tables.ARCMIN.positive]
    sliding_sag: Annotated[float, toml_tables.UM.positive]
    turning_gap: Annotated[float, toml_tables.ARCMIN.not_negative]
    sliding_gap: Annotated[float, toml_tables.UM.not_negative]
    preload_share: Annotated[float, toml_tables.SHARE]
    expansion: Annotated[float, toml_tables.Unit("um_per_m_K", 1e-6).not_negative]
    warm_up: Annotated[float, toml_tables.HOURS.positive]


@toml_tables.toml_table
class Tolerances:
    """A tolerance class: how far arms of one design may differ; a tolerance file gives it in sections.

    Attributes:
        name: Name of the class.
        it_grade: ISO 286-1 grade of the lengths a and d; the deviation is within plus or minus half the tolerance.
        least_length: Length below which the tolerance shrinks no further, m (a seat has a tolerance even at a = 0).
        angle: Half-width of the assembly angles alpha and theta, rad.
        distribution: ``uniform`` over the tolerance zone, or ``normal`` with the zone's edges at three standard
            deviations.
        spread: The standard deviation of the logarithm of each size (0.1 is about 10 %).
        temperature_rise: Range of the warm arm's temperature rise, K, from which it is drawn evenly.
        sizes: Sizes of the effects of an arm that has no plant of its own, or None.
    """

    name: str
    it_grade: Annotated[int, GRADE, toml_tables.Key(section="lengths")]
    least_length: Annotated[float, toml_tables.MM.positive, toml_tables.Key(section="lengths")]
    angle: Annotated[float, toml_tables.DEG.not_negative, toml_tables.Key("half_width_deg", "angles")]
    distribution: Annotated[Literal["uniform", "normal"], toml_tables.Key(section="lengths")]
    spread: SpreadTable
    temperature_rise: Annotated[
        tuple[float, float], toml_tables.KELVIN, toml_tables.IN_ORDER, toml_tables.Key("rise_K", "temperature")
    ]
    sizes: SizesTable | None = None


def it_tolerance(grade: int, length: Array | float) -> Array:
    """The width of the tolerance zone of ISO 286-1, m, for lengths in m."""
    millimetres = np.abs(np.asarray(length, dtype=float)) * 1e3
    small, large = 0.45 * np.cbrt(millimetres) + 0.001 * millimetres, 0.004 * millimetres + 2.1
    return np.asarray(GRADES[grade] * 1e-6 * np.where(millimetres <= 500.0, small, large))


def shipped_tolerances() -> list[str]:
    """Names of the tolerance classes that come with pickenv."""
    return toml_tables.shipped_in(TOLERANCES)


def load_tolerances(name: str | Path) -> Tolerances:
    """Read a tolerance class by name or from a path to a TOML file.

    Raises:
        InputError: If the class is unknown or a number is impossible; the message names the file and the key.
    """
    return toml_tables.read_toml(Tolerances, toml_tables.file_named("tolerance class", name, TOLERANCES))


def draw_plants(plant: Plant, tolerances: Tolerances, count: int, rng: np.random.Generator) -> Plant:
    """Draw ``count`` different true arms of one design, as one plant whose numbers are arrays.

    Link parameters are drawn about the nominal geometry; the sizes of the effects that are on, about the plant's own.
    Arm i has its own random stream, child i of ``rng``: the arm does not depend on ``count``, nor on which effects are
    on (effects with random numbers of their own take them last, one after the other).

    From a plant that a calibration made, arms are drawn that the calibration's data allow; what the data do not tell is
    drawn about what was found.

    Args:
        plant: The design, or the arm that was calibrated; on single numbers.
        tolerances: How far the design's arms differ; for a calibrated arm, how far what was not identified may lie off.
        count: Number of arms N, at least 1.
        rng: The parent of the arms' streams.

    Returns:
        A plant with link parameters ``(N, n)`` and effect numbers ``(N,)``; `pickenv.arm.plant.plant_batch.plant_at`
        picks one.

    Raises:
        InputError: If ``count`` is below 1 or ``plant`` is already a batch of arms.
    """
    if count < 1:
        raise InputError(f"count is {count}; draw at least one arm")
    if plant.geometry.alpha.ndim != 1:
        raise InputError(f"plant '{plant.name}' is already a batch of arms; draw from a single one")
    if plant.posterior is not None:
        half = half_widths(tolerances, plant.arm.nominal)[plant.posterior.unseen]
        return twin_arms(plant, lambda even: half * _deviation(tolerances, even), rng.spawn(count))
    total = max(columns.stop for columns in random_columns(plant).values())
    return plants_from(plant, tolerances, np.stack([child.random(total) for child in rng.spawn(count)]))


def erring_by(plant: Plant, size: float, joints: Array) -> Plant:
    """An arm whose parts err in the same proportions, and by so much that its tool errs by ``size`` on average.

    Args:
        plant: One true arm; only its geometry counts, and the arm that comes back has no effects.
        size: Mean distance between the true and the nominal tool, m.
        joints: Joints over which the mean is taken ``(..., n)``, rad or m.

    Raises:
        InputError: If the arm's parts have no error that could be made larger or smaller.
    """
    nominal = plant.arm.nominal
    delta, believed = nominal.difference(plant.geometry), forward(nominal, joints).position
    for _ in range(4 if size else 0):  # errors are nearly linear in the deviations
        error = np.linalg.norm(forward(nominal.displaced(delta), joints).position - believed, axis=-1).mean()
        if not error:
            raise InputError(
                f"plant '{plant.name}' has no error of its parts; give one of a class, 'coarse:{plant.arm.name}'"
            )
        delta = delta * (size / error)
    return replace(plant, geometry=nominal.displaced(delta) if size else nominal, effects=())


def plants_from(plant: Plant, tolerances: Tolerances, even: Array) -> Plant:
    """The arms that even random numbers stand for, as one plant whose numbers are arrays.

    Args:
        plant: The design, on single numbers.
        tolerances: How far the design's arms differ.
        even: Numbers from 0 to 1 for each arm ``(N, K)``; `random_columns` says what each column is for.
    """
    columns = {key: even[:, places.start : places.stop] for key, places in random_columns(plant).items()}
    draws = Draws(columns, tolerances.spread, tolerances.temperature_rise)
    effects = tuple(effect.drawn(draws) for effect in plant.effects)
    return replace(plant, geometry=_geometry(plant.arm.nominal, tolerances, columns["geometry"]), effects=effects)


def random_columns(plant: Plant) -> dict[str, range]:
    """Places of each quantity among an arm's even random numbers: fixed ones, whatever effects the plant has."""
    n, drives, waves = plant.arm.nominal.joints, plant.effect("transmission_error"), plant.effect("drive_harmonics")
    terms = len(drives.harmonics) if drives is not None else 0
    count, structure = len(waves.spread) if waves is not None else 0, plant.effect("local_structure")
    sizes = {"geometry": 4 * n, "temperature_rise": 1}
    sizes |= {"joint_stiffness": n, "backlash": n, "friction": 2 * n, "frequency": n, "damping": n}
    sizes |= {"ground_stiffness": 2, "sinkage": 2, "flexural_rigidity": 1, "roller_clearance": 1, "warm_up_time": 1}
    sizes |= {"lead": n, "transmission_error": terms, "phase": terms, "kept free": 2 * max(SPARE - terms, 0)}
    sizes |= {"bearing_stiffness": n, "drive_harmonics": 3 * count, "kept free too": 3 * max(SPARE - count, 0)}
    # Last come those whose number depends on the plant.
    sizes |= {"local_structure": structure.weights if structure is not None else 0}
    sizes |= {f"own {effect.name}": len(effect.own_sizes()) for effect in plant.effects if effect.own_sizes()}
    edges = np.cumsum([0, *sizes.values()]).tolist()
    return {key: range(a, b) for key, a, b in zip(sizes, edges, edges[1:], strict=False)}


def _deviation(tolerances: Tolerances, even: Array) -> Array:
    """Deviations as shares of the half-width of the tolerance zone: from -1 to 1 where the class draws evenly."""
    return 2.0 * even - 1.0 if tolerances.distribution == "uniform" else standard_normal_of(even) / 3.0


def half_widths(tolerances: Tolerances, nominal: Geometry) -> Array:
    """The half-widths of the tolerance zones of a geometry's parameters ``(5n + 12,)``, m and rad.

    Positions of base and tool have the half-width of the least length.
    """
    lengths = np.concatenate([*(getattr(nominal, name) for name in LINK_PARAMETERS), np.zeros(12)])
    zone = it_tolerance(tolerances.it_grade, np.maximum(np.abs(lengths), tolerances.least_length))
    return np.where(nominal.parameter_is_angle, tolerances.angle, zone / 2.0)


def standard_deviations(tolerances: Tolerances, nominal: Geometry) -> Array:
    """The standard deviations of a geometry's parameters ``(5n + 12,)`` over arms of the class, m and rad."""
    return half_widths(tolerances, nominal) / (math.sqrt(3.0) if tolerances.distribution == "uniform" else 3.0)


def _geometry(nominal: Geometry, tolerances: Tolerances, even: Array) -> Geometry:
    n = nominal.joints
    deviation = _deviation(tolerances, even)
    half = dict(zip(LINK_PARAMETERS, half_widths(tolerances, nominal)[: 5 * n].reshape(5, n), strict=True))
    numbers: dict[str, Any] = {name: np.tile(getattr(nominal, name), (len(even), 1)) for name in LINK_PARAMETERS}
    for k, name in enumerate(("alpha", "a", "theta", "d")):
        numbers[name] = numbers[name] + half[name] * deviation[:, k * n : (k + 1) * n]
    return replace(nominal, **numbers)
