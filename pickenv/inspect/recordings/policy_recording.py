"""Write a comparison of policies as one Rerun recording: verdict, error fields over the workspace, and all episodes.

The scenes of all policies are side by side in one space, so that one camera shows all of them. The time lines are as in
`episode_entities`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from pickenv.arm import Array
from pickenv.inspect.colours import lane
from pickenv.inspect.figures.plot_errors import field_gain
from pickenv.inspect.recordings import episode_entities as entities
from pickenv.inspect.recordings.scribe import Scribe, seen_from, view_of, with_colour_bar, write_recording
from pickenv.inspect.runs.comparison_summary import GAIN, comparison_markdown, error_spread, field_mm, scale_end
from pickenv.inspect.runs.recorded_episodes import Comparison, RecordedEpisodes, RecordedPolicy
from pickenv.inspect.runs.run_folder import shown_box

SIDEWAYS = np.array([0.8, 0.6, 0.0])
"""Direction to the scene of the next policy: to the right as the camera sees it."""
APART = 1.25
"""Distance between the scenes of neighbouring policies, in widths of one scene."""


def record_policies(episodes: RecordedEpisodes, path: str | Path) -> Path:
    """Write a comparison of policies as a Rerun recording (.rrd) that includes its layout (blueprint), atomically.

    Args:
        episodes: The episodes of every policy. If they are a `Comparison`, its errors over the workspace are shown too.
        path: The file to write.

    Returns:
        The path written.

    Raises:
        InputError: If the file cannot be written.
    """
    names = episodes.env_id.rpartition("/")[2], episodes.plant_name, f"seed{episodes.seed}", "compared"

    def send(stream: rr.RecordingStream) -> None:
        labels = [policy.label for policy in episodes.policies]
        Scribe(stream).properties(seed=episodes.seed, policies=labels, gripper=episodes.gripper)
        _send_episodes(stream, episodes)
        if isinstance(episodes, Comparison):
            _send_fields(stream, episodes)

    return write_recording(path, ":".join(filter(None, names)), _blueprint(episodes), send)


def rows_of(policy: RecordedPolicy, *, arm: bool) -> list[entities.Row]:
    """Return a policy's episodes as recorded steps, each with its `info`.

    Args:
        policy: The policy's recorded episodes.
        arm: Whether to add the joint command to `info`, so that the arm can be drawn.
    """
    names = ["position_error_mm", "picked", "tool_position", "fruit_position", "joint_target", "reward"]
    names += ["attitude_error_deg"] * (not np.isnan(policy.attitude_error_deg).all()) + ["joint_command"] * arm
    told = {name: getattr(policy, name) for name in names} | {"is_success": policy.success}
    return [
        entities.Row(e, t, e, {name: v[e, t].item() if v.ndim == 2 else v[e, t] for name, v in told.items()})
        for e, moments in enumerate(policy.moments)
        for t in range(int(moments))
    ]


def _send_episodes(stream: rr.RecordingStream, episodes: RecordedEpisodes) -> None:
    scribe = Scribe(stream)
    low, high, step = _box(episodes)
    for number, (policy, colour) in enumerate(zip(episodes.policies, episodes.colours, strict=True)):
        rows = rows_of(policy, arm=episodes.nominal is not None)
        scene = entities.Scene(episodes.nominal, episodes.period, episodes.tolerance_mm, policy.label, colour)
        root = f"side/{lane(policy.key)}"
        scribe.still(root, rr.Transform3D(translation=number * step))
        above = [(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0, high[2] + 0.1 * (high[2] - low[2])]
        scribe.still(f"{root}/colour", rr.Points3D([above], colors=[colour], radii=rr.Radius.ui_points(6.0)))
        scribe.words(f"{root}/name", above, policy.label)
        entities.send_steps(stream, scene, policy.key, rows, root=root)
        misses = 1e3 * (policy.ends.tool_position - policy.ends.fruit_position)
        scribe.still(f"ends/{policy.key}", rr.Points3D(misses, colors=[colour], radii=rr.Radius.ui_points(3.0)))
    scribe.document("verdict", comparison_markdown(episodes))


def _send_fields(stream: rr.RecordingStream, comparison: Comparison) -> None:
    """Send the error field of each policy and the first policy's errors minus the last policy's, all side by side."""
    scribe, (top, gain, step) = Scribe(stream), _field_scale(comparison)
    centre, radius = shown_box(comparison)
    above = centre + np.array([0.0, 0.0, 0.8 * radius])
    for number, (name, title, errors) in enumerate(_fields(comparison)):
        scribe.still(f"fields/{name}", rr.Transform3D(translation=number * step))
        scribe.words(f"fields/{name}/name", above, title)
        scribe.arrows(f"fields/{name}/vectors", comparison.grid.points, gain * errors, 1e3 * errors, top)
    scribe.colour_bar("legend/position", top, "mm")


def _fields(comparison: Comparison) -> list[tuple[str, str, Array]]:
    """Return the error field of each policy, and the difference field.

    A field is given by the name of its entity, its title, and its errors ``(F, 3)``, m. The difference is the first
    policy's errors minus the last policy's errors. For a single policy there is none.
    """
    policies = comparison.policies
    first, last = policies[0], policies[-1]
    fields = [(lane(p.key), f"{p.label}: {error_spread(field_mm(p))[0]:.3f} mm", p.field_errors) for p in policies]
    if first is not last:
        fields.append(("9_difference", f"{first.label} minus {last.label}", first.field_errors - last.field_errors))
    return fields


def _field_scale(comparison: Comparison) -> tuple[float, float, Array]:
    """Return three values that all error fields share.

    The first is the upper end of the colour scale, mm. The second is the factor by which arrows are longer than true.
    The third is the shift from one field to the next ``(3,)``, m.
    """
    top = max(scale_end(field_mm(policy)) for policy in comparison.policies)
    return top, field_gain(comparison.grid.step, top), APART * 2.0 * shown_box(comparison)[1] * SIDEWAYS


def _blueprint(episodes: RecordedEpisodes) -> rrb.Blueprint:
    (low, high, step), count = _box(episodes), len(episodes.policies)
    middle = (low + high) / 2.0 + (count - 1) / 2.0 * step
    distance = 0.6 * float(np.linalg.norm(high - low)) + 0.28 * (count - 1) * float(np.linalg.norm(step))
    eye = middle + distance * entities.EYE
    subject = "Tool and fruit" if episodes.nominal is None else f"Believed arm (wire), true arm's deviation ×{GAIN:g}"
    # The arm at true size stands in the enlarged one and would hide it.
    hidden = [f"- /side/{lane(policy.key)}/arm/true/**" for policy in episodes.policies]
    side = seen_from(eye, middle, "/side", ["+ /side/**", *hidden], f"{subject}; last episode")
    verdict = rrb.TextDocumentView(origin="/verdict", contents=["+ /verdict"], name="Who is better")
    target = entities.target_view(episodes.largest_mm, episodes.tolerance_mm)
    first = rrb.Horizontal(
        rrb.Vertical(side, verdict), rrb.Vertical(entities.distance_plot(), target), name="Who is better"
    )
    fields = [_field_tab(episodes)] if isinstance(episodes, Comparison) else []
    info = rows_of(episodes.policies[0], arm=False)[0].info
    lanes = view_of(rrb.StateTimelineView, "outcome", "Success, last episode")
    numbers = rrb.Vertical(rrb.Horizontal(*entities.number_plots(info)), lanes, name="Numbers")
    return entities.at_the_end(rrb.Tabs(first, *fields, numbers, active_tab=0))


def _field_tab(comparison: Comparison) -> Any:
    centre, radius = shown_box(comparison)
    (top, gain, step), count = _field_scale(comparison), len(_fields(comparison))
    middle = centre + (count - 1) / 2.0 * step
    eye = middle + (radius + 0.25 * (count - 1) * float(np.linalg.norm(step))) * entities.EYE
    name = f"Final misses by goal, one eye for all, arrows ×{gain:g}"
    view = seen_from(eye, middle, "/fields", ["+ /fields/**"], name)
    return with_colour_bar([view], "position", f"Colour: miss, 0 to {top:.2f} mm", f"Where, arrows ×{gain:g}")


def _box(episodes: RecordedEpisodes) -> tuple[Array, Array, Array]:
    """Return the box around tools, fruit and base, and the shift between the scenes of two policies.

    The box is given by two opposite corners ``(3,)`` each, m. The first corner has the smallest coordinates. The shift
    ``(3,)``, m, leads from a policy's scene to the next policy's scene.
    """
    points = [values.reshape(-1, 3) for p in episodes.policies for values in (p.tool_position, p.fruit_position)]
    if episodes.nominal is not None:
        points.append(episodes.nominal.base.position[None])
    every = np.concatenate(points)
    low, high = every.min(axis=0), every.max(axis=0)
    return low, high, APART * float(np.linalg.norm((high - low)[:2])) * SIDEWAYS
