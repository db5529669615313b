"""Single arms within a study: which arm of a setting is the best, and where an arm of known geometry would stand.

The design's own true arm (for `qiao2026` the true values of the paper's Table 1) can so be placed in the population
that its tolerance class would make. Errors are means over the study's fruit, mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import pyarrow.compute as pc
from pyarrow.dataset import Dataset

from pickenv.arm.plant.plant import Plant
from pickenv.errors import InputError
from pickenv.intervals import share_interval as wilson_interval
from pickenv.study.design.config import Setting
from pickenv.study.design.protocol import Protocol
from pickenv.study.results.outcomes import figures
from pickenv.study.results.row_table import OK
from pickenv.study.results.streaming import grouped
from pickenv.study.running.arm_by_arm import evaluate_arm

ERROR = "error_mean_mm"


@dataclass(frozen=True)
class Placement:
    """Where an arm stands in the population of a setting.

    Attributes:
        setting: The setting's number.
        arm: The arm's name.
        error_mm: Its mean position error under the same calibration, on the same fruit.
        arms: Number of arms of the population that have a result.
        percentile: Share of them with a smaller error, 0..1.
        interval: Wilson's 95 % interval of that share.
    """

    setting: int
    arm: str
    error_mm: float
    arms: int
    percentile: float
    interval: tuple[float, float]


def place(protocol: Protocol, rows: Dataset, setting: Setting, arm: Plant, name: str) -> Placement:
    """Calibrate and judge ``arm`` as the setting says, and find its place among the setting's arms.

    Args:
        protocol: The study.
        rows: Its rows.
        setting: One of its settings.
        arm: A single true arm; it need not be of the setting's population.
        name: What it is called.

    Raises:
        InputError: If the arm has no result in this setting, or no other arm has.
    """
    (outcome,) = evaluate_arm(protocol, [setting], arm, protocol.config.arms)  # a number, and tracker, of its own
    if outcome.status[0] != OK:
        raise InputError(f"{name} has no place in setting {setting.number}: {outcome.status[0]}")
    error = float(figures(outcome.position, outcome.attitude, protocol.config.radius_mm)[ERROR][0])
    table = grouped(
        rows,
        {"below": pc.if_else(pc.field(ERROR) < error, 1, 0)},
        [("below", "hash_sum", None, "below"), ("below", "hash_count", None, "arms")],
        (pc.field("setting") == setting.number) & (pc.field("status") == OK),
    ).to_pylist()
    if not table:
        raise InputError(f"no arm of setting {setting.number} has a result; give another setting")
    below, arms = table[0]["below"], table[0]["arms"]
    return Placement(setting.number, name, error, arms, below / arms, wilson_interval(below, arms))


def ranked(rows: Dataset, setting: int) -> dict[str, tuple[int, float]]:
    """Number and mean error in mm of the worst, the median and the best arm of a setting.

    Raises:
        InputError: If no arm of the setting has a result.
    """
    chosen = (pc.field("setting") == setting) & (pc.field("status") == OK)
    table = rows.to_table(columns=["arm", ERROR], filter=chosen, use_threads=False)
    if not table.num_rows:
        raise InputError(f"no arm of setting {setting} has a result; give another setting")
    order = table.sort_by([(ERROR, "descending"), ("arm", "ascending")]).to_pydict()
    places = {"worst": 0, "median": table.num_rows // 2, "best": table.num_rows - 1}
    return {name: (order["arm"][i], order[ERROR][i]) for name, i in places.items()}
