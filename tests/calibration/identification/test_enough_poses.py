"""How many equations an identification needs: more than parameters, and twice as many where rows repeat each other."""

import numpy as np
import pytest

from pickenv.base import InputError
from pickenv.calibration import ArmModel, ErrorModel, PeriodicTerm, complete_model, identify, link_model, with_terms


def chosen(geometry, *names):
    """The error model of some parameters."""
    whole = complete_model(geometry)
    some = [whole.names.index(name) for name in names]
    return ErrorModel(whole.columns[some], names, whole.tolerance[some])


def model_arm(geometry, model):
    """The geometry with each of a model's parameters off by its tolerance."""
    delta = np.zeros(len(geometry.parameter_names))
    delta[model.columns] = model.tolerance
    return geometry.displaced(delta)


def repeated(data):
    """The first pose of a set, measured at every row."""
    return data.select(np.zeros(len(data), dtype=np.int64))


@pytest.mark.parametrize(("positions", "poses", "needed"), [(False, 2, 6), (True, 4, 10)], ids=["12 of 16", "12 of 14"])
def test_too_few_equations_are_refused_with_twice_the_poses_they_ask_for(qiao, exact, positions, poses, needed):
    data = exact(qiao.true, poses)
    data = data.positions_only() if positions else data
    with pytest.raises(
        InputError, match=rf"{poses} poses give 12 equations, too few .* measure at least {needed} poses"
    ):
        identify(link_model(qiao.nominal), qiao.nominal, data)


def test_as_many_equations_as_parameters_judge_nothing_and_are_refused(qiao, exact):
    """Three lengths from one position would fit whatever was measured; two positions leave something over."""
    model = chosen(qiao.nominal, "a1", "theta1", "d2")
    one, two = (exact(model_arm(qiao.nominal, model), poses).positions_only() for poses in (1, 2))
    with pytest.raises(InputError, match="1 poses give 3 equations, too few for the 3 parameters"):
        identify(model, qiao.nominal, one)
    found = identify(model, qiao.nominal, two)
    assert found.identifiability.rank == 3 and found.degrees_of_freedom == 3
    np.testing.assert_allclose(found.delta, model.tolerance, rtol=1e-6)


def test_fewer_than_two_equations_for_each_parameter_do_where_they_show_all_of_them(qiao, exact):
    """Six for four."""
    model = chosen(qiao.nominal, "a1", "theta1", "d2", "theta4")
    data = exact(model_arm(qiao.nominal, model), 2).positions_only()
    found = identify(model, qiao.nominal, data)
    assert found.identifiability.rank == 4 and found.degrees_of_freedom == 2
    np.testing.assert_allclose(found.delta, model.tolerance, rtol=1e-6)
    apart = identify(model, qiao.nominal, [data.select([0]), data.select([1])])  # the same in two data sets
    np.testing.assert_allclose(apart.delta, found.delta, rtol=1e-9)


def test_rows_that_repeat_each_other_need_two_for_each_parameter_that_others_would_show(qiao, exact):
    """In one place a turn about J1 looks like a shift; anywhere, base_ry is one about J1 and a shift along z."""
    data = repeated(exact(qiao.true, 2).positions_only())
    with pytest.raises(InputError, match=r"2 poses give 6 equations, too few for the 4 parameters .* at least 3 poses"):
        identify(chosen(qiao.nominal, "base_x", "base_y", "base_z", "theta1", "base_ry"), qiao.nominal, data)
    model = chosen(qiao.nominal, "base_x", "base_z", "theta1", "base_ry")
    assert identify(model, qiao.nominal, data).identifiability.rank == 2


def test_of_several_data_sets_what_they_show_together_counts_and_no_other_pose_is_imagined(qiao, exact):
    """Alone such rows are refused."""
    data = repeated(exact(qiao.true, 2).positions_only())
    model = chosen(qiao.nominal, "base_x", "base_y", "base_z", "theta1", "base_ry")
    apart = identify(model, qiao.nominal, [data.select([0]), data.select([1])])
    assert apart.identifiability.rank == 3


def test_what_terms_would_show_elsewhere_is_not_asked_for(qiao, exact):
    """They may depend on loads that nobody knows there: of an arm with terms its geometry counts."""
    geometry = qiao.nominal
    arm = ArmModel.of(geometry, (PeriodicTerm((1, 2, 4), (5.0, 5.0, 1.0)),))
    data = exact(geometry, 2)
    with pytest.raises(InputError, match="too few for the 16 parameters"):
        identify(with_terms(link_model(geometry), arm), arm, data)


def test_an_arms_terms_are_parameters_after_those_of_its_geometry(qiao):
    arm = ArmModel.of(qiao.nominal, (PeriodicTerm((1, 2, 4), (5.0, 5.0, 1.0)),))
    links = link_model(qiao.nominal)
    model = with_terms(links, arm)
    names = np.array(arm.parameter_names)
    assert model.names == tuple(names[model.columns]) and len(model.columns) == len(links.names) + len(arm.coefficients)
    np.testing.assert_array_equal(model.columns[: len(links.columns)], links.columns)
    np.testing.assert_array_equal(model.tolerance, np.r_[links.tolerance, arm.term_tolerances])
