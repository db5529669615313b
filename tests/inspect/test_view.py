from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pickenv.inspect import Comparison
from pickenv.inspect.runs.run_folder import cut_away, eye_direction, shown_box


@pytest.mark.parametrize("shape", [(10, 10, 10), (9, 5, 9), (4, 12, 6)])
def test_the_eye_looks_from_outside_at_the_widest_face(shape: tuple[int, int, int], comparison: Comparison) -> None:
    scene = replace(comparison, grid=replace(comparison.grid, shape=shape))
    eye, outward = eye_direction(scene), shown_box(scene)[0] - scene.nominal.base.position
    np.testing.assert_allclose(np.linalg.norm(eye), 1.0)
    assert eye[:2] @ outward[:2] > 0.0
    assert eye[2] > 0.0
    if shape[0] != shape[1]:
        assert (abs(eye[1]) > abs(eye[0])) == (shape[0] > shape[1])


def test_what_is_cut_away_is_the_corner_nearest_to_the_eye(comparison: Comparison) -> None:
    away = cut_away(comparison)
    depth = (comparison.grid.points - shown_box(comparison)[0]) @ eye_direction(comparison)
    assert away[np.argmax(depth)]
    assert not away[np.argmin(depth)]
    assert away.mean() == pytest.approx(1 / 8)
