"""A comparison as one Rerun recording: error fields, reaches, arms, statistics, and the blueprint that lays them out.

Everything is sent as whole columns without wall-clock times, so equal comparisons give equal recordings. The only time
line is `reach`, the number of the reach. Metres in space; millimetres and degrees on plots, as their titles say.
"""

from __future__ import annotations

import platform
from collections.abc import Iterable
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from pickenv.arm.geometry import Array
from pickenv.errors import InputError
from pickenv.files import write_whole
from pickenv.inspect.blueprint import comparison_blueprint
from pickenv.inspect.colours import RED, Rgb, policy_colours, policy_key, viridis
from pickenv.inspect.comparison import Comparison, PolicyErrors
from pickenv.inspect.links import capsules, drawn_parts, nominal_points, true_points
from pickenv.inspect.summary import colour_scale_mm, field_mm, histogram_edges_mm, summary_markdown, ticks_mm
from pickenv.inspect.view import cut_away

if TYPE_CHECKING:
    import rerun as rr

APPLICATION_ID = "pickenv"
TIME_LINE = "reach"

GREY: Rgb = (150, 150, 158)
STEEL: Rgb = (190, 194, 204)
FRUIT: Rgb = (222, 202, 160)
BASE_RADIUS, TOOL_RADIUS = 0.030, 0.012
"""m; links are drawn thinner from base to tool."""
FRUIT_RADIUS = 0.008
"""m; smaller than an apple, so that a hundred of them hide nothing."""
COLOUR_BAR_PIXELS = (512, 7)


def record_comparison(comparison: Comparison, path: str | Path, *, gain: float = 20.0) -> Path:
    """Write ``comparison`` as a Rerun recording (.rrd) with its blueprint inside, whole or not at all.

    Args:
        comparison: What to show.
        path: The file to write, usually `errors.rrd`; missing folders are made.
        gain: How much longer than true size errors are drawn.

    Returns:
        The path written.

    Raises:
        InputError: If there is no policy or a key repeats or cannot be part of an entity path, if the gain is not above
            zero, or if the file cannot be written.
    """
    _check(comparison, gain)
    return write_whole(path, lambda temporary: _write(comparison, temporary, gain))


def recording_id(comparison: Comparison) -> str:
    """Identity of a recording: recordings of one scene and seed are shown as one."""
    return f"{comparison.plant.name}:seed{comparison.seed}"


def _check(comparison: Comparison, gain: float) -> None:
    keys = [policy.key for policy in comparison.policies]
    if not keys:
        raise InputError("the comparison has no policy; give at least one")
    for key in keys:
        if not key or key != policy_key(key):
            raise InputError(
                f"policy key '{key}' cannot name an entity; use lower-case letters, digits and underscores"
            )
        if keys.count(key) > 1:
            raise InputError(f"policy key '{key}' is given twice; give every policy its own key")
    if not gain > 0.0:
        raise InputError(f"the gain is {gain}; give a number above zero")


def _write(comparison: Comparison, path: Path, gain: float) -> None:
    import rerun as rr
    from rerun.chunk import RrdReader

    blueprint = comparison_blueprint(comparison, gain)
    try:
        with rr.RecordingStream(APPLICATION_ID, recording_id=recording_id(comparison), send_properties=False) as stream:
            stream.save(path, default_blueprint=blueprint)
            _send(_Scribe(stream, len(comparison.fruit)), comparison, gain)
        RrdReader(path).store()  # refuses a file without the footer that ends a finished recording
    except RuntimeError as error:  # a full disk ends rerun's writer thread, and its reader meets half a file
        raise OSError(f"{error}; is the disk full, or the variable RERUN set to off?") from error


def _send(scribe: _Scribe, comparison: Comparison, gain: float) -> None:
    _send_properties(scribe, comparison, gain)
    _send_scene(scribe, comparison, gain)
    for policy, colour in zip(comparison.policies, _colours(comparison), strict=True):
        _send_field(scribe, comparison, policy, gain)
        _send_reaches(scribe, comparison, policy, colour, gain)
    _send_tolerance(scribe, comparison, gain)
    _send_histograms(scribe, comparison)
    _send_legend(scribe, comparison, gain)


class _Scribe:
    """Sends columns to one stream, either for all time or along the time line `reach`."""

    def __init__(self, stream: rr.RecordingStream, reaches: int) -> None:
        self.stream, self.reaches = stream, reaches

    def still(self, entity: str, *content: rr.AsComponents) -> None:
        """Send archetypes that hold for all time, all of an entity in one chunk."""
        import rerun as rr

        columns: list[rr.ComponentColumn] = []
        for archetype in content:
            for batch in archetype.as_component_batches():
                columns.append(
                    rr.ComponentColumn(batch.component_descriptor(), batch, lengths=[len(batch.as_arrow_array())])
                )
        self.stream.send_columns(entity, [], columns, strict=True)

    def along(self, entity: str, *columns: Iterable[rr.ComponentColumn]) -> None:
        """Send columns with one row per reach; nothing is sent when there are no reaches."""
        import rerun as rr

        if self.reaches:
            time = rr.TimeColumn(TIME_LINE, sequence=np.arange(self.reaches))
            self.stream.send_columns(entity, [time], [c for several in columns for c in several], strict=True)


def _colours(comparison: Comparison) -> list[Rgb]:
    return policy_colours([policy.key for policy in comparison.policies])


def _f32(values: ArrayLike) -> Any:
    return np.ascontiguousarray(values, dtype=np.float32)


def _send_properties(scribe: _Scribe, comparison: Comparison, gain: float) -> None:
    import rerun as rr

    try:
        version = metadata.version("pickenv")
    except metadata.PackageNotFoundError:
        version = "not installed"
    scribe.stream.send_property(
        "pickenv",
        rr.AnyValues(
            plant=comparison.plant.name,
            arm=comparison.plant.arm.name,
            arm_fingerprint=comparison.plant.arm.fingerprint(),
            seed=comparison.seed,
            policies=[policy.key for policy in comparison.policies],
            gain=gain,
            tolerance_mm=comparison.tolerance_mm,
            colour_scale_mm=colour_scale_mm(comparison),
            pickenv_version=version,
            rerun_version=rr.__version__,
            numpy_version=np.__version__,
            python_version=platform.python_version(),
        ),
    )


def _send_scene(scribe: _Scribe, comparison: Comparison, gain: float) -> None:
    """The field's bounds with the world's axes, the fruit, and three arms under the first policy's commands."""
    import rerun as rr

    size = np.asarray(comparison.grid_shape) * comparison.grid_step
    corner = comparison.grid_origin - comparison.grid_step / 2.0
    scribe.still(
        "world/axes",
        rr.Arrows3D(
            origins=[corner] * 3,
            vectors=np.diag(size),
            colors=[STEEL] * 3,
            labels=[f"{axis} {length:.2f} m" for axis, length in zip("xyz", size, strict=True)],
            radii=rr.Radius.ui_points(1.5),
        ),
    )
    scribe.still(
        "world/workspace",
        rr.Boxes3D(
            centers=[corner + size / 2.0],
            half_sizes=[size / 2.0],
            colors=[(*GREY, 110)],
            radii=rr.Radius.ui_points(0.7),
            fill_mode="majorwireframe",
        ),
    )
    if not scribe.reaches:
        return
    scribe.still("world/fruit", rr.Points3D(comparison.fruit, colors=[FRUIT], radii=FRUIT_RADIUS))
    first = comparison.policies[0]
    believed = nominal_points(comparison.nominal, first.reach_joints)
    true = true_points(comparison.plant.geometry, first.reach_joints, first.reach_positions)
    parts = drawn_parts(believed)
    drawn = believed + gain * (true - believed)
    _send_arm(scribe, "world/arm/nominal", believed, parts, GREY, "majorwireframe", 1.0)
    _send_arm(scribe, "world/arm/true", true, parts, STEEL, "solid", 1.0)
    _send_arm(scribe, "world/arm/exaggerated", drawn, parts, _colours(comparison)[0], "solid", 0.5)


def _send_arm(
    scribe: _Scribe, entity: str, points: Array, parts: list[int], colour: Rgb, fill_mode: Any, thickness: float
) -> None:
    """An arm that stands at another pose at every reach; ``points`` is ``(R, K, 3)``."""
    import rerun as rr

    rods, count = capsules(points, parts), len(parts)
    lengths = [count] * scribe.reaches
    scribe.still(
        entity,
        rr.Capsules3D.from_fields(
            radii=_f32(thickness * np.linspace(BASE_RADIUS, TOOL_RADIUS, count)),
            colors=[colour] * count,
            line_radii=rr.Radius.ui_points(0.6),
            fill_mode=fill_mode,
        ),
    )
    moving = rr.Capsules3D.columns(
        lengths=_f32(rods.length.ravel()),
        translations=_f32(rods.start.reshape(-1, 3)),
        quaternions=_f32(rods.quaternion.reshape(-1, 4)),
    )
    scribe.along(entity, moving.partition(lengths))


def _pick_error(errors: Array) -> rr.DynamicArchetype:
    """What a click on an arrow reads out: the error's length and components, mm; ``errors`` is ``(N, 3)`` in m."""
    import rerun as rr

    xyz = rr.components.Vector3DBatch(_f32(errors * 1e3))
    return rr.DynamicArchetype(
        "PickError", components={"norm_mm": _f32(np.linalg.norm(errors, axis=-1) * 1e3), "xyz_mm": xyz}
    )


def _send_field(scribe: _Scribe, comparison: Comparison, policy: PolicyErrors, gain: float) -> None:
    """One policy's error field three times: arrows, voxels, and a tensor for slices."""
    import rerun as rr

    entity, top, magnitude = f"world/field/{policy.key}", colour_scale_mm(comparison), field_mm(policy)
    scribe.still(
        f"{entity}/vectors",
        rr.Arrows3D(
            origins=_f32(comparison.field_points),
            vectors=_f32(gain * policy.field_errors),
            colors=viridis(magnitude / top),
            radii=rr.Radius.ui_points(1.6),
        ),
        _pick_error(policy.field_errors),
    )
    kept = ~cut_away(comparison)
    scribe.still(
        f"{entity}/voxels",
        rr.VoxelGridMap(
            np.asarray(comparison.field_index[kept], dtype=np.int32),
            [comparison.grid_step] * 3,
            values=_f32(magnitude[kept]),
            value_range=[0.0, top],
            colormap="Viridis",
            translation=comparison.grid_origin - comparison.grid_step / 2.0,
        ),
    )
    grid = np.full(comparison.grid_shape, np.nan, dtype=np.float32)
    grid[tuple(np.asarray(comparison.field_index).T)] = magnitude
    scribe.still(
        f"field/{policy.key}/magnitude_mm",
        rr.Tensor(np.ascontiguousarray(grid.transpose(2, 1, 0)), dim_names=["z", "y", "x"], value_range=[0.0, top]),
    )


def _send_reaches(scribe: _Scribe, comparison: Comparison, policy: PolicyErrors, colour: Rgb, gain: float) -> None:
    """One policy's reaches along the time line: the miss as an arrow, the errors as numbers, and pick or miss."""
    import rerun as rr

    if not scribe.reaches:
        return
    miss = policy.reach_positions - comparison.fruit
    entity = f"world/miss/{policy.key}"
    scribe.still(entity, rr.Arrows3D.from_fields(colors=[colour], radii=rr.Radius.ui_points(2.5)))
    error_columns = rr.DynamicArchetype.columns(
        "PickError",
        components={
            "norm_mm": _f32(np.linalg.norm(miss, axis=-1) * 1e3),
            "xyz_mm": rr.components.Vector3DBatch(_f32(miss * 1e3)),
        },
    )
    arrows = rr.Arrows3D.columns(origins=_f32(comparison.fruit), vectors=_f32(gain * miss))
    scribe.along(entity, arrows, error_columns)
    shots = rr.Points3D(_f32(miss * 1e3), colors=[colour], radii=rr.Radius.ui_points(3.0))
    scribe.still(f"target/{policy.key}", shots, _pick_error(miss))
    for name, values in (("error_mm", policy.position_error_mm), ("attitude_deg", policy.attitude_error_deg)):
        entity = f"metrics/{name}/{policy.key}"
        scribe.still(entity, rr.SeriesLines(names=[policy.label], colors=[colour], widths=[1.8]))
        scribe.along(entity, rr.Scalars.columns(scalars=values))
    entity = f"outcome/{policy.key}"
    configuration = rr.StateConfiguration(
        values=["pick", "miss"], labels=["pick", "miss"], colors=[(*colour, 255), (*RED, 255)]
    )
    scribe.still(entity, configuration)
    scribe.along(entity, rr.StateChange.columns(state=["pick" if ok else "miss" for ok in policy.success]))


def _send_tolerance(scribe: _Scribe, comparison: Comparison, gain: float) -> None:
    """The gripper's capture region: a line on the error plot and, enlarged like the errors, a ball around the fruit."""
    import rerun as rr

    if not scribe.reaches:
        return
    line = rr.SeriesLines(names=[f"tolerance {comparison.tolerance_mm:g} mm"], colors=[RED], widths=[1.5])
    scribe.still("metrics/tolerance_mm", line)
    scribe.along("metrics/tolerance_mm", rr.Scalars.columns(scalars=[comparison.tolerance_mm] * scribe.reaches))
    radius = gain * comparison.tolerance_mm * 1e-3
    ball = rr.Ellipsoids3D.from_fields(
        half_sizes=[[radius] * 3], colors=[(*RED, 160)], line_radii=rr.Radius.ui_points(0.6), fill_mode="majorwireframe"
    )
    scribe.still("world/capture", ball)
    sphere = rr.Ellipsoids3D(
        half_sizes=[[comparison.tolerance_mm] * 3],
        colors=[(*RED, 200)],
        line_radii=rr.Radius.ui_points(0.8),
        fill_mode="majorwireframe",
    )
    scribe.still("target/capture", sphere)
    axes = rr.Arrows3D(
        origins=np.zeros((3, 3)),
        vectors=comparison.tolerance_mm * np.eye(3),
        colors=[STEEL] * 3,
        labels=["x", "y", "z"],
        radii=rr.Radius.ui_points(1.0),
    )
    scribe.still("target/axes", axes)
    scribe.along("world/capture", rr.Ellipsoids3D.columns(centers=_f32(comparison.fruit)))


def _send_histograms(scribe: _Scribe, comparison: Comparison) -> None:
    """Reach errors in bins that all policies share; within a bin the policies' bars stand side by side."""
    import rerun as rr

    edges, count = histogram_edges_mm(comparison), len(comparison.policies)
    width = float(edges[1] - edges[0]) * 0.9 / count
    for i, (policy, colour) in enumerate(zip(comparison.policies, _colours(comparison), strict=True)):
        numbers, _ = np.histogram(policy.position_error_mm, edges)
        middle = (edges[:-1] + edges[1:]) / 2.0 + (i - (count - 1) / 2.0) * width
        chart = rr.BarChart(
            numbers, abscissa=_f32(middle), widths=_f32(np.full(len(numbers), width)), color=(*colour, 255)
        )
        scribe.still(f"hist/{policy.key}", chart)


def _send_legend(scribe: _Scribe, comparison: Comparison, gain: float) -> None:
    """The colour bar with its unit, and the summary."""
    import rerun as rr

    top, (width, height) = colour_scale_mm(comparison), COLOUR_BAR_PIXELS
    bar = np.broadcast_to(viridis((np.arange(width) + 0.5) / width), (height, width, 3))
    scribe.still("legend/bar", rr.Image(np.ascontiguousarray(bar)))
    ticks = ticks_mm(top)
    positions = [(tick / top * width, height + 5.0) for tick in ticks]
    labels = [f"{tick:g}" for tick in ticks[:-1]] + [f"{ticks[-1]:g} mm"]
    scribe.still("legend/ticks", rr.Points2D(positions, labels=labels, radii=0.0, colors=[STEEL], show_labels=True))
    scribe.still("summary", rr.TextDocument(summary_markdown(comparison, gain), media_type="text/markdown"))
