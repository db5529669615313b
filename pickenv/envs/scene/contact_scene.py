"""The scene of `pickenv/PickScene-v0` as a MuJoCo model: the arm, fruit on a branch, leaves and cameras.

The MuJoCo model's arm is the true arm. The plant (the model of the true arm's errors) computes the tool's true frame,
and joint positions with the errors of drives, gears and joints. MuJoCo drives the joints to these positions, and shifts
the last link so that the true gripper touches the fruit. Arms have no weight in MuJoCo, since the plant computes how
they sag. Units: m, kg, s, N, rad.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Arm, Array, Frame, Plant, Pose, frame_of, frame_within, rotation_matrix
from pickenv.arm.files.mjcf import mjcf_text
from pickenv.arm.files.model_arm import ModelArm, arm_in_mujoco, quaternion
from pickenv.base import GRAVITY, InputError, is_file, require
from pickenv.orchard.fruit import Branch, Detachment, FruitSize, fruit_masses, sample_strength
from pickenv.orchard.gripper import Gripper, Suction
from pickenv.pictures.stage import Eye, Pixels

require("mujoco")
import mujoco  # noqa: E402

TIMESTEP, CHUNK = 0.004, 5
STIFFNESS, DAMPING, ARMATURE = 5000.0, 150.0, 1.0
CAMERAS = ("world", "wrist")
HULL, AS_DRAWN, UNSEEN = 48, 2, 5
OTHER, GRIPPER_BIT, FRUIT_BIT, LEAF_BIT = 0, 1, 2, 4
SMALLEST, LARGEST = 16, 1024
"""Bounds of the width and height of pictures."""

GRIP, WIDE = (1.5, 0.02, 1e-3), 60.0
"""Friction of grippers and fruit (sliding, torsional, rolling), and the wrist camera's vertical angle of view."""

METAL, WOOD = (0.6, 0.6, 0.65, 1.0), (0.36, 0.25, 0.16, 1.0)
SKIN, LEAF = (0.78, 0.12, 0.10, 1.0), (0.25, 0.50, 0.18, 1.0)


@dataclass(frozen=True, eq=False)
class Surroundings:
    """The surroundings of the arm and its gripper.

    Attributes:
        model: Path of a manufacturer's model of the arm (.xml), or None for a model made from the arm file.
        fruit: Number of fruit.
        leaves: Number of leaves around the first fruit.
        scale: Lengths of fruit, branch and gripper, as a multiple of an apple tree's.
        size: Diameter and density of fruit.
        cup: Clearance of the cup.
        suction: Properties of the cup's suction.
        detachment: Pull that detaches fruit.
        branch: Branch that the fruit hangs from.
        camera_mm: Standard deviation per axis of the errors of the cameras' positions, mm.
        camera_deg: Standard deviation per axis of the errors of the cameras' attitudes, deg.
        eye: Nominal viewpoint of the world camera.
    """

    model: str | None
    fruit: int
    leaves: int
    scale: float
    size: FruitSize
    cup: Gripper
    suction: Suction
    detachment: Detachment
    branch: Branch
    camera_mm: float
    camera_deg: float
    eye: Eye

    @property
    def radius(self) -> float:
        """Radius of a fruit, m."""
        return 0.5 * self.scale * self.size.mean

    @property
    def clearance(self) -> float:
        """Largest distance of a fruit's centre from the cup's axis at which the cup takes the fruit, m."""
        return self.scale * self.cup.tolerance

    @property
    def mass(self) -> float:
        """Mass of a fruit, kg."""
        return float(fruit_masses(self.size, 2.0 * self.radius))

    @property
    def sag(self) -> float:
        """Distance by which the weight of a fruit pulls its branch down, m."""
        return self.mass * GRAVITY / (self.branch.stiffness_upright * self.scale)


class ContactScene:
    """The MuJoCo scene of one environment: a model that is compiled once, and its present state.

    Args:
        arm: The nominal arm.
        around: The surroundings of the arm and its gripper.

    Attributes:
        model: `mujoco.MjModel`.
        data: `mujoco.MjData`.
        held: Whether each fruit is on its stem ``(f,)``.
        suction: Whether the cup's suction is on.
        strength: Pull at which each stem breaks ``(f,)``, N.
    """

    def __init__(self, arm: Arm, around: Surroundings) -> None:
        self.around, self.nominal = around, arm.nominal
        spec = self._robot(arm)
        try:
            robot = spec.compile()
        except ValueError as error:
            raise InputError(f"model {around.model} is not whole: {str(error).splitlines()[0]}") from error
        if around.model is not None:
            plain = (robot.actuator_trntype == 0) & (robot.actuator_biasprm[:, 1] == -robot.actuator_gainprm[:, 0])
            if not (plain & (robot.actuator_gainprm[:, 0] > 0.0)).all():
                name = robot.actuator(int(np.argmin(plain))).name
                raise InputError(f"drive '{name}' of the model is no position actuator of a joint; give one that is")
            for i, drive in enumerate(spec.actuators):  # makers' gains swing; a servo's own derivative term does not
                inertia = robot.dof_M0[robot.jnt_dofadr[robot.actuator_trnid[i, 0]]]
                drive.biasprm[2] = min(float(drive.biasprm[2]), -2.0 * math.sqrt(drive.gainprm[0] * inertia))
        placed = arm_in_mujoco(robot, arm.nominal)
        last = spec.body(robot.body(int(placed.bodies[-1])).name)
        self._equip(spec, last, frame_within(placed.within[-1], frame_of(arm.nominal.tool)))
        for number in range(around.fruit):
            self._hang(spec, number)
        self.model: Any = spec.compile()
        self.data: Any = mujoco.MjData(self.model)
        self._find()
        robot = (self.model.geom_contype == GRIPPER_BIT) & (np.arange(self.model.ngeom) != self._cup)
        self.model.geom_contype[robot] = self.model.geom_conaffinity[robot] = OTHER  # the arm's hulls are only drawn
        self.held, self.suction = np.ones(around.fruit, dtype=np.bool_), False
        self.strength = np.full(around.fruit, np.inf)
        self._plant: Plant | None = None
        self._pictures: dict[tuple[int, int], Any] = {}
        self._shown: Any = None
        self._sent: Array = np.zeros(self.model.nu)

    def __getstate__(self) -> dict[str, Any]:
        """Return all attributes but the renderers, for pickling and copying."""
        return self.__dict__ | {"_pictures": {}, "_shown": None}

    def _robot(self, arm: Arm) -> Any:
        """Return one MuJoCo specification (`mujoco.MjSpec`) of an arm that gravity does not pull, and the world camera.

        If the arm is made from an arm file, its drives have `STIFFNESS` and `DAMPING`, and the gears add the inertia
        `ARMATURE`: in N*m/rad, N*m*s/rad and kg*m^2 for turning joints, in N/m, N*s/m and kg for sliding joints. These
        drives settle within one or two control periods. Without the inertia, damping would dominate at the wrist and
        contacts would be unstable.

        A manufacturer's meshes are replaced in contacts and pictures by convex hulls with at most `HULL` corners. Geoms
        of the group `AS_DRAWN` only show the arm's look and take ten times as long to draw; geoms of the group `UNSEEN`
        are not drawn.
        """
        around = self.around
        if around.model is None:
            spec = mujoco.MjSpec.from_string(mjcf_text(arm.nominal, arm.name))
            for actuator in spec.actuators:
                actuator.set_to_position(kp=STIFFNESS, kv=DAMPING)
            for joint in spec.joints:
                joint.armature = ARMATURE
                if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:  # the rod that slides out
                    self._rod(joint.parent, np.zeros(3), [0.0, 0.0, -float(joint.range[1])], 0.02)
        else:
            if not is_file(Path(around.model)):
                raise InputError(f"model {around.model} does not exist; give a maker's MJCF file (.xml)")
            try:
                spec = mujoco.MjSpec.from_file(str(around.model))
            except ValueError as error:
                raise InputError(
                    f"model {around.model} is no MJCF that MuJoCo reads: {str(error).splitlines()[0]}"
                ) from error
            for joint in spec.joints:
                joint.frictionloss = 0.0  # a position drive would stop short of its target by it
        for mesh in spec.meshes:
            mesh.maxhullvert = HULL
        for body in spec.bodies[1:]:
            body.gravcomp = 1.0
        for geom in spec.geoms:  # what touches nothing gets no hull to be drawn as
            geom.contype = geom.conaffinity = OTHER if geom.group == AS_DRAWN else GRIPPER_BIT
        links = [geom for body in spec.bodies[1:] for geom in body.geoms]
        if all(geom.group in (AS_DRAWN, 4, UNSEEN) for geom in links):  # nothing else of the arm would be seen
            for geom in links:
                geom.group = AS_DRAWN + 1 if geom.group == AS_DRAWN else geom.group
        spec.option.timestep = TIMESTEP if around.model is None else TIMESTEP / 2
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.visual.quality.shadowsize = spec.visual.quality.offsamples = 0
        spec.visual.global_.offwidth = spec.visual.global_.offheight = LARGEST
        spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.35] * 3, [0.55] * 3
        sky = {"type": mujoco.mjtTexture.mjTEXTURE_SKYBOX, "builtin": mujoco.mjtBuiltin.mjBUILTIN_GRADIENT}
        spec.add_texture(name="sky", **sky, rgb1=[0.85, 0.90, 0.95], rgb2=[0.55, 0.65, 0.55], width=64, height=64)
        ahead = around.eye.axes()
        spec.worldbody.add_camera(
            name="pickenv world",
            pos=around.eye.position,
            quat=quaternion(np.stack([ahead[0], ahead[1], -ahead[2]], axis=1)),
            fovy=around.eye.angle_deg,
        )
        return spec

    def _equip(self, spec: Any, last: Any, tool: Frame) -> None:
        """Add the tool's site, the wrist camera and the gripper to the arm's last link.

        Args:
            spec: `mujoco.MjSpec` of the scene.
            last: The body that is the arm's last link.
            tool: The tool's frame in the frame of this body.
        """
        around = self.around
        rotation, place, face = np.array(tool[:9]).reshape(3, 3).T, np.array(tool[9:]), -around.radius
        stand = around.radius + 0.08 * around.scale
        if around.model is None:  # rods would end in the fruit
            self._rods_end(last, place - rotation[:, 2] * stand if place @ rotation[:, 2] > stand else np.zeros(3))
            if np.linalg.norm(place) < around.radius and (length := float(np.linalg.norm(last.pos))) > 0.0:
                self._rods_end(last.parent, last.pos * max(1.0 - stand / length, 0.0))
                for joint in last.parent.joints:
                    if joint.type == mujoco.mjtJoint.mjJNT_SLIDE:
                        self._rod(last.parent, [0.0, 0.0, -stand], [0.0, 0.0, -stand - float(joint.range[1])], 0.02)
        last.add_site(name="true tool", pos=place, quat=quaternion(rotation), size=[1e-3] * 3)
        hand = last.add_body(name="pickenv hand", pos=place, quat=quaternion(rotation), gravcomp=1.0)
        back = np.array([0.0, -0.12, -0.2]) * around.scale
        ahead = -back / np.linalg.norm(back)
        axes = np.stack([[1.0, 0.0, 0.0], np.cross(-ahead, [1.0, 0.0, 0.0]), -ahead], axis=1)
        hand.add_camera(name="pickenv wrist", pos=back, quat=quaternion(axes), fovy=WIDE)
        radius, lip, deep = 3.0 * around.clearance, around.suction.lip * around.scale, around.suction.thickness
        hand.add_geom(
            name="cup",
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            size=[radius, deep / 2, 0.0],
            margin=lip,
            gap=lip,
            pos=[0.0, 0.0, face - deep / 2],
            friction=GRIP,
            condim=4,
            contype=GRIPPER_BIT,
            conaffinity=FRUIT_BIT | LEAF_BIT,
            mass=0.01,
            rgba=[0.1, 0.1, 0.12, 1.0],
        )
        self._rod(hand, [0.0, 0.0, face - deep], [0.0, 0.0, -stand], 0.3 * radius)

    def _rods_end(self, body: Any, end: Array) -> None:
        """Replace the rods of a body by one rod from the body's origin to ``end (3,)``, m, in the body's frame."""
        for geom in body.geoms:
            geom.group = UNSEEN
        self._rod(body, np.zeros(3), end, 0.02)

    def _rod(self, body: Any, start: ArrayLike, end: ArrayLike, radius: float) -> None:
        """Add a rod without contacts and with almost no mass to a body, unless it is not longer than its radius.

        Args:
            body: The body.
            start: Start of the rod ``(3,)``, m, in the body's frame.
            end: End of the rod ``(3,)``, m, in the body's frame.
            radius: Radius of the rod, m.
        """
        if np.linalg.norm(np.subtract(end, start)) > radius:
            look = {"contype": OTHER, "conaffinity": OTHER, "mass": 1e-3, "rgba": METAL}
            ends = [*np.asarray(start).tolist(), *np.asarray(end).tolist()]
            body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=ends, size=[radius, 0.0, 0.0], **look)

    def _hang(self, spec: Any, number: int) -> None:
        """Add the branch and the fruit with the index ``number`` (from 0); fruit 0 gets the leaves too."""
        around = self.around
        scale, radius, stem = around.scale, around.radius, around.scale * around.detachment.stem
        bearer = spec.worldbody.add_body(name=f"bearer {number}", pos=[0.0, 0.0, 2.0])
        wood = around.branch.wood * scale**3
        branch = bearer.add_body(name=f"branch {number}", gravcomp=1.0)
        for way, axis in zip("xyz", np.eye(3), strict=True):
            spring = scale * (around.branch.stiffness_upright if way == "z" else around.branch.stiffness_sideways)
            branch.add_joint(
                name=f"branch {number} {way}",
                type=mujoco.mjtJoint.mjJNT_SLIDE,
                axis=axis,
                stiffness=spring,
                damping=2.0 * around.branch.damping_ratio * math.sqrt(spring * (wood + around.mass)),
            )
        rod = {"type": mujoco.mjtGeom.mjGEOM_CAPSULE, "contype": OTHER, "conaffinity": OTHER, "rgba": WOOD}
        branch.add_geom(fromto=[-0.2 * scale, 0, 0, 0.2 * scale, 0, 0], size=[0.006 * scale, 0, 0], mass=wood, **rod)
        name = f"fruit {number}"
        fruit = spec.worldbody.add_body(name=name, pos=[0.0, 0.0, 2.0 - stem - radius])
        fruit.add_joint(name=name, type=mujoco.mjtJoint.mjJNT_FREE, damping=around.suction.turning * scale**4)
        fruit.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=[radius, 0, 0],
            mass=around.mass,
            rgba=SKIN,
            contype=FRUIT_BIT,
            conaffinity=GRIPPER_BIT | FRUIT_BIT,
            condim=4,
            friction=GRIP,
        )
        fruit.add_geom(fromto=[0, 0, radius, 0, 0, radius + stem], size=[0.0015 * scale, 0, 0], mass=1e-6, **rod)
        kinds, body = mujoco.mjtEq, mujoco.mjtObj.mjOBJ_BODY
        tie = spec.add_equality(
            name=f"stem {number}", type=kinds.mjEQ_CONNECT, objtype=body, name1=name, name2=f"branch {number}"
        )
        tie.data[:3], tie.solref[0] = [0.0, 0.0, radius + stem], 2.0 * TIMESTEP  # as stiff as steps allow
        hold = spec.add_equality(
            name=f"hold {number}", type=kinds.mjEQ_WELD, objtype=body, name1="pickenv hand", name2=name, active=False
        )
        hold.data[:3], hold.data[10] = 0.0, 1.0
        for leaf in range(around.leaves if number == 0 else 0):
            blade = bearer.add_body(name=f"leaf {leaf}", gravcomp=0.0)
            blade.add_joint(type=mujoco.mjtJoint.mjJNT_BALL, stiffness=1e-3 * scale**4, damping=1e-4 * scale**4)
            blade.add_geom(
                type=mujoco.mjtGeom.mjGEOM_BOX,
                size=[0.022 * scale, 0.0005, 0.035 * scale],
                mass=1e-3 * scale**3,
                pos=[0.0, 0.0, -0.035 * scale],
                rgba=LEAF,
                contype=LEAF_BIT,
                conaffinity=GRIPPER_BIT,
            )

    def _find(self) -> None:
        """Store the indices of all parts of the model that are read or written in every step."""
        model, around = self.model, self.around
        self.arm: ModelArm = arm_in_mujoco(model, self.nominal)
        joints = self.arm.joints.tolist()
        drive_of = {int(model.actuator_trnid[i, 0]): i for i in range(model.nu)}
        names = zip(self.nominal.joint_names, joints, strict=True)
        if lost := [name for name, joint in names if joint not in drive_of]:
            raise InputError(f"the model has no drive for joint '{lost[0]}'; add a position actuator")
        self._drives = np.array([drive_of[joint] for joint in joints])
        self._hand, self._cup = model.body("pickenv hand").id, model.geom("cup").id
        self._site = model.site("true tool").id

        def numbers_of(part: Callable[[str], Any], name: str) -> NDArray[np.int64]:
            return np.array([part(f"{name} {i}").id for i in range(around.fruit)])

        self._fruit, self._bearers = (numbers_of(model.body, name) for name in ("fruit", "bearer"))
        self._holds, self._stems = (numbers_of(model.equality, name) for name in ("hold", "stem"))
        self._spheres = numbers_of(model.geom, "fruit")
        self._loose = np.array([model.joint(f"fruit {i}").qposadr[0] for i in range(around.fruit)])
        self._sunk = np.array([model.joint(f"branch {i} z").qposadr[0] for i in range(around.fruit)])
        self._blades = np.array([model.body(f"leaf {i}").id for i in range(around.leaves)], dtype=np.int64)
        self._cameras = {name: model.camera(f"pickenv {name}").id for name in CAMERAS}
        turned = {name: np.zeros(9) for name in CAMERAS}
        for name, i in self._cameras.items():
            mujoco.mju_quat2Mat(turned[name], model.cam_quat[i])
        self._said = {name: (model.cam_pos[i].copy(), turned[name].reshape(3, 3)) for name, i in self._cameras.items()}

    def begin(self, plant: Plant, joints: Sequence[float], tool: Frame, fruit: Array, rng: np.random.Generator) -> None:
        """Begin an episode with the arm at rest and all fruit on its stems.

        Args:
            plant: The true arm.
            joints: Positions of the true arm's joints ``(n,)``, rad or m.
            tool: The tool's true frame.
            fruit: Where fruit hangs at rest ``(f, 3)``, m, base frame.
            rng: Random generator for strengths of stems, places of leaves and errors of cameras.
        """
        model, data, around = self.model, self.data, self.around
        mujoco.mj_resetData(model, data)
        if plant.geometry is not (plant.arm.nominal if self._plant is None else self._plant.geometry):
            self.arm.take(plant.geometry)
        self._plant = plant
        hangs = around.radius + around.scale * around.detachment.stem + around.sag
        model.body_pos[self._bearers] = fruit + np.array([0.0, 0.0, hangs])
        self.strength = np.asarray(sample_strength(around.detachment, around.fruit, rng)[0]) * around.scale**2
        model.body_pos[self._blades] = rng.uniform(-0.07, 0.07, (around.leaves, 3)) * around.scale
        for name, number in self._cameras.items():
            shift, turn = rng.normal(size=(2, 3))
            position, rotation = self._said[name]
            turned = rotation_matrix(np.radians(around.camera_deg) * turn) @ rotation
            model.cam_pos[number] = position + around.camera_mm * 1e-3 * shift
            model.cam_quat[number] = quaternion(turned)
        data.qpos[self.arm.places] = joints
        for place, spot in zip(self._loose, fruit, strict=True):
            data.qpos[place : place + 3] = spot
        data.qpos[self._sunk] = -around.sag
        data.eq_active[self._stems], data.eq_active[self._holds] = 1, 0
        self.held[:] = True
        data.ctrl[self._drives] = joints
        self.suction = False
        self._sent = data.ctrl.copy()
        self._place(joints, tool)
        mujoco.mj_forward(model, data)

    def carry(self, joints: Sequence[float], tool: Frame, grip: float, period: float) -> None:
        """Simulate one period, in which the drives move on to new joint positions.

        A physics step takes `TIMESTEP`, or half of it with a manufacturer's model. After every `CHUNK` physics steps,
        stems and the cup's hold are checked for breaking.

        Args:
            joints: Positions of the true arm's joints at the end of the period ``(n,)``, rad or m.
            tool: The tool's true frame at the end of the period.
            grip: The gripper's command, -1 to 1; suction is on above 0.
            period: Length of the period, s.
        """
        data, count = self.data, max(round(period / self.model.opt.timestep), 1)
        self._place(joints, tool)
        self.suction = grip > 0.0
        data.ctrl[self._drives] = joints
        start, end, passed = self._sent, data.ctrl.copy(), 0
        while passed < count:
            steps = min(CHUNK, count - passed)
            passed += steps
            data.ctrl[:] = end if passed == count else start + (end - start) * (passed / count)
            mujoco.mj_step(self.model, data, steps)
            self._hold()
            self._break()
        self._sent = end
        mujoco.mj_kinematics(self.model, data)

    def _place(self, joints: Sequence[float], tool: Frame) -> None:
        if self._plant is not None and self._plant.effects:
            self.arm.put_tool(self._plant.chain, list(joints), tool)

    def _hold(self) -> None:
        """Let the cup take the fruit that lies in it if suction is on, and release what it holds if suction is off."""
        data, model, touched = self.data, self.model, self.touched
        for i, hold in enumerate(self._holds) if self.suction or self.taken.any() else ():
            if data.eq_active[hold]:
                data.eq_active[hold] = self.suction
            elif self.suction and touched[i]:
                place = (data.xpos[self._fruit[i]] - data.xpos[self._hand]) @ data.xmat[self._hand].reshape(3, 3)
                if np.hypot(*place[:2]) <= self.around.clearance:
                    model.eq_data[hold, 3:6] = place
                    back, turn = np.zeros((2, 4))  # of one sign with MuJoCo's own, or the weld would push
                    mujoco.mju_negQuat(back, data.xquat[self._hand])
                    mujoco.mju_mulQuat(turn, back, data.xquat[self._fruit[i]])
                    model.eq_data[hold, 6:10] = turn
                    data.eq_active[hold] = 1

    def _break(self) -> None:
        """Break stems that are pulled beyond their strength, and release fruit that pulls too hard on the cup."""
        data, strength = self.data, self.around.suction.holds * self.around.detachment.pull_95 * self.around.scale**2
        rows, forces = data.efc_id[: data.ne], data.efc_force[: data.ne]
        for tie, limit in [*zip(self._stems, self.strength, strict=True), *((hold, strength) for hold in self._holds)]:
            if data.eq_active[tie] and np.linalg.norm(forces[rows == tie][:3]) > limit:
                data.eq_active[tie] = 0
        self.held[:] = data.eq_active[self._stems]

    @property
    def joints(self) -> list[float]:
        """Positions of the arm's joints ``(n,)``, rad or m."""
        return list(self.data.qpos[self.arm.places].tolist())

    @property
    def tool(self) -> Frame:
        """The tool's true frame."""
        spot = self._site
        return frame_of(Pose(self.data.site_xpos[spot], self.data.site_xmat[spot].reshape(3, 3)))

    @property
    def wrist_eye(self) -> tuple[Array, Array, float]:
        """The nominal wrist camera in the tool's frame: position, attitude, and angle of view.

        The position is ``(3,)``, m. The attitude is a rotation ``(3, 3)`` with the camera's axes as columns. The angle
        is given by the tangent of its half.
        """
        return (*self._said["wrist"], math.tan(math.radians(WIDE) / 2))

    @property
    def fruit(self) -> Array:
        """Centres of the fruit ``(f, 3)``, m."""
        return np.asarray(self.data.xpos[self._fruit])

    @property
    def touched(self) -> NDArray[np.bool_]:
        """Whether the cup touches each fruit ``(f,)``."""
        if not self.data.ncon:
            return np.zeros(self.around.fruit, dtype=np.bool_)
        pairs = self.data.contact.geom[: self.data.ncon]
        return np.isin(self._spheres, pairs[(pairs == self._cup).any(axis=1)])

    @property
    def taken(self) -> NDArray[np.bool_]:
        """Whether the cup holds each fruit ``(f,)``."""
        return np.asarray(self.data.eq_active[self._holds] != 0)

    def picture(self, camera: str, size: tuple[int, int], dark: bool = False) -> Pixels:
        """Render the picture of a camera ``(height, width, 3)``.

        Args:
            camera: One of `CAMERAS`.
            size: Width and height, px.
            dark: Whether the background is black instead of a sky.

        Raises:
            InputError: If this machine cannot render without a screen.
        """
        from pickenv.pictures.mujoco_drawer import ModelPictures  # late: what draws is loaded when it draws

        if size not in self._pictures:  # films are larger than what is observed, and a context takes long to make
            try:
                self._pictures[size] = ModelPictures(self.model, size)
            except Exception as error:  # each way of drawing has its own errors
                advice = "install EGL (libegl1, libopengl0, libgl1-mesa-dri), or give obs_type='state'"
                raise InputError(f"MuJoCo cannot draw here; {advice}") from error
            self._shown = mujoco.MjvOption()
            self._shown.geomgroup[AS_DRAWN], self._shown.geomgroup[AS_DRAWN + 1] = 0, 1
            self._shown.sitegroup[:] = 0
            self._shown.flags[mujoco.mjtVisFlag.mjVIS_CONVEXHULL] = 1
        mujoco.mj_camlight(self.model, self.data)
        pictures: ModelPictures = self._pictures[size]
        return pictures.draw(self.data, self._cameras[camera], self._shown, dark)

    def close(self) -> None:
        """Free the renderers."""
        while self._pictures:
            self._pictures.popitem()[1].close()
