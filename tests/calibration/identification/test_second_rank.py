"""Data with unknowns of their own: their rank is judged again where the unknowns end."""

import numpy as np
import pytest

from pickenv.arm import forward, load_arm
from pickenv.calibration import DistanceObservations, complete_model, identify, link_model, random_joints
from pickenv.calibration.identification import least_squares
from pickenv.calibration.identification.least_squares import Progress
from pickenv.calibration.model.arm_model import ArmModel


@pytest.fixture(scope="module")
def wire():
    """A draw wire at a UR5 that is its nominal one but for two link lengths."""
    nominal = load_arm("ur5").nominal
    joints = random_joints(nominal, 120, np.random.default_rng(0))
    delta = np.zeros(len(nominal.parameter_names))
    delta[[nominal.parameter_names.index(name) for name in ("a2", "d4")]] = 1e-3, -5e-4
    there = forward(nominal.displaced(delta), joints).position
    return nominal, DistanceObservations(joints, np.linalg.norm(there - np.array([1.5, -2.0, 0.3]), axis=1), 2e-5)


@pytest.fixture
def ranks(monkeypatch):
    """What each judgement of the rank was asked and said; ``hidden`` names are dropped by the first."""
    asked, real = [], least_squares.identifiable_parameters

    def judge(model, sets, arm, unknowns, matrix, names, tolerance, *rest):
        seen = matrix.copy()
        seen[:, [name in judge.hidden[len(asked)] for name in names]] = 0.0
        asked.append(
            (arm, [part.copy() for part in unknowns], real(model, sets, arm, unknowns, seen, names, tolerance))
        )
        return asked[-1][-1]

    judge.hidden, judge.asked = [(), ()], asked
    monkeypatch.setattr(least_squares, "identifiable_parameters", judge)
    return judge


def test_a_parameter_that_only_the_unknowns_found_show_is_taken_in(wire, ranks):
    """Judged the second time of the arm as it started, with the anchor where it was found."""
    nominal, data = wire
    ranks.hidden = [("d4", "a2"), ()]
    found = identify(complete_model(nominal), nominal, [data])
    (_, _, first), (arm, unknowns, second) = ranks.asked
    assert arm.geometry is nominal and first.rank < second.rank
    np.testing.assert_allclose(unknowns[0], [1.5, -2.0, 0.3], atol=0.1)
    assert np.abs(unknowns[0] - data.start(ArmModel.of(nominal))).max() > 1e-4
    assert found.identifiability is second and found.converged
    assert found.chi_square < 1e-6 * found.degrees_of_freedom
    assert found.degrees_of_freedom == 120 - second.rank and len(found.covariance) == second.rank


@pytest.mark.parametrize("hidden", [[(), ()], [(), ("d4", "a2")]], ids=["as much", "less"])
def test_what_shows_no_more_the_second_time_stays_as_it_was_judged_first(wire, ranks, hidden):
    nominal, data = wire
    ranks.hidden = hidden
    found = identify(complete_model(nominal), nominal, [data])
    assert len(ranks.asked) == 2 and found.converged and found.identifiability is ranks.asked[0][-1]


def test_what_has_no_unknowns_is_judged_once(qiao, exact, ranks):
    assert identify(link_model(qiao.nominal), qiao.nominal, exact(qiao.true, 20)).converged and len(ranks.asked) == 1


@pytest.mark.parametrize("most", [1, 4])
def test_until_it_is_judged_again_and_after_it_there_are_as_many_steps(wire, qiao, exact, monkeypatch, most):
    monkeypatch.setattr(least_squares, "judged_step", lambda *_: Progress(1.0, False, True, False))
    nominal, data = wire
    found = identify(complete_model(nominal), nominal, [data], max_iterations=most)
    assert len(found.iterates) == 1 + 2 * most and not found.converged
    found = identify(link_model(qiao.nominal), qiao.nominal, exact(qiao.true, 20), max_iterations=most)
    assert len(found.iterates) == 1 + most and not found.converged
