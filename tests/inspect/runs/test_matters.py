"""Whether calibration changes picks, computed anew by drawing perception errors and by the grippers' own limits."""

from typing import Any

import numpy as np
import pytest

from pickenv.inspect import matters, pick_changes
from pickenv.inspect.runs.comparison_summary import MATTERS, PERCEPTION_MM, pick_share
from pickenv.orchard import Cup, capture_probability, load_gripper


def change(gripper: str, perception_mm: float, before: float, after: float) -> dict[str, Any]:
    return {"gripper": gripper, "perception_mm": perception_mm, "before": before, "after": after}


@pytest.mark.parametrize("name", ["li_cup", "compliant_hand"])
@pytest.mark.parametrize("seen", [0.0, 2.0, 5.0])
def test_a_share_is_that_of_drawn_perception_errors(name: str, seen: float) -> None:
    rng, gripper, own = np.random.default_rng(8), load_gripper(name), np.array([0.5, 2.0, 6.0])
    noise = rng.normal(scale=seen, size=(2, 40_000, 3)) if seen else np.zeros((2, 1, 3))
    lateral = np.hypot(own + noise[0], noise[1])
    drawn = capture_probability(gripper, 1e-3 * lateral, 0.0, 0.0).mean()
    assert pick_share(gripper, own, seen) == pytest.approx(drawn, abs=0.012)


def test_a_cup_takes_what_its_clearance_allows() -> None:
    cup = load_gripper("li_cup")
    assert isinstance(cup, Cup)
    clearance = 1e3 * (cup.opening - cup.fruit) / 2
    assert pick_share(cup, [0.9 * clearance, 1.1 * clearance], 0.0) == 0.5


def test_every_gripper_and_perception_error_is_told() -> None:
    changes = pick_changes([3.0, 4.0], [0.1, 0.2])
    assert len(changes) == 2 * len(PERCEPTION_MM)
    assert all(c["after"] >= c["before"] for c in changes)


def test_the_sentence_says_for_which_gripper_and_perception_error() -> None:
    some = [change("cup", 0.0, 1.0, 1.0), change("cup", 2.0, 0.6, 0.9), change("hand", 0.0, 0.9, 0.91)]
    said = matters("orchard", some)
    assert said.startswith(
        "On orchard this changes picks with cup and the fruit seen to 2 mm per axis: 60 % taken without, 90 %"
    )
    assert (
        "Were the fruit seen without error, it would change none (100 % taken without, 100 % with calibration)" in said
    )
    assert "Hardly a pick changes with hand (90 % taken without, 91 % with calibration)" in said
    few = matters("orchard", [change("cup", 0.0, 0.96, 1.0), change("cup", 2.0, 0.6, 0.9)])
    assert "it would change hardly any (96 % taken without, 100 % with calibration)" in few
    least = [change("cup", 2.0, 0.9, 0.9 + 0.6 * MATTERS), change("hand", 0.0, 0.9, 0.9)]
    assert matters("arm", least).startswith("On arm this changes no more than 3 of 100 picks, with any gripper")
    worse = [change("cup", 0.0, 0.9, 0.8)]
    assert matters("arm", worse) == (
        "On arm this changes picks with cup and the fruit seen without error: 90 % taken without, "
        "80 % with calibration."
    )
