"""What became of each parameter of a model: measured, held by its prior, or lost in others."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from pickenv.calibration.identification.least_squares import Identification, is_angle
from pickenv.calibration.model.error_model import ANGLE_TOLERANCE, LENGTH_TOLERANCE
from pickenv.calibration.model.prior import expected_sizes

MEASURED, HELD, LOST = "measured", "held by its prior", "lost in others"

INFORMED = 0.5
"""A term counts as measured where the data bring its standard deviation below this share of the expected one."""


@dataclass(frozen=True)
class States:
    """What became of each parameter of a model: `MEASURED`, `HELD` or `LOST`.

    Attributes:
        geometry: By parameter of links, base and tool, and by unknown of the measurements themselves.
        terms: By coefficient of the further terms.
    """

    geometry: Mapping[str, str]
    terms: Mapping[str, str]

    def of(self, name: str) -> str:
        """What became of one parameter."""
        return self.terms.get(name) or self.geometry[name]

    def text(self) -> str:
        """For people."""
        said = []
        for label, states in (("geometry", self.geometry), ("further terms", self.terms)):
            count = Counter(states.values())
            parts = [f"{label}: {count[MEASURED]} of {len(states)} measured"]
            parts += [f"{count[state]} {state.replace('its', 'their')}" for state in (HELD, LOST) if count[state]]
            if states:
                said.append(", ".join(parts))
        return "; ".join(said)

    def as_dict(self) -> dict[str, dict[str, str]]:
        """For JSON."""
        return {"geometry": dict(self.geometry), "terms": dict(self.terms)}


def parameter_states(
    found: Identification, bare: Identification, given: Mapping[str, float] = MappingProxyType({})
) -> States:
    """Which parameters were measured, which are held by their prior, and which are lost.

    A link's parameter that the data know less well than parts are made (1 mm, 1 mrad) is lost in others, even where the
    rank has room for it; a term's coefficient, or a parameter expected beforehand, is held by its prior unless the data
    know it twice as well.

    Args:
        found: The identification, with terms.
        bare: The one without, whose scatter weighs the prior (`pickenv.calibration.model.prior.coefficients_prior`).
        given: Standard deviations of parameters of links before measuring, where they have a prior.
    """
    model = found.arm_model
    count = len(model.geometry.parameter_names)
    prior = model.term_tolerances * expected_sizes(model) * found.scatter / max(bare.scatter, 1e-300)
    expected = dict(zip(model.parameter_names[count:], prior, strict=True))
    geometry: dict[str, str] = {}
    terms: dict[str, str] = {}
    for each in (bare, found):
        for name, std in zip(each.identifiability.names, each.standard_deviation, strict=True):
            kept = name in each.identifiability.kept_names
            if name in expected:
                terms[name] = LOST if not kept else MEASURED if std < INFORMED * expected[name] else HELD
            else:
                free = name.startswith(("base_", "tool_")) or name in each.unknowns
                made = np.inf if free else ANGLE_TOLERANCE if is_angle(name) else LENGTH_TOLERANCE
                held = std > INFORMED * given.get(name, np.inf)
                geometry[name] = HELD if kept and held else LOST if not kept or std > made else MEASURED
    return States(geometry, terms)
