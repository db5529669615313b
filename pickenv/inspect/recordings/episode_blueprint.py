"""The default layout of logged episodes: the arms beside what `info` says in numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import rerun.blueprint as rrb

from pickenv.arm.kinematics.forward import forward
from pickenv.inspect.recordings.blueprint_views import layout, seen_from
from pickenv.inspect.recordings.episodes import UNITS, Scene, has_arm, has_fruit, number_groups

EYE = np.array([0.75, -1.0, 0.55])
"""From the middle of the scene to the eye, in units of the arm's reach at mid-range."""
SHOWN_TOLERANCES = 5.0
"""Plots and the view from the fruit show errors up to this many tolerances; the way there is longer."""


def episode_blueprint(scene: Scene, info: Mapping[str, Any]) -> rrb.Blueprint:
    """The layout for environments whose infos are like ``info``."""
    views = _space_views(scene, info)
    plots: list[Any] = []
    for unit in number_groups(info):
        options: dict[str, Any] = {}
        if unit == "mm" and scene.tolerance_mm is not None:
            top = SHOWN_TOLERANCES * scene.tolerance_mm
            options["axis_y"] = rrb.ScalarAxis(range=(0.0, top), zoom_lock=True)
        title = f"Numbers in {UNITS[unit]}" if unit in UNITS else "Reward and counts"
        plots.append(
            rrb.TimeSeriesView(origin=f"/metrics/{unit}", contents=[f"+ /metrics/{unit}/**"], name=title, **options)
        )
    if "is_success" in info:
        plots.append(rrb.StateTimelineView(origin="/outcome", contents=["+ /outcome/**"], name="Success"))
    columns = [rrb.Vertical(*views)] if views else []
    return layout(rrb.Horizontal(*columns, rrb.Vertical(*plots)), "sim_time")


def _space_views(scene: Scene, info: Mapping[str, Any]) -> list[Any]:
    views: list[Any] = []
    if has_arm(scene, info):
        assert scene.nominal is not None
        base = scene.nominal.base.position
        tool = forward(scene.nominal, (scene.nominal.lower + scene.nominal.upper) / 2.0).position
        middle = (base + tool) / 2.0
        eye = middle + 1.6 * float(np.linalg.norm(tool - base)) * EYE
        fruit = ["+ /world/fruit/**", "+ /world/miss/**"] if has_fruit(info) else []
        name = "True arm, and the nominal arm (wire) under the same command; miss (red)"
        views.append(seen_from(eye, middle, "/world", ["+ /world/arm/**", *fruit], name))
    if has_fruit(info) and scene.tolerance_mm is not None:
        eye = SHOWN_TOLERANCES * scene.tolerance_mm * EYE
        name = f"True tool seen from the fruit, mm; capture region, {scene.tolerance_mm:g} mm (red)"
        views.append(seen_from(eye, np.zeros(3), "/target", ["+ /target/**"], name, ground=False))
    return views
