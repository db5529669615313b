"""The tested versions satisfy what the project asks for, and its version is the same wherever it stands."""

import re
import tomllib
from pathlib import Path

import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from pickenv.base import EXTRAS

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def pinned_versions() -> dict[str, str]:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pins = [line.split("==") for line in lines if line and not line.startswith("#")]
    return {canonicalize_name(name): version for name, version in pins}


def brought_by(extra: str) -> set[str]:
    """Packages of an extra, and of those that it names."""
    asked = [Requirement(text) for text in PROJECT["optional-dependencies"][extra]]
    deeper = [brought_by(other) for r in asked if r.name == "pickenv" for other in r.extras]
    return {canonicalize_name(r.name) for r in asked if r.name != "pickenv"}.union(*deeper)


def test_every_requirement_has_a_tested_version_in_its_range() -> None:
    pinned, extras = pinned_versions(), PROJECT["optional-dependencies"]
    texts = [text for texts in [PROJECT["dependencies"], *extras.values()] for text in texts]
    asked = [r for r in map(Requirement, texts) if r.name != "pickenv"]
    assert len(asked) > 30
    assert [str(r) for r in asked if pinned.get(canonicalize_name(r.name), "none") not in r.specifier] == []


def test_the_version_is_the_same_everywhere() -> None:
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (.+)$", citation, re.MULTILINE) == [PROJECT["version"]]


PACKAGES = {
    "PIL": "pillow",
    "cv2": "opencv-python-headless",
    "rerun": "rerun-sdk",
    "skimage": "scikit-image",
}
"""Packages whose module has another name."""


def test_the_sentence_about_a_missing_module_names_an_extra_that_brings_it() -> None:
    everything = brought_by("all")
    for extra, modules in EXTRAS.items():
        ours = {canonicalize_name(PACKAGES.get(module, module)) for module in modules}
        assert ours <= brought_by(extra) <= everything, extra
    named = {canonicalize_name(PACKAGES.get(m, m)) for modules in EXTRAS.values() for m in modules}
    assert everything == named
    core = {canonicalize_name(Requirement(text).name) for text in PROJECT["dependencies"]}
    assert not core & named


def test_what_contributors_are_told_of_exists() -> None:
    for name in ("CONTRIBUTING.md", "SECURITY.md", "CODE_OF_CONDUCT.md"):
        text = (ROOT / name).read_text(encoding="utf-8")
        told = re.findall(r"\]\(([^)\s]+)\)", text) + re.findall(r"`([\w.]+/[\w./]*\w)`", text)
        missing = [path for path in told if "://" not in path and "…" not in path and "NAME" not in path]
        assert [path for path in missing if not (ROOT / path).exists()] == [], name


def test_the_python_versions_are_those_that_continuous_integration_runs() -> None:
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8"))
    tested = workflow["jobs"]["run"]["strategy"]["matrix"]["python"]
    named = [re.fullmatch(r"Programming Language :: Python :: (3\.\d+)", text) for text in PROJECT["classifiers"]]
    assert [found[1] for found in named if found] == tested
    assert PROJECT["requires-python"] == f">={tested[0]}"
