"""`pickenv/PickScene-v0`: pick a hanging fruit with contact and pictures, with an arm that is not exact."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from pickenv.arm import Array, Frame, Plant, Pose, Scalar, Scalars, erring_by, forward, inverse, joint_jacobian
from pickenv.arm.kinematics.inverse import halton_joints
from pickenv.base import InputError, shown
from pickenv.envs.picking.pick_arm import act_arm
from pickenv.envs.reaching.reach import VIEW, ReachEnv
from pickenv.envs.scene.contact_scene import CAMERAS, LARGEST, SMALLEST, ContactScene, Surroundings
from pickenv.envs.shared import simulation
from pickenv.envs.shared.arm_env import RENDER_MODES, Information, begun
from pickenv.envs.shared.backends import FLOATS, Executor
from pickenv.envs.shared.simulation import ArmState, View
from pickenv.envs.shared.situation import make_situation
from pickenv.envs.shared.spaces import GOALS, action_space, flat_space
from pickenv.envs.shared.task import (
    Task,
    check_choice,
    check_count,
    check_name,
    check_number,
    checked_action,
    make_task,
    refuse_idle,
)
from pickenv.orchard import load_branch, load_detachment, load_fruit_size, load_gripper, load_suction
from pickenv.orchard.gripper import misalignment
from pickenv.pictures.stage import SIZE, Pixels, fitted_eye

OBSERVATIONS = ("state", "pixels", "pixels_agent_pos", "pixels_environment_state_agent_pos")
USUAL_PLANT = "ideal:ur5e"
PERIOD, STEP_COST, BONUS = 0.04, 0.002, 0.25  # the class explains these and the next two
HELD_STEPS, REACH_OF_APPLES = 5, 0.85
SPREAD, ATTEMPTS = 64, 2000
TRIES = 1, 3, 12, 34


class PickSceneEnv(ReachEnv):
    """Pick a fruit that hangs from a branch, with contact and pictures, with an arm that differs from its model.

    ## Description

    `pickenv/Reach-v0` in MuJoCo, with contact and pictures. An arm with a suction cup stands at a branch; the
    fruit's stem breaks when it is pulled hard enough. The policy commands the *nominal* arm, that is the model that its
    controller believes in. But the *true* arm moves, touches the fruit and carries the wrist camera. Its parts, joint
    zeros, compliance, backlash and warm-up are as in the plant (the model of the true arm). Delays and noise are
    as in `pickenv/Reach-v0`. With an ideal plant the states equal the plain MuJoCo model's states, to the bit.
    Contacts, their forces and the success of picks are simulated, and hold for this cup and this branch only.

    The arm is drawn as rods from the arm file, or comes from a manufacturer's MJCF file (`model`). Of the arm, only the
    cup has contacts. The arm has no weight in MuJoCo, since the plant computes how it sags.

    ## Action Space

    `Box(-1, 1, (n + 1,), float32)`: increments of the n joints as in `pickenv/Reach-v0`, per period of 0.04 s, and
    last the suction, which is on above 0. A cup takes the fruit that it touches if the fruit's centre is within 5 mm of
    its axis (`li_cup`, at full scale). It holds against 1.5 times the pull that detaches 95 % of fruit.

    ## Observation Space

    By `obs_type`:

    - "state" (default): `Box(float32)`, the n + 12 numbers of `pickenv/Reach-v0` (n + 15 with `feedback="camera"`), the
      suction, and whether the cup holds the fruit. The fruit's position is the one seen before the episode.
    - "pixels": `Dict` with `pixels`, itself a `Dict` of `(pixels, pixels, 3)` uint8 pictures by camera.
    - "pixels_agent_pos": `pixels`, and `agent_pos`, as LeRobot names it: the joint readings (rad, m) and the gripper.
      The gripper is 0 when suction is off, 0.5 when it is on, and 1 when it holds the fruit.
    - "pixels_environment_state_agent_pos": `pixels`, `agent_pos`, and the numbers of "state" as `environment_state`.

    The camera "world" does not move in an episode and shows all places of fruit. The camera "wrist" is fixed to the
    tool and looks at the tool's tip, at full scale from 0.2 m back along the tool's axis. Pictures need EGL or OSMesa
    if there is no screen.

    ## Rewards

    1 when the fruit has been held off its stem for 5 steps (0.2 s), 0.25 when it comes off, and -0.002 per step. The
    reward does not measure where the true tool is.

    ## Starting State

    As in `pickenv/Reach-v0`: joints are at mid-range or drawn, and the fruit is where the nominal arm's tool can be.
    `reset` takes the same options. With `within_mm` the fruit hangs near a place where the arm moves well in every
    direction. The tool then starts where the wrist camera sees the fruit. At full scale it is 6 to 30 cm short of the
    fruit along its axis, and up to 12.5 cm beside the fruit along each other axis. If you give another goal, give
    `start_joints` too. Arms of fewer than six joints start there in any attitude that they reach. The strength of the
    stem is drawn as in `pickenv/Pick-v0` (Bu et al. 2020). The branch is described in
    `pickenv/orchard/presets/branch.toml`.

    ## Episode End

    - Termination: the fruit is picked, which is success.
    - Truncation: after 300 steps (`max_episode_steps`).

    ## Information

    As in `pickenv/Reach-v0`, with distances to the fruit's present position. Further entries:

    | Key                | Meaning                                                                      | Unit |
    |--------------------|------------------------------------------------------------------------------|------|
    | `is_success`       | whether the fruit has been picked                                            | bool |
    | `attached`         | whether the cup holds the fruit                                              | bool |
    | `detached`         | whether the fruit is off its stem                                            | bool |
    | `grasp_lateral_mm` | fruit from true tool at the first touch with suction on, across the axis     | mm   |
    | `grasp_axial_mm`   | the same along the axis, positive beyond the tool (both 0 before)            | mm   |

    ## Arguments

    ```python
    >>> import gymnasium as gym
    >>> import pickenv
    >>> env = gym.make("pickenv/PickScene-v0", plant="coarse:ur5e", error_mm=3.0)
    >>> observation, info = env.reset(seed=1)
    >>> observation.shape, info["attached"]
    ((20,), False)

    ```

    The arguments of `pickenv/Reach-v0`. But `executor` is always "floats", and success is a picked fruit. So there is
    no `reward`, `tolerance_mm`, `angle_tolerance_deg` or `end_on_success`. Further arguments:

    - `plant` (default "ideal:ur5e"), `control_period_s` (default 0.04).
    - `error_mm` (default None): mean error of the tool over the joints' ranges. The errors of the true arm's parts are
      scaled by one factor to reach it, and the plant's effects are off. None leaves the plant as it is.
    - `obs_type`, `pixels` (width and height of pictures, px, 16 to 1024, default 64) and `cameras` (default both): what
      is observed.
    - `within_mm` (default None): largest distance of the fruit per axis from the place where the arm moves well (see
      "Starting State"); None for the arm's whole reach.
    - `camera_mm`, `camera_deg` (default 0): standard deviations per axis of the errors of the cameras' positions and
      attitudes, drawn in every episode.
    - `model` (path, default None): a manufacturer's MJCF file of the plant's arm, with the same joint names.
    - `fruit` (default 1): number of fruit; the first one is the goal. `leaves` (default 0): number of leaves around it,
      which hide the fruit and have contacts.
    - `scale` (default None): lengths of fruit, branch and cup as a multiple of an apple tree's. Forces scale with its
      square, masses with its cube. None means 1, or less for arms that reach less than 0.85 m.
    - `fruit_size` (default "li2016"): as in `pickenv/Pick-v0`.
    - `render_mode` (None, "human" or "rgb_array"): how pictures of the world camera are rendered.

    `gym.make_vec("pickenv/PickScene-v0", num_envs=4)` makes a `SyncVectorEnv`.

    ## Version History

    * v0: First version.
    """

    # Starts with `within_mm`, at full scale. `before` is the range of the tool's distance to the fruit along its axis,
    # m. The largest distance across the axis is `beside[0]`, m, plus `beside[1]` times the distance along it. `turned`
    # is the standard deviation per axis of the attitude, rad.
    before, beside, turned = (0.06, 0.3), (0.02, 0.35), 0.1

    def __init__(
        self,
        *,
        plant: str | None = None,
        obs_type: str = "state",
        pixels: int = 64,
        cameras: Sequence[str] = CAMERAS,
        model: str | None = None,
        fruit: int = 1,
        leaves: int = 0,
        scale: float | None = None,
        fruit_size: str = "li2016",
        error_mm: float | None = None,
        camera_mm: float = 0.0,
        camera_deg: float = 0.0,
        within_mm: float | None = None,
        control_period_s: float = PERIOD,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        """See the class for the arguments; raises `InputError` for values that are not allowed."""
        for name in ("reward", "tolerance_mm", "angle_tolerance_deg", "end_on_success"):
            if name in arguments:
                raise InputError(f"{name} has no effect where success is a picked fruit; leave it out")
        check_choice("executor", arguments.pop("executor", "floats"), ("floats",))
        check_choice("obs_type", obs_type, OBSERVATIONS)
        for name, count, least in (("fruit", fruit, 1), ("leaves", leaves, 0), ("pixels", pixels, SMALLEST)):
            check_count(name, count, least)
        error, within = (0.0 if size is None else size for size in (error_mm, within_mm))
        sizes = {"camera_mm": camera_mm, "camera_deg": camera_deg, "error_mm": error, "within_mm": within}
        for name, size in sizes.items():
            check_number(name, size)
        if pixels > LARGEST:
            raise InputError(f"pixels is {pixels}; give at most {LARGEST}")
        if not isinstance(cameras, list | tuple) or not cameras or any(name not in CAMERAS for name in cameras):
            raise InputError(f"cameras is {shown(cameras)}; give a list of {', '.join(CAMERAS)}")
        check_name("model", "" if model is None else model, "a maker's MJCF file (.xml)")
        if render_mode is not None:
            check_choice("render_mode", render_mode, RENDER_MODES)
        if plant is not None or arguments.get("difficulty") is None:
            arguments["plant"] = USUAL_PLANT if plant is None else plant
        self._error, self.pixels = error_mm, int(pixels)
        super().__init__(executor="floats", control_period_s=control_period_s, **arguments)
        if error_mm is not None:
            idle = {"without": tuple(arguments.get("without", ()))}
            refuse_idle(make_task, idle, "with error_mm, which switches all effects off; leave it out")
        if within_mm is not None:
            idle = {"start_spread": arguments.get("start_spread", 0.0)}
            refuse_idle(make_situation, idle, "with within_mm, where episodes start before the fruit; leave it out")
        self.render_mode = render_mode
        self.plant = self._scaled(self.plant)
        self.task = task = replace(self.task, gripper=1)
        if scale is None:
            scale = min(1.0, (task.reach - 1.0) / REACH_OF_APPLES)
        check_number("scale", scale, positive=True)
        around = Surroundings(
            model=model,
            fruit=int(fruit),
            leaves=int(leaves),
            scale=float(scale),
            size=load_fruit_size(fruit_size),
            cup=load_gripper("li_cup"),
            suction=load_suction("bellows"),
            detachment=load_detachment("apple"),
            branch=load_branch("apple"),
            camera_mm=float(camera_mm),
            camera_deg=float(camera_deg),
            eye=fitted_eye(self._places(), VIEW, (self.pixels, self.pixels)),
        )
        self._within = None if within_mm is None else 1e-3 * float(within_mm)
        self._pair: tuple[int, tuple[Array, Array]] | None = None
        self.scene = ContactScene(task.plant.arm, around)
        self.obs_type, self.cameras = obs_type, tuple(cameras)
        self.task_description = "pick the fruit that hangs from the branch"
        self.action_space = action_space(task)
        self.observation_space = self._space()
        self._grip = -1.0
        self._holding, self._closed = 0, (0.0, 0.0)

    def _places(self) -> Array:
        """Return k possible positions of fruit, then the position of the arm's base, ``(k + 1, 3)``, m, base frame.

        The positions of fruit are the tool's positions at the first `SPREAD` poses among `ATTEMPTS` that fit the task.
        The pose at which the arm moves best in every direction is stored in `_favoured`.
        """
        tries = (simulation.goal_attempt(FLOATS, self.task, 0, attempt) for attempt in range(ATTEMPTS))
        joints: Array = np.array(list(islice((pose for pose, fits in tries if fits), SPREAD)))
        geometry = self.task.plant.arm.nominal
        self._favoured = joints[np.argmax(np.linalg.svd(joint_jacobian(geometry, joints), compute_uv=False)[:, -1])]
        return np.concatenate([forward(geometry, joints).position, [geometry.base.position]])

    def _placed(self, within: float) -> tuple[Array, Array]:
        """Return joints with the tool at this episode's fruit, and joints at the start, ``(n,)`` each, rad or m.

        They are drawn once per episode. ``within`` is the largest distance of the fruit per axis from the place where
        the arm moves well, m.
        """
        if self._pair is None or self._pair[0] != int(self._key):
            self._pair = int(self._key), self._before_fruit(within)
        return self._pair[1]

    def _before_fruit(self, within: float) -> tuple[Array, Array]:
        """Draw the joints that `_placed` returns; `_placed` explains them.

        A pair is a fruit and a start. `TRIES` says how many pairs are drawn at once, in one try after another. Drawing
        ends when the arm reaches the fruit and the start of a pair.
        """
        rng, geometry = np.random.default_rng([int(self._key), 1]), self.task.plant.arm.nominal
        place, attitude = forward(geometry, self._favoured)
        how: dict[str, Any] = {"restarts": 0, "position_only": geometry.joints < 6}
        for count in TRIES:
            fruit, starts = [], []
            for _ in range(count):
                fruit.append(place + rng.uniform(-within, within, 3))
                ahead = rng.uniform(*self.before)
                off = np.append((self.beside[0] + self.beside[1] * ahead) * rng.uniform(-1.0, 1.0, 2), -ahead)
                turn = Rotation.from_rotvec(self.turned * rng.normal(size=3)).as_matrix()
                starts.append(Pose(fruit[-1] + attitude @ off * self.scene.around.scale, attitude @ turn))
            goal = inverse(geometry, Pose(np.array(fruit), attitude), self._favoured, **how)
            if not goal.reached.any():
                continue
            begin = inverse(geometry, Pose(*map(np.array, zip(*starts, strict=True))), goal.joints, **how)
            if (reached := np.flatnonzero(goal.reached & begin.reached)).size:
                return goal.joints[reached[0]], begin.joints[reached[0]]
        raise InputError(f"within_mm is {1e3 * within:g}; the arm reaches too little of that, give less")

    def _start(self, joints: Any) -> Scalars:
        if joints is None and self._within is not None:
            joints = self._placed(self._within)[1]
        return super()._start(joints)

    def _wanted(self, options: dict[str, Any]) -> Frame:
        if self._within is not None and not any(options.get(name) is not None for name in GOALS):
            options = {"goal_joints": self._placed(self._within)[0]}
        return super()._wanted(options)

    def _use_arm(self, number: int) -> None:
        super()._use_arm(number)
        self.plant = self._scaled(self.plant)

    def _scaled(self, plant: Plant) -> Plant:
        """Return the true arm ``plant`` with its geometric errors scaled to `error_mm`, and without effects.

        The error is the mean over `SPREAD` poses. If `error_mm` is None, ``plant`` is returned unchanged.
        """
        if self._error is None:
            return plant
        return erring_by(plant, 1e-3 * self._error, halton_joints(plant.arm.nominal, SPREAD))

    def _space(self) -> spaces.Space[Any]:
        flat, zeros, ones = flat_space(self.task), np.zeros(2, np.float32), np.ones(2, np.float32)
        state = spaces.Box(np.append(flat.low, zeros), np.append(flat.high, ones), dtype=np.float32)
        if self.obs_type == OBSERVATIONS[0]:
            return state
        picture = spaces.Box(0, 255, (self.pixels, self.pixels, 3), dtype=np.uint8)
        parts: dict[str, spaces.Space[Any]] = {"pixels": spaces.Dict(dict.fromkeys(self.cameras, picture))}
        if self.obs_type == OBSERVATIONS[3]:
            parts["environment_state"] = state
        if self.obs_type in OBSERVATIONS[2:]:
            low, high = np.append(self.task.lower, 0.0), np.append(self.task.upper, 1.0)
            margin = 1e-6 * (high - low)  # of rounding to single precision
            parts["agent_pos"] = spaces.Box((low - margin).astype(np.float32), (high + margin).astype(np.float32))
        return spaces.Dict(parts)

    def step(self, action: ArrayLike) -> tuple[Any, float, bool, bool, Information]:
        """Move the joint target by the action and set the suction, for one period.

        Raises:
            InputError: If the action has another shape or invalid numbers, or if `reset` was not called before.
        """
        values = checked_action(action, (self.task.actions,), self.task.most_action)
        state, self._grip, _, period = act_arm(self._x, self.task, begun(self._state, "step"), values.tolist())
        self._step += 1
        was_held = bool(self.scene.held[0])
        observation, _, information = self._look(state, period)
        success = information["is_success"]
        reward = float(success) + BONUS * float(information["detached"] and was_held) - STEP_COST
        return observation, reward, success, False, information

    def look(
        self,
        x: Executor,
        task: Task,
        plant: Plant,
        state: ArmState,
        command: Scalars,
        key: Scalar,
        moment: Scalar,
        dt: Scalar,
    ) -> tuple[ArmState, View]:
        """Hold the joint command for ``dt`` seconds in MuJoCo; `simulation.look` explains arguments and result."""
        memory = plant.carried(x.m, state.plant, command, dt)
        joints, tool = plant.stands(x.m, memory, command)
        scene = self.scene
        if dt == 0.0:
            self._begin(plant, joints, tool, state.goal)
        else:
            scene.carry(joints, tool, self._grip, dt)
        read = simulation.nominal_readings(x, plant, memory, state.target, command)
        read = [value + (at - sent) for value, at, sent in zip(read, scene.joints, joints, strict=True)]
        goal = (*state.goal[:9], *scene.fruit[0].tolist())
        state = state._replace(plant=memory, goal=goal)
        return simulation.viewed(x, task, state, read, scene.tool, command, key, moment, dt)

    def _begin(self, plant: Plant, joints: Sequence[float], tool: Frame, goal: Frame) -> None:
        rng, around = np.random.default_rng(int(self._key)), self.scene.around
        (phase, *_), _, heights = rng.uniform(size=(3, around.fruit))
        angles = 2.0 * np.pi * (phase + np.arange(around.fruit) / max(around.fruit - 1, 1))
        ring = 2.2 * around.radius * max(1.0, 0.5 / np.sin(np.pi / max(around.fruit - 1, 2)))  # so that none overlap
        apart = np.stack([ring * np.cos(angles), ring * np.sin(angles), around.radius * (heights - 0.5)], axis=1)
        apart[0] = 0.0
        self._grip, self._holding, self._closed = -1.0, 0, (0.0, 0.0)
        self.scene.begin(plant, joints, tool, np.array(goal[9:]) + apart, rng)

    def _look(self, state: ArmState, dt: Scalar) -> tuple[Any, float, Information]:
        observation, reward, information = super()._look(state, dt)
        scene = self.scene
        tool = np.array(scene.tool)
        lateral, axial, _ = misalignment(scene.fruit[0] - tool[9:], tool[6:9])
        if self._grip > 0.0 and scene.touched[0] and self._closed == (0.0, 0.0):
            self._closed = 1e3 * float(lateral), 1e3 * float(axial)
        taken, detached = bool(scene.taken[0]), not scene.held[0]
        self._holding = self._holding + 1 if taken and detached else 0
        information |= {"is_success": self._holding >= HELD_STEPS, "attached": taken, "detached": detached}
        information |= zip(("grasp_lateral_mm", "grasp_axial_mm"), self._closed, strict=True)
        return observation, reward, information

    def _observe(self, scene: simulation.View) -> tuple[Any, float]:
        flat, reward = super()._observe(scene)
        grip = np.array([self.scene.suction, self.scene.taken[0]], dtype=np.float32)
        if self.obs_type == OBSERVATIONS[0]:
            return np.append(flat, grip), reward
        size = self.pixels, self.pixels
        views: dict[str, Any] = {"pixels": {name: self.scene.picture(name, size) for name in self.cameras}}
        if self.obs_type == OBSERVATIONS[3]:
            views["environment_state"] = np.append(flat, grip)
        if self.obs_type in OBSERVATIONS[2:]:
            low, high = np.array(self.task.lower), np.array(self.task.upper)
            joints = low + (np.array(scene.readings) + 1.0) * 0.5 * (high - low)
            views["agent_pos"] = np.append(joints, grip.mean()).astype(np.float32)
        return views, reward

    def _picture(self) -> Pixels:
        begun(self._state, "render")
        return self.scene.picture("world", SIZE, self.dark)

    def close(self) -> None:
        """Close the window and the renderers."""
        self.scene.close()
        super().close()
