"""A fitted calibration: it predicts, compensates, saves and loads as one verified file, refused on another arm."""

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
from pickenv.base import DO_NOT_USE, FITTED_FRAMES, InputError
from pickenv.base.container import named_part, npz_path, part_of, read_container, refusing_damage, write_container
from pickenv.base.registry import Origin, get, origin
from pickenv.calibration.assessment.screen import Block, figure
from pickenv.calibration.compensation.compensator import Compensator
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.model.arm_model import ArmModel, Conditions, specification, term_from
from pickenv.calibration.model.measurements import InstrumentStation, Measurements, screen_unit
from pickenv.calibration.model.observations import BLOCKS, Observations, Rows, equally_spaced, same_poses
from pickenv.calibration.residuals.residual_models import LearntResidual

# How well the calibrated arm's tool pose is known, anywhere: u^2 = J C J^T + u_repeat^2 (GUM, JCGM 100:2008, 5.1.2).
# C is the posterior covariance of the parameters; u_repeat is what one reach scatters by that they do not say:
# repeatability, and what the model leaves out. How many u hold 95 of 100 errors is not assumed but counted on rows held
# out, block by block (split conformal; Barber, Candes, Ramdas and Tibshirani 2021, CV+). A calibration keeps all of it
# in its record, so that a command can be given with its uncertainty later. SI units.

NEARBY, SPACING = 0.3, 1.5
"""Greatest distance of joints, rad or m, at which two poses are alike in what a model leaves out; or, if it is larger,
so many times the distance of the measured poses from their neighbours."""

VAGUE = 2.0
"""A pose is unlike what was measured where the parameters' part of its uncertainty is more than so many times that of
95 of 100 fitted rows."""

MEASURED_REGION = "measured_region"
"""Entry of a calibration's record that holds `PoseUncertainty.region`."""

QUANTITIES = {"position": screen_unit(True), "attitude": screen_unit(False)}
"""The uncertain parts of a pose, and the unit and factor in which screens show each."""

ANCHORS = 400
"""Most poses that stand for the region in which an arm was measured."""

SHARE = 0.95


@dataclass(frozen=True, eq=False)
class PoseUncertainty:
    """Uncertainty of predicted poses of one calibrated arm.

    Attributes:
        names: Identified parameters of the arm.
        covariance: Covariance of the errors of these parameters ``(p, p)``, m and rad.
        position_repeat: Standard deviation of one position coordinate that the parameters do not explain, m.
        attitude_repeat: Standard deviation of one attitude coordinate that the parameters do not explain, rad; None
            where only positions were measured.
        factors: For each of `QUANTITIES` of which there are enough errors: "factor", 95 of 100 errors are smaller than
            this many times their expected root mean square; "covered", the share of the held-out errors within it, each
            judged by a factor and a size found without its block.
    """

    names: tuple[str, ...]
    covariance: Array
    position_repeat: float
    attitude_repeat: float | None
    factors: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    def pose_covariance(self, model: ArmModel, joints: ArrayLike, conditions: Conditions | None = None) -> Array:
        """Covariance ``(..., 6, 6)`` of the tool pose, m and rad, world axes, at joints ``(..., n)``.

        If only positions were measured, the attitude's part comes from the parameters' uncertainty alone.
        """
        joints = np.asarray(joints, dtype=float)
        columns = [model.parameter_names.index(name) for name in self.names]
        jacobian = model.jacobian(joints.reshape(-1, joints.shape[-1]), conditions)[..., columns]
        covariance = jacobian @ self.covariance @ np.swapaxes(jacobian, -1, -2)
        return np.asarray(covariance.reshape(*joints.shape[:-1], 6, 6) + np.diag(self.scatter))

    @property
    def scatter(self) -> Array:
        """Variance of each coordinate of a pose that the parameters do not explain ``(6,)``, m^2 and rad^2."""
        return np.repeat([self.position_repeat, self.attitude_repeat or 0.0], 3) ** 2

    def standard(
        self, model: ArmModel, joints: ArrayLike, conditions: Conditions | None = None
    ) -> tuple[Array, Array | None]:
        """Standard uncertainties of position ``(...)``, m, and attitude ``(...)``, rad.

        Each is the root of the sum of its three variances. The attitude's is None if only positions were measured.
        """
        return self.standard_of(np.diagonal(self.pose_covariance(model, joints, conditions), axis1=-2, axis2=-1))

    def standard_of(self, variance: Array) -> tuple[Array, Array | None]:
        """The same of poses of which the variances of the six coordinates are known ``(..., 6)``, scatter included."""
        position, attitude = np.sqrt(variance[..., :3].sum(-1)), np.sqrt(variance[..., 3:].sum(-1))
        return position, None if self.attitude_repeat is None else attitude

    def from_parameters(self, model: ArmModel, joints: ArrayLike, conditions: Conditions | None = None) -> Array:
        """Standard uncertainty of position ``(...)``, m, from the parameters alone: large far from measured poses."""
        return replace(self, position_repeat=0.0).standard(model, joints, conditions)[0]

    def within95(
        self, model: ArmModel, joints: ArrayLike, conditions: Conditions | None = None
    ) -> tuple[Array | None, Array | None]:
        """Bounds of 95 of 100 errors of position ``(...)``, m, and attitude ``(...)``, rad, at joints ``(..., n)``.

        A bound is None if there were too few held-out errors to find it.
        """
        return self._radii(self.standard(model, joints, conditions))

    def _radii(self, standard: tuple[Array, Array | None]) -> tuple[Array | None, Array | None]:
        position, attitude = (
            None if size is None or name not in self.factors else self.factors[name]["factor"] * size
            for name, size in zip(QUANTITIES, standard, strict=True)
        )
        return position, attitude

    def block(self, standard: tuple[Array, Array | None]) -> Block:
        """A table of the `bounds` of errors at such poses, and of the share of held-out errors that kept them."""
        rows = []
        for quantity, (low, middle, high) in self.bounds(standard).items():
            cell = f"{figure(middle)} {QUANTITIES[quantity][0]} ({figure(low)} to {figure(high)})"
            rows.append((quantity, cell, f"{100 * self.factors[quantity]['covered']:.1f} %"))
        heads = ("of", "95 of 100 are within (5 to 95 of 100 poses)", "held so")
        note = "by pose; held: of held-out rows, each judged by what was found without its block"
        return Block("How far errors go", heads, tuple(rows), note, "uncertainty")

    def bounds(self, standard: tuple[Array, Array | None]) -> dict[str, list[float]]:
        """What 95 of 100 errors keep within, of position (mm) and attitude (deg): at 5, 50 and 95 of 100 poses.

        Args:
            standard: Standard uncertainties of position and attitude at the poses, each ``(N,)``, as of `standard`.
        """
        radii = zip(QUANTITIES.items(), self._radii(standard), strict=True)
        return {
            quantity: np.percentile(radius * scale, [5, 50, 95]).tolist()
            for (quantity, (_, scale)), radius in radii
            if radius is not None
        }

    def as_record(self) -> dict[str, Any]:
        """The uncertainty for a calibration's record (JSON)."""
        return {
            "parameters": list(self.names),
            "covariance": self.covariance.tolist(),
            "position_repeat_m": self.position_repeat,
            "attitude_repeat_rad": self.attitude_repeat,
            **{f"{name}_within95": part for name, part in self.factors.items()},
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
        """The uncertainty of predicted poses, from an identification and the errors that it leaves.

        Args:
            found: The identification.
            errors: Measured minus predicted poses ``(N, 6)`` or positions ``(N, 3)``, m and rad, best of held-out rows.
                Their RMS per coordinate is taken as u_repeat, so it includes the instrument's noise and errs on the
                large side.
            joints: Joints at which each error was found ``(N, n)``, rad or m; if given, bounds of 95 of 100 errors are
                found too.
            blocks: The block of each error ``(N,)``, if errors of one block are alike.
            conditions: Payload and temperature of each error's row, if known.
            unit: "deg" if the errors are misses of directions ``(N, k)``, rad; the uncertainty of positions is then the
                parameters' alone.
            variance: The parameters' part of each pose's variances ``(N, 6)``; as of the arm's own base and tool if
                left out.
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
        """A record's entry of the measured region: some rows' joints, what distance is near, and the uncertainty there.

        Args:
            model: The arm.
            data: The rows fitted.
        """
        std = self.from_parameters(model, data.joints, data.conditions)
        joints = data.joints[equally_spaced(len(data.joints), ANCHORS)]
        places = joint_features(joints, model.geometry.prismatic)
        apart = np.asarray(KDTree(places).query(places, k=2)[0])[:, 1]
        near = max(NEARBY, SPACING * float(np.percentile(apart, 95)))
        region = {"joints": np.round(joints, 4).tolist(), "near": near, "position_p95_m": float(np.percentile(std, 95))}
        return {MEASURED_REGION: region}


def variance_by_station(found: Identification, data: Observations) -> Array:
    """Variances ``(N, 6)`` of the pose of each row by the parameters, in the frames of its own station, m^2 and rad^2.

    Args:
        found: The identification.
        data: Rows of its stations.
    """
    kept, parts = list(found.identifiability.kept_names), []
    for station in data.stations or (InstrumentStation(data),):
        model, _ = station.seen(found.arm_model, np.array([found.unknowns[name] for name in station.unknowns()]))
        names = list(model.parameter_names)
        for frame in station.frames:
            label = f"{frame}{station.owners.get(frame, station.number)}"
            names = [name.replace(f"{frame}_", f"{label}_") if name.startswith(f"{frame}_") else name for name in names]
        pairs = [(names.index(name), kept.index(name)) for name in kept if name in names]
        columns, places = np.array(pairs).T
        jacobian = model.jacobian(station.data.joints, station.data.conditions)[..., columns]
        parts.append(np.einsum("nip,pq,niq->ni", jacobian, found.covariance[np.ix_(places, places)], jacobian))
    return np.concatenate(parts)


def within95(joints: Array, squares: Array, variance: Array, blocks: Rows | None) -> dict[str, float] | None:
    """The factor on the expected size of errors that covers 95 of 100, and its cover of errors not used to find it.

    Args:
        joints: Joints of each error ``(R, n)``.
        squares: Squared errors ``(R,)``.
        variance: The parameters' part of each expected square ``(R,)``.
        blocks: The block of each error ``(R,)``; if None, contiguous tenths of the poses.

    Returns:
        The entries "factor" and "covered"; the latter is the share of errors that keep the bound found without their
        own block. None if there are too few errors or blocks.
    """
    count = len(squares)
    if count < 2 * BLOCKS:
        return None
    if blocks is None:
        poses = same_poses(joints)
        blocks = poses * BLOCKS // (int(poses.max()) + 1)
    numbers = np.unique(blocks)
    if len(numbers) < 2:
        return None
    ratio = np.zeros(count)
    for number in numbers:
        rows = blocks == number
        ratio[rows] = np.sqrt(squares[rows]) / np.sqrt(squares[~rows].mean() + variance[rows])
    inside = [ratio[blocks == number] <= _quantile(ratio[blocks != number]) for number in numbers]
    return {"factor": _quantile(ratio), "covered": float(np.concatenate(inside).mean())}


def _quantile(ratio: Array) -> float:
    """The smallest ratio that is no smaller than 95 of 100 of all ratios, counting one more than there are."""
    rank = int(np.ceil(SHARE * (len(ratio) + 1)))
    return float(np.sort(ratio)[min(rank, len(ratio)) - 1])


def joint_features(joints: Array, slides: tuple[bool, ...]) -> Array:
    """Features of joints ``(N, n)``: sines and cosines of revolute joints, then prismatic joints as they are, m."""
    straight = np.array(slides)
    turning = joints[:, ~straight]
    return np.concatenate([np.sin(turning), np.cos(turning), joints[:, straight]], axis=1)


def measured_there(record: Mapping[str, Any], model: ArmModel, data: Observations) -> NDArray[np.bool_] | None:
    """A mask of the rows ``(N,)`` in the measured region: fitted rows are near, and the parameters determine the pose.

    Args:
        record: The calibration's record; the result is None where it holds no region or no uncertainty.
        model: The arm.
        data: The rows.
    """
    region, sure = record.get(MEASURED_REGION), uncertainty_from(record)
    if region is None or sure is None:
        return None
    slides = model.geometry.prismatic
    tree = KDTree(joint_features(np.array(region["joints"]), slides))
    near = tree.query(joint_features(data.joints, slides))[0] <= region["near"]
    sure_there = sure.from_parameters(model, data.joints, data.conditions) <= VAGUE * region["position_p95_m"]
    return np.asarray(near & sure_there)


def uncertainty_from(record: Mapping[str, Any]) -> PoseUncertainty | None:
    """The uncertainty that a calibration's record holds, or None if it holds none or had no spare equations.

    Older records hold a scatter that differs from pose to pose, and a factor for that scatter; the bound on 95 of 100
    errors is then unknown.
    """
    entry = record.get("uncertainty")
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
    return PoseUncertainty(
        tuple(entry["parameters"]), covariance, float(entry["position_repeat_m"]), entry["attitude_repeat_rad"], factors
    )


KIND = "calibration"
FORMAT = 3
"""Version of the file's content."""

REMAKE = "run `pickenv calibrate` (or `pickenv demo`) to make one anew"
GEOMETRIES = ("arm", "nominal", "identified")
"""The geometries in a file."""


def remainder(model: ArmModel, learnt: LearntResidual | None, conditions: Conditions, joints: Array) -> Array:
    """The difference of the true pose from the identified geometry ``(..., 6)``, m and rad: terms plus learnt residual.

    Args:
        model: Gives the terms.
        learnt: Learnt residual, or None; one learnt from positions turns nothing.
        conditions: Payload and temperature, one value each (or one per pose).
        joints: Joints ``(..., n)``.
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
    """The calibration of one arm.

    Attributes:
        arm_name: Name of the arm.
        arm: The arm's own nominal geometry, as its file gives it; `load` refuses another arm's calibration.
        nominal: What the controller believes; where base and tool were fitted, with the fitted base and tool.
        model: The calibrated geometry with its parametric terms.
        learnt: Learnt residual, or None.
        record: Evidence for people and programs: data hash, seeds, versions, rank, dropped parameters.
    """

    arm_name: str
    arm: Geometry
    nominal: Geometry
    model: ArmModel
    learnt: LearntResidual | None
    record: Mapping[str, Any]

    @property
    def arm_fingerprint(self) -> str:
        """Hash of the arm's own nominal geometry."""
        return self.arm.fingerprint()

    def refuse_another(self, arm: Arm, name: str = "the calibration") -> None:
        """Refuse an arm with another geometry; ``name`` is what messages call the calibration.

        Raises:
            InputError: If it is another arm.
        """
        if self.arm_fingerprint != arm.fingerprint():
            raise InputError(
                f"{name} belongs to arm '{self.arm_name}' with another geometry than '{arm.name}'; fit it for this arm"
            )

    @property
    def unit(self) -> str | None:
        """Serial number of the robot that was measured; None where none was given."""
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
            with_residual: Whether the learnt residual takes part; parametric terms always do.
            conditions: Payload and temperature, one value each, for terms and residuals that need them.
            iterations: See `Compensator`; one is the fastest.
            single_precision: See `Compensator`; for training in thousands of environments.
            fast: Whether a network runs in single precision (`Bpnn.fast`).

        Raises:
            InputError: If the calibration is of a whole robot.
        """
        if self.arm.tree is not None:
            raise InputError("a whole robot has no one tool to compensate; export its calibration onto its URDF")
        learnt = self.learnt if with_residual else None
        if learnt is not None and fast:
            learnt = learnt.faster()
        anything = self.model.terms or learnt is not None
        residual = partial(remainder, self.model, learnt, conditions or Conditions()) if anything else None
        sure, reservations = uncertainty_from(self.record), self.reservations()
        bounds = None if sure is None else partial(self._within95, sure, conditions)
        return Compensator(
            self.nominal, self.identified, residual, iterations, single_precision, reservations, bounds, self.caution
        )

    def _within95(
        self, sure: PoseUncertainty, conditions: Conditions | None, joints: Array
    ) -> tuple[Array | None, Array | None]:
        """`PoseUncertainty.within95` at joints ``(..., n)`` under the same conditions everywhere."""
        repeated = None if conditions is None else conditions.repeated(joints.shape[:-1] or (1,))
        return sure.within95(self.model, joints, repeated)

    @property
    def caution(self) -> str | None:
        """A sentence on the parts of its workspace that the fitted rows say too little of; None if there are none."""
        workspace = self.record.get("workspace")
        sentence = workspace.get("reservation") if isinstance(workspace, Mapping) else None
        return None if sentence is None else str(sentence)

    def reservations(self) -> dict[str, str]:
        """The reservations against using this calibration, by name, each a sentence that says what to do."""
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
        """The calibrated geometry in the robot's own base; the arm's own base replaces a fitted one."""
        if self.record.get("frames") == "fitted":
            return replace(self.identified, base=self.arm.base)
        return self.identified

    def compensate(self, joints: ArrayLike, conditions: Conditions | None = None) -> Array:
        """Compute joint commands ``(..., n)`` for joint targets ``(..., n)``, rad or m."""
        return self.compensator(conditions=conditions)(joints)

    def predict(self, joints: ArrayLike, conditions: Conditions | None = None) -> Pose:
        """Predict the true tool pose at joint commands ``(..., n)``, rad or m."""
        return self.compensator(conditions=conditions, fast=False).predict(joints)

    def errors(self, data: Measurements, turn: Array | None = None) -> Array:
        """Measured minus predicted poses ``(N, 6)`` or positions ``(N, 3)``, m and rad, with terms and learnt residual.

        Args:
            data: Poses or positions.
            turn: Rotation of the base ``(3, 3)`` since the residual was learnt, which is in the axes of the base.
        """
        errors = data.difference(self.model)
        if self.learnt is not None:
            inputs = data.conditions.inputs() if self.learnt.inputs.conditions else None
            learnt = self.learnt.predict(data.joints, inputs)
            if turn is not None:
                learnt = (learnt.reshape(len(learnt), -1, 3) @ turn.T).reshape(learnt.shape)
            width = min(learnt.shape[1], errors.shape[1])
            errors[:, :width] -= learnt[:, :width]
        return errors

    def without_residual(self) -> Calibration:
        """This calibration without its learnt residual."""
        return replace(self, learnt=None)

    def save(self, path: str | Path) -> Path:
        """Write one verified file (see `pickenv.base.container`), whole or not at all; ``.npz`` is appended if missing.

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
            arm: If given, the arm that it must belong to, known by its nominal geometry.
            unit: If given, the serial number of the robot that it must belong to; two robots of one model are alike
                on paper, and only this tells them apart.
            whole: Whether it may be of a whole robot, which has no one tool to compensate.

        Raises:
            InputError: If the file is missing, damaged in any byte, holds what cannot move an arm (numbers that are
                not finite, a base that is no rotation), is of another version, of another arm or of another unit, or
                holds a residual model that is not here; the message names its package.
        """
        path = npz_path(path)
        content = read_container(path, KIND, remake=REMAKE, version=FORMAT)
        with refusing_damage(path, f"a {KIND} file", REMAKE):
            kind, parts = content.header.get("residual"), content.header.get("residual_from") or {}
            source = Origin(**{key: str(value) for key, value in parts.items()})
        if kind is not None:
            try:
                get("residual", str(kind), **asdict(source))
            except InputError as error:
                raise InputError(f"{path}: {error}") from error
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
    """Make a calibration from a file's parts; where they make none, any exception can be raised."""
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
    uncertainty = record.get("uncertainty")
    if uncertainty is not None:
        size = len(uncertainty["parameters"])
        finite({"covariance": np.array(uncertainty["covariance"], dtype=float)}, "covariance", (size, size), "record")
        if not set(uncertainty["parameters"]) <= set(calibration.model.parameter_names):
            raise InputError("its covariance is of parameters that its arm does not have")
    return calibration


def _learnt(kind: str | None, arrays: Mapping[str, NDArray[Any]], geometry: Geometry) -> LearntResidual | None:
    """The learnt residual that the header names, tried once in the middle of the joints' ranges."""
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
