"""Recorded steps as entities: arms, fruit, misses, distances and numbers, in the policy's colour and by its name.

Time lines: `episode_time` begins anew with every episode: curves lie over one another, and the arms show the last one.
`sim_time` strings all episodes, with a gap before each; `step` counts. On `episode` one sees how each ended.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import rerun as rr
from numpy.typing import ArrayLike

from pickenv.arm import Array
from pickenv.inspect.colours import FRUIT, GREY, RED, STEEL, Rgb, lane, policy_colours
from pickenv.inspect.recordings.episodes import (
    Row,
    Scene,
    column,
    distances_mm,
    has_arm,
    has_fruit,
    last_rows,
    number_groups,
)
from pickenv.inspect.recordings.scribe import Scribe, f32, move_arm, reading_columns, send_arm, send_capture
from pickenv.inspect.runs.saved import nominal_points, true_points

FRUIT_RADIUS, TOOL_RADIUS = 0.02, 0.012
"""m."""
GAIN = 20.0
"""How much larger than true the true arm's deviation from the believed one is drawn."""
GAP = 1.0
"""s; between two episodes on `sim_time`."""
NEAREST_MM = 1e-4
"""Distances below are drawn here, so that they have a logarithm."""
MOST_CURVES = 50
"""Episodes whose curves lie over one another on `episode_time`; later ones are on the other time lines."""
WIDTHS = (1.8, 1.2, 0.8, 0.5)
"""Of a policy's several numbers with one unit, in turn; points."""


def curve_name(scene: Scene, rows: Sequence[Row]) -> str:
    """What a policy's curves are called: its name, and how far from the fruit its episodes end in the mean."""
    ends = distances_mm(last_rows(rows))
    return scene.label if ends is None else f"{scene.label}: {ends.mean():.3f} mm"


def decades(distance_mm: Array) -> Array:
    """Logarithms to base 10 of distances: 0 is a millimetre, 1 a centimetre."""
    return np.asarray(np.log10(np.maximum(distance_mm, NEAREST_MM)))


def send_looks(stream: rr.RecordingStream, scene: Scene, key: str, rows: Sequence[Row], root: str = "world") -> None:
    """Send what holds for all steps of one environment; names of curves say how all of its ``rows`` end."""
    scribe, info = Scribe(stream), rows[0].info
    (colour,) = policy_colours([scene.policy])
    _send_bodies_looks(scribe, scene, key, rows, colour, root)
    if distances_mm(rows[:1]) is not None:
        _name_curves(scribe, f"distance/{lane(key)}", rows, [curve_name(scene, rows)], colour)
        if scene.tolerance_mm is not None:
            name = f"gripper's tolerance, {scene.tolerance_mm:g} mm"
            scribe.still("distance/tolerance", rr.SeriesLines(names=[name], colors=[RED], widths=[WIDTHS[0]]))
    for unit, names in number_groups(info).items():
        said = [f"{scene.label}, {name.replace('_', ' ')}" for name in names]
        _name_curves(scribe, f"metrics/{unit}/{lane(key)}", rows, said, colour)
    if "is_success" in info:
        states = rr.StateConfiguration(
            values=["yes", "no"],
            labels=[f"{scene.label}: success", f"{scene.label}: not yet"],
            colors=[(*colour, 255), (*STEEL, 255)],
        )
        scribe.still(f"outcome/{lane(key)}", states)


def _name_curves(scribe: Scribe, entity: str, rows: Sequence[Row], names: list[str], colour: Rgb) -> None:
    """The look of an entity's series, and of those of its episodes, which lie over one another."""
    widths = [WIDTHS[min(i, len(WIDTHS) - 1)] for i in range(len(names))]
    looks = rr.SeriesLines(names=names, colors=[colour] * len(names), widths=widths)
    for part in ("", *(f"/{order}" for order in dict.fromkeys(row.order for row in rows) if order < MOST_CURVES)):
        scribe.still(entity + part, looks)


def _send_bodies_looks(scribe: Scribe, scene: Scene, key: str, rows: Sequence[Row], colour: Rgb, root: str) -> None:
    info = rows[0].info
    if has_arm(scene, info):
        points = _arms(scene, rows[:1])[0]
        send_arm(scribe, f"{root}/arm/nominal/{key}", points, scene.parts, GREY, "majorwireframe")
        send_arm(scribe, f"{root}/arm/true/{key}", points, scene.parts, colour, "solid", 0.5)
        send_arm(scribe, f"{root}/arm/exaggerated/{key}", points, scene.parts, colour, "solid", 0.5)
    if has_fruit(info):
        scribe.still(f"{root}/fruit/{key}", rr.Points3D.from_fields(colors=[FRUIT], radii=[FRUIT_RADIUS]))
        scribe.still(f"{root}/tool/{key}", rr.Points3D.from_fields(colors=[colour], radii=[TOOL_RADIUS]))
        arrow = rr.Arrows3D.from_fields(colors=[RED], radii=rr.Radius.ui_points(2.0))
        scribe.still(f"{root}/miss/{key}", arrow)
        scribe.still(f"target/{key}", rr.Points3D.from_fields(colors=[colour], radii=rr.Radius.ui_points(4.0)))
        if scene.tolerance_mm is not None:
            send_capture(scribe, scene.tolerance_mm)


def send_rows(stream: rr.RecordingStream, scene: Scene, key: str, rows: Sequence[Row], root: str = "world") -> None:
    """Send ``rows`` of one environment as whole columns; an episode that is sent in parts ends with its last part."""
    moments = np.array([row.moment for row in rows])
    seconds = scene.period * moments + GAP * np.array([row.order for row in rows])
    strung = [rr.TimeColumn("step", sequence=moments), rr.TimeColumn("sim_time", duration=seconds)]
    every = [
        *strung,
        rr.TimeColumn("episode", sequence=[row.episode for row in rows]),
        rr.TimeColumn("episode_time", duration=[scene.period * row.within for row in rows]),
    ]
    scribe, info = Scribe(stream, every), rows[0].info
    if has_arm(scene, info):
        nominal, true = _arms(scene, rows)
        move_arm(scribe, f"{root}/arm/nominal/{key}", nominal, scene.parts)
        move_arm(scribe, f"{root}/arm/true/{key}", true, scene.parts)
        move_arm(scribe, f"{root}/arm/exaggerated/{key}", nominal + GAIN * (true - nominal), scene.parts)
    if has_fruit(info):
        fruit, tool = column(rows, "fruit_position"), column(rows, "tool_position")
        miss = tool - fruit
        scribe.along(f"{root}/fruit/{key}", rr.Points3D.columns(positions=f32(fruit)))
        scribe.along(f"{root}/tool/{key}", rr.Points3D.columns(positions=f32(tool)))
        arrows = rr.Arrows3D.columns(origins=f32(fruit), vectors=f32(miss))
        scribe.along(f"{root}/miss/{key}", arrows, reading_columns(1e3 * miss))
        scribe.along(f"target/{key}", rr.Points3D.columns(positions=f32(1e3 * miss)))
    if "is_success" in info:
        states = ["yes" if row.info["is_success"] else "no" for row in rows]
        scribe.along(f"outcome/{lane(key)}", rr.StateChange.columns(state=states))
    distance = distances_mm(rows)
    if distance is not None:
        _send_numbers(stream, scene, f"distance/{lane(key)}", rows, decades(distance)[:, None])
        if scene.tolerance_mm is not None:
            _send_level(stream, scene, rows, float(decades(np.array(scene.tolerance_mm))))
    for unit, names in number_groups(info).items():
        values = [[row.reward if name == "reward" else row.info[name] for name in names] for row in rows]
        _send_numbers(stream, scene, f"metrics/{unit}/{lane(key)}", rows, np.array(values, dtype=float))


def _send_numbers(stream: rr.RecordingStream, scene: Scene, entity: str, rows: Sequence[Row], values: Array) -> None:
    """Numbers ``(T, k)``: strung with a break before each episode, as each ended, and over one another."""
    first = [i for i, row in enumerate(rows) if row.within == 0 and row.order > 0]
    moments = np.array([row.moment for row in rows])
    seconds = scene.period * moments + GAP * np.array([row.order for row in rows])
    lengths = np.insert(np.full(len(rows), values.shape[1]), first, 0)  # a row without numbers ends a line
    times = [
        rr.TimeColumn("step", sequence=np.insert(moments, first, moments[first])),
        rr.TimeColumn("sim_time", duration=np.insert(seconds, first, seconds[first] - GAP / 2.0)),
    ]
    _send_scalars(Scribe(stream, times), entity, values, lengths)
    ends = [i for i, row in enumerate(rows) if i + 1 == len(rows) or rows[i + 1].order != row.order]
    times = [rr.TimeColumn("episode", sequence=[rows[i].episode for i in ends])]
    _send_scalars(Scribe(stream, times), entity, values[ends])
    for order in dict.fromkeys(row.order for row in rows):
        if order >= MOST_CURVES:
            break
        of = [i for i, row in enumerate(rows) if row.order == order]
        times = [rr.TimeColumn("episode_time", duration=[scene.period * rows[i].within for i in of])]
        _send_scalars(Scribe(stream, times), f"{entity}/{order}", values[of])


def _send_scalars(scribe: Scribe, entity: str, values: Array, lengths: ArrayLike | None = None) -> None:
    """Numbers ``(T, k)``, one row each, or with as many numbers a row as ``lengths`` says."""
    scalars = rr.Scalars.columns(scalars=values.ravel())
    scribe.along(entity, scalars.partition([values.shape[1]] * len(values) if lengths is None else lengths))


def _send_level(stream: rr.RecordingStream, scene: Scene, rows: Sequence[Row], value: float) -> None:
    """A level line across all time lines."""
    lines: dict[str, Any] = {
        "step": {"sequence": [rows[0].moment, rows[-1].moment]},
        "sim_time": {"duration": [scene.period * row.moment + GAP * row.order for row in (rows[0], rows[-1])]},
        "episode": {"sequence": [rows[0].episode, rows[-1].episode]},
        "episode_time": {"duration": [0.0, scene.period * max(row.within for row in rows)]},
    }
    for name, times in lines.items():
        scribe = Scribe(stream, [rr.TimeColumn(name, **times)])
        scribe.along("distance/tolerance", rr.Scalars.columns(scalars=[value, value]))


def _arms(scene: Scene, rows: Sequence[Row]) -> tuple[Array, Array]:
    """Points along the arm as its controller believes it to stand, and along the true arm, ``(T, K, 3)``, m.

    The true arm is the nominal one under the drives' command, brought to where the true tool stood.
    """
    assert scene.nominal is not None
    command = column(rows, "joint_command")
    believed = command if rows[0].target is None else np.array([row.target for row in rows], dtype=float)
    return nominal_points(scene.nominal, believed), true_points(scene.nominal, command, column(rows, "tool_position"))
