"""The README as a package index shows it: its links lead to the repository, at the version that is built.

An index knows nothing of the files beside the README, so links within the checkout are made addresses under the
homepage of `[project.urls]`, pictures to their bytes, pages to where they are read. Hatchling calls this as it builds.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from hatchling.metadata.plugin.interface import MetadataHookInterface

LINK = re.compile(r"(!?\[(?:[^\[\]]|!\[[^\]]*\]\([^)]*\))*\]\()([^)\s]+)(?=\))")
"""A link or a picture, or a link around a picture."""
INSIDE = re.compile(r"(!\[[^\]]*\]\()([^)\s]+)(?=\))")


def absolute(text: str, homepage: str, version: str) -> str:
    """A Markdown text whose relative links are addresses.

    Args:
        text: The text.
        homepage: Of the repository.
        version: Whose tag the addresses name.
    """

    def address(path: str, picture: bool) -> str:
        kind = "raw" if picture else "blob"
        return path if "://" in path or path.startswith("#") else f"{homepage}/{kind}/v{version}/{path}"

    text = INSIDE.sub(lambda m: m[1] + address(m[2], picture=True), text)
    return LINK.sub(lambda m: m[1] + address(m[2], picture=m[1].startswith("!")), text)


class LongDescription(MetadataHookInterface):
    """Sets the package's readme."""

    def update(self, metadata: dict[str, Any]) -> None:
        """Put the README with its addresses into the metadata."""
        text = (Path(self.root) / "README.md").read_text(encoding="utf-8")
        text = absolute(text, metadata["urls"]["Homepage"], metadata["version"])
        metadata["readme"] = {"content-type": "text/markdown", "text": text}
