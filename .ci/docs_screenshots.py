"""Screenshots of `make test-browser` as pictures of the documentation: few colours, small files.

    python .ci/docs_screenshots.py runs/browser/screenshots

Writes docs/images/inspection-*.webp for every tab of the recording and for both reports, light and dark,
docs/images/comparing-policies-*.png, and docs/images/explorer-light.webp.
"""

from __future__ import annotations

import sys
from pathlib import Path

from PIL import Image

OUT = Path(__file__).parents[1] / "docs/images"
COLOURS = (128, 96, 64)
"""Sizes of the palette; the first one that gives a file small enough is taken."""
LARGEST = 110_000
"""Bytes."""
LEFT_OUT = ("whole", "phone")


def shrink(source: Path, target: Path) -> None:
    """Write ``source`` with as large a palette as the file's size allows."""
    picture = Image.open(source).convert("RGB")
    for colours in COLOURS:
        # The other methods follow what is frequent, and a colour bar is not.
        palette = picture.quantize(colours, Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE)
        if target.suffix == ".webp":  # a page shows a dozen of them
            palette.convert("RGB").save(target, lossless=True, quality=100, method=6)
        else:
            palette.save(target, optimize=True)
        if target.stat().st_size <= LARGEST:
            return
    raise SystemExit(f"{target} is larger than {LARGEST} bytes even with {COLOURS[-1]} colours")


def name_of(source: Path) -> str | None:
    """The picture's name in the documentation, theme last; None for what stays out of it."""
    kind, _, rest = source.stem.partition("-")
    if kind == "compared":
        return f"comparing-policies-{rest}.png"
    if kind == "explorer":
        return f"explorer-{rest}.webp"
    if kind not in ("web", "report", "calibration") or rest.endswith(LEFT_OUT):
        return None
    theme, _, tab = rest.partition("-")
    return f"inspection-{tab if kind == 'web' else kind}-{theme}.webp"


def main(folder: Path) -> None:
    """Replace all pictures by those in ``folder``."""
    for old in OUT.glob("inspection-*.webp"):
        old.unlink()
    for source in sorted(folder.glob("*.png")):
        if name := name_of(source):
            shrink(source, OUT / name)
            print(f"{OUT / name}: {(OUT / name).stat().st_size // 1000} kB")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
