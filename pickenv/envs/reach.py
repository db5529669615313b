"""`pickenv/Reach-v0`: bring the tool to a fruit with an arm that is not quite the one its controller believes in."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import load_plant
from pickenv.arm.geometry import Array
from pickenv.arm.kinematics import Frame, chain_of, frame_error, tool_frame
from pickenv.arm.plant import Plant
from pickenv.errors import InputError

CONTROL_PERIOD = 0.1
"""Time between two actions, s: with the arm file's joint speeds it bounds one action's increment."""

MOST_CAMERA_NOISE_MM = 100.0
"""Ten standard deviations of the camera then stay within the metre that the observation's bounds leave for errors."""

FEEDBACK = ("encoders", "camera")
REWARDS = ("dense", "sparse")

Compensate = Callable[[Array], Array]


class ReachEnv(gym.Env[NDArray[np.float32], NDArray[np.float32]]):
    """Bring the tool to a fruit, in the attitude asked for, with an arm that is not what its controller believes.

    ## Description

    A six-joint picking arm (Qiao 2026: pitch, horizontal rail, telescopic boom, end rotation, end slide, twist) must
    bring its tool to a fruit, in the attitude asked for. The policy commands the *nominal* arm; what moves is the
    *true* arm, whose parts are off by tenths of millimetres and whose joints and boom bend. How far the true tool ends
    from the fruit is what is scored; the policy never sees it.

    ## Action Space

    `Box(-1, 1, (6,), float32)`: joint increments, as shares of the largest increment per control period of 0.1 s.

    | Num | Action            | Control Min | Control Max | Largest increment | Unit |
    |-----|-------------------|-------------|-------------|-------------------|------|
    | 0   | J1 pitch          | -1          | 1           | 6                 | deg  |
    | 1   | J2 horizontal rail| -1          | 1           | 50                | mm   |
    | 2   | J3 telescopic boom| -1          | 1           | 50                | mm   |
    | 3   | J4 end rotation   | -1          | 1           | 6                 | deg  |
    | 4   | J5 end slide      | -1          | 1           | 50                | mm   |
    | 5   | J6 twist          | -1          | 1           | 18                | deg  |

    The environment adds the increments to a nominal joint target, keeps it inside the joint limits, and hands it to the
    drives, through a compensator if `pickenv.wrappers.CompensationWrapper` has installed one.

    ## Observation Space

    `Box(float32)`, 18 numbers, or 21 with `feedback="camera"`. Nothing in it depends on the true arm but the camera's
    offset. Positions and attitudes are in the base frame.

    | Num   | Observation                                                          | Min  | Max  | Unit |
    |-------|----------------------------------------------------------------------|------|------|------|
    | 0-5   | joint readings, scaled to the joint limits                           | -1   | 1    | 1    |
    | 6-8   | believed tool position (nominal forward kinematics of the readings)  | -R   | R    | m    |
    | 9-11  | fruit position as the camera saw it                                  | -R   | R    | m    |
    | 12-14 | fruit minus believed tool position                                   | -2R  | 2R   | m    |
    | 15-17 | wanted against believed attitude, rotation vector                    | -pi  | pi   | rad  |
    | 18-20 | fruit minus true tool position as the camera measures it (camera)    | -2R  | 2R   | m    |

    R is an upper bound of the arm's reach plus 1 m.

    ## Rewards

    With e the distance between true tool and fruit in mm and t the angle between true and wanted attitude in degrees:

    - dense (default): -log10(1 + e) - 0.5 log10(1 + t), from about -4.4 (far away) to 0 (perfect); one more decimal of
      accuracy is worth as much at a millimetre as at a metre.
    - sparse: 0 while the fruit is inside the capture region, else -1.

    ## Starting State

    All joints at mid-range. Wanted poses are drawn from the nominal arm's joint ranges, 5 % away from the limits, such
    that the tool points upwards within `max_tilt_deg`: the arm picks from below. `reset(options=...)` takes
    `"start_joints"` and `"goal_joints"` (rad and m).

    ## Episode End

    - Termination: never; final accuracy is the point, so reaching the fruit does not end the episode.
    - Truncation: after 60 steps (`max_episode_steps` of `gym.make`).

    ## Information

    `info` has the same keys after `reset` and `step`: `position_error_mm`, `attitude_error_deg`, `is_success` (bool),
    `pose_error` (true tool against fruit: m, and rotation vector in rad), `joint_command` (what the drives got),
    `tool_position` (true, m), `fruit_position` (true, m).

    ## Arguments

    ```python
    >>> import gymnasium as gym
    >>> import pickenv
    >>> env = gym.make("pickenv/Reach-v0", plant="geometry_only", tolerance_mm=2.0)
    >>> observation, info = env.reset(seed=1)
    >>> observation.shape
    (18,)

    ```

    - `plant` (str, default "qiao2026"): preset or path of a plant file; "geometry_only" is Table 1 alone.
    - `without` (sequence of str): effects of the plant to switch off.
    - `feedback` ("encoders" or "camera"): whether the camera's tool-to-fruit offset is part of the observation.
    - `camera_noise_mm` (float, 0 to 100, default 0): standard deviation per axis of all that the camera sees.
    - `tolerance_mm` (float, default 5): radius of the gripper's capture region; 5 mm is the clearance of Li's cup.
    - `angle_tolerance_deg` (float, default 10): attitude tolerance of the capture region.
    - `reward` ("dense" or "sparse").
    - `max_tilt_deg` (float, default 30): largest angle between the wanted tool axis and the vertical.

    ## Version History

    * v0: First version.
    """

    metadata = {"render_modes": [], "render_fps": 10}  # noqa: RUF012

    def __init__(
        self,
        plant: str = "qiao2026",
        without: Sequence[str] = (),
        feedback: str = "encoders",
        camera_noise_mm: float = 0.0,
        tolerance_mm: float = 5.0,
        angle_tolerance_deg: float = 10.0,
        reward: str = "dense",
        max_tilt_deg: float = 30.0,
        render_mode: str | None = None,
    ) -> None:
        """See the class for the arguments; raises `InputError` for impossible ones."""
        _choice("feedback", feedback, FEEDBACK)
        _choice("reward", reward, REWARDS)
        for name, value, low in (
            ("tolerance_mm", tolerance_mm, 0.0),
            ("angle_tolerance_deg", angle_tolerance_deg, 0.0),
            ("camera_noise_mm", camera_noise_mm, None),
            ("max_tilt_deg", max_tilt_deg, 0.0),
        ):
            if not math.isfinite(value) or value < 0 or value == low:
                raise InputError(
                    f"{name} is {value}; give a finite number {'above' if low == 0.0 else 'not below'} zero"
                )
        if camera_noise_mm > MOST_CAMERA_NOISE_MM:
            raise InputError(f"camera_noise_mm is {camera_noise_mm}; give at most {MOST_CAMERA_NOISE_MM:.0f}")
        self.plant: Plant = load_plant(plant, without=without)
        self.feedback, self.reward_kind, self.render_mode = feedback, reward, render_mode
        self.camera_noise = camera_noise_mm * 1e-3
        self.tolerance_mm, self.angle_tolerance_deg = float(tolerance_mm), float(angle_tolerance_deg)
        self.max_tilt = math.radians(max_tilt_deg)
        self.compensator: Compensate | None = None
        geometry = self.plant.arm.nominal
        self._chain = chain_of(geometry)
        self._lower, self._upper = geometry.lower.tolist(), geometry.upper.tolist()
        self._increment = (self.plant.arm.speed * CONTROL_PERIOD).tolist()
        n, reach = geometry.joints, _reach_bound(self.plant)
        high = np.array([1.0] * n + [reach] * 6 + [2 * reach] * 3 + [math.pi] * 3, dtype=np.float32)
        if feedback == "camera":
            high = np.append(high, np.full(3, 2 * reach, dtype=np.float32))
        self.observation_space = spaces.Box(-high, high, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (n,), dtype=np.float32)
        self._target: list[float] = []

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start an episode; see the class for `options`."""
        super().reset(seed=seed)
        options = options or {}
        unknown = set(options) - {"start_joints", "goal_joints"}
        if unknown:
            raise InputError(f"unknown reset option '{sorted(unknown)[0]}'; give start_joints or goal_joints")
        middle = [(low + high) / 2 for low, high in zip(self._lower, self._upper, strict=True)]
        self._target = self._given_joints(options, "start_joints") or middle
        goal = self._given_joints(options, "goal_joints") or self._draw_goal()
        self._goal: Frame = tool_frame(math, self._chain, goal)
        seen = self._camera(self._goal[9:12])
        self._goal_seen: Frame = (*self._goal[:9], *seen)
        observation, info, _ = self._look()
        return observation, info

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """Move the joint target by `action` and see where the true tool goes.

        Raises:
            InputError: If the action is not finite or has another shape.
        """
        values = np.asarray(action, dtype=float)
        if values.shape != (len(self._increment),) or not all(map(math.isfinite, values.tolist())):
            raise InputError(f"action {values} is not {len(self._increment)} finite numbers between -1 and 1")
        self._target = [
            min(max(target + min(max(share, -1.0), 1.0) * most, low), high)
            for target, share, most, low, high in zip(
                self._target, values.tolist(), self._increment, self._lower, self._upper, strict=True
            )
        ]
        observation, info, reward = self._look()
        return observation, reward, False, False, info

    @property
    def joint_target(self) -> Array:
        """The nominal joint target that the actions have built up, rad or m."""
        return np.array(self._target)

    def _look(self) -> tuple[NDArray[np.float32], dict[str, Any], float]:
        """Observation, information and reward at the present joint target."""
        target = self._target
        command = target if self.compensator is None else self.compensator(np.array(target)).tolist()
        # The encoders sit on the motor side and see the command; readings are mapped back to nominal joints, so that a
        # compensator stays invisible to a policy that servoes on its believed tool position.
        believed = tool_frame(math, self._chain, target)
        offset = frame_error(believed, self._goal_seen)
        readings = [
            2.0 * (q - low) / (high - low) - 1.0 for q, low, high in zip(target, self._lower, self._upper, strict=True)
        ]
        true = self.plant.tool_frame_floats(command)
        error = frame_error(self._goal, true)
        numbers = [*readings, *believed[9:12], *self._goal_seen[9:12], *offset]
        if self.feedback == "camera":
            numbers += self._camera((-error[0], -error[1], -error[2]))
        distance = 1e3 * math.sqrt(error[0] * error[0] + error[1] * error[1] + error[2] * error[2])
        angle = math.degrees(math.sqrt(error[3] * error[3] + error[4] * error[4] + error[5] * error[5]))
        success = distance <= self.tolerance_mm and angle <= self.angle_tolerance_deg
        if self.reward_kind == "dense":
            reward = -math.log10(1.0 + distance) - 0.5 * math.log10(1.0 + angle)
        else:
            reward = 0.0 if success else -1.0
        info = {
            "position_error_mm": distance,
            "attitude_error_deg": angle,
            "is_success": success,
            "pose_error": np.array(error),
            "joint_command": np.array(command),
            "tool_position": np.array(true[9:12]),
            "fruit_position": np.array(self._goal[9:12]),
        }
        return np.array(numbers, dtype=np.float32), info, reward

    def _camera(self, point: Sequence[float]) -> list[float]:
        """A point as the camera sees it."""
        if not self.camera_noise:
            return list(point)
        return [v + float(e) for v, e in zip(point, self.np_random.normal(0.0, self.camera_noise, 3), strict=True)]

    def _given_joints(self, options: dict[str, Any], key: str) -> list[float] | None:
        if options.get(key) is None:
            return None
        joints = np.asarray(options[key], dtype=float)
        lower, upper = np.array(self._lower), np.array(self._upper)
        if joints.shape != lower.shape or not np.all((joints >= lower) & (joints <= upper)):
            raise InputError(f"{key} must be {len(lower)} joints (rad, m) inside the joint limits {lower} to {upper}")
        return [float(v) for v in joints]

    def _draw_goal(self) -> list[float]:
        """Joints of a wanted pose: uniform in the inner 90 % of the ranges, tool upwards within the largest tilt."""
        lower, upper = np.array(self._lower), np.array(self._upper)
        margin = 0.05 * (upper - lower)
        for _ in range(10_000):
            joints: list[float] = self.np_random.uniform(lower + margin, upper - margin).tolist()
            if tool_frame(math, self._chain, joints)[8] >= math.cos(self.max_tilt):
                return joints
        raise InputError(
            f"arm '{self.plant.arm.name}' found no pose with its tool within {math.degrees(self.max_tilt):.0f} deg of "
            "the vertical; raise max_tilt_deg"
        )


def _choice(name: str, value: str, allowed: tuple[str, ...]) -> None:
    if value not in allowed:
        raise InputError(f"{name} is {value!r}; give one of {', '.join(allowed)}")


def _reach_bound(plant: Plant) -> float:
    """A radius that no tool position leaves, m: the sum of all lengths, plus 1 m for errors and camera noise."""
    g = plant.arm.nominal
    slides = np.array(g.prismatic) * np.maximum(np.abs(g.lower), np.abs(g.upper))
    lengths = np.abs(g.a).sum() + np.abs(g.d).sum() + slides.sum()
    return float(lengths + np.linalg.norm(g.base.position) + np.linalg.norm(g.tool.position) + 1.0)
