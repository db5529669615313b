"""Which misalignments the figure of successes shows, worked out by hand."""

from __future__ import annotations

import numpy as np
import pytest

from pickenv.inspect import success_against_misalignment

X = np.arange(0.0, 12.0, 2.0)
NARROW, WIDE = (X, [0.8, 0.6, 0.41, 0.4, 0.2, 0.0]), (X, [1.0, 1.0, 0.9, 0.8, 0.7, 0.6])


@pytest.mark.parametrize(
    ("curves", "farthest", "end"),
    [((NARROW, WIDE), 0.5, 6.0), ((NARROW, WIDE), 7.0, 7.0), ((NARROW,), None, 6.0), ((WIDE,), None, 1.0)],
    ids=["half is lost at 6 mm", "a policy is farther off", "no policy", "nobody loses half"],
)
def test_it_ends_where_the_first_gripper_has_lost_half_of_what_it_had_or_at_the_policies(curves, farthest, end):
    points = {} if farthest is None else {"raw": {"narrow": (farthest, (0.5, None))}}
    (axes,) = success_against_misalignment(dict(zip(("narrow", "wide"), curves, strict=False)), points).axes
    assert axes.get_xlim() == pytest.approx((0.0, 1.3 * end))
