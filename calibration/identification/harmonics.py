"""Periodic errors of the drives: which orders the joints have, how many of them are real, and how well each is known.

Orthogonal matching pursuit (Pati 1993) on the normal equations with the geometry projected out: of all joints and
orders the one that explains most of what is left, again and again. How many are taken is decided on blocks held out;
then again among finer orders around those taken, of which fewer are needed. At last the orders are refined
by Gauss-Newton together with all other parameters.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pickenv.arm import Geometry, joint_jacobian
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.identification.block_equations import BlockEquations, Linearised, Places, solved
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.model.arm_model import Conditions, Term
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.terms import PeriodicTerm

STEP, HIGHEST = 0.5, 30.0
"""Orders are sought from 1 to the highest, in such steps, cycles per turn."""

FINE = 0.1
"""Steps of the finer grid that those chosen are chosen from again."""

MOST = 40
"""So many harmonics are taken at most."""

ROWS_EACH = 8
"""A harmonic needs so many rows."""

WITHIN = 0.03
"""The fewest harmonics are taken whose error on the blocks is within this share of the smallest."""

ROUNDS = 3
"""Steps of Gauss-Newton that refine the orders."""


@dataclass(frozen=True)
class FoundHarmonic:
    """One harmonic of one joint's drive, identified; with standard uncertainties.

    Attributes:
        joint: The joint, from 0.
        order: Cycles per turn (2 pi over the period, 1/m, of a prismatic joint).
        order_std: Of the order; None where it was given.
        amplitude: rad or m.
        amplitude_std: Of the amplitude.
    """

    joint: int
    order: float
    order_std: float | None
    amplitude: float
    amplitude_std: float


def harmonics_of(found: Identification) -> tuple[FoundHarmonic, ...]:
    """The identified harmonics, the largest first."""
    model, kept = found.arm_model, found.identifiability.kept_names
    place = {name: i for i, name in enumerate(kept)}
    names = model.parameter_names[len(model.geometry.parameter_names) :]
    value = dict(zip(names, model.coefficients, strict=True))
    harmonics = []
    for term in model.terms:
        if not isinstance(term, PeriodicTerm):
            continue
        parts = term.names(model.geometry)
        stds = term.order_std or (None,) * len(term.orders)
        for i, (joint, order, std) in enumerate(zip(term.joints, term.orders, stds, strict=True)):
            pair = parts[2 * i : 2 * i + 2]
            wave = np.array([value[name] for name in pair])
            amplitude = float(np.hypot(*wave))
            known = [k for k, name in enumerate(pair) if name in place]
            rows = [place[pair[k]] for k in known]
            slope = wave[known] / max(amplitude, 1e-300)
            variance = float(slope @ found.covariance[np.ix_(rows, rows)] @ slope)
            harmonics.append(FoundHarmonic(joint, order, std, amplitude, float(np.sqrt(variance))))
    return tuple(sorted(harmonics, key=lambda item: -item.amplitude))


def every_order(geometry: Geometry) -> PeriodicTerm:
    """All harmonics that may be chosen, of all revolute joints."""
    orders = np.arange(1.0, HIGHEST + STEP / 2, STEP).tolist()
    pairs = [(i, order) for i in range(geometry.joints) if not geometry.prismatic[i] for order in orders]
    return PeriodicTerm(tuple(i for i, _ in pairs), tuple(order for _, order in pairs))


def nearby(wave: PeriodicTerm) -> PeriodicTerm:
    """Harmonics on a finer grid around these, each once."""
    pairs = sorted(
        {
            (joint, round(order + FINE * k, 6))
            for joint, order in zip(wave.joints, wave.orders, strict=True)
            for k in range(-2, 3)
        }
    )
    return PeriodicTerm(tuple(i for i, _ in pairs), tuple(order for _, order in pairs))


def pursued(matrix: Array, right: Array, base: Places, candidates: Places, most: int) -> list[int]:
    """Numbers of the candidates chosen by orthogonal matching pursuit, in the order in which they were.

    A block Cholesky factorisation of the normal equations with pivots: each candidate is a pair of columns.

    Args:
        matrix: Normal equations ``(P, P)``, priors among them.
        right: Their right-hand side ``(P,)``.
        base: Places of the columns that take part anyway.
        candidates: Places of sine and cosine of each candidate ``(M, 2)``.
        most: How many to choose.
    """
    pairs = candidates.ravel()
    scale = np.sqrt(np.diag(matrix)[base])
    lower = np.linalg.cholesky(matrix[np.ix_(base, base)] / np.outer(scale, scale) + 1e-12 * np.eye(len(base)))
    done = np.linalg.solve(lower, matrix[np.ix_(base, pairs)] / scale[:, None])
    left = right[pairs] - done.T @ np.linalg.solve(lower, right[base] / scale)
    sines, cosines = slice(0, None, 2), slice(1, None, 2)
    diagonal = np.diag(matrix)[pairs] - (done**2).sum(axis=0)
    across = matrix[pairs[sines], pairs[cosines]] - (done[:, sines] * done[:, cosines]).sum(axis=0)
    chosen: list[int] = []
    free = np.full(len(candidates), True)
    for _ in range(most):
        a, c, u, v = diagonal[sines], diagonal[cosines], left[sines], left[cosines]
        determinant = np.where(free, np.maximum(a * c - across**2, 1e-9 * a * c), np.inf)
        explained = np.where(free, (c * u * u - 2.0 * across * u * v + a * v * v) / determinant, -np.inf)
        best = int(np.argmax(explained))
        chosen.append(best)
        free[best] = False
        two = [2 * best, 2 * best + 1]
        rows = matrix[np.ix_(pairs[two], pairs)] - done[:, two].T @ done
        corner = np.linalg.cholesky(rows[:, two])
        new, explains = np.linalg.solve(corner, rows), np.linalg.solve(corner, left[two])
        left = left - new.T @ explains
        diagonal = diagonal - (new**2).sum(axis=0)
        across = across - new[0, sines] * new[0, cosines] - new[1, sines] * new[1, cosines]
        done = np.vstack([done, new])
    return chosen


def chosen_orders(equations: BlockEquations, base: Places, candidates: Places) -> tuple[list[Places], Places]:
    """Places of the harmonics worth taking: on all blocks but each, and on all; empty where none is.

    Each block in turn is judged by what is pursued on the others, one harmonic after the other; the fewest are taken
    whose error is within `WITHIN` of the smallest.

    Args:
        equations: Normal equations of geometry, other terms and every harmonic.
        base: Places of the columns that take part anyway.
        candidates: Places of sine and cosine of each harmonic ``(M, 2)``.
    """
    rows = sum(len(block.joints) for block in equations.blocks)
    most = min(MOST, rows // ROWS_EACH, len(candidates))
    squares, paths = np.zeros(most + 1), []
    for block in range(len(equations.blocks)):
        matrix, right = equations.without(block)
        path = candidates[pursued(matrix, right, base, candidates, most)]
        for count in range(most + 1):
            solution = solved(matrix, right, np.r_[base, path[:count].ravel()])
            squares[count] += equations.left(block, solution)
        paths.append(path)
    rms = np.sqrt(np.abs(squares))  # of nothing but rounding a sum may be negative
    count = int(np.flatnonzero(rms <= (1.0 + WITHIN) * rms.min())[0])
    whole = candidates[pursued(*equations.without(None), base, candidates, count)]
    return [path[:count].ravel() for path in paths], whole.ravel()


@dataclass(frozen=True)
class _OrderTerm:
    """How the tool moves as a harmonic's order does: J q (sine coefficient cos(order q) - cosine coefficient sin)."""

    wave: PeriodicTerm
    sines: tuple[float, ...]
    cosines: tuple[float, ...]

    def names(self, geometry: Geometry) -> tuple[str, ...]:
        return tuple(f"order{i}" for i in range(len(self.wave.orders)))

    def tolerances(self, geometry: Geometry) -> Array:
        """Half the grid's step."""
        return np.full(len(self.wave.orders), STEP / 2)

    def columns(self, geometry: Geometry, joints: Array, conditions: Conditions) -> Array:
        chosen = list(self.wave.joints)
        turned = joints[:, chosen]
        angle = turned * np.array(self.wave.orders)
        slope = turned * (np.array(self.sines) * np.cos(angle) - np.array(self.cosines) * np.sin(angle))
        return np.asarray(joint_jacobian(geometry, joints)[..., chosen] * slope[:, None])


def refined(
    wave: PeriodicTerm, others: tuple[Term, ...], bare: Identification, observations: Observations
) -> PeriodicTerm:
    """The harmonics with their orders moved from the grid to where the data want them, and known how well.

    Args:
        wave: The harmonics on the grid.
        others: Terms that take part beside them.
        bare: The geometry identified without any.
        observations: Training rows.
    """
    grid = orders = np.array(wave.orders)
    std = np.zeros(len(grid))
    for _ in range(ROUNDS):
        wave = PeriodicTerm(wave.joints, tuple(orders.tolist()))
        linear = Linearised.of(bare, (*others, wave))
        solution = solved(*_all_equations(linear, observations)) * linear.scale
        sines, cosines = solution[linear.coefficients_of(len(others))].reshape(-1, 2).T.tolist()
        linear = Linearised.of(bare, (*others, wave, _OrderTerm(wave, tuple(sines), tuple(cosines))))
        matrix, right, everything = _all_equations(linear, observations)
        solution = solved(matrix, right, everything)
        places = linear.coefficients_of(len(others) + 1)
        orders = np.clip(orders + (solution * linear.scale)[places], grid - 0.48 * FINE, grid + 0.48 * FINE)
        columns, left = linear.equations(observations)
        remains = left - columns @ solution
        spare = max(len(left) - len(matrix), 1)
        scale = np.sqrt(np.diag(matrix))
        inverse = np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale)
        std = (np.sqrt(np.diag(inverse) * (remains @ remains) / spare) * linear.scale)[places]
    return PeriodicTerm(wave.joints, tuple(orders.tolist()), tuple(std.tolist()))


def _all_equations(linear: Linearised, observations: Observations) -> tuple[Array, Array, Places]:
    """Normal equations of all rows, with priors, and the places of all parameters."""
    matrix, right = BlockEquations.of(linear, [observations]).without(None)
    return matrix, right, np.arange(len(right))
