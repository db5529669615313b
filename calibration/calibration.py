"""A fitted calibration: fit, predict, compensate, save and load. One file, no pickle, refused on another arm."""

from __future__ import annotations

import json
import platform
import zipfile
import zlib
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from calibration.bpnn import Bpnn, BpnnSettings, train_bpnn
from calibration.compensation import Compensator
from calibration.error_model import ErrorModel, complete_model, frames_model, link_model, residual
from calibration.least_squares import Identification, align, identify, refuse_another_arm
from calibration.measurements import Measurements
from pickenv.arm import Arm, Geometry, Pose
from pickenv.arm.geometry import LINK_PARAMETERS, Array
from pickenv.errors import InputError
from pickenv.files import write_whole

FORMAT = 1
"""Version of the file format; newer files are refused by older programs."""

DAMAGE = (OSError, EOFError, ValueError, KeyError, TypeError, AttributeError, zipfile.BadZipFile, zlib.error)
"""What reading a file that is no calibration can raise."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """What a calibration found for one arm.

    Attributes:
        arm_name: Name of the arm.
        arm_fingerprint: Hash of the arm's nominal geometry; `load` refuses another arm's calibration.
        nominal: What the controller believes; where base and tool were fitted, with the fitted base and tool.
        identified: The calibrated geometry.
        network: Learnt residual, or None.
        record: Evidence for people and programs: data hash, seeds, versions, rank, dropped parameters.
    """

    arm_name: str
    arm_fingerprint: str
    nominal: Geometry
    identified: Geometry
    network: Bpnn | None
    record: Mapping[str, Any]

    def compensator(self, *, with_residual: bool = True) -> Compensator:
        """The map from joint targets to joint commands, with the learnt residual unless told otherwise."""
        return Compensator(self.nominal, self.identified, self.network if with_residual else None)

    def compensate(self, joints: ArrayLike) -> Array:
        """Joint commands for joint targets ``(..., n)``, rad or m."""
        return self.compensator()(joints)

    def predict(self, joints: ArrayLike) -> Pose:
        """Expected true tool pose at joint commands ``(..., n)``."""
        return self.compensator().predict(joints)

    def geometric(self) -> Calibration:
        """This calibration without its learnt residual."""
        return replace(self, network=None)

    def save(self, path: str | Path) -> Path:
        """Write one file (NumPy archive, no pickle), whole or not at all; ``.npz`` is appended if missing."""
        arrays: dict[str, Array] = {}
        for key, geometry in (("nominal", self.nominal), ("identified", self.identified)):
            arrays |= {f"{key}/{name}": value for name, value in geometry_arrays(geometry).items()}
        if self.network is not None:
            arrays |= {f"network/{name}": value for name, value in self.network.arrays().items()}
        header = {
            "format": FORMAT,
            "arm": self.arm_name,
            "arm_fingerprint": self.arm_fingerprint,
            "joint_names": self.nominal.joint_names,
            "prismatic": self.nominal.prismatic,
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
            with np.load(path, allow_pickle=False) as archive:
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
            network = _part(arrays, "network")
            return Calibration(
                arm_name=header["arm"],
                arm_fingerprint=header["arm_fingerprint"],
                nominal=geometry_from_arrays(_part(arrays, "nominal"), names, prismatic),
                identified=geometry_from_arrays(_part(arrays, "identified"), names, prismatic),
                network=Bpnn.from_arrays(network) if network else None,
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
    return named


def geometry_from_arrays(
    named: Mapping[str, Array], joint_names: tuple[str, ...], prismatic: tuple[bool, ...]
) -> Geometry:
    """The inverse of `geometry_arrays`."""
    numbers = {name: named[name] for name in (*LINK_PARAMETERS, "lower", "upper")}
    base = Pose(named["base_position"], named["base_rotation"])
    tool = Pose(named["tool_position"], named["tool_rotation"])
    return Geometry(joint_names, prismatic, **numbers, base=base, tool=tool)


@dataclass(frozen=True, eq=False)
class Fit:
    """A calibration together with how it was found.

    Attributes:
        calibration: The result.
        identification: Evidence of the least-squares stage.
        aligned: Evidence of the base and tool fit, where they were unknown.
    """

    calibration: Calibration
    identification: Identification
    aligned: Identification | None


def fit(
    arm: Arm,
    measurements: Measurements,
    residual_measurements: Measurements | None = None,
    *,
    known_frames: bool = False,
    rng: np.random.Generator | None = None,
    settings: BpnnSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Fit:
    """Calibrate an arm: least squares on the geometry, then, if data are given for it, the network on what remains.

    Args:
        arm: The arm.
        measurements: Poses for the identification (the paper: 100).
        residual_measurements: Poses for the network (the paper: 200), or None for geometry alone.
        known_frames: True if the instrument measures in the arm's own base frame with the tool known (simulation);
            then the paper's 24 parameters are identified. Else base, tool and Hayati's beta are fitted too.
        rng: Seeds the network; needed with ``residual_measurements``.
        settings: Network settings.
        progress: Called with (epochs done, epochs in all).

    Raises:
        InputError: If there are too few poses, the data do not fit the arm, or the identification does not converge.
    """
    aligned = None
    nominal = arm.nominal
    model: ErrorModel = link_model(nominal)
    if not known_frames:
        aligned = align(nominal, measurements, frames_model(nominal))
        nominal, model = aligned.geometry, complete_model(nominal)
    else:
        refuse_another_arm(nominal, measurements, "with base and tool taken as known")
    found = identify(model, nominal, measurements)
    if not found.converged:
        raise InputError(
            f"{measurements.source}: the identification did not converge (residual {found.residual_rms[-1]:.3g} "
            "standard uncertainties); check units, joint signs and outliers, or measure more varied poses"
        )
    network = None
    trained: dict[str, Any] | None = None
    if residual_measurements is not None:
        if rng is None:
            raise ValueError("give rng, which seeds the network")
        if residual_measurements.rotation is None:
            raise InputError(f"{residual_measurements.source}: the network learns pose residuals; measure full poses")
        targets = residual(found.geometry, residual_measurements)
        trained = {
            "data_fingerprint": residual_measurements.fingerprint(),
            "poses": len(residual_measurements),
            "settings": asdict(settings or BpnnSettings()),
            "generator": _generator_state(rng),
        }
        network = train_bpnn(residual_measurements.joints, targets, rng, settings, progress)
    record = {
        "source": measurements.source,
        "data_fingerprint": measurements.fingerprint(),
        "poses": len(measurements),
        "kind": measurements.kind,
        "rank": found.identifiability.rank,
        "dropped": {item.name: item.absorbed_by for item in found.identifiability.dropped},
        "network": trained,
        "versions": _versions("torch") if trained else _versions(),
    }
    calibration = Calibration(arm.name, arm.fingerprint(), nominal, found.geometry, network, record)
    return Fit(calibration, found, aligned)


def _generator_state(rng: np.random.Generator) -> Any:
    """The generator's state as it stands, in plain numbers: what reproduces the network to the bit."""

    def plain(value: Any) -> Any:
        if isinstance(value, dict):
            return {key: plain(item) for key, item in value.items()}
        return value.tolist() if isinstance(value, np.ndarray | np.generic) else value

    return plain(rng.bit_generator.state)


def _versions(*more: str) -> dict[str, str]:
    """Versions of what computed the calibration."""
    found = {"python": platform.python_version()}
    for name in ("pickenv", "numpy", "scipy", *more):
        try:
            found[name] = version(name)
        except PackageNotFoundError:  # a checkout that was never installed
            found[name] = "not installed"
    return found
