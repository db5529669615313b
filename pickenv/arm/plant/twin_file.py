"""Twins, that is plants made from a calibration's posterior distribution, and their files (.npz with a checksum).

A twin is the identified arm; arms can also be drawn from the posterior. The identified base and tool are transformed
from the instrument's frame into the arm's own frame: base B_own B_aligned^-1 B, tool T T_aligned^-1 T_own, with the
nominal arm's B_own and T_own. The arm's errors relative to its nominal geometry are then those that were measured
relative to the aligned nominal geometry. SI units.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.effects.drives import GravityYield, MeasurementNoise
from pickenv.arm.effects.effect import Effect
from pickenv.arm.effects.residual_field import Features, ResidualField
from pickenv.arm.effects.structure import Harmonic, TransmissionError
from pickenv.arm.files.arm import Arm, finite, geometry_arrays, geometry_from_arrays
from pickenv.arm.kinematics.geometry import LINK_PARAMETERS, Array, Geometry, Pose, behind, inverse_pose
from pickenv.arm.plant.plant import Layout, Plant, Posterior
from pickenv.base import InputError, read_container, refusing_damage, write_container
from pickenv.base.container import named_part, part_of

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
    """Return a random deviation of the weights of the field's waves ``(O, 2, K)`` from their mean, m and rad.

    There are O outputs with K waves each; the weights are those of cosines, then of sines.
    """
    outputs, count, smooth = field.features.outputs, field.features.count, posterior.field_factor.shape[-1] // 2
    normal = rng.standard_normal((outputs, 2 * smooth))
    learnt = np.einsum("okl,ol->ok", posterior.field_factor, normal).reshape(outputs, 2, smooth)
    rough = rng.standard_normal((outputs, 2, count - smooth))
    rough = rough * posterior.rough[:, None, None] / np.sqrt(max(count - smooth, 1))
    return np.concatenate([learnt, rough], axis=-1)


def _carried(arm: Arm, posterior: Posterior, geometries: Sequence[Geometry]) -> Geometry:
    """Transform the base and tool of geometries into the arm's own frame, and return them as one geometry.

    Drawn geometries become arrays with one entry per arm. The identified one alone keeps plain numbers.
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
    """Return the effects that a calibration's coefficients, of one arm ``(k,)`` or of many arms ``(N, k)``, describe.

    `Layout` gives the meaning of the coefficients.
    """
    layout, columns = posterior.layout, [_scalar(column) for column in np.moveaxis(coefficients, -1, 0)]
    waves, moments = columns[: layout.sizes[0]], columns[layout.sizes[0] :]
    effects: list[Effect] = []
    if waves:
        pairs = zip(layout.harmonics, waves[::2], waves[1::2], strict=True)
        terms = (
            Harmonic(joint, _scalar(np.hypot(sine, cosine)), math.tau / order, _scalar(np.arctan2(cosine, sine)))
            for (joint, order), sine, cosine in pairs
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
"""Version number of the file format."""

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
