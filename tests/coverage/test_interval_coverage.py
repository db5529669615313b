"""The interval functions hold the truth as often as they say, for errors as arms make them, at the smallest sample."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.stats import norm

from pickenv.arm.plant.iso9283 import CYCLES, pose_performance
from pickenv.base import (
    LEAST,
    LEAST_RUNS,
    clustered_share_interval,
    crossed_interval,
    estimate,
    mean_interval,
    norm_interval,
    quantile_interval,
    ratio_interval,
    share_interval,
)

Draw = Callable[[np.random.Generator, int], np.ndarray]

ERRORS: dict[str, tuple[Draw, float]] = {
    "the norms of three equal errors": (
        lambda rng, n: np.linalg.norm(rng.normal(size=(n, 3)), axis=1),
        np.sqrt(8.0 / np.pi),
    ),
    "arms, one of which is often twice as bad": (lambda rng, n: rng.gamma(2.0, size=n), 2.0),
    "arms half as far apart as they are bad": (lambda rng, n: np.exp(0.5 * rng.normal(size=n)), np.exp(0.125)),
    "differences": (lambda rng, n: rng.normal(size=n), 0.0),
}
"""What errors are drawn from, and their mean. Log-normal arms of 0.5: the spread of measured means over simulated arms
was 0.4 to 0.6 of their mean."""


@pytest.mark.parametrize("count", [LEAST, 64])
@pytest.mark.parametrize("kind", ERRORS)
def test_mean(repeats: Any, kind: str, count: int) -> None:
    draw, truth = ERRORS[kind]
    repeats.check(lambda rng: mean_interval(draw(rng, count)), truth)


def test_mean_over_few_runs(repeats: Any) -> None:
    repeats.check(lambda rng: mean_interval(rng.normal(3.0, 0.2, LEAST_RUNS), LEAST_RUNS), 3.0)


@pytest.mark.parametrize("trees", [LEAST, 30])
def test_picks_per_hour_over_trees(repeats: Any, trees: int) -> None:
    def draw(rng: np.random.Generator) -> Any:
        fruit = rng.poisson(20, trees)
        return ratio_interval(3600.0 * fruit, 30.0 + fruit * rng.normal(4.0, 0.5, trees))

    repeats.check(draw, 3600 * 20 / (30 + 20 * 4.0), share=0.2)


SIZES: dict[str, Draw] = {
    "any from 1 to 80": lambda rng, n: rng.integers(1, 81, n),
    "most small, some large": lambda rng, n: np.clip(np.round(np.exp(rng.normal(2.0, 1.2, n))), 1, 80).astype(int),
}
"""Fruit of clusters that are most unlike."""


@pytest.mark.parametrize("clusters", [LEAST, 24, 64])
@pytest.mark.parametrize("sizes", SIZES)
@pytest.mark.parametrize("statistic", ["rate", "share of one half", "share of four fifths"])
def test_ratios_over_unequal_clusters(repeats: Any, statistic: str, sizes: str, clusters: int) -> None:
    """Clusters that differ much in what they give, and in their size: 92 to 98 % hold; of ten shares 98.1 %."""
    share = {"rate": 0.0, "share of one half": 0.5, "share of four fifths": 0.8}[statistic]

    def draw(rng: np.random.Generator) -> Any:
        tried = SIZES[sizes](rng, clusters)
        if not share:
            return ratio_interval(tried * np.exp(0.5 * rng.normal(size=clusters)), tried)
        return clustered_share_interval(rng.binomial(tried, rng.beta(share, 1.0 - share, clusters)), tried)

    repeats.check(draw, share or np.exp(0.125), most=0.985 if clusters == LEAST else 0.98, share=0.5, least=0.92)


@pytest.mark.parametrize("arms", [LEAST, 24, 64])
@pytest.mark.parametrize("what", ["mean of those not lost", "share lost"])
def test_lost_reaches_stand_apart(repeats: Any, what: str, arms: int) -> None:
    """One reach in twenty is lost, which makes most of a mean; the share's interval is on the safe side (98.2 %)."""
    kept = float(np.exp(0.125))

    def draw(rng: np.random.Generator) -> Any:
        bad = np.exp(0.5 * rng.normal(size=(arms, 1))) * np.ones((1, 8))
        error = np.where(rng.random((arms, 8)) < 0.05, 1000.0, bad)
        columns = {"arm": np.repeat(np.arange(arms), 8), "error_mm": error.ravel()}
        (row,) = estimate(columns, "error_mm", lost=500.0)
        return row["lost" if what == "share lost" else "estimate"].ci95

    repeats.check(draw, 0.05 if what == "share lost" else kept, most=0.985, share=0.2, least=0.92)


@pytest.mark.parametrize(("trials", "share"), [(100, 0.5), (100, 0.9), (1000, 0.954), (40, 0.5)])
def test_share(repeats: Any, trials: int, share: float) -> None:
    repeats.check(lambda rng: share_interval(rng.binomial(trials, share), trials), share)


@pytest.mark.parametrize("arms", [LEAST, 64])
@pytest.mark.parametrize("alike", [0.0, 0.1, 0.3])
@pytest.mark.parametrize(("share", "most"), [(0.5, 0.97), (0.8, 0.975), (0.95, 0.98), (0.99, 1.0)])
def test_share_of_the_fruit_of_many_arms(repeats: Any, arms: int, alike: float, share: float, most: float) -> None:
    """Near 1 the interval is on the safe side: hardly an arm fails, and what is not seen is not ruled out."""
    size = 1.0 / alike - 1.0 if alike else np.inf

    def draw(rng: np.random.Generator) -> Any:
        chance = rng.beta(share * size, (1.0 - share) * size, arms) if alike else share
        return clustered_share_interval(rng.binomial(64, chance, arms), 64)

    repeats.check(draw, share, most)


@pytest.mark.parametrize(("arms", "seeds"), [(LEAST, LEAST_RUNS), (64, LEAST_RUNS), (16, 10)])
@pytest.mark.parametrize("spreads", [(1.0, 1.0, 1.0), (1.0, 0.3, 0.3), (0.3, 1.0, 0.3)])
def test_mean_estimate_and_training_seeds(repeats: Any, arms: int, seeds: int, spreads: tuple[float, ...]) -> None:
    arm, seed, both = spreads

    def draw(rng: np.random.Generator) -> Any:
        values = (
            arm * rng.normal(size=(arms, 1)) + seed * rng.normal(size=seeds) + both * rng.normal(size=(arms, seeds))
        )
        return crossed_interval(3.0 + values)

    repeats.check(draw, 3.0)


@pytest.mark.parametrize("trainings", [0.0, 0.2, 0.4])
def test_ratio_over_canopies_and_trainings(repeats: Any, trainings: float) -> None:
    """Fruit per hour of 60 canopies that five trainings pick, whose fruit vary by so much; more fruit take longer."""
    canopy, training = (place.ravel() for place in np.mgrid[:60, :LEAST_RUNS])

    def draw(rng: np.random.Generator) -> Any:
        size = rng.gamma(8.0, 0.75, 60)[canopy] * (1.0 + trainings * rng.normal(size=LEAST_RUNS)[training])
        fruit = size + rng.normal(size=len(size))
        hours = 0.002 * size + 0.001 * rng.gamma(4.0, 0.5, len(size)) + 0.002
        columns = {"canopy": canopy, "training": training, "fruit": fruit, "hours": hours}
        (row,) = estimate(columns, ("fruit", "hours"), over=("canopy", "training"), of="ratio")
        return row["estimate"].ci95

    repeats.check(draw, 6.0 / (0.012 + 0.002 + 0.002))


@pytest.mark.parametrize(
    ("count", "probability", "most"),
    [(10, 0.5, 0.97), (64, 0.5, 0.97), (64, 0.75, 0.97), (80, 0.95, 0.97), (20, 0.95, 0.985)],
)
def test_quantile(repeats: Any, count: int, probability: float, most: float) -> None:
    """With 20 values the upper end of the 95th percentile is open: one tail less to miss on."""
    found = lambda rng: quantile_interval(np.exp(rng.normal(size=count)), probability)  # noqa: E731
    repeats.check(found, float(np.exp(norm.ppf(probability))), most, share=0.2)


@pytest.mark.parametrize("size", [0.0, 0.1, 0.3, 1.0, 10.0])
@pytest.mark.parametrize("count", [LEAST, CYCLES])
def test_size_of_a_mean(repeats: Any, count: int, size: float) -> None:
    """The accuracy of a pose by ISO 9283, in scatters; near zero the lower end is zero, one tail less to miss on."""
    draw = lambda rng: norm_interval(rng.normal(size=(count, 3)) + np.array([size, 0.0, 0.0]))  # noqa: E731
    repeats.check(draw, size, most=1.0 if size < 1.0 else 0.98, share=0.2, least=0.92)


def test_repeatability_by_iso_9283(repeats: Any) -> None:
    """RP of a scatter that is wider along one axis; its truth is that of two million draws."""
    size = np.array([1.0, 0.5, 0.3, 1.0, 1.0, 1.0]) * 1e-4
    many = np.linalg.norm(np.random.default_rng(1).normal(size=(2_000_000, 3)) * size[:3], axis=1)
    truth = 1e3 * (many.mean() + 3.0 * many.std())
    repeats.check(
        lambda rng: pose_performance("P1", rng.normal(size=(CYCLES, 6)) * size)["repeatability_ci95_mm"],
        truth,
        share=0.2,
    )
