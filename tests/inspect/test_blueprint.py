from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickenv.inspect import Comparison, record_comparison
from pickenv.inspect.colours import in_words
from pickenv.inspect.recordings import comparison_recording


def rows(reading: Any, component: str) -> list[Any]:
    """All rows of one component of the embedded blueprint, whatever the view."""
    batches = [chunk.to_record_batch() for chunk in reading.blueprint.stream()]
    return [row for b in batches if component in b.schema.names for row in b.column(component).to_pylist()]


def titles(reading: Any) -> list[str]:
    return [row[0] for row in rows(reading, "ViewBlueprint:display_name") if row]


def test_every_include_rule_matches_a_logged_entity(reading: Any) -> None:
    assert len(reading.rules()) > 20
    assert reading.unmatched_rules() == []


def test_a_misspelt_include_rule_is_noticed(
    few: Comparison, reader: Callable[[Path], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = comparison_recording.space

    def misspell(comparison: Comparison, name: str, contents: list[str], **options: Any) -> Any:
        return whole(comparison, name, [rule.replace("/field/", "/fields/") for rule in contents], **options)

    monkeypatch.setattr(comparison_recording, "space", misspell)
    broken = reader(record_comparison(few, tmp_path / "errors.rrd"))
    misspelt = [f"/world/fields/{p.key}/{kind}" for p in few.policies for kind in ("vectors", "voxels")]
    assert sorted(broken.unmatched_rules()) == sorted([*misspelt, "/world/fields/removed/vectors"])


def test_the_fields_stand_side_by_side_with_the_gain_in_their_titles(reading: Any, comparison: Comparison) -> None:
    for policy in comparison.policies:
        mean = 1e3 * np.linalg.norm(policy.field_errors, axis=-1).mean()
        assert f"{in_words(policy.label)} | mean {mean:.2f} mm | arrows ×20" in titles(reading)


def test_every_title_of_a_plot_names_its_unit(reading: Any) -> None:
    words = ("error of each", "Reaches by", "Colour", "Position error", "mean")
    plots = [title for title in titles(reading) if any(word in title for word in words)]
    assert len(plots) == 2 + 6 + 1 + 3 + 1 + 4 + 3 + 2
    assert all("mm" in title or "°" in title for title in plots)


def test_every_part_of_the_comparison_has_its_tab(reading: Any, without_reaches: Comparison) -> None:
    names = [row[0] for row in rows(reading, "ContainerBlueprint:display_name") if row]
    tabs = ("Error fields", "Picking", "Voxels", "Slices", "True arm", "Effects", "Attitude", "Predicted", "A day in")
    for tab in tabs:
        assert any(name.startswith(tab) for name in names), tab
    assert "Reaches as a table" in titles(reading)


def test_all_views_of_the_workspace_start_with_the_same_eye(reading: Any, comparison: Comparison) -> None:
    eyes = [tuple(row[0]) for row in rows(reading, "EyeControls3D:position") if row]
    effects, attitudes, uncertainties, arms, removed, picking = 4, 3, 2, 2, 1, 1
    workspace = 2 * len(comparison.policies) + effects + attitudes + uncertainties + arms + removed + picking
    assert len(eyes) == workspace + 1  # the misses seen from the fruit have an eye of their own
    assert max(eyes.count(eye) for eye in eyes) == workspace


@pytest.mark.parametrize("count", [1, 5])
def test_any_number_of_policies_is_laid_out(
    count: int, few: Comparison, reader: Callable[[Path], Any], tmp_path: Path
) -> None:
    first = few.policies[0]
    policies = tuple(replace(first, key=f"policy_{i}", label=f"policy {i}") for i in range(count))
    reading = reader(record_comparison(replace(few, policies=policies), tmp_path / "errors.rrd"))
    assert reading.unmatched_rules() == []
    fields = [title for title in titles(reading) if title.endswith("arrows ×20") and "policy" in title]
    assert len(fields) == count
