"""Grade a calibration: the verdict, and the errors, observability and tests behind it.

The chi^2 test asks whether the model explains the residuals up to the stated noise: s^2 = r^T W r / (N - p) is
compared with 1. Units: mm and degrees in outputs, SI inside.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from pickenv.arm import Array, Geometry, forward
from pickenv.calibration.assessment.screen import Block, figure
from pickenv.calibration.identification.diagnosis import Weight
from pickenv.calibration.identification.least_squares import Identification, observability
from pickenv.calibration.model.arm_model import ArmModel, frames_model
from pickenv.calibration.model.noise_and_priors import FRAMES
from pickenv.calibration.model.observations import MISS_UNITS, Rows, equally_spaced

OPTIMISTIC = 1.5
"""Ratio of held-out errors to training errors above which the fit does not generalise to other poses."""

SIGNIFICANCE = 0.05
"""Significance level of the tests."""

SAME = 1e-9
"""Range of the gains (reductions of the error), as a share of the largest gain, up to which they count as equal."""

ALIKE = 1.2
"""Ratio of two errors below which they count as equal."""

AXES = ("x", "y", "z", "rx", "ry", "rz")

MANY_NOISES = 20.0
"""Ratio of residuals to the stated noise above which noise cannot be their cause."""

NOT_CONVERGED = "the identification did not converge, so its parameters mean nothing"

ENOUGH, SEVERAL = 3, 10
"""Least numbers of held-out rows: to judge a calibration, and to accept a gain that only all rows together show."""

Grade = Literal["good", "with care", "do not use"]


@dataclass(frozen=True)
class Completeness:
    """The chi^2 test of whether model and stated noise explain the residuals.

    Attributes:
        chi_square: Sum of squared residuals, each divided by its stated standard uncertainty.
        degrees_of_freedom: Number of equations minus number of parameters.
        p_value: Probability of a chi^2 at least this large if the model is complete and the noise as stated.
        p_small: Probability of a chi^2 at most this small if the model is complete and the noise as stated.
        noise: Words for the noise in sentences, such as "stated noise"; they say whether it is stated or assumed.
    """

    chi_square: float
    degrees_of_freedom: int
    p_value: float
    p_small: float
    noise: str = "stated noise"

    @property
    def reduced(self) -> float:
        """chi^2 per degree of freedom; 1 is expected. NaN without degrees of freedom."""
        return self.chi_square / self.degrees_of_freedom if self.degrees_of_freedom > 0 else float("nan")

    @property
    def complete(self) -> bool:
        """Whether the residuals are no larger than the stated noise explains, at the level `SIGNIFICANCE`."""
        return self.p_value >= SIGNIFICANCE

    def sentence(self) -> str:
        """Return the result of the test as a sentence."""
        if self.degrees_of_freedom <= 0:
            return "there are no spare equations, so the model cannot be tested"
        figures = f"reduced chi^2 {self.reduced:.3g}, {self.degrees_of_freedom} degrees of freedom"
        if not self.complete:
            return (
                f"what remains is {np.sqrt(self.reduced):.2g} times the {self.noise} ({figures}): effects beyond the "
                "model are left, or that noise is too small"
            )
        if self.p_small < SIGNIFICANCE / 2:
            return f"what remains is smaller than the {self.noise} ({figures}), which is probably too large"
        return f"what remains is the {self.noise} ({figures}, p = {self.p_value:.2g}): the model is complete for it"


def completeness(found: Identification, noise: str = "stated noise") -> Completeness:
    """Apply the chi^2 test to an identification; ``noise`` names the noise in sentences, such as "stated noise"."""
    test = found.chi_square, found.degrees_of_freedom  # without spare equations SciPy's law gives NaN
    return Completeness(*test, float(stats.chi2.sf(*test)), float(stats.chi2.cdf(*test)), noise)


def axis_errors(errors: Array, unit: str = "mm") -> dict[str, tuple[float, float, float, float]]:
    """Compute statistics of the errors along each axis.

    Args:
        errors: Errors of poses ``(N, 6)``, m and rad, of positions ``(N, 3)`` or of lengths ``(N, 1)``, m.
        unit: "deg" if ``errors`` are misses of directions ``(N, 1 to 3)``, rad; else "mm".

    Returns:
        For each axis, with its unit in the name, such as "x (mm)": the signed mean (bias), the standard deviation, the
        root mean square and the largest absolute value.
    """
    axes = ("r1", "r2", "r3") if unit == "deg" else AXES if errors.shape[1] > 1 else ("length",)
    statistics = {}
    for axis, column in zip(axes, errors.T, strict=False):
        unit_of_axis = "deg" if axis.startswith("r") else "mm"
        column = column * MISS_UNITS[unit_of_axis]
        mean, std, rms, most = column.mean(), column.std(), np.sqrt(np.mean(column**2)), np.abs(column).max()
        statistics[f"{axis} ({unit_of_axis})"] = float(mean), float(std), float(rms), float(most)
    return statistics


# How far off the arm is where it will work: expected errors over a declared workspace, of drawing and calibration. The
# posterior says how far the parameters may be from where the fit has them; draws from it are as many arms as the rows
# allow. Each arm's error is its distance from what the calibration, and what the drawing, says of it. Where base and
# tool were fitted, what they could take up is no error of the arm: it is projected out. What one reach scatters by
# comes on top. SI units inside, mm on screens.


POSES = 400
"""Largest number of measured poses that represent the measured region."""

DRAWS = 400
"""Number of arms that are drawn from the posterior."""

SURE = 0.95
"""Share of drawn arms that must be nearer to the calibrated than to the nominal geometry for a gain to be certain."""

HARDLY = 0.5
"""Ratio of the geometry's expected error to the held-out RMS error below which the geometry's error is negligible."""

LITTLE = 0.2
"""Share by which the expected error must decrease by measuring; below it, the rows add too little information."""


@dataclass(frozen=True)
class RegionError:
    """Expected errors of an arm over one region: RMS of the tool's position error, m.

    They are computed over arms that are drawn from the posterior, that is arms that agree with the measured rows.

    Attributes:
        region: Name of the region.
        calibrated: Expected error of the calibrated geometry.
        calibrated_ends: 95 % interval of the calibrated geometry's error over the drawn arms.
        nominal: Expected error of the nominal geometry.
        nominal_ends: 95 % interval of the nominal geometry's error over the drawn arms.
        expected: Expected error of arms of the tolerance class before measuring.
        better: Share of the drawn arms that are nearer to the calibrated than to the nominal geometry.
    """

    region: str
    calibrated: float
    calibrated_ends: tuple[float, float]
    nominal: float
    nominal_ends: tuple[float, float]
    expected: float
    better: float

    @property
    def narrowed(self) -> float:
        """Share by which the calibrated geometry's expected error is smaller than `expected`, 0 to 1."""
        return float(np.clip(1.0 - self.calibrated / max(self.expected, 1e-300), 0.0, 1.0))

    @property
    def gain(self) -> float:
        """Share of the nominal geometry's expected error that the calibration removes."""
        return 1.0 - self.calibrated / max(self.nominal, 1e-300)

    def as_dict(self) -> dict[str, Any]:
        """Return the expected errors, in mm, as values for JSON and a calibration's record."""
        mm = {"calibrated_rms_mm": self.calibrated, "nominal_rms_mm": self.nominal, "prior_rms_mm": self.expected}
        ends = {"calibrated_ci95_mm": self.calibrated_ends, "nominal_ci95_mm": self.nominal_ends}
        sizes = {name: value * 1e3 for name, value in mm.items()}
        intervals = {name: [value * 1e3 for value in pair] for name, pair in ends.items()}
        shares = {"gain": self.gain, "narrowed": self.narrowed, "better": self.better}
        return {"region": self.region, **sizes, **intervals, **shares}


@dataclass(frozen=True)
class Workspace:
    """Expected errors where rows were measured, and in the declared workspace, where the arm will work.

    Attributes:
        measured: Expected errors at the joints of the measured rows.
        declared: Expected errors over the declared workspace.
        thin: Names of joints whose measured range covers less than half of their range in the declared workspace.
        remains: RMS error on held-out rows, m. It is the error of one reach, and the geometry causes only part of it.
    """

    measured: RegionError
    declared: RegionError
    thin: tuple[str, ...] = ()
    remains: float = 0.0

    @property
    def reservation(self) -> str | None:
        """A sentence that says why the calibration is unreliable in the declared workspace; None if it is reliable."""
        over = self.declared
        if over.calibrated < HARDLY * self.remains:
            return None
        remedy = "measure poses there (`pickenv plan-poses`), or declare where the arm will work with `workspace`"
        if self.thin:
            remedy = f"move {', '.join(self.thin)} further, or declare where the arm will work with `workspace`"
        if over.narrowed < LITTLE:
            return (
                f"over {over.region} the rows tell hardly more than the drawing ({figure(over.calibrated * 1e3)} mm "
                f"expected, {figure(over.expected * 1e3)} mm before measuring); {remedy}"
            )
        if over.better < SURE:
            return (
                f"over {over.region} the calibrated arm ({figure(over.calibrated * 1e3)} mm expected) is better than "
                f"the drawing ({figure(over.nominal * 1e3)} mm) for {100 * over.better:.0f} % of the arms that the "
                f"rows allow; {remedy}"
            )
        return None

    def block(self) -> Block:
        """Return the expected errors as a table."""
        rows = []
        for region in (self.measured, self.declared):
            sizes = (
                f"{figure(value * 1e3)} ({figure(ends[0] * 1e3)} to {figure(ends[1] * 1e3)})"
                for value, ends in ((region.nominal, region.nominal_ends), (region.calibrated, region.calibrated_ends))
            )
            rows.append((region.region, *sizes, f"{100 * region.gain:.0f} %", f"{100 * region.narrowed:.0f} %"))
        heads = ("over", "nominal (mm)", "calibrated (mm)", "gain", "told by the rows")
        note = "RMS of what geometry errs by, 95 % interval over the arms that the rows allow; scatter comes on top"
        return Block("Expected errors of the tool", heads, tuple(rows), note)

    def as_dict(self) -> dict[str, Any]:
        """Return both regions' expected errors and the reservation as values for JSON and a calibration's record."""
        regions = {"measured": self.measured.as_dict(), "declared": self.declared.as_dict()}
        return regions | {"reservation": self.reservation}


def workspace_error(
    solution: Identification,
    nominal: Geometry,
    rows: Array,
    joints: Array,
    region: str = "the joint limits",
    remains: float = 0.0,
    between: NDArray[np.int64] | None = None,
) -> Workspace | None:
    """Compute expected errors at the measured joints and over a workspace.

    The result is None if the parameters have no priors. Random draws have a fixed seed, so equal inputs give equal
    results.

    Args:
        solution: The least-squares solution, whose parameters have priors.
        nominal: The nominal geometry. If base and tool were fitted, it has the fitted ones.
        rows: Measured joints ``(N, n)``, rad or m.
        joints: Joints that represent the workspace ``(M, n)``, rad or m.
        region: Name of the workspace.
        remains: RMS error on held-out rows, m.
        between: For a whole robot (a tree of links), indices of the two links between which each row was measured
            ``(N, 2)``, from 0, with -1 for the world. The workspace's joints are assigned to the same pairs in turn.
    """
    if solution.prior is None or not solution.prior.proper:
        return None
    measured, declared = (np.ptp(np.quantile(poses, [0.02, 0.98], axis=0), axis=0) for poses in (rows, joints))
    thin = tuple(nominal.joint_names[i] for i in np.flatnonzero(measured < 0.5 * declared))
    some = equally_spaced(len(rows), POSES)
    ways = np.full((1, 2), -1) if between is None else np.unique(between, axis=0)
    whole = np.resize(ways, (len(joints), 2))
    here = _region("the poses measured", solution, nominal, rows[some], ways if between is None else between[some])
    return Workspace(here, _region(region, solution, nominal, joints, whole), thin, remains)


def _region(
    region: str, solution: Identification, nominal: Geometry, joints: Array, between: NDArray[np.int64]
) -> RegionError:
    """Compute expected errors of the geometry alone: terms depend on conditions, which are unknown in a region.

    Args:
        region: Name of the region.
        solution: The least-squares solution, whose parameters have priors.
        nominal: The nominal geometry. If base and tool were fitted, it has the fitted ones.
        joints: Joints that represent the region ``(M, n)``, rad or m.
        between: For a whole robot, indices of the two links between which each pose is computed ``(M, 2)``, from 0,
            with -1 for the world; all -1 for a single chain.
    """
    prior, fitted = solution.prior, solution.geometry
    assert prior is not None
    names = solution.identifiability.kept_names
    places = [i for i, name in enumerate(names) if name in fitted.parameter_names]
    columns = [fitted.parameter_names.index(names[i]) for i in places]
    framed = dict(zip(prior.parameters.names, prior.group == FRAMES, strict=True))
    parts = []
    for way in np.unique(between, axis=0).tolist():
        one, other, some = fitted, nominal, joints
        if fitted.tree is not None:
            one, other, some = fitted.between(*way), nominal.between(*way), joints[(between == way).all(axis=1)]
        jacobian = ArmModel.of(one).jacobian(some)[:, :3].reshape(3 * len(some), -1)
        change = (forward(one, some).position - forward(other, some).position).ravel()
        effect = jacobian[:, columns]
        if any(framed.values()):
            frames = frames_model(one)
            basis = np.linalg.qr(jacobian[:, frames.columns] * frames.tolerance)[0]
            effect, change = effect - basis @ (basis.T @ effect), change - basis @ (basis.T @ change)
        parts.append((effect, change))
    effects, change = parts[0] if len(parts) == 1 else map(np.concatenate, zip(*parts, strict=True))
    covariance = solution.covariance[np.ix_(places, places)]
    std = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(std, std))
    root = std[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    draws = effects @ (root @ np.random.default_rng(0).standard_normal((len(places), DRAWS)))
    calibrated, by_drawing = (np.sqrt(3.0 * np.mean(errors**2, axis=0)) for errors in (draws, draws + change[:, None]))
    made = [i for i, place in enumerate(places) if not framed.get(names[place], True)]
    before = effects[:, made] * solution.prior_std[solution.identifiability.kept][places][made]
    expected, better = float(np.sqrt(np.sum(before**2) / len(joints))), float(np.mean(calibrated < by_drawing))
    return RegionError(region, *_size(calibrated), *_size(by_drawing), expected, better)


def _size(errors: Array) -> tuple[float, tuple[float, float]]:
    """Return the root mean square of the errors of A arms ``(A,)``, m, and the 95 % interval of these errors."""
    low, high = np.percentile(errors, [2.5, 97.5]).tolist()
    return float(np.sqrt(np.mean(errors**2))), (low, high)


@dataclass(frozen=True, eq=False)
class Quality:
    """The quality of a calibration: its grade, with the findings and tests that the grade comes from.

    Attributes:
        grade: The verdict.
        reason: The main reason for the grade, in one clause.
        findings: All findings, the most severe first, each a weight and a sentence. The weight is "fail" (do not use
            the calibration), "caution" (know this before use) or "note".
        observability: Observability indices, by name, of the kept geometric parameters at the training poses.
        completeness: The chi^2 test.
        workspace: Expected errors where rows were measured and where the arm will work; None without priors.
    """

    grade: Grade
    reason: str
    findings: tuple[tuple[Weight, str], ...]
    observability: dict[str, float]
    completeness: Completeness
    workspace: Workspace | None

    @property
    def others(self) -> tuple[tuple[Weight, str], ...]:
        """All findings except the finding that is `reason`."""
        return tuple((weight, text) for weight, text in self.findings if text != self.reason)

    def as_dict(self) -> dict[str, Any]:
        """Return grade, reason and findings as values for JSON and a calibration's record."""
        findings = [{"weight": weight, "text": text} for weight, text in self.findings]
        return {"grade": self.grade, "reason": self.reason, "findings": findings}


def grade_quality(
    found: Identification,
    trained: Array,
    before: Array | None,
    after: Array,
    workspace: Workspace | None = None,
    *,
    geometric: Identification | None = None,
    parametric: Array | None = None,
    noise: str = "stated noise",
    blocks: Rows | None = None,
    said: Iterable[tuple[Weight, str]] = (),
    unit: str = "mm",
    rows: tuple[int, str] | None = None,
) -> Quality:
    """Grade a calibration.

    Args:
        found: The identification.
        trained: Errors on the fitted rows without a learnt residual: ``(N, 6)``, ``(N, 3)`` or ``(N, 1)``, m and rad.
        before: Held-out errors of the nominal arm: ``(M, 6)``, ``(M, 3)`` or ``(M, 1)``, m and rad. Unless base and
            tool are known, the nominal arm's base and tool were fitted first. None if there is no nominal arm, because
            tool poses were given in place of joint values.
        after: Held-out errors of the calibrated arm, in the shape of ``before``.
        workspace: Expected errors where rows were measured and where the arm will work.
        geometric: The identification of the geometry alone, from which observability is computed; ``found`` if None.
        parametric: Held-out errors without a learnt residual, to be compared with ``trained``; ``after`` if None.
        noise: Words for the instrument's noise in sentences.
        blocks: Integer of each held-out error ``(M,)``, equal for all errors of one block of rows, or of one row.
            Errors with equal integers count as correlated. None if all errors are independent.
        said: Further findings, each a weight and a sentence.
        unit: The unit in which errors are shown: "mm", or "deg" if the errors are angles in rad.
        rows: Number of held-out rows, and the word for them in sentences. If None, the number of errors and "rows".
    """
    count, called = rows or (len(after), "rows")
    bare = geometric or found
    observed = observability(bare.identifiability.singular_values * np.sqrt(bare.poses), bare.poses)
    test = completeness(found, noise)
    unlearnt = after if parametric is None else parametric
    notes, beyond = [test.sentence()], []
    if noise.startswith("stated noise") and test.reduced > MANY_NOISES**2:
        notes, beyond = [], [f"{test.sentence()}; something else than noise is at work"]
    # All rows together may say that the arm is better where it was measured, if those held out do not contradict.
    sure = workspace is not None and workspace.measured.better >= SURE and count >= SEVERAL
    certain = before is not None and sure and _chance(after, before, blocks) > SIGNIFICANCE
    because = "" if before is None else _cause(found, before, after, unlearnt, unit)
    gain = () if certain else no_gain(before, after, blocks, unit, count, called, because)
    if certain and before is not None and workspace is not None and _undecided(before, after, blocks):
        errors = workspace.measured
        beyond.append(
            f"on {count} held-out {called} scatter ({_rms(after, unit):#.4g} {unit} RMS) hides what all rows together "
            f"say: geometry errs by {errors.calibrated * 1e3:#.3g} mm there, and by {errors.nominal * 1e3:#.3g} mm as "
            "drawn; measure more, or with less noise, to see it"
        )
    texts: dict[Weight, list[str]] = {
        "fail": [*(() if found.converged else (NOT_CONVERGED,)), *gain],
        "caution": [*beyond, *_cautions(found, trained, unlearnt, workspace, unit)],
        "note": notes,
    }
    for weight, text in said:
        texts[weight].append(text)
    findings = [(weight, text) for weight, sentences in texts.items() for text in sentences]
    worst, reason = findings[0]
    grade: Grade = "do not use" if worst == "fail" else "with care" if worst == "caution" else "good"
    if grade == "good":
        fall = "is" if before is None else f"falls from {_rms(before, unit):#.4g} to"
        reason = f"on {count} held-out {called} the error {fall} {_rms(after, unit):#.4g} {unit} RMS"
    return Quality(grade, reason, tuple(findings), observed, test, workspace)


def _rms(errors: Array, unit: str) -> float:
    """Return the RMS norm, in ``unit`` ("mm" or "deg"), of errors ``(M, k)``, m or rad; at most three columns count."""
    return float(np.sqrt(np.mean(np.sum(errors[:, :3] ** 2, axis=1)))) * MISS_UNITS[unit]


def no_gain(
    before: Array | None, after: Array, blocks: Rows | None, unit: str, count: int, called: str, because: str = ""
) -> Iterator[str]:
    """Yield the reasons why held-out rows do not show that the calibrated arm is better than the nominal arm.

    Args:
        before: Errors of the nominal arm ``(M, k)``, m or rad; None if there is no nominal arm. If k is larger than 3,
            the first three columns count.
        after: Errors of the calibrated arm ``(M, k)``, m or rad.
        blocks: For each error, the index of its block of rows, or of its row ``(M,)``. Errors with one index count as
            correlated. None if all errors are independent.
        unit: The unit in which errors are shown, "mm" or "deg".
        count: Number of held-out rows.
        called: Word for these rows in sentences, in the plural, such as "views".
        because: A clause on the cause, which is added to the sentence; may be empty.
    """
    if count < ENOUGH:
        few = f"1 {called[:-1]} was" if count == 1 else f"{count} {called} were"
        yield f"only {few} held out, which judges nothing; measure more, or give others as `test`"
    elif before is not None and _undecided(before, after, blocks):
        was, now = _rms(before, unit), _rms(after, unit)
        verb = "is no better than" if now >= was else "cannot be told from"
        yield (
            f"on {count} held-out {called} the calibrated arm ({now:#.4g} {unit} RMS) {verb} the nominal one "
            f"({was:#.4g} {unit} RMS)" + (f": {because}" if because else "")
        )


def _undecided(before: Array, after: Array, blocks: Rows | None) -> bool:
    """Return whether the calibrated arm is not significantly better than the nominal arm on held-out rows.

    The arguments are those of `no_gain`.
    """
    return _rms(after, "mm") >= _rms(before, "mm") or _chance(before, after, blocks) > SIGNIFICANCE


def _cause(found: Identification, before: Array, after: Array, unlearnt: Array, unit: str) -> str:
    """Return a clause that names the likely reason why a calibration is no improvement, and the remedy.

    Args:
        found: The identification.
        before: Held-out errors of the nominal arm ``(M, k)``, m or rad.
        after: Held-out errors of the calibrated arm ``(M, k)``, m or rad.
        unlearnt: Held-out errors of the calibrated arm without a learnt residual ``(M, k)``, m or rad.
        unit: The unit in which errors are shown, "mm" or "deg".
    """
    was, now, plain = (_rms(errors, unit) for errors in (before, after, unlearnt))
    if found.arm_model.terms and plain > was:
        return "the further terms do not carry over to rows held out; give `terms='none'`"
    if plain < was <= now:
        return "what was learnt does not carry over to rows held out; give `residual='none'`"
    if found.degrees_of_freedom < 2 * found.spent:
        return "the rows are too few to say more than the drawing; measure more"
    if now < ALIKE * was:
        return "the arm is as good as this instrument can tell; keep the drawing, or measure with less noise"
    return "the rows held out are of another arm or set-up than those fitted; check which rows belong together"


def _chance(before: Array, after: Array, blocks: Rows | None) -> float:
    """Compute the p-value of the gain from ``before`` to ``after``; the null hypothesis is that both arms are equal.

    The test is a one-sided paired t test over errors, or over blocks if they are given. The arguments are those of
    `no_gain`.
    """
    gain = np.linalg.norm(before[:, :3], axis=1) - np.linalg.norm(after[:, :3], axis=1)
    if blocks is not None:
        which = np.unique(blocks, return_inverse=True)[1]
        gain = np.bincount(which, gain) / np.bincount(which)
    if np.ptp(gain) <= SAME * np.max(np.abs(gain)):
        return 0.0 if gain[0] > 0 else 1.0
    return float(stats.ttest_1samp(gain, 0.0, alternative="greater").pvalue)


def _cautions(
    found: Identification, trained: Array, after: Array, workspace: Workspace | None, unit: str
) -> Iterator[str]:
    """Yield sentences of weight "caution" on the workspace, large held-out errors, and too few equations.

    Args:
        found: The identification.
        trained: Errors on fitted rows without a learnt residual ``(N, k)``, m or rad.
        after: Errors on held-out rows without a learnt residual ``(M, k)``, m or rad.
        workspace: Expected errors where rows were measured and where the arm will work; None without priors.
        unit: The unit in which errors are shown, "mm" or "deg".
    """
    if workspace is not None and workspace.reservation is not None:
        yield workspace.reservation
    tested, fitted = _rms(after, unit), _rms(trained, unit)
    if tested > OPTIMISTIC * fitted:
        yield (
            f"held-out errors ({tested:#.4g} {unit} RMS) are {tested / fitted:.1f} times as large as on the training "
            "rows: measure more poses, or poses like those that will be used"
        )
    free = found.prior is None or not found.prior.proper
    if free and found.degrees_of_freedom < found.identifiability.rank:
        yield (
            f"{found.degrees_of_freedom} spare equations for {found.identifiability.rank} parameters are few; "
            "measure at least twice as many poses"
        )
