"""A fitted calibration: predict, compensate, save and load. One file, no pickle, refused on another arm."""

from __future__ import annotations

import json
import zipfile
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calibration.arm_model import ArmModel, Conditions
from calibration.compensation import Compensator
from calibration.residual_models import LearntResidual
from calibration.terms import term_from
from pickenv.arm import Arm, Geometry, Pose
from pickenv.arm.geometry import LINK_PARAMETERS, Array, Coupling
from pickenv.errors import InputError
from pickenv.files import write_whole

FORMAT = 1
"""Version of the file format; newer files are refused by older programs."""

DAMAGE = (OSError, EOFError, ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile, zlib.error)
"""What reading a file that is no calibration can raise."""


@dataclass(frozen=True, eq=False)
class Remainder:
    """What the true pose differs from the identified geometry by: parametric terms plus the learnt residual.

    Attributes:
        model: Gives the terms.
        learnt: Learnt residual, or None.
        conditions: Payload and temperature, one value each (or one per pose).
    """

    model: ArmModel
    learnt: LearntResidual | None
    conditions: Conditions

    def parts(self) -> bool:
        """Whether there is anything to add."""
        return bool(self.model.terms) or self.learnt is not None

    def predict(self, joints: ArrayLike) -> Array:
        """Pose residual ``(..., 6)``, m and rad, at joints ``(..., n)``; one learnt from positions turns nothing."""
        joints = np.asarray(joints, dtype=float)
        total = np.zeros((*joints.shape[:-1], 6))
        if self.model.terms:
            total += self.model.displacement(joints, self.conditions.spread(joints.shape[:-1]))
        if self.learnt is not None:
            inputs = self.conditions.spread(joints.shape[:-1]).inputs() if self.learnt.inputs.conditions else None
            learnt = self.learnt.predict(joints, None if inputs is None else inputs.reshape(*joints.shape[:-1], -1))
            total[..., : learnt.shape[-1]] += learnt
        return total


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a calibration found for one arm.

    Attributes:
        arm_name: Name of the arm.
        arm_fingerprint: Hash of the arm's nominal geometry; `load` refuses another arm's calibration.
        nominal: What the controller believes; where base and tool were fitted, with the fitted base and tool.
        model: The calibrated geometry with its parametric terms.
        learnt: Learnt residual, or None.
        record: Evidence for people and programs: data hash, seeds, versions, rank, dropped parameters.
    """

    arm_name: str
    arm_fingerprint: str
    nominal: Geometry
    model: ArmModel
    learnt: LearntResidual | None
    record: Mapping[str, Any]

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
    ) -> Compensator:
        """The map from joint targets to joint commands, for control loops and environments.

        Args:
            with_residual: Whether the learnt residual takes part; parametric terms always do.
            conditions: Payload and temperature, one value each, for terms and residuals that need them.
            iterations: See `Compensator`; one is the fastest.
            single_precision: See `Compensator`; for training in thousands of environments.
        """
        learnt = self.learnt if with_residual else None
        if learnt is not None and single_precision:
            learnt = learnt.in_single_precision()
        remainder = Remainder(self.model, learnt, conditions or Conditions())
        residual = remainder if remainder.parts() else None
        return Compensator(self.nominal, self.identified, residual, iterations, single_precision)

    def compensate(self, joints: ArrayLike, conditions: Conditions | None = None) -> Array:
        """Joint commands for joint targets ``(..., n)``, rad or m."""
        return self.compensator(conditions=conditions)(joints)

    def predict(self, joints: ArrayLike, conditions: Conditions | None = None) -> Pose:
        """Expected true tool pose at joint commands ``(..., n)``."""
        return self.compensator(conditions=conditions).predict(joints)

    def without_residual(self) -> Calibration:
        """This calibration without its learnt residual."""
        return replace(self, learnt=None)

    def save(self, path: str | Path) -> Path:
        """Write one file (NumPy archive, no pickle), whole or not at all; ``.npz`` is appended if missing."""
        arrays: dict[str, Array] = {}
        for key, geometry in (("nominal", self.nominal), ("identified", self.identified)):
            arrays |= {f"{key}/{name}": value for name, value in geometry_arrays(geometry).items()}
        arrays["coefficients"] = self.model.coefficients
        if self.learnt is not None:
            arrays |= {f"learnt/{name}": value for name, value in self.learnt.arrays().items()}
        header = {
            "format": FORMAT,
            "arm": self.arm_name,
            "arm_fingerprint": self.arm_fingerprint,
            "joint_names": self.nominal.joint_names,
            "prismatic": self.nominal.prismatic,
            "terms": [term.specification() for term in self.model.terms],
            "record": self.record,
        }

        def write(temporary: Path) -> None:
            with temporary.open("wb") as file:
                np.savez(file, allow_pickle=False, header=np.array(json.dumps(header)), **arrays)

        return write_whole(_with_suffix(path), write)

    @staticmethod
    def load(path: str | Path, arm: Arm | None = None) -> Calibration:
        """Read a file that `save` wrote; nothing in it is executed.

        Args:
            path: The file, with or without its suffix.
            arm: If given, the arm that it must belong to.

        Raises:
            InputError: If the file is missing, damaged, newer than this program, or of another arm.
        """
        path = _with_suffix(path)
        if not path.is_file():
            raise InputError(
                f"calibration file {path} does not exist; run `pickenv demo` or `pickenv calibrate` to make one"
            )
        try:
            with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
                arrays = {key: archive[key] for key in archive.files}
            header = json.loads(str(arrays.pop("header")))
            file_format = int(header["format"])
        except DAMAGE as error:
            raise _damaged(path, error) from error
        if file_format > FORMAT:
            raise InputError(f"{path} has format {file_format}, this program reads up to {FORMAT}; update pickenv")
        if arm is not None and header.get("arm_fingerprint") != arm.fingerprint():
            raise InputError(
                f"{path} belongs to arm '{header.get('arm')}' with another geometry than '{arm.name}'; "
                "fit it for this arm"
            )
        try:
            names, prismatic = tuple(header["joint_names"]), tuple(header["prismatic"])
            learnt = _part(arrays, "learnt")
            identified = geometry_from_arrays(_part(arrays, "identified"), names, prismatic)
            terms = tuple(term_from(term) for term in header["terms"])
            return Calibration(
                arm_name=header["arm"],
                arm_fingerprint=header["arm_fingerprint"],
                nominal=geometry_from_arrays(_part(arrays, "nominal"), names, prismatic),
                model=ArmModel(identified, terms, arrays["coefficients"]),
                learnt=LearntResidual.from_arrays(learnt) if learnt else None,
                record=header["record"],
            )
        except DAMAGE as error:
            raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> InputError:
    return InputError(f"{path} is not a calibration file or is damaged ({error}); fit it again")


def _with_suffix(path: str | Path) -> Path:
    path = Path(path)
    return path if path.suffix == ".npz" else path.with_name(path.name + ".npz")


def _part(arrays: Mapping[str, Array], prefix: str) -> dict[str, Array]:
    return {key.partition("/")[2]: value for key, value in arrays.items() if key.startswith(f"{prefix}/")}


def geometry_arrays(geometry: Geometry) -> dict[str, Array]:
    """A geometry's numbers by name, for saving."""
    named = {name: getattr(geometry, name) for name in (*LINK_PARAMETERS, "lower", "upper")}
    for key, pose in (("base", geometry.base), ("tool", geometry.tool)):
        named |= {f"{key}_position": pose.position, f"{key}_rotation": pose.rotation}
    if geometry.coupling is not None:
        coupling = geometry.coupling
        named["coupling"] = np.array([coupling.joint, coupling.ratio, coupling.slides], dtype=float)
    return named


def geometry_from_arrays(
    named: Mapping[str, Array], joint_names: tuple[str, ...], prismatic: tuple[bool, ...]
) -> Geometry:
    """The inverse of `geometry_arrays`."""
    numbers = {name: named[name] for name in (*LINK_PARAMETERS, "lower", "upper")}
    base = Pose(named["base_position"], named["base_rotation"])
    tool = Pose(named["tool_position"], named["tool_rotation"])
    coupling = None
    if "coupling" in named:
        joint, ratio, slides = named["coupling"].tolist()
        coupling = Coupling(tuple(int(i) for i in joint), tuple(ratio), tuple(bool(s) for s in slides))
    return Geometry(joint_names, prismatic, **numbers, base=base, tool=tool, coupling=coupling)
