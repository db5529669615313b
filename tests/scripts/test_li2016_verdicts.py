"""Verdicts on Li et al. 2016 follow the numbers that stand beside them."""

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))

from papers import li2016_verdicts as verdicts
from reproduce_li2016 import TABLE2, table2


def test_table_2_is_exact_for_one_spacing_which_is_not_the_papers() -> None:
    table = verdicts.table_2(TABLE2, {spacing: table2(spacing * 1e-3) for spacing in (300, 350, 450)})
    assert table["verdict"] == "reproduced" and table["exact_for_spacing_mm"] == [450]
    assert "450 mm" in table["reason"]
    middle = {name: list(values) for name, values in TABLE2.items()}
    off = verdicts.table_2({**middle, "left": [81.0, *middle["left"][1:]]}, {s: table2(s * 1e-3) for s in (350, 450)})
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
        cloud = np.repeat([inside[0], outside[0]], [round(100 * share), 100 - round(100 * share)], axis=0)
        found = verdicts.figure_8(cloud)
        assert found["share_in_box"] == pytest.approx(share) and found["verdict"] == verdict


def test_a_pick_point_is_the_papers_within_a_centimetre() -> None:
    reach = {"as_printed": 0.1, "equations": 0.8, "corrected": 0.9, "search": 1.0}
    for off, verdict in ((9.0, "reproduced"), (11.0, "not reproduced")):
        found = verdicts.pick_points((-80, -660, 1220), np.array([-80.0, -660.0 + off, 1220.0]), reach)
        assert found["verdict"] == verdict and found["apart_mm"] == pytest.approx(off)


def test_curves_have_to_end_at_table_2() -> None:
    ends = {name: list(values) for name, values in TABLE2.items()}
    assert verdicts.figure_9(TABLE2, ends, 450)["verdict"] == "reproduced"
    ends["right"][1] = -0.237  # as with 350 mm
    assert verdicts.figure_9(TABLE2, ends, 350)["verdict"] == "not reproduced"


def test_the_experiment_is_a_fit_with_its_range() -> None:
    found = verdicts.recovery((46, 56), (46, 55), 0.858, (0.844, 0.873))
    assert found["verdict"] == "fitted" and "85.8%" in found["reason"]
