"""What the tests of handing over share: arms that are off, calibrations of them, and referees."""

import os
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import Arm, Geometry, Pose, forward, geometry_from_axes, rotation_matrix
from pickenv.calibration import ArmModel, Calibration, Choices, Measurements, calibrate, random_joints
from pickenv.calibration.delivery.corrected_chain import link_frames

UR5 = Path("robots/ur_description/urdf/ur5_robot.urdf")
PANDA = Path("robots/panda_description/urdf/panda.urdf")


def off_by(geometry: Geometry, rng: np.random.Generator, beta: bool = True) -> Geometry:
    """The arm as it might have been made: millimetres and milliradians off in every parameter."""
    size = geometry.links
    return replace(
        geometry,
        alpha=geometry.alpha + rng.normal(size=size) * 3e-3,
        a=geometry.a + rng.normal(size=size) * 1e-3,
        theta=geometry.theta + rng.normal(size=size) * 5e-3,
        d=geometry.d + rng.normal(size=size) * 1e-3,
        beta=rng.normal(size=size) * 1e-3 if beta else geometry.beta,
    )


def somewhere(rng: np.random.Generator, reach: float = 1.0) -> Pose:
    return Pose(rng.normal(size=3) * reach, rotation_matrix(rng.normal(size=3)))


@pytest.fixture(scope="session")
def made() -> Callable[..., Calibration]:
    """``made(arm, rng, frames)``: a calibration that found every parameter off, without the measuring."""

    def calibration(arm: Arm, rng: np.random.Generator, frames: str = "known", beta: bool = True) -> Calibration:
        found, nominal = off_by(arm.nominal, rng, beta), arm.nominal
        if frames == "fitted":
            base, tool = somewhere(rng), somewhere(rng, 0.1)
            found, nominal = replace(found, base=base, tool=tool), replace(nominal, base=base, tool=tool)
        return Calibration(arm.name, arm.nominal, nominal, ArmModel.of(found), None, {"frames": frames})

    return calibration


@pytest.fixture(scope="session")
def measured() -> Callable[..., Calibration]:
    """``measured(arm, rng)``: calibrated on simulated poses, told by an instrument that stood anywhere."""

    def calibration(arm: Arm, rng: np.random.Generator) -> Calibration:
        true = replace(off_by(arm.nominal, rng, beta=False), base=somewhere(rng), tool=somewhere(rng, 0.1))
        sets = []
        for count in (70, 30):
            joints = random_joints(arm.nominal, count, rng)
            pose = forward(true, joints)
            position = pose.position + rng.normal(size=pose.position.shape) * 1e-4
            sets.append(Measurements(joints, position, pose.rotation, arm.nominal.prismatic, 1e-4, 1e-3))
        choices = Choices(terms="none", residual="none", frames="fitted")
        return calibrate(arm, sets[0], test=sets[1], choices=choices).calibration

    return calibration


@pytest.fixture(scope="session")
def robots() -> Path:
    """Folder of the PyPI package example-robot-data, whose files are no part of this project."""
    places = [Path(os.environ["PICKENV_ROBOTS"])] if "PICKENV_ROBOTS" in os.environ else []
    places += [Path(p) / "cmeel.prefix/share/example-robot-data" for p in sys.path]
    for place in places:
        if (place / "robots").is_dir():
            return place
    pytest.skip(
        "example-robot-data is not installed: pip install example-robot-data, or set PICKENV_ROBOTS to its folder"
    )


@pytest.fixture(scope="session")
def so101(data_folder: Path) -> Path:
    """The SO-101's folder, as its makers publish it."""
    return data_folder / "so101"


ARMS = ("so101", "ur5", "panda")


@pytest.fixture(params=ARMS)
def own_urdf(request: pytest.FixtureRequest) -> Path:
    """The URDF of an arm as its makers publish it."""
    if request.param == "so101":
        return request.getfixturevalue("so101") / "so101_new_calib.urdf"
    return request.getfixturevalue("robots") / (UR5 if request.param == "ur5" else PANDA)


@pytest.fixture(scope="session")
def in_mujoco() -> Callable[..., Pose]:
    """``in_mujoco(path, names, tip, joints, meshes)``: where MuJoCo has a link, body or site of a robot's file."""
    mujoco = pytest.importorskip("mujoco", reason="MuJoCo is the referee: pip install mujoco")

    def frames(path: Path, names: tuple[str, ...], tip: str, joints: np.ndarray, meshes: dict[str, bytes]) -> Pose:
        text = path.read_text(encoding="utf-8")
        static = '<mujoco><compiler fusestatic="false" discardvisual="true"/></mujoco></robot>'
        model = mujoco.MjModel.from_xml_string(text.replace("</robot>", static), meshes)
        data = mujoco.MjData(model)
        site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, tip) >= 0
        places = [model.joint(name).qposadr[0] for name in names]
        found = []
        for row in joints:
            data.qpos[places] = row
            mujoco.mj_kinematics(model, data)
            end = data.site(tip) if site else data.body(tip)
            found.append((end.xpos.copy(), end.xmat.reshape(3, 3).copy()))
        return Pose(*(np.array(part) for part in zip(*found, strict=True)))

    return frames


@pytest.fixture(scope="session")
def meshes_of() -> Callable[[Path], dict[str, bytes]]:
    """``meshes_of(path)``: the meshes that a robot's file names and MuJoCo reads, by their file's name."""

    def found(path: Path) -> dict[str, bytes]:
        text, files = path.read_text(encoding="utf-8"), {}
        for name in re.findall(r"""<mesh[^>]*file(?:name)?=["']([^"']+)["']""", text):
            folders = [path.parent, path.parent / "assets", *path.parents]
            paths = (folder / name.removeprefix("package://") for folder in folders)
            file = next(path for path in paths if path.is_file())
            if file.suffix.lower() in (".stl", ".obj"):
                files[file.name] = file.read_bytes()
        return files

    return found


@pytest.fixture(scope="session")
def rigid() -> Callable[[Pose, Pose], float]:
    """``rigid(one, other)``: how far two rows of frames are from standing in each other at one constant place.

    The larger of m and of matrix elements; frames of one link, whatever its origin and root, give rounding alone.
    """

    def apart(one: Pose, other: Pose, root: Pose | None = None) -> float:
        turned = one.rotation if root is None else root.rotation @ one.rotation
        place = one.position if root is None else root.position + one.position @ root.rotation.T
        hand = np.einsum("nji,nj->ni", turned, other.position - place)
        turn = np.swapaxes(turned, 1, 2) @ other.rotation
        return float(max(np.abs(hand - hand[0]).max(), np.abs(turn - turn[0]).max()))

    return apart


@pytest.fixture(scope="session")
def told_otherwise() -> Callable[[Geometry, np.random.Generator, bool], Geometry]:
    """``told_otherwise(arm, rng, plain)``: the arm as a vendor might tell it: another root, other zeros and signs."""

    def geometry(arm: Geometry, rng: np.random.Generator, plain: bool) -> Geometry:
        n = arm.joints
        sign = rng.choice([-1.0, 1.0], n)
        # Zeros well above what counts as a file's last digits, below which none is preferred.
        zero = np.where(arm.prismatic, 0.1, 1.0) * rng.choice([-1.0, 1.0], n) * rng.uniform(0.05, 3.0, n)
        if plain:
            sign, zero = np.ones(n), np.zeros(n)
        root = Pose(np.zeros(3), np.eye(3))
        if not plain:
            root = Pose(rng.normal(size=3), rotation_matrix(rng.normal(size=3)))
        frames, tool = link_frames(arm, zero), forward(arm, zero)
        points = np.array([root.position + root.rotation @ pose.position for pose in frames])
        directions = np.array([s * root.rotation @ pose.rotation[:, 2] for s, pose in zip(sign, frames, strict=True)])
        slip = np.where(arm.prismatic, 0.0, 1.0)[:, None] * rng.normal(size=(n, 1)) * directions  # anywhere on the axis
        end = Pose(root.position + root.rotation @ tool.position, root.rotation @ tool.rotation)
        return geometry_from_axes(
            arm.joint_names, arm.prismatic, points + slip, directions, end, -3 * np.ones(n), 3 * np.ones(n)
        )

    return geometry
