"""Every column of a comparison's recording, recomputed: nothing is shown that is not so, and nothing is left out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickenv.arm import Array, drawn_parts, forward, nominal_points, true_points
from pickenv.base import InputError
from pickenv.inspect import Comparison, record_comparison
from pickenv.inspect.colours import FRUIT, GREY, RED, STEEL, WHITE, as_sentence, in_words, lane
from pickenv.inspect.runs.comparison_summary import summary_markdown

GAIN = 20.0
COLOURS = {"raw": (230, 159, 0), "ls": (0, 114, 178), "ls_bpnn": (0, 158, 115)}
WIRE, SOLID = 1, 3
"""Of rerun's ways to fill a body."""


def test_the_scene_is_the_grid_and_the_fruit(reading: Any, comparison: Comparison) -> None:
    low = comparison.grid.origin - 0.5 * comparison.grid.step
    size = 10 * np.full(3, comparison.grid.step)
    assert np.all(comparison.grid.points > low) and np.all(comparison.grid.points < low + size)
    reading.holds(
        "/world/axes",
        origins=[low, low, low],
        vectors=[[size[0], 0, 0], [0, size[1], 0], [0, 0, size[2]]],
        colors=[WHITE] * 3,
        labels=["x 0.55 m", "y 0.55 m", "z 0.55 m"],
        radii=[-1.5],
    )
    reading.holds(
        "/world/workspace",
        centers=comparison.grid.origin + 4.5 * comparison.grid.step,
        half_sizes=5 * np.full(3, comparison.grid.step),
        colors=[(*GREY, 110)],
        radii=[-0.7],
        fill_mode=[WIRE],
    )
    reading.holds("/world/fruit", positions=comparison.fruit, colors=[FRUIT], radii=[0.008])


def test_three_arms_are_drawn_under_the_first_command(reading: Any, comparison: Comparison) -> None:
    first = comparison.policies[0]
    believed = nominal_points(comparison.nominal, first.ends.joint_command)
    true = true_points(comparison.plant.geometry, first.ends.joint_command, first.ends.tool_position)
    parts = drawn_parts(believed)
    np.testing.assert_allclose(
        believed[:, -1], forward(comparison.nominal, first.ends.joint_command).position, atol=1e-12
    )
    radii, count = np.linspace(0.03, 0.012, len(parts)), len(parts)
    for name, points, colour, mode, thick in (
        ("nominal", believed, GREY, WIRE, 1.0),
        ("true", true, STEEL, SOLID, 1.0),
        ("exaggerated", believed + GAIN * (true - believed), COLOURS["raw"], SOLID, 0.5),
    ):
        starts = points[:, parts]
        along = points[:, [i + 1 for i in parts]] - starts
        length = np.linalg.norm(along, axis=-1)
        entity = f"/world/arm/{name}"
        reading.holds(
            entity,
            translations=starts,
            lengths=length,
            quaternions=reading.values(entity, "Capsules3D:quaternions"),
            colors=[colour] * count,
            radii=thick * radii,
            line_radii=[-0.6],
            fill_mode=[mode],
        )
        x, y, z, w = reading.values(entity, "Capsules3D:quaternions").T
        turned = np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)], axis=-1)
        np.testing.assert_allclose(length.ravel()[:, None] * turned, along.reshape(-1, 3), atol=1e-6)


def test_a_reach_is_an_arrow_a_shot_a_number_and_an_outcome(reading: Any, comparison: Comparison) -> None:
    count, tolerance = len(comparison.fruit), comparison.tolerance_mm
    for policy in comparison.policies:
        colour, miss = COLOURS[policy.key], policy.ends.tool_position - comparison.fruit
        clicked = {"norm_mm": 1e3 * np.sqrt((miss**2).sum(axis=1)), "xyz_mm": 1e3 * miss}
        reading.holds(
            f"/world/miss/{policy.key}",
            origins=comparison.fruit,
            vectors=GAIN * miss,
            colors=[colour],
            radii=[-2.5],
            **clicked,
        )
        reading.holds(f"/target/{policy.key}", positions=1e3 * miss, colors=[colour], radii=[-3.0], **clicked)
        for name, values in (
            ("error_mm", policy.ends.position_error_mm),
            ("attitude_deg", policy.ends.attitude_error_deg),
        ):
            reading.holds(
                f"/metrics/{name}/{lane(policy.key)}",
                scalars=[float(f"{value:.4g}") for value in values],
                names=[in_words(policy.label)],
                colors=[colour],
                widths=[1.8],
            )
        reading.holds(
            f"/outcome/{lane(policy.key)}",
            state=np.where(policy.ends.success, "pick", "miss").astype(object),
            values=["pick", "miss"],
            labels=["pick", "miss"],
            colors=[colour, RED],
        )
        np.testing.assert_array_equal(reading.times(f"/world/miss/{policy.key}", "reach"), np.arange(count))
    reading.holds(
        "/metrics/tolerance_mm", scalars=[tolerance] * count, names=["tolerance 1 mm"], colors=[RED], widths=[1.5]
    )
    reading.holds(
        "/world/capture",
        centers=comparison.fruit,
        half_sizes=[1e-3 * GAIN * tolerance] * 3,
        colors=[(*RED, 160)],
        line_radii=[-0.6],
        fill_mode=[WIRE],
    )
    reading.holds(
        "/target/capture",
        half_sizes=[tolerance] * 3,
        colors=[(*RED, 200)],
        line_radii=[-0.8],
        fill_mode=[WIRE],
    )
    ends = [[tolerance, 0, 0], [0, tolerance, 0], [0, 0, tolerance]]
    reading.holds(
        "/target/axes", origins=[0.0] * 9, vectors=ends, colors=[WHITE] * 3, labels=["x", "y", "z"], radii=[-1.0]
    )


def test_bars_of_all_policies_stand_side_by_side_in_their_bin(reading: Any, comparison: Comparison) -> None:
    largest = max(policy.ends.position_error_mm.max() for policy in comparison.policies)
    found = []
    for policy in comparison.policies:
        entity = f"/hist/{lane(policy.key)}"
        middle = np.array(reading.component(entity, "BarChart:abscissa").to_pylist()[0][0]["buffer"])
        wide = reading.values(entity, "BarChart:widths")
        bars = np.array(reading.component(entity, "BarChart:values").to_pylist()[0][0]["buffer"])
        found.append((middle, wide))
        (packed,) = reading.values(entity, "BarChart:color")
        assert tuple(int(packed) >> shift & 0xFF for shift in (24, 16, 8, 0)) == (*COLOURS[policy.key], 255)
        step = middle[1] - middle[0]
        edges = step * np.arange(len(bars) + 1)
        assert edges[-2] <= largest < edges[-1]
        inside = [
            ((policy.ends.position_error_mm >= a) & (policy.ends.position_error_mm < b)).sum()
            for a, b in zip(edges[:-1] - 1e-9, edges[1:] - 1e-9, strict=True)
        ]
        assert bars.tolist() == inside
    (first, wide), (second, _), (third, _) = found
    step = first[1] - first[0]
    np.testing.assert_allclose(wide, 0.3 * step, rtol=1e-5)
    np.testing.assert_allclose(second, step * (np.arange(len(second)) + 0.5), rtol=1e-5)
    np.testing.assert_allclose(second - first, 0.3 * step, rtol=1e-4)
    np.testing.assert_allclose(third - second, 0.3 * step, rtol=1e-4)


def test_a_file_says_of_which_arm_and_how_drawn(reading: Any, comparison: Comparison) -> None:
    entity = "/__properties/pickenv"
    arm = comparison.plant.arm
    raw = 1e3 * np.linalg.norm(comparison.policies[0].field_errors, axis=1)
    stated = {
        name: reading.values(entity, name).tolist()
        for name in ("arm", "arm_fingerprint", "tolerance_mm", "colour_scale_mm", "gain", "seed", "plant", "policies")
    }
    assert stated.pop("colour_scale_mm") == pytest.approx([np.percentile(raw, 99)])
    assert stated == {
        "arm": [arm.name],
        "arm_fingerprint": [arm.fingerprint()],
        "tolerance_mm": [comparison.tolerance_mm],
        "gain": [GAIN],
        "seed": [7],
        "plant": ["qiao2026"],
        "policies": ["raw", "ls", "ls_bpnn"],
    }
    reading.holds("/summary", text=[as_sentence(summary_markdown(comparison))], media_type=["text/markdown"])


def dense(reading: Any, key: str) -> Array:
    (told,) = reading.component(f"/field/{key}/magnitude_mm", "Tensor:data").flatten().to_pylist()
    return np.asarray(told["buffer"]).reshape(told["shape"])


def test_a_field_alone_draws_a_grid_of_three_lengths_with_holes(
    without_reaches: Comparison, reader: Callable[[Path], Any], tmp_path: Path
) -> None:
    """Cells without a point are no number; and what is drawn is twenty times as long as it is."""
    wider = replace(without_reaches, grid=replace(without_reaches.grid, shape=(10, 11, 12)))
    reading = reader(record_comparison(wider, tmp_path / "errors.rrd"))
    values, (x, y, z) = dense(reading, "raw"), wider.grid.index.T
    assert values.shape == (12, 11, 10)
    magnitude = 1e3 * np.linalg.norm(wider.policies[0].field_errors, axis=1)
    np.testing.assert_allclose(values[z, y, x], magnitude, rtol=1e-6)
    assert np.isnan(values).sum() == 10 * 11 * 12 - len(magnitude)
    vectors = reading.values("/world/field/raw/vectors", "Arrows3D:vectors")
    np.testing.assert_allclose(vectors, 20.0 * wider.policies[0].field_errors, rtol=1e-6, atol=1e-9)
    (told,) = reading.component("/field/raw/magnitude_mm", "Tensor:data").to_pylist()[0]
    assert [name[0] for name in told["names"]] == ["z", "y", "x"]


@pytest.mark.parametrize("key", ["", "LS", "l s", "ls-bpnn"])
def test_a_key_is_lower_case_words(key: str, without_reaches: Comparison, tmp_path: Path) -> None:
    (raw,) = without_reaches.policies
    with pytest.raises(InputError, match="cannot name an entity"):
        record_comparison(replace(without_reaches, policies=(replace(raw, key=key),)), tmp_path / "errors.rrd")
