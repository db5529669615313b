"""Figure 5 of Li et al. 2016: R - G, Otsu, two erosions, the rule of a fifth, two dilations, centroids, step by step.

The picture is rendered: seven apples of the lab in sight, foliage behind them; as in the paper, no fruit is hidden.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from papers.pages import judged
from pickenv.arm import Array
from pickenv.harvester import Tree
from pickenv.orchard import (
    StereoCamera,
    fruit_mask,
    fruit_regions,
    load_look,
    load_stereo_camera,
    locate,
    project,
    red_minus_green,
    render_stereo,
    sample_leaves,
)

NEAR_PX = 1.0
"""A centroid is its fruit's within this."""
AHEAD = 0.9
"""m from the camera to the nearest fruit."""
FOLIAGE = 2.0
"""m2 of leaves per m3, behind the fruit."""


@dataclass(frozen=True, eq=False)
class Segmentation:
    """A picture and what each step makes of it.

    Attributes:
        picture: Left image, red, green, blue.
        difference: R - G.
        masks: Pixels taken for fruit after each step, by name.
        centroids: Column and row of each region in the end ``(m, 2)``, px.
        fruit: Column, row and disparity of the true fruit ``(n, 3)``, px.
        missed: Localisation error of each fruit, camera axes ``(n, 3)``, m; NaN where it was not found.
    """

    picture: NDArray[np.uint8]
    difference: Array
    masks: dict[str, NDArray[np.bool_]]
    centroids: Array
    fruit: Array
    missed: Array


def segmentation(tree: Tree, rng: np.random.Generator) -> Segmentation:
    """Render one image of the lab and take the paper's steps one by one."""
    camera, look = load_stereo_camera("li2016"), load_look("red_apples")
    middle = (tree.fruit.min(0) + tree.fruit.max(0)) / 2
    x, y, z = np.moveaxis(tree.fruit - middle, -1, 0)
    ahead = -y - (-y).min() + AHEAD
    places = np.stack([-x, -z, ahead], -1)  # the camera looks along -y: right is -x, down is -z
    behind = float(ahead.max()) + 0.1
    leaves = sample_leaves((-1.2, -1.0, behind), (1.2, 1.0, behind + 0.4), FOLIAGE, look, rng)
    pair = render_stereo(camera, places, tree.diameters, leaves, look, rng)
    found = locate(camera, pair.left, pair.right)[0]
    return Segmentation(
        pair.left,
        red_minus_green(pair.left),
        steps(camera, pair.left),
        fruit_regions(camera, pair.left)[0],
        project(camera, places),
        missed_by(places, found, tree.diameters),
    )


def steps(camera: StereoCamera, picture: NDArray[np.uint8]) -> dict[str, NDArray[np.bool_]]:
    """The mask after each step: the same chain, with the later steps left out."""
    plain = replace(camera, erosions=0, dilations=0, least_area_share=0.0)
    chain = {
        "Otsu of R − G": plain,
        "two erosions": replace(plain, erosions=camera.erosions),
        "the rule of a fifth": replace(camera, dilations=0),
        "two dilations": camera,
    }
    return {name: fruit_mask(each, picture) for name, each in chain.items()}


def missed_by(places: Array, found: Array, diameters: Array) -> Array:
    """Error of the nearest detection of each fruit ``(n, 3)``, m; NaN beyond a diameter."""
    if not len(found):
        return np.full_like(places, np.nan)
    apart = found[None] - places[:, None]
    nearest = np.linalg.norm(apart, axis=-1).argmin(1)
    error = apart[np.arange(len(places)), nearest]
    return np.where(np.linalg.norm(error, axis=-1, keepdims=True) < diameters[:, None], error, np.nan)


def figure_5(found: Segmentation) -> dict[str, Any]:
    """The steps with what they leave, and how near the centroids are."""
    from skimage.measure import label

    rows: list[dict[str, Any]] = [
        {"step": name, "pixels": int(mask.sum()), "regions": int(label(mask, connectivity=2).max())}
        for name, mask in found.masks.items()
    ]
    fruit = len(found.fruit)
    apart = np.linalg.norm(found.centroids[None] - found.fruit[:, None, :2], axis=-1)
    off = float(apart.min(1).max()) if len(found.centroids) else np.inf
    seen = np.isfinite(found.missed).all(1)
    error_mm = 1e3 * np.sqrt(np.mean(found.missed[seen] ** 2, axis=0)) if seen.any() else np.full(3, np.nan)
    same = len(found.centroids) == fruit and off <= NEAR_PX
    reason = (
        f"on a rendered picture the chain leaves {len(found.centroids)} regions for {fruit} apples in sight, their "
        f"centroids within {off:.2f} px; in stereo that locates {int(seen.sum())} of them to "
        f"{error_mm[0]:.1f}, {error_mm[1]:.1f} and {error_mm[2]:.1f} mm (right, down, ahead)"
    )
    return judged(
        same,
        reason,
        rows,
        fruit=fruit,
        centroids=len(found.centroids),
        largest_centroid_error_px=off,
        localisation_rms_mm=error_mm.tolist(),
        files=["segmentation"],
    )
