from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickenv.inspect import blueprint
from pickenv.inspect.comparison import Comparison
from pickenv.inspect.recording import record_comparison


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
    comparison: Comparison, reader: Callable[[Path], Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = blueprint._space

    def misspell(rrb: Any, comparison: Comparison, name: str, contents: list[str], **options: Any) -> Any:
        return whole(rrb, comparison, name, [rule.replace("/field/", "/fields/") for rule in contents], **options)

    monkeypatch.setattr(blueprint, "_space", misspell)
    broken = reader(record_comparison(comparison, tmp_path / "errors.rrd"))
    assert sorted(broken.unmatched_rules()) == sorted(
        f"/world/fields/{policy.key}/{kind}" for policy in comparison.policies for kind in ("vectors", "voxels")
    )


def test_the_fields_stand_side_by_side_with_the_gain_in_their_titles(reading: Any, comparison: Comparison) -> None:
    for policy in comparison.policies:
        mean = 1e3 * np.linalg.norm(policy.field_errors, axis=-1).mean()
        assert f"{policy.label} | mean {mean:.2f} mm | arrows ×25" in titles(reading)


def test_every_title_of_a_plot_names_its_unit(reading: Any) -> None:
    plots = [
        title for title in titles(reading) if "error of each" in title or "Reaches (up)" in title or "Colour" in title
    ]
    assert len(plots) == 3
    assert all("mm" in title for title in plots)


def test_all_views_of_the_workspace_start_with_the_same_eye(reading: Any, comparison: Comparison) -> None:
    eyes = [tuple(row[0]) for row in rows(reading, "EyeControls3D:position") if row]
    assert len(eyes) == 2 * len(comparison.policies) + 2
    workspace = {eye for eye in eyes if eyes.count(eye) > 1}
    assert len(workspace) == 1
    assert sum(eye in workspace for eye in eyes) == 2 * len(comparison.policies) + 1


@pytest.mark.parametrize("count", [1, 2, 5])
def test_any_number_of_policies_is_laid_out(
    count: int, comparison: Comparison, reader: Callable[[Path], Any], tmp_path: Path
) -> None:
    first = comparison.policies[0]
    policies = tuple(replace(first, key=f"policy_{i}", label=f"policy {i}") for i in range(count))
    reading = reader(record_comparison(replace(comparison, policies=policies), tmp_path / "errors.rrd"))
    assert reading.unmatched_rules() == []
    assert sum(" | mean " in title for title in titles(reading)) == count
