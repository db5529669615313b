"""Table 4 of Qiao 2026: eight methods on the same poses, with the same inputs and as many poses each.

Every method spends the paper's 300 poses: alone it takes all of them, combined 100 go to the geometry and 200 to the
network, as in the paper. Every network takes the six joints as they are, standardised. Each run has poses, noise and
networks of its own; what it leaves is measured with the plant's own tracker.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from papers.qiao2026.equations import PAPER, mean_mm, paper_eta, parameter_vector, statistics
from pickenv.arm import (
    Array,
    Geometry,
    MeasurementNoise,
    Plant,
    Pose,
    draw_plants,
    forward,
    load_plant,
    load_tolerances,
    plant_at,
    pose_error,
)
from pickenv.base import mean_interval
from pickenv.base.intervals import LEAST_RUNS
from pickenv.calibration import (
    BpnnSettings,
    Compensator,
    ErrorModel,
    LearntResidual,
    Measurements,
    held_out_r2,
    identify,
    link_model,
    random_joints,
    simulated_tracker,
    start_filter,
    train_bpnn,
)
from pickenv.calibration.identification.solve import update
from pickenv.calibration.residuals.residual_models import fit_residual

METHODS = ("raw", "EKF", "LS", "RBF", "BPNN", "EKF+RBF", "EKF+BPNN", "LS+BPNN")
CLAIMS = {
    "LS+BPNN leaves less than LS": ("LS+BPNN", "LS"),
    "LS+BPNN leaves less than BPNN alone": ("LS+BPNN", "BPNN"),
    "LS+BPNN leaves less than EKF+BPNN": ("LS+BPNN", "EKF+BPNN"),
    "EKF+BPNN leaves less than EKF+RBF": ("EKF+BPNN", "EKF+RBF"),
    "LS leaves less than EKF": ("LS", "EKF"),
    "LS leaves less than BPNN alone": ("LS", "BPNN"),
    "LS leaves less than RBF alone": ("LS", "RBF"),
}
"""What the paper concludes from Table 4, and whose difference says so."""

TOLERANCES = "medium"
"""Arms are drawn from this class: its deviations are as large as those of the paper's Table 1."""


@dataclass(frozen=True, eq=False)
class Protocol:
    """The paper's 100 + 200 + 100 poses on a plant, for one run.

    Attributes:
        plant: The plant.
        identification: Poses for the geometry.
        network: Poses for the network.
        alone: Both, for a method that is one of the two alone.
        test: Poses that judge.
        rng: Noise and networks.
    """

    plant: Plant
    identification: Measurements
    network: Measurements
    alone: Measurements
    test: Measurements
    rng: np.random.Generator


def protocol(plant: Plant, seed: np.random.SeedSequence) -> Protocol:
    """Draw the poses and measure them."""
    rng = np.random.default_rng(seed)
    first, second, last = (PAPER["protocol"]["poses"][key] for key in ("identification", "residual_training", "test"))
    alone, test = (
        simulated_tracker(plant, random_joints(plant.arm.nominal, count, rng), rng) for count in (first + second, last)
    )
    rows = np.arange(first + second)
    return Protocol(plant, alone.select(rows[:first]), alone.select(rows[first:]), alone, test, rng)


def missed(run: Protocol, data: Measurements) -> Array:
    """Measured against wanted pose ``(100, 6)`` at the test poses, m and rad."""
    assert data.rotation is not None
    return pose_error(forward(run.plant.arm.nominal, run.test.joints), Pose(data.position, data.rotation))


@dataclass(frozen=True, eq=False)
class Left:
    """What one run of Table 4 leaves.

    Attributes:
        errors: Pose errors at the test poses ``(100, 6)`` by method, m and rad.
        r2: Held-out R^2 per axis ``(6,)`` of each network by method.
        eta: The paper's eta of LS and EKF from its 100 poses, %.
    """

    errors: Mapping[str, Array]
    r2: Mapping[str, Array]
    eta: Mapping[str, float]

    def mean_mm(self, method: str) -> float:
        """Mean position error, mm."""
        return mean_mm(self.errors[method])


def filtered(model: ErrorModel, nominal: Geometry, data: Measurements) -> Geometry:
    """The arm after one pass of the extended Kalman filter over poses, with their stated noise."""
    state, noise = start_filter(model, nominal, data.joints), MeasurementNoise(data.position_std, data.attitude_std)
    assert data.rotation is not None
    for joints, position, rotation in zip(data.joints, data.position, data.rotation, strict=True):
        state = update(state, joints, Pose(position, rotation), noise)
    return state.geometry


def table_4_run(run: Protocol, settings: BpnnSettings, methods: Sequence[str] = METHODS) -> Left:
    """What these methods leave, on poses that none of them has seen."""
    nominal = run.plant.arm.nominal
    model = link_model(nominal)
    finders: dict[str, Callable[[Measurements], Geometry]] = {
        "LS": lambda data: identify(model, nominal, data).geometry,
        "EKF": lambda data: filtered(model, nominal, data),
    }
    first = {name.partition("+")[0] for name in methods}
    geometries = {name: find(run.identification) for name, find in finders.items() if name in first}

    def network(kind: str, geometry: Geometry, data: Measurements) -> LearntResidual:
        fitter = (lambda x, y, rng: train_bpnn(x, y, rng, settings)) if kind == "BPNN" else None
        rows = data.joints, data.difference(geometry), nominal.prismatic
        return fit_residual(kind.lower(), *rows, run.rng, fitter=fitter, periodic_span=np.inf)

    errors, r2 = {"raw": missed(run, run.test)}, {}
    for name in (name for name in methods if name != "raw"):
        start, _, kind = name.rpartition("+")
        if kind in finders:
            geometry, learnt = finders[kind](run.alone), None
        else:
            geometry = geometries[start] if start else nominal
            learnt = network(kind, geometry, run.network if start else run.alone)
            r2[name] = held_out_r2(run.test.difference(geometry), learnt.predict(run.test.joints))
        command = Compensator(nominal, geometry, None if learnt is None else learnt.predict)(run.test.joints)
        errors[name] = missed(run, simulated_tracker(run.plant, command, run.rng))
    true = parameter_vector(run.plant.geometry)
    return Left(errors, r2, {name: paper_eta(parameter_vector(found), true) for name, found in geometries.items()})


@dataclass(frozen=True, eq=False)
class Campaign:
    """Table 4 on one plant.

    Attributes:
        runs: The arm of Table 1, once for each seed.
        arms: Arms drawn from a tolerance class, each with seeds of its own.
    """

    runs: Sequence[Left]
    arms: Sequence[Sequence[Left]]

    def by_arm(self, figure: Callable[[Left], float]) -> Array:
        """A figure of each drawn arm, the mean over its seeds ``(A,)``."""
        return np.array([np.mean([figure(left) for left in seeds]) for seeds in self.arms])

    def errors(self, method: str) -> Array:
        """Errors of all runs of Table 1's arm ``(runs * 100, 6)``, m and rad."""
        return np.concatenate([left.errors[method] for left in self.runs])


def campaign(
    plant: Plant,
    seed: np.random.SeedSequence,
    settings: BpnnSettings,
    counts: tuple[int, int, int],
    progress: Callable[[], object],
    methods: Sequence[str] = METHODS,
) -> Campaign:
    """Run Table 4 on a plant; no two runs share a stream.

    Args:
        plant: The plant, with the deviations of the paper's Table 1.
        seed: Of everything random.
        settings: Of the BPNN.
        counts: Runs of Table 1's arm, drawn arms, seeds of each.
        progress: Called after each run.
        methods: Those that are run, in the order of `METHODS`. They draw random numbers in turn.
    """
    of_runs, of_draws, of_arms = seed.spawn(3)
    drawn = draw_plants(plant, load_tolerances(TOLERANCES), counts[1], np.random.default_rng(of_draws))

    def worked(arm: Plant, each: np.random.SeedSequence) -> Left:
        left = table_4_run(protocol(arm, each), settings, methods)
        progress()
        return left

    runs = [worked(plant, each) for each in of_runs.spawn(counts[0])]
    arms = [
        [worked(plant_at(drawn, i), each) for each in own.spawn(counts[2])]
        for i, own in enumerate(of_arms.spawn(counts[1]))
    ]
    return Campaign(runs, arms)


def difference(done: Campaign, one: str, other: str) -> dict[str, Any]:
    """Mean difference of two methods' position errors over the drawn arms, and its 95 % interval.

    Poses of a run share calibration and networks, and runs of an arm share the arm: each arm counts once, with the
    mean over its seeds. There is no interval with fewer than ten arms.
    """
    by_arm, paper = done.by_arm(lambda left: left.mean_mm(one) - left.mean_mm(other)), PAPER["table4"]
    return {
        "methods": [one, other],
        "paper_mm": paper[one][0] - paper[other][0],
        "ours_mm": float(by_arm.mean()),
        "ci95_mm": mean_interval(by_arm),
    }


def row_of(errors: Array) -> list[float]:
    """[mean mm, RMS mm, mean deg, RMS deg] of the norms; the paper's RMSE cannot be the RMS of the norm (fact 6)."""
    position, attitude = statistics(errors)
    return [position.mean, position.rms, attitude.mean, attitude.rms]


def beside_paper(paper: Sequence[float], raw: Sequence[float], errors: Array, raw_errors: Array) -> dict[str, Any]:
    """Paper and ours of one method, with reductions of the means against raw, %."""
    ours, first = row_of(errors), row_of(raw_errors)
    reductions = {
        who: [100 * (1 - row[k] / start[k]) for k in (0, 2)]
        for who, row, start in (("paper", paper, raw), ("ours", ours, first))
    }
    return {"paper": list(paper), "ours": ours, "reduction_percent": reductions}


def drawn_arms_row(done: Campaign, method: str) -> dict[str, Any]:
    """What a method leaves on the drawn arms, mm: the mean, and its interval over arms."""
    by_arm = done.by_arm(lambda left: left.mean_mm(method))
    return {"arms_mm": float(by_arm.mean()), "arms_ci95_mm": mean_interval(by_arm)}


def correlation(left: Left) -> float:
    """Rank correlation of one run's order of methods with the paper's."""
    methods = METHODS[1:]
    return float(spearmanr(*zip(*((PAPER["table4"][m][0], left.mean_mm(m)) for m in methods), strict=True)).statistic)


def correlations(campaigns: Mapping[str, Campaign]) -> dict[str, Any]:
    """Rank correlation with the paper's order by plant: its mean over the drawn arms, and its interval."""
    by_arm = {plant: done.by_arm(correlation) for plant, done in campaigns.items()}
    return {plant: {"mean": float(values.mean()), "ci95": mean_interval(values)} for plant, values in by_arm.items()}


def some_methods(campaigns: Mapping[str, Campaign], methods: Sequence[str]) -> dict[str, Any]:
    """What some methods leave on the drawn arms of each plant, and their differences; of the layout of all results.

    With all methods but raw there is the rank correlation of their order too.
    """
    claims = {claim: pair for claim, pair in CLAIMS.items() if set(pair) <= set(methods)}
    order = {"rank_correlation_of_arms": correlations(campaigns)} if set(METHODS[1:]) <= set(methods) else {}
    return {
        "tables": {
            "4": {
                "rows": [
                    {"plant": plant, "method": method} | drawn_arms_row(done, method)
                    for plant, done in campaigns.items()
                    for method in methods
                ]
            }
            | order
        },
        "claims": {
            claim: {"rows": [{"plant": plant} | difference(done, *pair) for plant, done in campaigns.items()]}
            for claim, pair in claims.items()
        },
    }


def table_4_rows(plant: str, done: Campaign) -> list[dict[str, Any]]:
    """Table 4 on one plant: its rows, without verdicts."""
    paper, rows = PAPER["table4"], []
    for name in METHODS:
        r2 = [left.r2[name] for left in done.runs if name in left.r2]
        rows.append(
            {"plant": plant, "method": name}
            | beside_paper(paper[name], paper["raw"], done.errors(name), done.errors("raw"))
            | {
                "ci95_mm": mean_interval([left.mean_mm(name) for left in done.runs], LEAST_RUNS),
                **drawn_arms_row(done, name),
                "r2": np.mean(r2, axis=0).tolist() if r2 else None,
            }
        )
    return rows


def twin(seed: np.random.SeedSequence) -> Plant:
    """A simulated twin of a real arm: plant qiao2026 with deviations drawn afresh, as large as Table 1's."""
    plant = load_plant("qiao2026")
    rng = np.random.default_rng(seed)
    table_1 = plant.arm.nominal.difference(plant.geometry)
    scale = np.zeros(len(table_1))
    angle = plant.arm.nominal.parameter_is_angle
    for kind in (angle, ~angle):
        rows = np.flatnonzero(kind[: 4 * plant.arm.nominal.joints])
        scale[rows] = np.sqrt(np.mean(table_1[rows] ** 2))
    return replace(plant, name="twin", geometry=plant.arm.nominal.displaced(rng.normal(size=len(scale)) * scale))
