"""What a name on the command line stands for: a kind of policy, a shipped one, a file, or a folder of trainings."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from pickenv.agents.evaluation.rollout import PolicyMaker
from pickenv.agents.policies import foreign
from pickenv.agents.policies.learned import LearnedPolicy, load_policy
from pickenv.agents.policies.policy import Policy
from pickenv.agents.policies.remembering import (
    RememberingPolicy,
    RememberingReach,
    load_remembering,
    remembers,
)
from pickenv.arm import Arm
from pickenv.base import InputError
from pickenv.base.registry import get, names
from pickenv.envs.shared.task import FEEDBACK
from pickenv.wrappers.tool_steps import ToolSteps

SEQUENTIAL_STEPS = 30
"""Steps of an episode of a policy that learns from pick to pick: the longest way takes 20."""


@dataclass(frozen=True)
class Kind:
    """A kind of policy.

    Attributes:
        feedback: What it can use: "encoders", "camera".
        sequential: Whether it learns from episode to episode.
        raw_only: Whether a compensator would only stand in its way.
        files: Of a learned policy, one per training seed; else empty.
    """

    feedback: tuple[str, ...] = FEEDBACK
    sequential: bool = False
    raw_only: bool = False
    files: tuple[str, ...] = ()

    @property
    def steps(self) -> int:
        """Steps of an episode."""
        return SEQUENTIAL_STEPS if self.sequential else 60


def kind_of(name: str) -> Kind:
    """What kind of policy a name stands for.

    Raises:
        InputError: If it is no kind, no shipped policy, no policy file and no folder of one training with several
            seeds.
    """
    if name in names("policy"):
        maker, plain = get("policy", name), Kind()
        traits = ("feedback", "sequential", "raw_only")
        return Kind(**{trait: getattr(maker, trait, getattr(plain, trait)) for trait in traits})
    if Path(name).suffix in foreign.SUFFIXES:
        return Kind(files=(name,))
    if Path(name).is_dir():
        files = tuple(str(path) for path in sorted(Path(name).glob("*/policy.npz")))
        return replace(_kind_of_files(name, files), files=files)
    try:
        policy = load_any(name)
    except InputError as error:
        if name.endswith(".npz"):
            raise
        raise InputError(
            f"unknown policy '{name}'; give {', '.join(names('policy'))}, a shipped baseline, a file or a folder of "
            "trainings"
        ) from error
    return replace(_kind_of_policy(policy), files=(name,))


def load_any(name: str, arm: Arm | None = None) -> LearnedPolicy | RememberingPolicy:
    """A shipped policy or a policy file, with or without a memory; errors as of `load_policy`."""
    return load_remembering(name, arm) if remembers(name) else load_policy(name, arm)


def maker_of(name: str, camera_noise_mm: float = 0.0, compensation: str = "raw") -> PolicyMaker:
    """How a policy is made for an environment, from a seed.

    Args:
        name: Of a registered or shipped policy, or a policy file (.npz, or as `foreign_policy` takes it).
        camera_noise_mm: Noise that an adaptive policy expects, per axis.
        compensation: What it stands behind.
    """

    def make(env: Any, seed: int) -> Policy:
        if name in names("policy"):
            known = {"camera_noise_mm": camera_noise_mm, "compensation": compensation}
            return foreign.registered_policy(name, env, seed, known if kind_of(name).sequential else {})
        if Path(name).suffix in foreign.SUFFIXES:
            return foreign.foreign_policy(name, env, seed)
        policy = load_any(name, env.unwrapped.task.plant.arm)
        return policy if isinstance(policy, LearnedPolicy) else RememberingReach(env, policy)

    return make


def policy_name(name: str) -> str:
    """How a policy is called in tables: files and folders by the end of their path."""
    path = Path(name)
    if path.suffix in foreign.SUFFIXES:
        return path.stem
    if name.endswith(".npz"):
        return "/".join(path.with_suffix("").parts[-3:])
    return path.name if len(path.parts) > 1 else name


def _kind_of_files(folder: str, files: tuple[str, ...]) -> Kind:
    """The kind of a folder's trainings; they must differ in their seeds alone."""
    if not files:
        raise InputError(f"{folder} holds no trainings; give a folder whose folders hold a policy.npz each, one a seed")
    policies = [load_any(file) for file in files]
    trainings = [dict(policy.record.get("training", {})) for policy in policies]
    seeds = [training.pop("seed", None) for training in trainings]
    if len(set(seeds)) < len(seeds) or any(training != trainings[0] for training in trainings):
        raise InputError(
            f"{folder} holds trainings that differ in more than their seeds, or two of one seed; give one training "
            "with several seeds, each in a folder of its own"
        )
    return _kind_of_policy(policies[0])


def _kind_of_policy(policy: LearnedPolicy | RememberingPolicy) -> Kind:
    if isinstance(policy, RememberingPolicy):
        return Kind(("camera",), sequential=True)
    if isinstance(policy.scaling, ToolSteps):
        raise InputError("this policy picks, and cannot be compared on reaches; judge it in pickenv/Pick-v0")
    return Kind(("camera",) if policy.scaling.camera else ("encoders",))
