"""Figures of pictures of a board: reprojection errors as arrows, in the picture's plane and on the pictures themselves.

An arrow starts where a corner is predicted and points to where it was found, magnified by the factor that the figure
states; its colour is its true length. Pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from PIL import Image, ImageOps, UnidentifiedImageError

from pickenv.arm import Array
from pickenv.base import InputError
from pickenv.inspect.colours import viridis_map
from pickenv.inspect.figures.field_figure import round_down
from pickenv.inspect.figures.style import WIDTH, new_figure
from pickenv.inspect.runs.calibration_trace import ViewErrors

LONGEST = 0.1
"""Length of the longest arrow, as a share of the picture's width."""

MOST_VIEWS, BESIDE = 9, 3
"""Views drawn at most, the worst first, and how many stand beside each other."""

PICTURE_WIDTH, FAINT = 320, 0.4
"""Pictures behind arrows: their width, px, and opacity."""


def corner_errors(views: Sequence[ViewErrors]) -> Figure:
    """The errors of all views in one plane: what a lens leaves shows as a pattern.

    Raises:
        InputError: If there is no corner to draw.
    """
    size = _size(views)
    found, errors = np.concatenate([v.found for v in views]), np.concatenate([v.errors for v in views])
    whole, (gain, top) = ViewErrors("all", found, errors, size), _scale(views)
    with new_figure(WIDTH, WIDTH * 0.72 * size[1] / size[0] + 0.6) as figure:
        axes = figure.add_subplot(xlabel="u (px)", ylabel="v (px)")
        arrows = _draw(axes, whole, gain, top)
        counted = f"{len(whole.errors)} corners of {len(views)} views"
        axes.set_title(f"{whole.rms:.3g} px RMS over {counted}, errors drawn ×{gain:g}")
        figure.colorbar(arrows, ax=axes, label="error (px)").outline.set_visible(False)
    return figure


def view_errors(views: Sequence[ViewErrors]) -> Figure:
    """The errors of each view on its picture, the worst first, nine at most; without a picture the corners alone.

    Raises:
        InputError: If there is no corner to draw.
    """
    gain, top = _scale(views)
    worst = sorted(views, key=lambda view: -view.rms)[:MOST_VIEWS]
    lines, width, height = -(-len(worst) // BESIDE), *_size(views)
    with new_figure(
        WIDTH, lines * (0.9 * WIDTH / BESIDE * height / width + 0.2) + 1.1, **{"axes.grid": False}
    ) as figure:
        panels = figure.subplots(lines, BESIDE, squeeze=False, sharex=True, sharey=True)
        for axes, view in zip(panels.flat, worst, strict=False):
            if view.picture is not None and (grey := faint_picture(view.picture)) is not None:
                extent = (-0.5, width - 0.5, height - 0.5, -0.5)
                axes.imshow(grey, extent=extent, cmap="gray", vmin=0, vmax=255, alpha=FAINT, interpolation="none")
            arrows = _draw(axes, view, gain, top, 2.0)
            axes.set_title(f"{view.name}: {view.rms:.3g} px", fontsize=8.0)
        for axes in panels.flat[len(worst) :]:
            axes.set_axis_off()
        for axes in panels[:, 0]:
            axes.set_ylabel("v (px)")
        for k in range(min(BESIDE, len(worst))):
            last = panels.flat[max(range(k, len(worst), BESIDE))]
            last.set_xlabel("u (px)")
            last.tick_params(labelbottom=True)
        ends = " to ".join(dict.fromkeys(f"{view.rms:.3g}" for view in (worst[0], worst[-1])))
        figure.suptitle(f"The worst views: {ends} px RMS; errors drawn ×{gain:g}", fontsize=9.0)
        bar = figure.colorbar(arrows, ax=panels, label="error (px)", location="bottom", shrink=0.5, aspect=40.0)
        bar.outline.set_visible(False)
    return figure


def faint_picture(path: str | Path) -> Array | None:
    """Grey values of a picture, made small ``(h, w)``; None where it cannot be read."""
    try:
        with Image.open(path) as opened:
            opened.draft("L", (PICTURE_WIDTH, PICTURE_WIDTH))
            grey = ImageOps.exif_transpose(opened).convert("L")
            return np.asarray(grey.resize((PICTURE_WIDTH, round(PICTURE_WIDTH * grey.height / grey.width))))
    except (OSError, UnidentifiedImageError, Image.DecompressionBombError):
        return None


def _size(views: Sequence[ViewErrors]) -> tuple[int, int]:
    if not views or not sum(len(view.errors) for view in views):
        raise InputError("there is no corner to draw; give views with errors")
    return views[0].size


def _scale(views: Sequence[ViewErrors]) -> tuple[float, float]:
    """How much longer than true the arrows are drawn, and the longest error, px."""
    width, _ = _size(views)
    top = max(float(np.linalg.norm(view.errors, axis=1).max(initial=0.0)) for view in views)
    return round_down(LONGEST * width / max(top, 1e-9)), max(top, 1e-9)


def _draw(axes: Axes, view: ViewErrors, gain: float, top: float, thickness: float = 1.0) -> Quiver:
    width, height = view.size
    arrows = axes.quiver(
        *(view.found - view.errors).T,
        *view.errors.T,
        np.linalg.norm(view.errors, axis=1),
        angles="xy",
        scale_units="xy",
        scale=1.0 / gain,
        cmap=viridis_map(),
        clim=(0.0, top),
        width=0.004 * thickness,
        headwidth=3.5,
        minlength=0.0,
    )
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), aspect="equal")
    return arrows
