"""Policies that others trained or wrote: registered ones, a zip of Stable-Baselines3, a file with `make_policy`.

All execute what they hold, so load only what you trust; a policy file (.npz) of `pickenv train` executes nothing.
"""

from __future__ import annotations

import json
import runpy
import sys
import traceback
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from pkgutil import resolve_name
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from pickenv.agents.policies.policy import Policy
from pickenv.base import InputError, require
from pickenv.base.registry import get
from pickenv.wrappers import Scaling

SUFFIXES = (".zip", ".py")
MAKER = "make_policy"
TELLING: Mapping[str, tuple[str, str]] = {
    "top_quantiles_to_drop_per_net": ("sb3_contrib", "TQC"),
    "target_policy_noise": ("stable_baselines3", "TD3"),
    "target_entropy": ("stable_baselines3", "SAC"),
    "clip_range": ("stable_baselines3", "PPO"),
    "gae_lambda": ("stable_baselines3", "A2C"),
}
"""For each setting by which a zip's algorithm is recognised, tried in this order: the algorithm's module and name."""

RECURRENT = ("sb3_contrib", "RecurrentPPO")
"""Module and name of the algorithm of a zip whose policy class is recurrent; its other settings are PPO's."""


class Sb3Policy:
    """A model of Stable-Baselines3, acting without noise, on one observation or a batch.

    A recurrent model remembers within an episode.

    Attributes:
        model: The model.
        scaling: For a model trained on `pickenv/ReachScaled-v0`, the scaling of its observations and actions.
    """

    def __init__(self, model: Any, scaling: Scaling | None = None) -> None:
        self.model, self.scaling = model, scaling
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        self._state: Any = None

    def act(self, observation: Any) -> NDArray[np.float32]:
        """The next action, or actions."""
        inputs = observation if self.scaling is None else self.scaling.shown(observation)
        begins = np.full(len(inputs) if np.ndim(inputs) == 2 else 1, self._state is None)
        action, self._state = self.model.predict(inputs, self._state, begins, deterministic=True)
        return np.asarray(action if self.scaling is None else self.scaling.act(observation, action), dtype=np.float32)


def foreign_policy(path: str | Path, env: Any, seed: int) -> Policy:
    """Load a policy for an environment.

    Args:
        path: A zip that a model's ``save`` wrote, or a Python file with ``make_policy(env, seed)``; what that returns
            has ``act(observation)`` and ``reset()``.
        env: The environment, single or vector.
        seed: Of the policy's own draws.

    Raises:
        InputError: If there is no such file, it is damaged, of an algorithm that is not known, defines no
            ``make_policy``, its own lines fail, or it was trained on other observations or actions.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path} does not exist; give a zip of Stable-Baselines3 or a Python file with {MAKER}")
    if path.suffix != ".py":
        return _trained(path, env)
    with faults_in(path, "policy"):
        make = runpy.run_path(str(path)).get(MAKER)
    if make is None:
        raise InputError(f"{path} defines no {MAKER}(env, seed); let it return an object with act and reset")
    with faults_in(path, "policy"):
        policy = make(env, seed)
    return _checked(policy, f"{MAKER} of {path}")


def registered_policy(name: str, env: Any, seed: int, known: Mapping[str, Any]) -> Policy:
    """Make a registered policy for an environment.

    Args:
        name: Its name.
        env: The environment, single or vector.
        seed: Of the policy's own draws.
        known: Keywords that a policy takes which learns from episode to episode.

    Raises:
        InputError: If the lines of another package fail, or what they return is no policy.
    """
    maker = get("policy", name)
    with faults_in(Path(getattr(sys.modules[maker.__module__], "__file__", name)), "policy"):
        policy = maker(env, seed, **known)
    return _checked(policy, f"policy '{name}'")


def _checked(policy: Any, maker: str) -> Policy:
    if not callable(getattr(policy, "act", None)) or not callable(getattr(policy, "reset", None)):
        raise InputError(f"what {maker} returns has no act(observation) or no reset(); give it both")
    return cast(Policy, policy)


@contextmanager
def faults_in(path: Path, what: str) -> Iterator[None]:
    """Report an error that somebody else's code raises with its file and line.

    Args:
        path: The file that holds the code.
        what: What there is to mend.

    Raises:
        InputError: In place of any error that the code raises.
    """
    try:
        yield
    except InputError:
        raise
    except Exception as error:
        lines = [frame.lineno for frame in traceback.extract_tb(error.__traceback__) if frame.filename == str(path)]
        line, message = lines[-1] if lines else None, str(error)
        if isinstance(error, SyntaxError):
            line, message = error.lineno, error.msg
        place = f"{path}, line {line}" if line is not None else f"{path}"
        raise InputError(f"{place}: {type(error).__name__}: {message}; mend the {what}") from error


def _trained(path: Path, env: Any) -> Sb3Policy:
    require("stable_baselines3")
    try:
        with zipfile.ZipFile(path) as archive:
            settings = json.loads(archive.read("data"))
    except (OSError, KeyError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(f"{path} is no model of Stable-Baselines3 ({error}); give what its save wrote") from error
    recurrent = "recurrent" in str(dict(settings.get("policy_class") or {}).get("__module__"))
    home = RECURRENT if recurrent else next((home for key, home in TELLING.items() if key in settings), None)
    if home is None:
        names = ", ".join(name for _, name in (*TELLING.values(), RECURRENT))
        raise InputError(f"{path} is of an algorithm that is not known here; give one of {names}, or a Python file")
    require(home[0])
    model = resolve_name(":".join(home)).load(path, device="cpu")
    task = getattr(env.unwrapped, "task", None)
    scaling = None if task is None else Scaling(task.joints, task.camera)
    if scaling is not None and model.observation_space.shape == (scaling.features,):
        return Sb3Policy(model, scaling)
    for kind in ("observation", "action"):
        trained, present = getattr(model, f"{kind}_space"), getattr(env, f"{kind}_space")
        present = getattr(env, f"single_{kind}_space", present)
        if trained.shape != present.shape or type(trained) is not type(present):
            raise InputError(
                f"{path} was trained on {kind}s {trained}, but the environment has {present}; give its own"
            )
    return Sb3Policy(model)
