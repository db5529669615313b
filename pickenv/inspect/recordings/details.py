"""Why the arm errs where it does: what each effect alone does, what no joint removes, what drifts within a day.

Everything here is computed from a comparison, on its field of poses or on its reaches. SI units.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pickenv.arm import forward, noncompensable_error
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.plant.effect_shares import TABLE
from pickenv.arm.plant.plant import EFFECTS, FOUND
from pickenv.inspect.recordings.field_day import Day, day_of
from pickenv.inspect.runs.comparison import Comparison
from pickenv.inspect.runs.comparison_summary import attitude_scale_deg, round_step

NO_FIELD = 1e-9
"""m; an effect that moves the settled tool by less than this everywhere has no field to show."""
FLOOR = "floor"
"""Key of the attitude error that no joint motion removes."""


@dataclass(frozen=True, eq=False)
class Details:
    """What a comparison's further views show.

    Attributes:
        removed: What the last policy removes of the error that the one before it leaves ``(F, 3)``, m; None where there
            is one policy.
        effects: The error field that each effect has alone ``(F, 3)``, m; `geometry` is the true against the nominal
            geometry.
        attitude: Attitude errors over the field ``(F, 3)``, rotation vectors, rad: of the first policy, of the last,
            and the part that no joint motion removes (key `FLOOR`); empty where attitudes are unknown.
        day: A day in the field; None without reaches, or for an arm of which no drift is known.
    """

    removed: Array | None
    effects: Mapping[str, Array]
    attitude: Mapping[str, Array]
    day: Day | None


def details_of(comparison: Comparison) -> Details:
    """Compute all of it."""
    policies = comparison.policies
    removed = policies[-2].field_errors - policies[-1].field_errors if len(policies) > 1 else None
    return Details(removed, effect_fields(comparison), attitude_fields(comparison), day_of(comparison))


def effect_fields(comparison: Comparison) -> dict[str, Array]:
    """The error field ``(F, 3)``, m, of each effect that is on, alone on the nominal geometry, and of the geometry.

    The tool is settled, the arm warm and the machine sunk. Effects that show only on the way there have no field.
    """
    plant, joints = comparison.plant, comparison.field_joints
    believed = forward(comparison.nominal, joints).position
    fields = {}
    for name in (*TABLE, *FOUND):
        if name != "geometry" and getattr(plant, name) is None:
            continue
        alone = plant.without(other for other in (*EFFECTS, *FOUND) if other != name)
        if name != "geometry":
            alone = replace(alone, geometry=comparison.nominal)
        field = alone.tool_pose(joints).position - believed
        if np.abs(field).max(initial=0.0) > NO_FIELD:
            fields[name] = field
    return fields


def attitude_fields(comparison: Comparison) -> dict[str, Array]:
    """Attitude errors of the first and the last policy, and the floor under the last one; see `Details`."""
    first, last = comparison.policies[0], comparison.policies[-1]
    if first.field_attitude is None or last.field_attitude is None:
        return {}
    error = np.concatenate([last.field_errors, last.field_attitude], axis=1)
    floor = noncompensable_error(comparison.plant.geometry, comparison.field_joints, error)[..., 3:]
    return {first.key: first.field_attitude, last.key: last.field_attitude, FLOOR: floor}


def attitude_length(comparison: Comparison, fields: Mapping[str, Array]) -> float:
    """How long an attitude error of 1 deg is drawn, m: round, and such that neighbouring arrows rarely overlap."""
    return round_step(comparison.grid_step / attitude_scale_deg(fields))
