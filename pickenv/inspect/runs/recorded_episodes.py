"""Episodes of several policies for the same fruit, step by step: what a film, a recording and a table start from.

Saved and loaded whole as `episodes.npz` of a comparison's run folder (`pickenv.inspect.runs.run_folder`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array, Geometry
from pickenv.base import InputError


@dataclass(frozen=True, eq=False)
class RecordedPolicy:
    """One policy's E episodes of at most T moments, the reset being the first; a shorter one stays at its last moment.

    Attributes:
        label: Name for people: raw, LS, LS+BPNN.
        key: Short name as in entity paths and JSON; `pickenv.inspect.colours.policy_colours` gives its colour.
        moments: Moments of each episode ``(E,)``, T at most.
        joint_target: Joints at which the controller believes the arm to be ``(E, T, n)``, rad or m: the nominal arm
            stands there. What the drives got where an environment tells nothing else, and n is 0 where it has no arm.
        joint_command: What the drives got ``(E, T, n)``: a calibration stands between the two.
        tool_position: True tool ``(E, T, 3)``, m.
        tool_rotation: Its attitude ``(E, T, 3, 3)``; nan where it is not known.
        fruit_position: Fruit ``(E, T, 3)``, m; where there are several, the one that the tool goes for.
        position_error_mm: Distance between true tool and fruit ``(E, T)``.
        attitude_error_deg: Angle between true and wanted attitude ``(E, T)``; nan where it is not known.
        success: Whether the environment calls it a success ``(E, T)``.
        picked: Fruit that the gripper has taken in this episode so far ``(E, T)``; a reach picks at its last moment.
        miss_mm: Distance between tool and fruit where the gripper closes ``(E, T)``; nan at all other moments. A reach
            closes at its last moment.
        reward: Reward of each step ``(E, T)``; 0 at the reset and after the end.
    """

    label: str
    key: str
    moments: NDArray[np.int64]
    joint_target: Array
    joint_command: Array
    tool_position: Array
    tool_rotation: Array
    fruit_position: Array
    position_error_mm: Array
    attitude_error_deg: Array
    success: NDArray[np.bool_]
    picked: NDArray[np.int64]
    miss_mm: Array
    reward: Array


@dataclass(frozen=True, eq=False)
class RecordedEpisodes:
    """The same episodes with several policies.

    Attributes:
        env_id: The environment, as `gymnasium.make` knows it.
        plant: Name of the plant; empty where the environment has none.
        gripper: Name of the gripper that picks are judged by.
        tolerance_mm: How far aside of the tool a fruit may lie so that the gripper takes it one time in two, or always
            for a cup.
        seed: Seed of the comparison.
        seeds: Seed of each episode; no two policies' differ.
        period: Time between two moments, s.
        nominal: The arm as its controller believes it to be; None where the environment has no arm.
        true_geometry: Geometry of the true arm; with `joint_command` and `tool_position` it draws it
            (`pickenv.inspect.runs.saved.true_points`).
        policies: One entry per policy: raw, LS, LS+BPNN, then others.
    """

    env_id: str
    plant: str
    gripper: str
    tolerance_mm: float
    seed: int
    seeds: tuple[int, ...]
    period: float
    nominal: Geometry | None
    true_geometry: Geometry | None
    policies: tuple[RecordedPolicy, ...]


def last_of(policy: RecordedPolicy, values: Array | NDArray[np.int64] | NDArray[np.bool_]) -> Array:
    """The last moment of each episode of values ``(E, T, ...)``: ``(E, ...)``."""
    return np.asarray(values[np.arange(len(policy.moments)), policy.moments - 1])


POSITIONS = ("tool_position", "fruit_position")
"""What an environment's `info` must hold to be drawn and compared: three finite numbers each, m, in one frame."""


def missing_positions(info: Mapping[str, Any]) -> str:
    """What `info` lacks of `POSITIONS`, in a sentence that says what to do; empty where nothing is missing.

    Raises:
        InputError: If one of them is there, but no position.
    """
    for name in POSITIONS:
        if name in info:
            value = np.asarray(info[name])
            if value.shape != (3,) or value.dtype.kind not in "fiu" or not np.isfinite(value).all():
                raise InputError(f"info['{name}'] is {info[name]!r}; give three finite numbers in m")
    absent = [f"'{name}'" for name in POSITIONS if name not in info]
    if not absent:
        return ""
    return f"its info lacks {' and '.join(absent)}; let the environment give both, three numbers in m, at every step"


def believed_joints(env: Any) -> Array | None:
    """Joints at which an environment's controller believes the arm to be, copied; None where it does not tell."""
    target = getattr(env.unwrapped, "joint_target", None)
    return None if target is None else np.array(target, dtype=float)
