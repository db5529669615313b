"""Rerun recordings of anything: one stream, whole columns, no wall-clock times, so that equal data give equal files.

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
from pickenv.inspect.runs.saved import capsules

APPLICATION_ID = "pickenv"
BASE_RADIUS, TOOL_RADIUS = 0.030, 0.012
"""Radii of the first and the last link as drawn, m; links become thinner from base to tool."""
COLOUR_BAR_PIXELS = (512, 7)


def write_recording(
    path: str | Path, recording_id: str, blueprint: rrb.Blueprint, send: Callable[[rr.RecordingStream], None]
) -> Path:
    """Write a recording (.rrd) with its blueprint inside, whole or not at all.

    Args:
        path: The file; missing folders are made.
        recording_id: Identity of the recording; files of one identity are shown as one recording.
        blueprint: The layout.
        send: Function that sends everything to the stream.

    Raises:
        InputError: If the file cannot be written.
    """
    content = recording_bytes(recording_id, blueprint, send)
    return write_whole(path, lambda temporary: temporary.write_bytes(content))


def recording_bytes(recording_id: str, blueprint: rrb.Blueprint, send: Callable[[rr.RecordingStream], None]) -> bytes:
    """A recording as the content of a file, with the footer that ends a finished recording.

    It is made in memory, because rerun's own writer waits for ever when the disk fills up.

    Raises:
        InputError: If the variable RERUN switches rerun off.
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
    """Sends columns to one stream, either for all time or along time lines."""

    def __init__(self, stream: rr.RecordingStream, times: Sequence[rr.TimeColumn] = ()) -> None:
        """A scribe for one stream and its time columns; without ``times``, `along` sends nothing."""
        self.stream, self.times = stream, tuple(times)

    def still(self, entity: str, *content: rr.AsComponents) -> None:
        """Send archetypes that hold for all time, all of an entity in one chunk."""
        batches = [batch for archetype in content for batch in archetype.as_component_batches()]
        columns = [
            rr.ComponentColumn(batch.component_descriptor(), batch, lengths=[len(batch.as_arrow_array())])
            for batch in batches
        ]
        self.stream.send_columns(entity, [], columns, strict=True)

    def along(self, entity: str, *columns: Iterable[rr.ComponentColumn]) -> None:
        """Send columns with one row per moment."""
        if self.times:
            self.stream.send_columns(entity, self.times, [c for several in columns for c in several], strict=True)

    def properties(self, **facts: Any) -> None:
        """Send facts that a reader sees beside the recording, and the versions of the packages that made it."""
        made_with: Any = {f"{name}_version": made for name, made in {**versions(), "rerun": rr.__version__}.items()}
        self.stream.send_property("pickenv", rr.AnyValues(**facts, **made_with))

    def document(self, entity: str, markdown: str) -> None:
        """Send a Markdown text for all time."""
        self.still(entity, rr.TextDocument(as_sentence(markdown), media_type="text/markdown"))

    def words(self, entity: str, place: ArrayLike, text: str) -> None:
        """Send a text at a place ``(3,)`` in space, m, for all time."""
        self.still(entity, rr.Points3D([place], labels=[in_words(text)], colors=[WHITE], radii=0.0, show_labels=True))

    def curve(self, entity: str, name: str, colour: Rgb, values: ArrayLike, width: float | None = None) -> None:
        """Send numbers along the time lines ``(T,)``, and how they are drawn; the width is in points."""
        widths = None if width is None else [width]
        self.still(entity, rr.SeriesLines(names=[in_words(name)], colors=[colour], widths=widths))
        self.along(entity, rr.Scalars.columns(scalars=values))

    def lane(self, entity: str, looks: Mapping[str, tuple[str, Rgb]], states: Sequence[str]) -> None:
        """Send states along the time lines ``(T,)``; each state has a label and a colour in ``looks``."""
        labels, colours = zip(*((in_words(label), (*colour, 255)) for label, colour in looks.values()), strict=True)
        self.still(entity, rr.StateConfiguration(values=list(looks), labels=labels, colors=colours))
        self.along(entity, rr.StateChange.columns(state=states))

    def arrows(self, entity: str, origins: Array, arrows: Array, values: Array, top: float, unit: str = "mm") -> None:
        """Send a field of arrows for all time, coloured by the length of ``values``.

        Args:
            entity: Name of the field.
            origins: Points at which the arrows start ``(N, 3)``, m.
            arrows: The arrows as drawn ``(N, 3)``, m.
            values: The vectors that a click reads out ``(N, 3)``, in ``unit``.
            top: Upper end of the colour scale, in ``unit``.
            unit: Unit of ``values``.
        """
        colours = viridis(np.linalg.norm(values, axis=-1) / top)
        archetype = rr.Arrows3D(
            origins=f32(origins), vectors=f32(arrows), colors=colours, radii=rr.Radius.ui_points(1.6)
        )
        self.still(entity, archetype, reading(values, unit))

    def arm(
        self, entity: str, points: Array, parts: list[int], colour: Rgb, fill_mode: Any, thickness: float = 1.0
    ) -> None:
        """Send a moving arm's look and places; ``points`` ``(T, K, 3)``, m, and ``parts`` are as in `capsules`."""
        count = len(parts)
        self.still(
            entity,
            rr.Capsules3D.from_fields(
                radii=f32(thickness * np.linspace(BASE_RADIUS, TOOL_RADIUS, count)),
                colors=[colour] * count,
                line_radii=rr.Radius.ui_points(0.6),
                fill_mode=fill_mode,
            ),
        )
        start, length, quaternion = capsules(points, parts)
        moving = rr.Capsules3D.columns(
            lengths=f32(length.ravel()),
            translations=f32(start.reshape(-1, 3)),
            quaternions=f32(quaternion.reshape(-1, 4)),
        )
        self.along(entity, moving.partition([len(parts)] * len(points)))

    def dots(self, entity: str, places: Array, colour: Rgb, radius: Any) -> None:
        """Send a moving ball's look and places ``(T, 3)``, m; the radius is in m, or a `rerun.Radius`."""
        self.still(entity, rr.Points3D.from_fields(colors=[colour], radii=radius))
        self.along(entity, rr.Points3D.columns(positions=f32(places)))

    def axes(self, entity: str, corner: ArrayLike, lengths: ArrayLike, labels: Sequence[str], width: float) -> None:
        """Send the world's axes from ``corner`` ``(3,)``, m, with ``lengths`` ``(3,)`` and labels; width in points."""
        arrows = rr.Arrows3D(
            origins=[corner] * 3,
            vectors=np.diag(lengths),
            colors=[WHITE] * 3,
            labels=labels,
            radii=rr.Radius.ui_points(width),
        )
        self.still(entity, arrows)

    def capture(self, entity: str, radius: float, opacity: int = 200, width: float = 0.8) -> None:
        """Send the gripper's capture region, a ball with the tolerance as radius; the width of lines is in points."""
        ball = rr.Ellipsoids3D.from_fields(
            half_sizes=[[radius] * 3],
            colors=[(*RED, opacity)],
            line_radii=rr.Radius.ui_points(width),
            fill_mode="majorwireframe",
        )
        self.still(entity, ball)

    def colour_bar(self, entity: str, top: float, unit: str) -> None:
        """Send a colour scale from 0 to ``top`` with its unit: an image and its ticks as entities below ``entity``."""
        width, height = COLOUR_BAR_PIXELS
        bar = np.broadcast_to(viridis((np.arange(width) + 0.5) / width), (height, width, 3))
        self.still(f"{entity}/bar", rr.Image(np.ascontiguousarray(bar)))
        at = ticks(top)
        positions = [(tick / top * width, height - 1.0) for tick in at]
        labels = [f"{tick:g}" for tick in at[:-1]] + [f"{at[-1]:g} {unit}"]
        words = rr.Points2D(positions, labels=labels, radii=0.0, colors=[WHITE], show_labels=True)
        self.still(f"{entity}/ticks", words)


def f32(values: ArrayLike) -> Any:
    """Values as 32-bit floats, the precision in which rerun keeps them."""
    return np.ascontiguousarray(values, dtype=np.float32)


def reading(vectors: Array, unit: str = "mm") -> rr.DynamicArchetype:
    """Numbers that a click on an arrow reads out: length and components of ``vectors`` ``(N, 3)``, in ``unit``."""
    return rr.DynamicArchetype("PickError", components=_readings(vectors, unit))


def reading_columns(vectors: Array) -> Iterable[rr.ComponentColumn]:
    """The numbers of `reading`, in mm, as columns with one row per moment."""
    return rr.DynamicArchetype.columns("PickError", components=_readings(vectors, "mm"))


def _readings(vectors: Array, unit: str) -> dict[str, Any]:
    lengths = f32(np.linalg.norm(vectors, axis=-1))
    return {f"norm_{unit}": lengths, f"xyz_{unit}": rr.components.Vector3DBatch(f32(vectors))}


BACKGROUND = (72, 72, 80)
"""Background of 3D views in either theme: a grey from which both ends of Viridis stand out."""
MOST_ABREAST = 4
"""Largest number of views in one row."""


def layout(content: Any, time_line: str | None, **time: Any) -> rrb.Blueprint:
    """A blueprint with all panels collapsed; unless ``time`` says otherwise, time is paused at first and then loops."""
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
    """A 3D view from the point ``eye`` to the point ``look`` ``(3,)``, m, with a grid on the ground or without."""
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
    """A view of a given kind that shows everything below an entity."""
    return kind(origin=f"/{entity}", contents=[f"+ /{entity}/**"], name=in_words(name), **more)


def with_colour_bar(views: list[Any], key: str, meaning: str, name: str) -> Any:
    """A tab: ``views`` side by side, in rows where they are many, and below them the colour bar `/legend/key`."""
    bounds = rrb.VisualBounds2D(x_range=[-14.0, 534.0], y_range=[-4.0, 20.0])
    bar = view_of(rrb.Spatial2DView, f"legend/{key}", meaning, background=BACKGROUND, visual_bounds=bounds)
    rows = rrb.Grid(*views, grid_columns=-(-len(views) // -(-len(views) // MOST_ABREAST)))
    return rrb.Vertical(rows, bar, row_shares=[5.2, 1.0], name=name)
