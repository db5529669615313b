"""Simulated whole robots: URDF text, kinematics of their own, and what trackers and cameras see of them.

The truth is built joint by joint from the URDF's numbers with matrices of 4 x 4, and knows nothing of DH tables.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pickenv.arm import Array

AXES = np.eye(3)[[2, 1, 1, 0, 1, 0]]
"""Axes of a branch's joints in turn."""

GRAVITY, GOLDEN = 9.81, (1.0 + np.sqrt(5.0)) / 2.0
LENS = {"fx": 900.0, "fy": 900.0, "cx": 640.0, "cy": 480.0, "width": 1280, "height": 960}
BOARD = np.array([[0.03 * (i % 6 + 1), 0.03 * (i // 6 + 1), 0.0] for i in range(30)])
"""Inner corners of a chessboard of 7 x 6 squares of 30 mm, m."""


DODECAHEDRON = np.array(
    [
        *([x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)),
        *(np.roll([0.0, a / GOLDEN, b * GOLDEN], k) for k in range(3) for a in (-1, 1) for b in (-1, 1)),
    ]
) * (0.05 / np.sqrt(3.0))
"""The 20 points in the middle of an icosahedron's faces, m."""


FACES = np.array([np.roll([a, 0.0, 0.0], k) for k in range(3) for a in (-1.0, 1.0)])
CUBE = np.concatenate(
    [0.03 * n + 0.022 * np.array([a * u + b * v for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))])
     for n, u, v in ((n, np.roll(n, 1), np.roll(n, 2)) for n in FACES)]
)  # fmt: skip
"""The corners of six tags of 44 mm on the faces of a cube of 60 mm, m; four for each face."""


def matrix(position: Sequence[float] | Array = (0.0, 0.0, 0.0), rotation: Array | None = None) -> Array:
    """A pose as a matrix ``(4, 4)``."""
    pose = np.eye(4)
    pose[:3, 3] = position
    if rotation is not None:
        pose[:3, :3] = rotation
    return pose


@dataclass(frozen=True, eq=False)
class Joint:
    """A joint of a tree: kind, link before and behind, origin ``(4, 4)`` and axis ``(3,)``."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Array
    axis: Array


@dataclass(frozen=True, eq=False)
class Robot:
    """A tree of joints; the torso's last link yields about its axes under the weight of what it carries."""

    joints: tuple[Joint, ...]
    masses: Mapping[str, float]
    yields: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def moving(self) -> list[str]:
        """Names of the joints that move, from the root outwards."""
        return [joint.name for joint in self.joints if joint.kind != "fixed"]

    def poses(self, values: Mapping[str, float]) -> dict[str, Array]:
        """The pose ``(4, 4)`` of each link at joint values by name; joints that are not named are at zero."""
        poses = {"base": np.eye(4)}
        for joint in self.joints:
            value, moved = values.get(joint.name, 0.0), np.eye(4)
            if joint.kind == "revolute":
                moved = matrix(rotation=Rotation.from_rotvec(value * joint.axis).as_matrix())
            elif joint.kind == "prismatic":
                moved = matrix(value * joint.axis)
            poses[joint.child] = poses[joint.parent] @ joint.origin @ moved
        return self._bent(poses) if any(self.yields) else poses

    def _bent(self, poses: dict[str, Array]) -> dict[str, Array]:
        torso, carried = poses["torso2"], {link for link in poses if link.startswith(("left", "right", "head"))}
        levers = {link: poses[link][:3, 3] - torso[:3, 3] for link in self.masses}
        moment = sum(np.cross(levers[link], [0.0, 0.0, -GRAVITY * mass]) for link, mass in self.masses.items())
        turn = Rotation.from_rotvec(np.array(self.yields) * (torso[:3, :3].T @ moment)).as_matrix()
        bend = torso @ matrix(rotation=turn) @ np.linalg.inv(torso)
        return {link: bend @ pose if link in carried else pose for link, pose in poses.items()}

    def urdf(self) -> str:
        """The robot as URDF."""
        text = ['<robot name="torso">', '<link name="base"/>']
        for joint in self.joints:
            xyz = " ".join(map(repr, joint.origin[:3, 3].tolist()))
            rpy = " ".join(map(repr, Rotation.from_matrix(joint.origin[:3, :3]).as_euler("xyz").tolist()))
            axis = " ".join(map(str, joint.axis.tolist()))
            mass = self.masses.get(joint.child, 1e-6)
            inertia = '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
            text += [
                f'<link name="{joint.child}"><inertial><mass value="{mass}"/>{inertia}</inertial></link>',
                f'<joint name="{joint.name}" type="{joint.kind}"><parent link="{joint.parent}"/>',
                f'<child link="{joint.child}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="{axis}"/>',
                '<limit lower="-1.5" upper="1.5" velocity="1" effort="1"/></joint>',
            ]
        return "\n".join([*text, "</robot>", ""])


def drawn_robot(rng: np.random.Generator) -> Robot:
    """A torso that lifts and leans, a head of two joints and two arms of six, with parts of random size."""
    joints = _branch("torso", "base", 2, 0.25, rng)
    joints[0] = replace(joints[0], kind="prismatic")
    for name, count, size in (("head", 2, 0.15), ("left", 6, 0.25), ("right", 6, 0.25)):
        joints += _branch(name, "torso2", count, size, rng)
    masses = {f"{side}{i}": float(rng.uniform(0.5, 3.0)) for side in ("left", "right") for i in range(1, 7)}
    return Robot(tuple(joints), masses)


def _branch(name: str, parent: str, count: int, size: float, rng: np.random.Generator) -> list[Joint]:
    joints = []
    for i in range(count + 1):
        kind, child = ("revolute", f"{name}{i + 1}") if i < count else ("fixed", f"{name}_tip")
        turn = Rotation.from_euler("xyz", rng.uniform(-0.4, 0.4, 3)).as_matrix()
        origin = matrix(rng.uniform(-size, size, 3), turn)
        joints.append(
            Joint(f"{name}_j{i + 1}" if i < count else f"{name}_mount", kind, parent, child, origin, AXES[i % 6])
        )
        parent = child
    return joints


def built(robot: Robot, rng: np.random.Generator, mm: float = 0.3, mrad: float = 0.5) -> Robot:
    """The robot as it was built: each origin off by these standard deviations per axis."""
    parts = []
    for joint in robot.joints:
        turn = Rotation.from_rotvec(rng.normal(size=3) * mrad * 1e-3).as_matrix() @ joint.origin[:3, :3]
        parts.append(replace(joint, origin=matrix(joint.origin[:3, 3] + rng.normal(size=3) * mm * 1e-3, turn)))
    return replace(robot, joints=tuple(parts))


def _described(
    folder: Path, name: str, joints: Sequence[str], section: str, header: str, rows: Array, scene: str
) -> None:
    np.savetxt(folder / f"{name}.csv", rows, "%.9g", ",", header=header, comments="")
    units = ["m" if joint == "torso_j1" else "rad" for joint in joints]
    text = f"[joints]\ncolumns = {list(joints)}\nunits = {units}\n{section}\n[scene]\n{scene}\n".replace("'", '"')
    (folder / f"{name}.toml").write_text(text, encoding="utf-8")


def track(
    robot: Robot,
    joints: Sequence[str],
    link: str,
    folder: Path,
    rng: np.random.Generator,
    stand: Array,
    rows: int = 120,
    whole: bool = True,
) -> None:
    """Write what a tracker sees of a ball on a link, and its description; ``stand`` ``(4, 4)`` is the base's pose."""
    noise, ball = 3e-5, np.append(rng.uniform(-0.1, 0.1, 3), 1.0)
    values = rng.uniform(-1.2, 1.2, (rows, len(joints)))
    seen = [(stand @ robot.poses(dict(zip(joints, row, strict=True)))[link] @ ball)[:3] for row in values]
    position = np.array(seen) + noise * rng.normal(size=(rows, 3))
    section = '[position]\ncolumns = ["x", "y", "z"]\nunit = "m"\nstd_mm = 0.03'
    scene = f'sensor = "tracker"\ntarget = "ball on {link}"' + (f'\ntarget_link = "{link}"' if whole else "")
    _described(folder, link, joints, section, ",".join([*joints, "x", "y", "z"]), np.c_[values, position], scene)


def looking(place: Array, at: Array) -> Array:
    """The pose ``(4, 4)`` of a camera at a place ``(3,)`` that looks at another."""
    ahead = (at - place) / np.linalg.norm(at - place)
    across = np.cross([0.0, 0.0, 1.0], ahead) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], ahead))
    return matrix(place, np.stack([across, np.cross(ahead, across), ahead], 1))


def watch(
    robot: Robot,
    joints: Sequence[str],
    link: str,
    folder: Path,
    rng: np.random.Generator,
    *,
    name: str,
    carrier: str,
    camera: Array,
    board: Array,
    scene: str,
    views: int = 40,
    most: int = 0,
    cube: bool = False,
) -> None:
    """Write the corners of a chessboard on a link that a camera sees, or points of a body, and their description.

    Args:
        robot: The robot.
        joints: The joints that move.
        link: The link with the board.
        folder: Where to write <name>.csv and <name>.toml.
        rng: Draws joints and noise.
        name: Name of the files.
        carrier: The link with the camera.
        camera: Pose of the camera in its link ``(4, 4)``.
        board: Pose of the board in its link ``(4, 4)``.
        scene: Lines of [scene].
        views: Number of views.
        most: If given, the link has a dodecahedron for a board, and 3 to so many of its points are seen in a view.
        cube: Whether the link has a cube of tags for a board.
    """
    pixel, places = 0.15, CUBE if cube else DODECAHEDRON if most else BOARD
    table: list[list[float]] = []
    view = 0
    while view < views:
        values = rng.uniform(-0.9, 0.9, len(joints))
        poses = robot.poses(dict(zip(joints, values, strict=True)))
        stands = np.linalg.inv(poses[carrier] @ camera) @ poses[link] @ board
        points = places @ stands[:3, :3].T + stands[:3, 3]
        facing = stands[:3, 2] @ points.mean(0) > 0.5 * np.linalg.norm(points.mean(0))
        if points[:, 2].min() < 0.15 or not (facing or most or cube):
            continue
        seen = points[:, :2] / points[:, 2:] * 900.0 + (640.0, 480.0)
        inside = ((seen > 5.0) & (seen < (1275.0, 955.0))).all(axis=1)
        if cube:  # whole tags, seen from without at 70 degrees or less
            normals, middles = FACES @ stands[:3, :3].T, points.reshape(6, 4, 3).mean(axis=1)
            slant = -np.sum(normals * middles, axis=1) / np.linalg.norm(middles, axis=1)
            inside = np.repeat(inside.reshape(6, 4).all(axis=1) & (slant > np.cos(np.radians(70.0))), 4)
        if inside.sum() < (4 if cube else 12):
            continue
        if most:  # of the near half, some
            near = np.argsort(np.linalg.norm(points, axis=1))[:10]
            inside &= np.isin(np.arange(20), rng.choice(near, rng.integers(3, most + 1), replace=False))
        noise = pixel * rng.normal(size=seen.shape)
        table += [[view, *values, i, *(seen[i] + noise[i])] for i in np.flatnonzero(inside)]
        view += 1
    lens = "\n".join(f"{key} = {value}" for key, value in LENS.items())
    mount = "" if "_link" in scene else 'mount = "world"\n'
    section = f'[pixels]\n{mount}columns = ["u", "v"]\nview = "view"\ncorner = "corner"\nstd_px = {pixel}\n'
    board_text = '[board]\nkind = "chessboard"\ncolumns = 7\nrows = 6\nsquare_mm = 30'
    if most or cube:
        board_text = f"[target]\npoints_mm = {(1e3 * places).ravel().tolist()}"
    section += f"[camera]\n{lens}\n{board_text}"
    _described(folder, name, joints, section, ",".join(["view", *joints, "corner", "u", "v"]), np.array(table), scene)


def head_watches(
    robot: Robot,
    joints: Sequence[str],
    link: str,
    folder: Path,
    rng: np.random.Generator,
    views: int = 40,
    cube: bool = False,
) -> None:
    """Write what a camera on the head sees of a board or a cube of tags on a link: camera.csv and camera.toml."""
    at_zero = robot.poses({})
    there = np.linalg.inv(at_zero["head_tip"]) @ at_zero[link]
    camera = looking(rng.uniform(-0.05, 0.05, 3), there[:3, 3])
    facing = at_zero[link][:3, :3].T @ at_zero["head_tip"][:3, :3] @ camera[:3, :3]
    board = matrix(rng.uniform(-0.05, 0.05, 3), facing)
    scene = f'sensor_link = "head_tip"\ntarget_link = "{link}"'
    watch(
        robot, joints, link, folder, rng,
        name="camera", carrier="head_tip", camera=camera, board=board, scene=scene, views=views, cube=cube,
    )  # fmt: skip


def two_cameras_watch(
    robot: Robot, joints: Sequence[str], link: str, folder: Path, rng: np.random.Generator, most: int = 0
) -> None:
    """Write what two cameras in the world see of one board or body on a link: camera1 and camera2, .csv and .toml."""
    tip = robot.poses({})[link]
    board = looking(rng.uniform(-0.05, 0.05, 3), rng.uniform(-1.0, 1.0, 3))
    there = tip @ board
    for i, aside in enumerate((-0.35, 0.35), start=1):
        place = there[:3, 3] + there[:3, :3] @ (aside, 0.1 * i, -0.9)
        scene = f'sensor = "camera {i}"\ntarget = "board"'
        camera = looking(place, there[:3, 3])
        watch(
            robot, joints, link, folder, rng,
            name=f"camera{i}", carrier="base", camera=camera, board=board, scene=scene,
            views=50 if most else 25, most=most,
        )  # fmt: skip


def apart(one: Array, other: Array) -> float:
    """How far two motions ``(N, 4, 4)`` differ, m and rad, wherever the frames at either end are.

    A motion away from the first pose is a screw. Its angle, its advance, and the angles between the screws' axes do
    not depend on the frames.
    """
    numbers = []
    for motion in (one, other):
        steps = np.linalg.inv(motion[0]) @ motion[1:]
        turns = Rotation.from_matrix(steps[:, :3, :3]).as_rotvec()
        numbers.append(np.concatenate([(turns @ turns.T).ravel(), np.sum(turns * steps[:, :3, 3], axis=1)]))
    return float(np.abs(numbers[0] - numbers[1]).max())
