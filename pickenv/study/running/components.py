"""Where the differences between arms' errors come from: the arms themselves, their fruit, their poses, the tracker.

Each is drawn again while the others are held, on arms beyond the study's own. Figure: the radius that holds the
required share of an arm's fruit, which decides whether it is within specification. Its logarithm, so that a share is
one of relative errors, and a few bad arms do not decide alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.plant.plant import Plant
from pickenv.errors import InputError
from pickenv.study.design.config import LS, RAW, Setting
from pickenv.study.design.protocol import Circumstances, Protocol
from pickenv.study.results.quantiles import variance_indices
from pickenv.study.results.row_table import OK

MOST, LEAST = 256, 30
"""Arms of the design at most, and fewest for which it is made: of 20 arms intervals of totals hold 92 %."""


def components_of(protocol: Protocol, setting: Setting) -> list[dict[str, Any]]:
    """Shares of the variance of the arms' logarithmic errors in one setting.

    Args:
        protocol: The study; as many arms are drawn as it has, from `LEAST` to `MOST`, and each is judged six times.
        setting: One of its settings, raw or least squares.

    Returns:
        As `variance_indices`, of the groups arms, fruit, and for least squares poses and tracker; with the number of
        ``arms``.

    Raises:
        InputError: If the setting's method is another, or too few arms can be judged.
    """
    if setting.method not in (RAW, LS):
        raise InputError(f"components of variance of method '{setting.method}' would take too long")
    count = min(MOST, protocol.config.arms)
    if count < LEAST:
        raise InputError(f"{count} arms are too few to divide their variance; give {LEAST}")
    begin = protocol.config.arms  # arms that the study has not
    numbers = range(begin, begin + count), range(begin + count, begin + 2 * count)
    (arms, again), (given, other) = (
        [protocol.draw(setting, part) for part in numbers],
        [[protocol.circumstances(number) for number in part] for part in numbers],
    )
    pairs = list(zip(given, other, strict=True))
    causes: dict[str, tuple[Plant, list[Circumstances]]] = {
        "arms": (again, given),
        "fruit": (arms, [replace(one, fruit=new.fruit) for one, new in pairs]),
    }
    if setting.poses:
        causes["poses"] = arms, [replace(one, poses=new.poses) for one, new in pairs]
        causes["tracker"] = arms, [replace(one, tracker=new.tracker) for one, new in pairs]
    every = np.stack([_log_errors(protocol, setting, *case) for case in ((arms, given), (again, other))])
    mixed = np.stack([_log_errors(protocol, setting, *case) for case in causes.values()])
    judged = np.isfinite(every).all(axis=0) & np.isfinite(mixed).all(axis=0)
    if judged.sum() < LEAST:
        raise InputError(f"only {judged.sum()} of {count} arms can be judged, too few to divide their variance")
    first, second = every[:, judged, None]
    rows = variance_indices(first, second, mixed[:, judged, None], list(causes))
    return [row | {"arms": int(judged.sum())} for row in rows]


def _log_errors(protocol: Protocol, setting: Setting, arms: Plant, given: Sequence[Circumstances]) -> Array:
    """Logarithms of the radii that hold the required share of the arms' fruit ``(N,)``; NaN for an arm not judged."""
    from pickenv.study.running.batched import judge_batch

    outcomes = judge_batch(protocol, setting, arms, given)
    radius = np.quantile(outcomes.position, protocol.config.share, axis=1)
    return np.log(np.where([text == OK for text in outcomes.status], radius, np.nan))
