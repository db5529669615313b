"""How each drawn arm differs from its design: the columns that sensitivity analyses start from.

``delta_PARAMETER_mm`` or ``_deg``: true minus nominal; ``size_EFFECT``: factor on the design's size; ``sine_EFFECT``
and ``cosine_EFFECT``: that factor times sine and cosine of the phase, as a periodic error acts; ``rise_K``: the warm
arm's temperature rise. Numbers that change nothing at rest (frequencies, time constants) are left out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.plant.plant import Plant

SIZES: Mapping[str, tuple[str, Callable[[Any], tuple[Any, ...]]]] = {
    "joint_stiffness": ("joint_compliance", lambda effect: effect.stiffness),
    "flexural_rigidity": ("boom_bending", lambda effect: (effect.flexural_rigidity,)),
    "torsional_rigidity": ("boom_torsion", lambda effect: (effect.torsional_rigidity,)),
    "bearing_stiffness": ("slide_compliance", lambda effect: tuple(each.stiffness for each in effect.bearings)),
    "lead": ("transmission_error", lambda effect: effect.lead),
    "roller_clearance": ("roller_play", lambda effect: (effect.clearance,)),
    "backlash": ("backlash", lambda effect: effect.width),
    "friction_forward": ("stick_band", lambda effect: effect.forward),
    "friction_backward": ("stick_band", lambda effect: effect.backward),
    "ground_stiffness": ("base_tilt", lambda effect: effect.stiffness),
    "creep": ("base_tilt", lambda effect: (effect.creep,)),
    "settlement": ("base_tilt", lambda effect: (effect.settlement,)),
}
"""Which numbers of which effect each column holds."""


def deviations(design: Plant, arms: Plant) -> dict[str, Array]:
    """The columns for a batch of arms.

    Args:
        design: What they were drawn from.
        arms: N arms.

    Returns:
        Columns ``(N,)`` by name. Numbers that are zero in the design, and so in every arm, have none.
    """
    nominal = design.arm.nominal
    names = iter(nominal.parameter_names)
    columns: dict[str, Array] = {}
    for kind in ("alpha", "a", "theta", "d"):
        difference = getattr(arms.geometry, kind) - getattr(nominal, kind)
        angle = kind in ("alpha", "theta")
        for i in range(nominal.joints):
            column = f"delta_{next(names)}_{'deg' if angle else 'mm'}"
            columns[column] = np.degrees(difference[:, i]) if angle else 1e3 * difference[:, i]
    for name, (effect, numbers) in SIZES.items():
        if getattr(design, effect) is None:
            continue
        sizes = numbers(getattr(design, effect))
        for i, (size, drawn) in enumerate(zip(sizes, numbers(getattr(arms, effect)), strict=True), start=1):
            if size:
                columns[f"size_{name}_{i}" if len(sizes) > 1 else f"size_{name}"] = drawn / size
    if arms.transmission_error is not None and design.transmission_error is not None:
        pairs = zip(design.transmission_error.harmonics, arms.transmission_error.harmonics, strict=True)
        for i, (own, term) in enumerate(pairs, start=1):
            if own.amplitude:
                size = term.amplitude / own.amplitude
                columns[f"sine_transmission_error_{i}"] = size * np.sin(term.phase)
                columns[f"cosine_transmission_error_{i}"] = size * np.cos(term.phase)
    if arms.thermal_growth is not None:
        columns["rise_K"] = np.asarray(arms.thermal_growth.final_rise)
    return columns
