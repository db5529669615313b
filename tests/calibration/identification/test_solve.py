"""The one solve: where rows tell, it is least squares; where they do not, the drawing; its covariance is honest."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Plant, draw_plants, forward, load_arm, load_tolerances, plant_at, rotation_matrix
from pickenv.calibration import complete_model, identify, prior_model, random_joints, simulated_tracker
from pickenv.calibration.identification.solve import solve
from pickenv.calibration.model.noise_and_priors import ANGLES, LENGTHS, ZEROS, stated_noise
from pickenv.calibration.pipeline.calibration import PoseUncertainty

ARM = load_arm("ur5")
UR5 = ARM.nominal
EVERYWHERE = random_joints(UR5, 200, np.random.default_rng(99))


def arms_of(kind, count, seed):
    drawn = draw_plants(Plant("ur5", ARM, UR5), load_tolerances(kind), count, np.random.default_rng(seed))
    return [plant_at(drawn, i) for i in range(count)]


def measured(plant, joints, rng):
    """Rows of a tracker with the noise that is assumed of one."""
    rows = simulated_tracker(plant, joints, rng)
    turn = rotation_matrix(rows.attitude_std * rng.standard_normal((len(joints), 3)))
    place = rows.position + rows.position_std * rng.standard_normal((len(joints), 3))
    return replace(rows, position=place, rotation=turn @ rows.rotation)


def rows_of(plant, count, seed):
    rng = np.random.default_rng(seed)
    return measured(plant, random_joints(UR5, count, rng), rng)


def error(geometry, plant):
    """RMS position error of a geometry against the arm, over the whole joint ranges, m."""
    return float(
        np.sqrt(
            np.mean(
                np.sum((forward(geometry, EVERYWHERE).position - forward(plant.geometry, EVERYWHERE).position) ** 2, 1)
            )
        )
    )


def test_where_rows_tell_everything_it_is_least_squares():
    """Two hundred poses of a tracker: the priors move no prediction by a tenth of what least squares is unsure of."""
    (plant,) = arms_of("cobot", 1, 0)
    rows = rows_of(plant, 200, 1)
    plain = identify(complete_model(UR5), UR5, rows)
    solution = solve(prior_model("ur5", UR5, known=True), rows)
    apart = forward(plain.geometry, EVERYWHERE).position - forward(solution.geometry, EVERYWHERE).position
    assert np.sqrt(np.mean(np.sum(apart**2, 1))) < 0.1 * max(error(plain.geometry, plant), 1e-6) + 2e-6


def test_what_rows_do_not_tell_stays_at_the_drawing():
    """Rows of one pose move what they can; parameters are known no better than before, but for one pose's worth."""
    (plant,) = arms_of("cobot", 1, 2)
    rows = rows_of(plant, 1, 3)
    many = rows.select(np.zeros(30, dtype=int))
    solution = solve(prior_model("ur5", UR5, known=True, scale=1.0), many)
    assert solution.converged and solution.spent < 6.5
    assert error(solution.geometry, plant) < 1.05 * error(UR5, plant)


@pytest.mark.parametrize("count", [3, 5, 8, 20])
def test_it_is_never_worse_than_the_drawing(count):
    """Ten arms, few rows: over the whole joint ranges no arm ends worse than drawn by more than a tenth."""
    for i, plant in enumerate(arms_of("cobot", 10, 4)):
        solution = solve(prior_model("ur5", UR5, known=True), rows_of(plant, count, 10 + i))
        assert error(solution.geometry, plant) < 1.1 * error(UR5, plant)


def stated_covariance(solution, joints):
    """What the posterior states of the tool's pose."""
    known = PoseUncertainty(solution.identifiability.kept_names, solution.covariance, 0.0, 0.0)
    return known.pose_covariance(solution.arm_model, joints)


def squared_ratio(plant, solution):
    """Squared error everywhere, as a share of what the posterior states."""
    stated = stated_covariance(solution, EVERYWHERE)
    missed = forward(plant.geometry, EVERYWHERE).position - forward(solution.geometry, EVERYWHERE).position
    return np.sum(missed**2) / np.trace(stated[:, :3, :3], axis1=1, axis2=2).sum()


def corner_of(plant, count, rng):
    """Rows of a tracker in a corner of the joint ranges."""
    return measured(plant, UR5.lower + 0.2 * rng.random((count, 6)) * (UR5.upper - UR5.lower), rng)


def test_its_covariance_is_honest_far_from_the_rows():
    """Forty arms by twelve poses in a corner of the joint ranges: squared errors everywhere are as large as stated."""
    ratios = []
    for i, plant in enumerate(arms_of("cobot", 40, 5)):
        rows = corner_of(plant, 12, np.random.default_rng(100 + i))
        ratios.append(squared_ratio(plant, solve(prior_model("ur5", UR5, known=True, scale=1.0), rows)))
    assert 0.7 < np.mean(ratios) < 1.35


@pytest.mark.slow
def test_it_is_honest_of_arms_made_three_times_better_or_worse_than_expected():
    """Zeros, lengths and angles of each of 180 arms scatter by another factor, and four rows do not tell which.

    Where the likeliest factors are taken as certain, squared errors are a third larger than stated.
    """
    factors, ratios = np.exp(np.log(3.0) * np.random.default_rng(6).standard_normal((180, 3))), []
    model = prior_model("ur5", UR5, known=True)
    for i, factor in enumerate(factors):
        rng = np.random.default_rng([6, i])
        scales = dict(zip((ZEROS, LENGTHS, ANGLES), factor, strict=True))
        change = np.zeros(len(UR5.parameter_names))
        change[model.parameters.columns] = replace(model, scales=scales).width * rng.standard_normal(len(model.std))
        plant = Plant("ur5", ARM, UR5.displaced(change))
        ratios.append(squared_ratio(plant, solve(model, corner_of(plant, 4, rng))))
    assert 0.85 < np.mean(ratios) < 1.2


def test_the_rows_say_how_well_parts_are_made():
    """Arms of a class ten times finer, or coarser, than expected move the scale of its widths towards theirs."""
    scales = {}
    for kind in ("fine", "printed"):
        found = [solve(prior_model("ur5", UR5, known=True), rows_of(p, 60, 7)).prior for p in arms_of(kind, 4, 6)]
        scales[kind] = {name: np.mean([prior.scales[name] for prior in found]) for name in (ZEROS, LENGTHS, ANGLES)}
    assert scales["fine"][ZEROS] < 0.3 < 2.0 < scales["printed"][ZEROS]
    assert scales["fine"][ANGLES] < 0.3 < 2.0 < scales["printed"][ANGLES] and scales["fine"][LENGTHS] < 0.5


def test_rows_that_state_no_noise_get_theirs():
    """A camera's poses read as a tracker's: the answer is the one of the noise that they have."""
    (plant,) = arms_of("cobot", 1, 8)
    rows, rng = rows_of(plant, 40, 9), np.random.default_rng(10)
    rough = replace(rows, position=rows.position + 1e-3 * rng.standard_normal(rows.position.shape), rotation=None)
    told = replace(rough, position_std=1e-3, std_stated=True)
    one, other = (solve(prior_model("ur5", UR5, known=True), data) for data in (rough, told))
    assert one.noise.channels[0] * rough.position_std == pytest.approx(1e-3, rel=0.2)
    assert error(one.geometry, plant) == pytest.approx(error(other.geometry, plant), rel=0.1)


def test_errors_that_neighbours_share_widen_what_is_stated():
    """What a model cannot say is alike nearby: taken as independent, its parameters would be known far too well."""
    (plant,) = arms_of("cobot", 1, 11)
    rng = np.random.default_rng(12)
    joints = UR5.lower + (0.5 + 0.1 * rng.random((150, 6))) * (UR5.upper - UR5.lower)
    rows = measured(plant, joints, rng)
    waves = np.sin(joints @ (rng.standard_normal((6, 3)) * 3.0))
    alike = replace(rows, position=rows.position + 3e-4 * waves, rotation=None)
    mixed = replace(rows, position=rows.position + 3e-4 * rng.permutation(waves), rotation=None)
    one, other = (solve(prior_model("ur5", UR5, known=True, scale=1.0), data) for data in (alike, mixed))
    assert one.noise.share > 0.3 and one.noise.common > 2.0 and other.noise.common < one.noise.common / 2
    stated = [np.trace(stated_covariance(found, joints)[:, :3, :3], axis1=1, axis2=2).mean() for found in (one, other)]
    assert stated[0] > 1.5 * stated[1]


def test_noise_that_is_given_is_not_sought():
    rows = rows_of(arms_of("cobot", 1, 13)[0], 30, 14)
    solution = solve(prior_model("ur5", UR5, known=True), rows, stated_noise(rows))
    assert solution.noise.channels.tolist() == [1.0, 1.0] and solution.converged
