"""A fitted calibration of one arm: it predicts poses, compensates commands, and is saved as a file with a checksum."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import KDTree

from pickenv.arm import Arm, Array, Geometry, Pose
from pickenv.arm.files.arm import finite, geometry_arrays, geometry_from_arrays
from pickenv.base import DO_NOT_USE, FITTED_FRAMES, InputError, in_file
from pickenv.base.container import named_part, npz_path, part_of, read_container, refusing_damage, write_container
from pickenv.base.registry import Origin, get, origin
from pickenv.calibration.assessment.screen import Block, figure, within95
from pickenv.calibration.compensation.compensator import Compensator
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.model.arm_model import ArmModel, Conditions
from pickenv.calibration.model.measurements import InstrumentStation, Measurements, screen_unit
from pickenv.calibration.model.observations import Observations, Rows, equally_spaced
from pickenv.calibration.model.terms import specification, term_from
from pickenv.calibration.residuals.residual_models import LearntResidual

# How well the calibrated arm's tool pose is known, anywhere: u^2 = J C J^T + u_repeat^2 (GUM, JCGM 100:2008, 5.1.2).
# C is the posterior covariance of the parameters; u_repeat is what one reach scatters by that they do not say:
# repeatability, and what the model leaves out. How many u hold 95 of 100 errors is not assumed but counted on rows held
# out, block by block (split conformal; Barber, Candes, Ramdas and Tibshirani 2021, CV+). A calibration keeps all of it
# in its record, so that a command can be given with its uncertainty later. SI units.

NEARBY, SPACING = 0.3, 1.5
"""Largest distance between the `joint_features` of two poses that count as near each other. It is the first number. If
measured poses are sparse, it is the second number times the 95th percentile of their distances to the nearest one."""

VAGUE = 2.0
"""Limit on the position uncertainty that the parameters cause at a pose of the measured region. It is a multiple of the
95th percentile of this uncertainty at the fitted rows."""

MEASURED_REGION = "measured_region"
"""Entry of a calibration's record that holds `PoseUncertainty.region`."""

UNCERTAINTY, WITHOUT_RESIDUAL = "uncertainty", "uncertainty_without_residual"
"""Names of two entries of a calibration's record. The first holds the `PoseUncertainty` of the arm with its learnt
residual, if any. The second holds the `PoseUncertainty` of the arm without the learnt residual."""

QUANTITIES = {"position": screen_unit(True), "attitude": screen_unit(False)}
"""The parts of a pose that have an uncertainty. For each: the unit shown, and the factor from SI to this unit."""

ANCHORS = 400
"""Largest number of poses that represent the region in which an arm was measured."""

Sizes = tuple[Array | None, Array | None]
"""Standard uncertainties of position, m, and attitude, rad, at some poses, or bounds on errors; None if unknown."""


@dataclass(frozen=True, eq=False)
class PoseUncertainty:
    """Uncertainty of predicted poses of one calibrated arm.

    Attributes:
        names: Names of the arm's identified parameters.
        covariance: Covariance of the errors of these parameters ``(p, p)``, m and rad.
        position_repeat: Standard deviation of one position coordinate that the parameters do not explain, m.
        attitude_repeat: Standard deviation of one attitude coordinate that the parameters do not explain, rad; None
            if only positions were measured.
        factors: For each of `QUANTITIES` with enough held-out errors, the entries "factor" and "covered". 95 of 100
            errors are smaller than "factor" times their expected root mean square. "covered" is the share of held-out
            errors below their bound. The bound of an error is computed without the error's block of rows.
        growth: Factors on ``position_repeat`` and ``attitude_repeat`` in the uncertainty of a pose. They allow
            for the small number of held-out errors that determine these standard deviations.
    """

    names: tuple[str, ...]
    covariance: Array
    position_repeat: float
    attitude_repeat: float | None
    factors: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    growth: tuple[float, float] = (1.0, 1.0)

    def pose_covariance(self, model: ArmModel, joints: ArrayLike, conditions: Conditions | None = None) -> Array:
        """Compute the covariance ``(..., 6, 6)`` of the tool pose, m and rad, in world axes.

        If only positions were measured, the attitude's part comes from the parameters' uncertainty alone.

        Args:
            model: The calibrated arm.
            joints: Joints ``(..., n)``, rad or m.
            conditions: Payload and temperature, if the model depends on them.
        """
        joints = np.asarray(joints, dtype=float)
        columns = [model.parameter_names.index(name) for name in self.names]
        jacobian = model.jacobian(joints.reshape(-1, joints.shape[-1]), conditions)[..., columns]
        covariance = jacobian @ self.covariance @ np.swapaxes(jacobian, -1, -2)
        return np.asarray(covariance.reshape(*joints.shape[:-1], 6, 6) + np.diag(self.scatter))

    @property
    def scatter(self) -> Array:
        """Variance of each pose coordinate ``(6,)`` that the parameters do not explain, m^2 and rad^2."""
        return np.repeat(np.multiply([self.position_repeat, self.attitude_repeat or 0.0], self.growth), 3) ** 2

    def standard(
        self, model: ArmModel, joints: ArrayLike, conditions: Conditions | None = None
    ) -> tuple[Array, Array | None]:
        """Compute the standard uncertainties of position ``(...)``, m, and attitude ``(...)``, rad.

        Each is the root of the sum of its three variances. The attitude's uncertainty is None if only positions were
        measured.

        Args:
            model: The calibrated arm.
            joints: Joints ``(..., n)``, rad or m.
            conditions: Payload and temperature, if the model depends on them.
        """
        return self.standard_of(np.diagonal(self.pose_covariance(model, joints, conditions), axis1=-2, axis2=-1))

    def standard_of(self, variance: Array) -> tuple[Array, Array | None]:
        """Compute the standard uncertainties of position and attitude from the variances of a pose.

        Args:
            variance: Variances of the six pose coordinates ``(..., 6)``, m^2 and rad^2.

        Returns:
            Two arrays ``(...)``: the uncertainty of position, m, and the uncertainty of attitude, rad. The second is
            None if no attitudes were measured.
        """
        position, attitude = np.sqrt(variance[..., :3].sum(-1)), np.sqrt(variance[..., 3:].sum(-1))
        return position, None if self.attitude_repeat is None else attitude

    def from_parameters(self, model: ArmModel, joints: ArrayLike, conditions: Conditions | None = None) -> Array:
        """Compute the standard uncertainty of position ``(...)``, m, that the parameters alone cause.

        It is large far from measured poses.

        Args:
            model: The calibrated arm.
            joints: Joints ``(..., n)``, rad or m.
            conditions: Payload and temperature, if the model depends on them.
        """
        return replace(self, position_repeat=0.0).standard(model, joints, conditions)[0]

    def within95(self, standard: Sizes) -> Sizes:
        """Compute bounds on the errors of position ``(...)``, m, and attitude ``(...)``, rad.

        95 of 100 errors are below their bound. A bound is None if there were too few held-out errors to compute it.
        ``standard`` are the standard uncertainties of position and attitude (`standard`).
        """
        position, attitude = (
            None if size is None or name not in self.factors else self.factors[name]["factor"] * size
            for name, size in zip(QUANTITIES, standard, strict=True)
        )
        return position, attitude

    def block(self, radii: Sizes) -> Block:
        """Return a table of the 95 % bounds on errors (`bounds`), and of the share of held-out errors below them.

        Args:
            radii: Bounds at N poses (`within95`): position ``(N,)``, m, and attitude ``(N,)``, rad.
        """
        rows = []
        for quantity, (low, middle, high) in self.bounds(radii).items():
            cell = f"{figure(middle)} {QUANTITIES[quantity][0]} ({figure(low)} to {figure(high)})"
            rows.append((quantity, cell, f"{100 * self.factors[quantity]['covered']:.1f} %"))
        heads = ("of", "95 of 100 are within (5 to 95 of 100 poses)", "held so")
        note = "by pose; held: of held-out rows, each judged by what was found without its block"
        return Block("How far errors go", heads, tuple(rows), note, "uncertainty")

    @staticmethod
    def bounds(radii: Sizes) -> dict[str, list[float]]:
        """Compute how the 95 % bounds on errors (`within95`) are distributed over poses.

        Args:
            radii: Bounds at N poses (`within95`): position ``(N,)``, m, and attitude ``(N,)``, rad.

        Returns:
            The 5th, 50th and 95th percentiles of the bound, for "position" in mm and "attitude" in deg.
        """
        return {
            quantity: np.percentile(radius * scale, [5, 50, 95]).tolist()
            for (quantity, (_, scale)), radius in zip(QUANTITIES.items(), radii, strict=True)
            if radius is not None
        }

    def as_record(self) -> dict[str, Any]:
        """Return the uncertainty as an entry of a calibration's record (JSON); `uncertainty_from` reads it."""
        return {
            "parameters": list(self.names),
            "covariance": self.covariance.tolist(),
            "position_repeat_m": self.position_repeat,
            "attitude_repeat_rad": self.attitude_repeat,
            **{f"{name}_within95": part for name, part in self.factors.items()},
            **({} if self.growth == (1.0, 1.0) else {"growth": list(self.growth)}),
        }

    @staticmethod
    def of(
        found: Identification,
        errors: Array,
        joints: Array | None = None,
        blocks: Rows | None = None,
        conditions: Conditions | None = None,
        unit: str = "mm",
        variance: Array | None = None,
    ) -> PoseUncertainty:
        """Compute the uncertainty of predicted poses from an identification and the errors that it leaves.

        Args:
            found: The identification.
            errors: Measured minus predicted poses ``(N, 6)`` or positions ``(N, 3)``, m and rad, preferably of held-out
                rows. Their RMS per coordinate is taken as the scatter of a single motion to a pose
                (``position_repeat`` and ``attitude_repeat``). It includes the instrument's noise, so it is rather too
                large.
            joints: Joints of each error's row ``(N, n)``, rad or m. If given, the bounds on 95 of 100 errors are
                computed too.
            blocks: One integer per error ``(N,)``, equal for all errors of one block of rows. Errors of one block are
                correlated. If None, blocks are contiguous tenths of the poses.
            conditions: Payload and temperature of each error's row, if known.
            unit: "deg" if ``errors`` are misses of directions ``(N, k)``, rad. The uncertainty of positions then
                comes from the parameters alone.
            variance: Variances of each row's pose coordinates that the parameters cause ``(N, 6)``, m^2 and rad^2. If
                None, they are computed with the arm's own base and tool.
        """
        positions, attitudes = (np.zeros((0, 3)), errors) if unit == "deg" else (errors[:, :3], errors[:, 3:])
        names = set(found.arm_model.parameter_names)
        places = [i for i, name in enumerate(found.identifiability.kept_names) if name in names]
        sure = PoseUncertainty(
            names=tuple(found.identifiability.kept_names[i] for i in places),
            covariance=found.covariance[np.ix_(places, places)],
            position_repeat=float(np.sqrt(np.mean(positions**2))) if positions.size else 0.0,
            attitude_repeat=float(np.sqrt(np.mean(attitudes**2))) if attitudes.size else None,
        )
        if joints is None or not np.isfinite(sure.covariance).all():
            return sure
        parametric = replace(sure, position_repeat=0.0, attitude_repeat=None)
        if variance is None:
            variance = np.diagonal(parametric.pose_covariance(found.arm_model, joints, conditions), axis1=1, axis2=2)
        factors = {}
        for name, first, some in zip(QUANTITIES, (0, 3), (positions, attitudes), strict=True):
            squares, expected = np.sum(some**2, axis=1), variance[:, first : first + 3].sum(axis=1)
            if some.size and (part := within95(joints, squares, expected, blocks)):
                factors[name] = part
        return replace(sure, factors=factors)

    def region(self, model: ArmModel, data: Observations) -> dict[str, Any]:
        """Return the entry of a calibration's record that describes the measured region (`Calibration.measured_there`).

        The entry holds the joints of some rows, and the largest joint distance that counts as near. It also holds the
        95th percentile, over the rows, of the position uncertainty, m, that the parameters cause.

        Args:
            model: The calibrated arm.
            data: The fitted rows.
        """
        std = self.from_parameters(model, data.joints, data.conditions)
        joints = data.joints[equally_spaced(len(data.joints), ANCHORS)]
        places = joint_features(joints, model.geometry.prismatic)
        apart = np.asarray(KDTree(places).query(places, k=2)[0])[:, 1]
        near = max(NEARBY, SPACING * float(np.percentile(apart, 95)))
        return {"joints": np.round(joints, 4).tolist(), "near": near, "position_p95_m": float(np.percentile(std, 95))}


def variance_by_station(found: Identification, data: Observations) -> Array:
    """Compute the variances of each row's pose coordinates ``(N, 6)`` that the parameters cause, m^2 and rad^2.

    A station is one placement of the instrument and its target. Each row's pose is taken with the base and tool of the
    row's station.

    Args:
        found: The identification.
        data: Rows of the stations that were identified.
    """
    kept, parts = list(found.identifiability.kept_names), []
    for station in data.stations or (InstrumentStation(data),):
        model, _ = station.seen(found.arm_model, np.array([found.unknowns[name] for name in station.unknowns()]))
        names = list(model.parameter_names)
        for frame in station.frames:
            label = f"{frame}{station.owners.get(frame, station.number)}"
            names = [name.replace(f"{frame}_", f"{label}_") if name.startswith(f"{frame}_") else name for name in names]
        columns, places = np.array([(names.index(name), kept.index(name)) for name in kept if name in names]).T
        jacobian = model.jacobian(station.data.joints, station.data.conditions)[..., columns]
        parts.append(np.einsum("nip,pq,niq->ni", jacobian, found.covariance[np.ix_(places, places)], jacobian))
    return np.concatenate(parts)


def joint_features(joints: Array, slides: tuple[bool, ...]) -> Array:
    """Compute features of joints: the sines of all revolute joints, then their cosines, then the prismatic joints, m.

    Args:
        joints: Joints ``(N, n)``, rad or m.
        slides: For each joint, whether it is prismatic.
    """
    straight = np.array(slides)
    turning = joints[:, ~straight]
    return np.concatenate([np.sin(turning), np.cos(turning), joints[:, straight]], axis=1)


def uncertainty_from(record: Mapping[str, Any], name: str = UNCERTAINTY) -> PoseUncertainty | None:
    """Read an uncertainty from a calibration's record; ``name`` is its entry, `UNCERTAINTY` or `WITHOUT_RESIDUAL`.

    The result is None if the record holds none, or if its covariance is not finite because the fit had no more
    equations than parameters. Older records hold a scatter that differs from pose to pose; the factors for the bounds
    on 95 of 100 errors are then left out.
    """
    entry = record.get(name)
    if not isinstance(entry, Mapping):
        return None
    covariance = np.array(entry["covariance"], dtype=float)
    if not np.isfinite(covariance).all():
        return None
    factors = {
        name: {key: entry[f"{name}_within95"][key] for key in ("factor", "covered")}
        for name in QUANTITIES
        if f"{name}_within95" in entry and f"{name}_local" not in entry  # that factor is of another scatter
    }
    repeats, growth = (float(entry["position_repeat_m"]), entry["attitude_repeat_rad"]), entry.get("growth", (1.0, 1.0))
    return PoseUncertainty(tuple(entry["parameters"]), covariance, *repeats, factors, (growth[0], growth[1]))


KIND = "calibration"
FORMAT = 3
REMAKE = "run `pickenv calibrate` (or `pickenv demo`) to make one anew"
GEOMETRIES = ("arm", "nominal", "identified")
"""Names of the geometries that a calibration file holds."""


def remainder(model: ArmModel, learnt: LearntResidual | None, conditions: Conditions, joints: Array) -> Array:
    """Predict the true pose minus the pose of the identified geometry ``(..., 6)``, m and rad.

    This difference is the sum of parametric terms and learnt residual.

    Args:
        model: The identified arm with its terms.
        learnt: Learnt residual, or None. A residual that was learnt from positions predicts no rotation.
        conditions: Payload and temperature, one value each or one per pose.
        joints: Joints ``(..., n)``, rad or m.
    """
    expected = None
    if learnt is not None:
        inputs = conditions.repeated(joints.shape[:-1]).inputs() if learnt.inputs.conditions else None
        expected = learnt.predict(joints, None if inputs is None else inputs.reshape(*joints.shape[:-1], -1))
    if not model.terms and expected is not None and expected.shape[-1] == 6:
        return expected
    total = np.zeros((*joints.shape[:-1], 6))
    if model.terms:
        total += model.displacement(joints, conditions.repeated(joints.shape[:-1]))
    if expected is not None:
        total[..., : expected.shape[-1]] += expected
    return total


@dataclass(frozen=True, eq=False)
class Calibration:
    """The calibration of one arm: its identified geometry, terms and learnt residual, with a record of the fit.

    Attributes:
        arm_name: Name of the arm.
        arm: The arm's nominal geometry as its file gives it. It identifies the arm: `load` can refuse other arms.
        nominal: The nominal geometry that the controller uses. If base and tool were fitted, it has the fitted ones.
        model: The calibrated geometry with its parametric terms.
        learnt: Learnt residual, or None.
        record: Evidence of the fit: data hash, seeds, versions, rank, dropped parameters, verdict and uncertainty.
    """

    arm_name: str
    arm: Geometry
    nominal: Geometry
    model: ArmModel
    learnt: LearntResidual | None
    record: Mapping[str, Any]

    @property
    def arm_fingerprint(self) -> str:
        """Hash of the arm's nominal geometry."""
        return self.arm.fingerprint()

    def refuse_another(self, arm: Arm, name: str = "the calibration") -> None:
        """Check that an arm has the nominal geometry for which this calibration was made.

        Args:
            arm: The arm.
            name: Name of the calibration in the message.

        Raises:
            InputError: If the arm has another nominal geometry.
        """
        arm.refuse_another(self.arm, f"{name} belongs to arm '{self.arm_name}'")

    @property
    def unit(self) -> str | None:
        """Serial number of the robot that was measured; None if none was given."""
        unit = self.record.get("unit")
        return None if unit is None else str(unit)

    @property
    def identified(self) -> Geometry:
        """The calibrated geometry."""
        return self.model.geometry

    def compensator(
        self,
        *,
        with_residual: bool = True,
        conditions: Conditions | None = None,
        iterations: int = 2,
        single_precision: bool = False,
        fast: bool = True,
    ) -> Compensator:
        """Make the map from joint targets to joint commands, for control loops and environments.

        Args:
            with_residual: Whether the learnt residual is used. Parametric terms always are.
            conditions: Payload and temperature, one value each, for terms and residuals that depend on them.
            iterations: Number of corrections, as in `Compensator`; one is the fastest.
            single_precision: Whether corrections are computed in single precision, as in `Compensator`. This is for
                training in thousands of environments.
            fast: Whether a residual network runs in single precision (`Bpnn.fast`).

        Raises:
            InputError: If the calibration is of a whole robot (a tree of links).
        """
        if self.arm.tree is not None:
            raise InputError("a whole robot has no one tool to compensate; export its calibration onto its URDF")
        calibration = self if with_residual else self.without_residual()
        learnt, present = calibration.learnt, conditions or Conditions()
        if learnt is not None:
            present.refuse_other_inputs(self.record)
            learnt = learnt.faster() if fast else learnt
        anything = self.model.terms or learnt is not None
        residual = partial(remainder, self.model, learnt, present) if anything else None

        def bounds(commands: Array) -> Sizes:
            repeated = None if conditions is None else conditions.repeated(commands.shape[:-1] or (1,))
            return calibration.uncertainty(commands, repeated)[1]

        stated = bounds if uncertainty_from(calibration.record) is not None else None
        evidence = self.reservations(), stated, self.caution, self.arm
        return Compensator(self.nominal, self.identified, residual, iterations, single_precision, *evidence)

    def uncertainty(self, joints: ArrayLike, conditions: Conditions | None = None) -> tuple[Sizes, Sizes]:
        """Compute the standard uncertainties of predicted poses, and the bounds that 95 of 100 errors do not exceed.

        A learnt residual predicts nothing at poses outside the measured region. There, uncertainties and bounds of
        the arm without the residual are returned.

        Args:
            joints: Joints ``(..., n)``, rad or m.
            conditions: Payload and temperature of each pose, if the model depends on them.
        """
        sure, joints = uncertainty_from(self.record), np.asarray(joints, dtype=float)
        if sure is None:
            return (None, None), (None, None)
        standard = sure.standard(self.model, joints, conditions)
        sizes = standard, sure.within95(standard)
        if self.learnt is None or WITHOUT_RESIDUAL not in self.record:
            return sizes
        inside = self.measured_there(joints.reshape(-1, joints.shape[-1]), conditions)
        measured = np.reshape(True if inside is None else inside, joints.shape[:-1])
        without = self.without_residual().uncertainty(joints, conditions)
        (position, attitude), within = (
            [None if a is None or b is None else np.where(measured, a, b) for a, b in zip(*pair, strict=True)]
            for pair in zip(sizes, without, strict=True)
        )
        return (position, attitude), (within[0], within[1])

    def measured_there(self, joints: Array, conditions: Conditions | None) -> NDArray[np.bool_] | None:
        """Return a mask ``(N,)`` of the poses that lie in the region where the arm was measured.

        A pose lies there if a fitted row is near and the parameters cause little uncertainty of it (`VAGUE`). The
        result is None if the record holds no region or no uncertainty.

        Args:
            joints: Joints ``(N, n)``, rad or m.
            conditions: Payload and temperature, if the model depends on them.
        """
        region = self.record.get(MEASURED_REGION)
        sure = uncertainty_from(self.record, WITHOUT_RESIDUAL) or uncertainty_from(self.record)
        if region is None or sure is None:
            return None
        slides = self.identified.prismatic
        tree = KDTree(joint_features(np.array(region["joints"]), slides))
        near = tree.query(joint_features(joints, slides))[0] <= region["near"]
        sure_there = sure.from_parameters(self.model, joints, conditions) <= VAGUE * region["position_p95_m"]
        return np.asarray(near & sure_there)

    @property
    def caution(self) -> str | None:
        """The cautions of the verdict, to be read before use; None if there are none."""
        verdict = self.record.get("verdict")
        findings = verdict.get("findings", ()) if isinstance(verdict, Mapping) else ()
        return "; ".join(str(row["text"]) for row in findings if row["weight"] == "caution") or None

    def reservations(self) -> dict[str, str]:
        """Return the reasons against using this calibration, by name; each is a sentence that says what to do.

        There can be two: the verdict is "do not use", and base and tool were fitted.
        """
        sentences = {}
        verdict = self.record.get("verdict")
        if isinstance(verdict, Mapping) and verdict.get("grade") == "do not use":
            sentences[DO_NOT_USE] = (
                f"the verdict on this calibration is: do not use ({verdict.get('reason')}); measure again"
            )
        if self.record.get("frames") == "fitted":
            interval = self.record.get("base_frame", {}).get("mean_ci95_mm")
            size = f" ({interval[0]:.3g} to {interval[1]:.3g} mm of mean error there)" if interval else ""
            sentences[FITTED_FRAMES] = (
                "base and tool of this calibration were fitted, so what the arm does in its own base frame, where the "
                f"fruit stand, is not known{size}; measure with the instrument registered to the base and calibrate "
                "with `frames='known'`"
            )
        return sentences

    @property
    def in_own_base(self) -> Geometry:
        """The calibrated geometry in the robot's own frames: the base and tool of `arm` replace fitted ones."""
        if self.record.get("frames") == "fitted":
            return replace(self.identified, base=self.arm.base, tool=self.arm.tool)
        return self.identified

    def compensate(self, joints: ArrayLike, conditions: Conditions | None = None) -> Array:
        """Compute joint commands ``(..., n)`` for joint targets ``(..., n)``, rad or m (see `compensator`)."""
        return self.compensator(conditions=conditions)(joints)

    def predict(self, joints: ArrayLike, conditions: Conditions | None = None) -> Pose:
        """Predict the true tool pose at joint commands ``(..., n)``, rad or m, in the frame of `identified`."""
        return self.compensator(conditions=conditions, fast=False).predict(joints)

    def errors(self, data: Measurements, turn: Array | None = None) -> Array:
        """Compute measured minus predicted poses ``(N, 6)`` or positions ``(N, 3)``, m and rad.

        The prediction includes terms and learnt residual.

        Args:
            data: Measured poses or positions.
            turn: Rotation ``(3, 3)`` from the base's attitude in the fit to its present attitude. It turns
                the residual, which was learnt in the base's axes. None if the base is unchanged.
        """
        errors = data.difference(self.model)
        if self.learnt is not None:
            data.conditions.refuse_other_inputs(self.record)
            inputs = data.conditions.inputs() if self.learnt.inputs.conditions else None
            learnt = self.learnt.predict(data.joints, inputs)
            if turn is not None:
                learnt = (learnt.reshape(len(learnt), -1, 3) @ turn.T).reshape(learnt.shape)
            width = min(learnt.shape[1], errors.shape[1])
            errors[:, :width] -= learnt[:, :width]
        return errors

    def without_residual(self) -> Calibration:
        """Return a copy of this calibration without its learnt residual, with the uncertainty that it then has."""
        without = self.record.get(WITHOUT_RESIDUAL)
        uncertainty = {} if without is None else {UNCERTAINTY: without}
        return replace(self, learnt=None, record={**self.record, **uncertainty})

    def save(self, path: str | Path) -> Path:
        """Write the calibration as one file with a checksum (`pickenv.base.container`), and return the file's path.

        The file is written whole or not at all.

        Args:
            path: The file; ``.npz`` is appended if it is missing.

        Raises:
            InputError: If the file cannot be written, or `load` would refuse it.
        """
        arrays: dict[str, NDArray[Any]] = {}
        for key in GEOMETRIES:
            arrays |= named_part(f"{key}/", geometry_arrays(getattr(self, key)))
        arrays["coefficients"] = self.model.coefficients
        if self.learnt is not None:
            arrays |= named_part("learnt/", self.learnt.arrays())
        header = {
            "arm": self.arm_name,
            "arm_fingerprint": self.arm_fingerprint,
            "joint_names": self.nominal.joint_names,
            "prismatic": self.nominal.prismatic,
            "terms": [specification(term) for term in self.model.terms],
            "residual": None if self.learnt is None else self.learnt.kind,
            "residual_from": None if self.learnt is None else asdict(origin("residual", self.learnt.kind)),
            "record": self.record,
        }
        _from_parts(header, arrays)
        return write_container(npz_path(path), KIND, header, arrays, version=FORMAT)

    @staticmethod
    def load(path: str | Path, arm: Arm | None = None, unit: str | None = None, whole: bool = False) -> Calibration:
        """Read a file that `save` wrote; nothing in it is executed.

        A residual model of another package needs that package, which is imported.

        Args:
            path: The file, with or without its suffix.
            arm: If given, the arm for which the calibration must have been made. Arms are compared by their nominal
                geometry.
            unit: If given, the serial number of the robot for which the calibration must have been made. Two robots
                of one model have the same nominal geometry, and only this number distinguishes them.
            whole: Whether the calibration of a whole robot (a tree of links) is accepted. It cannot compensate, since
                such a robot has no single tool.

        Raises:
            InputError: If the file is missing, damaged in any byte, or of another version, arm or unit. Also if a
                value is not finite, or the base's rotation matrix is no rotation. Also if the package of the residual
                model is not installed; the message then names it.
        """
        path = npz_path(path)
        content = read_container(path, KIND, remake=REMAKE, version=FORMAT)
        with refusing_damage(path, f"a {KIND} file", REMAKE):
            kind, parts = content.header.get("residual"), content.header.get("residual_from") or {}
            source = Origin(**{key: str(value) for key, value in parts.items()})
        if kind is not None:
            with in_file(path):
                get("residual", str(kind), **asdict(source))
        with refusing_damage(path, f"a {KIND} file", REMAKE):
            calibration = _from_parts(content.header, content.arrays)
        if calibration.arm.tree is not None and not whole:
            raise InputError(f"{path} is of a whole robot, which `export` writes onto its URDF; calibrate one arm here")
        if arm is not None:
            calibration.refuse_another(arm, str(path))
        if unit is not None and calibration.unit != unit:
            whose = "names no unit" if calibration.unit is None else f"belongs to unit '{calibration.unit}'"
            raise InputError(f"{path} {whose}, but unit '{unit}' is asked for; calibrate that robot by its own file")
        return calibration


def _from_parts(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Calibration:
    """Make a calibration from a file's parts; if the parts are invalid, any exception can be raised."""
    names, prismatic, record = header["joint_names"], header["prismatic"], header["record"]
    parts = {key: part_of(arrays, f"{key}/") for key in GEOMETRIES}
    arm, nominal, identified = (geometry_from_arrays(part, names, prismatic, key) for key, part in parts.items())
    if arm.fingerprint() != header["arm_fingerprint"]:
        raise InputError(f"its arm's geometry is not the one of fingerprint {header['arm_fingerprint']}")
    if replace(nominal, base=arm.base, tool=arm.tool).fingerprint() != header["arm_fingerprint"]:
        raise InputError("its nominal geometry differs from its arm's by more than base and tool")
    terms = tuple(term_from(term) for term in header["terms"])
    count = sum(len(term.names(identified)) for term in terms)
    calibration = Calibration(
        arm_name=str(header["arm"]),
        arm=arm,
        nominal=nominal,
        model=ArmModel(identified, terms, finite(arrays, "coefficients", (count,), "terms")),
        learnt=_learnt(header["residual"], part_of(arrays, "learnt/"), identified),
        record=dict(record),
    )
    for uncertainty in filter(None, map(record.get, (UNCERTAINTY, WITHOUT_RESIDUAL))):
        size = len(uncertainty["parameters"])
        finite({"covariance": np.array(uncertainty["covariance"], dtype=float)}, "covariance", (size, size), "record")
        if not set(uncertainty["parameters"]) <= set(calibration.model.parameter_names):
            raise InputError("its covariance is of parameters that its arm does not have")
    return calibration


def _learnt(kind: str | None, arrays: Mapping[str, NDArray[Any]], geometry: Geometry) -> LearntResidual | None:
    """Make the learnt residual of a file, and evaluate it once.

    Args:
        kind: Name of the residual model in the file's header; None if the file has no learnt residual.
        arrays: The file's arrays by name.
        geometry: The identified geometry.
    """
    if kind is None:
        if arrays:
            raise InputError("it holds a learnt residual that its header does not name")
        return None
    for name, value in arrays.items():
        if value.dtype.kind == "f":
            finite({name: value.astype(float)}, name, value.shape, "learnt")
    if str(arrays["kind"]) != kind:
        raise InputError(f"its learnt residual is '{arrays['kind']}', but its header names '{kind}'")
    learnt = LearntResidual.from_arrays(arrays)
    conditions = np.zeros(learnt.inputs.conditions) if learnt.inputs.conditions else None
    with np.errstate(all="ignore"):
        tried = learnt.predict((geometry.lower + geometry.upper) / 2, conditions)
    if tried.shape not in ((3,), (6,)) or not np.isfinite(tried).all():
        raise InputError(f"its learnt residual gives {tried.shape} numbers, not 3 or 6 finite ones")
    return learnt
