"""What a machine's stereo pair makes of fruit: pictures that are drawn and read, or errors measured on such pictures.

``rendered`` draws both pictures and reads them (exact, and a tenth of a second each); ``measured_errors`` draws errors
from tables made that way (sight_errors.py); ``ideal`` sees all fruit where it is. Units: m, px.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from pickenv.base import InputError
from pickenv.orchard.camera import camera_axes, camera_frame, orchard_frame
from pickenv.orchard.canopy import Canopy, face
from pickenv.orchard.checks import Array, Flags
from pickenv.orchard.circles import CircleSearch, load_circle_search, locate_circles
from pickenv.orchard.preset_files import shipped
from pickenv.orchard.render import Leaves, Look, StereoPair, load_look, render_stereo, sample_leaves, turned_leaves
from pickenv.orchard.sight_errors import Chances, SightErrors, Sightings, draw_chances, load_sight_errors, sighted
from pickenv.orchard.vision import Detections, StereoCamera, load_stereo_camera, locate, match_detections

VISIONS = ("rendered", "measured_errors", "ideal")
DETECTORS = ("li2016", "circles")
"""Li's regions and centroids, and circles that leaves may hide in part."""

SAME = 1.0
"""Fruit diameters within which a detection is of this fruit."""


@dataclass(frozen=True, eq=False)
class Eyes:
    """How fruit is seen in one canopy.

    Attributes:
        vision: One of `VISIONS`.
        detector: One of `DETECTORS`.
        canopy: Where the leaves are.
        camera: The stereo pair.
        look: Colours and light of its pictures.
        search: What the detector of circles goes by.
        errors: The table, for measured errors.
    """

    vision: str
    detector: str
    canopy: Canopy
    camera: StereoCamera
    look: Look
    search: CircleSearch
    errors: SightErrors | None


def load_eyes(vision: str, canopy: Canopy, detector: str = "li2016") -> Eyes:
    """Eyes with the stereo pair of Li et al. 2016.

    Raises:
        InputError: If the vision or the detector is unknown, or no errors were measured in this canopy.
    """
    for what, name, known in (("vision", vision, VISIONS), ("detector", detector, DETECTORS)):
        if name not in known:
            raise InputError(f"unknown {what} '{name}'; give one of {', '.join(known)}")
    errors = _errors_in(canopy, detector) if vision == "measured_errors" else None
    return Eyes(
        vision,
        detector,
        canopy,
        load_stereo_camera("li2016"),
        load_look("red_apples"),
        load_circle_search("li2016"),
        errors,
    )


def errors_name(canopy: str, detector: str) -> str:
    """Under which name a canopy's errors stand in sight.toml."""
    return f"{canopy}-{detector}"


def _errors_in(canopy: Canopy, detector: str) -> SightErrors:
    name = errors_name(canopy.name, detector)
    if name in shipped("sight"):
        errors = load_sight_errors(name)
        if errors.leaf_area_per_volume == canopy.leaf_area_per_volume:
            return errors
    raise InputError(
        f"no errors were measured in canopy '{canopy.name}' with {canopy.leaf_area_per_volume:g} m2/m3 of leaves by "
        f"detector '{detector}'; give vision='rendered', or measure them: python scripts/studies/measure_sight.py"
    )


@dataclass(frozen=True, eq=False)
class Viewpoint:
    """Where the middle of the stereo pair stands, m, and which way it looks, (3,) each, in any frame with z up."""

    middle: Array
    looking: Array

    def left_eye(self, camera: StereoCamera) -> Array:
        """Where the left camera stands."""
        return np.asarray(self.middle - camera.baseline / 2 * camera_axes(self.looking)[0])


@dataclass(frozen=True, eq=False)
class Sight:
    """Fruit as seen.

    Attributes:
        in_sight: Whether anything of it is in sight, (n,).
        located: Whether its place was found, (n,).
        believed: Where, in the frame of the view, m, (n, 3); says nothing of fruit that is not located.
        false: Places (m, 3) where fruit was believed and none is.
    """

    in_sight: Flags
    located: Flags
    believed: Array
    false: Array


def foliage(eyes: Eyes, rng: np.random.Generator) -> Leaves | None:
    """The canopy's leaves in the orchard frame, and those beside it that a picture shows; None where none are drawn."""
    if eyes.vision != "rendered":
        return None
    canopy, camera = eyes.canopy, eyes.camera
    aside = canopy.width / 2 + (canopy.standoff + canopy.depth) * camera.image[0] / 2 / camera.focal_length
    low, high = [-aside, 0.0, canopy.bottom], [aside, canopy.depth, canopy.top]
    places = sample_leaves(low, high, canopy.leaf_area_per_volume, eyes.look, rng)
    places[:, 1] += face(canopy, places[:, 2])
    return turned_leaves(places, eyes.look, rng)


def picture(
    eyes: Eyes,
    view: Viewpoint,
    fruit: ArrayLike,
    diameters: ArrayLike,
    leaves: Leaves | None,
    rng: np.random.Generator,
    looks: int = 1,
) -> StereoPair:
    """The pair of pictures that the eyes take; ``looks`` of them averaged, which only lowers the sensor's noise."""
    camera, eye = eyes.camera, view.left_eye(eyes.camera)
    if leaves is None:
        leaves = turned_leaves(np.zeros((0, 3)), eyes.look, rng)
    places = camera_frame(leaves.places, eye, view.looking)
    half = np.array(camera.image) / 2 / camera.focal_length
    edge = np.array([camera.baseline + eyes.look.leaf_length, eyes.look.leaf_length])
    shown = (np.abs(places[:, :2]) <= half * places[:, 2:] + edge).all(axis=1)
    before = Leaves(places[shown], leaves.shapes[shown], leaves.colours[shown])
    look = replace(eyes.look, pixel_noise=eyes.look.pixel_noise / np.sqrt(looks))
    return render_stereo(camera, camera_frame(fruit, eye, view.looking), diameters, before, look, rng)


def read_picture(eyes: Eyes, pair: StereoPair) -> Detections:
    """Fruit that the detector finds, camera frame."""
    if eyes.detector == "circles":
        return locate_circles(eyes.camera, eyes.search, pair.left, pair.right)
    return locate(eyes.camera, pair.left, pair.right)


def _matched(pair: StereoPair, found: Detections, places: Array, diameters: ArrayLike) -> tuple[Flags, Array, Array]:
    """Which fruit of a picture is located, where (camera frame), and the detections that are none."""
    located, seen = np.zeros(len(places), dtype=bool), places.copy()
    shown = np.flatnonzero(pair.visible > 0)
    if not len(shown):
        return located, seen, found.positions
    within = SAME * float(np.max(diameters))
    matched = match_detections(found, places[shown], within)
    true = matched.fruit >= 0
    which = shown[matched.fruit[true]]
    located[which], seen[which] = True, matched.positions[true]
    return located, seen, matched.positions[~true]


def see(
    eyes: Eyes,
    view: Viewpoint,
    fruit: ArrayLike,
    diameters: ArrayLike,
    rng: np.random.Generator,
    *,
    leaves: Leaves | None = None,
    chances: Chances | None = None,
    looks: int = 1,
) -> Sight:
    """Look at fruit.

    Args:
        eyes: How.
        view: From where.
        fruit: True centres in the view's frame, m, (n, 3).
        diameters: m, (n,).
        rng: Source of every draw that is not given.
        leaves: What hangs before the fruit in a rendered picture, in the view's frame.
        chances: What decides where errors are measured ones; drawn when left out.
        looks: Pictures that are averaged.
    """
    fruit = np.asarray(fruit, dtype=float).reshape(-1, 3)
    n, camera = len(fruit), eyes.camera
    everything = np.ones(n, dtype=bool)
    if eyes.vision == "ideal":
        return Sight(everything, everything, fruit.copy(), np.zeros((0, 3)))
    eye = view.left_eye(camera)
    places = camera_frame(fruit, eye, view.looking)
    if eyes.vision == "rendered":
        pair = picture(eyes, view, fruit, diameters, leaves, rng, looks)
        located, seen, false = _matched(pair, read_picture(eyes, pair), places, diameters)
        in_sight = pair.visible > 0
    else:
        assert eyes.errors is not None
        chances = draw_chances(rng, n) if chances is None else chances
        in_sight, located, error = sighted(eyes.errors, places[:, 2], chances, looks)
        seen, false = places + error, _phantoms(eyes, rng)
    return Sight(in_sight, located, orchard_frame(seen, eye, view.looking), orchard_frame(false, eye, view.looking))


def _phantoms(eyes: Eyes, rng: np.random.Generator) -> Array:
    """Detections of no fruit, camera frame: anywhere in the picture, as deep as the canopy."""
    assert eyes.errors is not None
    camera, canopy = eyes.camera, eyes.canopy
    count = int(rng.poisson(eyes.errors.false_per_picture))
    depth = canopy.standoff + canopy.depth * rng.random((count, 1))
    across = (rng.random((count, 2)) - 0.5) * np.array(camera.image) / camera.focal_length
    return np.concatenate([across * depth, depth], axis=-1)


def sightings(
    eyes: Sequence[Eyes],
    view: Viewpoint,
    fruit: ArrayLike,
    diameters: ArrayLike,
    wanted: Flags,
    leaves: Leaves | None,
    rng: np.random.Generator,
    tree: int,
) -> list[Sightings]:
    """Draw two pictures from one place, let each detector read both, and say what became of the ``wanted`` fruit (n,).

    Args:
        eyes: They share canopy, camera and look.
        view: From where.
        fruit: True centres in the view's frame, m, (n, 3).
        diameters: m, (n,).
        wanted: Which fruit counts.
        leaves: In the view's frame.
        rng: Source of every draw.
        tree: Number of the tree.
    """
    places = camera_frame(fruit, view.left_eye(eyes[0].camera), view.looking)
    pairs = [picture(eyes[0], view, fruit, diameters, leaves, rng) for _ in range(2)]
    found = []
    for each in eyes:
        (located, seen, false), (once_more, moved, _) = (
            _matched(pair, read_picture(each, pair), places, diameters) for pair in pairs
        )
        error, again = (
            np.where(flags[:, None], where - places, np.nan)[wanted]
            for flags, where in ((located, seen), (once_more, moved))
        )
        number, depth = np.full(int(wanted.sum()), tree), places[wanted, 2]
        found.append(Sightings(number, depth, pairs[0].visible[wanted], located[wanted], error, again, 1, len(false)))
    return found
