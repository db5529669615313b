"""A canopy and the arm that picks in it as a stage to draw. Units: m; mm in words."""

from __future__ import annotations

import numpy as np

from pickenv.arm import Array, Frame, Geometry
from pickenv.envs.picking.pick_scene import PickScene, PickSetting, to_base
from pickenv.envs.shared.arm_env import GHOST_WORDS, arm_at_work, staged, standing, tool_dial
from pickenv.pictures.arm_shapes import Solids, cup_solids, frustum_solids, hand_solids, joined_solids
from pickenv.pictures.stage import SIZE, Eye, Mesh, Stage, Words
from pickenv.pictures.tree_shapes import GREEN, MISSED_FRUIT, crate, fruit_colours, fruit_solids, row_of_trees

CAMERA = (110, 96, 160)


def draw_pick(
    nominal: Geometry, command: Array, tool: Frame, believed: Frame, scene: PickScene, number: int, dark: bool
) -> Stage:
    """The arm, its ghost, its gripper, the camera and the trees.

    Args:
        nominal: The arm as its controller believes it to be.
        command: What the drives got ``(n,)``, rad or m.
        tool: Frame of the true tool.
        believed: Frame of the tool as the controller believes it to be.
        scene: The fruit.
        number: The fruit that the arm is after.
        dark: Whether the background is dark.
    """
    orchard, funnel = scene.orchard, scene.funnel()
    point, axis = np.array(tool[9:]), np.array(tool[6:9])
    offset = point - scene.positions[number]
    solids = joined_solids(
        arm_at_work(nominal, command, point, axis, np.array(believed[9:])),
        gripper_solids(orchard, point, axis, scene.held is not None),
        canopy_fruit(scene),
        crate(pick_eye(orchard), SIZE, funnel["collected"], float(np.mean(scene.diameters)), ground_of(orchard)),
        camera_solids(orchard),
    )
    missed = scene.attempted & ~scene.attached
    words = [
        Words(f"picked {funnel['collected']} of {funnel['reachable']}", "top left", large=True),
        Words(f"missed {int(missed.sum())}", "top left"),
        Words(f"{1e3 * float(np.linalg.norm(offset)):.1f} mm from the fruit", "top right"),
        Words(GHOST_WORDS, "bottom left"),
    ]
    still = (*standing(nominal, ground_of(orchard), dark), *trees_of(orchard))
    dial = tool_dial(axis, offset, 1e3 * orchard.gripper.tolerance)
    return staged(solids, still, pick_eye(orchard), tuple(words), dial, dark)


def gripper_solids(orchard: PickSetting, point: Array, axis: Array, closed: bool) -> Solids:
    """The cup, as wide as its opening; or the hand, around a usual fruit."""
    if orchard.gripper.kind == "cup":
        return cup_solids(point, axis, orchard.station.tool_radius)
    return hand_solids(point, axis, orchard.station.tool_radius, closed)


def canopy_fruit(scene: PickScene) -> Solids:
    """Fruit that hangs or is in the gripper: ripe where it can still be tried, another colour where it was missed."""
    there = ~scene.collected & ~(scene.damaged & scene.detached)
    if scene.held is not None:
        there[scene.held] = True
    colours = fruit_colours(len(scene.rest))
    colours[~scene.reachable] = GREEN
    colours[scene.attempted & ~scene.attached] = MISSED_FRUIT
    held = there & scene.detached
    hanging = there & ~held
    places, sizes = scene.positions, scene.diameters
    return joined_solids(
        fruit_solids(places[hanging], sizes[hanging], colours[hanging]),
        fruit_solids(places[held], sizes[held], colours[held], stems=False),
    )


def camera_solids(orchard: PickSetting) -> Solids:
    """The camera that looks at the canopy, and what it sees."""
    canopy, camera = orchard.canopy, orchard.camera
    middle = (canopy.bottom + canopy.top) / 2
    eye = to_base(orchard, np.array([0.0, -canopy.standoff, middle]))
    ahead = to_base(orchard, np.array([0.0, 0.0, middle])) - eye
    half_angles = [side / 2 / camera.focal_length for side in camera.image]
    return frustum_solids(eye, ahead / np.linalg.norm(ahead), half_angles, 0.3 * float(np.linalg.norm(ahead)), CAMERA)


def trees_of(orchard: PickSetting) -> tuple[Mesh, ...]:
    """The section of canopy before the arm."""
    canopy = orchard.canopy
    ends = np.array([[-canopy.width / 2, 0.0, canopy.bottom], [canopy.width / 2, canopy.depth, canopy.top]])
    corners = to_base(orchard, ends)
    low, high = (tuple(float(value) for value in end) for end in (corners.min(axis=0), corners.max(axis=0)))
    return row_of_trees(low, high, canopy.leaf_area_per_volume, ground_of(orchard))


def ground_of(orchard: PickSetting) -> float:
    """Height of the ground in the arm's base frame, m."""
    return float(to_base(orchard, np.zeros(3))[2])


def pick_eye(orchard: PickSetting) -> Eye:
    """From behind the arm, to its side and above it."""
    canopy = orchard.canopy
    face = to_base(orchard, np.array([0.0, 0.0, (canopy.bottom + canopy.top) / 2]))
    target = face * [0.62, 0.62, 0.62]
    return Eye(target + np.array([1.35, 2.15, 0.75]), target)
