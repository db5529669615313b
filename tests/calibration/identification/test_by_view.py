"""Uncertainty by view against refits without each view, and against truth drawn many times."""

from dataclasses import dataclass

import numpy as np
import pytest

from pickenv.calibration.identification.by_view import jackknife_covariance, shared_rows
from pickenv.calibration.model.measurements import Measurements


@dataclass(frozen=True)
class Given:
    """A data set that says which row each of its equations belongs to."""

    joints: np.ndarray
    rows: np.ndarray

    def equations(self):
        return self.rows, np.zeros_like(self.rows)


def system(rng: np.random.Generator, views: int, each: int, shared: float, own: float, prior: bool = False):
    """A linear model whose equations of one view share errors that are linear in six coordinates, as a pose's are."""
    rows = np.repeat(np.arange(views), each)
    pose = rng.normal(size=(views * each, 6))
    matrix = np.einsum("ij,ijp->ip", pose, rng.normal(size=(views, 6, 4))[rows])
    errors = shared * np.einsum("ij,ij->i", pose, rng.normal(size=(views, 6))[rows]) + own * rng.normal(size=len(rows))
    if prior:
        known = np.array([[0.0, 0.0, 0.0, 5.0]])
        matrix, errors, rows = np.vstack([matrix, known]), np.append(errors, rng.normal()), np.append(rows, -1)
    return matrix, errors, rows


def factor_of(matrix: np.ndarray) -> np.ndarray:
    return np.linalg.inv(np.linalg.qr(matrix, mode="r"))


@pytest.mark.parametrize("prior", [False, True])
def test_it_is_the_scatter_of_refits_that_each_leave_one_view_out(prior: bool) -> None:
    matrix, errors, rows = system(np.random.default_rng(3), 12, 10, 0.3, 0.1, prior)
    whole = np.linalg.lstsq(matrix, errors, rcond=None)[0]
    found = jackknife_covariance(factor_of(matrix), matrix, errors - matrix @ whole, rows)
    moved = np.array([np.linalg.lstsq(matrix[rows != v], errors[rows != v], rcond=None)[0] for v in range(12)]) - whole
    expected = moved.T @ moved * 11 / 12
    if prior:
        inverse = np.linalg.inv(matrix.T @ matrix)
        expected = expected + inverse @ matrix[-1:].T @ matrix[-1:] @ inverse
    assert found == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize(("shared", "own"), [(0.0, 0.2), (0.3, 0.02), (0.2, 0.2)])
def test_truth_lies_within_two_sigma_as_often_as_it_should(shared: float, own: float) -> None:
    """Taken one by one, equations that share errors would promise three times too much."""
    scores, plain = [], []
    for seed in range(150):
        matrix, errors, rows = system(np.random.default_rng(seed), 25, 40, shared, own)
        factor = factor_of(matrix)
        off = np.linalg.lstsq(matrix, errors, rcond=None)[0]
        left = errors - matrix @ off
        scores.append(off / np.sqrt(np.diag(jackknife_covariance(factor, matrix, left, rows))))
        plain.append(off / np.sqrt(left @ left / (len(left) - 4) * np.diag(factor @ factor.T)))
    within = np.mean(np.abs(scores) < 1.96)
    assert 0.92 < within < 0.98
    assert (np.mean(np.abs(plain) < 1.96) < 0.75) == (shared > 0.0)


def test_too_few_views_and_a_view_that_alone_holds_a_parameter_say_nothing() -> None:
    matrix, errors, rows = system(np.random.default_rng(0), 12, 10, 0.1, 0.1)
    assert jackknife_covariance(factor_of(matrix), matrix, errors, np.minimum(rows, 1)) is None
    alone = np.column_stack([matrix, (rows == 3).astype(float)])
    assert jackknife_covariance(factor_of(alone), alone, errors, rows) is None
    wide = np.random.default_rng(1).normal(size=(120, 60))
    assert jackknife_covariance(factor_of(wide), wide, errors, rows) is None


def test_only_rows_of_many_equations_share_them() -> None:
    joints = np.zeros((3, 2))
    pictures = Given(joints, np.append(np.repeat([0, 1, 2], 8), -1))
    poses = Given(joints, np.repeat([0, 1, 2], 6))
    assert shared_rows([poses]) is None
    assert shared_rows([pictures]).tolist() == pictures.rows.tolist()
    both = shared_rows([poses, pictures])
    assert both.tolist() == [*poses.rows, *(np.repeat([3, 4, 5], 8)), -1]
    assert shared_rows([pictures, object()]) is None  # type: ignore[list-item]
    tracked = Measurements(np.zeros((4, 2)), np.zeros((4, 3)), None, (False, False))
    assert shared_rows([tracked]) is None
