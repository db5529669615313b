"""Tabs for the reasons behind the errors: arms, effects, attitude, uncertainty, a day in the field."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun.blueprint as rrb

from pickenv.inspect.recordings.blueprint_views import ghost, space, with_colour_bar
from pickenv.inspect.recordings.detail_entities import DAY_WORDS
from pickenv.inspect.recordings.details import FLOOR, Details, attitude_length
from pickenv.inspect.recordings.field_day import Day
from pickenv.inspect.runs import comparison_summary
from pickenv.inspect.runs.comparison import Comparison


def detail_tabs(comparison: Comparison, details: Details, gain: float) -> list[Any]:
    """One tab for each part of ``details`` that there is."""
    tabs = [_effects(comparison, details, gain)]
    if details.attitude:
        tabs.append(_attitude(comparison, details))
    if comparison.field_uncertainty is not None:
        tabs.append(_uncertainty(comparison))
    if details.day is not None:
        tabs.append(_day(details.day))
    if len(comparison.fruit):
        tabs.insert(0, _arms(comparison, gain))
    return tabs


def _arms(comparison: Comparison, gain: float) -> Any:
    first = comparison.policies[0].label
    exaggerated = ["+ /world/arm/nominal", "+ /world/arm/exaggerated", "+ /world/fruit", "+ /world/miss/**"]
    urdf = ["+ /urdf_nominal/**", "+ /urdf_true/**"]
    return rrb.Horizontal(
        space(comparison, f"Nominal arm (wire) and true arm under the {first} command, ×{gain:g}", exaggerated),
        space(comparison, "Nominal and true arm as exported (URDF), true size", urdf, origin="/"),
        name=f"True arm ×{gain:g}",
    )


def _effects(comparison: Comparison, details: Details, gain: float) -> Any:
    views = []
    for name, field in details.effects.items():
        mean = comparison_summary.error_spread(1e3 * np.linalg.norm(field, axis=-1)).mean
        title = f"{name.replace('_', ' ')} | mean {mean:.2f} mm | ×{gain:g}"
        views.append(space(comparison, title, [f"+ /world/effect/{name}", *ghost(comparison)]))
    meaning = f"Colour: position error, 0 to {comparison_summary.colour_scale_mm(comparison):.2f} mm"
    return with_colour_bar(views, "position", meaning, "Effects, each alone")


def _attitude(comparison: Comparison, details: Details) -> Any:
    labels = {policy.key: f"{policy.label} attitude" for policy in comparison.policies}
    labels[FLOOR] = "No joint motion removes"
    top, length = comparison_summary.attitude_scale_deg(details.attitude), attitude_length(comparison, details.attitude)
    views = []
    for key, field in details.attitude.items():
        mean = comparison_summary.error_spread(np.degrees(np.linalg.norm(field, axis=-1))).mean
        title = f"{labels[key]} | mean {mean:.3f}° | {1e3 * length:g} mm per degree"
        views.append(space(comparison, title, [f"+ /world/attitude/{key}", *ghost(comparison)]))
    meaning = f"Colour: attitude error, 0 to {top:.3f}°; arrows point along its axis"
    return with_colour_bar(views, "attitude", meaning, "Attitude")


def _uncertainty(comparison: Comparison) -> Any:
    assert comparison.field_uncertainty is not None
    last, predicted = comparison.policies[-1], 1e3 * comparison.field_uncertainty
    actual, inside = (
        comparison_summary.field_mm(last),
        100.0 * float(np.mean(comparison_summary.field_mm(last) < 2.0 * predicted)),
    )
    least, most = float(predicted.min()), float(predicted.max())
    titles = {
        "predicted": f"Predicted standard uncertainty u | mean {predicted.mean():.2f} mm, {least:.2f} to {most:.2f} mm",
        "actual": f"Actual error, {last.label} | mean {actual.mean():.2f} mm | below 2u at {inside:.0f} %",
    }
    views = [space(comparison, title, [f"+ /world/uncertainty/{key}"]) for key, title in titles.items()]
    meaning = f"Colour: uncertainty and error, 0 to {comparison_summary.uncertainty_scale_mm(comparison):.2f} mm"
    return with_colour_bar(views, "uncertainty", meaning, "Predicted uncertainty")


def _day(day: Day) -> Any:
    largest = max(float(np.percentile(errors, 95, axis=1).max()) for errors in day.errors_mm.values())
    plot = rrb.TimeSeriesView(
        origin="/day",
        contents=["+ /day/**"],
        name=f"Position error over {day.hours[-1]:g} h of warming up, tilting and sinking as in '{day.plant}', mm | "
        f"commands as on firm ground | across: reaches, {60.0 * day.hours[0]:.0f} min apart; or choose 'hours'",
        axis_y=rrb.ScalarAxis(range=(0.0, 1.15 * largest), zoom_lock=True),
        plot_legend=rrb.PlotLegend(rrb.Corner2D.RightBottom, visible=True),
    )
    words = rrb.TextDocumentView(origin=f"/{DAY_WORDS}", contents=[f"+ /{DAY_WORDS}"], name="Why")
    return rrb.Horizontal(plot, words, column_shares=[3, 1], name="A day in the field")
