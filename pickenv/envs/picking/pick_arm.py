"""The arm of `pickenv/Pick-v0` as pure functions on components: floats for one environment, NumPy arrays for many.

`pickenv.envs.picking.pick_scene` simulates the fruit. Units: m, rad, s.
"""

from __future__ import annotations

import math
from functools import lru_cache, reduce
from operator import or_
from types import ModuleType

import numpy as np
from scipy.spatial import cKDTree

from pickenv.arm import Array, Geometry, Plant, Pose, Scalar, Scalars, chosen, clipped, inverse
from pickenv.base import InputError
from pickenv.envs.shared import simulation, situation
from pickenv.envs.shared.backends import Executor, Flags
from pickenv.envs.shared.simulation import ArmState
from pickenv.envs.shared.spaces import spread_poses
from pickenv.envs.shared.task import Task, inexact

# Which points an arm reaches from below with its tool upright: where fruit can be picked. Base frame, m.


UP = np.array([0.0, 0.0, 1.0])
"""Direction in which the tool approaches a fruit, and in which it points there, base frame."""


class Reach:
    """Test whether the nominal arm, tool upright, reaches both a point and the point ``approach`` m below it.

    Attributes:
        ITERATIONS: Number of steps of the inverse kinematics that decides whether a point is in reach. With 15 steps,
            the decisions on 4000 points are the same.
    """

    ITERATIONS = 8

    def __init__(self, geometry: Geometry, approach: float) -> None:
        """Sample the arm's upright poses once; each test then starts from the sampled pose nearest to its point."""
        self.geometry, self.approach = geometry, approach
        joints, poses = spread_poses(geometry)
        upright = poses.rotation[:, 2, 2] > np.cos(np.radians(30.0))
        if not upright.any():
            raise InputError("this arm cannot hold its tool upright, so it cannot pick from below; take qiao2026")
        self.joints = joints[upright]
        self.rotations = np.array([_upright(rotation) for rotation in poses.rotation[upright]])
        self.tree = cKDTree(poses.position[upright])

    def __call__(self, positions: Array) -> Flags:
        """Return flags (n,) of the positions (n, 3), m, that are in reach."""
        if not len(positions):
            return np.zeros(0, dtype=np.bool_)
        points = np.concatenate([positions, positions - self.approach * UP])
        _, nearest = self.tree.query(points)
        solution = inverse(
            self.geometry,
            Pose(points, self.rotations[nearest]),
            self.joints[nearest],
            position_tolerance=5e-4,
            attitude_tolerance=0.02,
            max_iterations=self.ITERATIONS,
            restarts=0,
        )
        at, below = solution.reached.reshape(2, -1)
        return np.asarray(at & below)


@lru_cache(maxsize=4)
def reach_of(geometry: Geometry, approach: float) -> Reach:
    """Return the `Reach` of an arm for ``approach``, m. It is cached, so that its poses are sampled only once."""
    return Reach(geometry, approach)


def _upright(rotation: Array) -> Array:
    """Return the attitude (3, 3) near ``rotation`` (3, 3) whose tool axis points straight up."""
    x = rotation[:, 0] - rotation[2, 0] * UP
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(UP, x), UP], axis=-1)


STIRRED = 1e-9
"""Largest change of a joint target that still counts as standing still, rad or m."""


BELIEVED, TOOL, TURN, TILT, SIGHT = slice(0, 12), slice(12, 24), slice(24, 27), 27, 28


def act_arm(x: Executor, task: Task, state: ArmState, action: Scalars) -> tuple[ArmState, Scalar, Scalar, Scalar]:
    """Move the joint target by ``action``, or by an earlier action if actions are delayed.

    An action has one share of the largest increment (-1 to 1) per joint, then the gripper's command.

    Returns:
        Four values: the state with its new target, the gripper's command, whether the target moved, and the length of
        the period, s.
    """
    setting, values = task.situation, state.drawn
    (*moves, gripper), sent = situation.late(x, setting, "delay", values, state.sent, action)
    target = simulation.move(x, task, state.target, situation.in_period(x, setting, values, moves))
    stirred = reduce(or_, (abs(new - old) > STIRRED for new, old in zip(target, state.target, strict=True)))
    return state._replace(target=target, sent=sent), gripper, stirred, setting.value("period", values)


def look_at_arm(
    x: Executor, task: Task, plant: Plant, state: ArmState, command: Scalars, key: Scalar, moment: Scalar, dt: Scalar
) -> tuple[ArmState, simulation.Components]:
    """Hold the joint command for ``dt`` seconds, then measure the tool's true and believed pose.

    `pickenv.envs.shared.simulation.look` explains the arguments.

    Returns:
        The state afterwards, and the numbers measured. At `BELIEVED` is the frame of the believed tool, and at `TOOL`
        the tool's true frame. At `TURN` is the rotation vector from the believed attitude to upright, rad. At `TILT` is
        the angle between the true tool's axis and the vertical, deg. The joint readings, scaled to the limits, begin at
        `SIGHT`.
    """
    plant_state, ended = plant.advance(x.m, state.plant, command, dt)
    read = simulation.nominal_readings(x, plant, plant_state, state.target, command)
    arrived, late = simulation.sensed(x, task, state, key, moment, read, (), dt)
    pose, tool = simulation.nominal_frames(x, task, list(arrived))[1], inexact(ended)
    tilt = simulation.DEGREES * x.m.acos(clipped(x.m, tool[8], -1.0, 1.0))
    turn, readings = upright_turn(x.m, pose[6:9]), simulation.scaled(x, task, arrived)
    return state._replace(sensed=late, plant=plant_state), (*pose, *tool, *turn, tilt, *readings)


def upright_turn(m: ModuleType, axis: Scalars) -> simulation.Components:
    """Compute the rotation vector (rad, 3) of the shortest rotation that turns the unit vector ``axis`` to +z."""
    ax, ay, az = axis
    sine = m.sqrt(ax * ax + ay * ay)
    scale = m.atan2(sine, az) / (sine + 1e-30)
    about_x, about_y, about_z = ay * scale, -ax * scale, sine * 0.0
    reversed_ = (sine < 1e-12) & (az < 0)  # any axis across will do
    return chosen(m, reversed_, about_z + math.pi, about_x), chosen(m, reversed_, about_z, about_y), about_z
