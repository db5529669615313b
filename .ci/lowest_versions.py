"""The lowest versions that pyproject.toml promises to work with, as constraints for pip.

"numpy>=2" becomes "numpy==2.0.*": the latest repair of the lowest minor version.

Run: python .ci/lowest_versions.py > lowest.txt
"""

from __future__ import annotations

import tomllib
from pathlib import Path

from packaging.requirements import Requirement
from packaging.version import Version


def lowest(requirement: Requirement) -> str | None:
    """Its lowest minor version as a constraint; None if it states no lower bound."""
    bounds = [Version(each.version) for each in requirement.specifier if each.operator in (">=", "==", "~=")]
    if not bounds:
        return None
    major, minor, *_ = (*max(bounds).release, 0)
    return f"{requirement.name}=={major}.{minor}.*"


def brought(texts: list[str], extras: dict[str, list[str]]) -> list[Requirement]:
    """Requirements, with those of our own extras that they name in turn."""
    asked = [Requirement(text) for text in texts]
    deeper = [brought(extras[extra], extras) for each in asked if each.name == "pickenv" for extra in each.extras]
    return [each for each in asked if each.name != "pickenv"] + [each for part in deeper for each in part]


def main() -> None:
    """Print a constraint for everything that users install."""
    project = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    found = {
        lowest(each) for each in brought([*project["dependencies"], "pickenv[all]"], project["optional-dependencies"])
    }
    print("\n".join(sorted(text for text in found if text)))


if __name__ == "__main__":
    main()
