"""Tuned parameters read from `pickenv.zoo.hyperparams`, strings in the notation of RL Zoo included; nothing is run."""

from __future__ import annotations

import ast
import importlib
from typing import Any

from pickenv.base import InputError

ALGORITHMS = ("ppo", "sac", "tqc", "ppo_lstm", "ppo_history")


def check_algorithm(algorithm: str) -> None:
    """Refuse an unknown algorithm.

    Raises:
        InputError: If it is not one of `ALGORITHMS`.
    """
    if algorithm not in ALGORITHMS:
        raise InputError(f"unknown algorithm '{algorithm}'; give one of {', '.join(ALGORITHMS)}")


def tuned(algorithm: str, env_id: str) -> dict[str, Any]:
    """Parameters of an algorithm on an environment.

    Raises:
        InputError: If the algorithm is unknown, or was never tuned on the environment.
    """
    check_algorithm(algorithm)
    known: dict[str, dict[str, Any]] = importlib.import_module(f"pickenv.zoo.hyperparams.{algorithm}").hyperparams
    if env_id not in known:
        raise InputError(f"{algorithm} has no tuned parameters for '{env_id}'; give one of {', '.join(known)}")
    return {key: _value(value) for key, value in known[env_id].items()}


def class_named(policy: str) -> Any:
    """A policy as stable-baselines3 takes it: the class that a dotted name stands for, or one of its own names."""
    module, _, name = policy.rpartition(".")
    return getattr(importlib.import_module(module), name) if module else policy


def _value(value: Any) -> Any:
    if not isinstance(value, str):
        return value
    if value.startswith("lin_"):
        start = float(value[4:])
        return lambda remaining: remaining * start  # a schedule that falls evenly to zero
    if value.startswith("dict("):
        call = ast.parse(value, mode="eval").body
        assert isinstance(call, ast.Call)
        return {word.arg: ast.literal_eval(word.value) for word in call.keywords}
    return value
