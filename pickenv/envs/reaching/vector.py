"""Native vector environments of the reach tasks, which `gym.make_vec` makes."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import deepcopy
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import IDEAL, Plant, chosen
from pickenv.base import InputError, is_there, register, require
from pickenv.base.registry import get, names
from pickenv.envs.reaching.batch import Batch, NumpyBatch, Views
from pickenv.envs.reaching.reach import GOAL_KEYS, check_ideal, draw_reach, rewards_of_goals
from pickenv.envs.shared.backends import Flags, Rows, fresh_seed, seed_word
from pickenv.envs.shared.difficulty import on_ladder
from pickenv.envs.shared.native_vector import NativeVectorEnv, set_spaces
from pickenv.envs.shared.simulation import NUMBER_KEYS
from pickenv.envs.shared.spaces import OPTIONS, action_space, flat_space, given_goals, goal_space
from pickenv.envs.shared.task import OF_TASKS, Task, check_choice, make_task, refuse_unknown
from pickenv.pictures.stage import Stage

STATE = {"seeds": "_seeds", "episodes": "_episodes", "elapsed": "_elapsed", "ended": "_over"}


class ReachVectorEnv(NativeVectorEnv):
    """N `pickenv/Reach-v0` in one vector environment.

    Environment i (from 0) returns the same numbers as a single `pickenv/Reach-v0` with the seed ``seed + i``, whatever
    N is. With ``executor="numpy"`` in both, the numbers are equal to the bit. Between executors, in float64, they agree
    within 1e-9.

    | `autoreset_mode`       | step after the end of an episode          | last observation of the episode             |
    |------------------------|-------------------------------------------|---------------------------------------------|
    | "NextStep" (default)   | ignores the action, begins the next one   | returned by the step that ended it          |
    | "SameStep"             | the step that ends it begins the next one | `infos["final_obs"]`, `infos["final_info"]` |
    | "Disabled"             | refused until `reset` has been called     | returned by the step that ended it          |

    `reset(options={"reset_mask": mask})` begins episodes where the mask is True; the other environments continue. The
    other options are the options of `pickenv/Reach-v0`. Each has one value for all environments or one value for each,
    for example ``(6,)`` or ``(N, 6)``. Infos are dicts of arrays with a mask ``_key`` for every key.

    Args:
        num_envs: N.
        max_episode_steps: Steps after which an episode is truncated, or None for never.
        autoreset_mode: An `AutoresetMode` or its name, see the table.
        executor: "numpy" runs on NumPy arrays. "compiled" does so too, with the step as machine code. Results agree up
            to rounding (1e-12), and compilation takes 0.1 s once (half a second from 1024 environments on). "auto"
            (default) is "compiled" if llvmlite of the extra `pickenv[compiled]` is installed, else "numpy". "torch"
            takes and returns tensors.
        compiled: torch only: whether the step is compiled (half a minute, once) or run eagerly.
        device: torch only: "cpu", "cuda", "cuda:1".
        dtype: torch only: "float64" or "float32" (with an accuracy of positions of 1 um).
        pose_infos: Whether infos hold `pose_error`, `joint_command`, `tool_position` and `fruit_position`. With a
            hundred thousand environments, writing them takes about a third of a step's time.
        render_mode: None or "rgb_array".
        arguments: Other arguments of `pickenv/Reach-v0`.

    Example:
        >>> import gymnasium as gym
        >>> import pickenv
        >>> envs = gym.make_vec("pickenv/Reach-v0", num_envs=3, autoreset_mode="SameStep")
        >>> observations, infos = envs.reset(seed=1)
        >>> observations.shape
        (3, 18)
        >>> observations, rewards, terminations, truncations, infos = envs.step(envs.action_space.sample())
        >>> infos["pose_error"].shape, infos["_pose_error"].tolist()
        ((3, 6), [True, True, True])

    Raises:
        InputError: If an argument has a value that is not allowed. The message names the argument.
    """

    options = OPTIONS
    goal_dict = False
    task_of: Callable[..., Task] = staticmethod(make_task)

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = 60,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        executor: str = "auto",
        compiled: bool = True,
        device: str = "cpu",
        dtype: str = "float64",
        pose_infos: bool = True,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        super().__init__(num_envs, max_episode_steps, autoreset_mode, render_mode)
        check_choice("executor", executor, ("auto", *names("backend")))
        refuse_unknown(self, arguments, on_ladder, self.task_of, *OF_TASKS)
        self.task: Task = self.task_of(**on_ladder("Reach", **arguments))
        self.metadata |= {"render_fps": self.task.situation.frames_per_second, "torch": executor == "torch"}
        set_spaces(self, goal_space(self.task) if self.goal_dict else flat_space(self.task), action_space(self.task))
        self._poses = bool(pose_infos)
        settings = {"device": device, "dtype": dtype, "compiled": compiled}
        make = get("backend", ("compiled" if is_there("llvmlite") else "numpy") if executor == "auto" else executor)
        self.batch: Batch = make(self.task, self.num_envs, self.goal_dict, pose_infos, settings)
        self._seeds = np.zeros(self.num_envs, dtype=np.uint64)
        self._episodes = np.zeros(self.num_envs, dtype=np.uint64)
        self._views: Views

    @property
    def plant(self) -> Plant:
        """The true arm that all environments share, or the true arms of a population, one per environment."""
        return self.batch.plant

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Return all arrays that the next step depends on, for a checkpoint.

        Some of the arrays are attributes of the environment; `STATE` has the attribute's name for each array's name in
        the checkpoint. This works for environments on NumPy with an autoreset mode other than "Disabled".
        """
        arrays = {key: getattr(self, name) for key, name in STATE.items()}
        arrays["seeded"] = np.full(self.num_envs, self._begun)
        return {key: np.array(value) for key, value in (arrays | self.batch.state_arrays()).items()}

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """Restore the arrays that `state_arrays` of an environment with the same arguments returned."""
        for key, name in STATE.items():
            setattr(self, name, state[key].copy())
        self._begun = bool(state["seeded"].all())
        self.batch.take_state_arrays(state)

    def _seed(self, row: int, seed: int | None) -> None:
        self._seeds[row] = seed_word(fresh_seed(self.np_random) if seed is None else seed)

    def _checked(self, actions: ArrayLike) -> Any:
        return self.batch.numbers_of_actions(actions)

    def _begin(self, rows: Rows, options: dict[str, Any], seeded: Flags) -> None:
        how = self._asked(options, rows)
        self._episodes[rows] = np.where(seeded[rows], np.uint64(0), self._episodes[rows] + np.uint64(1))
        self.batch.restart(rows, self._seeds[rows], self._episodes[rows], self.compensator, **how)
        views = self.batch.show(rows, self.compensator)
        self._views = views if len(rows) == self.num_envs else self.batch.merged(self._views, rows, views)

    def _asked(self, options: dict[str, Any], rows: Rows) -> dict[str, Any]:
        """Return the starts, goals and arms that ``options`` ask for, as keyword arguments of `Batch.restart`.

        Each has one entry per environment in ``rows``, which has indices from 0.
        """
        joints, frames = given_goals(self.task, options, self.num_envs)
        goals = {"goal": joints, "frames": frames}
        how: dict[str, Any] = {name: goal[rows] for name, goal in goals.items() if goal is not None}
        if options.get("start_joints") is not None:
            how["start"] = self.task.given_joints("start_joints", options["start_joints"], self.num_envs)[rows]
        if options.get("arm") is not None:
            arms = np.asarray(options["arm"])
            if arms.shape not in ((), (self.num_envs,)):
                raise InputError(f"option arm has shape {arms.shape}; give one number, or {self.num_envs}")
            numbers = np.broadcast_to(arms, (self.num_envs,))[rows].tolist()
            how["arm"] = np.array([self.task.given_arm(number) for number in numbers], dtype=np.intp)
        return how

    def _act(self, actions: Any, live: Flags) -> Any:
        self._views = self.batch.advance(actions, self._elapsed, self.compensator)
        rewards = self._views.reward
        return rewards if live.all() else chosen(self.batch.x.m, self.batch.flags(live), rewards, 0.0)

    def _finished(self) -> Flags:
        if not self.task.end_on_success:
            return np.zeros(self.num_envs, dtype=np.bool_)
        return self.batch.host(self._views.success)

    def _flags(self, flags: Flags) -> Any:
        return self.batch.flags(flags)

    def _observation(self) -> Any:
        views = self._views
        if self.autoreset_mode is AutoresetMode.DISABLED:  # a mask shows again what it leaves out, as it was
            self._views = deepcopy(views)
        parts = [part.T for part in views.observation]
        return dict(zip(GOAL_KEYS, parts, strict=True)) if self.goal_dict else parts[0]

    def _information(self) -> dict[str, Any]:
        n, views = self.task.joints, self._views
        infos: dict[str, Any] = dict(zip(NUMBER_KEYS, views.numbers, strict=True)) | {"is_success": views.success}
        cuts = (("pose_error", 0, 6), ("joint_command", 6, 6 + n), ("tool_position", 6 + n, 9 + n))
        for key, a, b in (*cuts, ("fruit_position", 9 + n, 12 + n)) if self._poses else ():
            infos[key] = views.vectors[a:b].T
        return infos

    def _stage(self, row: int) -> Stage:
        return draw_reach(self.task, self.batch.scene(row, self.compensator), dark=False)


Settings = Mapping[str, Any]


@register("backend", "compiled")
def _compiled(task: Task, count: int, goal_dict: bool, poses: bool, settings: Settings) -> Batch:
    """Make a `Batch` whose step is machine code, from the arguments of `Batch`; ``settings`` are not used.

    Raises:
        MissingExtra: If llvmlite is not installed.
    """
    require("llvmlite")
    from pickenv.envs.reaching.compiled_batch import CompiledBatch

    return CompiledBatch(task, count, goal_dict, poses)


@register("backend", "numpy")
def _numpy(task: Task, count: int, goal_dict: bool, poses: bool, settings: Settings) -> Batch:
    """Make a `Batch` whose step runs on NumPy arrays, from the arguments of `Batch`; ``settings`` are not used."""
    return NumpyBatch(task, count, goal_dict, poses)


@register("backend", "torch")
def _torch(task: Task, count: int, goal_dict: bool, poses: bool, settings: Settings) -> Batch:
    """Make a `Batch` whose step runs on torch tensors, from the arguments of `Batch` and the executor's settings.

    The settings are ``device``, ``dtype`` and ``compiled``; only torch uses them.

    Raises:
        MissingExtra: If torch is not installed.
    """
    require("torch")
    from pickenv.envs.reaching.torch_batch import TorchBatch

    return TorchBatch(task, count, goal_dict, poses, **settings)


class ReachGoalVectorEnv(ReachVectorEnv):
    """N `pickenv/ReachGoal-v0` in one vector environment; see `ReachVectorEnv`."""

    goal_dict = True

    def __init__(self, num_envs: int = 1, *, reward: str = "sparse", **arguments: Any) -> None:
        super().__init__(num_envs, reward=reward, **arguments)

    def compute_reward(self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any) -> Any:
        """Compute rewards from achieved and desired goals ``(N, 9)``, as in `pickenv/ReachGoal-v0`; ignore ``info``."""
        return rewards_of_goals(self.task, achieved_goal, desired_goal)


class ReachIdealVectorEnv(ReachVectorEnv):
    """N `pickenv/ReachIdeal-v0` in one vector environment; see `ReachVectorEnv`."""

    def __init__(self, num_envs: int = 1, **arguments: Any) -> None:
        super().__init__(num_envs, **{"plant": IDEAL, **arguments})
        check_ideal(self.task)
