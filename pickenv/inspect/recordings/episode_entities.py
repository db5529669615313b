"""Episodes in Rerun: the choice of steps to record, the entities of these steps, and the layout of the views.

All data come from `info`. An entity is left out if `info` lacks the entries that it shows. Entities have the policy's
colour and name.

There are four time lines. `episode_time` begins anew with every episode, so curves of episodes overlap, and the arms
show the last episode. `sim_time` joins all episodes, with a gap before each. `step` counts steps. `episode` shows how
each episode ended.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, Geometry, drawn_parts, forward, nominal_points, true_points
from pickenv.inspect.colours import FRUIT, GREY, RED, STEEL, Rgb, in_words, lane
from pickenv.inspect.recordings.scribe import Scribe, f32, layout, reading_columns, seen_from, view_of
from pickenv.inspect.runs.comparison_summary import GAIN
from pickenv.inspect.runs.recorded_episodes import POSITIONS

Trigger = Callable[[int], bool]

UNITS = {"mm": "mm", "deg": "°"}
"""Unit of a number by the ending of its name. Numbers with other endings are counts, or have the unit 1."""
OTHERS, REST = "other", "Reward and counts"


def capped_cubic(episode: int) -> bool:
    """Return whether an episode (its index, from 0) is one that Gymnasium's `RecordVideo` records by default.

    These are the episodes 0, 1, 8, 27 … and, from 1000 on, every thousandth.
    """
    return round(episode ** (1.0 / 3.0)) ** 3 == episode if episode < 1000 else episode % 1000 == 0


class Row(NamedTuple):
    """One recorded step of an environment (not a reading of an instrument).

    Attributes:
        episode: Index of the episode, from 0, counting also episodes that were not recorded.
        within: Number of steps since the episode's reset, 0 for the reset.
        order: Index of the episode, from 0, counting only episodes with recorded steps.
        info: The step's `info`, with the added entry ``reward`` (0 after a reset). The entry ``joint_target`` has the
            joint values at which the controller believes the arm to be, if the environment has them.
    """

    episode: int
    within: int
    order: int
    info: Mapping[str, Any]


class EpisodeLog:
    """The recorded steps of one environment (`rows`), and the choice of the steps to record."""

    def __init__(self, key: str, episode_trigger: Trigger | None, step_trigger: Trigger | None, length: float) -> None:
        """Begin an empty log.

        Args:
            key: Name in entity paths: the policy, and the environment's number if there are several.
            episode_trigger: Function of an episode's index, from 0, that returns whether to record the episode from its
                start; None for never.
            step_trigger: Function of a step's index over all episodes, from 0, that returns whether to record from this
                step on; None for never.
            length: Number of steps to record after a trigger; infinite for whole episodes.
        """
        self.key, self.length, self.rows = key, length, list[Row]()
        self._episode_trigger, self._step_trigger = episode_trigger, step_trigger
        self._episode = self._step = -1
        self._within, self._left = 0, 0.0

    def begin(self, info: Mapping[str, Any], target: Array | None = None) -> None:
        """Count a new episode, and add its first `info` to `rows` if it is to be recorded.

        Args:
            info: The `info` of the reset.
            target: As for `note`.
        """
        self._episode += 1
        self._within = 0
        if self.length == np.inf:
            self._left = 0.0
        if self._episode_trigger is not None and self._episode_trigger(self._episode):
            self._left = self.length
        if self._wanted():
            self.note(info, 0.0, target)

    def steps(self) -> bool:
        """Count a new step, and return whether its `info` is to be recorded."""
        self._step += 1
        self._within += 1
        if self._step_trigger is not None and self._step_trigger(self._step):
            self._left = self.length
        return self._wanted()

    def _wanted(self) -> bool:
        self._left -= 1.0
        return self._left >= 0.0

    def note(self, info: Mapping[str, Any], reward: float, target: Array | None = None) -> None:
        """Add the present step to `rows`.

        Args:
            info: The step's `info`.
            reward: The step's reward; 0 after a reset.
            target: Joint values at which the controller believes the arm to be ``(n,)``, rad or m; None if unknown.
        """
        last = self.rows[-1] if self.rows else None
        order = 0 if last is None else last.order + (last.episode != self._episode)
        told = {} if target is None else {"joint_target": target}
        self.rows.append(Row(self._episode, self._within, order, {**info, **told, "reward": reward}))


@dataclass(frozen=True)
class Scene:
    """The properties that all environments of a recording have in common.

    Attributes:
        nominal: Geometry of the nominal arm; None for environments without one.
        period: Time between steps, s.
        tolerance_mm: Radius of the gripper's capture region, mm; None if there is none.
        label: Name of the policy for readers.
        colour: Colour of the policy, RGB in 0..255.
    """

    nominal: Geometry | None
    period: float
    tolerance_mm: float | None
    label: str
    colour: Rgb

    @cached_property
    def parts(self) -> list[int]:
        """Indices, from 0, of the first points of the segments of the arm's polyline to draw (`drawn_parts`)."""
        assert self.nominal is not None
        lower, upper = self.nominal.lower, self.nominal.upper
        return drawn_parts(nominal_points(self.nominal, np.stack([lower, (lower + upper) / 2.0, upper])))


def info_of(infos: Mapping[str, Any], index: int) -> dict[str, Any]:
    """Return a copy of one environment's `info` from the infos of a vector environment.

    A copy is needed because the environment may overwrite its arrays.

    Args:
        infos: Infos of the vector environment, by name.
        index: Index of the environment, from 0.
    """
    info = {}
    for name, values in infos.items():
        if not name.startswith(("_", "final_")) and not isinstance(values, Mapping):
            value = values[index]
            value = np.array(value.cpu() if hasattr(value, "cpu") else value)
            info[name] = value if value.ndim else value.item()
    return info


def has_arm(scene: Scene, info: Mapping[str, Any]) -> bool:
    """Return whether arms can be drawn: the scene has a nominal arm, and `info` has joint command and tool position."""
    return scene.nominal is not None and {"joint_command", "tool_position"} <= set(info)


def has_fruit(info: Mapping[str, Any]) -> bool:
    """Return whether the vector from fruit to tool can be drawn, that is whether `info` has both positions."""
    return set(POSITIONS) <= set(info)


def distances_mm(rows: Sequence[Row]) -> Array | None:
    """Return the distance between tool and fruit in each recorded step ``(T,)``, mm.

    Return None if `info` has neither the positions of tool and fruit nor the distance.
    """
    if has_fruit(rows[0].info):
        return np.asarray(1e3 * np.linalg.norm(column(rows, "tool_position") - column(rows, "fruit_position"), axis=1))
    return column(rows, "position_error_mm") if "position_error_mm" in rows[0].info else None


def last_rows(rows: Sequence[Row]) -> list[Row]:
    """Return the last recorded step of each episode."""
    return list({row.order: row for row in rows}.values())


def number_groups(info: Mapping[str, Any]) -> dict[str, list[str]]:
    """Return the names of the numbers in ``info``, by unit; booleans and arrays do not count as numbers."""
    groups: dict[str, list[str]] = {}
    for name, value in info.items():
        if np.ndim(value) == 0 and isinstance(value, int | float | np.number) and not isinstance(value, bool):
            end = name.rpartition("_")[2]
            groups.setdefault(end if end in UNITS else OTHERS, []).append(name)
    return groups


def column(rows: Sequence[Row], name: str) -> Array:
    """Return the values of the entry ``name`` of `info` in all recorded steps ``(T, ...)``."""
    return np.array([row.info[name] for row in rows], dtype=float)


FRUIT_RADIUS, TOOL_RADIUS = 0.02, 0.012
"""Radii of the balls that show fruit and tool, m."""
GAP = 1.0
"""Gap between two episodes on the time line `sim_time`, s."""
NEAREST_MM = 1e-4
"""Smallest distance that is drawn, mm. Smaller distances are drawn at this value, so that they have a logarithm."""
MOST_CURVES = 50
"""Largest number of episodes with curves on `episode_time`; later episodes have curves on the other time lines only."""
WIDTHS = (1.8, 1.2, 0.8, 0.5)
"""Line widths of a policy's curves that share a unit, points, from the first curve on. All further curves have the last
of these widths."""


def decades(distance_mm: Array) -> Array:
    """Return the base-10 logarithms ``(...)`` of distances ``(...)``, mm: 0 is a millimetre, 1 a centimetre."""
    return np.asarray(np.log10(np.maximum(distance_mm, NEAREST_MM)))


def send_steps(
    stream: rr.RecordingStream, scene: Scene, key: str, rows: Sequence[Row], begin: int = 0, root: str = "world"
) -> None:
    """Send one environment's recorded steps, from index ``begin`` on, as whole columns.

    Colours and names of curves are sent too. The name of the distance curve states the mean final distance over all
    episodes in ``rows``, also those before ``begin``. An episode may be sent in several calls; the last step that was
    sent counts as the episode's end.

    Args:
        stream: The recording.
        scene: What all environments of the recording have in common.
        key: Name of the environment in entity paths.
        rows: All recorded steps of the environment so far.
        begin: Index in ``rows`` of the first step to send, from 0.
        root: Entity below which arms and fruit are placed.
    """
    new, info, colour = rows[begin:], rows[0].info, scene.colour
    moments, seconds = _strung(scene, new, begin)
    times = [
        rr.TimeColumn("step", sequence=moments),
        rr.TimeColumn("sim_time", duration=seconds),
        rr.TimeColumn("episode", sequence=[row.episode for row in new]),
        rr.TimeColumn("episode_time", duration=[scene.period * row.within for row in new]),
    ]
    scribe = Scribe(stream, times)
    if has_arm(scene, info):
        nominal, true = _arms(scene, new)
        exaggerated = nominal + GAIN * (true - nominal)
        scribe.arm(f"{root}/arm/nominal/{key}", nominal, scene.parts, GREY, "majorwireframe")
        scribe.arm(f"{root}/arm/true/{key}", true, scene.parts, colour, "solid", 0.5)
        scribe.arm(f"{root}/arm/exaggerated/{key}", exaggerated, scene.parts, colour, "solid", 0.5)
    if has_fruit(info):
        fruit, tool = column(new, "fruit_position"), column(new, "tool_position")
        miss = tool - fruit
        scribe.dots(f"{root}/fruit/{key}", fruit, FRUIT, FRUIT_RADIUS)
        scribe.dots(f"{root}/tool/{key}", tool, colour, TOOL_RADIUS)
        scribe.dots(f"target/{key}", 1e3 * miss, colour, rr.Radius.ui_points(4.0))
        scribe.still(f"{root}/miss/{key}", rr.Arrows3D.from_fields(colors=[RED], radii=rr.Radius.ui_points(2.0)))
        arrows = rr.Arrows3D.columns(origins=f32(fruit), vectors=f32(miss))
        scribe.along(f"{root}/miss/{key}", arrows, reading_columns(1e3 * miss))
        if scene.tolerance_mm is not None:
            scribe.capture("target/capture", scene.tolerance_mm)
    if "is_success" in info:
        looks = {"yes": (f"{scene.label}: success", colour), "no": (f"{scene.label}: not yet", STEEL)}
        scribe.lane(f"outcome/{lane(key)}", looks, ["yes" if row.info["is_success"] else "no" for row in new])
    distance, ends = distances_mm(new), distances_mm(last_rows(rows))
    if distance is not None and ends is not None:
        entity = f"distance/{lane(key)}"
        _name_curves(scribe, entity, rows, [f"{scene.label}: {ends.mean():.3f} mm"], colour)
        _send_numbers(stream, scene, entity, new, begin, decades(distance)[:, None])
        if scene.tolerance_mm is not None:
            name, level = f"gripper's tolerance, {scene.tolerance_mm:g} mm", np.full(len(new), scene.tolerance_mm)
            scribe.curve("distance/tolerance", name, RED, decades(level), WIDTHS[0])
    for unit, names in number_groups(info).items():
        entity, labels = f"metrics/{unit}/{lane(key)}", [f"{scene.label}, {name.replace('_', ' ')}" for name in names]
        _name_curves(scribe, entity, rows, labels, colour)
        _send_numbers(stream, scene, entity, new, begin, np.stack([column(new, name) for name in names], axis=1))


def _name_curves(scribe: Scribe, entity: str, rows: Sequence[Row], names: list[str], colour: Rgb) -> None:
    """Send names, colours and widths of an entity's curves, and of the overlaid curves of its single episodes.

    Args:
        scribe: Writer of the recording.
        entity: Path of the curves.
        rows: Recorded steps of the episodes.
        names: Name of each curve.
        colour: Colour of all curves, RGB in 0..255.
    """
    widths = [WIDTHS[min(i, len(WIDTHS) - 1)] for i in range(len(names))]
    looks = rr.SeriesLines(names=list(map(in_words, names)), colors=[colour] * len(names), widths=widths)
    for part in ("", *(f"/{order}" for order in dict.fromkeys(row.order for row in rows) if order < MOST_CURVES)):
        scribe.still(entity + part, looks)


def _strung(scene: Scene, rows: Sequence[Row], begin: int) -> tuple[NDArray[np.int64], Array]:
    """Return two arrays: the indices of rows among all recorded steps ``(T,)``, and the rows' times ``(T,)``, s.

    Args:
        scene: What all environments of the recording have in common.
        rows: T successive recorded steps.
        begin: Index of the first of these rows among all recorded steps, from 0.

    Returns:
        The indices, from 0, and the times on the time line `sim_time`.
    """
    moments = np.arange(begin, begin + len(rows))
    return moments, scene.period * moments + GAP * np.array([row.order for row in rows])


def _send_numbers(
    stream: rr.RecordingStream, scene: Scene, entity: str, rows: Sequence[Row], begin: int, values: Array
) -> None:
    """Send numbers ``values`` ``(T, k)`` of T rows on every time line.

    All episodes follow one another on `step` and `sim_time`, and are overlaid on `episode_time`. The time line
    `episode` has the last numbers of each episode.

    Args:
        stream: The recording.
        scene: What all environments of the recording have in common.
        entity: Path of the numbers.
        rows: T successive recorded steps.
        begin: Index of the first of these rows among all recorded steps, from 0.
        values: k numbers of each row ``(T, k)``.
    """
    first = [i for i, row in enumerate(rows) if row.within == 0 and row.order > 0]
    moments, seconds = _strung(scene, rows, begin)
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
    """Send ``values`` ``(T, k)`` along the time columns.

    ``lengths`` says how many numbers belong to each time of the columns; None for k numbers each.
    """
    scalars = rr.Scalars.columns(scalars=values.ravel())
    scribe.along(entity, scalars.partition([values.shape[1]] * len(values) if lengths is None else lengths))


def _arms(scene: Scene, rows: Sequence[Row]) -> tuple[Array, Array]:
    """Return points along the believed arm and along the true arm, ``(T, K, 3)`` each, m.

    The believed arm is the nominal arm at the joint values at which its controller believes it to be. The true arm is
    drawn as the nominal arm at the joint command, moved so that its tool is at the true tool.
    """
    assert scene.nominal is not None
    command = column(rows, "joint_command")
    target = column(rows, "joint_target") if "joint_target" in rows[0].info else command
    return nominal_points(scene.nominal, target), true_points(scene.nominal, command, column(rows, "tool_position"))


# The default layout: the arms beside how far the tool is from the fruit, and what `info` says.


EYE = np.array([0.75, -1.0, 0.55])
"""Vector from the middle of the scene to the camera, in units of the scene's size."""
SHOWN_TOLERANCES = 5.0
"""The view of the tool from the fruit shows errors up to this many tolerances, or more if a final error is larger."""
DECADES = "log10 of mm (-1: 0.1 mm, 0: 1 mm, 1: 10 mm)"
"""Label of the axis of distances, as the viewer has no logarithmic axes of its own."""


def episode_blueprint(scene: Scene, rows: Sequence[Row]) -> rrb.Blueprint:
    """Return the layout (blueprint) for a recording whose steps have the same `info` entries as ``rows``."""
    info = rows[0].info
    plots: list[Any] = [distance_plot()] if distances_mm(rows[:1]) is not None else []
    numbers = number_plots(info)
    plots.append(rrb.Tabs(*numbers, active_tab=len(numbers) - 1) if plots else rrb.Vertical(*numbers))
    if "is_success" in info:
        plots.append(view_of(rrb.StateTimelineView, "outcome", "Success"))
    views = _space_views(scene, rows)
    columns = [rrb.Vertical(*views)] if views else []
    return at_the_end(rrb.Horizontal(*columns, rrb.Vertical(*plots)))


def at_the_end(content: Any) -> rrb.Blueprint:
    """Return a layout of the views ``content`` on the time line `episode_time`, with the cursor at its end."""
    return layout(content, "episode_time", play_state="following", loop_mode="off")


def number_plots(info: Mapping[str, Any]) -> list[Any]:
    """Return one plot for each unit of the numbers in `info`, and one for reward and counts."""
    return [
        view_of(rrb.TimeSeriesView, f"metrics/{unit}", f"Numbers in {UNITS[unit]}" if unit in UNITS else REST)
        for unit in number_groups(info)
    ]


def distance_plot() -> Any:
    """Return a plot of the logarithm of the distance from tool to fruit."""
    title = f"Distance to the fruit, {DECADES}; legend: mean at the end"
    legend = rrb.PlotLegend(rrb.Corner2D.LeftBottom, visible=True)
    return view_of(rrb.TimeSeriesView, "distance", title, plot_legend=legend)


def _space_views(scene: Scene, rows: Sequence[Row]) -> list[Any]:
    views: list[Any] = []
    info = rows[0].info
    if has_arm(scene, info):
        assert scene.nominal is not None
        base = scene.nominal.base.position
        tool = forward(scene.nominal, (scene.nominal.lower + scene.nominal.upper) / 2.0).position
        middle = (base + tool) / 2.0
        eye = middle + 1.3 * float(np.linalg.norm(tool - base)) * EYE
        arms = ["+ /world/arm/nominal/**", "+ /world/arm/exaggerated/**"]
        fruit = ["+ /world/fruit/**", "+ /world/miss/**"] if has_fruit(info) else []
        name = f"Believed arm (wire), true arm with its deviation ×{GAIN:g}; miss (red)"
        views.append(seen_from(eye, middle, "/world", [*arms, *fruit], name))
    elif has_fruit(info):
        points = np.concatenate([column(rows, "tool_position"), column(rows, "fruit_position")])
        low, high = points.min(axis=0), points.max(axis=0)
        middle, radius = (low + high) / 2.0, max(float(np.linalg.norm(high - low)) / 2.0, 1e-3)
        name = "Tool, fruit, and between them the miss (red)"
        views.append(seen_from(middle + 2.0 * radius * EYE, middle, "/world", ["+ /world/**"], name))
    if has_fruit(info):
        ends = distances_mm(last_rows(rows))
        assert ends is not None
        views.append(target_view(float(ends.max()), scene.tolerance_mm))
    return views


def target_view(largest_mm: float, tolerance_mm: float | None) -> Any:
    """Return a 3D view of the tool's true position relative to the fruit, mm.

    Args:
        largest_mm: Largest distance between tool and fruit at an episode's end, mm; the view is at least this wide.
        tolerance_mm: Radius of the gripper's capture region, mm; None if there is none.
    """
    span = max(SHOWN_TOLERANCES * (tolerance_mm or 0.0), 1.2 * largest_mm)
    region = "" if tolerance_mm is None else f"; capture region, {tolerance_mm:g} mm (red)"
    name = f"True tool seen from the fruit, mm{region}"
    return seen_from(span * EYE, np.zeros(3), "/target", ["+ /target/**"], name, ground=False)
