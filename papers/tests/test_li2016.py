"""Verdicts on Li et al. 2016 follow the numbers that stand beside them."""

import importlib
from typing import NoReturn

import numpy as np
import pytest
import typer
from scipy.ndimage import binary_dilation, binary_erosion, label
from typer.testing import CliRunner

from papers.li2016 import verdicts
from papers.li2016.comparison import displacements
from papers.li2016.equations import EXACT, PAPER, chained, equations
from papers.li2016.lab import sample_image
from papers.li2016.prediction import OPEN, Sessions, machine_with, picking_with, prediction
from papers.li2016.segmentation import figure_5, segmentation
from pickenv.harvester import Measure, load_machine, load_true_machine


def test_table_2_is_exact_for_one_spacing_which_is_not_the_papers() -> None:
    table = verdicts.table_2(PAPER["table2"], {spacing: displacements(spacing * 1e-3) for spacing in (300, 350, 450)})
    assert table["verdict"] == "reproduced" and table["exact_for_spacing_mm"] == [450]
    assert "450 mm" in table["reason"]
    middle = {name: list(values) for name, values in PAPER["table2"].items()}
    off = verdicts.table_2(
        {**middle, "left": [81.0, *middle["left"][1:]]}, {s: displacements(s * 1e-3) for s in (350, 450)}
    )
    assert off["verdict"] == "not reproduced" and "exact for no spacing" in off["reason"]


@pytest.mark.parametrize(("heights", "verdict"), [((800.0, 2900.0), "reproduced"), ((800.0, 2950.0), "not reproduced")])
def test_table_1_by_the_height_at_which_the_machine_works(heights: tuple[float, float], verdict: str) -> None:
    table = verdicts.table_1(heights, (1390.0, 3490.0))
    assert table["verdict"] == verdict and "1390 to 3490 mm" in table["reason"]


def test_table_3_is_a_fit_where_spans_overlap_and_never_a_result() -> None:
    paper = {"master": (3.0, 5.9), "left": (6.6, 8.4)}
    for size, verdict in ((1.0, "fitted"), (3.0, "not reproduced")):
        errors = {"raw": size * np.array([[4.0, 7.0], [5.0, 8.0]])}
        table = verdicts.table_3(paper, errors, ("master", "left"))
        assert table["verdict"] == verdict
        assert table["rows"][1]["raw"] == [7.0 * size, 8.0 * size]


def test_the_workspace_counts_what_lies_in_the_printed_box() -> None:
    inside, outside = np.array([[0.0, -1000.0, 1000.0]]), np.array([[0.0, -400.0, 1000.0]])
    for share, verdict in ((1.0, "reproduced"), (0.8, "not reproduced")):
        counts = [round(100 * share), 100 - round(100 * share)]
        cloud = np.repeat([inside[0], outside[0]], counts, axis=0)
        found = verdicts.figure_8(cloud, np.repeat([10.0, 80.0], counts), 51.34)
        assert found["share_in_box"] == pytest.approx(share) and found["verdict"] == verdict
        assert found["share_in_box_within_fig_2"] == 1.0


def test_figure_2_follows_from_the_size_of_the_area() -> None:
    reached = np.array([3, 3, 2, 0])
    for length, verdict in ((2000.0, "reproduced"), (1990.0, "not reproduced")):
        found = verdicts.figure_2(PAPER, length, (800.0, 2900.0), reached)
        assert found["verdict"] == verdict and "51.34 deg" in found["reason"] and "1877 mm" in found["reason"]
        assert found["share_reached"] == 0.75
    wider = {**PAPER, "orchard": {**PAPER["orchard"], "work_width": 2.6}}
    assert verdicts.figure_2(wider, 2000.0, (800.0, 2900.0), reached)["verdict"] == "not reproduced"


def test_a_pick_point_is_the_papers_within_a_centimetre() -> None:
    reach = {"as_printed": 0.1, "equations": 0.8, "corrected": 0.9, "search": 1.0}
    for off, verdict in ((9.0, "reproduced"), (11.0, "not reproduced")):
        rows = [{"method": "the paper's", "pick_point_mm": [-80, -660, 1220], "apart_mm": 0.0}]
        rows += [{"method": name, "pick_point_mm": [-80, -660, 1220 + off], "apart_mm": off} for name in reach]
        found = verdicts.pick_points((-80, -660, 1220), rows, reach)
        assert found["verdict"] == verdict and found["apart_mm"] == off
        assert [row["share_of_drawn_fruit"] for row in found["rows"]] == [None, *reach.values()]


def test_curves_have_to_end_at_table_2() -> None:
    ends = {name: list(values) for name, values in PAPER["table2"].items()}
    assert verdicts.figure_9(PAPER["table2"], ends, 450)["verdict"] == "reproduced"
    ends["right"][1] = -0.237  # as with 350 mm
    assert verdicts.figure_9(PAPER["table2"], ends, 350)["verdict"] == "not reproduced"


def sessions_of(recovered: list[float]) -> Sessions:
    order = np.linspace(0, 1, len(recovered))
    return Sessions(np.array(recovered), 56, {name: each.at(order) for name, each in OPEN.items()})


@pytest.mark.parametrize(
    ("low", "high", "verdict", "words"),
    [
        (40, 50, "reproduced", "lies within"),
        (30, 40, "not reproduced", "lies outside"),
        (10, 56, "not reproduced", "an interval wider than 28 says nothing"),
    ],
)
def test_the_experiment_is_predicted_and_never_fitted(low: int, high: int, verdict: str, words: str) -> None:
    found = prediction(PAPER["picking"], sessions_of(list(np.repeat(np.arange(low, high + 1.0), 20))))
    assert found["verdict"] == verdict and words in found["reason"]
    assert sum(found["counts"]) == 20 * (high - low + 1) and len(found["counts"]) == 57
    (row,) = found["rows"]
    assert row["paper"] == [46, 56] and low <= row["prediction_95_percent"][0] <= row["median"] <= high


def test_each_quantile_of_the_sessions_has_an_interval_which_narrows_with_their_number() -> None:
    """Those of all shares are bounded from 200 sessions on, as many as a quick run has."""
    rng, widths = np.random.default_rng(3), []
    for count in (200, 800, 3200):
        recovered = rng.binomial(56, 0.6, count).astype(float)
        quantiles = prediction(PAPER["picking"], sessions_of(recovered.tolist()))["quantiles"]
        assert [row["share"] for row in quantiles] == [0.025, 0.25, 0.5, 0.75, 0.975]
        for row in quantiles:
            low, high = row["ci95"]
            assert low <= row["apples"] <= high
            assert row["apples"] == np.quantile(recovered, row["share"], method="inverted_cdf")
        widths.append(sum(row["ci95"][1] - row["ci95"][0] for row in quantiles))
    assert widths == sorted(widths, reverse=True) and widths[0] > 1.5 * widths[-1]


def test_open_constants_fill_their_ranges_and_reach_the_model() -> None:
    for name, each in OPEN.items():
        assert each.at(np.array([0.0, 1.0])) == pytest.approx([each.low, each.high])
        assert each.low < each.high and each.why
        if each.even_in_log:
            assert each.at(np.array(0.5)) == pytest.approx(np.sqrt(each.low * each.high)), name
    low, high = (picking_with({name: getattr(each, end) for name, each in OPEN.items()}) for end in ("low", "high"))
    for key in ("gather", "push", "push_spread", "lasting", "cut_success", "undamaged"):
        assert np.all(np.array(getattr(low, key)) < np.array(getattr(high, key))), key
    assert high.push == pytest.approx(0.032)


def test_a_camera_that_errs_sends_the_cup_as_far_aside() -> None:
    """A cup's stop is the sum of two arms' errors; with the camera's it has the variance of all three."""
    true = load_true_machine(load_machine())
    found = machine_with(true, {"sideways": 3.0, "depth": 9.0})
    drawn = np.random.default_rng(0).normal(size=(20_000, 2, 3)).sum(axis=1) * found.repeatability
    wanted = np.sqrt(2 * true.repeatability**2 + (np.array([3.0, 9.0, 3.0]) * 1e-3) ** 2)
    np.testing.assert_allclose(drawn.std(axis=0), wanted, rtol=0.03)


def test_printed_equations_are_held_against_a_product_of_transforms() -> None:
    """The judge itself is checked: the machine's cup is a product of eq (1) with theta4 = +pi/2."""
    machine, rng = load_machine(), np.random.default_rng(1)
    for _ in range(20):
        q = rng.uniform(machine.lower, machine.upper)
        tips = machine.tips(q[:3], q[3:].reshape(machine.arms, 3))
        for i, offset in enumerate(machine.offsets):
            chain = chained(machine, q[:3], q[3 + 3 * i : 6 + 3 * i], offset)
            np.testing.assert_allclose(chain[:3, 3], tips[i], atol=1e-12)
            assert np.linalg.det(chain[:3, :3]) == pytest.approx(1.0)
    found = equations(machine, load_machine(spacing=EXACT), rng)
    holds = {name: part["verdict"] == "reproduced" for name, part in found.items()}
    assert holds == {"1": False, "2-3": True, "4": True, "5": True, "6": False, "7": False, "8": True} | {
        "9": False,
        "10-12": False,
    }
    for part in found.values():
        (row,) = part["rows"]
        assert (part["verdict"] == "reproduced") == (row["as_printed_misses_mm"] < 1e-6)
        assert row["corrected_misses_mm"] is None or row["corrected_misses_mm"] < 1e-6
    assert "1.25 to 1.52 m off" in found["6"]["reason"] and "3 of the paper's own three" in found["6"]["reason"]
    assert "determinant -1" in found["4"]["reason"]


def test_segmentation_takes_the_steps_one_by_one() -> None:
    pytest.importorskip("skimage")
    rng = np.random.default_rng(5)
    found = segmentation(sample_image(load_machine(), rng), rng)
    otsu, eroded, fifth, dilated = found.masks.values()
    assert np.all(eroded <= otsu) and np.all(fifth <= eroded) and np.all(fifth <= dilated)
    np.testing.assert_array_equal(binary_erosion(otsu, np.ones((3, 3)), 2, border_value=1), eroded)
    np.testing.assert_array_equal(binary_dilation(fifth, np.ones((3, 3)), 2), dilated)
    labels, count = label(eroded, np.ones((3, 3)))
    areas = np.bincount(labels.ravel())[1:]
    kept = 1 + np.flatnonzero(areas >= areas.max() / 5)
    np.testing.assert_array_equal(np.isin(labels, kept), fifth)
    judged = figure_5(found)
    assert [row["regions"] for row in judged["rows"]] == [label(m, np.ones((3, 3)))[1] for m in found.masks.values()]
    assert count >= len(kept) and judged["fruit"] == 7
    assert judged["verdict"] == ("reproduced" if judged["largest_centroid_error_px"] <= 1.0 else "not reproduced")


@pytest.mark.parametrize(
    ("low", "high", "verdict", "words"),
    [
        (0.80, 0.84, "reproduced", "lies within; 46 of 56"),
        (0.75, 0.79, "not reproduced", "lies outside; 46 of 56"),
        (0.78, 0.85, "not reproduced", "an interval wider than 5 points says nothing"),
        (None, None, "not reproduced", "an interval wider than 5 points says nothing"),
    ],
)
def test_what_own_eyes_recover_is_held_against_the_papers_share(
    low: float | None, high: float | None, verdict: str, words: str
) -> None:
    recovery = {"raw": Measure(0.8, low, high), "circles": Measure(0.97)}
    found = verdicts.own_eyes(PAPER["picking"], recovery, "li2016_bare", "measured_errors", 400)
    assert found["verdict"] == verdict and words in found["reason"] and "70% to 90%" in found["reason"]
    assert [row["paper_percent"] for row in found["rows"]] == [pytest.approx(100 * 46 / 56), None]


def test_a_vision_that_there_is_not_is_refused_before_anything_is_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    program = importlib.import_module("papers.li2016.__main__")

    def never() -> NoReturn:
        raise AssertionError("the machine was loaded")

    monkeypatch.setattr(program, "load_machine", never)
    app = typer.Typer()
    app.command()(program.main)
    found = CliRunner().invoke(app, ["--quick", "--vision", "eagle"])
    assert found.exit_code == 2 and "'eagle' is not one of" in found.output
