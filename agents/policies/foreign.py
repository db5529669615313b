"""Policies from outside pickenv: registered policies, zip files of Stable-Baselines3, and files with `make_policy`.

All of these can execute code, so load only files that you trust. A policy file (.npz) of `pickenv train` executes
nothing.
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
RECURRENT = ("sb3_contrib", "RecurrentPPO")


class Sb3Policy:
    """Policy that runs a Stable-Baselines3 model deterministically, on one observation or a batch.

    A recurrent model keeps its state within an episode.

    Attributes:
        model: The Stable-Baselines3 model.
        scaling: Scaling of observations and actions for a model trained on `pickenv/ReachScaled-v0`; None for others.
    """

    def __init__(self, model: Any, scaling: Scaling | None = None) -> None:
        self.model, self.scaling = model, scaling
        self.reset()

    def reset(self) -> None:
        """Forget the last episode."""
        self._state: Any = None

    def act(self, observation: Any) -> NDArray[np.float32]:
        """Return the next action, or one action per observation of a batch."""
        inputs = observation if self.scaling is None else self.scaling.shown(observation)
        begins = np.full(len(inputs) if np.ndim(inputs) == 2 else 1, self._state is None)
        action, self._state = self.model.predict(inputs, self._state, begins, deterministic=True)
        return np.asarray(action if self.scaling is None else self.scaling.act(observation, action), dtype=np.float32)


def foreign_policy(path: str | Path, env: Any, seed: int) -> Policy:
    """Load a policy for an environment from a Stable-Baselines3 zip file or a Python file.

    Args:
        path: Zip file that a model's ``save`` wrote, or Python file that defines ``make_policy(env, seed)``. The object
            that ``make_policy`` returns must have ``act(observation)`` and ``reset()``.
        env: Environment, single or vector.
        seed: Seed of the policy's own random draws.

    Raises:
        InputError: If the file is missing or damaged, its algorithm is unknown, it defines no ``make_policy``, or its
            code fails. Also if its model was trained on other observations or actions.
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
        policy = make(env, seed)
    return _checked(policy, f"{MAKER} of {path}")


def registered_policy(name: str, env: Any, seed: int, known: Mapping[str, Any]) -> Policy:
    """Make a registered policy for an environment.

    Args:
        name: Registered name of the policy.
        env: Environment, single or vector.
        seed: Seed of the policy's own random draws.
        known: Keyword arguments for a policy that learns from episode to episode.

    Raises:
        InputError: If the registered function fails, or returns an object without ``act`` or ``reset``.
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
    """Turn errors that foreign code raises within the context into an `InputError` with file and line.

    Args:
        path: File that holds the code.
        what: Word for the thing that the user should correct, such as "policy".

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
    """Load the policy in a zip file of Stable-Baselines3; the settings in the file show its algorithm.

    `TELLING` gives, for the name of a setting, the module and name of the algorithm that has it. Settings are tried in
    this order, and the first that the file has decides. `RECURRENT` is the algorithm of a file with a recurrent policy
    class; the settings of such a file look like PPO.
    """
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
        learnt = getattr(model, f"{kind}_space")
        present = getattr(env, f"single_{kind}_space", getattr(env, f"{kind}_space"))
        if learnt.shape != present.shape or type(learnt) is not type(present):
            raise InputError(f"{path} was trained on {kind}s {learnt}, but the environment has {present}; give its own")
    return Sb3Policy(model)
