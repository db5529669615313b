"""Write Rerun recordings as whole columns without wall-clock times, so that equal data give equal files.

Units: m in space; mm and degrees on plots, as their titles say.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import ArrayLike

from pickenv.arm import Array
from pickenv.base import InputError, versions, write_whole
from pickenv.inspect.colours import RED, WHITE, Rgb, as_sentence, in_words, viridis
from pickenv.inspect.runs.comparison_summary import ticks
from pickenv.inspect.runs.run_folder import capsules

APPLICATION_ID = "pickenv"
BASE_RADIUS, TOOL_RADIUS = 0.030, 0.012
"""Radii of the first and the last link as drawn, m; links become thinner from base to tool."""


def write_recording(
    path: str | Path, recording_id: str, blueprint: rrb.Blueprint, send: Callable[[rr.RecordingStream], None]
) -> Path:
    """Write a recording (.rrd) that includes its layout (blueprint), atomically, and return the path.

    Args:
        path: The file. Missing folders are made.
        recording_id: Identity of the recording. The viewer shows files of one identity as one recording.
        blueprint: The layout.
        send: Function that sends everything to the stream.

    Raises:
        InputError: If the file cannot be written.
    """
    content = recording_bytes(recording_id, blueprint, send)
    return write_whole(path, lambda temporary: temporary.write_bytes(content))


def recording_bytes(recording_id: str, blueprint: rrb.Blueprint, send: Callable[[rr.RecordingStream], None]) -> bytes:
    """Return a recording as the content of a file, with the footer that ends a finished recording.

    The content is made in memory, because rerun's own writer waits for ever when the disk fills up.

    Raises:
        InputError: If the environment variable RERUN switches rerun off.
    """
    stream = rr.RecordingStream(APPLICATION_ID, recording_id=recording_id, send_properties=False)
    memory = stream.memory_recording()
    if not rr.is_enabled(stream):
        raise InputError("the variable RERUN switches recording off; unset it")
    # Active, not only the default: the web viewer passes over a default that comes after the recording's head.
    stream.send_blueprint(blueprint, make_active=True, make_default=True)
    send(stream)
    return memory.drain_as_bytes()


class Scribe:
    """Writer that sends columns to one Rerun stream, either as static data or along time lines."""

    def __init__(self, stream: rr.RecordingStream, times: Sequence[rr.TimeColumn] = ()) -> None:
        """Make a writer for one stream.

        Args:
            stream: The stream.
            times: Time columns for data that change; without them, `along` sends nothing.
        """
        self.stream, self.times = stream, tuple(times)

    def still(self, entity: str, *content: rr.AsComponents) -> None:
        """Send archetypes of an entity in one chunk as static data, that is for all times."""
        batches = [batch for archetype in content for batch in archetype.as_component_batches()]
        columns = [rr.ComponentColumn(b.component_descriptor(), b, lengths=[len(b.as_arrow_array())]) for b in batches]
        self.stream.send_columns(entity, [], columns, strict=True)

    def along(self, entity: str, *columns: Iterable[rr.ComponentColumn]) -> None:
        """Send columns of data to the path ``entity``, with one row for each time in the writer's time columns."""
        if self.times:
            self.stream.send_columns(entity, self.times, [c for several in columns for c in several], strict=True)

    def properties(self, **facts: Any) -> None:
        """Send properties of the recording, by name, and the versions of the packages that made it."""
        made_with: Any = {f"{name}_version": made for name, made in {**versions(), "rerun": rr.__version__}.items()}
        self.stream.send_property("pickenv", rr.AnyValues(**facts, **made_with))

    def document(self, entity: str, markdown: str) -> None:
        """Send a Markdown text to the path ``entity``, as static data."""
        self.still(entity, rr.TextDocument(as_sentence(markdown), media_type="text/markdown"))

    def words(self, entity: str, place: ArrayLike, text: str) -> None:
        """Send a text at the position ``place`` ``(3,)`` in space, m, as static data."""
        self.still(entity, rr.Points3D([place], labels=[in_words(text)], colors=[WHITE], radii=0.0, show_labels=True))

    def curve(self, entity: str, name: str, colour: Rgb, values: ArrayLike, width: float | None = None) -> None:
        """Send numbers ``(T,)`` along the time lines, and how they are drawn.

        ``name`` is the curve's name in the legend, and ``width`` the line width, points.
        """
        widths = None if width is None else [width]
        self.still(entity, rr.SeriesLines(names=[in_words(name)], colors=[colour], widths=widths))
        self.along(entity, rr.Scalars.columns(scalars=values))

    def lane(self, entity: str, looks: Mapping[str, tuple[str, Rgb]], states: Sequence[str]) -> None:
        """Send T states by name along the time lines; each state has a label and a colour in ``looks``."""
        labels, colours = zip(*((in_words(label), (*colour, 255)) for label, colour in looks.values()), strict=True)
        self.still(entity, rr.StateConfiguration(values=list(looks), labels=labels, colors=colours))
        self.along(entity, rr.StateChange.columns(state=states))

    def arrows(self, entity: str, origins: Array, arrows: Array, values: Array, top: float, unit: str = "mm") -> None:
        """Send a field of arrows as static data, coloured by the length of ``values``.

        Args:
            entity: Name of the field.
            origins: Points at which the arrows start ``(N, 3)``, m.
            arrows: The arrows as drawn ``(N, 3)``, m.
            values: The vectors ``(N, 3)``, in ``unit``. Their lengths give the colours. A click on an arrow shows its
                vector.
            top: Upper end of the colour scale, in ``unit``.
            unit: Unit of ``values``.
        """
        look: Any = {"colors": viridis(np.linalg.norm(values, axis=-1) / top), "radii": rr.Radius.ui_points(1.6)}
        self.still(entity, rr.Arrows3D(origins=f32(origins), vectors=f32(arrows), **look), reading(values, unit))

    def arm(
        self, entity: str, points: Array, parts: list[int], colour: Rgb, fill_mode: Any, thickness: float = 1.0
    ) -> None:
        """Send the look of a moving arm, and its positions along the time lines.

        Args:
            entity: Name of the arm.
            points: Points along the arm ``(T, K, 3)``, m.
            parts: Indices, from 0, of the first points of the segments to draw, from `drawn_parts`.
            colour: Colour of the arm, RGB in 0..255.
            fill_mode: Rerun's fill mode, such as "solid".
            thickness: Factor on the radii of the links.
        """
        radii = f32(thickness * np.linspace(BASE_RADIUS, TOOL_RADIUS, len(parts)))
        look: Any = {"colors": [colour] * len(parts), "line_radii": rr.Radius.ui_points(0.6), "fill_mode": fill_mode}
        self.still(entity, rr.Capsules3D.from_fields(radii=radii, **look))
        start, length, quaternion = capsules(points, parts)
        place, turn = f32(start.reshape(-1, 3)), f32(quaternion.reshape(-1, 4))
        moving = rr.Capsules3D.columns(lengths=f32(length.ravel()), translations=place, quaternions=turn)
        self.along(entity, moving.partition([len(parts)] * len(points)))

    def dots(self, entity: str, places: Array, colour: Rgb, radius: Any) -> None:
        """Send the look of a moving ball, and its positions along the time lines.

        Args:
            entity: Name of the ball.
            places: Positions ``(T, 3)``, m.
            colour: Colour of the ball, RGB in 0..255.
            radius: Radius, m, or a `rerun.Radius`.
        """
        self.still(entity, rr.Points3D.from_fields(colors=[colour], radii=radius))
        self.along(entity, rr.Points3D.columns(positions=f32(places)))

    def axes(self, entity: str, corner: ArrayLike, lengths: ArrayLike, labels: Sequence[str], width: float) -> None:
        """Send three labelled arrows along the world's axes as static data.

        Args:
            entity: Name of the axes.
            corner: Point at which the arrows start ``(3,)``, m.
            lengths: Lengths of the arrows ``(3,)``, m.
            labels: Labels of the arrows.
            width: Line width, points.
        """
        look: Any = {"colors": [WHITE] * 3, "labels": labels, "radii": rr.Radius.ui_points(width)}
        self.still(entity, rr.Arrows3D(origins=[corner] * 3, vectors=np.diag(lengths), **look))

    def capture(self, entity: str, radius: float, opacity: int = 200, width: float = 0.8) -> None:
        """Send the look of the gripper's capture region, a ball.

        Args:
            entity: Name of the ball.
            radius: Radius of the ball, in the unit of the view's space (m or mm).
            opacity: Opacity, 0..255.
            width: Line width, points.
        """
        look: Any = {"colors": [(*RED, opacity)], "fill_mode": "majorwireframe"}
        thin = rr.Radius.ui_points(width)
        self.still(entity, rr.Ellipsoids3D.from_fields(half_sizes=[[radius] * 3], line_radii=thin, **look))

    def colour_bar(self, entity: str, top: float, unit: str) -> None:
        """Send a colour scale from 0 to ``top`` with its unit: an image, and ticks, as entities below ``entity``."""
        width, height = 512, 7  # px
        bar = np.broadcast_to(viridis((np.arange(width) + 0.5) / width), (height, width, 3))
        self.still(f"{entity}/bar", rr.Image(np.ascontiguousarray(bar)))
        at = ticks(top)
        positions = [(tick / top * width, height - 1.0) for tick in at]
        labels = [f"{tick:g}" for tick in at[:-1]] + [f"{at[-1]:g} {unit}"]
        self.still(f"{entity}/ticks", rr.Points2D(positions, labels=labels, radii=0, colors=[WHITE], show_labels=True))


def f32(values: ArrayLike) -> Any:
    """Return values as 32-bit floats, the precision in which rerun stores them."""
    return np.ascontiguousarray(values, dtype=np.float32)


def reading(vectors: Array, unit: str = "mm") -> rr.DynamicArchetype:
    """Return the numbers that a click on an arrow shows: norm and components of ``vectors`` ``(N, 3)``, in ``unit``."""
    return rr.DynamicArchetype("PickError", components=_readings(vectors, unit))


def reading_columns(vectors: Array) -> Iterable[rr.ComponentColumn]:
    """Return the numbers of `reading` for vectors ``(T, 3)``, mm, as columns with one row per time."""
    return rr.DynamicArchetype.columns("PickError", components=_readings(vectors, "mm"))


def _readings(vectors: Array, unit: str) -> dict[str, Any]:
    lengths = f32(np.linalg.norm(vectors, axis=-1))
    return {f"norm_{unit}": lengths, f"xyz_{unit}": rr.components.Vector3DBatch(f32(vectors))}


BACKGROUND = (72, 72, 80)
"""Background of 3D views in either theme: a grey from which both ends of Viridis stand out."""
MOST_ABREAST = 4
"""Largest number of views in one row."""


def layout(content: Any, time_line: str | None, **time: Any) -> rrb.Blueprint:
    """Return a blueprint with all panels collapsed.

    At first the time is paused; when played, it loops. The options ``time`` can change both.

    Args:
        content: The views.
        time_line: Name of the time line; None for none.
        time: Options of rerun's time panel.
    """
    return rrb.Blueprint(
        content,
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.TimePanel(state="collapsed", timeline=time_line, **{"loop_mode": "all", "play_state": "paused"} | time),
        auto_views=False,
    )


def seen_from(
    eye: Array, look: Array, origin: str, contents: list[str], name: str, *, ground: bool = True, **more: Any
) -> Any:
    """Return a 3D view from the point ``eye`` to the point ``look``.

    Args:
        eye: Position of the camera ``(3,)``, m.
        look: Point that the camera looks at ``(3,)``, m.
        origin: The view's root entity.
        contents: Rerun's query expressions for the entities to show.
        name: Title of the view.
        ground: Whether to draw a grid on the ground.
        more: Further arguments of the view.
    """
    grid = {"visible": True, "spacing": 0.5, "stroke_width": 0.5, "color": (255, 255, 255, 30)}
    return rrb.Spatial3DView(
        origin=origin,
        contents=contents,
        name=in_words(name),
        background=BACKGROUND,
        eye_controls=rrb.EyeControls3D(position=eye, look_target=look, eye_up=[0.0, 0.0, 1.0]),
        line_grid=rrb.LineGrid3D(**(grid if ground else {"visible": False})),
        **more,
    )


def view_of(kind: Any, entity: str, name: str, **more: Any) -> Any:
    """Return a view of a kind (a class of rerun's views), with the title ``name``, of everything below an entity."""
    return kind(origin=f"/{entity}", contents=[f"+ /{entity}/**"], name=in_words(name), **more)


def with_colour_bar(views: list[Any], key: str, meaning: str, name: str) -> Any:
    """Return a tab with ``views`` side by side, in several rows if they are many, and a colour bar below them.

    Args:
        views: The views.
        key: Key of the colour bar. The bar is the entity with this name below `/legend`.
        meaning: Title of the colour bar.
        name: Name of the tab.
    """
    bounds = rrb.VisualBounds2D(x_range=[-14.0, 534.0], y_range=[-4.0, 20.0])
    bar = view_of(rrb.Spatial2DView, f"legend/{key}", meaning, background=BACKGROUND, visual_bounds=bounds)
    rows = rrb.Grid(*views, grid_columns=-(-len(views) // -(-len(views) // MOST_ABREAST)))
    return rrb.Vertical(rows, bar, row_shares=[5.2, 1.0], name=name)
