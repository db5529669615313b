"""The Gaussian process is the textbooks', and its likelihood search ends no worse than scikit-learn's."""

import warnings
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel

from pickenv.arm import Plant
from pickenv.calibration import identify, link_model, random_joints, simulated_tracker
from pickenv.calibration.residuals import gaussian_process
from pickenv.calibration.residuals.gaussian_process import (
    AMPLITUDES,
    LENGTH_SCALES,
    NOISES,
    GaussianProcess,
    negative_log_likelihood,
)
from pickenv.calibration.residuals.residual_models import joint_inputs

LIMIT_MM = 0.06
"""Mean position error allowed on the paper's arm; where the process takes all for noise, 0.35 is left."""
LIKELIHOOD_TOLERANCE = 0.5
"""Nats: optima this near are told apart by nothing that the rows say."""


@dataclass(frozen=True, eq=False)
class Arm:
    """What least squares leaves of one simulated arm: 200 rows to learn from, 1000 to judge by; m and rad."""

    inputs: np.ndarray
    targets: np.ndarray
    later: np.ndarray
    truth: np.ndarray

    def error_mm(self, predicted: np.ndarray) -> float:
        """Mean position error that remains."""
        return float(np.linalg.norm((self.truth - predicted)[:, :3], axis=1).mean() * 1e3)


@cache
def arm_after_least_squares(plant: Plant, seed: int) -> Arm:
    """100 poses for geometry, 200 for the residual, as in the paper; least squares alone leaves 0.5 mm mean.

    The target sits truly in all three sets: a mounting of its own in each would be judged as the process's error.
    """
    rng, nominal = np.random.default_rng(seed), plant.arm.nominal
    assert plant.effect("measurement_noise") is not None
    plant = plant.with_effect(replace(plant.effect("measurement_noise"), centring_std=0.0))
    sets = [simulated_tracker(plant, random_joints(nominal, n, rng), rng) for n in (100, 200, 1000)]
    geometry = identify(link_model(nominal), nominal, sets[0]).geometry
    inputs = joint_inputs(sets[1].joints, nominal.prismatic)
    return Arm(
        inputs(sets[1].joints), sets[1].difference(geometry), inputs(sets[2].joints), sets[2].difference(geometry)
    )


def standardised(targets: np.ndarray) -> np.ndarray:
    return (targets - targets.mean(axis=0)) / targets.std(axis=0)


def hyper_parameters(process: GaussianProcess, output: int) -> np.ndarray:
    """Logarithms of amplitude, length scales and noise, as `negative_log_likelihood` takes them."""
    return np.log([process.amplitude[output], *process.length_scales[output], process.noise[output]])


def likelihoods(process: GaussianProcess, arm: Arm) -> np.ndarray:
    """Negative log marginal likelihood of each output, nats; less is better."""
    scaled = standardised(arm.targets)
    outputs = range(scaled.shape[1])
    return np.array(
        [negative_log_likelihood(hyper_parameters(process, j), arm.inputs, scaled[:, j])[0] for j in outputs]
    )


@cache
def with_all_rows(plant: Plant, seed: int) -> GaussianProcess:
    """The process of `fitted`, which nothing changes, fitted once for all tests of this arm."""
    return fitted(arm_after_least_squares(plant, seed))


def fitted(arm: Arm, **changes: int) -> GaussianProcess:
    return GaussianProcess.fit(arm.inputs, arm.targets, np.random.default_rng(0), **changes)


def referees(arm: Arm, restarts: int) -> list[GaussianProcessRegressor]:
    """scikit-learn's processes, one per output: the same kernel and bounds, its own optimiser and restarts."""
    squared = [tuple(bound**2 for bound in bounds) for bounds in (AMPLITUDES, NOISES)]
    kernel = ConstantKernel(1.0, squared[0]) * RBF(np.ones(arm.inputs.shape[1]), LENGTH_SCALES)
    referee = GaussianProcessRegressor(
        kernel + WhiteKernel(0.25, squared[1]), alpha=1e-10, n_restarts_optimizer=restarts, random_state=0
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it says when a length scale ends at its bound
        return [clone(referee).fit(arm.inputs, target) for target in standardised(arm.targets).T]


def test_the_gaussian_process_is_the_textbooks() -> None:
    """Likelihood, its gradient, and mean agree with scikit-learn's for the same kernel."""
    rng = np.random.default_rng(0)
    inputs = rng.normal(size=(80, 3))
    target = np.sin(inputs[:, 0]) + 0.3 * inputs[:, 1] + 0.1 * rng.normal(size=80)
    ours = GaussianProcess.fit(inputs, target[:, None], rng)
    scaled = standardised(target)
    kernel = ConstantKernel(ours.amplitude[0] ** 2) * RBF(ours.length_scales[0]) + WhiteKernel(ours.noise[0] ** 2)
    theirs = GaussianProcessRegressor(kernel, optimizer=None, alpha=1e-10).fit(inputs, scaled)
    later = rng.normal(size=(40, 3))
    mean = theirs.predict(later)
    np.testing.assert_allclose(ours.predict(later)[:, 0], mean * target.std() + target.mean(), atol=1e-6)
    theta = hyper_parameters(ours, 0)
    value, slope = negative_log_likelihood(theta, inputs, scaled)
    assert value == pytest.approx(-theirs.log_marginal_likelihood_value_, rel=1e-6)
    for k in range(5):
        step = np.zeros(5)
        step[k] = 1e-5
        ahead, behind = (negative_log_likelihood(theta + s * step, inputs, scaled)[0] for s in (1, -1))
        assert slope[k] == pytest.approx((ahead - behind) / 2e-5, abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [2, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (0, 1, 3, 4))])
def test_the_papers_arm_keeps_a_few_hundredths_of_a_millimetre(dynamic: Plant, seed: int) -> None:
    """A search that began on a third of the rows left 0.36 and 0.35 mm at seeds 2 and 4."""
    arm = arm_after_least_squares(dynamic, seed)
    assert arm.error_mm(with_all_rows(dynamic, seed).predict(arm.later)) <= LIMIT_MM


def test_its_likelihood_is_no_worse_than_scikit_learns(dynamic: Plant) -> None:
    """Of x; of all positions and attitudes in the thorough form below."""
    arm = arm_after_least_squares(dynamic, 2)
    arm = replace(arm, targets=arm.targets[:, :1])
    theirs = [-referee.log_marginal_likelihood_value_ for referee in referees(arm, restarts=0)]
    assert np.all(likelihoods(with_all_rows(dynamic, 2), arm) <= np.array(theirs) + LIKELIHOOD_TOLERANCE)


@pytest.mark.slow
@pytest.mark.parametrize(("output", "nats"), [(1, 10.0), pytest.param(3, 1.0, marks=pytest.mark.slow)])
def test_more_starts_find_optima_that_one_misses_and_never_lose_one(
    dynamic: Plant, monkeypatch: pytest.MonkeyPatch, output: int, nats: float
) -> None:
    """Of five arms: y, where one start takes detail for noise, and an attitude small beside its noise."""
    arms = [arm_after_least_squares(dynamic, seed) for seed in range(5)]
    arms = [replace(arm, targets=arm.targets[:, output : output + 1]) for arm in arms]
    several = np.array([likelihoods(fitted(arm), arm) for arm in arms])
    monkeypatch.setattr(gaussian_process, "PLAIN_STARTS", gaussian_process.PLAIN_STARTS[:1])
    one = np.array([likelihoods(fitted(arm, starts=0), arm) for arm in arms])
    assert np.all(several <= one + 0.01)  # two ways to one optimum
    assert np.max(one - several) > nats


def test_where_some_rows_show_noise_alone_all_rows_have_the_last_word(
    dynamic: Plant, monkeypatch: pytest.MonkeyPatch
) -> None:
    """40 rows leave the process ignorant; it still ends as well as with all rows for every start."""
    arm = arm_after_least_squares(dynamic, 1)
    arm = replace(arm, targets=arm.targets[:, :2])
    every = likelihoods(fitted(arm), arm)
    monkeypatch.setattr(gaussian_process, "START_ROWS", 40)
    few = likelihoods(fitted(arm), arm)
    np.testing.assert_allclose(few, every, atol=LIKELIHOOD_TOLERANCE)


def test_the_same_rows_and_generator_give_the_same_process(dynamic: Plant) -> None:
    arm = arm_after_least_squares(dynamic, 1)
    arm = replace(arm, inputs=arm.inputs[:80], targets=arm.targets[:80, :2])
    first, second = fitted(arm).arrays(), fitted(arm).arrays()
    for name, values in first.items():
        np.testing.assert_array_equal(values, second[name])


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(20))
def test_scikit_learn_as_referee_on_twenty_arms(dynamic: Plant, seed: int) -> None:
    """Error within 2 % of scikit-learn's, which restarts its own search twice, and a likelihood no worse."""
    arm = arm_after_least_squares(dynamic, seed)
    process, others = fitted(arm), referees(arm, restarts=2)
    theirs = np.column_stack([other.predict(arm.later) for other in others])
    error = arm.error_mm(process.predict(arm.later))
    assert error <= LIMIT_MM
    assert error <= 1.02 * arm.error_mm(theirs * arm.targets.std(axis=0) + arm.targets.mean(axis=0))
    best = np.array([-other.log_marginal_likelihood_value_ for other in others])
    assert np.all(likelihoods(process, arm) <= best + LIKELIHOOD_TOLERANCE)
