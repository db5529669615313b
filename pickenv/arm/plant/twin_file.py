"""A calibrated arm's plant as one verified file (.npz), with all that its arms are drawn from: a container."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.effects.drives import MeasurementNoise
from pickenv.arm.effects.residual_field import Features, ResidualField
from pickenv.arm.files.arm import Arm, finite, geometry_arrays, geometry_from_arrays
from pickenv.arm.kinematics.geometry import Geometry, Pose
from pickenv.arm.plant.plant import Plant
from pickenv.arm.plant.posterior import Layout, Posterior
from pickenv.arm.plant.twin_arms import twin_plant
from pickenv.base import InputError, read_container, refusing_damage, write_container
from pickenv.base.container import named_part, part_of

TWIN = "twin"
TWIN_FORMAT = 1
"""Version of the file's content."""

REMAKE_TWIN = "run `pickenv twin` to make one of a calibration"


def write_twin(plant: Plant, path: str | Path) -> Path:
    """Write a plant that was made of a calibration, whole or not at all.

    Raises:
        InputError: If it was not, or if effects were added to it or switched off; or if the file cannot be written.
    """
    known = plant.posterior
    if known is None:
        raise InputError(f"plant '{plant.name}' was not made of a calibration; plants of that kind are TOML files")
    arrays: dict[str, NDArray[Any]] = {}
    noise = plant.effect("measurement_noise")
    if plant.names != (own := twin_plant(plant.name, plant.arm, known, noise).names):
        raise InputError(
            f"plant '{plant.name}' has the effects {', '.join(plant.names)}, its calibration found {', '.join(own)}; "
            "write it as it was made"
        )
    geometries = {"arm": plant.arm.nominal, "identified": known.identified, "aligned": _with_frames(plant.arm, known)}
    for key, geometry in geometries.items():
        arrays |= named_part(f"{key}/", geometry_arrays(geometry))
    parts = ("coefficients", "factor", "unseen", "traces", "field_factor", "rough")
    arrays |= {"speed": plant.arm.speed} | {name: getattr(known, name) for name in parts}
    if known.field is not None:
        field = known.field
        arrays |= {
            "frequency": field.features.frequency,
            "centre": np.array(field.features.centre),
            "weight": field.weight,
        }
        arrays |= {"offset": np.array(field.offset), "turn": np.array(field.turn)}
    header = {
        "name": plant.name,
        "arm": plant.arm.name,
        "source": plant.arm.source,
        "joint_names": plant.arm.nominal.joint_names,
        "prismatic": plant.arm.nominal.prismatic,
        "layout": asdict(known.layout),
        "periodic": None if known.field is None else known.field.features.periodic,
        "noise": None if noise is None else vars(noise),
        "notes": known.notes,
    }
    return write_container(path, TWIN, header, arrays, version=TWIN_FORMAT)


def read_twin(path: str | Path) -> Plant:
    """Read a file that `write_twin` wrote; nothing in it is executed.

    Raises:
        InputError: If the file is missing, damaged in any byte, of another kind or version, or holds no arm.
    """
    found = read_container(path, TWIN, remake=REMAKE_TWIN, version=TWIN_FORMAT)
    with refusing_damage(path, f"a {TWIN} file", REMAKE_TWIN):
        return _plant_of(found.header, found.arrays)


def _with_frames(arm: Arm, known: Posterior) -> Geometry:
    base, tool = known.aligned
    return replace(arm.nominal, base=base, tool=tool)


def _plant_of(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Plant:
    """The plant that a file's parts make; raises anything at all where they make none."""
    names, prismatic = header["joint_names"], header["prismatic"]
    parts = {key: part_of(arrays, f"{key}/") for key in ("arm", "identified", "aligned")}
    nominal, identified, aligned = (geometry_from_arrays(p, names, prismatic, key) for key, p in parts.items())
    layout = _layout(header["layout"], nominal)
    unseen = arrays["unseen"].astype(np.int64)
    count = sum(layout.sizes)
    size = len(nominal.parameter_names) + count
    if np.any((unseen < 0) | (unseen >= len(nominal.parameter_names))):
        raise InputError("it names parameters that its arm does not have")
    field = None if header["periodic"] is None else _field(header["periodic"], arrays, nominal.joints)
    outputs = 0 if field is None else field.features.outputs
    smooth = arrays["field_factor"].shape[-1]
    posterior = Posterior(
        identified=identified,
        aligned=(Pose(*aligned.base), Pose(*aligned.tool)),
        layout=layout,
        coefficients=finite(arrays, "coefficients", (count,), TWIN),
        factor=finite(arrays, "factor", (size, arrays["factor"].shape[-1]), TWIN),
        unseen=unseen,
        traces=finite(arrays, "traces", (size, len(unseen)), TWIN),
        field=field,
        field_factor=finite(arrays, "field_factor", (outputs, smooth, smooth), TWIN),
        rough=finite(arrays, "rough", (outputs,), TWIN),
        notes=tuple(str(note) for note in header["notes"]),
    )
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
    boom = content["boom"]
    layout = Layout(
        leads=tuple(content["leads"]),
        harmonics=tuple((int(joint), float(order)) for joint, order in content["harmonics"]),
        moments=tuple((int(joint), int(link), str(moment)) for joint, link, moment in content["moments"]),
        up=tuple(float(part) for part in content["up"]),  # type: ignore[arg-type]
        boom=None if boom is None else (int(boom[0]), float(boom[1])),
    )
    joints = [*layout.leads, *(joint for joint, _ in layout.harmonics), *(pair[0] for pair in layout.moments)]
    joints += [pair[1] for pair in layout.moments] + ([layout.boom[0]] if layout.boom else [])
    if not all(0 <= joint < geometry.joints for joint in joints) or not {pair[2] for pair in layout.moments} <= set(
        "mxyz"
    ):
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
