"""Policies without learning: scripted policies for the nominal arm, an oracle, visual servoing, and random actions."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.agents.policies import policy
from pickenv.arm import Array, Plant, Pose, forward, inverse, joint_jacobian, plants_on, pose_error, truncated_inverse
from pickenv.base import InputError, register
from pickenv.harvester import Work, assign, zone_work
from pickenv.orchard import fruit_regions, load_stereo_camera


class ScriptedReach(policy.ReachController):
    """Reach policy that solves the nominal inverse kinematics once per episode and drives straight to the solution.

    It uses the observation only: joint readings, the measured fruit position and the rotation to the wanted attitude.
    """

    def reset(self) -> None:
        """Forget the last episode's fruit."""
        super().reset()
        self._wanted: Array | None = None

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the next action ``(n,)``, or actions ``(N, n)`` for N observations.

        Raises:
            InputError: If the nominal arm cannot reach the fruit.
        """
        reading = self.present(observation)
        if self._wanted is None:
            self._wanted = self.wanted_joints(reading)
        return self.action(self._wanted - reading.joints)

    def wanted_pose(self, reading: policy.ObservationParts) -> Pose:
        """Return the pose that the tool is to reach: the measured fruit position with the wanted attitude."""
        return Pose(reading.seen, policy.attitude_after(forward(self.geometry, reading.joints), reading.turn))

    def wanted_joints(self, reading: policy.ObservationParts) -> Array:
        """Return joint values ``(..., n)``, rad or m, with the nominal arm's tool at `wanted_pose`.

        Raises:
            InputError: If the nominal arm cannot reach the fruit.
        """
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
    """Policy of uniformly random actions, the baseline that uses no information."""

    def __init__(self, env: Any, rng: np.random.Generator) -> None:
        """Read the bounds of actions from ``env``, single or vector, and draw all random numbers from ``rng``."""
        self.space = getattr(env, "single_action_space", env.action_space)
        self.rng = rng

    def reset(self) -> None:
        """Do nothing: the policy keeps no state of an episode."""

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return uniformly random actions, one for each observation."""
        low, high = np.float64(self.space.low), np.float64(self.space.high)
        return np.asarray(self.rng.uniform(low, high, (*np.shape(observation)[:-1], *low.shape)), dtype=np.float32)


class ScriptedScene(ScriptedReach):
    """Scripted policy for `pickenv/PickScene-v0`: approach along the tool axis, stop, advance, grip, and draw back.

    It uses the state observation and the nominal arm. With `feedback="camera"` it stops short of the fruit and
    measures the mean difference between the camera's gap to the fruit and the believed gap. It then corrects its target
    by this difference.

    Attributes:
        FAR: Position of the tool along its axis at the start, m at full scale; 0 at the fruit, negative short of it.
        BEFORE: The same position at the stop.
        PRESS: The same position at the end of the advance.
        AWAY: The same position at the end of the retreat.
        STAND: Number of steps for which the arm stands at the stop short of the fruit.
        GRIP: Number of steps for which the arm grips.
        SLOW: Distance per step near the fruit, m at full scale.
        NEAR: Joint error below which joints have arrived, rad or m.
        SETTLED: Number of steps for which the arm stands still before the policy measures the gap to the fruit.
        STRAY: Largest position error of a move that keeps the tool's attitude, as a share of the move. If the error is
            larger, the attitude may change.
        MOST_WAITED: Number of steps after which the policy goes on even if the joints have not arrived.
    """

    FAR, BEFORE, PRESS, AWAY = -0.2, -0.08, 0.003, -0.4
    STAND, GRIP = 40, 10
    _PATIENCE = (0, STAND, 0, GRIP, np.inf)
    SLOW, NEAR = 0.003, 2e-3
    SETTLED, STRAY, MOST_WAITED = 16, 0.01, 60

    def __init__(self, env: Any) -> None:
        """Read the arm from ``env``."""
        super().__init__(env)
        self.lag = max(self.lag, 1)  # drives with inertia follow late: it goes by what it has sent

    def reset(self) -> None:
        """Forget the last episode's fruit."""
        super().reset()
        self._stage, self._waited, self._at = 0, 0, self.FAR
        self._gaps: list[Array] = []

    def act(self, observation: Any) -> NDArray[np.float32]:
        """Return the next action ``(n + 1,)``: joint increments, then a number for the gripper, below 0 to open it."""
        reading, scale = self.present(np.asarray(_state_of(observation))[:-2]), self.env.scene.around.scale
        if self._wanted is None:
            self._wanted = self.wanted_joints(reading)
        end = (self.FAR, self.BEFORE, self.PRESS, self.PRESS, self.AWAY)[self._stage]
        step = self.SLOW if self._stage in (2, 3) else 3.0 * self.SLOW
        self._at += float(np.clip(end - self._at, -step, step))
        if self._stage < len(self._PATIENCE) - 1:
            goal = self._along(self._wanted, self._at * scale)
        else:
            goal = self._drawn(reading.joints, min(self._at, 0.0) * scale)
        if self._stage == 1 and self._waited > self.SETTLED and (gap := self._gap(observation, reading)) is not None:
            self._gaps.append(gap)
        if self._stage >= 2 and self._gaps:
            goal = self._moved(goal, np.mean(self._gaps, axis=0))
        away = goal - reading.joints
        arrived = self._at == end and (float(np.abs(away).max()) < self.NEAR or self._waited > self.MOST_WAITED)
        self._waited += self._at == end
        if arrived and self._waited > self._PATIENCE[self._stage]:
            self._stage, self._waited = self._stage + 1, 0
        return np.append(self.action(away), 1.0 if self._stage >= 2 else -1.0).astype(np.float32)

    def _gap(self, observation: Any, reading: policy.ObservationParts) -> Array | None:
        """Return the measured minus the believed gap from tool to fruit ``(3,)``, m, base frame.

        Without a camera measurement return None.
        """
        return None if reading.camera is None else reading.camera - reading.offset

    def _along(self, joints: Array, distance: float) -> Array:
        """Return joints ``(n,)`` with the tool ``distance``, m, further along its own axis than at ``joints``."""
        for _ in range(3):
            joints = self._moved(joints, forward(self.geometry, joints).rotation[:, 2] * distance / 3.0)
        return joints

    def _drawn(self, joints: Array, distance: float) -> Array:
        """Return joints ``(n,)`` near ``joints`` with the tool at a distance from the fruit along the wanted tool axis.

        The tool may have any attitude. ``distance``, m, is negative short of the fruit.
        """
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
        """Return joints ``(n,)`` that move the tool from its position at ``joints`` by ``shift (3,)``, m, base frame.

        The tool keeps its attitude if possible.
        """
        jacobian = joint_jacobian(self.geometry, joints)
        step = truncated_inverse(jacobian) @ np.concatenate([shift, np.zeros(3)])
        if np.linalg.norm(jacobian[:3] @ step - shift) > self.STRAY * np.linalg.norm(shift):  # the attitude gives way
            back = truncated_inverse(jacobian[:3])
            step, free = back @ shift, np.eye(len(joints)) - back @ jacobian[:3]
            step = step - free @ (truncated_inverse(jacobian[3:] @ free) @ (jacobian[3:] @ step))
        return np.asarray((joints + step).clip(self.geometry.lower, self.geometry.upper))


class SeeingScene(ScriptedScene):
    """`ScriptedScene` that locates the fruit in the wrist camera's images while the arm stands, and corrects the aim.

    It needs observations "pixels_environment_state_agent_pos". Li's detector (extra `harvest`) segments the fruit, and
    the policy takes the largest region. The policy relies on the pose of the camera on the tool that the environment
    states. An error of this pose becomes an error of the grasp.
    """

    def __init__(self, env: Any) -> None:
        """Read the arm, and the camera's pose in the tool's frame, from ``env``."""
        super().__init__(env)
        self._eye, self._eye_axes, self._slope = self.env.scene.wrist_eye
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
        point = self._eye + ray * ((reading.offset @ pose.rotation[:, 2] - self._eye[2]) / ray[2])
        return np.asarray(pose.rotation @ point - reading.offset)


def _state_of(observation: Any) -> Any:
    """Return the state vector of a scene's observation, which is the whole observation or a part of it."""
    if isinstance(observation, dict) and "environment_state" not in observation:
        raise InputError("the observation holds no state; make the environment with obs_type='state'")
    return observation["environment_state"] if isinstance(observation, dict) else observation


class ServoScene(policy.ReachController):
    """Visual-servoing policy for `pickenv/PickScene-v0`; it plans nothing ahead.

    Each step removes a share of the gap that the camera measures between the tool's true position and the fruit
    (`feedback="camera"`). The tool first moves sideways until its axis points at the fruit. It then advances along this
    axis, and retreats once the cup holds the fruit. Without delays the action depends on the present observation only,
    so that a network can learn it (`clone`).

    Attributes:
        SHARE: Share of the remaining gap that one step removes.
        MOST: Largest move of one step, m at full scale.
        TURNS: Largest turn of one step, rad.
        PRESS: Distance of the aim beyond the fruit, m at full scale.
        BACK: Retreat per step, m at full scale.
        FUNNEL: Two numbers that set the lateral distance from tool axis to fruit at which the advance slows to 1/e. It
            is the larger of two: the first number, m at full scale, and the second number times the remaining gap.
    """

    SHARE, MOST, TURNS = 0.25, 0.015, 0.03
    PRESS, BACK, FUNNEL = 0.01, -0.012, (0.004, 0.25)

    def act(self, observation: Any) -> NDArray[np.float32]:
        """Return the next action ``(n + 1,)``, with suction on.

        Raises:
            InputError: If the observation holds no camera measurement, or no state.
        """
        numbers, scale = np.asarray(_state_of(observation)), self.env.scene.around.scale
        reading = self.present(numbers[:-2])
        attitude = forward(self.geometry, reading.joints).rotation
        gap = attitude.T @ policy.camera_of(reading, "servo") / scale
        turn = np.clip(self.SHARE * (attitude.T @ reading.turn), -self.TURNS, self.TURNS)
        gap[2] += self.PRESS
        step = np.clip(self.SHARE * gap, -self.MOST, self.MOST)
        if step[2] > 0.0:
            width = max(self.FUNNEL[0], self.FUNNEL[1] * gap[2])
            step[2] *= np.exp(-(np.hypot(*gap[:2]) ** 2) / width**2)
        if numbers[-1] > 0.5:
            step, turn = np.array([0.0, 0.0, self.BACK]), np.zeros(3)
        moves = np.concatenate([attitude @ step * scale, attitude @ turn])
        joints = truncated_inverse(joint_jacobian(self.geometry, reading.joints)) @ moves
        return np.append(self.action(joints), 1.0).astype(np.float32)


# The oracle: a policy that knows the true arm. What remains with it, no calibration can remove.


class OracleReach(ScriptedReach):
    """Reach policy that solves the inverse kinematics of the true arm at rest, effects included, and drives there.

    The policy knows neither the state of backlash and friction nor the arm's temperature, so errors due to these
    remain. The environment's plant (the true arm with its errors) may change, and is read anew in every episode.
    """

    def wanted_joints(self, reading: policy.ObservationParts) -> Array:
        """Return joint values ``(..., n)``, rad or m, at which the true arm at rest has its tool at `wanted_pose`."""
        return _of_true_arm(self.env.plant, super().wanted_joints(reading), self.wanted_pose(reading))


def _of_true_arm(plant: Plant, joints: Array, pose: Pose) -> Array:
    """Return joints ``(..., n)`` near ``joints``, rad or m, at which the true arm at rest has its tool at ``pose``."""
    nominal = plant.arm.nominal
    for _ in range(6):  # Newton steps from the nominal solution; three are enough for errors of millimetres
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
    """Reach policy that drives to the first measured fruit position and corrects its target by visual servoing.

    The pseudoinverse of the nominal Jacobian, truncated to the task's rank, maps the camera's corrections to joints.
    The Jacobian is computed once, at the joints that the nominal inverse kinematics gives for the fruit.

    Attributes:
        gain: Weight of the newest measurement in the filtered correction, above 0 and at most 1.
    """

    def __init__(self, env: Any, *, gain: float = 0.1) -> None:
        """Read the nominal geometry and the joint increments from ``env``.

        Raises:
            InputError: If ``gain`` is not above 0 and at most 1.
        """
        super().__init__(env)
        if not 0 < gain <= 1:
            raise InputError(f"gain is {gain}; give a number above 0 and at most 1")
        self.gain = gain

    def reset(self) -> None:
        """Forget the last episode's fruit and measurements."""
        super().reset()
        self._correction: Array | None = None

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the next action ``(n,)``, or actions ``(N, n)`` for N observations.

        Raises:
            InputError: If the observation holds no camera measurement, or the nominal arm cannot reach the fruit.
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


HASTY: dict[str, Any] = {"settle": 0.0, "tool_speed": np.inf}
"""Arguments of `ScriptedPick` for full speed without waiting."""

OUT, BELOW, AT = range(3)


class ScriptedPick(policy.ReachController):
    """Scripted policy for `pickenv/Pick-v0`: approach each fruit from below, stand still for `settle` s, and grasp.

    Numeric arguments except ``iterations`` take one value, or one value for each environment of a vector.

    Attributes:
        PASSED: Factor on the arrival tolerance, for all waypoints but the fruit itself.
        GENTLE: Tool speed as a share of the speed that bruises fruit; the margin is for swing and following error.
    """

    PASSED, GENTLE = 10.0, 0.75

    def __init__(
        self,
        env: Any,
        settle: ArrayLike = 0.5,
        approach: ArrayLike = 0.10,
        tool_speed: ArrayLike | None = None,
        *,
        gain: ArrayLike = 1.0,
        arrived: ArrayLike = 2e-4,
        aim: ArrayLike = (0.0, 0.0, 0.0),
        patience: ArrayLike = np.inf,
        iterations: int = 25,
    ) -> None:
        """Read the arm from ``env``, a `pickenv/Pick-v0`, single or native vector, wrapped or not.

        Args:
            env: The environment.
            settle: Time without motion before the grasp, s; at most 1.
            approach: Length of the straight path from below up to the fruit, m.
            tool_speed: Largest speed of the tool as the nominal arm predicts it, m/s; by default, `GENTLE` times the
                bruising speed. Limits of joint speeds hold in any case.
            gain: Share of the remaining joint step that one action commands; less than 1 if readings are delayed.
            arrived: Joint error below which a joint counts as arrived, m or rad.
            aim: Offset from the measured fruit position to the aim ``(..., 3)``, base frame, m.
            patience: Longest time for one fruit, s; after it, the gripper closes wherever the arm is.
            iterations: Largest number of iterations of the inverse kinematics. Fewer iterations are faster, but leave
                joints farther from mid-range.
        """
        super().__init__(env)
        self.period: float = self.env.task.situation.period.high  # the increments are those of this period
        gentle = self.GENTLE * self.env.orchard.station.bruise_speed
        self.settle, self.approach, self.aim = (np.asarray(value, dtype=float) for value in (settle, approach, aim))
        self.tool_speed = np.asarray(gentle if tool_speed is None else tool_speed, dtype=float)
        self.gain, self.arrived, self.patience = (np.asarray(value, dtype=float) for value in (gain, arrived, patience))
        self.iterations = iterations

    def reset(self) -> None:
        """Forget the last canopy."""
        super().reset()
        self._begin(0)

    def _begin(self, count: int) -> None:
        self._fruit, self._way = np.full((count, 3), np.nan), np.full((count, AT + 1, self.geometry.joints), np.nan)
        self._place, self._spent = np.full(count, BELOW), np.zeros(count)

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the next action ``(n + 1,)``, or actions ``(N, n + 1)`` for observations of N environments."""
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
        if new.size:
            some = 0 if single else new
            self._plan(some, joints[some], fruit[some], turn[some])
        for _ in (OUT, BELOW):
            near = self._away(joints, self._way[rows, self._place]) < self.arrived * self.PASSED
            self._place += seeking & (self._place < AT) & near
        goals = self._way[rows, np.where(off, BELOW, self._place)]
        # Standing still is asked of the command: corrections smaller than the encoders' counts would never end.
        arrived = seeking & (self._place == AT) & (self._away(joints, goals) < self.arrived)
        stays = hanging | arrived | np.isnan(goals[:, 0])
        late = seeking & (self._spent * self.period >= self.patience)
        closes = hanging | late | (arrived & (still >= self.settle - 1e-3))
        self._spent += 1.0
        away = np.where(stays[:, None], 0.0, goals - joints)
        shares = self._shares(joints[0], away[0])[None] if single else self._shares(joints, away)
        self.sent(shares)
        actions = np.concatenate([shares, closes[:, None]], axis=-1, dtype=np.float32)
        return actions[0] if single else actions

    def _plan(self, rows: Any, joints: Array, seen: Array, turn: Array) -> None:
        """Plan three waypoints: below the last fruit (`OUT`), below the next fruit (`BELOW`), at the next fruit (`AT`).

        Args:
            rows: Indices of the r environments, from 0.
            joints: Present joints ``(r, n)``, rad or m.
            seen: Measured positions of the next fruit ``(r, 3)``, m, base frame.
            turn: Rotation vectors from the believed to the upright tool attitude ``(r, 3)``, rad.
        """
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
        """Return the joints ``(..., n)`` at which to grasp in the environments ``rows`` (indices from 0).

        ``at`` are the nominal arm's joints at the fruit, rad or m. This class returns them; subclasses correct them.
        """
        return at

    def _solve(self, position: Array, rotation: Array, start: Array) -> Array:
        pose, most = Pose(position, rotation), self.iterations
        return inverse(self.geometry, pose, start, attitude_tolerance=1e-3, max_iterations=most, restarts=0).joints

    @staticmethod
    def _away(joints: Array, goals: Array) -> Array:
        return np.asarray(np.abs(goals - joints).max(axis=-1))

    def _shares(self, joints: Array, away: Array) -> Array:
        """Return the action ``(..., n)`` towards a goal of the joints, within the limits of joint speed and tool speed.

        One factor scales the steps of all joints, so that the tool's path is nearly straight.

        Args:
            joints: Present joints ``(..., n)``, rad or m.
            away: Goal minus present joints ``(..., n)``, rad or m.
        """
        step = self.gain[..., None] * away
        share = step / self.increment
        way = np.linalg.norm((joint_jacobian(self.geometry, joints)[..., :3, :] @ step[..., None])[..., 0], axis=-1)
        most = np.maximum(np.abs(share).max(axis=-1), way / (self.tool_speed * self.period))
        return np.asarray(share / np.maximum(1.0, most)[..., None])


class OraclePick(ScriptedPick):
    """`ScriptedPick` that solves the inverse kinematics of the true arm at rest, as `OracleReach` does.

    It aims at the fruit position that the camera measured. The true arms are read anew for every fruit.
    """

    def _corrected(self, rows: Any, at: Array) -> Array:
        return _of_true_arm(plants_on(self.env.plant, lambda values: values[rows]), at, forward(self.geometry, at))


# A scripted policy for the harvester: plan the zone once, pick by the plan, plan anew for what was missed. It uses
# the observation alone, and works for the Gymnasium environment and for PettingZoo's.


@dataclass(eq=False)
class _Arm:
    """State of one slave (picking arm): indices of its fruit still to pick, its present fruit, and the pick's phase."""

    queue: list[int] = field(default_factory=list)
    fruit: int | None = None
    phase: str = "travel"
    waited: int = 0


class ScriptedHarvest:
    """Scripted policy for `pickenv/Harvest-v0` that drives every slave (picking arm) through its planned picks.

    A slave goes out to a fruit only if it cannot collide with another slave that is out at a fruit.

    Attributes:
        ARRIVED: Joint error below which a joint of a slave counts as arrived, m or rad.
        PATIENCE: Number of control periods that a raised cup waits for its sensor before it gives up.
    """

    ARRIVED, PATIENCE = 1e-3, 3

    def __init__(self, env: Any) -> None:
        """Read the machine from ``env``, a `pickenv/Harvest-v0` of Gymnasium or PettingZoo, wrapped or not."""
        self.task = env.unwrapped.task
        self.machine = self.task.machine
        self.reset()

    def reset(self) -> None:
        """Forget the last zone."""
        self._arms = [_Arm() for _ in range(self.machine.arms)]

    def act(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the next action of all joints of the machine ``(3 + 3 arms,)``."""
        joints, busy, fruit, hangs = self._decoded(np.asarray(observation, dtype=float))
        if hangs.any() and all(arm.fruit is None and not arm.queue for arm in self._arms):
            self._plan(joints[:3], fruit, hangs)
        goals = joints.copy()
        for i, arm in enumerate(self._arms):
            mine = slice(3 + 3 * i, 6 + 3 * i)
            goals[mine] = self._goal(i, arm, joints[mine], bool(busy[i] > 0), hangs)
        share = (goals - joints) / self.task.increment
        pairs = share[3:].reshape(-1, 3)[:, 1:]  # swing and stretch keep step, as the plan's clearances suppose
        pairs /= np.maximum(1.0, np.abs(pairs).max(axis=1, keepdims=True))
        return np.asarray(share.clip(-1.0, 1.0), dtype=np.float32)

    def act_together(self, observations: dict[str, NDArray[np.float32]]) -> dict[str, NDArray[np.float32]]:
        """Return the next action of each PettingZoo agent, by the agents' names."""
        shared = next(iter(observations.values()))[: len(self.task.bounds[0])]
        return dict(zip(observations, self.act(shared).reshape(-1, 3), strict=True))

    def _decoded(self, values: Array) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """Take apart the observation ``values`` of `pickenv/Harvest-v0`.

        Returns:
            Four arrays. The first holds the joints, rad or m. The second holds the share of sensing and cutting that
            each slave still has to do. The third holds the positions of the fruit ``(fruit, 3)``, m, base frame. The
            fourth is a mask ``(fruit,)`` of the fruit that hangs in reach.
        """
        machine, n = self.machine, self.machine.joints
        joints = machine.lower + (values[:n] + 1) / 2 * (machine.upper - machine.lower)
        slots = values[n + machine.arms :].reshape(-1, 4)
        sin, cos = np.sin(joints[0]), np.cos(joints[0])
        right, ahead, up = slots[:, 0], slots[:, 1], slots[:, 2]
        away = np.stack([right * sin + ahead * cos, -right * cos + ahead * sin, up], axis=-1)
        return joints, values[n : n + machine.arms], machine.frame3(joints[:3]) + away, slots[:, 3] > 0.5

    def _plan(self, master: Array, fruit: Array, hangs: NDArray[np.bool_]) -> None:
        self._work: Work = zone_work(self.machine, master, fruit)
        self._work.reached[:, ~hangs] = False
        for arm, queue in zip(self._arms, assign(self._work, "search"), strict=True):
            arm.queue, arm.fruit = list(queue), None

    def _goal(self, i: int, arm: _Arm, here: Array, cutting: bool, hangs: NDArray[np.bool_]) -> Array:
        """Return the next joint goal ``(3,)`` of a slave, rad or m, and advance the phase of its pick.

        Args:
            i: Index of the slave, from 0.
            arm: State of the slave.
            here: Present joints of the slave ``(3,)``.
            cutting: Whether the slave's blade is closing.
            hangs: Flags of the fruit that hangs in reach.
        """
        if arm.fruit is None:
            if not arm.queue:
                return here
            arm.fruit, arm.phase, arm.waited = arm.queue.pop(0), "travel", 0
        home, work = self.machine.slave_home, self._work
        at, low = work.joints[i, arm.fruit], float(work.approach[arm.fruit])
        below = np.array([at[0] - low, *home[1:]])
        if arm.phase == "travel" and np.abs(here - below).max() < self.ARRIVED and self._clear(i, arm.fruit):
            arm.phase = "out"
        out = np.array([at[0] - low, *at[1:]])
        if arm.phase == "out" and np.abs(here - out).max() < self.ARRIVED:
            arm.phase = "rise"
        if arm.phase == "rise":
            arm.waited += cutting or abs(here[0] - at[0]) < self.ARRIVED
            if not cutting and (arm.waited > self.PATIENCE or not hangs[arm.fruit]):
                arm.phase = "back"
        if arm.phase == "back":
            drawn_in = np.array([here[0], *home[1:]])
            if np.abs(here - drawn_in).max() < self.ARRIVED:
                arm.fruit = None
            return drawn_in
        return {"travel": below, "out": out, "rise": np.asarray(at)}[arm.phase]

    def _clear(self, i: int, fruit: int) -> bool:
        """Return whether slave ``i`` can go out to ``fruit``, indices from 0, without hitting a slave that is out."""
        return not any(
            arm.fruit is not None and arm.phase != "travel" and self._work.conflict[i, fruit, k, arm.fruit]
            for k, arm in enumerate(self._arms)
            if k != i
        )


# The same by name, for comparisons: how each is made for an environment.


@register("policy", "random")
def random(env: Any, seed: int) -> policy.Policy:
    """Make the policy of uniformly random actions."""
    return RandomReach(env, np.random.default_rng(seed))


@register("policy", "scripted")
def scripted(env: Any, seed: int = 0) -> policy.Policy:
    """Make the scripted policy that fits an environment; it draws no random numbers and ignores ``seed``.

    Raises:
        InputError: If there is no scripted policy for the environment.
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
def oracle(env: Any, seed: int) -> policy.Policy:
    """Make the policy that knows the true arm; ``seed`` is not used."""
    return OracleReach(env)


@register("policy", "servo")
def servo(env: Any, seed: int) -> policy.Policy:
    """Make the visual-servoing policy with its default gain; ``seed`` is not used."""
    return ServoReach(env)


# What an evaluation needs to know of each, as `pickenv.agents.evaluation.contenders.Kind` explains.
vars(random).update(feedback=("encoders",))
vars(scripted).update(feedback=("encoders",))
vars(oracle).update(feedback=("encoders",), raw_only=True)
vars(servo).update(feedback=("camera",))
