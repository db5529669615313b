"""What maintainers run besides: lowest versions, licences, benchmarks that became slower."""

import sys
import tomllib
from importlib.metadata import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / ".ci"))

from benchmark_history import LOOK_BACK, slower  # noqa: E402
from lowest_versions import brought, lowest  # noqa: E402

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


@pytest.mark.parametrize(
    ("asked", "constraint"),
    [
        ("numpy>=2", "numpy==2.0.*"),
        ("scipy>=1.15,<2", "scipy==1.15.*"),
        ("minari[hdf5]>=0.5.1", "minari==0.5.*"),
        ("x", None),
    ],
)
def test_the_lowest_version_is_the_latest_repair_of_the_lowest_minor(asked: str, constraint: str | None) -> None:
    assert lowest(Requirement(asked)) == constraint


def test_the_lowest_versions_satisfy_what_is_asked_for_by_all() -> None:
    extras = PROJECT["optional-dependencies"]
    asked = brought(["pickenv[all]"], extras)
    assert {"torch", "rerun-sdk", "pyarrow", "stable-baselines3"} <= {each.name for each in asked}
    for each in asked:
        found = lowest(each)
        assert found is not None and each.specifier.contains(found.partition("==")[2].replace("*", "99"))


def test_a_licence_is_stated_for_every_package_that_the_core_brings() -> None:
    for package in (metadata(Requirement(text).name) for text in PROJECT["dependencies"]):
        stated = [package.get("License-Expression"), package.get("License"), *package.get_all("Classifier", [])]
        assert any(text and ("License ::" in text or "::" not in text) for text in stated), package["Name"]


def test_slower_is_judged_against_the_last_runs_only() -> None:
    old = [{"benchmark": "fk", "ratio": "9"}] + [{"benchmark": "fk", "ratio": "1"}] * LOOK_BACK
    assert slower(old, {"fk": 1.4, "new": 50.0}) == []
    assert slower(old, {"fk": 1.6}) == [f"fk takes 1.60 times as long as in the last {LOOK_BACK} runs"]
    assert slower(old[:1], {"fk": 1.6}) == []
