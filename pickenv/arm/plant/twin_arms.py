"""Plants of a calibration's posterior: the arm as it was found, and arms that the data allow.

Everything is carried from the instrument's frame into the arm's own, so that the arm errs there as it did against the
aligned nominal arm: base B_own B_aligned^-1 B, tool T T_aligned^-1 T_own. SI units.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pickenv.arm.effects.drives import GravityYield, MeasurementNoise
from pickenv.arm.effects.effect import Effect
from pickenv.arm.effects.residual_field import ResidualField
from pickenv.arm.effects.structure import BoomBending, Harmonic, TransmissionError
from pickenv.arm.files.arm import Arm
from pickenv.arm.kinematics.geometry import LINK_PARAMETERS, Array, Geometry, Pose, behind, inverse_pose
from pickenv.arm.plant.plant import Plant
from pickenv.arm.plant.posterior import Posterior
from pickenv.base import GRAVITY

Zone = Callable[[Array], Array]
"""Turns even numbers 0 to 1, one per parameter that was not identified, into deviations within tolerances, m or rad."""


def twin_plant(name: str, arm: Arm, posterior: Posterior, noise: MeasurementNoise | None) -> Plant:
    """The arm as it was found; its residual is the mean, which is no arm: judge on draws."""
    geometry = _carried(arm, posterior, [posterior.identified])
    parts = (*_effects(arm, posterior, posterior.coefficients), posterior.field, noise)
    return Plant(name, arm, geometry, effects=tuple(part for part in parts if part is not None), posterior=posterior)


def twin_arms(plant: Plant, zone: Zone, streams: Sequence[np.random.Generator]) -> Plant:
    """Arms that the data allow, one per stream, as one plant whose numbers are arrays.

    Effects that the plant has switched off stay off.

    Args:
        plant: A plant of a posterior.
        zone: How far parameters that were not identified may lie from where they are.
        streams: One generator per arm.
    """
    known = plant.posterior
    assert known is not None
    field = known.field if plant.effect("residual") is not None else None
    deltas, weights = [], []
    for rng in streams:
        unseen = zone(rng.random(len(known.unseen)))
        deltas.append(known.traces @ unseen + known.factor @ rng.standard_normal(known.factor.shape[1]))
        if field is not None:
            weights.append((field.weight + _weights(known, field, rng)).astype(np.float32))
    delta, count = np.array(deltas), len(known.identified.parameter_names)
    geometry = _carried(plant.arm, known, [known.identified.displaced(row[:count]) for row in delta])
    parts = _effects(plant.arm, known, known.coefficients + delta[:, count:])
    if field is not None:
        parts.append(replace(field, weight=np.array(weights)))
    drawn = plant.with_effect(*(part for part in parts if plant.effect(part.name) is not None))
    return replace(drawn, geometry=geometry, posterior=None, ready=None)


def _weights(known: Posterior, field: ResidualField, rng: np.random.Generator) -> Array:
    """Deviation of the waves' weights ``(O, 2, K)`` from their mean."""
    outputs, count, smooth = field.features.outputs, field.features.count, known.field_factor.shape[-1] // 2
    drawn = np.zeros((outputs, 2, count))
    normal = rng.standard_normal((outputs, 2 * smooth))
    drawn[..., :smooth] = np.einsum("okl,ol->ok", known.field_factor, normal).reshape(outputs, 2, smooth)
    rough = rng.standard_normal((outputs, 2, count - smooth))
    drawn[..., smooth:] = rough * known.rough[:, None, None] / np.sqrt(max(count - smooth, 1))
    return drawn


def _carried(arm: Arm, known: Posterior, found: Sequence[Geometry]) -> Geometry:
    """Geometries in the arm's own frame: one as it is, several as one whose numbers are arrays."""
    base, tool = known.aligned
    own = arm.nominal
    first, last = behind(own.base, inverse_pose(base)), behind(inverse_pose(tool), own.tool)
    bases = [behind(first, each.base) for each in found]
    tools = [behind(each.tool, last) for each in found]
    if len(found) == 1 and found[0] is known.identified:
        return replace(own, **{name: getattr(found[0], name) for name in LINK_PARAMETERS}, base=bases[0], tool=tools[0])
    links: dict[str, Any] = {name: np.stack([getattr(each, name) for each in found]) for name in LINK_PARAMETERS}
    return replace(own, **links, base=_together(bases), tool=_together(tools))


def _together(poses: Sequence[Pose]) -> Pose:
    """One pose where all are alike, else one per arm."""
    position, rotation = (np.stack(parts) for parts in zip(*poses, strict=True))
    alike = np.ptp(position, axis=0).max() == 0.0 and np.ptp(rotation, axis=0).max() == 0.0
    return poses[0] if alike else Pose(position, rotation)


def _effects(arm: Arm, known: Posterior, coefficients: Array) -> list[Effect]:
    """The effects that coefficients ``(k,)`` stand for, or those of many arms ``(N, k)``."""
    layout, columns = known.layout, [_scalar(column) for column in np.moveaxis(coefficients, -1, 0)]
    ends = np.cumsum(layout.sizes).tolist()
    leads, waves, moments, boom = (columns[a:b] for a, b in zip([0, *ends], ends, strict=False))
    effects: list[Effect] = []
    if leads or waves:
        lead: list[Any] = [0.0] * arm.nominal.joints
        for joint, size in zip(layout.leads, leads, strict=True):
            lead[joint] = lead[joint] + size
        pairs = zip(layout.harmonics, waves[::2], waves[1::2], strict=True)
        terms = (
            Harmonic(joint, _scalar(np.hypot(sine, cosine)), math.tau / order, _scalar(np.arctan2(cosine, sine)))
            for (joint, order), sine, cosine in pairs
        )
        effects.append(TransmissionError(tuple(lead), tuple(terms)))
    if moments:
        effects.append(GravityYield(layout.moments, tuple(moments), layout.up))
    if layout.boom is not None:
        joint, length = layout.boom
        effects.append(BoomBending(joint, length, GRAVITY, *boom))
    return effects


def _scalar(value: Any) -> Any:
    """An array of arms as it is, one number as a float."""
    return value if np.ndim(value) else float(value)
