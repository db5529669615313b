"""A release goes out only where tag, versions, changelog and repository agree; torch has the build that was meant."""

import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path[:0] = [str(ROOT / ".ci"), str(ROOT / "scripts")]

from install_torch import CPU_INDEX, pip_calls, wanted  # noqa: E402
from release import changelog_section, check_release  # noqa: E402

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
CITATION = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
CHANGELOG = (
    "# Changelog\n\n## [Unreleased]\n\n### Added\n\n- new\n\n## [1.2.0] - 2026-12-01\n\n- two\n\n## [1.1.0]\n\n- one\n"
)
OURS = PROJECT["urls"]["Homepage"].removeprefix("https://github.com/")


def test_a_section_ends_where_the_next_begins() -> None:
    assert changelog_section(CHANGELOG, "1.2.0") == "- two\n"
    assert changelog_section(CHANGELOG, "1.1.0") == "- one\n"
    for version in ("1.2", "1.0.0", "1x2.0"):
        with pytest.raises(SystemExit, match="no section"):
            changelog_section(CHANGELOG, version)
    with pytest.raises(SystemExit, match="no section"):
        changelog_section("## [2.0.0]\n\n## [1.0.0]\n\n- one\n", "2.0.0")


def test_what_does_not_agree_is_not_released() -> None:
    tag = f"v{PROJECT['version']}"
    assert check_release(tag, OURS, PROJECT, CITATION) == PROJECT["version"]
    assert check_release(tag, None, PROJECT, CITATION) == PROJECT["version"]
    with pytest.raises(SystemExit, match="the tag is v9"):
        check_release("v9.9.9", OURS, PROJECT, CITATION)
    with pytest.raises(SystemExit, match=r"CITATION\.cff"):
        check_release(tag, OURS, PROJECT, CITATION.replace(f"version: {PROJECT['version']}", "version: 0.0.0"))
    with pytest.raises(SystemExit, match="mend the addresses"):
        check_release(tag, "somebody/else", PROJECT, CITATION)


@pytest.mark.parametrize(
    ("choice", "nvidia", "build"),
    [("auto", False, "cpu"), ("auto", True, "cuda"), ("cpu", True, "cpu"), ("cuda", False, "cuda")],
)
def test_torch_has_cuda_only_where_it_is_of_use_or_asked_for(choice: str, nvidia: bool, build: str) -> None:
    assert wanted(choice, nvidia)[0] == build


def test_the_small_index_is_asked_for_torch_alone_and_on_linux_only() -> None:
    first, last = pip_calls("cpu", "Linux")
    assert CPU_INDEX in first and "--no-deps" in first and first[-1] == "torch"
    assert not any(word.startswith("http") for word in last)
    assert pip_calls("cuda", "Linux") == pip_calls("cpu", "Darwin") == pip_calls("cpu", "Windows") == [last]
    with pytest.raises(SystemExit, match="none of auto, cpu, cuda"):
        wanted("rocm", False)
