"""What calibration says about what a data set can tell (Qiao 2026 eqs (9)-(10), and the facts behind them)."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pickenv.arm import Array, Geometry, Pose, load_arm
from pickenv.calibration import (
    ArmModel,
    ErrorModel,
    Identifiability,
    Measurements,
    complete_model,
    frames_model,
    identifiability,
    link_model,
)

PAPER_DROPS = {"a2", "a3", "a5", "d3", "d4", "theta2", "d6"}


def scaled_jacobian(model: ErrorModel, geometry: Geometry, data: Measurements) -> Array:
    return data.jacobian(ArmModel.of(geometry), np.zeros(0))[0][:, model.columns] * model.tolerance


def analysed(model: ErrorModel, geometry: Geometry, data: Measurements) -> Identifiability:
    return identifiability(scaled_jacobian(model, geometry, data), model.names, model.tolerance, len(data))


def some_of(model: ErrorModel, names: set[str]) -> ErrorModel:
    rows = [i for i, name in enumerate(model.names) if name in names]
    return ErrorModel(model.columns[rows], tuple(model.names[i] for i in rows), model.tolerance[rows])


def test_poses_tell_16_of_the_24_link_parameters(qiao, exact):
    found = analysed(link_model(qiao.nominal), qiao.nominal, exact(qiao.nominal))
    assert (len(found.names), found.rank, len(found.dropped)) == (24, 16, 8)


def test_poses_tell_15_of_the_papers_17(qiao, exact):
    """The paper keeps the collinear pairs (d1, d2) and (theta5, theta6)."""
    model = link_model(qiao.nominal)
    found = analysed(some_of(model, set(model.names) - PAPER_DROPS), qiao.nominal, exact(qiao.nominal))
    assert (len(found.names), found.rank) == (17, 15)
    assert found.dropped == {
        "d2": pytest.approx({"d1": 1.0}),
        "theta6": pytest.approx({"theta5": 1.0}),
    }


def test_positions_tell_14(qiao, exact):
    assert analysed(link_model(qiao.nominal), qiao.nominal, exact(qiao.nominal).positions_only()).rank == 14


def test_poses_tell_24_of_the_complete_model(qiao, exact):
    """4 R + 2 P + 6 for three revolute and three prismatic joints."""
    assert analysed(complete_model(qiao.nominal), qiao.nominal, exact(qiao.nominal)).rank == 24


@pytest.mark.parametrize(("target", "rank"), [((0, 0, 0), 19), ((0, 0, 0.08), 19), ((0.05, 0, 0), 21)])
def test_positions_tell_more_of_the_complete_model_off_the_twist_axis(qiao, exact, target, rank):
    geometry = replace(qiao.nominal, tool=Pose(np.array(target, dtype=float), np.eye(3)))
    assert analysed(complete_model(geometry), geometry, exact(geometry).positions_only()).rank == rank


@pytest.mark.parametrize(("name", "rank"), [("ur5", 4 * 6 + 6), ("wam", 4 * 7 + 6)])
def test_poses_tell_4r_and_6_of_a_revolute_arm(exact, name, rank):
    geometry = load_arm(name).nominal
    assert analysed(complete_model(geometry), geometry, exact(geometry)).rank == rank


def test_parallel_axes_bring_hayatis_beta(qiao):
    assert {n for n in complete_model(load_arm("ur5").nominal).names if n.startswith("beta")} == {"beta2", "beta3"}
    assert {n for n in complete_model(qiao.nominal).names if n.startswith("beta")} == {"beta1", "beta5"}
    assert len(frames_model(qiao.nominal).names) == 12


def test_each_dropped_parameter_names_what_absorbs_it(qiao, exact):
    """d3 = (theta2 - theta1) / 138 mm, so theta2 = theta1 + 138 mm d3 (per rad); the others are plain twins."""
    found = analysed(link_model(qiao.nominal), qiao.nominal, exact(qiao.nominal))
    assert found.dropped == {
        "a2": pytest.approx({"a1": 1.0}),
        "a3": pytest.approx({"a1": 1.0}),
        "a5": pytest.approx({"a4": 1.0}),
        "d2": pytest.approx({"d1": 1.0}),
        "d4": pytest.approx({"d1": 1.0}),
        "d6": pytest.approx({"d5": 1.0}),
        "theta6": pytest.approx({"theta5": 1.0}),
        "theta2": pytest.approx({"theta1": 1.0, "d3": 0.138}),
    }


def test_a_parameter_without_effect_is_absorbed_by_nothing(exact):
    geometry = load_arm("ur5").nominal
    found = analysed(complete_model(geometry), geometry, exact(geometry).positions_only())
    assert {"tool_rx", "tool_ry", "tool_rz"} <= {name for name, absorbed in found.dropped.items() if not absorbed}


@pytest.fixture(scope="module")
def scaled(qiao, exact):
    model = link_model(qiao.nominal)
    return model, scaled_jacobian(model, qiao.nominal, exact(qiao.nominal, 40))


@given(order=st.permutations(range(24)))
@settings(max_examples=50, deadline=None)
def test_the_count_does_not_depend_on_the_order_and_absorption_is_exact(scaled, order):
    model, matrix = scaled
    order = np.array(order)
    names, tolerance, columns = [model.names[i] for i in order], model.tolerance[order], matrix[:, order]
    found = identifiability(columns, tuple(names), tolerance, 40)
    assert found.rank == 16
    column = {name: columns[:, i] / tolerance[i] for i, name in enumerate(names)}
    for dropped, absorbed in found.dropped.items():
        explained = sum(share * column[name] for name, share in absorbed.items())
        np.testing.assert_allclose(explained, column[dropped], atol=1e-9 * np.abs(column[dropped]).max())
    # An earlier parameter of a tied group is preferred.
    assert all(min(map(names.index, absorbed)) < names.index(name) for name, absorbed in found.dropped.items())


def test_phi_is_eq_10_and_marks_the_redundant_ones(scaled):
    model, matrix = scaled
    found = identifiability(matrix, model.names, model.tolerance, 40)
    diagonal = np.abs(np.diag(np.linalg.qr(matrix[:, found.kept], mode="r")))
    np.testing.assert_allclose(found.r_diagonal[found.kept], diagonal, rtol=1e-9)
    ratio = found.r_diagonal / found.r_diagonal.mean()
    marked = {name for name, phi in zip(found.names, ratio, strict=True) if phi < 0.05}
    assert marked == set(found.dropped)


def test_condition_and_kept_names_belong_to_the_base_set(scaled):
    model, matrix = scaled
    found = identifiability(matrix, model.names, model.tolerance, 40)
    assert found.singular_values[0] / found.singular_values[-1] == pytest.approx(np.linalg.cond(matrix[:, found.kept]))
    assert set(found.kept_names) == set(model.names) - set(found.dropped)
    assert len(found.singular_values) == 16


def test_the_verdict_does_not_depend_on_the_number_of_poses(qiao, exact):
    few, many = (analysed(link_model(qiao.nominal), qiao.nominal, exact(qiao.nominal, n)) for n in (8, 2000))
    assert few.rank == many.rank == 16
    assert few.singular_values[0] == pytest.approx(many.singular_values[0], rel=0.3)
