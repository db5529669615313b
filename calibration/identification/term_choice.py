"""Which parametric terms an arm needs: chosen within the training rows, on contiguous blocks held out of each fit.

Weight (joints that yield under the arm's own mass) and the drives' harmonics need no data sheet, so they can be tried
on any arm, and compliance wherever torques were measured; they extrapolate where a learnt residual only interpolates.
One that does not win on blocks stays out.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickenv.arm import Arm
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.block_equations import BlockEquations, Linearised, Places, solved
from pickenv.calibration.identification.harmonics import chosen_orders, every_order, nearby, refined
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.identification.solve import solve
from pickenv.calibration.model.arm_model import Term
from pickenv.calibration.model.noise import counted
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.prior import prior_model
from pickenv.calibration.model.splits import contiguous_folds, equally_spaced, same_poses
from pickenv.calibration.model.terms import GravityTerm, PeriodicTerm, ThermalTerm, weighed
from pickenv.errors import InputError

MARGIN = 0.03
"""Terms must cut the cross-validated RMS by more than this share."""

FOLDS = 5
ROWS = 1500
"""The choice is made on so many training rows at most, taken evenly."""

WARM = 5.0
"""Temperatures that vary by less than this, K, say nothing about expansion."""

NAMES = ("compliance", "gravity", "periodic", "thermal")
"""Terms that can be chosen, in the order in which they are tried: what measured torques say before what is inferred."""


@dataclass(frozen=True)
class TermChoice:
    """What was tried and chosen.

    Attributes:
        chosen: Names of the terms, some of `NAMES` joined by "+", or "none".
        blocked_rms: Cross-validated blocked RMS of every candidate, m.
        terms: The terms.
    """

    chosen: str
    blocked_rms: dict[str, float]
    terms: tuple[Term, ...] = ()


def identify_terms(
    terms: tuple[Term, ...], bare: Identification, observations: Observations, known: bool = False
) -> Identification:
    """Identify geometry and terms, with the priors of a geometry identified without them; coefficients have their own.

    Args:
        terms: The terms.
        bare: The geometry without them.
        observations: The rows.
        known: Whether base and tool are known, where ``bare`` was identified without priors.
    """
    model = bare.prior or prior_model("", bare.geometry, known=known, fit="full")
    return solve(model.with_terms(terms), observations, near=bare)


def choose_terms(arm: Arm, bare: Identification, observations: Observations) -> TermChoice:
    """Choose terms by blocked cross-validation within training rows, in the order they were measured.

    One after the other, what was measured first (torques), then what every arm has (weight), and each only if it wins
    over those before it. The order is a decision: on the WAM's grid harmonics alone score better than weight alone, and
    extrapolate worse. Weight stays beside harmonics only if it wins over harmonics alone.

    Args:
        arm: The arm.
        bare: Its geometry, identified without terms.
        observations: Training rows.
    """
    trial = _Trial.of(arm, bare, observations)
    chosen: tuple[str, ...] = ()
    scores = {"none": trial.score(())}

    def wins(wider: tuple[str, ...], than: tuple[str, ...]) -> bool:
        for names in (wider, than):
            if _joined(names) not in scores:
                scores[_joined(names)] = trial.score(names)
        return scores[_joined(wider)] < (1.0 - MARGIN) * scores[_joined(than)]

    temperature = observations.conditions.temperature
    warm = temperature is not None and float(np.ptp(temperature)) > WARM
    for name in trial.names:
        if (name != "thermal" or warm) and wins((*chosen, name), chosen):
            chosen = (*chosen, name)
    if set(chosen) >= {"gravity", "periodic"}:
        lighter = tuple(name for name in chosen if name != "gravity")
        if not wins(chosen, lighter):
            chosen = lighter
    return TermChoice(_joined(chosen), scores, trial.terms(chosen))


def terms_of(names: str, arm: Arm, bare: Identification, observations: Observations) -> tuple[Term, ...]:
    """The terms of these names joined by "+", as many harmonics among them as the training rows bear.

    Args:
        names: Some of `NAMES` joined by "+", or "none".
        arm: The arm.
        bare: Its geometry, identified without terms.
        observations: Training rows.

    Raises:
        InputError: If a name is unknown.
    """
    wanted = [name for name in names.split("+") if name != "none"]
    for name in wanted:
        if name not in NAMES:
            raise InputError(f"unknown terms '{name}'; give auto, none, or some of {', '.join(NAMES)} joined by +")
        if name == "compliance" and observations.conditions.torque is None:
            raise InputError(
                f"{observations.source}: compliance needs the joints' measured torques; name their columns in "
                "[conditions.torques], or give --terms gravity"
            )
    if "periodic" not in wanted:
        return tuple(plain_term(name, arm, observations) for name in wanted)
    return _Trial.of(arm, bare, observations, tuple(wanted)).terms(tuple(wanted))


def plain_term(name: str, arm: Arm, observations: Observations) -> Term:
    """Weight or compliance, of an arm mounted upright as its nominal base says, or warmth, or every harmonic."""
    geometry = arm.nominal
    if name == "periodic":
        return every_order(geometry)
    if name == "thermal":
        return ThermalTerm()
    up = geometry.base.rotation.T @ np.array([0.0, 0.0, 1.0])
    payload = observations.conditions.payload
    varied = payload is not None and float(np.ptp(payload)) > 0
    weight = GravityTerm(tuple(range(geometry.joints)), (float(up[0]), float(up[1]), float(up[2])), varied)
    if name == "gravity":
        return weight
    return weighed(weight, geometry, observations.joints, observations.conditions)


@dataclass(frozen=True, eq=False)
class _Trial:
    """Terms on trial, in blocks of the training rows.

    Attributes:
        bare: The geometry, identified without terms.
        data: The rows.
        names: Names of the terms.
        equations: Normal equations of geometry and terms by block.
        counts: What each row counts by block ``(N,)``: rows of a cluster miss alike, and are few facts.
    """

    bare: Identification
    data: Observations
    names: tuple[str, ...]
    equations: BlockEquations
    counts: tuple[Array, ...]

    @staticmethod
    def of(arm: Arm, bare: Identification, observations: Observations, names: tuple[str, ...] | None = None) -> _Trial:
        """These terms, or all that the data have conditions for."""
        data = observations.select(equally_spaced(len(observations.joints), ROWS))
        if names is None:
            missing = {"compliance": data.conditions.torque is None, "thermal": data.conditions.temperature is None}
            names = tuple(name for name in NAMES if not missing.get(name))
        model = Linearised.of(bare, tuple(plain_term(name, arm, data) for name in names))
        folds = [held for _, held in contiguous_folds(data.groups, same_poses(data.joints), FOLDS)]
        every = counted(data.joints)
        counts = tuple(every[held] for held in folds)
        equations = BlockEquations.of(model, [data.select(held) for held in folds])
        return _Trial(bare, data, names, equations, counts)

    def places(self, names: tuple[str, ...]) -> tuple[list[Places], Places]:
        """Places of the parameters that take part with terms of these names: on all blocks but each, and on all."""
        model = self.equations.model
        others = [model.coefficients_of(self.names.index(name)) for name in names if name != "periodic"]
        base = np.concatenate([model.fitted, *others])
        if "periodic" not in names:
            return [base] * len(self.equations.blocks), base
        every = model.coefficients_of(self.names.index("periodic")).reshape(-1, 2)
        paths, whole = chosen_orders(self.equations, base, every)
        return [np.r_[base, path] for path in paths], np.r_[base, whole]

    def score(self, names: tuple[str, ...]) -> float:
        """RMS that they leave on blocks, each judged by a fit to the others, m."""
        squares, counts = 0.0, 0.0
        for number, (block, places) in enumerate(zip(self.equations.blocks, self.places(names)[0], strict=True)):
            solution = solved(*self.equations.without(number), places)
            missed = self.equations.model.misses(block, solution)
            count = self.counts[number][block.rows_of_misses]
            squares, counts = squares + float(count @ np.sum(missed**2, axis=1)), counts + float(count.sum())
        return float(np.sqrt(squares / counts))

    def terms(self, names: tuple[str, ...]) -> tuple[Term, ...]:
        """The terms of these names, with the orders of the harmonics refined."""
        every = self.equations.model.arm.terms
        found = {name: every[self.names.index(name)] for name in names}
        if "periodic" in names:
            wave = found.pop("periodic")
            assert isinstance(wave, PeriodicTerm)
            others, first = tuple(found.values()), self.equations.model.coefficients_of(self.names.index("periodic"))[0]
            wave = wave.some((np.setdiff1d(self.places(names)[1], np.arange(first))[::2] - first) // 2)
            if wave.orders:
                near = nearby(wave)
                model = Linearised.of(self.bare, (*others, near))
                fine = BlockEquations.of(model, self.equations.blocks)
                places = model.coefficients_of(len(others))
                base = np.arange(places[0])
                _, whole = chosen_orders(fine, base, places.reshape(-1, 2))
                wave = near.some(np.sort(whole[::2] - places[0]) // 2)
                if wave.orders:
                    found["periodic"] = refined(wave, others, self.bare, self.data)
        return tuple(found[name] for name in names if name in found)


def _joined(names: tuple[str, ...]) -> str:
    return "+".join(names) or "none"
