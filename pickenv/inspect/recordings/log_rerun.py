"""Wrappers that log episodes for the Rerun viewer, as `gymnasium.wrappers.RecordVideo` films them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, SupportsFloat, TypeVar

import gymnasium as gym
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from gymnasium.utils import RecordConstructorArgs
from gymnasium.vector import AutoresetMode, VectorEnv, VectorWrapper

import pickenv
from pickenv.base import InputError
from pickenv.inspect.colours import check_key, policy_colours, policy_label
from pickenv.inspect.recordings import episode_entities as entities
from pickenv.inspect.recordings.scribe import write_recording
from pickenv.inspect.recordings.viewing import PATIENCE, open_live
from pickenv.inspect.runs.recorded_episodes import believed_joints, missing_positions

Observation = TypeVar("Observation")
Action = TypeVar("Action")
GROWTH = 2.0
"""Factor by which the number of recorded steps must grow before the file is rewritten, which keeps the cost small."""


class _Recorder:
    """The part that `LogRerun` and `LogRerunVector` share: logs of environments, the file, and the live viewers."""

    _scene: entities.Scene

    def __init__(self, env: Any, keys: Sequence[str], settings: Mapping[str, Any]) -> None:
        policy, folder, length = settings["policy"], settings["save_path"], settings["recording_length"]
        check_key(policy, "policy")
        if length < 0:
            raise InputError(f"recording_length is {length}; give a number of steps, or 0 for whole episodes")
        self._viewers = {name: settings[name] for name in ("spawn", "connect", "serve")}
        self._live = any(value is not None and value is not False for value in self._viewers.values())
        if folder is None and not self._live:
            raise InputError("nothing would be logged; give save_path, spawn, connect or serve")
        triggers = settings["episode_trigger"], settings["step_trigger"]
        if triggers == (None, None):
            triggers = entities.capped_cubic, None
        self.path = None if folder is None else Path(folder) / f"{settings['name_prefix']}-{policy}.rrd"
        self.logs = [entities.EpisodeLog(key, *triggers, float(length) or np.inf) for key in keys]
        self._env, self._policy = env, policy
        self._identity = ""
        self._in_file = 0
        self._shown = [0] * len(self.logs)
        self._stream: rr.RecordingStream | None = None

    def met(self, info: Mapping[str, Any]) -> None:
        """Store the properties that all episodes share, and the recording's identity, after the first reset.

        ``info`` is the reset's `info`. Recordings of several policies have one identity if environment, plant and first
        seed are the same. The viewer shows recordings of one identity as one recording.
        """
        if self._identity:
            return
        outer = self._env.unwrapped
        missing = missing_positions(entities.info_of(info, 0) if hasattr(outer, "num_envs") else info)
        if missing:
            gym.logger.warn(f"the recording of {type(outer).__name__} has no view in 3D: {missing}")
        inner = outer.envs[0].unwrapped if hasattr(outer, "envs") else outer
        task = getattr(inner, "task", None)
        plant = getattr(task, "plant", None)
        self._scene = entities.Scene(
            nominal=None if plant is None else plant.arm.nominal,
            period=1.0 / inner.metadata.get("render_fps", 10),
            # Only where the fruit is a pose to be reached is this radius what counts.
            tolerance_mm=getattr(task, "tolerance_mm", None) if "pose_error" in info else None,
            label=policy_label(self._policy),
            colour=policy_colours([self._policy])[0],
        )
        name = type(inner).__name__ if inner.spec is None else inner.spec.id.rpartition("/")[2]
        self._identity = ":".join([name, *([] if plant is None else [plant.name]), f"seed{outer.np_random_seed}"])

    def ended(self, growth: float = GROWTH) -> None:
        """Show the recorded steps of an episode that has ended, and rewrite the file if there are enough new steps.

        The file is rewritten if the recorded steps are at least ``growth`` times the steps in the file.
        """
        recorded = sum(len(log.rows) for log in self.logs)
        if recorded and self._live:
            if self._stream is None:
                self._stream = open_live(self._identity, self._blueprint(), **self._viewers)
            self._send(self._stream, self._shown)
            self._shown = [len(log.rows) for log in self.logs]
        if self.path is not None and recorded > self._in_file and recorded >= growth * self._in_file:
            anew = [0] * len(self.logs)  # the old file stays until the new one is complete
            write_recording(self.path, self._identity, self._blueprint(), lambda stream: self._send(stream, anew))
            self._in_file = recorded

    def close(self) -> None:
        """Show and write the steps not yet shown or written, and disconnect the live viewers."""
        self.ended(growth=1.0)
        if self._stream is not None:
            try:
                self._stream.flush(timeout_sec=PATIENCE)
                self._stream.disconnect()
            except RuntimeError as error:
                gym.logger.warn("a live viewer did not take the last steps: %s", error)
            self._stream = None

    def _blueprint(self) -> rrb.Blueprint:
        return entities.episode_blueprint(self._scene, next(log.rows for log in self.logs if log.rows))

    def _send(self, stream: rr.RecordingStream, start: Sequence[int]) -> None:
        """Send each environment's recorded steps from an index on, preceded by static data such as colours.

        ``start`` has one index, from 0, for each environment.
        """
        if not any(start):
            facts: dict[str, Any] = {"pickenv_version": pickenv.__version__, "rerun_version": rr.__version__}
            stream.send_property("pickenv", rr.AnyValues(**facts))
        for log, begin in zip(self.logs, start, strict=True):
            if len(log.rows) > begin:
                entities.send_steps(stream, self._scene, log.key, log.rows, begin)


NOT_OF_THE_RECORDER = ("self", "env", "indices")
"""Names of the wrappers' arguments that are not settings of the recorder."""


class LogRerun(gym.Wrapper[Observation, Action, Observation, Action], RecordConstructorArgs):
    """Log episodes for Rerun: true and nominal arm, fruit, arrow from fruit to tool, and every number of `info`.

    The signature follows `gymnasium.wrappers.RecordVideo`. All recorded episodes are in one file,
    ``save_path/name_prefix-policy.rrd``. The viewer shows files of several policies on one environment and seed as one
    recording: ``rerun runs/*.rrd``.

    The whole file is rewritten at the end of an episode if there are twice as many recorded steps as in the file, and
    by `close`. Live viewers show each episode when it has ended.

    Example:
        >>> import gymnasium as gym
        >>> import pickenv
        >>> from pickenv.inspect import LogRerun
        >>> env = LogRerun(gym.make("pickenv/Reach-v0"), "runs/recordings", lambda number: True, policy="random")
        >>> observation, info = env.reset(seed=0)
        >>> for _ in range(60):
        ...     observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> env.close()

    Change log:
     * v0.1.0 - Added.
    """

    def __init__(
        self,
        env: gym.Env[Observation, Action],
        save_path: str | Path | None = None,
        episode_trigger: entities.Trigger | None = None,
        step_trigger: entities.Trigger | None = None,
        recording_length: int = 0,
        name_prefix: str = "episodes",
        *,
        policy: str = "policy",
        spawn: bool = False,
        connect: str | None = None,
        serve: int | None = None,
    ) -> None:
        """Log the episodes of ``env``.

        Args:
            env: Any environment. Arms and fruit are drawn if `info` has their positions.
            save_path: Folder for the file; None for live viewers alone.
            episode_trigger: Function of an episode's index, from 0, that returns whether to record the episode. Without
                any trigger, `capped_cubic` is used.
            step_trigger: Function of a step's index over all episodes, from 0, that returns whether to record from this
                step on.
            recording_length: Number of steps to record after a trigger; 0 for whole episodes.
            name_prefix: First part of the file's name.
            policy: Name of the policy: lower-case letters, digits and underscores.
            spawn: Whether to show the episodes in a viewer that is started here.
            connect: Address of a running viewer that shows the episodes; None for no such viewer.
            serve: Port for viewers that connect to see the episodes; None for no server.

        Raises:
            InputError: If ``policy`` is empty or has other characters, ``recording_length`` is negative, or there is
                neither a folder nor a viewer. `reset`, `step` and `close` raise `InputError` if the file cannot be
                written or a viewer cannot be reached.
        """
        settings = {name: value for name, value in locals().items() if name not in NOT_OF_THE_RECORDER}
        RecordConstructorArgs.__init__(self, **settings)
        gym.Wrapper.__init__(self, env)
        self._recorder = _Recorder(env, [policy], settings)
        self._log = self._recorder.logs[0]

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Reset the environment, and record its first `info` if a trigger asks for that."""
        observation, info = self.env.reset(seed=seed, options=options)
        self._recorder.met(info)
        self._log.begin(info, believed_joints(self.env))
        return observation, info

    def step(self, action: Action) -> tuple[Observation, SupportsFloat, bool, bool, dict[str, Any]]:
        """Step the environment, and record its `info` if a trigger asks for that."""
        observation, reward, terminated, truncated, info = self.env.step(action)
        if self._log.steps():
            self._log.note(info, float(reward), believed_joints(self.env))
        if terminated or truncated:
            self._recorder.ended()
        return observation, reward, terminated, truncated, info

    def close(self) -> None:
        """Write the steps not yet written, and close the environment."""
        self._recorder.close()
        super().close()


class LogRerunVector(VectorWrapper[Any, Any, Any, Any, Any], RecordConstructorArgs):
    """`LogRerun` for vector environments: it logs the environments with the chosen indices, from 0.

    Change log:
     * v0.1.0 - Added.
    """

    def __init__(
        self,
        env: VectorEnv[Any, Any, Any],
        save_path: str | Path | None = None,
        episode_trigger: entities.Trigger | None = None,
        step_trigger: entities.Trigger | None = None,
        recording_length: int = 0,
        name_prefix: str = "episodes",
        *,
        indices: Sequence[int] = (0,),
        policy: str = "policy",
        spawn: bool = False,
        connect: str | None = None,
        serve: int | None = None,
    ) -> None:
        """Log the environments of ``env`` whose indices, from 0, are in ``indices``.

        All other arguments are as for `LogRerun`. Each environment counts its own episodes and steps, and the
        triggers get these counts.

        Raises:
            InputError: If ``indices`` is empty, has an index twice, or has an index that no environment has. Also for
                the reasons of `LogRerun`.
        """
        settings = {name: value for name, value in locals().items() if name not in NOT_OF_THE_RECORDER}
        RecordConstructorArgs.__init__(self, indices=indices, **settings)
        VectorWrapper.__init__(self, env)
        if not indices or not all(0 <= i < env.num_envs for i in indices) or len(set(indices)) != len(indices):
            raise InputError(f"indices are {list(indices)}; give different numbers from 0 to {env.num_envs - 1}")
        self._recorder = _Recorder(env, [f"{policy}/env_{i}" for i in indices], settings)
        self._logged = list(zip(indices, self._recorder.logs, strict=True))
        self._over = np.zeros(env.num_envs, dtype=np.bool_)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Reset the environments, and record the first `info` of each environment if a trigger asks for that."""
        mask = None if options is None else options.get("reset_mask")
        observations, infos = self.env.reset(seed=seed, options=options)  # type: ignore[arg-type]
        self._recorder.met(infos)
        for i, log in self._logged:
            if mask is None or mask[i]:
                self._over[i] = False
                log.begin(entities.info_of(infos, i))
        return observations, infos

    def step(self, actions: Any) -> tuple[Any, Any, Any, Any, dict[str, Any]]:
        """Step the environments, and record the `info` of each environment if a trigger asks for that."""
        observations, rewards, terminations, truncations, infos = self.env.step(actions)
        same_step = self.env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
        ended = False
        for i, log in self._logged:
            if self._over[i]:  # this step began the next episode; its action was ignored
                self._over[i] = False
                log.begin(entities.info_of(infos, i))
                continue
            over = bool(terminations[i] or truncations[i])
            if log.steps():
                log.note(entities.info_of(infos["final_info"] if over and same_step else infos, i), float(rewards[i]))
            if over and same_step:
                log.begin(entities.info_of(infos, i))
            self._over[i] = over and not same_step
            ended = ended or over
        if ended:
            self._recorder.ended()
        return observations, rewards, terminations, truncations, infos

    def close(self, **arguments: Any) -> None:
        """Write the steps not yet written, and close the environments."""
        self._recorder.close()
        super().close(**arguments)
