"""What a film's frames are put together of: words in their places, halves beside each other, a line below."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pickenv.inspect import RecordedEpisodes, RecordedPolicy, film
from pickenv.inspect.films import film as film_module
from pickenv.inspect.films.film import FilmPlan, FilmSet, film_pictures, film_stage, plan_film

A = [0.5, 0.0, 0.3]


def policy(label: str, miss_mm: float, ends: int) -> RecordedPolicy:
    """One episode of six moments that closes beside its one fruit at the fourth, and lasts for ``ends`` of them."""
    fruit = np.broadcast_to(A, (1, 6, 3))
    tool = fruit + 1e-3 * miss_mm * np.array([0.6, 0.8, 0.0])
    miss, nothing = np.full((1, 6), np.nan), np.zeros((1, 6, 0))
    miss[0, 3] = miss_mm
    return RecordedPolicy(
        label=label, key=label.lower(), moments=np.array([ends]), joint_target=nothing, joint_command=nothing,
        tool_position=tool, tool_rotation=np.full((1, 6, 3, 3), np.nan), fruit_position=fruit,
        position_error_mm=1e3 * np.linalg.norm(tool - fruit, axis=-1) + np.arange(6.0),
        attitude_error_deg=np.zeros((1, 6)), success=np.zeros((1, 6), bool), picked=np.zeros((1, 6), dtype=np.int64),
        miss_mm=miss, reward=np.zeros((1, 6)),
    )  # fmt: skip


@pytest.fixture
def episodes() -> RecordedEpisodes:
    return RecordedEpisodes(
        env_id="x/Reach", plant=None, gripper="li_cup", tolerance_mm=5.0, seed=0, seeds=(0,), period=0.1,
        policies=(policy("raw", 7.0, 6), policy("LS", 2.0, 5)),
    )  # fmt: skip


@pytest.fixture
def plan(episodes: RecordedEpisodes) -> FilmPlan:
    return plan_film(episodes, seconds=3.0)


def test_each_half_says_whose_it_is_what_is_picked_and_how_far_it_is(
    episodes: RecordedEpisodes, plan: FilmPlan
) -> None:
    film_set = FilmSet(episodes, plan, dark=False)
    for frame in plan.frames:
        for side, (miss, ends) in enumerate(((7.0, 6), (2.0, 5))):
            half = film_stage(film_set, frame, side)
            now = min(frame.moment, ends - 1)
            closed = now >= 3
            name, picked, away, ghost, *missed = half.words
            assert (name.text, name.colour, name.large) == (("raw", "LS")[side], None, True)
            assert (picked.text, picked.large) == (f"picked 0 of {int(closed)}", False)
            assert (away.text, away.place) == (f"{miss + now:.1f} mm to the fruit", "top right")
            assert ghost.text.startswith("ghost: the arm as believed, deviation × ") and ghost.place == "bottom left"
            assert [words.text for words in missed] == [f"missed by {miss:.1f} mm"] * closed
            if closed:
                np.testing.assert_allclose(missed[0].place, [0.5, 0.0, 0.3 - 0.045])
            assert half.dial is not None and half.dial.label == (f"miss {miss:.1f} mm" if closed else "no grasp yet")
            np.testing.assert_allclose(np.linalg.norm(half.dial.marks_mm, axis=1), [miss] * closed, rtol=1e-9)
            assert (half.size, half.dark, len(half.dial.marks_mm)) == ((400, 360), False, closed)


@pytest.mark.parametrize(("count", "dark", "plant"), [(1, False, ""), (2, True, "field")])
def test_halves_stand_side_by_side_above_a_line(
    count: int, dark: bool, plant: str, episodes: RecordedEpisodes, monkeypatch: pytest.MonkeyPatch
) -> None:
    named = SimpleNamespace(name=plant, arm=SimpleNamespace(nominal=None))
    shown = replace(episodes, policies=episodes.policies[:count], plant=named)
    plan = plan_film(shown, seconds=1.0, frames_per_second=4)
    lines: list[tuple[object, ...]] = []

    def strip(text: str, size: tuple[int, int], is_dark: bool) -> np.ndarray:
        lines.append((text, size, is_dark))
        line = np.full((size[1], size[0], 3), 9, dtype=np.uint8)
        line[0, 0], line[1, :], line[:, 1] = (1, 2, 3), 7, 8
        return line

    drawn: list[str] = []
    monkeypatch.setattr(film_module, "strip", strip)
    monkeypatch.setattr(
        film_module, "painted",
        lambda stage: drawn.append(stage.words[0].text) or np.full((360, 400, 3), 50 + len(drawn), dtype=np.uint8),
    )  # fmt: skip
    told: list[tuple[str, int, int]] = []
    pictures = list(film_pictures(shown, plan, dark=dark, progress=lambda *each: told.append(each)))
    width = 400 * count + 4 * (count - 1)
    named = f", plant {plant}" if plant else ""
    said = f"x/Reach{named}, gripper li_cup: the same fruit, {plan.speed:.1f} × as fast as the arm"
    assert lines == [(said, (width, 28), dark)]
    assert told == [("frames", number, 4) for number in range(1, 5)]
    assert drawn == [p.label for p in shown.policies] * 4
    for number, picture in enumerate(pictures):
        assert picture.shape == (388, width, 3) and picture.dtype == np.uint8
        for side in range(count):
            assert np.all(picture[:360, 404 * side : 404 * side + 400] == 51 + number * count + side)
        for side in range(count - 1):
            assert np.all(picture[:360, 404 * side + 400 : 404 * side + 404] == [1, 2, 3])
        assert picture[360, 0].tolist() == [1, 2, 3] and np.all(picture[361, 2:] == 7)
    assert next(film_pictures(shown, plan)).shape == (388, width, 3) and lines[-1][2] is False


def test_a_film_is_twelve_seconds_of_ten_frames_if_not_told_else(
    episodes: RecordedEpisodes, monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    monkeypatch.setattr(film_module, "read_run", lambda path: SimpleNamespace(kind="comparison"))
    monkeypatch.setattr(film_module, "load_part", lambda run, part: episodes)
    monkeypatch.setattr(film_module, "write_film", lambda pictures, path, fps: None)
    made = film(str(tmp_path), f"{tmp_path}/film.GIF")
    assert (len(made.plan.frames), made.plan.frames_per_second, made.plan.policies) == (120, 10, (0, 1))
