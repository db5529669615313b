"""Figures of numbers with intervals: every number is drawn where it is, and an open end is an arrow."""

import numpy as np
import pytest

from pickenv.base import Estimate
from pickenv.inspect import estimates_figure
from tests.inspect.figures.figure_lint import figure_faults

ROWS = [
    {"plant": plant, "method": method, "pick": pick, "estimate": Estimate(value, ends)}
    for plant in ("field", "orchard")
    for method, factor in (("raw", 4.0), ("ls", 1.0))
    for pick in (1, 2, 3)
    for value, ends in [(factor / pick, (0.8 * factor / pick, 1.3 * factor / pick))]
]


def drawn(figure):
    """Places along x, and heights, of all that is drawn in the panels."""
    lines = [line for axis in figure.axes for line in axis.get_lines() if len(line.get_xdata())]
    return np.array([(x, y) for line in lines for x, y in zip(line.get_xdata(), line.get_ydata(), strict=True)], float)


@pytest.mark.parametrize("log", [False, True])
@pytest.mark.parametrize("panels", [None, "plant"])
def test_whiskers_stand_at_their_numbers_and_ends(log, panels):
    rows = [row for row in ROWS if row["pick"] == 1]
    figure = estimates_figure(rows, "mean error (mm)", ("plant", "method"), panels=panels, log=log, scale=10.0)
    places = drawn(figure)[:, 0]
    for row in rows:
        for value in (row["estimate"].value, *row["estimate"].ci95):
            assert np.isclose(places, 10.0 * value).any()
    assert figure_faults(figure) == []


def test_lines_follow_the_column_that_they_are_drawn_along():
    figure = estimates_figure(ROWS, "mean error (mm)", ("plant", "method", "pick"), x="pick", panels="plant")
    assert figure.get_suptitle() == "field (rough arm): raw 1.3, least squares 0.33"
    assert [axis.get_title("left") for axis in figure.axes] == ["field (rough arm)", "orchard (drifting arm)"]
    for axis in figure.axes:
        curves = [line for line in axis.get_lines() if len(line.get_xdata())]
        assert [line.get_ydata()[0] for line in curves] == [4.0, 1.0]
        assert all(list(line.get_xdata()) == [1.0, 2.0, 3.0] for line in curves)
    assert figure_faults(figure) == []


def test_an_open_end_is_an_arrow_from_the_number():
    rows = [{"method": "raw", "estimate": Estimate(2.0, (1.0, None))}]
    (axis,) = estimates_figure(rows, "median arm (mm)", ("method",)).axes
    assert [line.get_xdata()[0] for line in axis.get_lines() if line.get_marker() == ">"] == [2.0]
