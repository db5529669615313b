"""Choice of an arm's parametric terms, by cross-validation over contiguous blocks of the training rows.

Gravity terms (joint deflection under the arm's own weight) and harmonics of the drives need no data sheet, so they can
be tried on any arm. Compliance can be tried if torques were measured. Terms extrapolate; a learnt residual only
interpolates. A term that does not reduce the cross-validated error is left out.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Arm, Array, Geometry
from pickenv.base import InputError
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.identification.solve import solve
from pickenv.calibration.model.arm_model import ArmModel, Term
from pickenv.calibration.model.noise_and_priors import counted, expected_sizes, prior_model
from pickenv.calibration.model.observations import Observations, contiguous_folds, same_poses
from pickenv.calibration.model.terms import OrderTerm, PeriodicTerm, ThermalTerm, bending_of, weight_of

# Least squares on contiguous blocks of rows at once: normal equations of all columns that may take part, by block.
# Near a fitted geometry everything that may be added is linear, so the equations of the rows without a block are
# those of all rows less the block's own. Any choice of columns is then fitted, and judged on the block left out, by
# small matrices alone. Rows are whitened; coefficients are in their tolerances, with their prior.

Places = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Linearised:
    """A linear model of the residual of a fitted geometry, with terms that may be added to the geometry.

    The model's parameters are first the fitted parameters (of the geometry, and unknowns of the measurements), then the
    terms' coefficients.

    Attributes:
        arm: The fitted geometry and the terms, all coefficients zero.
        unknowns: Fitted unknowns of the measurements, by name.
        names: Names of the parameters.
        scale: Factor on each parameter's column ``(P,)``, so that coefficients are in units of their tolerances.
        ridge: The priors' addition to the normal equations' diagonal ``(P,)``.
        pull: The priors' addition to the right-hand side ``(P,)``; it is not zero if fitted parameters differ from
            their priors' means.
        blocks: Contiguous blocks of training rows; each block is held out once.
    """

    arm: ArmModel
    unknowns: dict[str, float]
    names: tuple[str, ...]
    scale: Array
    ridge: Array
    pull: Array
    blocks: tuple[Observations, ...] = ()

    @staticmethod
    def of(bare: Identification, terms: tuple[Term, ...], blocks: Sequence[Observations] = ()) -> Linearised:
        """Return the linear model of terms that are added to a geometry identified without them.

        Args:
            bare: The identification without terms.
            terms: The terms.
            blocks: Contiguous blocks of training rows.
        """
        arm, fitted = ArmModel.of(bare.geometry, terms), bare.identifiability.kept_names
        names = fitted + arm.parameter_names[len(bare.geometry.parameter_names) :]
        scale = np.r_[np.ones(len(fitted)), arm.term_tolerances]
        of_fitted = (bare.scatter / bare.prior_std[bare.identifiability.kept]) ** 2
        ridge = np.r_[of_fitted, (bare.scatter / expected_sizes(arm)) ** 2]
        change = np.zeros(0) if bare.prior is None else bare.prior.start.difference(bare.arm_model)
        change_of = dict(zip(bare.geometry.parameter_names, change.tolist(), strict=False))
        offset = np.array([change_of.get(name, 0.0) for name in fitted])
        pull = np.r_[-of_fitted * offset, np.zeros(len(scale) - len(offset))]
        return Linearised(arm, bare.unknowns, names, scale, ridge, pull, tuple(blocks))

    @property
    def fitted(self) -> Places:
        """Indices, from 0, of the parameters that are not terms' coefficients."""
        return np.arange(len(self.names) - len(self.arm.coefficients))

    def coefficients_of(self, term: int) -> Places:
        """Return the indices, among the parameters, of the coefficients of the term with index ``term`` (from 0)."""
        ends = np.cumsum([len(self.fitted), *(len(member.names(self.arm.geometry)) for member in self.arm.terms)])
        return np.arange(ends[term], ends[term + 1])

    def equations(self, data: Observations) -> tuple[Array, Array]:
        """Return the equations of a data set, linearised at the fitted geometry.

        Args:
            data: The rows, which give R equations.

        Returns:
            Whitened derivatives with respect to the parameters, times `scale` ``(R, P)``, and the whitened residual
            ``(R,)``.
        """
        unknowns = data.unknowns()
        values = np.array([self.unknowns[name] for name in unknowns])
        by_arm, by_unknown = data.jacobian(self.arm, values)
        first, count = len(self.fitted), len(self.arm.geometry.parameter_names)
        place = {name: i for i, name in enumerate(unknowns + self.arm.geometry.parameter_names)}
        places = [place[name] for name in self.names[:first]]
        columns = np.hstack([np.hstack([by_unknown, by_arm])[:, places], by_arm[:, count:]])
        return np.ascontiguousarray(columns) * self.scale, data.residual(self.arm, values)

    @cached_property
    def normal(self) -> tuple[Array, Array, Array]:
        """Normal equations of each of B blocks of rows: A^T A ``(B, P, P)``, A^T r ``(B, P)`` and r^T r ``(B,)``.

        A and r are the derivatives and the residual of a block, from `equations`.
        """
        parts = [self.equations(block) for block in self.blocks]
        matrix = np.stack([columns.T @ columns for columns, _ in parts])
        right = np.stack([residual @ columns for columns, residual in parts])
        return matrix, right, np.array([residual @ residual for _, residual in parts])

    def without(self, block: int | None) -> tuple[Array, Array]:
        """Return the normal equations, with priors, of all blocks of rows but one.

        Args:
            block: Index, from 0, of the block that is left out; with None all blocks are included.

        Returns:
            Matrix ``(P, P)`` and right-hand side ``(P,)``.
        """
        of_each, right_of_each, _ = self.normal
        matrix, right = of_each.sum(axis=0), right_of_each.sum(axis=0)
        if block is not None:
            matrix, right = matrix - of_each[block], right - right_of_each[block]
        return matrix + np.diag(self.ridge), right + self.pull

    def misses(self, data: Observations, solution: Array) -> Array:
        """Return misses (measured minus predicted) of the data ``(R, 3)`` or ``(R, 1)``, m, after a change.

        ``solution`` is the change of the parameters ``(P,)``, divided by `scale`.
        """
        change = defaultdict(float, zip(self.names, solution * self.scale, strict=True))
        terms = tuple(term for i, term in enumerate(self.arm.terms) if solution[self.coefficients_of(i)].any())
        arm = ArmModel.of(self.arm.geometry, terms)
        arm = arm.displaced(np.array([change[name] for name in arm.parameter_names]))
        return data.misses(arm, np.array([self.unknowns[name] + change[name] for name in data.unknowns()]))


def left_of(normal: tuple[Array, Array, Array], block: int, solution: Array) -> float:
    """Return the sum of squared residuals of one block of rows after a change of the parameters.

    Args:
        normal: The normal equations of all blocks of rows (`Linearised.normal`).
        block: Index of the block, from 0.
        solution: Change of the parameters ``(P,)``, divided by `Linearised.scale`.
    """
    matrix, right, square = normal
    slope = matrix[block] @ solution - 2.0 * right[block]
    return float(square[block] + solution @ slope)


def solved(matrix: Array, right: Array, places: Places) -> Array:
    """Return the solution ``(P,)`` of normal equations for some parameters; it is zero for all other parameters.

    Args:
        matrix: Matrix ``(P, P)``.
        right: Right-hand side ``(P,)``.
        places: Indices, from 0, of the parameters to solve for.
    """
    scale = np.sqrt(np.diag(matrix)[places])
    small = matrix[np.ix_(places, places)] / np.outer(scale, scale) + 1e-12 * np.eye(len(places))
    solution = np.zeros(len(right))
    solution[places] = np.linalg.solve(small, right[places] / scale) / scale
    return solution


# Periodic errors of the drives: which orders the joints have, how many of them are real, and how well each is known.
# Orthogonal matching pursuit (Pati 1993) on the normal equations with the geometry projected out: of all joints and
# orders the one that explains most of what is left, again and again. How many are taken is decided on blocks held
# out; then again among finer orders around those taken, of which fewer are needed. At last the orders are refined by
# Gauss-Newton together with all other parameters.


STEP, HIGHEST = 0.5, 30.0
"""Step and highest value of the grid of orders, which starts at 1, cycles per turn."""

FINE = 0.1
"""Step of the finer grid around the chosen orders, cycles per turn; orders are chosen again from this grid."""

MOST = 40
"""Largest number of harmonics that are chosen."""

ROWS_EACH = 8
"""Number of rows needed for each harmonic."""

WITHIN = 0.03
"""Share by which the error on held-out blocks may exceed the least error, so that fewer harmonics are taken."""

Harmonic = tuple[int, float, float | None, float, float]
"""An identified harmonic of a joint's drive: joint, order, uncertainty of the order, amplitude, uncertainty of the
amplitude. The joint is an index from 0. The order is in cycles per turn (for a prismatic joint 2 pi over the period,
1/m). Its standard uncertainty is None if the order was given. The amplitude and its standard uncertainty are in rad or
m."""


def harmonics_of(found: Identification) -> list[Harmonic]:
    """Return the identified harmonics, in order of decreasing amplitude."""
    model, fitted = found.arm_model, found.identifiability.kept_names
    names = model.parameter_names[len(model.geometry.parameter_names) :]
    value = dict(zip(names, model.coefficients, strict=True))
    harmonics: list[Harmonic] = []
    for term in (term for term in model.terms if isinstance(term, PeriodicTerm)):
        stds = term.order_std or (None,) * len(term.orders)
        pairs = np.reshape(term.names(model.geometry), (-1, 2)).tolist()
        for pair, joint, order, std in zip(pairs, term.joints, term.orders, stds, strict=True):
            amplitude = float(np.hypot(*(value[name] for name in pair)))
            parts = [name for name in pair if name in fitted]
            rows = [fitted.index(name) for name in parts]
            slope = np.array([value[name] for name in parts]) / max(amplitude, 1e-300)
            variance = float(slope @ found.covariance[np.ix_(rows, rows)] @ slope)
            harmonics.append((joint, order, std, amplitude, float(np.sqrt(variance))))
    return sorted(harmonics, key=lambda item: -item[3])


def every_order(geometry: Geometry) -> PeriodicTerm:
    """Return a term with all candidate harmonics: orders from 1 to `HIGHEST` in steps of `STEP`, per revolute joint."""
    orders = np.arange(1.0, HIGHEST + STEP / 2, STEP).tolist()
    return _harmonics([(i, order) for i in range(geometry.joints) if not geometry.prismatic[i] for order in orders])


def nearby(wave: PeriodicTerm) -> PeriodicTerm:
    """Return a term of the harmonics on a finer grid around the harmonics of ``wave``, without repetitions."""
    around = zip(wave.joints, wave.orders, strict=True)
    return _harmonics(sorted({(joint, round(order + FINE * k, 6)) for joint, order in around for k in range(-2, 3)}))


def _harmonics(pairs: Sequence[tuple[int, float]]) -> PeriodicTerm:
    """Return a term of the harmonics in ``pairs``, each a joint (index from 0) and an order."""
    return PeriodicTerm(tuple(i for i, _ in pairs), tuple(order for _, order in pairs))


def pursued(matrix: Array, right: Array, base: Places, candidates: Places, most: int) -> list[int]:
    """Return indices, from 0, of the candidates chosen by orthogonal matching pursuit, in the order of their choice.

    The method is a pivoted block Cholesky factorisation of the normal equations, in which each candidate is a pair of
    columns.

    Args:
        matrix: Normal equations ``(P, P)``, priors among them.
        right: Right-hand side of the normal equations ``(P,)``.
        base: Indices, from 0, of the columns that are always included.
        candidates: Indices, from 0, of each candidate's sine and cosine columns ``(M, 2)``.
        most: Number of candidates to choose.
    """
    pairs = candidates.ravel()
    scale = np.sqrt(np.diag(matrix)[base])
    lower = np.linalg.cholesky(matrix[np.ix_(base, base)] / np.outer(scale, scale) + 1e-12 * np.eye(len(base)))
    done = np.linalg.solve(lower, matrix[np.ix_(base, pairs)] / scale[:, None])
    residual = right[pairs] - done.T @ np.linalg.solve(lower, right[base] / scale)
    sines, cosines = slice(0, None, 2), slice(1, None, 2)
    diagonal = np.diag(matrix)[pairs] - (done**2).sum(axis=0)
    across = matrix[pairs[sines], pairs[cosines]] - (done[:, sines] * done[:, cosines]).sum(axis=0)
    numbers: list[int] = []
    free = np.full(len(candidates), True)
    for _ in range(most):
        a, c, u, v = diagonal[sines], diagonal[cosines], residual[sines], residual[cosines]
        determinant = np.where(free, np.maximum(a * c - across**2, 1e-9 * a * c), np.inf)
        explained = np.where(free, (c * u * u - 2.0 * across * u * v + a * v * v) / determinant, -np.inf)
        best = int(np.argmax(explained))
        numbers.append(best)
        free[best] = False
        two = [2 * best, 2 * best + 1]
        rows = matrix[np.ix_(pairs[two], pairs)] - done[:, two].T @ done
        corner = np.linalg.cholesky(rows[:, two])
        new, explains = np.linalg.solve(corner, rows), np.linalg.solve(corner, residual[two])
        residual = residual - new.T @ explains
        diagonal = diagonal - (new**2).sum(axis=0)
        across = across - new[0, sines] * new[0, cosines] - new[1, sines] * new[1, cosines]
        done = np.vstack([done, new])
    return numbers


def chosen_orders(equations: Linearised, base: Places, candidates: Places) -> tuple[list[Places], Places]:
    """Choose harmonics: once without each block of rows, and once on all blocks.

    For each block held out, harmonics are chosen one after the other on all other blocks, and judged on this block. The
    number of harmonics is the smallest one whose error exceeds the least error by at most the share `WITHIN`.

    Args:
        equations: Normal equations of geometry, other terms and every candidate harmonic.
        base: Indices, from 0, of the columns that are always included.
        candidates: Indices, from 0, of the sine and cosine columns of each candidate ``(M, 2)``.

    Returns:
        Indices, from 0, of the columns of the chosen harmonics: a list with an array for each block held out, then an
        array for all blocks. All arrays are empty if no harmonic reduces the error.
    """
    of_each, right_of_each, squares_of_each = equations.normal
    most = min(MOST, sum(len(block.joints) for block in equations.blocks) // ROWS_EACH, len(candidates))
    squares, paths = np.zeros(most + 1), []
    for block in range(len(equations.blocks)):
        matrix, right = equations.without(block)
        path = candidates[pursued(matrix, right, base, candidates, most)]
        places = np.r_[base, path.ravel()]
        matrix, right = matrix[np.ix_(places, places)], right[places]
        few = of_each[:, places[:, None], places], right_of_each[:, places], squares_of_each
        for count in range(most + 1):
            squares[count] += left_of(few, block, solved(matrix, right, np.arange(len(base) + 2 * count)))
        paths.append(path)
    rms = np.sqrt(np.abs(squares))  # of nothing but rounding a sum may be negative
    count = int(np.flatnonzero(rms <= (1.0 + WITHIN) * rms.min())[0])
    all_places = candidates[pursued(*equations.without(None), base, candidates, count)]
    return [path[:count].ravel() for path in paths], all_places.ravel()


def refined(
    wave: PeriodicTerm, others: tuple[Term, ...], bare: Identification, observations: Observations
) -> PeriodicTerm:
    """Return the harmonics with orders refined by the data, and with the uncertainties of the orders.

    Args:
        wave: The harmonics, with orders on the grid.
        others: Other terms, which are fitted together with the harmonics.
        bare: The geometry identified without terms.
        observations: Training rows.
    """
    grid = orders = np.array(wave.orders)
    std = np.zeros(len(grid))
    for _ in range(3):  # Gauss-Newton steps
        wave = PeriodicTerm(wave.joints, tuple(orders.tolist()))
        linear = Linearised.of(bare, (*others, wave))
        solution = _solution_with_priors(linear, observations)[-1]
        sines, cosines = (solution * linear.scale)[linear.coefficients_of(len(others))].reshape(-1, 2).T.tolist()
        linear = Linearised.of(bare, (*others, wave, OrderTerm(wave, tuple(sines), tuple(cosines))))
        columns, residual, matrix, solution = _solution_with_priors(linear, observations)
        places = linear.coefficients_of(len(others) + 1)
        orders = np.clip(orders + (solution * linear.scale)[places], grid - 0.48 * FINE, grid + 0.48 * FINE)
        remains = residual - columns @ solution
        spare = max(len(residual) - len(matrix), 1)
        scale = np.sqrt(np.diag(matrix))
        inverse = np.linalg.inv(matrix / np.outer(scale, scale)) / np.outer(scale, scale)
        std = (np.sqrt(np.diag(inverse) * (remains @ remains) / spare) * linear.scale)[places]
    return PeriodicTerm(wave.joints, tuple(orders.tolist()), tuple(std.tolist()))


def _solution_with_priors(linear: Linearised, observations: Observations) -> tuple[Array, Array, Array, Array]:
    """Solve the linear model for all rows, with priors.

    Returns:
        Four arrays. The first is the matrix ``(R, P)`` of the rows' equations. The second is their right side ``(R,)``.
        The third is the matrix ``(P, P)`` of the normal equations, priors included. The last is the solution ``(P,)``.
    """
    columns, residual = linear.equations(observations)
    matrix = columns.T @ columns + np.diag(linear.ridge)
    return columns, residual, matrix, solved(matrix, residual @ columns + linear.pull, np.arange(len(matrix)))


MARGIN = 0.03
"""Terms must cut the cross-validated RMS by more than this share."""

ROWS = 1500
"""Largest number of training rows, equally spaced, on which terms are chosen."""

WARM = 5.0
"""Range of temperatures, K, above which thermal expansion is tried."""

NAMES = ("compliance", "bending", "gravity", "periodic", "thermal")
"""Terms that can be chosen, in the order of trial; terms that need torques or masses come before gravity."""


TermChoice = tuple[str, dict[str, float], tuple[Term, ...]]
"""Result of `choose_terms`: names of the chosen terms (some of `NAMES` joined by "+", or "none"), RMS misses, and the
terms. There is one cross-validated RMS miss, m, for each combination of terms that was tried; the key is its names."""


def identify_terms(
    terms: tuple[Term, ...], bare: Identification, observations: Observations, known: bool = False
) -> Identification:
    """Identify geometry and terms together, starting from a geometry that was identified without terms.

    The geometry keeps its priors, and the terms' coefficients have priors of their own.

    Args:
        terms: The terms.
        bare: The identification without the terms.
        observations: The rows.
        known: Whether base and tool are known; it counts only if ``bare`` was identified without priors.
    """
    model = bare.prior or prior_model("", bare.geometry, known=known, fit="full")
    return solve(model.with_terms(terms), observations, near=bare)


def choose_terms(arm: Arm, bare: Identification, observations: Observations) -> TermChoice:
    """Choose terms by blocked cross-validation within training rows, which are in the order of measurement.

    Terms are tried one after the other in the order of `NAMES`. A term is added only if it cuts the RMS error with the
    terms chosen so far by more than the share `MARGIN`. The order matters: on the measured grid of a WAM arm, harmonics
    alone score better than gravity alone, but extrapolate worse. If gravity and harmonics are chosen, gravity is kept
    only if the chosen terms without gravity have a larger error, by the same margin.

    Args:
        arm: The arm.
        bare: Its geometry, identified without terms.
        observations: Training rows.
    """
    trial = _Trial.of(arm, bare, observations)
    taken: tuple[str, ...] = ()
    scores = {"none": trial.score(())}

    def wins(wider: tuple[str, ...], than: tuple[str, ...]) -> bool:
        scores.update({_joined(names): trial.score(names) for names in (wider, than) if _joined(names) not in scores})
        return scores[_joined(wider)] < (1.0 - MARGIN) * scores[_joined(than)]

    temperature = observations.conditions.temperature
    warm = temperature is not None and float(np.ptp(temperature)) > WARM
    for name in trial.names:
        if (name != "thermal" or warm) and wins((*taken, name), taken):
            taken = (*taken, name)
    if set(taken) >= {"gravity", "periodic"}:
        lighter = tuple(name for name in taken if name != "gravity")
        if not wins(taken, lighter):
            taken = lighter
    return _joined(taken), scores, trial.terms(taken)


def terms_of(names: str, arm: Arm, bare: Identification, observations: Observations) -> tuple[Term, ...]:
    """Return the terms of these names, with as many harmonics as the training rows support.

    Args:
        names: Some of `NAMES` joined by "+", or "none".
        arm: The arm.
        bare: Its geometry, identified without terms.
        observations: Training rows.

    Raises:
        InputError: If a name is unknown or given twice. Also if compliance is named and neither torques nor the links'
            masses are known, or if bending is named and the masses are unknown.
    """
    requested = [name for name in names.split("+") if name != "none"]
    for name in requested:
        if requested.count(name) > 1:
            raise InputError(f"terms '{names}' name {name} more than once; name each term once")
        if name not in NAMES:
            raise InputError(f"unknown terms '{name}'; give auto, none, or some of {', '.join(NAMES)} joined by +")
        if name == "compliance" and not _torques_known(arm, observations):
            raise InputError(
                f"{observations.source}: compliance needs the joints' measured torques, or the masses of the arm's "
                "links; name columns in [conditions.torques], give a file with masses, or `terms='gravity'`"
            )
        if name == "bending" and arm.load is None:
            raise InputError("bending needs the masses of the links; give an arm file with masses, or leave it out")
    if "periodic" not in requested:
        return tuple(plain_term(name, arm, observations) for name in requested)
    return _Trial.of(arm, bare, observations, tuple(requested)).terms(tuple(requested))


def plain_term(name: str, arm: Arm, observations: Observations) -> Term:
    """Return the term of this name.

    Args:
        name: One of `NAMES`. The term "periodic" has all candidate harmonics.
        arm: The arm. "bending" takes the weight of the arm's masses, as does "compliance" without measured torques.
        observations: The rows, whose measured torques "compliance" takes.
    """
    geometry = arm.nominal
    if name == "periodic":
        return every_order(geometry)
    if name == "thermal":
        return ThermalTerm()
    payload = observations.conditions.payload
    weight = weight_of(geometry, payload is not None and float(np.ptp(payload)) > 0)
    if name == "gravity":
        return weight
    if name == "bending" and arm.load is not None:
        return bending_of(arm)
    if observations.conditions.torque is None and arm.load is not None:
        return weight.with_masses(geometry, arm.load)
    return weight.weighed(geometry, observations.joints, observations.conditions)


def _torques_known(arm: Arm, observations: Observations) -> bool:
    """Return whether torques were measured, or can be computed from the masses of the arm's links."""
    return observations.conditions.torque is not None or arm.load is not None


@dataclass(frozen=True, eq=False)
class _Trial:
    """Terms on trial, in blocks of the training rows.

    Attributes:
        bare: The geometry, identified without terms.
        data: The rows.
        names: Names of the terms.
        equations: Normal equations of geometry and terms by block.
        counts: Weights of each block's rows ``(N,)``, smaller for rows of a cluster, because their errors are alike.
        harmonics: Results of `chosen_orders`, by the names of the terms taken together; `places` adds them.
    """

    bare: Identification
    data: Observations
    names: tuple[str, ...]
    equations: Linearised
    counts: tuple[Array, ...]
    harmonics: dict[tuple[str, ...], tuple[list[Places], Places]] = field(default_factory=dict)

    @staticmethod
    def of(arm: Arm, bare: Identification, observations: Observations, names: tuple[str, ...] | None = None) -> _Trial:
        """Return a trial of the terms ``names``, some of `NAMES`; if None, of all terms that arm and data allow."""
        data = observations.at_most(ROWS)
        if names is None:
            missing = {
                "bending": arm.load is None,
                "compliance": not _torques_known(arm, data),
                "thermal": data.conditions.temperature is None,
            }
            names = tuple(name for name in NAMES if not missing.get(name))
        folds = [fold for _, fold in contiguous_folds(data.groups, same_poses(data.joints), folds=5)]
        every = counted(data.joints)
        terms = tuple(plain_term(name, arm, data) for name in names)
        equations = Linearised.of(bare, terms, [data.select(fold) for fold in folds])
        return _Trial(bare, data, names, equations, tuple(every[fold] for fold in folds))

    def places(self, names: tuple[str, ...]) -> tuple[list[Places], Places]:
        """Return indices, from 0, of the parameters that are fitted with the terms ``names``.

        Returns:
            A list with the indices for each block of rows left out, then the indices for all blocks together.
        """
        model = self.equations
        others = [model.coefficients_of(self.names.index(name)) for name in names if name != "periodic"]
        base = np.concatenate([model.fitted, *others])
        if "periodic" not in names:
            return [base] * len(self.equations.blocks), base
        if names not in self.harmonics:
            every = model.coefficients_of(self.names.index("periodic")).reshape(-1, 2)
            self.harmonics[names] = chosen_orders(self.equations, base, every)
        paths, on_all = self.harmonics[names]
        return [np.r_[base, path] for path in paths], np.r_[base, on_all]

    def score(self, names: tuple[str, ...]) -> float:
        """Compute the RMS miss, m, over all blocks with the named terms.

        The misses of each block come from a fit to all other blocks.
        """
        squares, counts = 0.0, 0.0
        for number, (block, places) in enumerate(zip(self.equations.blocks, self.places(names)[0], strict=True)):
            missed = self.equations.misses(block, solved(*self.equations.without(number), places))
            count = self.counts[number][block.rows_of_misses]
            squares, counts = squares + float(count @ np.sum(missed**2, axis=1)), counts + float(count.sum())
        return float(np.sqrt(squares / counts))

    def terms(self, names: tuple[str, ...]) -> tuple[Term, ...]:
        """Return the terms of these names, with the orders of the harmonics refined."""
        terms = {name: self.equations.arm.terms[self.names.index(name)] for name in names}
        if "periodic" in names:
            wave = terms.pop("periodic")
            assert isinstance(wave, PeriodicTerm)
            others, every = tuple(terms.values()), self.equations.coefficients_of(self.names.index("periodic"))
            wave = wave.some((np.intersect1d(self.places(names)[1], every)[::2] - every[0]) // 2)
            if wave.orders:
                near = nearby(wave)
                fine = Linearised.of(self.bare, (*others, near), self.equations.blocks)
                places = fine.coefficients_of(len(others))
                _, fine_places = chosen_orders(fine, np.arange(places[0]), places.reshape(-1, 2))
                wave = near.some(np.sort(fine_places[::2] - places[0]) // 2)
                if wave.orders:
                    terms["periodic"] = refined(wave, others, self.bare, self.data)
        return tuple(terms[name] for name in names if name in terms)


def _joined(names: tuple[str, ...]) -> str:
    """Return names joined by "+", or "none" if there are none."""
    return "+".join(names) or "none"
