"""How far off the arm is where it will work: expected errors over a declared workspace, of drawing and calibration.

The posterior says how far the parameters may be from where the fit has them; draws from it are as many arms as the rows
allow. Each arm's error is its distance from what the calibration, and what the drawing, says of it. Where base and tool
were fitted, what they could take up is no error of the arm: it is projected out. What one reach scatters by comes on
top. SI units inside, mm on screens.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from pickenv.arm import Array, Geometry
from pickenv.calibration.assessment.screen import Block, figure
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.model.arm_model import ArmModel, frames_model
from pickenv.calibration.model.prior import FRAMES

POSES = 400
"""Poses at most that stand for a region."""

DRAWS = 400
"""Arms drawn from the posterior."""

SURE = 0.95
"""So many of these arms must be nearer to the calibration than to the drawing, for a gain to be certain."""

HARDLY = 0.5
"""Errors of geometry below this share of what one reach errs by hardly matter, told or not."""

LITTLE = 0.2
"""A posterior that is narrower than the prior by less than this share tells nothing new there."""


@dataclass(frozen=True)
class RegionError:
    """Expected errors of an arm over one region, RMS of the tool's position, m.

    Attributes:
        region: Its name.
        calibrated: Of the calibrated arm.
        calibrated_ends: 95 % interval over arms that the rows allow.
        nominal: Of the arm as drawn.
        nominal_ends: Likewise.
        expected: What arms of the tolerance class err by there before anything was measured.
        better: Share of the arms that are nearer to the calibration than to the drawing.
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
        """How much less is expected than before measuring, 0 to 1."""
        return float(np.clip(1.0 - self.calibrated / max(self.expected, 1e-300), 0.0, 1.0))

    @property
    def gain(self) -> float:
        """Share of the drawing's error that the calibration takes away."""
        return 1.0 - self.calibrated / max(self.nominal, 1e-300)

    def as_dict(self) -> dict[str, Any]:
        """For JSON and a calibration's record."""
        mm = {"calibrated_rms_mm": self.calibrated, "nominal_rms_mm": self.nominal, "prior_rms_mm": self.expected}
        ends = {"calibrated_ci95_mm": self.calibrated_ends, "nominal_ci95_mm": self.nominal_ends}
        return {
            "region": self.region,
            **{name: value * 1e3 for name, value in mm.items()},
            **{name: [value * 1e3 for value in pair] for name, pair in ends.items()},
            "gain": self.gain,
            "narrowed": self.narrowed,
            "better": self.better,
        }


@dataclass(frozen=True)
class Workspace:
    """Expected errors where rows were measured, and where the arm will work.

    Attributes:
        measured: At the rows' own joints.
        declared: Over the declared workspace.
        thin: Names of joints whose measured range covers less than half of the declared one.
        remains: RMS error on held-out rows, m: what one reach errs by, whatever geometry says.
    """

    measured: RegionError
    declared: RegionError
    thin: tuple[str, ...] = ()
    remains: float = 0.0

    @property
    def reservation(self) -> str | None:
        """What stands against using the calibration there, in a sentence; None where nothing does."""
        over = self.declared
        if over.calibrated < HARDLY * self.remains:
            return None
        remedy = "measure poses there (`pickenv plan-poses`), or declare where the arm will work with --workspace"
        if self.thin:
            remedy = f"move {', '.join(self.thin)} further, or declare where the arm will work with --workspace"
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
        """For screens."""
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
        """For JSON and a calibration's record."""
        return {
            "measured": self.measured.as_dict(),
            "declared": self.declared.as_dict(),
            "reservation": self.reservation,
        }


def workspace_error(
    solution: Identification,
    nominal: Geometry,
    rows: Array,
    joints: Array,
    region: str = "the joint limits",
    remains: float = 0.0,
) -> Workspace | None:
    """Expected errors over the rows' joints and over a workspace; the same every time.

    Args:
        solution: The fit, whose parameters have priors; else None is returned, for then the rows alone speak.
        nominal: The drawing, with base and tool as aligned where they were fitted.
        rows: Joints measured ``(N, n)``, rad or m.
        joints: Joints of the workspace ``(M, n)``.
        region: What the workspace is called.
        remains: RMS error on held-out rows, m.
    """
    if solution.prior is None or not solution.prior.proper:
        return None
    geometry = solution.geometry
    span = [np.ptp(np.quantile(poses, [0.02, 0.98], axis=0), axis=0) for poses in (rows, joints)]
    thin = tuple(
        name for name, measured, declared in zip(geometry.joint_names, *span, strict=True) if measured < 0.5 * declared
    )
    some = rows[np.unique(np.linspace(0, len(rows) - 1, POSES).astype(int))]
    return Workspace(
        _region("the poses measured", solution, nominal, some),
        _region(region, solution, nominal, joints),
        thin,
        remains,
    )


def _region(region: str, solution: Identification, nominal: Geometry, joints: Array) -> RegionError:
    """Expected errors over joints ``(M, n)``; terms stay out, for they stand on conditions that nobody knows there."""
    prior, bare = solution.prior, ArmModel.of(solution.geometry)
    assert prior is not None
    names = solution.identifiability.kept_names
    places = [i for i, name in enumerate(names) if name in bare.parameter_names]
    columns = [bare.parameter_names.index(names[i]) for i in places]
    jacobian = bare.jacobian(joints)[:, :3].reshape(3 * len(joints), -1)
    effects = jacobian[:, columns]
    change = (bare.pose(joints).position - ArmModel.of(nominal).pose(joints).position).ravel()
    framed = dict(zip(prior.parameters.names, prior.group == FRAMES, strict=True))
    if any(framed.values()):
        frames = frames_model(solution.geometry)
        basis = np.linalg.qr(jacobian[:, frames.columns] * frames.tolerance)[0]
        effects = effects - basis @ (basis.T @ effects)
        change = change - basis @ (basis.T @ change)
    covariance = solution.covariance[np.ix_(places, places)]
    std = np.sqrt(np.diag(covariance))
    values, vectors = np.linalg.eigh(covariance / np.outer(std, std))
    root = std[:, None] * vectors * np.sqrt(np.maximum(values, 0.0))
    draws = effects @ (root @ np.random.default_rng(0).standard_normal((len(places), DRAWS)))
    calibrated, by_drawing = _rms(draws), _rms(draws + change[:, None])
    parts = [i for i, place in enumerate(places) if not framed.get(names[place], True)]
    before = effects[:, parts] * solution.prior_std[solution.identifiability.kept][places][parts]
    return RegionError(
        region,
        float(np.sqrt(np.mean(calibrated**2))),
        _ends(calibrated),
        float(np.sqrt(np.mean(by_drawing**2))),
        _ends(by_drawing),
        float(np.sqrt(np.sum(before**2) / len(joints))),
        float(np.mean(calibrated < by_drawing)),
    )


def _rms(errors: Array) -> Array:
    """RMS position errors ``(D,)`` of stacked coordinates ``(3 M, D)``."""
    return np.asarray(np.sqrt(3.0 * np.mean(errors**2, axis=0)))


def _ends(values: Array) -> tuple[float, float]:
    low, high = np.percentile(values, [2.5, 97.5])
    return float(low), float(high)
