"""What a release is checked and described by: version, repository, section of the changelog.

Run: python .ci/release.py TAG [--repository OWNER/NAME] > notes.md
"""

from __future__ import annotations

import argparse
import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def changelog_section(changelog: str, version: str) -> str:
    """The section of a version, without its heading.

    Args:
        changelog: Text of CHANGELOG.md.
        version: As in "## [0.2.0] - 2026-12-01".

    Raises:
        SystemExit: If there is none, or nothing in it.
    """
    found = re.search(rf"^## \[{re.escape(version)}\][^\n]*\n(.*?)(?=^## \[|\Z)", changelog, re.M | re.S)
    if not found or not found[1].strip():
        raise SystemExit(f"CHANGELOG.md has no section [{version}]; close [Unreleased] under that name first")
    return found[1].strip() + "\n"


def check_release(tag: str, repository: str | None, project: dict[str, object], citation: str) -> str:
    """The version to be released, if tag, package, citation and repository agree.

    Args:
        tag: As pushed, "v0.2.0".
        repository: "owner/name" of where the workflow runs, or None.
        project: Table [project] of pyproject.toml.
        citation: Text of CITATION.cff.

    Raises:
        SystemExit: If they do not; the sentence says what to change.
    """
    version, urls = str(project["version"]), project["urls"]
    assert isinstance(urls, dict)
    if tag != f"v{version}":
        raise SystemExit(f"the tag is {tag}, the version in pyproject.toml {version}: the tag has to be v{version}")
    if f"\nversion: {version}\n" not in citation:
        raise SystemExit(f"CITATION.cff states another version than {version}")
    if repository is not None and urls["Homepage"] != f"https://github.com/{repository}":
        raise SystemExit(f"[project.urls] names {urls['Homepage']}, but this is {repository}: mend the addresses first")
    return version


def main() -> None:
    """Check, and print the notes."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("tag")
    parser.add_argument("--repository")
    given = parser.parse_args()
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    version = check_release(given.tag, given.repository, project, citation)
    print(changelog_section((ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), version), end="")


if __name__ == "__main__":
    main()
