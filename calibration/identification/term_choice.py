"""Which parametric terms an arm needs: chosen within the training rows, on contiguous blocks held out of each fit.

Weight (joints that yield under the arm's own mass) and periodic drive errors need no data sheet, so they can be tried
on any arm; they extrapolate where a learnt residual only interpolates. One that does not win on blocks stays out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickenv.arm import Arm, Geometry
from pickenv.calibration.identification.least_squares import Identification, identify
from pickenv.calibration.identification.rows import unknowns_of
from pickenv.calibration.model.arm_model import ArmModel, Term
from pickenv.calibration.model.error_model import geometric_model, with_terms
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.prior import coefficients_prior
from pickenv.calibration.model.splits import contiguous_folds, equally_spaced
from pickenv.calibration.model.terms import GravityTerm, PeriodicTerm, ThermalTerm
from pickenv.errors import InputError

MARGIN = 0.03
"""Terms must cut the cross-validated RMS by more than this share."""

FOLDS = 5
ROWS = 1500
"""The choice is made on so many training rows at most, taken evenly."""

WARM = 5.0
"""Temperatures that vary by less than this, K, say nothing about expansion."""

NAMES = ("gravity", "periodic", "thermal", "none")


@dataclass(frozen=True)
class TermChoice:
    """What was tried and chosen.

    Attributes:
        chosen: Name of the terms, one of `NAMES` joined by "+".
        blocked_rms: Cross-validated blocked RMS of every candidate, m.
    """

    chosen: str
    blocked_rms: dict[str, float]


def terms_of(name: str, arm: Arm, observations: Observations) -> tuple[Term, ...]:
    """The terms that a name stands for, for an arm mounted upright as its nominal base says.

    Raises:
        InputError: If the name is unknown.
    """
    geometry = arm.nominal
    terms: list[Term] = []
    for part in name.split("+"):
        if part == "gravity":
            up = geometry.base.rotation.T @ np.array([0.0, 0.0, 1.0])
            payload = observations.conditions.payload
            varied = payload is not None and float(np.ptp(payload)) > 0
            terms.append(GravityTerm(tuple(range(geometry.joints)), (float(up[0]), float(up[1]), float(up[2])), varied))
        elif part == "periodic":
            terms += [
                PeriodicTerm(i, period)
                for i in range(geometry.joints)
                if not geometry.prismatic[i]
                for period in (2 * np.pi, np.pi)
            ]
        elif part == "thermal":
            terms.append(ThermalTerm())
        elif part != "none":
            raise InputError(
                f"unknown terms '{part}'; give auto or some of {', '.join(NAMES[:-2])}, thermal, joined by +"
            )
    return tuple(terms)


def identify_terms(
    terms: tuple[Term, ...], bare: Identification, observations: Observations, known: bool = False
) -> Identification:
    """Identify geometry and terms, from a geometry identified without them; coefficients have a prior."""
    start = ArmModel.of(bare.geometry, terms)
    model = with_terms(geometric_model(bare.geometry, known), start)
    scatter = float(np.sqrt(bare.chi_square / max(bare.degrees_of_freedom, 1)))
    return identify(model, start, [observations, coefficients_prior(start, scatter)], max_iterations=60)


def choose_terms(arm: Arm, aligned: Geometry, observations: Observations, known: bool = False) -> TermChoice:
    """Choose terms by blocked cross-validation within training rows, in the order they were measured.

    One after the other, what every arm has first (weight), and each only if it wins over those before it. The order is
    a decision: on the WAM's grid periodic terms alone score better than weight alone, and extrapolate worse.

    Args:
        arm: The arm.
        aligned: Its geometry with base and tool fitted, or known.
        observations: Training rows.
        known: Whether base and tool are known.
    """
    data = observations.select(equally_spaced(len(observations.joints), ROWS))
    folds = []
    for train, test in contiguous_folds(data.groups, FOLDS):
        here = data.select(train)
        folds.append((identify(geometric_model(aligned, known), aligned, [here]), here, data.select(test)))

    def score(name: str) -> float:
        missed = []
        for bare, here, there in folds:
            terms = terms_of(name, arm, data)
            found = identify_terms(terms, bare, here, known) if terms else bare
            missed.append(there.misses(found.arm_model, unknowns_of(found, there)))
        return float(np.sqrt(np.mean(np.sum(np.concatenate(missed) ** 2, axis=1))))

    chosen, scores = "none", {"none": score("none")}
    temperature = data.conditions.temperature
    warm = temperature is not None and float(np.ptp(temperature)) > WARM
    for name in ("gravity", "periodic", *(("thermal",) if warm else ())):
        wider = name if chosen == "none" else f"{chosen}+{name}"
        scores[wider] = score(wider)
        if scores[wider] < (1.0 - MARGIN) * scores[chosen]:
            chosen = wider
    return TermChoice(chosen, scores)
