"""Native vector environments of the reach tasks: `gym.make_vec` makes them, for any number of environments at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Plant
from pickenv.arm.plant.plant_file import IDEAL
from pickenv.base import InputError, is_there, register, require
from pickenv.base.registry import get, names
from pickenv.envs.reaching.batch import Batch, NumpyBatch, Start, Views
from pickenv.envs.reaching.reach_goal import GOAL_KEYS, rewards_of_goals
from pickenv.envs.shared import spaces
from pickenv.envs.shared.arm_batch import Flags
from pickenv.envs.shared.arm_env import checked_render_mode, drawn
from pickenv.envs.shared.difficulty import on_ladder
from pickenv.envs.shared.given_goals import given_goals
from pickenv.envs.shared.simulation import NUMBER_KEYS
from pickenv.envs.shared.spaces import PlainSpec
from pickenv.envs.shared.streams import fresh_seed, seed_word
from pickenv.envs.shared.task import Compensate, Task, check_choice, check_count, make_task

AUTO = ("numpy", "compiled")
"""What "auto" takes where llvmlite is missing, and where it is there."""

STATE = ("seeds", "episodes", "elapsed", "seeded", "ended")


class ReachVectorEnv(PlainSpec, VectorEnv[Any, Any, Any]):
    """N environments `pickenv/Reach-v0` in one.

    Environment i is the same, number by number, as a single `pickenv/Reach-v0` with seed ``seed + i``, whatever N is:
    to the bit with ``executor="numpy"`` in both, within 1e-9 between executors in float64.

    | `autoreset_mode`       | step after the end of an episode          | last observation of the episode             |
    |------------------------|-------------------------------------------|---------------------------------------------|
    | "NextStep" (default)   | ignores the action, begins the next one   | returned by the step that ended it          |
    | "SameStep"             | the step that ends it begins the next one | `infos["final_obs"]`, `infos["final_info"]` |
    | "Disabled"             | refused until `reset` has been called     | returned by the step that ended it          |

    `reset(options={"reset_mask": mask})` begins episodes where the mask is True and leaves the others alone;
    the other options are as in `pickenv/Reach-v0`, given once for all environments or once for each, as ``(6,)`` or
    ``(N, 6)``. Infos are dicts of arrays with a mask ``_key`` for every key.

    Args:
        num_envs: N.
        difficulty: A rung of the ladder, as in `pickenv/Reach-v0`.
        split: Its arms to learn on, or to be judged on.
        max_episode_steps: Steps after which an episode is truncated, or None for never.
        autoreset_mode: An `AutoresetMode` or its name, see the table.
        executor: "numpy"; "compiled", the same on arrays with the step as machine code (0.1 s, once; half a second from
            1024 environments on), up to roundings (1e-12); "auto" (default): compiled where llvmlite is installed, of
            the extra `pickenv[compiled]`; or "torch" for tensors in and out.
        compiled: torch only: whether the step is compiled (half a minute, once) or run eagerly.
        device: torch only: "cpu", "cuda", "cuda:1".
        dtype: torch only: "float64" or "float32" (positions then hold to 1 um).
        pose_infos: Whether infos hold `pose_error`, `joint_command`, `tool_position` and `fruit_position`: at a hundred
            thousand environments writing them down takes as long as a third of the step.
        render_mode: None or "rgb_array".
        arguments: Those of `pickenv/Reach-v0`.

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
        InputError: If an argument is impossible.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012
        "render_modes": ["rgb_array"],
        "autoreset_mode": AutoresetMode.NEXT_STEP,
    }
    goal_dict = False

    def __init__(
        self,
        num_envs: int = 1,
        *,
        difficulty: str | None = None,
        split: str = "train",
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
        check_count("num_envs", num_envs)
        if max_episode_steps is not None:
            check_count("max_episode_steps", max_episode_steps)
        mode = str(getattr(autoreset_mode, "value", autoreset_mode))
        check_choice("autoreset_mode", mode, tuple(mode.value for mode in AutoresetMode))
        check_choice("executor", executor, ("auto", *names("backend")))
        checked_render_mode(render_mode, ("rgb_array",))
        self.task: Task = make_task(**on_ladder("Reach", difficulty, split, arguments))
        self.num_envs, self.max_episode_steps, self.render_mode = int(num_envs), max_episode_steps, render_mode
        self.autoreset_mode = AutoresetMode(mode)
        self.metadata = {**type(self).metadata, "render_fps": self.task.situation.frames_per_second}
        self.metadata |= {"autoreset_mode": self.autoreset_mode, "torch": executor == "torch"}
        self.single_observation_space = spaces.goal_space(self.task) if self.goal_dict else spaces.flat_space(self.task)
        self.single_action_space = spaces.action_space(self.task)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self._poses = bool(pose_infos)
        self.compensator: Compensate | None = None
        settings = {"device": device, "dtype": dtype, "compiled": compiled}
        make = get("backend", AUTO[is_there("llvmlite")] if executor == "auto" else executor)
        self.batch: Batch = make(self.task, self.num_envs, self.goal_dict, pose_infos, settings)
        self._seeds = np.zeros(self.num_envs, dtype=np.uint64)
        self._episodes = np.zeros(self.num_envs, dtype=np.uint64)
        self._elapsed = np.zeros(self.num_envs, dtype=np.uint64)
        self._seeded = np.zeros(self.num_envs, dtype=np.bool_)
        self._ended = np.zeros(self.num_envs, dtype=np.bool_)
        self._last: Views | None = None

    @property
    def plant(self) -> Plant:
        """The true arm, or arms."""
        return self.batch.plant

    @property
    def increment(self) -> Array:
        """Largest increment of each joint in one action, rad or m."""
        return np.array(self.task.increment)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin episodes in all environments, or in those of `options["reset_mask"]`; see the class.

        Args:
            seed: Environment i gets ``seed + i``, or entry i of a sequence; None goes on with its stream.
            options: See the class.
        """
        super().reset(seed=int(seed) if isinstance(seed, int | np.integer) else None)
        options = spaces.given_options(options, (*spaces.OPTIONS, "reset_mask"))
        mask = spaces.given_mask(options.pop("reset_mask", None), self.num_envs)
        self._take_seeds(seed, mask)
        rows = np.flatnonzero(mask)
        self._begin(rows, self._chosen(options, rows))
        shown = self.batch.show(rows, self.compensator)
        if len(rows) == self.num_envs:
            out = shown
        else:
            if self._last is None:
                raise InputError("reset_mask leaves out environments that were never reset; reset all of them first")
            out = self.batch.merged(self._last, rows, shown)
        self._last = self.batch.copied(out) if self.autoreset_mode is AutoresetMode.DISABLED else None
        return self._observations(out), self._infos(out, mask)

    def step(self, actions: ArrayLike) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Act in all environments.

        Raises:
            InputError: If actions have another shape or impossible numbers, or an ended episode was not reset.
        """
        if not self._seeded.all():
            raise InputError("step was called before reset; call reset first")
        numbers = self.batch.numbers_of_actions(actions)
        mode = self.autoreset_mode
        live: Flags | None = None  # where time passes; None: everywhere
        if self._ended.any():
            live = ~self._ended
            if mode is not AutoresetMode.NEXT_STEP:
                first = int(np.argmax(self._ended))
                raise InputError(f"environment {first} has ended its episode; call reset with a reset_mask first")
            self._episodes[self._ended] += np.uint64(1)
            self._begin(np.flatnonzero(self._ended), {})
            self._elapsed += live
        else:
            self._elapsed += np.uint64(1)
        out = self.batch.advance(numbers, self._elapsed, live, self.compensator)
        rewards = out.reward
        truncations, terminations = (np.zeros(self.num_envs, dtype=np.bool_) for _ in range(2))
        if self.max_episode_steps is not None:
            truncations = self._elapsed >= self.max_episode_steps
        if self.task.end_on_success:
            terminations = self.batch.host(out.success)
        if live is not None:
            truncations, terminations = truncations & live, terminations & live
        ended = terminations | truncations
        final: dict[str, Any] = {}
        if mode is AutoresetMode.SAME_STEP and ended.any():
            rows = np.flatnonzero(ended)
            final = self._final(out, rows, ended)
            self._episodes[rows] += np.uint64(1)
            self._begin(rows, {})
            out = self.batch.merged(out, rows, self.batch.show(rows, self.compensator))
        else:
            self._ended = ended
        if mode is AutoresetMode.DISABLED:
            self._last = self.batch.copied(out)
        infos = final | self._infos(out, np.ones(self.num_envs, dtype=np.bool_))
        flags = (self.batch.flags(flag) for flag in (terminations, truncations))
        return self._observations(out), rewards, *flags, infos

    def render(self) -> tuple[NDArray[np.uint8], ...] | None:
        """One picture per environment, as in `pickenv/Reach-v0`."""
        if self.render_mode is None:
            return None
        from pickenv.envs.reaching.reach import draw_reach

        if not self._seeded.all():
            raise InputError("render was called before reset; call reset first")
        pictures = []
        for i in range(self.num_envs):
            scene = self.batch.scene(i, self.compensator)
            pictures.append(drawn(draw_reach(self.task.plant.arm.nominal, scene, self.task.tolerance_mm, dark=False)))
        return tuple(pictures)

    def state_arrays(self) -> dict[str, NDArray[Any]]:
        """Everything that the next step depends on, for a checkpoint; on NumPy and not in mode "Disabled"."""
        own: dict[str, NDArray[Any]] = {key: getattr(self, f"_{key}") for key in STATE}
        return {key: np.array(value) for key, value in (own | self.batch.state_arrays()).items()}

    def take_state_arrays(self, state: dict[str, NDArray[Any]]) -> None:
        """The inverse of `state_arrays`, in an environment made with the same arguments."""
        for key in STATE:
            setattr(self, f"_{key}", state[key].copy())
        self.batch.take_state_arrays(state)

    def _begin(self, rows: NDArray[np.intp], chosen: dict[str, Any]) -> None:
        self._elapsed[rows], self._ended[rows] = 0, False
        self.batch.restart(rows, Start(self._seeds[rows], self._episodes[rows], **chosen), self.compensator)

    def _take_seeds(self, seed: int | Sequence[int | None] | None, mask: Flags) -> None:
        """New seeds where they are given, the next episode elsewhere."""
        seeds = spaces.given_seeds(seed, self.num_envs)
        if seed is None and self._seeded.all():
            self._episodes[mask] += np.uint64(1)
            return
        for i in np.flatnonzero(mask):
            given = seeds[i]
            if given is None and self._seeded[i]:
                self._episodes[i] += np.uint64(1)
            else:
                if given is not None and given < 0:
                    raise InputError(f"seed {given} is negative; give a whole number not below zero")
                self._seeds[i] = seed_word(fresh_seed(self.np_random) if given is None else int(given))
                self._episodes[i], self._seeded[i] = 0, True

    def _chosen(self, options: dict[str, Any], rows: NDArray[np.intp]) -> dict[str, Any]:
        """Options of `reset` for the environments ``rows``."""
        chosen: dict[str, Any] = {}
        if options.get("start_joints") is not None:
            chosen["start"] = self.task.given_joints("start_joints", options["start_joints"], self.num_envs)[rows]
        goals = given_goals(self.task, options, self.num_envs)
        chosen["goal"] = None if goals.joints is None else goals.joints[rows]
        chosen["wanted"] = None if goals.frames is None else goals.frames[rows]
        if options.get("arm") is not None:
            arms = np.asarray(options["arm"])
            if arms.shape not in ((), (self.num_envs,)):
                raise InputError(f"option arm has shape {arms.shape}; give one number, or {self.num_envs}")
            each = np.broadcast_to(arms, (self.num_envs,))[rows]
            chosen["arm"] = np.array([self.task.given_arm(arm) for arm in each.tolist()], dtype=np.intp)
        return chosen

    def _observations(self, out: Views) -> Any:
        parts = [part.T for part in out.observation]
        return dict(zip(GOAL_KEYS, parts, strict=True)) if self.goal_dict else parts[0]

    def _infos(self, out: Views, mask: Flags) -> dict[str, Any]:
        """Infos as a dict of arrays with masks; what is outside the mask is zero."""
        n = self.task.joints
        numbers, vectors, success = out.numbers, out.vectors, out.success
        given = self.batch.flags(mask)
        if not mask.all():
            numbers, success = [row * given for row in numbers], success & given
            vectors = vectors * given if self._poses else vectors
        infos: dict[str, Any] = dict(zip(NUMBER_KEYS, numbers, strict=True))
        infos["is_success"] = success
        cuts = (("pose_error", 0, 6), ("joint_command", 6, 6 + n), ("tool_position", 6 + n, 9 + n))
        for key, a, b in (*cuts, ("fruit_position", 9 + n, 12 + n)) if self._poses else ():
            infos[key] = vectors[a:b].T
        return infos | {f"_{key}": given for key in infos}

    def _final(self, out: Views, rows: NDArray[np.intp], ended: Flags) -> dict[str, Any]:
        """Last observation and info of the episodes that ended, before they are overwritten."""
        last = self.batch.copied(out)
        infos = self._infos(last, ended)
        mask = self.batch.flags(ended)
        return {
            "final_obs": self.batch.final_observations(self._observations(last), rows),
            "_final_obs": mask,
            "final_info": infos,
            "_final_info": mask,
        }


Settings = Mapping[str, Any]
"""What the environment says of where it computes: ``device``, ``dtype`` and ``compiled``; only torch asks."""


@register("backend", "compiled")
def _compiled(task: Task, count: int, goal_dict: bool, poses: bool, settings: Settings) -> Batch:
    """The step as machine code on NumPy's arrays.

    Raises:
        MissingExtra: If llvmlite is not installed.
    """
    require("llvmlite")
    from pickenv.envs.reaching.compiled_batch import CompiledBatch

    return CompiledBatch(task, count, goal_dict, poses)


@register("backend", "numpy")
def _numpy(task: Task, count: int, goal_dict: bool, poses: bool, settings: Settings) -> Batch:
    """The step on NumPy's arrays."""
    return NumpyBatch(task, count, goal_dict, poses)


@register("backend", "torch")
def _torch(task: Task, count: int, goal_dict: bool, poses: bool, settings: Settings) -> Batch:
    """The step on torch's tensors.

    Raises:
        MissingExtra: If torch is not installed.
    """
    require("torch")
    from pickenv.envs.reaching.torch_batch import TorchBatch

    return TorchBatch(task, count, goal_dict, poses, **settings)


class ReachGoalVectorEnv(ReachVectorEnv):
    """N environments `pickenv/ReachGoal-v0` in one; see `ReachVectorEnv`."""

    goal_dict = True

    def __init__(self, num_envs: int = 1, *, reward: str = "sparse", **arguments: Any) -> None:
        super().__init__(num_envs, reward=reward, **arguments)

    def compute_reward(self, achieved_goal: ArrayLike, desired_goal: ArrayLike, info: Any) -> Any:
        """Reward of achieved against desired goals, as in `pickenv/ReachGoal-v0`."""
        return rewards_of_goals(self.task, achieved_goal, desired_goal)


class ReachIdealVectorEnv(ReachVectorEnv):
    """N environments `pickenv/ReachIdeal-v0` in one; see `ReachVectorEnv`."""

    def __init__(self, num_envs: int = 1, **arguments: Any) -> None:
        super().__init__(num_envs, **{"plant": IDEAL, **arguments})
