"""Who takes part in a comparison: policies with what stands between them and the arm, by the names that people give."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from pickenv.agents.evaluation.compared_policies import kind_of, maker_of, policy_name
from pickenv.agents.evaluation.rollout import PolicyMaker
from pickenv.agents.policies.policy import Policy
from pickenv.arm import Arm
from pickenv.base import InputError, obey, read_container
from pickenv.calibration import Calibration
from pickenv.inspect.colours import policy_key, policy_rank
from pickenv.inspect.runs.comparison_summary import stage_label
from pickenv.wrappers import Compensate

NONE = "none"
LEAST_SQUARES = "ls"
"""After a calibration's name and ``#``: its least squares alone, without what was learnt of the rest."""

Given: TypeAlias = str | Path | Policy
"""A policy: a kind, a shipped one, a file, or an object with ``act`` and ``reset``."""


@dataclass(frozen=True, eq=False)
class Contender:
    """One policy of a comparison.

    Attributes:
        label: Name for people.
        make: Makes it for an environment, from a seed.
        compensator: Stands between it and the arm; None for a raw arm.
        calibration: Where the compensator is from.
    """

    label: str
    make: PolicyMaker
    compensator: Compensate | None = None
    calibration: Calibration | None = None


def contenders_of(
    policies: Sequence[Given],
    compensate: Sequence[str | Path | Calibration | None] = (),
    labels: Sequence[str] = (),
    *,
    arm: Any = None,
    camera_noise_mm: float = 0.0,
    allow: Collection[str] = (),
) -> list[Contender]:
    """Policies with their calibrations and names, raw, LS and LS+BPNN first.

    Args:
        policies: One or more; a calibration file among them stands for the scripted policy behind it.
        compensate: A calibration for each policy, in the same order: "none", a file, a file and "#ls" for its least
            squares alone, or a `Calibration`. One policy is taken with each of several, several with one.
        labels: Names for people, one for each; made from policies and calibrations when left out.
        arm: The arm that calibrations must be of; None where the environment has none.
        camera_noise_mm: Noise that an adaptive policy expects, per axis.
        allow: Reservations of calibrations to accept, by name.

    Raises:
        InputError: If their numbers do not fit, a name is unknown, two have one name, or something stands against a
            calibration.
    """
    pairs = [_pair(policy) for policy in policies]
    given = [None if each in (None, NONE) else each for each in compensate]
    if len(pairs) == 1 and len(given) > 1 and pairs[0][1] is None:
        pairs = pairs * len(given)
    if len(given) == 1:
        given = given * len(pairs)
    if given and len(given) != len(pairs):
        raise InputError(
            f"there are {len(pairs)} policies and {len(given)} calibrations; give one for each ({NONE} for a raw arm), "
            "one for all, or one policy"
        )
    pairs = [(policy, own or other) for (policy, own), other in zip(pairs, given or [None] * len(pairs), strict=True)]
    stages = [_calibrated(calibration, arm, allow) for _, calibration in pairs]
    names = list(labels) or _labels([_name(policy) for policy, _ in pairs], [stage for stage, _, _ in stages])
    if len(names) != len(pairs):
        raise InputError(f"there are {len(pairs)} policies and {len(names)} labels; give each one label")
    found = []
    for (policy, _), (stage, calibration, compensator), label in zip(pairs, stages, names, strict=True):
        if isinstance(policy, str | Path):
            kind_of(str(policy))
            make = maker_of(str(policy), camera_noise_mm, "raw" if stage == "raw" else LEAST_SQUARES)
        else:
            make = _ready(policy)
        found.append(Contender(label, make, compensator, calibration))
    check_labels(names)
    return sorted(found, key=lambda each: policy_rank(each.label))


def load_compensator(path: str | Path, arm: Arm, allow: Collection[str] = ()) -> Compensate:
    """The compensator of a calibration file, for environments whose fruit stand in the arm's own base frame.

    Raises:
        InputError: If the file is missing, damaged or of another arm, or if something stands against its calibration
            that ``allow`` does not name (`pickenv.base.obey`).
    """
    calibration = Calibration.load(path, arm)
    obey(calibration.reservations(), allow)
    return calibration.compensator()


def check_labels(labels: Sequence[str]) -> None:
    """Refuse names that a viewer cannot tell apart, or that it cannot say.

    Raises:
        InputError: If a label has no letter or digit, or two are alike but for signs and capitals.
    """
    keys = [policy_key(label) for label in labels]
    for key, label in zip(keys, labels, strict=True):
        if not key:
            raise InputError(f"the label '{label}' has no letter or digit; give another")
        if keys.count(key) > 1:
            raise InputError(f"two policies are called '{label}'; give each its own --label")


def _ready(policy: Policy) -> PolicyMaker:
    return lambda env, seed: policy


def _pair(policy: Given) -> tuple[Given, str | Path | Calibration | None]:
    """A policy, and the calibration that its name stands for if it is one's."""
    if isinstance(policy, str | Path) and _is_calibration(str(policy)):
        return "scripted", policy
    if isinstance(policy, str | Path) and (Path(policy) / "policy.npz").is_file():
        return Path(policy) / "policy.npz", None  # the folder of one training
    return policy, None


def _is_calibration(name: str) -> bool:
    path = Path(name.partition("#")[0])
    if path.suffix != ".npz" or not path.is_file():
        return False
    return read_container(path, None, remake="make it anew").kind == "calibration"


def _calibrated(
    given: str | Path | Calibration | None, arm: Any, allow: Collection[str]
) -> tuple[str, Calibration | None, Compensate | None]:
    """What a calibration is called among policies, itself, and its compensator."""
    if given is None:
        return "raw", None, None
    calibration, part = given, ""
    if not isinstance(calibration, Calibration):
        path, _, part = str(given).partition("#")
        if part not in ("", LEAST_SQUARES):
            raise InputError(f"'{given}' ends in #{part}; a calibration is whole, or #{LEAST_SQUARES}")
        calibration = Calibration.load(path, arm)
    obey(calibration.reservations(), allow)
    if part:
        calibration = calibration.without_residual()
    return stage_label(calibration), calibration, calibration.compensator()


def _name(policy: Given) -> str:
    return policy_name(str(policy)) if isinstance(policy, str | Path) else type(policy).__name__


def _labels(policies: Sequence[str], stages: Sequence[str]) -> list[str]:
    """Names that say what differs: the stage, the policy, or both."""
    if len(policies) == 1:
        return [policies[0] if stages[0] == "raw" else stages[0]]
    if len(set(policies)) == 1:
        return list(stages)
    if len(set(stages)) == 1:
        return list(policies)
    return [f"{policy}, {stage}" for policy, stage in zip(policies, stages, strict=True)]
