"""Licences of the packages that pickenv asks for, core and extras, as installed here: a Markdown table.

Run: python scripts/licences.py
"""

from __future__ import annotations

import re
from importlib import metadata
from importlib.metadata import Distribution

from packaging.requirements import Requirement

OURS = "pickenv"
FOR_USERS = ("", "learn", "rl", "inspect", "camera", "study", "ray", "harvest", "export", "compiled")
"""Extras whose packages users install; "" is the core."""


def installed(name: str) -> Distribution | None:
    """An installed package."""
    try:
        return metadata.distribution(name)
    except metadata.PackageNotFoundError:
        return None


def needed(extras: tuple[str, ...] = FOR_USERS) -> dict[str, Distribution]:
    """Packages that pickenv needs with these extras, and what they need in turn, as far as they are installed."""
    found: dict[str, Distribution] = {}
    waiting = [(OURS, extras)]
    while waiting:
        name, wanted = waiting.pop()
        package = installed(name)
        for requirement in map(Requirement, (package.requires if package else None) or []):
            marker = requirement.marker
            if marker is not None and not any(marker.evaluate({"extra": extra}) for extra in (*wanted, "")):
                continue
            key = re.sub(r"[-_.]+", "-", requirement.name).lower()
            there = installed(key)
            if key != OURS and key not in found and there is not None:
                found[key] = there
                waiting.append((key, tuple(requirement.extras)))
    return dict(sorted(found.items()))


def licence(package: Distribution) -> str:
    """What a package says of its licence, in one line."""
    said = package.metadata
    expression = said.get("License-Expression") or ""
    classifiers = [text.rpartition(" :: ")[2] for text in said.get_all("Classifier") or [] if "License ::" in text]
    first = (said.get("License") or "").strip().splitlines()
    return expression or "; ".join(classifiers) or (first[0] if first else "") or "not stated"


def main() -> None:
    """Print the table."""
    print("| package | version | licence |\n|---|---|---|")
    for name, package in needed().items():
        print(f"| {name} | {package.version} | {licence(package)} |")


if __name__ == "__main__":
    main()
