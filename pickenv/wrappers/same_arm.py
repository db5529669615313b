"""Wrappers in which a policy picks many fruit with one unknown arm, and so can learn to calibrate it.

An episode is a run of picks on one true arm; the next episode may have another arm. In `ManyCanopies` a run consists of
whole canopies. In `SameArm` an action is a whole pick. Before each pick the policy chooses how far beside the fruit to
aim. The arm gets the joints that bring the nominal arm to that aim, and stays there. The camera measures the difference
between the tool's true and believed positions. Only these measurements at past picks distinguish one arm from another.
Units: m and rad.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, SupportsFloat

import gymnasium as gym
import numpy as np
from gymnasium import spaces
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper
from numpy.typing import NDArray

from pickenv.arm import Array, Geometry, joint_jacobian, truncated_inverse
from pickenv.base import InputError
from pickenv.base.container import part_of
from pickenv.envs.picking.pick import PickEnv
from pickenv.envs.picking.pick_scene import given_hours, pick_reward
from pickenv.envs.shared.arm_env import Options
from pickenv.envs.shared.backends import GOAL, NUMPY, episode_key, fresh_seed, seed_word, stream_key
from pickenv.envs.shared.native_vector import Seeds, checked_seeds, final_rows, set_spaces
from pickenv.envs.shared.simulation import NUMBER_KEYS, gap_reward, goal_attempt
from pickenv.envs.shared.spaces import flat_space, given_options
from pickenv.envs.shared.task import GOAL_ATTEMPTS, Task, as_numbers, check_choice, check_count, check_number

SEEN_MM = 5.0
"""Unit of the arm's errors in observations, mm."""

MOST_SEEN = 20.0
"""Bound of errors in observations, in units of `SEEN_MM`; larger errors are clipped."""

SAME_ARM_REWARDS = ("measured", "true")


@dataclass(frozen=True)
class PickMemory:
    """The layout of an observation before a pick: the joints at the fruit, and the arm's errors at past picks.

    Attributes:
        joints: Number of joints n.
        window: Number of past picks in an observation.
        reach_mm: Largest shift of an aim per axis, mm.
    """

    joints: int
    window: int = 1
    reach_mm: float = 8.0

    @property
    def token(self) -> int:
        """Number of values for one past pick, n + 4: n joints, 3 errors, and a flag that the pick took place."""
        return self.joints + 4

    @property
    def inputs(self) -> int:
        """Number of values in the observation, n + window (n + 4)."""
        return self.joints + self.window * self.token

    def space(self) -> spaces.Box:
        """Return the space of the observations."""
        ones = [1.0] * self.joints
        high = np.array(ones + [*ones, *[MOST_SEEN] * 3, 1.0] * self.window, dtype=np.float32)
        return spaces.Box(-high, high, dtype=np.float32)

    def empty(self, rows: int) -> NDArray[np.float32]:
        """Return the values for past picks (tokens) of ``rows`` arms before the first pick.

        They are zeros of the shape ``(rows, window, token)``.
        """
        return np.zeros((rows, self.window, self.token), dtype=np.float32)

    def after(self, tokens: NDArray[np.float32], joints: Array, error: Array) -> NDArray[np.float32]:
        """Return the tokens (values for past picks) with a new pick as the first, and without the oldest pick.

        Args:
            tokens: Tokens of N arms before the pick ``(N, window, token)``, newest first.
            joints: Joints of the pick ``(N, n)``, scaled from their limits to -1 to 1.
            error: True minus believed tool position at the pick ``(N, 3)``, m.
        """
        errors = (error / (SEEN_MM * 1e-3)).clip(-MOST_SEEN, MOST_SEEN)
        new = np.concatenate([joints, errors, np.ones((len(joints), 1))], axis=1)[:, None].astype(np.float32)
        return np.concatenate([new, tokens[:, :-1]], axis=1)

    def shown(self, joints: Array, tokens: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return observations ``(N, inputs)`` of N arms before a pick.

        Args:
            joints: Joints of the nominal arm at the next fruit ``(N, n)``, scaled from their limits to -1 to 1.
            tokens: Values for past picks ``(N, window, token)``, newest first.
        """
        return np.concatenate([joints, tokens.reshape(len(tokens), -1)], axis=1, dtype=np.float32)

    def aim(self, geometry: Geometry, joints: Array, actions: Any) -> Array:
        """Compute the joints ``(N, n)`` with which the nominal arm aims beside the fruit.

        Args:
            geometry: The nominal arm.
            joints: Joints of the nominal arm at the fruit ``(N, n)``, rad or m.
            actions: Shifts of the aim ``(N, 3)``, base frame, as shares of `reach_mm`.
        """
        shift = np.clip(actions, -1.0, 1.0) * (self.reach_mm * 1e-3)
        back = truncated_inverse(joint_jacobian(geometry, joints))[..., :3]
        return np.asarray((joints + np.einsum("...ij,...j->...i", back, shift)).clip(geometry.lower, geometry.upper))


def scaled_joints(geometry: Geometry, joints: Array) -> Array:
    """Scale joints ``(..., n)``, rad or m, linearly, so that the limits become -1 and 1."""
    low, high = geometry.lower, geometry.upper
    return np.asarray(2.0 * (joints - low) / (high - low) - 1.0)


class _Run:
    """The present runs of several arms. Arrays have one row per arm.

    Each arm has a seed. The seed and the number of poses drawn with it so far determine the arm's next pose.

    Attributes:
        LONGEST_LOOK: Largest number of steps that the arm may stay at a fruit, since the environment's own time limit
            is 60.
    """

    LONGEST_LOOK = 59

    def __init__(
        self, task: Task, rows: int, *, picks: int, window: int, looks: int, reach_mm: float, reward: str
    ) -> None:
        check_choice("reward", reward, SAME_ARM_REWARDS)
        for name, count in {"picks": picks, "window": window, "looks": looks}.items():
            check_count(name, count)
        check_number("reach_mm", reach_mm, positive=True)
        if looks > self.LONGEST_LOOK:
            raise InputError(f"looks is {looks}; give at most {self.LONGEST_LOOK}")
        if not task.camera or task.end_on_success:
            raise InputError("SameArm needs a camera and whole episodes; give feedback='camera', end_on_success=False")
        memory = PickMemory(task.joints, window, reach_mm)
        self.task, self.geometry, self.memory = task, task.plant.arm.nominal, memory
        self.picks, self.looks, self.measured = int(picks), int(looks), reward == SAME_ARM_REWARDS[0]
        self.seeds = np.zeros(rows, dtype=np.uint64)
        self.count = np.zeros(rows, dtype=np.uint64)  # poses drawn so far
        self.pick = 0
        self.tokens = memory.empty(rows)
        self.joints: Array = np.zeros((rows, task.joints))

    def begin(self) -> None:
        """Begin new runs: forget the picks of the arms before, and draw the poses of the first fruit."""
        self.pick, self.tokens = 0, self.memory.empty(len(self.seeds))
        self.draw()

    def draw(self) -> None:
        """Draw the pose of each arm's next fruit, with the joints at the fruit, as the environment itself would.

        It is the first pose in the arm's random stream that the task accepts as a goal.
        """
        streams = stream_key(NUMPY, episode_key(NUMPY, self.seeds, self.count), GOAL)
        self.count = self.count + np.uint64(1)
        rows = np.arange(len(streams))
        for attempt in range(GOAL_ATTEMPTS):
            tried, fits = goal_attempt(NUMPY, self.task, streams[rows], attempt)
            self.joints[rows] = np.stack(tried, axis=1)
            rows = rows[~fits]
            if not len(rows):
                return
        raise self.task.no_goal()

    @property
    def scaled(self) -> Array:
        """The joints of the nominal arm at the present fruit ``(rows, n)``, scaled from their limits to -1 to 1."""
        return scaled_joints(self.geometry, self.joints)

    def shown(self) -> NDArray[np.float32]:
        """Return the observations ``(rows, inputs)`` before the pick of the present fruit."""
        return self.memory.shown(self.scaled, self.tokens)

    def options(self, actions: Any, arms: Any) -> dict[str, Any]:
        """Return options for a reset that puts each arm at its aim, with the present fruit as goal.

        ``actions`` are shifts of the aims ``(rows, 3)``, base frame, as shares of ``reach_mm``. ``arms`` are the
        indices of the arms in the population, from 0.
        """
        shifts = as_numbers("actions", actions)
        if shifts.shape != (len(self.joints), 3) or not np.isfinite(shifts).all():
            raise InputError(f"actions have shape {shifts.shape}; give {len(self.joints)} times 3 finite numbers")
        options = {"start_joints": self.memory.aim(self.geometry, self.joints, shifts), "goal_joints": self.joints}
        return options if self.task.arms == "fixed" else options | {"arm": arms}

    def seed(self, seeds: Sequence[int | None], generator: np.random.Generator) -> None:
        """Begin the random stream of poses of each arm that gets a seed or has not drawn a pose yet.

        ``seeds`` has one seed per arm; for None, an arm without a pose gets a seed that ``generator`` draws.
        """
        for i, seed in enumerate(seeds):
            if seed is not None or not self.count[i]:
                self.seeds[i] = seed_word(fresh_seed(generator) if seed is None else int(seed))
                self.count[i] = 0

    def stand(self, env: Any, still: Array) -> tuple[Any, Any]:
        """Keep the arms in place for ``looks`` steps, store the tools' measured errors, and draw the next fruit.

        ``env`` is the wrapped environment, and ``still`` its action that moves no joint.

        Returns:
            The rewards (from the camera's mean measurement or from the true tool), and the infos of the last step.
        """
        n, error, gap = self.task.joints, *np.zeros((2, len(self.joints), 3))
        for _ in range(self.looks):
            observation, rewards, _, _, infos = env.step(still)
            values = np.atleast_2d(observation).astype(float)
            gap += values[:, n + 12 :]
            error += values[:, n + 6 : n + 9] - values[:, n + 12 :]
        if self.measured:
            measured = gap_reward(NUMPY, self.task, list(gap.T / self.looks), list(values[:, n + 9 : n + 12].T))
            rewards = measured.reshape(np.shape(rewards))
        self.tokens = self.memory.after(self.tokens, self.scaled, error / self.looks)
        self.pick += 1
        self.draw()
        return rewards, infos


class SameArmVector(VectorWrapper[Any, Any, Any, Any, Any], RecordConstructorArgs):
    """`SameArm` for native vector environments. All arms pick at once, and the step that ends the runs begins new runs.

    Example:
        >>> import gymnasium as gym
        >>> import pickenv
        >>> from pickenv.wrappers import SameArmVector
        >>> envs = gym.make_vec("pickenv/Reach-v0", num_envs=4, feedback="camera", arms="per_episode")
        >>> envs = SameArmVector(envs, picks=10)
        >>> envs.reset(seed=0)[0].shape
        (4, 16)

    Change log:
     * v0.3.0 - Added.
    """

    def __init__(
        self, env: VectorEnv[Any, Any, Any], picks: int = 20, window: int = 1, looks: int = 10, reach_mm: float = 8.0,
        reward: str = "measured",
    ) -> None:  # fmt: skip
        """Wrap ``env``; `SameArm` explains the arguments.

        Raises:
            InputError: If ``env`` is no native reach environment on NumPy with a camera, or an argument is one that
                `SameArm` refuses.
        """
        how: dict[str, Any] = {"picks": picks, "window": window, "looks": looks, "reach_mm": reach_mm, "reward": reward}
        RecordConstructorArgs.__init__(self, **how)
        VectorWrapper.__init__(self, env)
        inner: Any = env.unwrapped
        native = hasattr(inner, "batch") and not env.metadata.get("torch")
        if not native or env.single_observation_space.shape != flat_space(inner.task).shape:
            raise InputError("SameArmVector works on native pickenv/Reach-v0 environments; make them with make_vec")
        self.run, self._inner, most = _Run(inner.task, self.num_envs, **how), inner, inner.max_episode_steps
        if most is not None and looks >= most:
            raise InputError(f"looks is {looks}, but episodes end after {most} steps; give a larger max_episode_steps")
        self.metadata = {**env.metadata, "autoreset_mode": AutoresetMode.SAME_STEP}
        set_spaces(self, self.run.memory.space(), spaces.Box(-1.0, 1.0, (3,), np.float32))
        self._still = np.zeros_like(self.run.joints)
        self._arms: NDArray[np.intp] = np.zeros(self.num_envs, dtype=np.intp)

    def reset(self, *, seed: Seeds = None, options: Options = None) -> tuple[Any, dict[str, Any]]:
        """Begin runs on newly drawn arms, or on the arms whose numbers (from 0) are in ``options["arm"]``."""
        options = given_options(options, ("arm",))
        self.run.seed(checked_seeds(seed, self.num_envs), self._inner.np_random)
        _, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        self._begin()
        return self.run.shown(), self._infos(infos)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Pick one fruit on every arm.

        Each row of ``actions`` ``(N, 3)`` is the offset of one arm's aim from its fruit, as in `SameArm`.
        """
        self.env.reset(options=self.run.options(actions, self._arms))
        rewards, infos = self.run.stand(self.env, self._still)
        done = np.full(self.num_envs, self.run.pick >= self.run.picks)
        observations, infos = self.run.shown(), self._infos(infos)
        if done.all():
            rows = np.arange(self.num_envs)
            final = {"final_obs": final_rows(observations, rows, self.num_envs), "_final_obs": done.copy()}
            final |= {"final_info": infos, "_final_info": done.copy()}
            _, begun = self.env.reset(options={"goal_joints": self.run.joints})  # saves drawing poses that nobody uses
            self._begin()
            observations, infos = self.run.shown(), self._infos(begun) | final
        return observations, rewards, np.zeros_like(done), done, infos

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Return all arrays that the next step depends on, for a checkpoint."""
        run = self.run
        parts = {"seeds": run.seeds, "count": run.count, "tokens": run.tokens, "joints": run.joints, "arms": self._arms}
        arrays = {f"run/{key}": np.array(value) for key, value in (parts | {"pick": run.pick}).items()}
        return {**arrays, **self._inner.state_arrays()}

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore the arrays that `state_arrays` of environments with the same arguments returned."""
        run, parts = self.run, {key: value.copy() for key, value in part_of(state, "run/").items()}
        run.seeds, run.count, run.tokens, run.joints = (parts[key] for key in ("seeds", "count", "tokens", "joints"))
        run.pick, self._arms = int(parts["pick"]), parts["arms"]
        self._inner.take_state_arrays(state)

    def _begin(self) -> None:
        self._arms = self._inner.batch.arm.copy()
        self.run.begin()

    def _infos(self, infos: dict[str, Any]) -> dict[str, Any]:
        everywhere = np.ones(self.num_envs, dtype=np.bool_)
        columns = {key: np.array(infos[key]) for key in (*NUMBER_KEYS, "is_success")}
        columns |= {"pick": np.full(self.num_envs, self.run.pick), "arm": self._arms.copy()}
        return columns | {f"_{key}": everywhere for key in columns}


class SameArmMixture(VectorEnv[Any, Any, Any]):
    """Several `SameArmVector` joined into one vector environment, for learning on arms of several plants.

    Each environment gives the same results as in its own `SameArmVector` with the same seed. All runs have the same
    length, so they all end in the same step.

    Change log:
     * v0.3.0 - Added.

    Attributes:
        parts: The joined vector environments, in the order of their environments.
        task: The task of the first part; all parts have the same nominal arm.
        run: State of the present runs of the arms in the first part.
    """

    def __init__(self, parts: Sequence[SameArmVector]) -> None:
        """Join ``parts``.

        Raises:
            InputError: If there are no parts, or their nominal arms or the arguments of their runs differ.
        """
        arms = [part.run.task.plant.arm for part in parts]
        runs = {(part.run.picks, part.run.looks, part.run.measured, part.run.memory) for part in parts}
        if len({arm.fingerprint() for arm in arms}) != 1 or len(runs) != 1:
            names = ", ".join(arm.name for arm in arms) or "none"
            raise InputError(f"a mixture needs plants of one nominal arm, and runs alike; these are of {names}")
        first, self.parts = parts[0], tuple(parts)
        self.task, self.run, self.metadata = first.run.task, first.run, first.metadata
        self.num_envs = sum(part.num_envs for part in parts)
        set_spaces(self, first.single_observation_space, first.single_action_space)
        self._ends = np.cumsum([part.num_envs for part in parts])[:-1]

    def reset(self, *, seed: Seeds = None, options: Options = None) -> tuple[Any, dict[str, Any]]:
        """Begin runs on newly drawn arms; ``options`` must be empty."""
        given_options(options, ())
        shares = np.split(np.array(checked_seeds(seed, self.num_envs), dtype=object), self._ends)
        done = [part.reset(seed=share.tolist()) for part, share in zip(self.parts, shares, strict=True)]
        observations, infos = zip(*done, strict=True)
        return np.concatenate(observations), _joined(infos)

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Pick one fruit on every arm.

        Each row of ``actions`` ``(N, 3)`` is the offset of one arm's aim from its fruit, as in `SameArm`.
        """
        shares = np.split(as_numbers("actions", actions), self._ends)
        *columns, infos = zip(*(part.step(share) for part, share in zip(self.parts, shares, strict=True)), strict=True)
        observations, rewards, ended, cut = (np.concatenate(column) for column in columns)
        return observations, rewards, ended, cut, _joined(infos)

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Return all arrays that the next step depends on, for a checkpoint."""
        return {f"{k}/{key}": value for k, part in enumerate(self.parts) for key, value in part.state_arrays().items()}

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore the arrays that `state_arrays` of a mixture of the same parts returned."""
        for k, part in enumerate(self.parts):
            part.take_state_arrays(part_of(state, f"{k}/"))


def _joined(infos: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Join the infos of several vector environments into the infos of one vector environment."""
    columns = {key: [each[key] for each in infos] for key in infos[0]}
    return {key: (_joined if key == "final_info" else np.concatenate)(column) for key, column in columns.items()}


class SameArm(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Pick fruit after fruit with one unknown arm, one action per fruit: a task of calibrating while picking.

    An episode is a run of ``picks`` fruit of `pickenv/Reach-v0` on one true arm. The policy gets the nominal arm's
    joints at each fruit. The action is the shift of the aim beside the fruit, x, y, z in the base frame, as shares of
    ``reach_mm``. The arm is put at that aim and stays there for ``looks`` steps, and the camera's measurements are
    averaged. With n joints the observation is `Box(float32)` of n + window (n + 4) numbers:

    | Num       | Observation                                                        | Min | Max | Unit |
    |-----------|--------------------------------------------------------------------|-----|-----|------|
    | 0 to n-1  | joints of the nominal arm at the fruit, scaled to the limits       | -1  | 1   | 1    |
    | then n    | joints at the last pick; the past picks follow, newest first       | -1  | 1   | 1    |
    | then 3    | true minus believed tool position at that pick, camera's measure   | -20 | 20  | 5 mm |
    | then 1    | whether there was such a pick                                      | 0   | 1   | 1    |

    The reward of a pick is the reward of `pickenv/Reach-v0` for the gap between tool and fruit that the camera
    measured, averaged over the steps. A real arm could measure it, so a policy may observe it. With `reward="true"` the
    reward is computed from the tool's true pose. This reward has no noise. A policy that observed it could locate the
    fruit with a few probing aims, so use it for training only. A run is truncated after its last pick. `info` has the
    errors of `pickenv/Reach-v0`, the number of picks so far as `pick`, and the arm's number (from 0) as `arm`. Every
    run has the same arm unless the environment is made with `arms="per_episode"`. `reset(options={"arm": number})`
    chooses an arm.

    Example:
        >>> import gymnasium as gym
        >>> import pickenv
        >>> from pickenv.wrappers import SameArm
        >>> env = SameArm(gym.make("pickenv/Reach-v0", feedback="camera", arms="per_episode"), picks=10)
        >>> observation, info = env.reset(seed=0)
        >>> observation.shape, env.action_space.shape
        ((16,), (3,))

    Change log:
     * v0.3.0 - Added.
    """

    def __init__(
        self, env: gym.Env[Any, Any], picks: int = 20, window: int = 1, looks: int = 10, reach_mm: float = 8.0,
        reward: str = "measured",
    ) -> None:  # fmt: skip
        """Wrap ``env``.

        Args:
            env: A `pickenv/Reach-v0` with a camera.
            picks: Number of fruit in a run.
            window: Number of past picks in the observation; a recurrent policy needs only one.
            looks: Number of steps that the arm stays at each fruit.
            reach_mm: Largest shift of an aim per axis, mm.
            reward: "measured", from the gap that the camera measured, or "true", for training in simulation only.

        Raises:
            InputError: If ``env`` is no flat `pickenv/Reach-v0` with a camera, or ends on success. If a count is below
                1, ``looks`` is above 59, ``reach_mm`` is not above 0, or ``reward`` is unknown.
        """
        how: dict[str, Any] = {"picks": picks, "window": window, "looks": looks, "reach_mm": reach_mm, "reward": reward}
        RecordConstructorArgs.__init__(self, **how)
        gym.Wrapper.__init__(self, env)
        self._inner: Any = env.unwrapped
        task: Any = getattr(self._inner, "task", None)
        single = isinstance(task, Task) and hasattr(self._inner, "arm")
        if not single or env.observation_space.shape != flat_space(task).shape:
            raise InputError("SameArm works on flat reach environments; wrap a pickenv/Reach-v0 environment")
        self.run = _Run(task, 1, **how)
        self.observation_space = self.run.memory.space()
        self.action_space = spaces.Box(-1.0, 1.0, (3,), np.float32)
        self._arm = 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin a run on a newly drawn arm, or on the arm with the number ``options["arm"]``, from 0."""
        options = given_options(options, ("arm",))
        _, info = self.env.reset(seed=seed, options=options)
        self.run.seed([seed], self._inner.np_random)
        self._arm = self._inner.arm
        self.run.begin()
        return self.run.shown()[0], self._info(info)

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Pick one fruit.

        The ``action`` ``(3,)`` is the offset of the aim from the fruit, in the unit and frame that the class states.
        """
        options = self.run.options(as_numbers("action", action)[None], self._arm)
        options = {key: value[0] if key != "arm" else value for key, value in options.items()}
        self.env.reset(options=options)
        reward, info = self.run.stand(self.env, np.zeros(self.run.task.joints))
        return self.run.shown()[0], float(reward), False, self.run.pick >= self.run.picks, self._info(info)

    def _info(self, info: dict[str, Any]) -> dict[str, Any]:
        return {key: info[key] for key in (*NUMBER_KEYS, "is_success")} | {"pick": self.run.pick, "arm": self._arm}


class ManyCanopies(gym.Wrapper[Any, Any, Any, Any], RecordConstructorArgs):
    """Pick canopy after canopy with one unknown arm in the course of a day: a task of calibrating while picking.

    An episode is a run of ``canopies`` episodes of `pickenv/Pick-v0` on one true arm. The arm warms up and sinks into
    the ground from canopy to canopy. Its hours since switch-on increase linearly from the first to the last of
    ``hours``. Observations and actions are as in the environment. With `feedback="gripper"` the policy observes, at
    each fruit in the gripper, the error of arm and camera. The step that ends a canopy returns the first observation of
    the next one. The run is truncated after the last canopy.

    The reward of a step is 1 for each collected fruit, minus 0.002. A real arm could measure this reward, so a policy
    may observe it. With `reward="true"` the reward is the reward of `pickenv/Pick-v0`, which includes damage. `info`
    has four more entries than the environment's: `canopy` (number of finished canopies), `arm` (the arm's number, from
    0), and `run_attempted` and `run_collected` (counts of fruit in the run so far).

    Example:
        >>> import gymnasium as gym
        >>> import pickenv
        >>> from pickenv.wrappers import ManyCanopies
        >>> env = ManyCanopies(gym.make("pickenv/Pick-v0", difficulty="own_eyes", feedback="gripper"), canopies=10)
        >>> observation, info = env.reset(seed=0)
        >>> observation.shape, info["canopy"]
        ((26,), 0)

    Change log:
     * v0.3.0 - Added.
    """

    def __init__(
        self, env: gym.Env[Any, Any], canopies: int = 20, hours: Sequence[float] = (0.0, 8.0), reward: str = "measured"
    ) -> None:
        """Wrap ``env``.

        Args:
            env: A `pickenv/Pick-v0`. Make it with `arms="per_episode"` or with a `difficulty` that has a population of
                arms, else every run has the same arm.
            canopies: Number of canopies in a run.
            hours: Hours for which the arm has been switched on at the first and at the last canopy.
            reward: "measured", which a real arm could measure, or "true", for training in simulation only.

        Raises:
            InputError: If ``env`` is no `pickenv/Pick-v0`, ``canopies`` is below 1, ``hours`` are not two numbers from
                0 to 1000, or ``reward`` is unknown.
        """
        RecordConstructorArgs.__init__(self, canopies=canopies, hours=hours, reward=reward)
        gym.Wrapper.__init__(self, env)
        if not isinstance(env.unwrapped, PickEnv):
            raise InputError("ManyCanopies works on picking environments; wrap a pickenv/Pick-v0 environment")
        check_choice("reward", reward, SAME_ARM_REWARDS)
        check_count("canopies", canopies)
        first, last = given_hours(hours, 2)
        self.canopies, self.hours = int(canopies), np.linspace(first, last, int(canopies))
        self.measured, self._inner = reward == SAME_ARM_REWARDS[0], env.unwrapped
        self._done = np.zeros(2, dtype=np.int64)
        self._canopy, self._binned = 0, 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begin a run on a newly drawn arm, or on the arm with the number ``options["arm"]``, from 0."""
        options = given_options(options, ("arm",))
        self._canopy, self._done[:] = 0, 0
        return self._begin(seed, options)

    def step(self, action: Any) -> tuple[Any, SupportsFloat, bool, bool, dict[str, Any]]:
        """Act for one period; if that ends a canopy, begin the next one."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self.measured:
            before, self._binned = self._binned, int(self._inner.scene.collected.sum())
            reward = pick_reward(self._binned - before, 0)
        if not (terminated or truncated):
            return observation, reward, False, False, self._info(info)
        self._canopy += 1
        if self._canopy == self.canopies:
            return observation, reward, False, True, self._info(info)
        self._done += [info["attempted"], info["collected"]]
        observation, info = self._begin(None, {} if self._inner.task.arms == "fixed" else {"arm": self._inner.arm})
        return observation, reward, False, False, info

    def _begin(self, seed: int | None, options: dict[str, Any]) -> tuple[Any, dict[str, Any]]:
        observation, info = self.env.reset(seed=seed, options=options | {"hours": self.hours[self._canopy]})
        self._binned = 0
        return observation, self._info(info)

    def _info(self, info: dict[str, Any]) -> dict[str, Any]:
        attempted, collected = self._done + np.array([info["attempted"], info["collected"]])
        run = {"run_attempted": int(attempted), "run_collected": int(collected)}
        return info | {"canopy": self._canopy, "arm": self._inner.arm} | run
