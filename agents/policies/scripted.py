"""Scripted policies: what a controller with a perfect nominal model would do, and one that knows nothing."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.agents.policies import policy
from pickenv.arm import Array, Plant, Pose, forward, inverse, joint_jacobian, plants_on, pose_error, truncated_inverse
from pickenv.base import InputError, register
from pickenv.envs import CONTROL_PERIOD
from pickenv.harvester import Work, assign, zone_work
from pickenv.orchard import fruit_regions, load_stereo_camera


class ScriptedReach(policy.ReachController):
    """Solve the nominal inverse kinematics for the fruit once per episode, then drive straight to those joints.

    It uses the observation alone: joint readings, and the offset and attitude between believed tool and fruit.
    """

    def __init__(self, env: Any) -> None:
        """Read the arm's nominal geometry and increments from ``env``, a `pickenv/Reach-v0`, wrapped or not."""
        super().__init__(env)
        self._wanted: Array | None = None

    def reset(self) -> None:
        """Forget the last episode's fruit."""
        self._wanted = None
        self.forget()

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action.

        Raises:
            InputError: If the fruit cannot be reached by the nominal arm.
        """
        reading = self.present(observation)
        if self._wanted is None:
            self._wanted = self.wanted_joints(reading)
        return self.action(self._wanted - reading.joints)

    def wanted_pose(self, reading: policy.ObservationParts) -> Pose:
        """The pose that the tool shall have: the fruit with its attitude."""
        return Pose(reading.seen, policy.attitude_after(forward(self.geometry, reading.joints), reading.turn))

    def wanted_joints(self, reading: policy.ObservationParts) -> Array:
        """Joints that bring the nominal arm's tool to the fruit."""
        target = self.wanted_pose(reading)
        solution = inverse(self.geometry, target, attitude_tolerance=1e-4)
        # A camera's error may put the fruit out of reach by as much; the closest joints are the answer then.
        lost = ~solution.reached & (solution.position_error > 0.1)
        if np.any(lost):
            first = (np.argmax(lost),) if lost.ndim else ()
            raise InputError(
                f"the fruit at {np.round(target.position[first] * 1e3)} mm cannot be reached: "
                f"{solution.position_error[first] * 1e3:.1f} mm and "
                f"{np.degrees(solution.attitude_error[first]):.2f} deg remain; choose a goal inside the joint limits"
            )
        return solution.joints


class RandomReach:
    """Uniformly random actions: the result of knowing nothing."""

    def __init__(self, env: Any, rng: np.random.Generator) -> None:
        """``env``, single or vector, gives the actions' bounds, ``rng`` every draw."""
        self.space = getattr(env, "single_action_space", env.action_space)
        self.rng = rng

    def reset(self) -> None:
        """Nothing to forget."""

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action."""
        low, high = np.float64(self.space.low), np.float64(self.space.high)
        return np.asarray(self.rng.uniform(low, high, (*np.shape(observation)[:-1], *low.shape)), dtype=np.float32)


class ScriptedScene(ScriptedReach):
    """Take the fruit of `pickenv/PickScene-v0`: come from behind it, stand, go to it, grip, and draw it away.

    It uses the state observation and the nominal arm. With `feedback="camera"` it looks while it stands, and corrects
    by what the camera's gap to the fruit differs from the believed one.
    """

    FAR, BEFORE, PRESS, AWAY = -0.2, -0.08, 0.003, -0.4
    """Where the tool comes to along its axis, where it stands and looks, how far it presses, and how far it draws
    back, m at full scale."""
    STAND, GRIP = 40, 10
    """Steps for which it stands and looks, and for which it grips."""
    _PATIENCE = (0, STAND, 0, GRIP, np.inf)
    SLOW, NEAR = 0.003, 2e-3
    """Distance that it goes in a step near fruit, m at full scale, and when joints have arrived, rad or m."""

    def __init__(self, env: Any) -> None:
        """Read the arm and the scene's scale from ``env``."""
        super().__init__(env)
        self.lag = max(self.lag, 1)  # drives with inertia follow late: it goes by what it has sent
        self._scale = env.unwrapped.scene.around.scale
        self.reset()

    def reset(self) -> None:
        """Forget the last episode's fruit."""
        super().reset()
        self._stage, self._waited, self._at = 0, 0, self.FAR
        self._gaps: list[Array] = []

    def act(self, observation: Any) -> NDArray[np.float32]:
        """The next action: increments of the joints, and the gripper, which is open below 0."""
        reading = self.present(np.asarray(_state_of(observation))[:-2])
        if self._wanted is None:
            self._wanted = self.wanted_joints(reading)
        end = (self.FAR, self.BEFORE, self.PRESS, self.PRESS, self.AWAY)[self._stage]
        step = self.SLOW if self._stage in (2, 3) else 3.0 * self.SLOW
        self._at += float(np.clip(end - self._at, -step, step))
        if self._stage < len(self._PATIENCE) - 1:
            goal = self._along(self._wanted, self._at * self._scale)
        else:
            goal = self._drawn(reading.joints, min(self._at, 0.0) * self._scale)
        if self._stage == 1 and self._waited > SETTLED and (gap := self._gap(observation, reading)) is not None:
            self._gaps.append(gap)
        if self._stage >= 2 and self._gaps:
            goal = self._moved(goal, np.mean(self._gaps, axis=0))
        away = goal - reading.joints
        patience = self._PATIENCE[self._stage]
        arrived = self._at == end and (float(np.abs(away).max()) < self.NEAR or self._waited > MOST_WAITED)
        self._waited += self._at == end
        if arrived and self._waited > patience:
            self._stage, self._waited = self._stage + 1, 0
        closed = self._stage >= 2
        return np.append(self.action(away), 1.0 if closed else -1.0).astype(np.float32)

    def _gap(self, observation: Any, reading: policy.ObservationParts) -> Array | None:
        """How far the true tool is from where it is believed to be, as far as it can be seen ``(3,)``, m."""
        return None if reading.camera is None else reading.camera - reading.offset

    def _along(self, joints: Array, distance: float) -> Array:
        """Joints whose tool is moved along its own axis, m."""
        for _ in range(3):
            joints = self._moved(joints, forward(self.geometry, joints).rotation[:, 2] * distance / 3.0)
        return joints

    def _drawn(self, joints: Array, distance: float) -> Array:
        """Joints whose tool is that far behind the fruit, m, in whatever attitude joints within limits allow."""
        assert self._wanted is not None
        goal, g = forward(self.geometry, self._wanted), self.geometry
        target, free = goal.position + goal.rotation[:, 2] * distance, np.ones(g.joints, dtype=bool)
        for _ in range(4):
            gap = target - forward(g, joints).position
            step = np.zeros(g.joints)
            step[free] = truncated_inverse(joint_jacobian(g, joints)[:3, free]) @ gap
            unlimited = joints + step
            joints = unlimited.clip(g.lower, g.upper)
            free = free & (unlimited == joints)
            if not free.any():
                break
        return np.asarray(joints)

    def _moved(self, joints: Array, shift: Array) -> Array:
        """Joints whose tool is moved by ``shift (3,)``, m, and keeps its attitude as far as it can."""
        jacobian = joint_jacobian(self.geometry, joints)
        step = truncated_inverse(jacobian) @ np.concatenate([shift, np.zeros(3)])
        if np.linalg.norm(jacobian[:3] @ step - shift) > STRAY * np.linalg.norm(shift):  # the attitude gives way
            back = truncated_inverse(jacobian[:3])
            step, free = back @ shift, np.eye(len(joints)) - back @ jacobian[:3]
            step = step - free @ (truncated_inverse(jacobian[3:] @ free) @ (jacobian[3:] @ step))
        return np.asarray((joints + step).clip(self.geometry.lower, self.geometry.upper))


class SeeingScene(ScriptedScene):
    """`ScriptedScene` that looks at the fruit in the wrist camera's pictures while it stands, and corrects by them.

    It takes "pixels_environment_state_agent_pos", finds the largest region of fruit by Li's detector (extra `harvest`),
    and takes the camera to be where it is said to be: an error of the camera's place becomes one of the grasp.
    """

    def __init__(self, env: Any) -> None:
        """Read the arm, the scale and the camera's place on the tool from ``env``."""
        super().__init__(env)
        self._eye, self._eye_axes, self._slope = env.unwrapped.scene.wrist_eye
        self._detector = load_stereo_camera("li2016")

    def _gap(self, observation: Any, reading: policy.ObservationParts) -> Array | None:
        picture = observation["pixels"]["wrist"]
        centroids, boxes = fruit_regions(self._detector, picture)
        if not len(boxes):
            return None
        column, row = centroids[np.prod(boxes[:, 2:] - boxes[:, :2], axis=-1).argmax()]
        half = len(picture) / 2
        across = np.array([column + 0.5 - half, half - 0.5 - row]) / half * self._slope
        ray = self._eye_axes @ [*across, -1.0]
        pose = forward(self.geometry, reading.joints)
        depth = reading.offset @ pose.rotation[:, 2]
        point = self._eye + ray * ((depth - self._eye[2]) / ray[2])
        return np.asarray(pose.rotation @ point - reading.offset)


def _state_of(observation: Any) -> Any:
    """The numbers of the state in an observation of the scene, or the observation itself."""
    if isinstance(observation, dict) and "environment_state" not in observation:
        raise InputError("the observation holds no state; make the environment with obs_type='state'")
    return observation["environment_state"] if isinstance(observation, dict) else observation


class ServoScene(policy.ReachController):
    """Take the fruit of `pickenv/PickScene-v0` as somebody does who looks on: no plan, one step after the other.

    Each step takes away a share of what the camera sees between true tool and fruit (`feedback="camera"`). The tool
    goes to the fruit's axis first and then along it, and back once the cup holds. What it does depends on what it sees
    now alone, so that a network can learn it (`clone`).
    """

    SHARE, MOST, TURNS = 0.25, 0.015, 0.03
    """Of what is left, in a step; and the most that it moves, m at full scale, and turns, rad."""
    PRESS, BACK, FUNNEL = 0.01, -0.012, (0.004, 0.25)
    """How far beyond the fruit it aims, and its steps back, m; and how far beside the axis it may be to go on, m, and
    per metre that is left."""

    def __init__(self, env: Any) -> None:
        """Read the arm and the scene's scale from ``env``."""
        super().__init__(env)
        self._scale = env.unwrapped.scene.around.scale

    def reset(self) -> None:
        """Forget the last episode."""
        self.forget()

    def act(self, observation: Any) -> NDArray[np.float32]:
        """The next action, with suction.

        Raises:
            InputError: If the observation holds no camera, or no state.
        """
        numbers = np.asarray(_state_of(observation))
        reading = self.present(numbers[:-2])
        attitude = forward(self.geometry, reading.joints).rotation
        gap = attitude.T @ policy.camera_of(reading, "servo") / self._scale
        turn = np.clip(self.SHARE * (attitude.T @ reading.turn), -self.TURNS, self.TURNS)
        gap[2] += self.PRESS
        step = np.clip(self.SHARE * gap, -self.MOST, self.MOST)
        if step[2] > 0.0:
            width = max(self.FUNNEL[0], self.FUNNEL[1] * gap[2])
            step[2] *= np.exp(-(np.hypot(*gap[:2]) ** 2) / width**2)
        if numbers[-1] > 0.5:
            step, turn = np.array([0.0, 0.0, self.BACK]), np.zeros(3)
        moves = np.concatenate([attitude @ step * self._scale, attitude @ turn])
        joints = truncated_inverse(joint_jacobian(self.geometry, reading.joints)) @ moves
        return np.append(self.action(joints), 1.0).astype(np.float32)


SETTLED = 16
"""Steps after which an arm that stands is looked at."""

STRAY = 0.01
"""Share of a shift that may be lost to keep the tool's attitude."""

MOST_WAITED = 60
"""Steps after which an arm that comes no nearer goes on."""

# The oracle: a policy that knows the true arm. What remains with it, no calibration can remove.


ITERATIONS = 6
"""Newton steps from the nominal solution; millimetres shrink to nothing in three."""


class OracleReach(ScriptedReach):
    """Solve the inverse kinematics of the true arm at rest, effects included, then drive there.

    It knows neither how gaps lie nor how warm the arm is, so effects with a state keep their share of the error.
    """

    def __init__(self, env: Any) -> None:
        """``env`` holds the true arm; its plant is read anew in every episode, for populations of arms."""
        super().__init__(env)
        self._env = env.unwrapped

    def wanted_joints(self, reading: policy.ObservationParts) -> Array:
        """Joints that bring the true arm's tool to the fruit."""
        return _of_true_arm(self._env.plant, super().wanted_joints(reading), self.wanted_pose(reading))


def _of_true_arm(plant: Plant, joints: Array, pose: Pose) -> Array:
    """Joints near ``joints`` at which the tool of the true arm at rest has a pose."""
    nominal = plant.arm.nominal
    for _ in range(ITERATIONS):
        back = truncated_inverse(joint_jacobian(plant.geometry, joints))
        joints = joints + np.einsum("...ij,...j->...i", back, pose_error(plant.tool_pose(joints), pose))
        joints = joints.clip(nominal.lower, nominal.upper)
    return np.asarray(joints)


# Visual servoing on the camera's view of the gap between tool and fruit (Chaumette and Hutchinson 2006). The camera
# says where the fruit is as seen from the true tool; what that differs from the believed gap by is the arm's error
# here. It is filtered with a gain and added to the target: with gain 1 every picture is believed at once, with a
# smaller one the noise of many is averaged. A picture's delay then only makes the correction late, not unstable. m,
# rad.


class ServoReach(ScriptedReach):
    """Drive to the fruit as it was first seen, and correct by the camera through the nominal Jacobian.

    The Jacobian is truncated to the task's rank, and taken at the nominal solution, where the arm arrives.

    Attributes:
        gain: Share of the newest picture in the correction, above 0 and at most 1.
    """

    def __init__(self, env: Any, *, gain: float = 0.1) -> None:
        """``env`` gives the nominal geometry and the increments.

        Raises:
            InputError: If a setting is impossible.
        """
        super().__init__(env)
        if not 0 < gain <= 1:
            raise InputError(f"gain is {gain}; give a number above 0 and at most 1")
        self.gain = gain
        self.reset()

    def reset(self) -> None:
        """Forget the last episode's pictures."""
        super().reset()
        self._correction: Array | None = None

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action.

        Raises:
            InputError: If the observation holds no camera, or the fruit cannot be reached by the nominal arm.
        """
        reading = self.present(observation)
        picture, before = policy.camera_of(reading, "servo") - reading.offset, self._correction
        if self._wanted is None:
            self._wanted = self.wanted_joints(reading)
            self._back: Array = truncated_inverse(joint_jacobian(self.geometry, self._wanted))[..., :3]
        self._correction = picture if before is None else before + self.gain * (picture - before)
        target = self._wanted + np.einsum("...ij,...j->...i", self._back, self._correction)
        target = target.clip(self.geometry.lower, self.geometry.upper)
        return self.action(target - reading.joints)


# A scripted policy for `pickenv/Pick-v0`: from below, wait until the arm has settled, grasp, twist, retreat. It uses
# the observation alone. It trusts the nominal arm, so what it collects shows what the arm's errors cost. It moves
# gently enough not to bruise what it meets; `HASTY` does neither and shows what that costs. How it does each is an
# argument, so that it can be learnt (`scripts/studies/policy_search.py`). Units: m, rad, s.


PICK_ARRIVED = 2e-4
"""A joint within this of its goal is there, m or rad."""

PASSED = 10.0
"""Factor on the arrival distance within which places on the way count as reached."""

GENTLE = 0.75
"""Tool speed as a share of the speed that bruises fruit; the rest is room for swing and following error."""

HASTY: dict[str, Any] = {"settle": 0.0, "tool_speed": np.inf}
"""Arguments of `ScriptedPick` for full speed without waiting."""

OUT, BELOW, AT = range(3)
"""Places on the way to a fruit: below the last fruit, below this fruit, and at it."""


class ScriptedPick(policy.ReachController):
    """A policy that comes to each fruit from below, and stands still for `settle` seconds before it grasps.

    Each argument is one number, or one for each environment of a vector.
    """

    def __init__(
        self,
        env: Any,
        settle: ArrayLike = 0.5,
        approach: ArrayLike = 0.10,
        tool_speed: ArrayLike | None = None,
        *,
        gain: ArrayLike = 1.0,
        arrived: ArrayLike = PICK_ARRIVED,
        aim: ArrayLike = (0.0, 0.0, 0.0),
        patience: ArrayLike = np.inf,
        iterations: int = 25,
    ) -> None:
        """Read the arm from ``env``, a `pickenv/Pick-v0`, single or native vector, wrapped or not.

        Args:
            env: The environment.
            settle: Time without motion before the grasp, s; at most 1.
            approach: Length of the straight way from below, m.
            tool_speed: Largest speed of the believed tool, m/s, gentle when left out; joint speeds hold in any case.
            gain: Share of what is left of a way that one action commands; less than 1 where readings are late.
            arrived: A joint within this of its goal is there, m or rad.
            aim: How far beside the fruit as seen the tool goes ``(..., 3)``, base frame, m.
            patience: Time for one fruit after which the gripper closes as soon as it can, s.
            iterations: Steps of the inverse; fewer leave joints less near to mid-range, and are sooner done.
        """
        super().__init__(env)
        gentle = GENTLE * env.unwrapped.orchard.station.bruise_speed
        self.settle, self.approach, self.aim = (np.asarray(value, dtype=float) for value in (settle, approach, aim))
        self.tool_speed = np.asarray(gentle if tool_speed is None else tool_speed, dtype=float)
        self.gain, self.arrived, self.patience = (np.asarray(value, dtype=float) for value in (gain, arrived, patience))
        self.iterations = iterations
        self.reset()

    def reset(self) -> None:
        """Forget the last canopy."""
        self.forget()
        self._begin(0)

    def _begin(self, count: int) -> None:
        n = self.geometry.joints
        self._fruit, self._way = np.full((count, 3), np.nan), np.full((count, AT + 1, n), np.nan)
        self._place, self._spent = np.full(count, BELOW), np.zeros(count)

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next action ``(n + 1,)``, or actions ``(N, n + 1)`` for observations of as many environments."""
        values = np.asarray(observation, dtype=float)
        single, values = values.ndim == 1, np.atleast_2d(values)
        if len(self._fruit) != len(values):
            self._begin(len(values))
        n, rows = self.geometry.joints, np.arange(len(values))
        joints = self.geometry.lower + (values[:, :n] + 1.0) / 2.0 * (self.geometry.upper - self.geometry.lower)
        joints = self.commanded(joints)
        fruit, turn, still = values[:, n + 3 : n + 6], values[:, n + 9 : n + 12], values[:, n + 12]
        hanging, off = values[:, n + 14] > 0.5, values[:, n + 15] > 0.5
        seeking = ~(hanging | off)
        new = np.flatnonzero(seeking & ~np.isclose(fruit, self._fruit, atol=1e-6).all(axis=-1))
        if single and new.size:
            self._plan(0, joints[0], fruit[0], turn[0])
        elif new.size:
            self._plan(new, joints[new], fruit[new], turn[new])
        for _ in (OUT, BELOW):
            near = self._away(joints, self._way[rows, self._place]) < self.arrived * PASSED
            self._place += seeking & (self._place < AT) & near
        goals = self._way[rows, np.where(off, BELOW, self._place)]
        # Standing still is asked of the command: corrections smaller than the encoders' counts would never end.
        arrived = seeking & (self._place == AT) & (self._away(joints, goals) < self.arrived)
        stays = hanging | arrived | np.isnan(goals[:, 0])
        late = seeking & (self._spent * CONTROL_PERIOD >= self.patience)
        closes = hanging | late | (arrived & (still >= self.settle - 1e-3))
        self._spent += 1.0
        away = np.where(stays[:, None], 0.0, goals - joints)
        shares = self._shares(joints[0], away[0])[None] if single else self._shares(joints, away)
        self.sent(shares)
        actions = np.concatenate([shares, closes[:, None]], axis=-1, dtype=np.float32)
        return actions[0] if single else actions

    def _plan(self, rows: Any, joints: Array, seen: Array, turn: Array) -> None:
        """Waypoints: down from the last fruit, below the next one, and up to it."""
        upright = policy.attitude_after(forward(self.geometry, joints), turn)
        aim = np.broadcast_to(self.aim, self._fruit.shape)[rows]
        down = np.broadcast_to(self.approach, len(self._fruit))[rows][..., None] * np.array([0.0, 0.0, 1.0])
        straight = self._solve(seen + aim, upright, joints)
        at = self._corrected(rows, straight)
        last, below = self._way[rows, BELOW], self._solve(seen + aim - down, upright, straight) + (at - straight)
        self._place[rows] = np.where(np.isnan(last[..., 0]), BELOW, OUT)
        self._way[rows, OUT], self._way[rows, BELOW], self._way[rows, AT] = last, below, at
        self._fruit[rows], self._spent[rows] = seen, 0.0

    def _corrected(self, rows: Any, at: Array) -> Array:
        """Joints to grasp at in the environments ``rows`` for nominal joints ``at``; those, where nothing is learnt."""
        return at

    def _solve(self, position: Array, rotation: Array, start: Array) -> Array:
        pose = Pose(position, rotation)
        most = self.iterations
        return inverse(self.geometry, pose, start, attitude_tolerance=1e-3, max_iterations=most, restarts=0).joints

    @staticmethod
    def _away(joints: Array, goals: Array) -> Array:
        return np.asarray(np.abs(goals - joints).max(axis=-1))

    def _shares(self, joints: Array, away: Array) -> Array:
        """Shares of the joints' increments, in step with each other, so that the tool's way is nearly straight."""
        step = self.gain[..., None] * away
        share = step / self.increment
        way = np.linalg.norm((joint_jacobian(self.geometry, joints)[..., :3, :] @ step[..., None])[..., 0], axis=-1)
        most = np.maximum(np.abs(share).max(axis=-1), way / (self.tool_speed * CONTROL_PERIOD))
        return np.asarray(share / np.maximum(1.0, most)[..., None])


class OraclePick(ScriptedPick):
    """Pick as scripted, aimed by the true arm at rest, as `OracleReach` does; fruit is where the camera saw it."""

    def __init__(self, env: Any, **how: Any) -> None:
        """``env`` holds the true arms, which are read anew for every fruit; ``how`` is as for `ScriptedPick`."""
        super().__init__(env, **how)
        self._env = env.unwrapped

    def _corrected(self, rows: Any, at: Array) -> Array:
        plants = plants_on(self._env.plant, lambda values: values[rows])
        return _of_true_arm(plants, at, forward(self.geometry, at))


# A scripted policy for the harvester: plan the zone once, pick by the plan, plan anew for what was missed. It uses
# the observation alone, and works for the Gymnasium environment and for PettingZoo's.


SLAVE_ARRIVED = 1e-3
"""A joint within this of its goal is there, m or rad."""
PATIENCE = 3
"""Periods that a risen cup waits for its sensor before it gives up."""


@dataclass(eq=False)
class _Arm:
    """State of one slave: its fruit still to pick, and the phase of the present pick."""

    queue: list[int] = field(default_factory=list)
    fruit: int | None = None
    phase: str = "travel"
    waited: int = 0


class ScriptedHarvest:
    """A policy that drives every slave through its planned picks; an arm goes out only where it meets no other arm."""

    def __init__(self, env: Any) -> None:
        """Read the machine from ``env``, a `pickenv/Harvest-v0` of Gymnasium or PettingZoo, wrapped or not."""
        self.task = env.unwrapped.task
        self.machine = self.task.machine
        self.reset()

    def reset(self) -> None:
        """Forget the last zone."""
        self._arms = [_Arm() for _ in range(self.machine.arms)]
        self._work: Work | None = None

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """The next joint action of the whole machine."""
        machine = self.machine
        joints, busy, fruit, hangs = self._decoded(np.asarray(observation, dtype=float))
        idle = all(arm.fruit is None and not arm.queue for arm in self._arms)
        if idle and hangs.any():
            self._plan(joints[:3], fruit, hangs)
        goals = joints.copy()
        for i, arm in enumerate(self._arms):
            mine = slice(3 + 3 * i, 6 + 3 * i)
            goals[mine] = self._goal(i, arm, joints[mine], bool(busy[i] > 0), hangs)
        share = (goals - joints) / self.task.increment
        for i in range(machine.arms):  # swing and stretch keep step, as the plan's clearances suppose
            both = slice(4 + 3 * i, 6 + 3 * i)
            share[both] /= max(1.0, float(np.abs(share[both]).max()))
        return np.asarray(share.clip(-1.0, 1.0), dtype=np.float32)

    def act_together(self, observations: dict[str, NDArray[np.float32]]) -> dict[str, NDArray[np.float32]]:
        """The next actions of PettingZoo's agents."""
        shared = next(iter(observations.values()))[: len(self.task.bounds[0])]
        return dict(zip(observations, self.act(shared).reshape(-1, 3), strict=True))

    def _decoded(self, values: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """Joints, time left of each blade, fruit in the base frame, and whether each fruit hangs in reach."""
        machine, n = self.machine, self.machine.joints
        joints = machine.lower + (values[:n] + 1) / 2 * (machine.upper - machine.lower)
        slots = values[n + machine.arms :].reshape(-1, 4)
        sin, cos = np.sin(joints[0]), np.cos(joints[0])
        right, ahead, up = slots[:, 0], slots[:, 1], slots[:, 2]
        away = np.stack([right * sin + ahead * cos, -right * cos + ahead * sin, up], axis=-1)
        return joints, values[n : n + machine.arms], machine.frame3(joints[:3]) + away, slots[:, 3] > 0.5

    def _plan(self, master: Array, fruit: Array, hangs: NDArray[np.bool_]) -> None:
        work = zone_work(self.machine, master, fruit)
        work.reached[:, ~hangs] = False
        self._work = work
        for arm, queue in zip(self._arms, assign(work, "search"), strict=True):
            arm.queue, arm.fruit = list(queue), None

    def _goal(self, i: int, arm: _Arm, here: Array, cutting: bool, hangs: NDArray[np.bool_]) -> Array:
        """The next goal of slave ``i``; also advances its phase."""
        home, work = self.machine.slave_home, self._work
        if arm.fruit is None:
            if not arm.queue or work is None:
                return here
            arm.fruit, arm.phase, arm.waited = arm.queue.pop(0), "travel", 0
        assert work is not None
        at, low = work.joints[i, arm.fruit], float(work.approach[arm.fruit])
        below = np.array([at[0] - low, *home[1:]])
        if arm.phase == "travel" and np.abs(here - below).max() < SLAVE_ARRIVED and self._clear(i, arm.fruit):
            arm.phase = "out"
        out = np.array([at[0] - low, *at[1:]])
        if arm.phase == "out" and np.abs(here - out).max() < SLAVE_ARRIVED:
            arm.phase = "rise"
        if arm.phase == "rise":
            risen = abs(here[0] - at[0]) < SLAVE_ARRIVED
            arm.waited += risen or cutting
            if not cutting and (arm.waited > PATIENCE or not hangs[arm.fruit]):
                arm.phase = "back"
        if arm.phase == "back":
            drawn_in = np.array([here[0], *home[1:]])
            if np.abs(here - drawn_in).max() < SLAVE_ARRIVED:
                arm.fruit = None
            return drawn_in
        return {"travel": below, "out": out, "rise": np.asarray(at)}[arm.phase]

    def _clear(self, i: int, fruit: int) -> bool:
        """Whether the way of slave ``i`` to ``fruit`` is clear of all arms that are out."""
        assert self._work is not None
        return not any(
            arm.fruit is not None and arm.phase != "travel" and self._work.conflict[i, fruit, k, arm.fruit]
            for k, arm in enumerate(self._arms)
            if k != i
        )


# The same by name, for comparisons: how each is made for an environment.


@register("policy", "random")
@policy.with_traits(("encoders",))
def random(env: Any, seed: int) -> policy.Policy:
    """The policy of uniformly random actions."""
    return RandomReach(env, np.random.default_rng(seed))


@register("policy", "scripted")
@policy.with_traits(("encoders",))
def scripted(env: Any, seed: int = 0) -> policy.Policy:
    """The scripted policy of an environment; it draws no random numbers and ignores ``seed``.

    Raises:
        InputError: If the environment is none of pickenv's.
    """
    inner = env.unwrapped
    if hasattr(inner, "orchard"):
        return ScriptedPick(env)
    if hasattr(getattr(inner, "task", None), "machine"):
        return ScriptedHarvest(env)
    if not hasattr(inner, "task"):
        raise InputError(f"there is no scripted policy for {type(inner).__name__}; give a policy of your own")
    return ScriptedReach(env)


@register("policy", "oracle")
@policy.with_traits(("encoders",), raw_only=True)
def oracle(env: Any, seed: int) -> policy.Policy:
    """The policy that knows the true arm."""
    return OracleReach(env)


@register("policy", "servo")
@policy.with_traits(("camera",))
def servo(env: Any, seed: int) -> policy.Policy:
    """Visual servoing with its usual gain."""
    return ServoReach(env)
