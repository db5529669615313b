"""Both drawers show the same stage: bodies where the eye sees them, near before far, words and dial in their places."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys

import numpy as np
import pytest

from pickenv.pictures import drawers
from pickenv.pictures.drawers import draw_plainly, lettered
from pickenv.pictures.shapes import chequered
from pickenv.pictures.stage import Dial, Eye, Mesh, Rods, Stage, Words, backdrop, rgba, spheres

EYE = Eye(np.array([0.0, -3.0, 1.0]), np.array([0.0, 0.0, 0.0]))
RED, BLUE = (230, 10, 10), (10, 10, 230)


@pytest.fixture
def mujoco():
    if drawers.drawer_name() != "mujoco":
        pytest.skip("MuJoCo cannot draw here")
    return drawers._mujoco(0).draw


@pytest.fixture(params=["plain", "mujoco"])
def draw(request):
    if request.param == "plain":
        return draw_plainly
    return request.getfixturevalue("mujoco")


def balls(*places, colour=RED, radius=0.12, opacity=1.0):
    return spheres(np.array(places, dtype=float), np.full(len(places), radius), rgba(colour, len(places), opacity))


def reddish(pixels):
    values = pixels.astype(int)
    return values[..., 0] > 2 * np.maximum(values[..., 1], values[..., 2])


def bluish(pixels):
    values = pixels.astype(int)
    return values[..., 2] > 2 * np.maximum(values[..., 0], values[..., 1])


@pytest.mark.parametrize("place", [(0.0, 0.0, 0.0), (0.6, 0.3, -0.2), (-0.7, -0.5, 0.3)])
def test_a_ball_is_seen_where_and_as_large_as_the_eye_says(draw, place):
    pixels = draw(Stage(EYE, balls=(balls(place),)))
    assert pixels.shape == (360, 480, 3) and pixels.dtype == np.uint8
    rows, columns = np.nonzero(reddish(pixels))
    column, row, depth = EYE.project(place, (480, 360))
    assert columns.mean() == pytest.approx(column, abs=2.0) and rows.mean() == pytest.approx(row, abs=2.0)
    disc = np.pi * (0.12 * EYE.pixels_per_metre(depth, (480, 360))) ** 2
    assert 0.75 * disc < len(rows) < 1.1 * disc


def test_what_is_near_hides_what_is_far(draw):
    wall = Rods(np.array([[-1.0, -1.0, 0.35]]), np.array([[1.0, -1.0, 0.35]]), np.array([0.3]), rgba(BLUE, 1))
    stage = Stage(EYE, rods=(wall,), balls=(balls((0.0, 0.5, -0.2)),))
    assert not reddish(draw(stage)).any() and bluish(draw(stage)).any()
    before = Stage(EYE, rods=(wall,), balls=(balls((0.0, -1.6, 0.5)),))
    assert reddish(draw(before)).any()


def test_what_is_seen_through_is_a_mixture(draw):
    clear = draw(Stage(EYE, balls=(balls((0.0, 0.0, 0.0), opacity=0.4),)))[180, 240].astype(int)
    solid, empty = draw(Stage(EYE, balls=(balls((0.0, 0.0, 0.0)),)))[180, 240], draw(Stage(EYE))[180, 240]
    assert solid[1] + 20 < clear[1] < int(empty[1]) - 20


def test_mujoco_mixes_in_the_shares_that_an_opacity_says(mujoco):
    ball = [balls((0.0, 0.0, 0.0), opacity=opacity) for opacity in (0.4, 1.0)]
    clear, solid, empty = (mujoco(Stage(EYE, balls=tuple(each)))[180, 240] for each in (ball[:1], ball[1:], ()))
    np.testing.assert_allclose(clear, 0.4 * solid + 0.6 * empty, atol=2.5)


def test_mujoco_draws_faces_in_their_own_colours_and_both_sides_of_them(mujoco):
    """In the light of its lamps, each side of a face that looks at the eye has its colour, be it one of thousands."""
    rng = np.random.default_rng(0)
    columns, rows = (grid.ravel() for grid in np.meshgrid(np.arange(48), np.arange(36)))
    start = np.stack([columns, np.zeros(len(columns)), 36.0 - rows], axis=1) * 0.01 - [0.24, 0.0, 0.18]
    corners = start[:, None] + 0.01 * np.array([[0, 0, 0], [1, 0, 0], [1, 0, -1], [0, 0, -1]])
    colours = np.column_stack([rng.integers(20, 200, (len(start), 3)), np.full(len(start), 255)]).astype(np.uint8)
    triangles = (np.array([[0, 1, 2], [0, 2, 3]]) + 4 * np.arange(len(start))[:, None, None]).reshape(-1, 3)
    angle = 2 * np.degrees(np.arctan(0.18 / 2.0))
    eyes = [Eye(np.array([0.0, y, 0.0]), np.zeros(3), angle) for y in (-2.0, 2.0)]
    wall = Mesh(corners.reshape(-1, 3), triangles, np.repeat(colours, 4, axis=0))
    front, back = (mujoco(Stage(eye, still=(wall,)))[5::10, 5::10].astype(float) for eye in eyes)
    np.testing.assert_allclose(front, colours[:, :3].reshape(36, 48, 3), rtol=0.1)
    np.testing.assert_allclose(back[:, ::-1], front, atol=1.0)


def test_pictures_of_any_size_with_any_number_of_bodies_follow_one_another(draw):
    rng = np.random.default_rng(1)
    few, many = Stage(EYE, balls=(balls((0.0, 0.0, 0.0)),)), balls(*rng.normal(0.0, 0.4, (300, 3)))
    ground = chequered((-2, -2), (2, 2), -0.5, 0.05, ((10, 160, 20), (20, 190, 30)))
    first = draw(few)
    assert draw(Stage(EYE, balls=(many,), meshes=(ground,), size=(701, 403))).shape == (403, 701, 3)
    np.testing.assert_array_equal(draw(few), first)
    odd = draw(Stage(EYE, size=(301, 203))).astype(int)
    assert np.ptp(odd, axis=1).max() <= 1 and np.ptp(odd, axis=0).min() > 5


def test_still_meshes_stay_and_go_with_the_stage(draw):
    ground = chequered((-2, -2), (2, 2), -0.5, 0.5, ((10, 160, 20), (20, 190, 30)))
    with_ground, without = Stage(EYE, still=(ground,)), Stage(EYE)
    first = draw(with_ground)
    empty = draw(without)
    assert not np.array_equal(first, empty)
    np.testing.assert_array_equal(draw(with_ground), first)
    np.testing.assert_array_equal(draw(without), empty)
    moved = dataclasses.replace(with_ground, meshes=(ground,), still=())
    difference = np.abs(draw(moved).astype(int) - first)
    assert (difference.max(axis=-1) > 3).mean() < 0.01


def test_light_and_dark_backgrounds(draw):
    light, dark = draw(Stage(EYE)), draw(Stage(EYE, dark=True))
    assert light.min() > 190 and dark.max() < 70
    for pixels, is_dark in ((light, False), (dark, True)):
        upper, lower = backdrop(is_dark)
        np.testing.assert_allclose(pixels[0, 0], upper, atol=3)
        np.testing.assert_allclose(pixels[-1, 0], lower, atol=3)


@pytest.mark.parametrize("corner", ["top left", "top right", "bottom left", "bottom right"])
def test_words_stand_in_their_corner_and_nowhere_else(corner):
    blank = np.full((360, 480, 3), 128, dtype=np.uint8)
    changed = np.any(lettered(blank, Stage(EYE, words=(Words("4.1 mm", corner), Words("n", corner)))) != 128, axis=-1)
    rows, columns = np.nonzero(changed)
    assert ("top" in corner) == (rows.max() < 120) and ("bottom" in corner) == (rows.min() > 240)
    assert ("left" in corner) == (columns.max() < 160) and ("right" in corner) == (columns.min() > 320)


def test_what_a_picture_is_about_is_written_larger_and_nothing_else():
    blank = np.full((360, 480, 3), 128, dtype=np.uint8)
    tall = []
    for words in (Words("raw"), Words("raw", large=True)):
        rows = np.nonzero(np.any(lettered(blank, Stage(EYE, words=(words,))) != 128, axis=-1))[0]
        tall.append(np.ptp(rows))
    assert tall[1] > tall[0] and not Words("raw").large


def test_words_at_a_place_of_the_world_stand_there():
    blank, place = np.full((360, 480, 3), 128, dtype=np.uint8), np.array([0.4, 0.2, 0.1])
    changed = np.any(lettered(blank, Stage(EYE, words=(Words("x", place),))) != 128, axis=-1)
    rows, columns = np.nonzero(changed)
    column, row, _ = EYE.project(place, (480, 360))
    assert columns.mean() == pytest.approx(column, abs=4) and rows.mean() == pytest.approx(row, abs=16)


@pytest.mark.parametrize("miss", [(2.0, 0.0), (0.0, 3.0), (-4.0, -1.0), (60.0, 0.0)])
def test_the_dial_shows_which_way_the_tool_was_off(miss):
    colour = (250, 0, 250)
    dial = Dial(np.array([miss]), 5.0, colour)
    stage = Stage(EYE, dial=dial)
    blank = np.full((360, 480, 3), 128, dtype=np.uint8)
    shown = lettered(blank, stage)
    rows, columns = np.nonzero((shown == colour).all(axis=-1))
    plate = np.nonzero(
        np.any(lettered(blank, dataclasses.replace(stage, dial=Dial(np.empty((0, 2)), 5.0, colour))) != 128, -1)
    )
    middle, half = [(axis.max() + axis.min()) / 2 for axis in plate], np.ptp(plate[1]) / 2
    assert len(rows) > 20
    found = np.array([columns.mean() - middle[1], middle[0] - rows.mean()])
    length = np.hypot(*miss)
    assert np.dot(found, miss) / (np.linalg.norm(found) * length) > 0.98
    if length < 10:
        assert np.linalg.norm(found) / half == pytest.approx(length / 5.0 / 2.2, abs=0.05)
    else:
        assert 0.85 < np.linalg.norm(found) / half < 1.0  # on the rim


def test_where_mujoco_ends_the_trial_pictures_are_plain_and_one_sentence_says_why(monkeypatch):
    monkeypatch.setattr(drawers, "is_there", lambda module: True)
    monkeypatch.setattr(drawers, "TRIAL", "pickenv.no_such_module")
    said = drawers.why_plain()
    assert said is not None and "EGL" in said and said.count(".") <= 1 and "\n" not in said


def test_where_mujoco_is_absent_one_sentence_names_the_extra(monkeypatch):
    monkeypatch.setattr(drawers, "is_there", lambda module: False)
    assert "pip install 'pickenv[render]'" in drawers.why_plain()
    monkeypatch.setenv("PICKENV_PLAIN_PICTURES", "1")
    assert "PICKENV_PLAIN_PICTURES" in drawers.why_plain()


DRAWN = """
import gymnasium, pickenv
env = gymnasium.make("pickenv/Reach-v0", render_mode="rgb_array")
env.reset(seed=0)
from pickenv.pictures.drawers import drawer_name
print(env.render().shape, drawer_name())
"""


@pytest.mark.slow
def test_an_environment_is_drawn_plainly_where_that_is_asked_for():
    code = f"{DRAWN}\nimport sys\nprint('mujoco' in sys.modules)"
    plain = os.environ | {"PICKENV_PLAIN_PICTURES": "1"}
    done = subprocess.run([sys.executable, "-c", code], env=plain, capture_output=True, text=True, check=False)
    assert done.stdout.split("\n")[:2] == ["(360, 480, 3) plain", "False"], done.stderr
