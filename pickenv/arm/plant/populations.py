"""Populations of arms: random draws of true arms, by a tolerance class or from a calibration's posterior (twins).

A tolerance class says how widely arms of one design differ. Lengths follow ISO 286-1: IT = k (0.45 D^(1/3) + 0.001 D)
um up to 500 mm, k (0.004 D + 2.1) um above, with D in mm and k from `GRADES`. Sizes of effects are log-normal about the
plant's own sizes.

A twin is the identified arm as a plant, in a file (.npz with a checksum). The identified base and tool are transformed
from the instrument's frame into the arm's own frame. The base B becomes B_own B_aligned^-1 B, and the tool T becomes
T T_aligned^-1 T_own. B_own and T_own are the nominal arm's, B_aligned and T_aligned the same in the instrument's frame.
The arm's errors relative to its nominal geometry then equal the errors that were measured relative to the aligned
nominal geometry. Objects have m, rad, K, s.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.effects.drives import GravityYield, MeasurementNoise
from pickenv.arm.effects.effect import Draws, Effect, standard_normal_of
from pickenv.arm.effects.residual_field import Features, ResidualField
from pickenv.arm.effects.structure import Harmonic, TransmissionError
from pickenv.arm.files.arm import Arm, finite, geometry_arrays, geometry_from_arrays
from pickenv.arm.kinematics.forward import forward
from pickenv.arm.kinematics.geometry import LINK_PARAMETERS, Array, Geometry, Pose, behind, inverse_pose
from pickenv.arm.plant.plant import Layout, Plant, Posterior
from pickenv.base import InputError, read_container, refusing_damage, toml_tables, write_container
from pickenv.base.container import named_part, part_of

TOLERANCES = Path(__file__).parent / "tolerance_classes"

GRADES = {5: 7, 6: 10, 7: 16, 8: 25, 9: 40, 10: 64, 11: 100, 12: 160, 13: 250, 14: 400, 15: 640, 16: 1000, 17: 1600}
"""Tolerance of each IT grade in units of the standard tolerance factor i (ISO 286-1, table 1)."""

SPARE = 64
"""Number of periodic drive errors for which columns of random numbers are reserved. The columns after them thus keep
their places if a plant gets more periodic errors."""

GRADE = toml_tables.WHOLE.within(min(GRADES), max(GRADES))
LogSize = Annotated[float, toml_tables.NUMBER.not_negative]


@toml_tables.toml_table
class SpreadTable:
    """The table [spread] of a tolerance file: the standard deviation of the logarithm of each size, 0 by default."""

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
    """The table [sizes] of a tolerance file: the sizes of the effects for an arm that has no plant file.

    Attributes:
        turning_sag: Deflection of a revolute joint under the arm's own weight in the pose of its largest torque, rad.
        sliding_sag: Deflection of a slide under the arm's own weight in the pose of its largest force, m.
        turning_gap: Backlash of a revolute joint, rad.
        sliding_gap: Backlash of a slide, m.
        preload_share: Gravity torque above which a joint always rests on the same side of its backlash. It is a share
            of the joint's largest gravity torque.
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
    """A tolerance class: how widely arms of one design differ. It is read from a tolerance file.

    Attributes:
        name: Name of the class.
        it_grade: ISO 286-1 grade of the lengths a and d. Deviations are within plus or minus half the tolerance.
        least_length: Shortest length with a tolerance of its own, m. Shorter lengths have the tolerance of this length,
            because even at a = 0 a part's seat has a tolerance.
        angle: Half-width of the tolerance zone of the assembly angles alpha and theta, rad.
        distribution: ``uniform`` over the tolerance zone, or ``normal`` with the zone's edges at three standard
            deviations.
        spread: Standard deviation of the logarithm of each size (0.1 is about 10 %).
        temperature_rise: Range of the warm arm's temperature rise, K; draws are uniform in it.
        sizes: Sizes of the effects for an arm that has no plant file, or None.
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
    """Return the width of the tolerance zone of ISO 286-1, m, for an IT grade (5 to 17) and lengths in m."""
    millimetres = np.abs(np.asarray(length, dtype=float)) * 1e3
    small, large = 0.45 * np.cbrt(millimetres) + 0.001 * millimetres, 0.004 * millimetres + 2.1
    return np.asarray(GRADES[grade] * 1e-6 * np.where(millimetres <= 500.0, small, large))


def shipped_tolerances() -> list[str]:
    """Return the names of the tolerance classes that come with pickenv."""
    return toml_tables.shipped_in(TOLERANCES)


def load_tolerances(name: str | Path) -> Tolerances:
    """Read a tolerance class by its name, or from a TOML file by its path.

    Raises:
        InputError: If the class is unknown or a number is outside its limits; the message names the file and the key.
    """
    return toml_tables.read_toml(Tolerances, toml_tables.file_named("tolerance class", name, TOLERANCES))


def draw_plants(plant: Plant, tolerances: Tolerances, count: int, rng: np.random.Generator) -> Plant:
    """Draw ``count`` different true arms of one design, as one plant whose numbers are arrays.

    Link parameters are drawn about the nominal geometry, effect sizes about the sizes in ``plant``. Arm i has its own
    random stream, child i (from 0) of ``rng``. The arm therefore does not depend on ``count``. The arm's random numbers
    are the same whatever effects are on. For this, effects with random numbers of their own take them at the end of the
    stream.

    If the plant was made from a calibration, the arms are drawn from the calibration's posterior distribution. The
    parameters that the calibration's data do not identify are drawn within their tolerances about the identified
    values.

    Args:
        plant: The design (a simulated true arm), or the twin of a calibrated arm; a single arm.
        tolerances: The tolerance class of the design's arms. For a calibrated arm it only applies to the parameters
            that were not identified.
        count: Number of arms N, at least 1.
        rng: Parent of the arms' random streams.

    Returns:
        A plant with link parameters ``(N, n)`` and effect numbers ``(N,)``; `pickenv.arm.plant.plant.plant_at`
        selects one arm.

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
    """Return the arm with its geometric errors scaled by one factor, so that its mean tool position error is ``size``.

    Args:
        plant: The true arm, a single one. Only its geometry is used; the returned plant has no effects.
        size: Mean distance between the tool's true and nominal position, m.
        joints: Joints over which the mean is taken ``(..., n)``, rad or m.

    Raises:
        InputError: If the true geometry is the nominal one, so that there is no error to scale.
    """
    nominal = plant.arm.nominal
    delta, ideal = nominal.difference(plant.geometry), forward(nominal, joints).position
    for _ in range(4 if size else 0):  # errors are nearly linear in the deviations
        error = np.linalg.norm(forward(nominal.displaced(delta), joints).position - ideal, axis=-1).mean()
        if not error:
            raise InputError(
                f"plant '{plant.name}' has no error of its parts; give one of a class, 'coarse:{plant.arm.name}'"
            )
        delta = delta * (size / error)
    return replace(plant, geometry=nominal.displaced(delta) if size else nominal, effects=())


def plants_from(plant: Plant, tolerances: Tolerances, even: Array) -> Plant:
    """Compute true arms from uniform random numbers, as one plant whose numbers are arrays.

    Args:
        plant: The design, a single arm.
        tolerances: The tolerance class of the design's arms.
        even: Uniform random numbers from 0 to 1 ``(N, K)``, one row per arm. `random_columns` says which of the K
            columns determine which quantity.
    """
    columns = {key: even[:, places.start : places.stop] for key, places in random_columns(plant).items()}
    draws = Draws(columns, tolerances.spread, tolerances.temperature_rise)
    effects = tuple(effect.drawn(draws) for effect in plant.effects)
    return replace(plant, geometry=_geometry(plant.arm.nominal, tolerances, columns["geometry"]), effects=effects)


def random_columns(plant: Plant) -> dict[str, range]:
    """Return which columns of the random numbers of `plants_from` determine which quantity: columns, from 0, by name.

    Most quantities have the same columns whatever effects the plant has. Quantities whose number of columns depends on
    the effects have the last columns.
    """
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
    """Return deviations as shares of the half-width of the tolerance zone, from uniform random numbers 0 to 1.

    Deviations are from -1 to 1 for a uniform distribution. For a normal distribution, the zone's edges -1 and 1 are at
    three standard deviations.
    """
    return 2.0 * even - 1.0 if tolerances.distribution == "uniform" else standard_normal_of(even) / 3.0


def half_widths(tolerances: Tolerances, nominal: Geometry) -> Array:
    """Return the half-widths of the tolerance zones of a geometry's parameters ``(5n + 12,)``, m and rad.

    Positions of base and tool have the half-width that belongs to ``least_length``.
    """
    lengths = np.concatenate([*(getattr(nominal, name) for name in LINK_PARAMETERS), np.zeros(12)])
    zone = it_tolerance(tolerances.it_grade, np.maximum(np.abs(lengths), tolerances.least_length))
    return np.where(nominal.parameter_is_angle, tolerances.angle, zone / 2.0)


def standard_deviations(tolerances: Tolerances, nominal: Geometry) -> Array:
    """Return the standard deviations of a geometry's parameters ``(5n + 12,)`` over arms of the class, m and rad."""
    return half_widths(tolerances, nominal) / (math.sqrt(3.0) if tolerances.distribution == "uniform" else 3.0)


def _geometry(nominal: Geometry, tolerances: Tolerances, even: Array) -> Geometry:
    n = nominal.joints
    deviation = _deviation(tolerances, even)
    half = dict(zip(LINK_PARAMETERS, half_widths(tolerances, nominal)[: 5 * n].reshape(5, n), strict=True))
    numbers: dict[str, Any] = {name: np.tile(getattr(nominal, name), (len(even), 1)) for name in LINK_PARAMETERS}
    for k, name in enumerate(("alpha", "a", "theta", "d")):
        numbers[name] = numbers[name] + half[name] * deviation[:, k * n : (k + 1) * n]
    return replace(nominal, **numbers)


Zone = Callable[[Array], Array]
"""A function from uniform random numbers from 0 to 1, one per unidentified parameter, to deviations, m or rad."""


def twin_plant(name: str, arm: Arm, posterior: Posterior, noise: MeasurementNoise | None) -> Plant:
    """Return the twin of a calibrated arm: a plant (simulated true arm) with the identified parameters.

    The twin's residual field has the posterior's mean weights. This mean is smoother than any possible arm; evaluate
    methods on arms drawn by `twin_arms`.

    Args:
        name: Name of the plant.
        arm: The arm with its nominal geometry.
        posterior: Posterior distribution of the calibration.
        noise: Errors of the measuring instrument, which become an effect of the plant, or None.
    """
    geometry = _carried(arm, posterior, [posterior.identified])
    parts = (*_effects(arm, posterior, posterior.coefficients), posterior.field, noise)
    return Plant(name, arm, geometry, effects=tuple(part for part in parts if part is not None), posterior=posterior)


def twin_arms(plant: Plant, zone: Zone, streams: Sequence[np.random.Generator]) -> Plant:
    """Draw arms from the posterior distribution of a twin, one per generator, as one plant whose numbers are arrays.

    Effects that were switched off in the twin stay off.

    Args:
        plant: A plant with a posterior.
        zone: Function from uniform random numbers to deviations of the unidentified parameters, m or rad (`Zone`).
        streams: One random generator per arm.
    """
    posterior = plant.posterior
    assert posterior is not None
    field = posterior.field if plant.effect("residual") is not None else None
    deltas, weights = [], []
    for rng in streams:
        unseen = zone(rng.random(len(posterior.unseen)))
        deltas.append(posterior.traces @ unseen + posterior.factor @ rng.standard_normal(posterior.factor.shape[1]))
        if field is not None:
            weights.append((field.weight + _weights(posterior, field, rng)).astype(np.float32))
    delta, count = np.array(deltas), len(posterior.identified.parameter_names)
    geometry = _carried(plant.arm, posterior, [posterior.identified.displaced(row[:count]) for row in delta])
    parts = _effects(plant.arm, posterior, posterior.coefficients + delta[:, count:])
    if field is not None:
        parts.append(replace(field, weight=np.array(weights)))
    arms = plant.with_effect(*(part for part in parts if plant.effect(part.name) is not None))
    return replace(arms, geometry=geometry, posterior=None, ready=None)


def _weights(posterior: Posterior, field: ResidualField, rng: np.random.Generator) -> Array:
    """Draw how far the weights of the field's waves deviate from their mean: ``(O, 2, K)``, m and rad.

    There are O outputs with K waves each; weights of cosines come first, then weights of sines.
    """
    outputs, count, smooth = field.features.outputs, field.features.count, posterior.field_factor.shape[-1] // 2
    normal = rng.standard_normal((outputs, 2 * smooth))
    learnt = np.einsum("okl,ol->ok", posterior.field_factor, normal).reshape(outputs, 2, smooth)
    rough = rng.standard_normal((outputs, 2, count - smooth))
    rough = rough * posterior.rough[:, None, None] / np.sqrt(max(count - smooth, 1))
    return np.concatenate([learnt, rough], axis=-1)


def _carried(arm: Arm, posterior: Posterior, geometries: Sequence[Geometry]) -> Geometry:
    """Transform the base and tool of geometries into the arm's own frame, and return the geometries as one.

    Args:
        arm: The arm with its nominal geometry.
        posterior: Posterior distribution of the calibration.
        geometries: Drawn geometries, which become arrays with one entry per arm; or the identified geometry alone,
            which keeps plain numbers.
    """
    base, tool = posterior.aligned
    nominal = arm.nominal
    first, last = behind(nominal.base, inverse_pose(base)), behind(inverse_pose(tool), nominal.tool)
    frames = {"base": [behind(first, g.base) for g in geometries], "tool": [behind(g.tool, last) for g in geometries]}
    links = {name: [getattr(geometry, name) for geometry in geometries] for name in LINK_PARAMETERS}
    parts: dict[str, Any] = {name: rows[0] for name, rows in (links | frames).items()}
    if geometries[0] is not posterior.identified:
        parts = {name: np.stack(rows) for name, rows in links.items()}
        parts |= {name: _together(poses) for name, poses in frames.items()}
    return replace(nominal, **parts)


def _together(poses: Sequence[Pose]) -> Pose:
    """Return the pose itself if all poses are equal, else one `Pose` of arrays with an entry per pose."""
    position, rotation = (np.stack(parts) for parts in zip(*poses, strict=True))
    alike = np.ptp(position, axis=0).max() == 0.0 and np.ptp(rotation, axis=0).max() == 0.0
    return poses[0] if alike else Pose(position, rotation)


def _effects(arm: Arm, posterior: Posterior, coefficients: Array) -> list[Effect]:
    """Return the effects that a calibration's coefficients describe.

    Args:
        arm: The arm with its nominal geometry.
        posterior: Posterior distribution of the calibration; its `Layout` gives the meaning of the coefficients.
        coefficients: The coefficients ``(k,)`` of one arm, or ``(N, k)`` of N arms.
    """
    layout, columns = posterior.layout, [_scalar(column) for column in np.moveaxis(coefficients, -1, 0)]
    waves, moments = columns[: layout.sizes[0]], columns[layout.sizes[0] :]
    effects: list[Effect] = []
    if waves:
        terms = (
            Harmonic(joint, _scalar(np.hypot(sine, cosine)), math.tau / order, _scalar(np.arctan2(cosine, sine)))
            for (joint, order), sine, cosine in zip(layout.harmonics, waves[::2], waves[1::2], strict=True)
        )
        effects.append(TransmissionError((0.0,) * arm.nominal.joints, tuple(terms)))
    if moments:
        effects.append(GravityYield(layout.moments, tuple(moments), layout.up))
    return effects


def _scalar(value: Any) -> Any:
    """Return an array with an entry per arm unchanged, and an array of a single number as a float."""
    return value if np.ndim(value) else float(value)


# The file: a container that holds all that the arms are drawn from.


TWIN = "twin"
TWIN_FORMAT = 1

REMAKE_TWIN = "run `pickenv twin` to make one of a calibration"


def write_twin(plant: Plant, path: str | Path) -> Path:
    """Write a twin (a plant that was made from a calibration) to a file and return its path.

    If this fails, no incomplete file is left.

    Args:
        plant: The twin.
        path: The file (.npz) to write.

    Raises:
        InputError: If the plant was not made from a calibration, if effects were added to it or switched off, or if the
            file cannot be written.
    """
    posterior, nominal = plant.posterior, plant.arm.nominal
    if posterior is None:
        raise InputError(f"plant '{plant.name}' was not made of a calibration; plants of that kind are TOML files")
    noise = plant.effect("measurement_noise")
    names = twin_plant(plant.name, plant.arm, posterior, noise).names
    if plant.names != names:
        effects = f"{', '.join(plant.names)}, its calibration found {', '.join(names)}"
        raise InputError(f"plant '{plant.name}' has the effects {effects}; write it as it was made")
    base, tool = posterior.aligned
    aligned = replace(nominal, base=base, tool=tool)
    geometries = {"arm": nominal, "identified": posterior.identified, "aligned": aligned}
    arrays: dict[str, NDArray[Any]] = {}
    for key, geometry in geometries.items():
        arrays |= named_part(f"{key}/", geometry_arrays(geometry))
    parts = ("coefficients", "factor", "unseen", "traces", "field_factor", "rough")
    arrays |= {"speed": plant.arm.speed} | {name: getattr(posterior, name) for name in parts}
    if (field := posterior.field) is not None:
        arrays |= {"frequency": field.features.frequency, "centre": np.array(field.features.centre)}
        arrays |= {name: np.array(getattr(field, name)) for name in ("weight", "offset", "turn")}
    header: dict[str, Any] = {"name": plant.name, "arm": plant.arm.name, "source": plant.arm.source}
    header |= {"joint_names": nominal.joint_names, "prismatic": nominal.prismatic, "layout": asdict(posterior.layout)}
    header |= {"periodic": None if field is None else field.features.periodic}
    header |= {"noise": None if noise is None else vars(noise), "notes": posterior.notes}
    return write_container(path, TWIN, header, arrays, version=TWIN_FORMAT)


def read_twin(path: str | Path) -> Plant:
    """Read a twin from a file that `write_twin` wrote; nothing in the file is executed.

    Raises:
        InputError: If the file is missing, damaged, of another kind or version, or has no valid arm.
    """
    container = read_container(path, TWIN, remake=REMAKE_TWIN, version=TWIN_FORMAT)
    with refusing_damage(path, f"a {TWIN} file", REMAKE_TWIN):
        return _plant_of(container.header, container.arrays)


def _plant_of(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Plant:
    """Return the plant that a file's header and arrays describe; raise an exception of any type if they are invalid."""
    names, prismatic = header["joint_names"], header["prismatic"]
    parts = {key: part_of(arrays, f"{key}/") for key in ("arm", "identified", "aligned")}
    nominal, identified, aligned = (geometry_from_arrays(p, names, prismatic, key) for key, p in parts.items())
    layout = _layout(header["layout"], nominal)
    unseen = arrays["unseen"].astype(np.int64)
    count, size = sum(layout.sizes), len(nominal.parameter_names) + sum(layout.sizes)
    if np.any((unseen < 0) | (unseen >= len(nominal.parameter_names))):
        raise InputError("it names parameters that its arm does not have")
    field = None if header["periodic"] is None else _field(header["periodic"], arrays, nominal.joints)
    outputs, smooth = 0 if field is None else field.features.outputs, arrays["field_factor"].shape[-1]
    shapes = {"coefficients": (count,), "factor": (size, arrays["factor"].shape[-1]), "traces": (size, len(unseen))}
    shapes |= {"field_factor": (outputs, smooth, smooth), "rough": (outputs,)}
    numbers = {name: finite(arrays, name, shape, TWIN) for name, shape in shapes.items()}
    frames, notes = (aligned.base, aligned.tool), tuple(map(str, header["notes"]))
    posterior = Posterior(identified, frames, layout, unseen=unseen, field=field, notes=notes, **numbers)
    if field is not None and smooth > 2 * field.features.count:
        raise InputError("its residual has fewer features than its posterior")
    speed = finite(arrays, "speed", (nominal.joints,), TWIN)
    arm = Arm(str(header["arm"]), str(header["source"]), nominal, None, speed)
    noise = None if header["noise"] is None else MeasurementNoise(**header["noise"])
    plant = twin_plant(str(header["name"]), arm, posterior, noise)
    if not all(np.isfinite(part).all() for part in plant.tool_pose((nominal.lower + nominal.upper) / 2)):
        raise InputError("its arm has no finite pose in the middle of its joints' ranges")
    return plant


def _layout(content: Mapping[str, Any], geometry: Geometry) -> Layout:
    from pydantic import TypeAdapter  # late: it is heavy

    layout = TypeAdapter(Layout).validate_python(content)
    joints = {joint for joint, _ in layout.harmonics} | {joint for pair in layout.moments for joint in pair[:2]}
    if not joints <= set(range(geometry.joints)) or not {moment for *_, moment in layout.moments} <= set("mxyz"):
        raise InputError("it names a joint that its arm does not have")
    return layout


def _field(periodic: Any, arrays: Mapping[str, NDArray[Any]], joints: int) -> ResidualField:
    outputs, waves = arrays["offset"].shape[0], arrays["frequency"].shape[1]
    if outputs not in (3, 6) or waves % outputs or len(periodic) != joints:
        raise InputError("its residual is neither of a position nor of a pose, or of another arm")
    rows = joints + sum(map(bool, periodic))
    centre, turn = finite(arrays, "centre", (rows,), TWIN), finite(arrays, "turn", (3, 3), TWIN)
    frequency, weight = (
        finite({name: arrays[name].astype(float)}, name, shape, TWIN).astype(np.float32)
        for name, shape in (("frequency", (rows, waves)), ("weight", (outputs, 2, waves // outputs)))
    )
    offset = finite(arrays, "offset", (outputs,), TWIN)
    features = Features(frequency, tuple(centre.tolist()), tuple(map(bool, periodic)), outputs)
    return ResidualField(features, weight, tuple(offset.tolist()), tuple(map(tuple, turn.tolist())))
