"""A compliant hand forgives centimetres, Li's cup 5 mm."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pickenv.base import InputError
from pickenv.orchard import CompliantHand, Cup, capture_probability, load_gripper, misalignment

quick = settings(deadline=None, derandomize=True)

vectors = st.tuples(*[st.floats(-0.2, 0.2)] * 3)


@pytest.fixture(scope="module")
def picks(data_folder: Path) -> tuple[np.ndarray, np.ndarray]:
    """Misalignments (lateral, axial, angle; m, rad) and outcomes of the picks on the tree proxy."""
    with (data_folder / "pickapp-osu" / "proxy_pick_metadata.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    offset = np.array([[float(row[f"noise_{axis}_m"]) for axis in "xyz"] for row in rows])
    turn = np.array([[float(row[f"noise_{axis}_rad"]) for axis in ("roll", "pitch", "yaw")] for row in rows])
    measured = [np.hypot(offset[:, 0], offset[:, 1]), np.abs(offset[:, 2]), np.linalg.norm(turn, axis=-1)]
    return np.stack(measured, axis=-1), np.array([row["outcome"] == "s" for row in rows], dtype=float)


def logistic_fit(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Maximum-likelihood coefficients and their standard errors."""
    x = np.column_stack([np.ones(len(x)), x])
    w = np.zeros(x.shape[1])
    for _ in range(30):
        p = 1 / (1 + np.exp(-x @ w))
        information = x.T @ (x * (p * (1 - p))[:, None])
        w = w + np.linalg.solve(information, x.T @ (y - p))
    return w, np.sqrt(np.diag(np.linalg.inv(information)))


def test_the_hand_is_the_logistic_fit_to_419_picks(picks: tuple[np.ndarray, np.ndarray]) -> None:
    x, outcome = picks
    hand = load_gripper("compliant_hand")
    assert isinstance(hand, CompliantHand) and len(outcome) == 419
    fitted, error = logistic_fit(x, outcome)
    ours = np.array([hand.intercept, -hand.lateral, -hand.axial, -hand.angle])
    assert (np.abs(fitted - ours) < 0.1 * error).all()  # the same data: equal to the rounding of the coefficients


def test_the_hand_succeeds_as_often_as_the_picks_did(picks: tuple[np.ndarray, np.ndarray]) -> None:
    x, outcome = picks
    expected = capture_probability(load_gripper("compliant_hand"), *x.T)
    for low, high in ((0.0, 0.01), (0.01, 0.02), (0.02, 0.03), (0.03, 0.05)):
        bin_ = (x[:, 0] >= low) & (x[:, 0] < high)
        error = np.sqrt(np.mean(expected[bin_] * (1 - expected[bin_])) / bin_.sum())
        assert abs(outcome[bin_].mean() - expected[bin_].mean()) < 3 * error


def test_calibration_decides_with_the_cup_and_helps_with_the_hand() -> None:
    """From 6.3 mm to 0.46 mm: everything for Li's cup, a few points for the compliant hand."""
    before, after = (capture_probability(load_gripper("li_cup"), e, 0.0, 0.0) for e in (6.3e-3, 0.46e-3))
    assert (before, after) == (0.0, 1.0)
    hand = load_gripper("compliant_hand")
    before, after = (capture_probability(hand, e, 0.01, 0.0) for e in (6.3e-3, 0.46e-3))
    assert 0.03 < after - before < 0.08


def test_lis_cup_clears_five_millimetres() -> None:
    cup = load_gripper("li_cup")
    assert isinstance(cup, Cup) and (cup.opening - cup.fruit) / 2 == pytest.approx(0.005)
    assert capture_probability(cup, [0.0049, 0.0051], 0.0, 0.0).tolist() == [1.0, 0.0]
    assert capture_probability(cup, 0.0, 0.0, 0.0, diameter=0.0749) == 0.0  # a real apple does not fit


@quick
@given(st.floats(0, 0.1), st.floats(0, 0.1), st.floats(0, 1), st.floats(0, 0.05))
def test_more_misalignment_never_helps(lateral: float, axial: float, angle: float, more: float) -> None:
    for name in ("li_cup", "compliant_hand"):
        gripper = load_gripper(name)
        here = capture_probability(gripper, lateral, axial, angle)
        assert 0.0 <= here <= 1.0
        assert capture_probability(gripper, lateral + more, axial, angle) <= here
        assert capture_probability(gripper, lateral, axial + more, angle) <= here
        assert capture_probability(gripper, lateral, axial, angle + more) <= here
        assert capture_probability(gripper, -lateral, -axial, -angle) == here


@quick
@given(vectors, vectors)
def test_lateral_and_axial_are_the_offsets_two_legs(offset: tuple, axis: tuple) -> None:
    axis = np.add(axis, [0.0, 0.0, 1.0])
    lateral, axial, angle = misalignment(offset, axis)
    assert np.hypot(lateral, axial) == pytest.approx(np.linalg.norm(offset), abs=1e-12)
    assert axial == pytest.approx(np.dot(offset, axis) / np.linalg.norm(axis), abs=1e-12)
    assert angle == 0.0


def test_the_angle_is_that_between_the_axes_small_ones_too() -> None:
    for angle in (0.0, 1e-9, 0.3, np.pi / 2, np.pi):
        *_, found = misalignment(np.zeros(3), [0, np.sin(angle), np.cos(angle)], [0, 0, 2.0])
        assert found == pytest.approx(angle, rel=1e-6, abs=1e-15)


def test_a_hand_that_forgives_any_lateral_miss_is_refused(tmp_path: Path) -> None:
    path, values = (
        tmp_path / "hand.toml",
        "intercept=2.0\nlateral_per_10mm=0.0\naxial_per_10mm=0.3\nangle_per_10deg=0.0",
    )
    path.write_text(f'name="h"\nkind="hand"\nsource="x"\n{values}\n', encoding="utf-8")
    with pytest.raises(InputError, match="lateral"):
        load_gripper(path)
