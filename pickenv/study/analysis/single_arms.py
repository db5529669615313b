"""Single arms within a study: which arm of a setting is the best, and where an arm of known geometry would stand.

The design's own true arm (for `qiao2026` the true values of the paper's Table 1) can so be placed in the population
that its tolerance class would make: it meets what the population's arms meet, and is compared with each of them at that
arm's own fruit, poses and tracker. Errors are means over an arm's fruit, mm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pyarrow.compute as pc
from pyarrow.dataset import Dataset

from pickenv.arm.plant.plant import Plant
from pickenv.errors import InputError
from pickenv.intervals import share_interval
from pickenv.study.design.config import LS, RAW, Setting
from pickenv.study.design.protocol import Protocol
from pickenv.study.results.outcomes import figures, gathered
from pickenv.study.results.row_table import OK
from pickenv.study.running.arm_by_arm import evaluate_arm

ERROR = "error_mean_mm"


MOST = {RAW: 1000, LS: 1000}
"""Arms that an arm is compared with at most, by method."""
MOST_LEARNT = 20
"""The same for methods that learn, which take seconds for each."""


@dataclass(frozen=True)
class Placement:
    """Where an arm stands in the population of a setting.

    Attributes:
        setting: The setting's number.
        arm: The arm's name.
        error_mm: Its mean position error under the same calibration, over all fruit and poses that it met.
        arms: Number of arms of the population that it was compared with.
        percentile: Share of them with a smaller error in the same circumstances, 0..1.
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
    count = min(protocol.config.arms, MOST.get(setting.method, MOST_LEARNT))
    given = [protocol.circumstances(number) for number in range(count)]
    outcomes = gathered([evaluate_arm(protocol, [setting], arm, each)[0] for each in given])
    judged = np.array([text == OK for text in outcomes.status])
    if not judged.any():
        raise InputError(f"{name} has no place in setting {setting.number}: {outcomes.status[0]}")
    own = np.where(judged, figures(outcomes.position, outcomes.attitude, protocol.config.radius_mm)[ERROR], np.nan)
    chosen = (pc.field("setting") == setting.number) & (pc.field("status") == OK) & (pc.field("arm") < count)
    table = rows.to_table(columns=["arm", ERROR], filter=chosen, use_threads=False)
    against = own[table["arm"].to_numpy()]
    compared = np.isfinite(against)
    if not compared.any():
        raise InputError(f"no arm of setting {setting.number} has a result; give another setting")
    below, arms = int(np.sum((table[ERROR].to_numpy() < against)[compared])), int(compared.sum())
    error = float(np.mean(own[judged]))
    return Placement(setting.number, name, error, arms, below / arms, share_interval(below, arms))


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
