"""From an arm's errors at its fruit to its row: each column recomputed, and who counts as judged."""

from types import SimpleNamespace

import numpy as np
import pytest

from pickenv.experiments import study


def test_every_column_is_its_statistic_in_mm_and_degrees():
    rng = np.random.default_rng(0)
    position, attitude = rng.gamma(2.0, 4e-4, (5, 21)), rng.gamma(2.0, 1e-3, (5, 21))
    found = study.figures(position, attitude, 0.7)
    for arm in range(5):
        mm = np.sort(1e3 * position[arm])
        expected = {
            "error_mean_mm": mm.sum() / 21,
            "error_rms_mm": np.sqrt((mm**2).sum() / 21),
            "error_p50_mm": mm[10],  # 21 values: the 11th
            "error_p95_mm": mm[19],  # 0.95 * 20 is 19
            "error_max_mm": mm[20],
            "attitude_mean_deg": attitude[arm].sum() / 21 * 180 / np.pi,
            "share_within": np.count_nonzero(mm <= 0.7) / 21,
        }
        assert {name: values[arm] for name, values in found.items()} == pytest.approx(expected)
    edge = study.figures(np.array([[0.5e-3, 1e-3]]), np.zeros((1, 2)), 1.0)
    assert edge["share_within"][0] == 1.0  # at the radius itself is within


@pytest.mark.parametrize(("missed", "ok"), [(0, True), (2, True), (3, False), (10, False)])
def test_an_arm_may_miss_as_many_fruit_as_the_required_share_leaves(missed, ok):
    config = SimpleNamespace(fruit=10, share=0.8, radius_mm=1.5)
    said = study.reach_status(missed, config)
    assert (said == study.OK) == ok
    assert ok or (said.startswith(f"{missed} of 10 fruit are out of this arm's reach") and "1.5 mm away" in said)


def test_only_arms_with_finite_errors_and_no_complaint_are_judged():
    setting = study.Setting(0, "medium", 8, 12, 0.1, 0.2, 0.0, "ls")
    position, attitude = np.full((4, 3), 1e-3), np.full((4, 3), 1e-3)
    position[1, 2], attitude[2, 0] = np.nan, np.inf
    outcomes = study.outcomes_of(
        setting, [study.OK, study.OK, study.OK, "did not converge"], [3, 4, 5, 6], position, attitude
    )
    columns = study._columns(range(10, 14), outcomes, 1.0)
    assert columns["status"].tolist() == [
        study.OK,
        study.NOT_FINITE,
        study.NOT_FINITE,
        "did not converge",
    ]
    assert columns["arm"].tolist() == [10, 11, 12, 13] and columns["iterations"].tolist() == [3, 4, 5, 6]
    assert np.isfinite(columns["error_mean_mm"]).tolist() == [True, False, False, False]
    assert columns["error_mean_mm"][0] == pytest.approx(1.0) and columns["share_within"][0] == 1.0
