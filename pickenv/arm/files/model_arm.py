"""The arm in a loaded MuJoCo model: its nominal geometry, its present joints, and changes that make it the true arm.

MuJoCo is imported when it is first needed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.kinematics.forward import (
    Chain,
    Frame,
    attach,
    chain_of,
    frame_of,
    frame_within,
    frames,
    geometry_from_axes,
)
from pickenv.arm.kinematics.geometry import Array, Geometry, Pose, identity_pose
from pickenv.base import InputError, listed, require

SLIDE, HINGE = 2, 3
"""MuJoCo's numbers of the joint types that an arm may have: slide and hinge."""


def geometry_in_mujoco(model: Any, site: str, joints: Sequence[str] | None = None, data: Any = None) -> Geometry:
    """Return the nominal geometry of the arm that moves a site, in the model's world frame.

    Args:
        model: `mujoco.MjModel`.
        site: Name of the site at the tool.
        joints: Names of the arm's joints from base to tool; by default all joints that move the site.
        data: `mujoco.MjData` with the positions of all other joints; by default the model's initial positions.

    Raises:
        MissingExtra: If MuJoCo is not installed.
        InputError: If the site or a joint is missing, a joint does not move the site, or is a ball joint.
    """
    require("mujoco")
    mujoco: Any = import_module("mujoco")
    if (number := mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, site)) < 0:
        raise InputError(f"the model has no site '{site}'; name the one at the arm's tool")
    chain: list[int] = []
    body = int(model.site_bodyid[number])
    while body > 0:
        first = int(model.body_jntadr[body])
        chain = [*range(first, first + int(model.body_jntnum[body])), *chain]
        body = int(model.body_parentid[body])
    names = {mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint) or f"joint{joint}": joint for joint in chain}
    selection = tuple(joints) if joints is not None else tuple(names)
    if lost := [name for name in selection if name not in names]:
        raise InputError(f"joint '{lost[0]}' does not move site '{site}'; its joints are {', '.join(names)}")
    numbers = [joint for name, joint in names.items() if name in selection]
    kinds = [int(model.jnt_type[joint]) for joint in numbers]
    if not numbers or not set(kinds) <= {SLIDE, HINGE}:
        raise InputError(f"the joints before site '{site}' are not all slides and hinges; name those of the arm")
    still = mujoco.MjData(model)
    if data is not None:
        still.qpos[:] = data.qpos
        still.mocap_pos[:], still.mocap_quat[:] = data.mocap_pos, data.mocap_quat
    still.qpos[model.jnt_qposadr[numbers]] = 0.0
    mujoco.mj_kinematics(model, still)
    ranges = np.array(model.jnt_range[numbers], dtype=float)
    ranges[~((model.jnt_limited[numbers] != 0) & (np.ptp(ranges, axis=1) > 0.0))] = -np.pi, np.pi
    tool = Pose(still.site_xpos[number].copy(), still.site_xmat[number].reshape(3, 3).copy())
    titles, slides = tuple(name for name in names if name in selection), tuple(kind == SLIDE for kind in kinds)
    return geometry_from_axes(titles, slides, still.xanchor[numbers], still.xaxis[numbers], tool, *ranges.T)


def joints_in_mujoco(model: Any, data: Any, geometry: Geometry) -> Array:
    """Return the present joint displacements ``(n,)``, rad or m, of the arm in a simulation.

    Args:
        model: `mujoco.MjModel`.
        data: `mujoco.MjData` of the simulation.
        geometry: The arm's geometry, from `geometry_in_mujoco`.
    """
    return np.array([data.qpos[model.joint(name).qposadr[0]] for name in geometry.joint_names])


SAME = 1e-6
"""Largest difference between entries of a frame in the model and in the nominal arm that counts as rounding."""


@dataclass(frozen=True, eq=False)
class ModelArm:
    """The arm in a MuJoCo model, with methods that move its bodies so that the arm has another geometry.

    Attributes:
        model: `mujoco.MjModel`. The poses of bodies and the axis of the last joint are changed in it.
        nominal: The geometry of the unchanged model.
        joints: Indices of the arm's joints in the model ``(n,)``.
        bodies: Indices of the bodies that these joints move ``(n,)``.
        above: Frame of each body's parent body (n frames): the first in world axes, each later one in the frame of the
            previous link.
        within: Frame of each body in its link's frame (n frames).
        pivot: Axis of the last joint and a point on it, in the last link's frame ``(2, 3)``, m.
    """

    model: Any
    nominal: Geometry
    joints: NDArray[np.int64]
    bodies: NDArray[np.int64]
    above: tuple[Frame, ...]
    within: tuple[Frame, ...]
    pivot: Array

    @cached_property
    def places(self) -> NDArray[np.int64]:
        """Indices of the joints' positions in ``qpos`` ``(n,)``."""
        return np.asarray(self.model.jnt_qposadr[self.joints])

    @cached_property
    def rest(self) -> list[float]:
        """Displacements of the n joints, rad or m, for which the model gives the poses of its bodies (``qpos0``)."""
        return list(self.model.qpos0[self.places].tolist())

    def take(self, geometry: Geometry) -> None:
        """Give the model's arm the base, links and tool of another geometry; bodies attached to a link move along."""
        chain = chain_of(geometry)
        links = frames(math, chain, self.rest)[1:]
        steps = [links[0], *(frame_within(*pair) for pair in pairwise(links))]
        for body, above, step, within in zip(self.bodies, self.above, steps, self.within, strict=True):
            self._put(body, attach(frame_within(above, step), within))
        self.put_tool(chain, self.rest, attach(links[-1], chain.tool))

    def put_tool(self, chain: Chain, joints: Sequence[float], tool: Frame) -> None:
        """Move the last body so that the tool has the frame ``tool`` when the joints have the displacements ``joints``.

        Args:
            chain: The chain of the geometry that the model's arm has now.
            joints: Displacements of the n joints, rad or m.
            tool: Frame of the tool in world axes.
        """
        *_, before, last = frames(math, chain, joints)
        resting = frames(math, chain, [*joints[:-1], self.rest[-1]])[-1]
        shift = attach(frame_within(last, tool), self._untool)  # of all that hangs on the last link
        inner, above = attach(shift, self.within[-1]), self.above[-1]
        parent = attach(before, above) if len(self.bodies) > 1 else above
        self._put(self.bodies[-1], attach(frame_within(parent, resting), inner))
        turned, joint = np.array(inner[:9]).reshape(3, 3), self.joints[-1]
        self.model.jnt_axis[joint] = turned @ self.pivot[0]
        self.model.jnt_pos[joint] = turned @ (self.pivot[1] - inner[9:])

    @cached_property
    def _untool(self) -> Frame:
        return frame_within(frame_of(self.nominal.tool), frame_of(identity_pose()))

    def _put(self, body: int, frame: Frame) -> None:
        self.model.body_pos[body] = frame[9:]
        self.model.body_quat[body] = quaternion(np.array(frame[:9]).reshape(3, 3).T)


def quaternion(rotation: Array) -> Array:
    """Return the quaternion ``(4,)``, w first as in MuJoCo, of a rotation matrix ``(3, 3)``."""
    components = np.zeros(4)
    import_module("mujoco").mju_mat2Quat(components, np.ravel(rotation))
    return components


def arm_in_mujoco(model: Any, nominal: Geometry) -> ModelArm:
    """Return the arm in a model as a `ModelArm`, after checking that its geometry is the nominal one.

    Args:
        model: `mujoco.MjModel`; this function does not change it.
        nominal: The nominal geometry, whose joints have their names in the model. Its tool need not exist in the model.

    Raises:
        InputError: If a joint is missing, a joint moves several links, two joints move one body, or the model's arm
            differs from the nominal one. The message says where.
    """
    if nominal.coupling is not None:
        raise InputError("joints of the arm move several links; give an arm whose joints move one link each")
    names = [model.joint(number).name for number in range(model.njnt)]
    if lost := [name for name in nominal.joint_names if name not in names]:
        raise InputError(f"the model has no joint '{lost[0]}'; its joints are {listed(names, 200)}")
    mujoco: Any = import_module("mujoco")
    joints = np.array([names.index(name) for name in nominal.joint_names])
    bodies = model.jnt_bodyid[joints]
    if len(set(bodies.tolist())) < len(bodies):
        raise InputError("two joints of the arm move one body; put a body between them")
    data, places, chain = mujoco.MjData(model), model.jnt_qposadr[joints], chain_of(nominal)

    def stands(joints: Array) -> tuple[list[Frame], list[Frame]]:
        """Return the frames ``above`` and ``within`` of `ModelArm`, computed at joints ``(n,)``, rad or m."""
        data.qpos[:] = model.qpos0
        data.qpos[places] = joints
        mujoco.mj_kinematics(model, data)
        links = frames(math, chain, joints.tolist())[1:]
        above, poses = (
            [frame_of(Pose(data.xpos[body], data.xmat[body].reshape(3, 3))) for body in numbers]
            for numbers in (model.body_parentid[bodies], bodies)
        )
        return [above[0], *map(frame_within, links[:-1], above[1:])], list(map(frame_within, links, poses))

    above, within = stands(model.qpos0[places])
    # At other joints bodies stand in their links as before, or the links are not the model's.
    _, elsewhere = stands(nominal.lower + np.linspace(0.3, 0.7, nominal.joints) * (nominal.upper - nominal.lower))
    gaps = np.abs(np.array(within) - np.array(elsewhere)).max(axis=1)
    if (gaps > SAME).any():
        name = nominal.joint_names[int(np.argmax(gaps > SAME))]
        raise InputError(f"the model's arm is not the nominal one at joint '{name}'; give the arm file of this model")
    axis, point, turned = model.jnt_axis[joints[-1]], model.jnt_pos[joints[-1]], np.array(within[-1]).reshape(4, 3)
    pivot = np.stack([axis @ turned[:3], turned[3] + point @ turned[:3]])
    return ModelArm(model, nominal, joints, bodies, tuple(above), tuple(within), pivot)
