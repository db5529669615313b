"""The page that turns an arm's error shows every shipped plant, weighs little, and says what the library computes."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import load_plant, shipped_plants

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "scripts"))

import explorer  # noqa: E402

CONTENT = json.loads(explorer.FIELDS.read_text(encoding="utf-8").removeprefix(explorer.ASSIGNED).rstrip(";\n"))
HEAVY = 3_000_000
"""Bytes of all that the page loads besides the theme."""


def test_every_shipped_plant_is_there_and_all_of_it_is_small():
    assert {field["plant"] for field in CONTENT["plants"]} == set(shipped_plants())
    assert sum(path.stat().st_size for path in (ROOT / "docs/_static").glob("explorer*")) < HEAVY


def test_means_and_largest_errors_are_those_of_the_arrows():
    for field in CONTENT["plants"]:
        assert [stage["label"] for stage in field["stages"]] == ["raw", "LS", "LS+BPNN", "LS+GP"]
        for stage in field["stages"]:
            lengths = np.linalg.norm(stage["errors_um"], axis=1) / 1e3
            assert len(lengths) == len(CONTENT["arms"][field["arm"]]) > 200
            assert [stage["mean_mm"], stage["largest_mm"]] == pytest.approx([lengths.mean(), lengths.max()], abs=2e-3)


@pytest.mark.slow
def test_a_field_made_anew_is_the_one_that_is_shipped():
    pytest.importorskip("torch", reason="a network learns")
    plant = load_plant("qiao2026")
    joints = explorer.places(plant)
    shipped = next(field for field in CONTENT["plants"] if field["plant"] == plant.name)
    again = explorer.field(plant, joints)
    np.testing.assert_allclose(CONTENT["arms"][plant.arm.name], explorer.drawn(plant, joints), atol=1)
    for old, new in zip(shipped.pop("stages"), again.pop("stages"), strict=True):
        last = 1 if old["label"] in ("raw", "LS") else 5  # sums of learnt models round as the processor does
        np.testing.assert_allclose(old["errors_um"], new["errors_um"], atol=last)
        assert [old["mean_mm"], old["largest_mm"]] == pytest.approx(
            [new["mean_mm"], new["largest_mm"]], abs=1e-3 * last
        )
    assert again == pytest.approx(shipped)


@pytest.mark.parametrize("page", ["README.md", "docs/index.md"])
def test_readers_find_it(page):
    assert "explorer.md)" in (ROOT / page).read_text(encoding="utf-8")
    assert "scripts/explorer.py" in (ROOT / "docs/explorer.md").read_text(encoding="utf-8")
