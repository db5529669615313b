"""pickenv in LeRobot: the environment `--env.type=pickenv`, and the step that puts a calibration before a robot."""

from __future__ import annotations

import json
import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium.vector import AsyncVectorEnv, AutoresetMode, SyncVectorEnv
from lerobot.configs import FeatureType, PolicyFeature
from lerobot.datasets.lerobot_dataset import LeRobotDataset
from lerobot.envs import EnvConfig
from lerobot.processor import ActionProcessorStep, ProcessorStepRegistry
from lerobot.utils.constants import ACTION, OBS_IMAGES, OBS_STATE

import pickenv
from pickenv.agents import Policy, arms_of, recorded_episode
from pickenv.base import DO_NOT_USE, obey, write_json
from pickenv.wrappers import CompensationWrapper

ERRORS = ("position_error_mm", "grasp_lateral_mm", "grasp_axial_mm")
"""Errors in `info`, mm, which are noted where an episode ends; one of a grasp is 0 where nothing was grasped."""

PASSED = ("plant", "arms", "population_seed", "error_mm", "obs_type", "pixels", "cameras")
"""Fields of the configuration that the environment has under the same names."""

OBSERVATIONS = ("pixels_agent_pos", "pixels")
RADIANS = {"deg": math.pi / 180.0, "rad": 1.0}


class Noting:
    """A vector environment that notes how episodes end: the first of each environment after a reset.

    Those are the episodes that LeRobot counts. What was noted is summed up in LeRobot's log when the vector is closed.
    """

    noted: list[dict[str, Any]]
    errors_to: str | None

    def reset(self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None) -> Any:
        """Start an episode in every environment; LeRobot's own options are not for them."""
        options = {name: value for name, value in (options or {}).items() if not name.startswith("lerobot_")}
        first = isinstance(seed, int)
        self._seeds = [seed + i for i in range(self.num_envs)] if first else seed or [None] * self.num_envs
        self._runs, self._succeeded = np.ones((2, self.num_envs), dtype=bool) & [[True], [False]]
        return super().reset(seed=seed, options=options)

    def step(self, actions: Any) -> Any:
        """Step every environment."""
        *_, terminated, truncated, infos = result = super().step(actions)
        last = infos.get("final_info", infos)  # of an environment that ended and has begun anew
        self._succeeded |= last.get("is_success", False)
        ended = self._runs & (terminated | truncated)
        self._runs &= ~ended
        for i in np.flatnonzero(ended):
            errors = {name: float(last[name][i]) for name in ERRORS}
            known = {name: value if value and math.isfinite(value) else None for name, value in errors.items()}
            self.noted.append({"seed": self._seeds[i], "is_success": bool(self._succeeded[i]), **known})
            if self.errors_to is not None:
                with Path(self.errors_to).open("a", encoding="utf-8") as file:
                    file.write(json.dumps(self.noted[-1]) + "\n")
        return result

    def close(self, **arguments: Any) -> None:
        """Close the environments; log the median and the largest size of each error."""
        if not self.closed:
            for name in ERRORS:
                if found := [abs(end[name]) for end in self.noted if end.get(name) is not None]:
                    text = "%s at the end of %d episodes: median %.1f, largest %.1f"
                    logging.info(text, name, len(found), np.median(found), max(found))
        super().close(**arguments)


class NotingSync(Noting, SyncVectorEnv):
    """Environments in this process."""


class NotingAsync(Noting, AsyncVectorEnv):
    """Environments in a process each."""


@EnvConfig.register_subclass("pickenv")
@dataclass
class PickenvEnv(EnvConfig):
    """The environments `pickenv/PickScene-v0`.

    Attributes:
        plant: The simulated true arm.
        arms: "fixed", or "per_episode" for another arm of the plant's kind in each.
        population_seed: Seed from which true arms are drawn.
        error_mm: Mean error to which the true arm's is scaled, mm; None leaves it.
        calibration: File of a calibration to put between policy and arm, or None.
        allow: Reservations of the calibration to accept, by name.
        obs_type: "pixels_agent_pos" or "pixels".
        pixels: Width and height of each picture.
        cameras: Cameras of the pictures.
        episode_length: Most steps of an episode.
        errors_to: File for a JSON line per episode: seed, success and errors in mm; None writes none.
        arguments: Further arguments of the environment, by name.
    """

    task: str | None = "PickScene-v0"
    fps: int = 25
    plant: str = "printed:so101"
    arms: str = "fixed"
    population_seed: int = 0
    error_mm: float | None = None
    calibration: str | None = None
    allow: list[str] = field(default_factory=list)
    obs_type: str = "pixels_agent_pos"
    pixels: int = 64
    cameras: list[str] = field(default_factory=lambda: ["world", "wrist"])
    episode_length: int = 300
    errors_to: str | None = None
    arguments: dict[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Describe observations and actions to LeRobot."""
        if self.obs_type not in OBSERVATIONS:
            raise pickenv.InputError(f"obs_type is '{self.obs_type}'; LeRobot takes one of {', '.join(OBSERVATIONS)}")
        axes = (pickenv.load_plant(self.plant).arm.nominal.joints + 1,)  # and the gripper
        self.features = {ACTION: PolicyFeature(FeatureType.ACTION, axes)}
        self.features_map = {ACTION: ACTION, "agent_pos": OBS_STATE}
        if self.obs_type == "pixels_agent_pos":
            self.features["agent_pos"] = PolicyFeature(FeatureType.STATE, axes)
        for camera in self.cameras:
            self.features[f"pixels/{camera}"] = PolicyFeature(FeatureType.VISUAL, (self.pixels, self.pixels, 3))
            self.features_map[f"pixels/{camera}"] = f"{OBS_IMAGES}.{camera}"

    @property
    def package_name(self) -> str:
        """The package that registers the environment."""
        return "pickenv"

    @property
    def gym_kwargs(self) -> dict[str, Any]:
        """Arguments of `gymnasium.make`."""
        chosen = {name: getattr(self, name) for name in PASSED}
        timing = {"control_period_s": 1.0 / self.fps, "max_episode_steps": self.episode_length}
        return {**chosen, **timing, "render_mode": "rgb_array", **self.arguments}

    def make_one(self) -> gymnasium.Env[Any, Any]:
        """One environment, with the calibration in between; raises `InputError` if that is of another arm."""
        env = gymnasium.make(self.gym_id, disable_env_checker=self.disable_env_checker, **self.gym_kwargs)
        if self.calibration is None:
            return env
        inner: Any = env.unwrapped
        calibration = pickenv.Calibration.load(self.calibration, inner.plant.arm)
        return CompensationWrapper(env, calibration.compensator(), self.allow)

    def create_envs(self, n_envs: int, use_async_envs: bool = False) -> dict[str, dict[int, Any]]:
        """The vector of ``n_envs`` environments, as LeRobot wants it: each begins anew in the step that ends it."""
        makers, options = [self.make_one] * n_envs, {"autoreset_mode": AutoresetMode.SAME_STEP}
        apart = use_async_envs and n_envs > 1
        vector = NotingAsync(makers, context="forkserver", **options) if apart else NotingSync(makers, **options)
        vector.noted, vector.errors_to = [], self.errors_to
        vector.metadata = {**vector.metadata, "render_fps": self.fps}  # a whole number, or no film is written
        if self.errors_to is not None:
            Path(self.errors_to).write_text("", encoding="utf-8")
        return {self.type: {0: vector}}


def record(
    env: gymnasium.Env[Any, Any],
    policy: Policy,
    root: str | Path,
    episodes: int = 50,
    *,
    seed: int = 0,
    repo_id: str = "pickenv/demonstrations",
) -> LeRobotDataset:
    """Record a policy as a LeRobotDataset (v3); episodes that end without success are left out.

    ``meta/pickenv.json`` has the environment's arguments, whether a compensator stood before the arm, and for each
    episode its seed and the links of the believed and the true arm.

    Args:
        env: A single environment of pickenv with one arm. Of dictionaries pictures and "agent_pos" are recorded, as
            LeRobot names them; of plain observations all numbers, as "observation.state".
        policy: What acts in it.
        root: Folder of the data set, which is not there yet.
        episodes: Episodes that are tried.
        seed: Seed of the first one; the next ones count up.
        repo_id: Name of the data set.

    Raises:
        InputError: If the folder is there, the environment cannot be recorded, or no episode succeeded.
    """
    inner: Any = env.unwrapped
    space, rate = env.observation_space, float(env.metadata["render_fps"])
    plain = isinstance(space, gymnasium.spaces.Box)
    if Path(root).exists():
        raise pickenv.InputError(f"{root} is there already; take it away, or name another folder")
    if not (hasattr(inner, "plant") and (plain or "agent_pos" in space.spaces)):
        raise pickenv.InputError(f"{env.spec.id} shows neither plain numbers nor agent_pos of one arm; record another")
    if rate != round(rate):
        raise pickenv.InputError(f"the environment has {rate:.2f} steps a second; LeRobot takes whole numbers")
    recorded, kept = None, []
    for number in range(seed, seed + episodes):
        row, info = recorded_episode(env, policy, number)
        if not info.get("is_success", True):
            continue
        seen = row["observations"]
        columns = {OBS_STATE: seen if plain else seen["agent_pos"], ACTION: row["actions"]}
        if not plain:
            columns |= {f"{OBS_IMAGES}.{camera}": views for camera, views in seen.get("pixels", {}).items()}
        if recorded is None:
            features = {key: _feature(values[0]) for key, values in columns.items()}
            name = inner.plant.arm.name
            recorded = LeRobotDataset.create(repo_id, int(rate), features, root, robot_type=name, use_videos=False)
        for step in range(len(row["actions"])):
            frame = {key: values[step] for key, values in columns.items()}
            recorded.add_frame({**frame, "task": getattr(inner, "task_description", env.spec.id)})
        recorded.save_episode()
        kept.append({"seed": number, **arms_of(env)})
    if recorded is None:
        raise pickenv.InputError(f"none of {episodes} episodes succeeded; record more, or another policy")
    recorded.finalize()
    arguments = {**env.spec.kwargs, "max_episode_steps": env.spec.max_episode_steps}
    about = {"environment": env.spec.id, "arguments": json.loads(json.dumps(arguments, default=repr))}
    about |= {"compensated": inner.compensator is not None, "episodes": kept, "simulated": True}
    write_json(Path(root) / "meta/pickenv.json", about)
    return recorded


def _feature(value: np.ndarray[Any, Any]) -> dict[str, Any]:
    """LeRobot's description of a column, by its first value."""
    if value.ndim == 3:
        return {"dtype": "image", "shape": value.shape, "names": ["height", "width", "channels"]}
    return {"dtype": "float32", "shape": value.shape, "names": [f"number_{i}" for i in range(len(value))]}


@ProcessorStepRegistry.register("pickenv_compensation")
@dataclass
class CompensationStep(ActionProcessorStep):
    """Correct joint targets on their way to a robot, by a calibration of this robot.

    Targets come as LeRobot's robots take them (`{"shoulder_pan.pos": 12.3, ...}`), or as a policy's tensor
    ``(..., m)``, whose first columns are the joints in the arm's order. Everything else, the gripper above all, passes
    untouched.

    Attributes:
        path: File of the calibration.
        joints: Names of the joints in LeRobot, in the arm's order; as the calibration names them if left out.
        unit: Unit of turning joints, "deg" or "rad"; sliding joints are in m.
        allow: Reservations of the calibration to accept, by name; as for `pickenv apply`, "do-not-use" alone matters.
    """

    path: str
    joints: list[str] = field(default_factory=list)
    unit: str = "deg"
    allow: list[str] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Load the calibration; raises `InputError` if it does not fit, or if something stands against its use."""
        self.compensator = pickenv.Calibration.load(self.path).compensator()
        obey(self.compensator.reservations, self.allow, [DO_NOT_USE])
        for sentence in filter(None, (*self.compensator.reservations.values(), self.compensator.caution)):
            logging.warning("%s", sentence)
        nominal = self.compensator.nominal
        self.joints = self.joints or list(nominal.joint_names)
        if len(self.joints) != nominal.joints:
            raise pickenv.InputError(
                f"{self.path} is of {nominal.joints} joints, not {len(self.joints)}; name them all"
            )
        if self.unit not in RADIANS:
            raise pickenv.InputError(f"the unit is '{self.unit}'; give one of {', '.join(RADIANS)}")
        self._scale = np.where(nominal.prismatic, 1.0, RADIANS[self.unit])

    def action(self, action: Any) -> Any:
        """The action with its joint targets corrected."""
        if isinstance(action, torch.Tensor):
            n, found = len(self.joints), action.clone()
            found[..., :n] = torch.as_tensor(self._corrected(action[..., :n].double().cpu().numpy()))
            return found
        keys = [f"{name}.pos" for name in self.joints]
        if missing := [key for key in keys if key not in action]:
            raise pickenv.InputError(f"the action has no {missing[0]}; it has {', '.join(action)}")
        corrected = self._corrected(np.array([float(action[key]) for key in keys]))
        return {**action, **dict(zip(keys, corrected.tolist(), strict=True))}

    def _corrected(self, targets: Any) -> Any:
        return self.compensator(targets * self._scale) / self._scale

    def get_config(self) -> dict[str, Any]:
        """What LeRobot writes into a pipeline's file."""
        return {"path": str(self.path), "joints": self.joints, "unit": self.unit, "allow": self.allow}

    def transform_features(self, features: Any) -> Any:
        """The features, which stay as they are."""
        return features
