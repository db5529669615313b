"""Impossible orchards are refused with one clear sentence."""

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickenv.base import InputError
from pickenv.orchard import (
    Branch,
    FruitMap,
    FruitSize,
    approach_clear,
    capture_probability,
    detection_probability,
    foliage_path,
    load_branch,
    load_camera,
    load_canopy,
    load_detachment,
    load_fruit_map,
    load_fruit_size,
    load_gripper,
    load_look,
    load_station,
    load_stereo_camera,
    load_suction,
    locate,
    match_detections,
    measured_positions,
    misalignment,
    natural_frequencies,
    occlusion,
    project,
    render_stereo,
    sample_counts,
    sample_fruit,
    sample_leaves,
    shipped,
    swing,
    triangulate,
)

NAN = float("nan")
RNG = np.random.default_rng(0)
CANOPY, CAMERA, STEREO = load_canopy("li2016"), load_camera("azure_kinect"), load_stereo_camera("li2016")
BRANCH, HAND, LOOK = load_branch("apple"), load_gripper("compliant_hand"), load_look("red_apples")
NONE = np.zeros((0, 3))

CASES: dict[str, tuple[Callable[[], Any], str]] = {
    "negative density": (lambda: FruitMap(0.3, (1.0, -2.0)), "row_means of a fruit map is -2.0"),
    "negative scale": (lambda: load_fruit_map("v_trellis").scaled(-1.0), "density"),
    "no rows": (lambda: FruitMap(0.3, ()), "row_means is empty"),
    "underdispersed": (lambda: FruitMap(0.3, (1.0,), 1, 0.5), "of at least 1"),
    "half a cluster": (lambda: FruitMap(0.3, (1.0,), 0), "cluster_size"),
    "NaN block": (lambda: FruitMap(NAN, (1.0,)), "block"),
    "no length": (lambda: sample_counts(load_fruit_map("v_trellis"), 0, RNG), "blocks long"),
    "mean outside": (lambda: FruitSize(0.1, 0.0, 0.05, 0.09, 840.0), "do not hold their mean"),
    "overfull": (
        lambda: sample_fruit(load_fruit_map("v_trellis").scaled(2000.0), load_fruit_size("apple"), CANOPY, RNG),
        "too full",
    ),
    "empty canopy": (lambda: replace(CANOPY, top=CANOPY.bottom), "is empty"),
    "no depth": (lambda: replace(CANOPY, depth=0.0), "depth"),
    "negative leaves": (lambda: replace(CANOPY, leaf_area_per_volume=-1.0), "leaf_area_per_volume"),
    "flat on the ground": (lambda: replace(CANOPY, lean=1.5), "leans"),
    "NaN point": (lambda: foliage_path(CANOPY, [0, NAN, 1], [0, 1, 1]), "NaN"),
    "flat point": (lambda: foliage_path(CANOPY, [0, 1], [0, 1]), "three coordinates"),
    "eye in a fruit": (lambda: occlusion(CANOPY, [[0, 0.1, 1]], 0.08, [0, 0.1, 1.01]), "inside a fruit"),
    "diameters amiss": (lambda: occlusion(CANOPY, [[0, 0.1, 1]], [0.1, 0.1], [0, -1, 1]), "1 fruit but 2"),
    "no diameter": (lambda: occlusion(CANOPY, [[0, 0.1, 1]], 0.0, [0, -1, 1]), "above zero"),
    "no tool": (lambda: approach_clear(np.zeros((2, 3)), 0.1, [0, 0, 1], -1.0), "tool radius"),
    "no direction": (lambda: approach_clear(np.zeros((2, 3)), 0.1, [0, 0, 0], 0.1), "zero vectors"),
    "negative noise": (lambda: replace(CAMERA, depth_noise=-1.0), "depth_noise"),
    "range reversed": (lambda: replace(CAMERA, farthest=0.1), "range"),
    "camera named": (lambda: replace(CAMERA, focal_length=0.0), "of camera 'azure_kinect'"),
    "camera's range": (lambda: replace(CAMERA, farthest=0.1), "of camera 'azure_kinect'"),
    "less than unseen": (lambda: detection_probability(CAMERA, 1.0, -0.1), "visible share"),
    "no focal length": (lambda: replace(CAMERA, focal_length=0.0), "focal_length"),
    "sure of dropout": (lambda: replace(CAMERA, dropout=1.5), "from 0 to 1"),
    "thresholds crossed": (lambda: replace(CAMERA, lost_below=0.9), "found_above"),
    "NaN fruit": (lambda: measured_positions(CAMERA, [[0, NAN, 0]], [0, 0, 0], np.zeros((1, 5))), "NaN"),
    "eye on a fruit": (lambda: measured_positions(CAMERA, [0, 0, 0], [0, 0, 0], np.zeros(5)), "at the viewpoint"),
    "few draws": (lambda: measured_positions(CAMERA, [0, 1, 0], [0, 0, 0], np.zeros(3)), "5 random draws"),
    "matched nowhere": (lambda: match_detections(NONE, NONE, 0.0), "above"),
    "NaN misalignment": (lambda: capture_probability(HAND, NAN, 0.0, 0.0), "lateral"),
    "no axis": (lambda: misalignment([0, 0, 0], [0, 0, 0]), "zero vectors"),
    "hand that likes errors": (lambda: replace(HAND, lateral=-1.0), "lateral of compliant hand"),
    "no pendulum": (lambda: Branch(0.0, 1.0, 1.0, 0.1, 0.1, 0.1), "pendulum"),
    "negative damping": (lambda: replace(BRANCH, damping_ratio=-0.1), "damping_ratio"),
    "weightless": (lambda: natural_frequencies(BRANCH, 0.0), "mass of fruit"),
    "back in time": (lambda: swing(BRANCH, [0, 0, 0], [0, 0, 0], 0.2, -1.0), "time step"),
    "disparity too wide": (lambda: replace(STEREO, nearest=0.05), "raise nearest"),
    "behind the camera": (lambda: project(STEREO, [0, 0, -1]), "behind the camera"),
    "at infinity": (lambda: triangulate(STEREO, [320, 240, 0]), "at infinity"),
    "fruit behind the camera": (lambda: render_stereo(STEREO, [[0, 0, -1]], 0.1, NONE, LOOK, RNG), "behind"),
    "negative foliage": (lambda: sample_leaves([0, 0, 1], [1, 1, 2], -1.0, LOOK, RNG), "leaf area"),
    "inside out": (lambda: sample_leaves([0, 0, 2], [1, 1, 1], 1.0, LOOK, RNG), "exchange"),
    "small picture": (lambda: locate(STEREO, np.zeros((4, 4, 3), "u1"), np.zeros((4, 4, 3), "u1")), "left image"),
    "grey picture": (lambda: locate(STEREO, np.zeros((480, 640), "u1"), np.zeros((480, 640), "u1")), "uint8"),
}


@pytest.mark.parametrize("case", CASES)
def test_impossible_input_is_refused_in_one_sentence(case: str) -> None:
    attempt, words = CASES[case]
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        attempt()
    assert "\n" not in str(caught.value) and str(caught.value).count(". ") == 0


LOADERS: dict[str, Callable[[str | Path], object]] = {
    "branch": load_branch,
    "camera": load_camera,
    "canopy": load_canopy,
    "detachment": load_detachment,
    "fruit": load_fruit_map,
    "fruit_size": load_fruit_size,
    "gripper": load_gripper,
    "look": load_look,
    "station": load_station,
    "suction": load_suction,
    "vision": load_stereo_camera,
}


@pytest.mark.parametrize("kind", LOADERS)
def test_every_preset_loads_and_an_unknown_one_names_those_that_are(kind: str) -> None:
    for name in shipped(kind):
        LOADERS[kind](name)
    with pytest.raises(InputError, match=rf"unknown {kind} 'nobody'; give one of \['"):
        LOADERS[kind]("nobody")
    with pytest.raises(InputError, match="does not exist"):
        LOADERS[kind]("nowhere.toml")


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (
            "block_mm = 300\nrow_means = [1]\ncluster_size = 1\ncluster_variance_ratio = 1\nsize = 2",
            "unknown key 'size'",
        ),
        ("block_mm = 300\nrow_means = [1]\ncluster_size = 1", "cluster_variance_ratio of 'mine' is missing"),
        ("block_mm = 300\nrow_means = [1]\ncluster_size = 1.5\ncluster_variance_ratio = 1", "whole number"),
        ("block_mm = 'wide'", "block_mm of 'mine' is 'wide'; give a number above zero"),
        ("block_mm = 300\nrow_means = 1", "list of numbers"),
        ("block_mm = -300\nrow_means = [1]\ncluster_size = 1\ncluster_variance_ratio = 1", "above zero"),
        ("block_mm = ", "not valid TOML"),
    ],
)
def test_a_file_of_ones_own_is_read_strictly(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(complaint)):
        load_fruit_map(path)


def test_a_file_of_ones_own_is_read(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text(
        "block_mm = 250\nrow_means = [1, 2]\ncluster_size = 1\ncluster_variance_ratio = 3\n", encoding="utf-8"
    )
    assert load_fruit_map(path) == FruitMap(0.25, (1.0, 2.0), 1, 3.0)


def test_a_preset_that_is_not_a_table_is_refused_in_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "gripper.toml"
    path.write_text("kind = 'magnet'\n", encoding="utf-8")
    with pytest.raises(InputError, match="give 'cup' or 'hand'"):
        load_gripper(path)
