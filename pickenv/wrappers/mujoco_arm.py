"""The arm inside a MuJoCo model, as this project knows arms: its nominal geometry, and its joints at the moment."""

from __future__ import annotations

from collections.abc import Sequence
from importlib import import_module
from typing import Any

import numpy as np

from pickenv.arm import Array, Geometry, Pose
from pickenv.arm.kinematics.axes import geometry_from_axes
from pickenv.errors import InputError

SLIDE, HINGE = 2, 3
"""MuJoCo's numbers of the joint types of an arm."""


def geometry_in_mujoco(model: Any, site: str, joints: Sequence[str] | None = None, data: Any = None) -> Geometry:
    """The nominal chain that moves a site, in the model's world.

    Args:
        model: `mujoco.MjModel`.
        site: Name of the site at the tool.
        joints: The arm's joints from base to tool; all that move the site when left out.
        data: `mujoco.MjData` that says where all other joints stand; where the model has them when left out.

    Raises:
        InputError: If MuJoCo, the site or a joint is missing, a joint does not move the site, or is a ball.
    """
    mujoco = mujoco_or_sentence()
    number = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, site)
    if number < 0:
        raise InputError(f"the model has no site '{site}'; name the one at the arm's tool")
    chain: list[int] = []
    body = int(model.site_bodyid[number])
    while body > 0:
        first = int(model.body_jntadr[body])
        chain += reversed(range(first, first + int(model.body_jntnum[body])))
        body = int(model.body_parentid[body])
    chain.reverse()
    names = {mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_JOINT, joint) or f"joint{joint}": joint for joint in chain}
    wanted = tuple(joints) if joints is not None else tuple(names)
    if lost := [name for name in wanted if name not in names]:
        raise InputError(f"joint '{lost[0]}' does not move site '{site}'; its joints are {', '.join(names)}")
    own = [joint for name, joint in names.items() if name in wanted]
    kinds = [int(model.jnt_type[joint]) for joint in own]
    if not own or not set(kinds) <= {SLIDE, HINGE}:
        raise InputError(f"the joints before site '{site}' are not all slides and hinges; name those of the arm")
    still = mujoco.MjData(model)
    if data is not None:
        still.qpos[:] = data.qpos
        still.mocap_pos[:], still.mocap_quat[:] = data.mocap_pos, data.mocap_quat
    still.qpos[model.jnt_qposadr[own]] = 0.0
    mujoco.mj_kinematics(model, still)
    ranges = [
        model.jnt_range[j] if model.jnt_limited[j] and np.ptp(model.jnt_range[j]) else [-np.pi, np.pi] for j in own
    ]
    tool = Pose(still.site_xpos[number].copy(), still.site_xmat[number].reshape(3, 3).copy())
    return geometry_from_axes(
        tuple(name for name in names if name in wanted),
        tuple(kind == SLIDE for kind in kinds),
        still.xanchor[own],
        still.xaxis[own],
        tool,
        *np.array(ranges, dtype=float).T,
    )


def joints_in_mujoco(model: Any, data: Any, geometry: Geometry) -> Array:
    """Present displacements ``(n,)`` of an arm that `geometry_in_mujoco` found, rad or m."""
    return np.array([data.qpos[model.joint(name).qposadr[0]] for name in geometry.joint_names])


def mujoco_or_sentence() -> Any:
    """MuJoCo.

    Raises:
        InputError: If it is not installed.
    """
    try:
        return import_module("mujoco")
    except ImportError as error:
        raise InputError("MuJoCo is not installed, and the environment is one of it; pip install mujoco") from error
