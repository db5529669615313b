"""Do payload and temperature have to be known? The future work that Qiao 2026 names, on a simulated arm.

Calibrations learn from as many poses, measured at the reference or under varying payload and temperature; each is
judged where the conditions differ from the reference. A residual of the joints alone cannot follow; terms and a
residual that are told the conditions can. SI units inside, mm in the results.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from pickenv.arm import Plant
from pickenv.arm.effects.thermal import ThermalGrowth
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.assessment.metrics import ErrorStatistics, bootstrap_interval, error_statistics
from pickenv.calibration.identification.least_squares import identify
from pickenv.calibration.model.arm_model import ArmModel, Conditions, Term
from pickenv.calibration.model.error_model import link_model, with_terms
from pickenv.calibration.model.measurements import Measurements, random_joints, simulated_tracker
from pickenv.calibration.model.terms import BendingTerm, ComplianceTerm, ThermalTerm
from pickenv.calibration.residuals.residual_models import Fitter, LearntResidual, fit_residual
from pickenv.errors import InputError

ALUMINIUM = 23e-6
"""Coefficient of linear expansion of aluminium, 1/K (ISO 1-1 tables; 22 to 24 for usual alloys)."""

METHODS = (
    "geometry",
    "joints only, learnt at the reference",
    "joints only",
    "residual with conditions",
    "terms",
    "terms and residual with conditions",
)


@dataclass(frozen=True)
class ConditionsSettings:
    """Sizes of the study.

    Attributes:
        training: Poses measured.
        test: Poses for each case.
        payload: Largest payload, kg; training poses draw theirs from zero to it.
        temperature: Largest temperature rise, K; training poses draw theirs from zero to it.
        expansion: Coefficient of the simulated arm's links, 1/K.
        residual: Residual model by name, see `pickenv.calibration.residuals.residual_models.FITTERS`.
        seed: Seed of everything random.
    """

    training: int = 300
    test: int = 200
    payload: float = 0.5
    temperature: float = 20.0
    expansion: float = ALUMINIUM
    residual: str = "bpnn"
    seed: int = 0


@dataclass(frozen=True, eq=False)
class ConditionsResult:
    """Held-out position errors by case and method.

    Attributes:
        settings: What was run.
        errors_mm: For each case and method, norms of the position errors ``(M,)``, mm; the poses of a case are the
            same for all methods.
        coefficients: Identified coefficients of the terms, in their own units.
        true_expansion: What the thermal coefficient should be, 1/K.
    """

    settings: ConditionsSettings
    errors_mm: Mapping[str, Mapping[str, Array]]
    coefficients: Mapping[str, float]
    true_expansion: float

    def statistics(self, case: str, method: str) -> ErrorStatistics:
        """Statistics of one case and method, mm."""
        return error_statistics(self.errors_mm[case][method])

    def gain(self, case: str, method: str, over: str = "joints only") -> tuple[float, float, float]:
        """Mean fall of the error of ``over`` by ``method``, mm, and its 95 % interval, paired by pose."""
        fall = self.errors_mm[case][over] - self.errors_mm[case][method]
        return (float(fall.mean()), *bootstrap_interval(fall))

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "cases": {
                case: {method: self.statistics(case, method).as_dict() for method in methods}
                for case, methods in self.errors_mm.items()
            },
            "coefficients": dict(self.coefficients),
            "true_expansion_per_K": self.true_expansion,
        }

    def report(self) -> str:
        """A table for people: mean position error and its 95 % interval."""
        lines = [f"{'mean position error [mm], 95 % interval':>40}  " + "  ".join(f"{c:>22}" for c in self.errors_mm)]
        for method in METHODS:
            cells = []
            for case in self.errors_mm:
                found = self.statistics(case, method)
                low, high = found.mean_ci95
                cells.append(f"{found.mean:.3f} ({low:.3f}..{high:.3f})")
            lines.append(f"{method:>40}  " + "  ".join(f"{cell:>22}" for cell in cells))
        return "\n".join(lines)


def under(plant: Plant, payload: Array, temperature: Array, expansion: float = ALUMINIUM) -> Plant:
    """The plant holding payloads ``(N,)`` kg with its links ``(N,)`` K above the reference, one entry per pose.

    Raises:
        InputError: If the plant has no masses, so that a payload would change nothing.
    """
    if plant.load is None:
        raise InputError(f"plant {plant.name} has no [load], so a payload would change nothing; give one that has")
    growth = ThermalGrowth((expansion,) * plant.geometry.joints, temperature, temperature, 1.0)
    return replace(plant, load=replace(plant.load, payload=payload), thermal_growth=growth)


def measured_under(
    plant: Plant, joints: Array, payload: Array, temperature: Array, rng: np.random.Generator, expansion: float
) -> Measurements:
    """What a tracker sees of `under`, with payload and temperature recorded."""
    data = simulated_tracker(under(plant, payload, temperature, expansion), joints, rng)
    return replace(data, conditions=Conditions(payload=payload, temperature=temperature))


def plant_terms(plant: Plant) -> tuple[Term, ...]:
    """Terms for what the plant's conditions change: compliance, bending of its boom, heat."""
    assert plant.load is not None
    turning = tuple(i for i, slides in enumerate(plant.geometry.prismatic) if not slides)
    terms: list[Term] = [ComplianceTerm(turning, plant.load)]
    if plant.boom_bending is not None:
        boom = plant.boom_bending
        terms.append(BendingTerm(boom.joint, float(boom.length), float(boom.end_mass)))
    return (*terms, ThermalTerm())


def conditions_study(
    plant: Plant, settings: ConditionsSettings | None = None, *, fitter: Fitter | None = None
) -> ConditionsResult:
    """Run the study: cases "reference", "payload", "heat" and "both", methods `METHODS`.

    Args:
        plant: A plant with masses; its own payload and heat are replaced.
        settings: Sizes and seed.
        fitter: Another way to fit the residual model.
    """
    chosen = settings or ConditionsSettings()
    measure_rng, *learn_rngs = (np.random.default_rng(s) for s in np.random.SeedSequence(chosen.seed).spawn(5))
    nominal = plant.arm.nominal

    def measured(count: int, payload: Array, temperature: Array) -> Measurements:
        joints = random_joints(nominal, count, measure_rng)
        return measured_under(plant, joints, payload, temperature, measure_rng, chosen.expansion)

    train = measured(
        chosen.training,
        measure_rng.uniform(0, chosen.payload, chosen.training),
        measure_rng.uniform(0, chosen.temperature, chosen.training),
    )
    at_reference = measured(chosen.training, np.zeros(chosen.training), np.zeros(chosen.training))
    cases = {
        name: measured(chosen.test, np.full(chosen.test, payload), np.full(chosen.test, heat))
        for name, payload, heat in (
            ("reference", 0.0, 0.0),
            ("payload", chosen.payload, 0.0),
            ("heat", 0.0, chosen.temperature),
            ("both", chosen.payload, chosen.temperature),
        )
    }
    model = link_model(nominal)
    plain, cold = (identify(model, nominal, data).arm_model for data in (train, at_reference))
    start = ArmModel.of(nominal, plant_terms(plant))
    with_effects = identify(with_terms(model, start), start, train).arm_model

    def learnt(arm: ArmModel, data: Measurements, told: bool, rng: np.random.Generator) -> LearntResidual:
        targets = data.difference(arm)
        inputs = data.conditions.inputs() if told else None
        return fit_residual(
            chosen.residual, data.joints, targets, data.prismatic, rng, conditions=inputs, fitter=fitter
        )

    models = dict(
        zip(
            METHODS,
            (
                (plain, None, False),
                (cold, learnt(cold, at_reference, False, learn_rngs[0]), False),
                (plain, learnt(plain, train, False, learn_rngs[1]), False),
                (plain, learnt(plain, train, True, learn_rngs[2]), True),
                (with_effects, None, False),
                (with_effects, learnt(with_effects, train, True, learn_rngs[3]), True),
            ),
            strict=True,
        )
    )
    errors: dict[str, dict[str, Array]] = {}
    for case, data in cases.items():
        errors[case] = {}
        for method, (arm, residual, told) in models.items():
            left = data.difference(arm)
            if residual is not None:
                left = left - residual.predict(data.joints, data.conditions.inputs() if told else None)
            errors[case][method] = np.linalg.norm(left[:, :3], axis=1) * 1e3
    names = with_effects.parameter_names[len(nominal.parameter_names) :]
    found = dict(zip(names, with_effects.coefficients.tolist(), strict=True))
    return ConditionsResult(chosen, errors, found, chosen.expansion)
