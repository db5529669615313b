"""Rows that stand against what is said of the arm or its frames: a good fit to them is named, and never called good."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Plant, Pose, draw_plants, load_arm, load_plant, load_tolerances, plant_at, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import Choices, calibrate, random_joints, simulated_tracker

PLAIN = Choices(terms="none", residual="none")


def rows_of(name, seed=0, count=150):
    """Rows of an arm of the class cobot, by a tracker registered to its base."""
    arm = load_arm(name)
    drawn = draw_plants(Plant(name, arm, arm.nominal), load_tolerances("cobot"), 1, np.random.default_rng(seed))
    rng = np.random.default_rng(seed + 1)
    rows = simulated_tracker(plant_at(drawn, 0), random_joints(arm.nominal, count, rng), rng)
    return replace(rows, position=rows.position + rows.position_std * rng.standard_normal(rows.position.shape))


def causes(result):
    return " ".join(text for weight, text in result.quality.findings if weight != "note")


@pytest.mark.parametrize("seed", [0, 1, 2])
@pytest.mark.parametrize("frames", ["known", "fitted"])
def test_an_arm_of_its_class_is_not_accused(seed, frames):
    found = calibrate("ur5", rows_of("ur5", 10 * seed), choices=replace(PLAIN, frames=frames))
    assert found.quality.grade == "good", found.quality.reason


@pytest.mark.parametrize(("made", "named"), [("ur5e", "ur5"), ("ur5", "ur5e")])
def test_rows_of_another_arm_are_named(made, named):
    """The fit is splendid, and its links lie centimetres from the drawing of the arm that was named."""
    found = calibrate(named, rows_of(made), choices=replace(PLAIN, frames="fitted"))
    assert found.quality.grade != "good"
    assert "may be of another arm" in causes(found) and found.quality.reason.startswith("d")


@pytest.mark.parametrize("millimetres", [3, 10, 50])
def test_a_base_that_stands_elsewhere_is_named(millimetres):
    rows = rows_of("ur5")
    found = calibrate(
        "ur5", replace(rows, position=rows.position + np.array([millimetres * 1e-3, 0, 0])), choices=PLAIN
    )
    assert found.quality.grade != "good" and "the base is said to be known" in causes(found)
    assert "`frames='fitted'`" in causes(found)


def test_a_base_that_is_turned_is_named():
    rows, turn = rows_of("ur5"), rotation_matrix(np.array([np.radians(1.0), 0.0, 0.0]))
    turned = replace(rows, position=rows.position @ turn.T, rotation=turn @ rows.rotation)
    found = calibrate("ur5", turned, choices=PLAIN)
    assert found.quality.grade != "good" and "the base is said to be known" in causes(found)


def test_a_longer_tool_is_named():
    """The reflector stands 10 mm beside where it is said to be."""
    arm = load_arm("ur5")
    rows = rows_of("ur5")
    beside = Pose(np.array([0.01, 0.0, 0.0]), np.eye(3))
    moved = replace(rows, position=rows.position + rows.rotation @ beside.position)
    found = calibrate(arm, moved, choices=PLAIN)
    assert found.quality.grade != "good" and "the tool is said to be known" in causes(found)


def test_a_region_that_behaves_otherwise_is_named():
    """The arm sags by 8 mm where its second joint is high, in a third of the rows."""
    rows = rows_of("ur5", count=200)
    high = rows.joints[:, 1] > np.quantile(rows.joints[:, 1], 0.67)
    found = calibrate("ur5", replace(rows, position=rows.position - np.outer(high, [0, 0, 8e-3])), choices=PLAIN)
    assert found.quality.grade != "good" and "J2 shoulder is above" in causes(found)


def test_other_rows_to_judge_by_leave_nothing_to_split() -> None:
    plant, rng = load_plant("qiao2026"), np.random.default_rng(0)
    train, test = (simulated_tracker(plant, random_joints(plant.arm.nominal, count, rng), rng) for count in (20, 10))
    for more in ({"split": "blocked"}, {"test_rows": 5}):
        with pytest.raises(InputError, match=f"`{next(iter(more))}=.*` holds rows of the data out, but `test` gives"):
            calibrate(plant.arm, train, test=test, **more)
    for more in ({"tolerances": "no_such_class"}, {"prior_scale": 0.1}):
        with pytest.raises(InputError, match=f"so `{next(iter(more))}` says nothing"):
            calibrate(plant.arm, train, test=test, choices=Choices(fit="full", **more))
