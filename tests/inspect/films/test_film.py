"""A film states what the run's arrays say, frame by frame, and its pictures change where that changes."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pickenv.arm import forward, load_plant
from pickenv.base import InputError
from pickenv.inspect import RecordedEpisodes, RecordedPolicy, film
from pickenv.inspect.colours import in_words
from pickenv.inspect.films import film as film_module
from pickenv.inspect.films.film import (
    GAP,
    HALF,
    MOST_MOMENTS,
    STRIP,
    Film,
    attempts_of,
    film_pictures,
    film_stage,
    plan_film,
    write_film,
)
from pickenv.pictures.shapes import GAIN

ARM = load_plant("qiao2026").arm.nominal
PLANT = dataclasses.replace(load_plant("qiao2026"), name="orchard")


def policy(label, rng, off_mm, taken, episodes, moments, many):
    """Episodes in which the tool comes to one fruit, or to three one after the other, and is ``off_mm`` off there."""
    n = ARM.joints
    shape = (episodes, moments)
    command = np.broadcast_to((ARM.lower + ARM.upper) / 2, (*shape, n)).copy()
    command[..., 1] += np.linspace(0.0, 0.1, moments)
    pose = forward(ARM, command)
    tool = pose.position + np.array([0.0, 0.0, 1e-3 * off_mm])
    fruit = np.repeat(tool[:, -1:] + [0.05, -0.1, 0.0], moments, axis=1)
    miss, picked = np.full(shape, np.nan), np.zeros(shape, dtype=np.int64)
    count = np.full(episodes, moments) - np.arange(episodes)
    for e in range(episodes):
        last = count[e] - 1
        closes = [last] if not many else [last // 3, 2 * last // 3, last]
        for k, t in enumerate(closes):
            miss[e, t] = off_mm + rng.uniform(0, 1)
            if (e + k) % 2 or taken:
                picked[e, t:] += 1
            if many:
                fruit[e, t + 1 :] += [0.0, 0.0, 0.15]
    distance = 1e3 * np.linalg.norm(tool - fruit, axis=-1)
    return RecordedPolicy(
        label=label, key=label.lower(), moments=count, joint_target=command, joint_command=command, tool_position=tool,
        tool_rotation=pose.rotation, fruit_position=fruit, position_error_mm=distance,
        attitude_error_deg=np.zeros(shape), success=np.zeros(shape, bool), picked=picked, miss_mm=miss,
        reward=np.zeros(shape),
    )  # fmt: skip


def run(many, episodes=3, moments=40):
    rng = np.random.default_rng(7)
    policies = (
        policy("raw", rng, 6.0, False, episodes, moments, many),
        policy("LS", rng, 1.0, True, episodes, moments, many),
    )
    return RecordedEpisodes(
        env_id="pickenv/Pick-v0" if many else "pickenv/Reach-v0", plant=PLANT, gripper="li_cup", tolerance_mm=5.0,
        seed=0, seeds=tuple(range(episodes)), period=0.1, policies=policies,
    )  # fmt: skip


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize(("seconds", "fps"), [(12.0, 10), (3.0, 8)])
def test_every_frame_states_what_the_run_holds(many, seconds, fps):
    episodes = run(many)
    plan = plan_film(episodes, seconds=seconds, frames_per_second=fps)
    assert len(plan.frames) == round(seconds * fps) and plan.reaching is not many
    assert list(plan.frames) == sorted(plan.frames) and plan.frames[0] == (0, 0)
    for number, (episode, moment) in enumerate(plan.frames):
        for held, stated in zip(episodes.policies, plan.stated(number), strict=True):
            now = min(moment, held.moments[episode] - 1)
            assert stated.label == held.label
            assert stated.distance_mm == held.position_error_mm[episode, now]
            earlier = [m for e in range(episode) for m in held.miss_mm[e] if np.isfinite(m)]
            closed = earlier + [m for m in held.miss_mm[episode, : now + 1] if np.isfinite(m)]
            assert stated.tried == len(closed)
            assert stated.miss_mm == (closed[-1] if closed else None)
            ends = sum(held.picked[e, held.moments[e] - 1] for e in range(episode))
            assert stated.picked == ends + held.picked[episode, now]
            assert 0 <= stated.picked <= stated.tried
    for held, stated in zip(episodes.policies, plan.stated(-1), strict=True):
        whole = [held.picked[e, held.moments[e] - 1] for e in range(plan.frames[-1][0] + 1)]
        assert stated.picked == sum(whole)


def test_a_film_goes_no_faster_than_can_be_followed_and_says_how_fast():
    episodes = run(many=True, episodes=12)
    plan = plan_film(episodes, seconds=6.0)
    steps = np.diff([moment for episode, moment in plan.frames if episode == 0])
    assert steps.max() <= MOST_MOMENTS + 1
    shown = {episode for episode, _ in plan.frames}
    assert shown == set(range(len(shown))) and 1 < len(shown) < 12
    assert 1.0 < plan.speed <= MOST_MOMENTS
    assert plan.speed == pytest.approx(np.mean([s for s in steps if s > 0]), rel=0.35)


@pytest.mark.parametrize("many", [False, True])
def test_each_grasp_is_an_attempt_that_is_taken_or_not(many):
    for held in run(many).policies:
        for e in range(3):
            found = attempts_of(held, e)
            assert [close for _, close, *_ in found] == np.flatnonzero(np.isfinite(held.miss_mm[e])).tolist()
            gains = np.diff(held.picked[e], prepend=0)
            assert [taken for *_, taken in found] == [bool(gains[close]) for _, close, *_ in found]


def test_the_stage_shows_arm_ghost_and_misses_of_the_run():
    episodes = run(many=True)
    plan = plan_film(episodes)
    episode, _ = plan.frames[-1]
    for side, held in enumerate(episodes.policies):
        stage = film_stage(plan, -1, side)
        texts = [words.text for words in stage.words]
        stated = plan.stated(-1)[side]
        assert texts[0] == in_words(held.label) and f"picked {stated.picked} of {stated.tried}" in texts
        assert stage.dial.label == f"miss {stated.miss_mm:.1f} mm" and stage.dial.tolerance_mm == 5.0
        assert len(stage.dial.marks_mm) == stated.tried
        missed = [words for words in stage.words if words.text.startswith("missed by")]
        gains = np.diff(held.picked[episode], prepend=0)
        closes = np.flatnonzero(np.isfinite(held.miss_mm[episode]))
        assert [w.text for w in missed] == [
            f"missed by {held.miss_mm[episode, t]:.1f} mm" for t in closes if not gains[t]
        ]
        ghost = next(rods for rods in stage.rods if len(rods.colour) and rods.colour[0, 3] < 255)
        now = held.moments[episode] - 1
        tool = held.tool_position[episode, now]
        believed = forward(ARM, held.joint_target[episode, now]).position
        np.testing.assert_allclose(ghost.end[-1], tool + GAIN * (believed - tool), atol=1e-9)
        assert any(f"deviation × {GAIN}" in text for text in texts)


def test_the_inset_changes_when_the_gripper_closes_and_not_before():
    episodes = run(many=True)
    plan = plan_film(episodes)
    tried = [plan.stated(number)[0].tried for number in range(len(plan.frames))]
    first = tried.index(1)
    around = dataclasses.replace(plan, frames=plan.frames[first - 2 : first + 1])
    pictures = list(film_pictures(around))
    assert {picture.shape for picture in pictures} == {(HALF[1] + STRIP, 2 * HALF[0] + GAP, 3)}
    inset = np.s_[HALF[1] - 105 : HALF[1] - 8, HALF[0] - 105 : HALF[0] - 8]
    green = [((p[inset].astype(int) - [46, 139, 87]) ** 2).sum(axis=-1) < 300 for p in pictures]
    assert all(ring.sum() > 100 for ring in green)
    disc = np.hypot(*np.mgrid[-48:49, -48:49]) < 48.5  # the orange arm may stand beside the round inset
    orange = [((p[inset][disc].astype(int) - [230, 159, 0]) ** 2).sum(axis=-1) < 60 for p in pictures]
    assert orange[0].sum() == orange[1].sum() == 0
    assert orange[2].sum() > 30


@pytest.mark.parametrize("dark", [False, True])
def test_pictures_put_the_policies_side_by_side_in_their_colours(dark):
    episodes = run(many=False)
    plan = plan_film(episodes, ["LS", "raw"], seconds=1.0, frames_per_second=2, dark=dark)
    assert [stated.label for stated in plan.stated(0)] == ["LS", "raw"]
    left, right = (next(film_pictures(plan))[: HALF[1], columns].astype(int)
                   for columns in (np.s_[: HALF[0]], np.s_[-HALF[0] :]))  # fmt: skip
    blue, orange = (lambda p: p[..., 2] > 2 * p[..., 0] + 40), (lambda p: p[..., 0] > 3 * p[..., 2] + 60)
    assert orange(right).sum() > orange(left).sum() + 1000
    assert blue(left).sum() > blue(right).sum() + 1000
    assert bool(left[0].mean() < 80) is dark


def test_one_policy_alone_can_be_filmed_and_unknown_ones_are_named():
    episodes = run(many=False)
    assert len(plan_film(episodes, ["LS"]).stated(0)) == 1
    with pytest.raises(InputError, match="no policy 'BPNN' in this run; give one of raw, LS"):
        plan_film(episodes, ["BPNN"])
    with pytest.raises(InputError, match="impossible"):
        plan_film(episodes, seconds=0.0)


def test_files_hold_every_frame(tmp_path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    from PIL import Image

    episodes = run(many=True)
    plan = plan_film(episodes, seconds=1.0)
    pictures = list(film_pictures(plan))
    for name in ("film.gif", "film.mp4"):
        write_film(iter(pictures), tmp_path / name, 10)
        frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / name))
        assert frames == 10 and seconds == pytest.approx(1.0, abs=0.15)
    with Image.open(tmp_path / "film.gif") as picture:
        assert picture.n_frames == 10 and picture.info["loop"] == 0
        shown = np.asarray(picture.convert("RGB"), dtype=int)
    assert np.abs(shown - pictures[0]).mean() < 8


def test_a_film_that_is_broken_off_leaves_the_old_file_or_none(tmp_path):
    pytest.importorskip("imageio_ffmpeg")

    def broken_off():
        yield from np.zeros((5, 64, 64, 3), dtype=np.uint8)
        raise KeyboardInterrupt

    for name in ("film.gif", "film.mp4"):
        for old in (None, b"an older film"):
            if old is not None:
                (tmp_path / name).write_bytes(old)
            with pytest.raises(KeyboardInterrupt):
                write_film(broken_off(), tmp_path / name, 10)
            files = [path.read_bytes() for path in tmp_path.glob(f"*{name[4:]}")]
            assert files == ([] if old is None else [old])


# What a film's frames are put together of: words in their places, halves beside each other, a line below.
A = [0.5, 0.0, 0.3]


def closing(label: str, miss_mm: float, ends: int) -> RecordedPolicy:
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
        policies=(closing("raw", 7.0, 6), closing("LS", 2.0, 5)),
    )  # fmt: skip


@pytest.fixture
def plan(episodes: RecordedEpisodes) -> Film:
    return plan_film(episodes, seconds=3.0)


def test_each_half_says_whose_it_is_what_is_picked_and_how_far_it_is(plan: Film) -> None:
    for number, (_, moment) in enumerate(plan.frames):
        for side, (miss, ends) in enumerate(((7.0, 6), (2.0, 5))):
            half = film_stage(plan, number, side)
            now = min(moment, ends - 1)
            closed = now >= 3
            name, picked, away, ghost, *missed = half.words
            assert (name.text, name.colour, name.large) == (("raw", "least squares")[side], None, True)
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
    plan = plan_film(shown, seconds=1.0, frames_per_second=4, dark=dark)
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
    pictures = list(film_pictures(plan, progress=lambda *each: told.append(each)))
    width = 400 * count + 4 * (count - 1)
    named = f", {in_words(plant)}" if plant else ""
    said = f"x/Reach{named}, suction cup: the same fruit, {plan.speed:.1f} × as fast as the arm"
    assert lines == [(said, (width, 28), dark)]
    assert told == [("frames", number, 4) for number in range(1, 5)]
    assert drawn == [in_words(p.label).partition(" + ")[0] for p in shown.policies] * 4
    for number, picture in enumerate(pictures):
        assert picture.shape == (388, width, 3) and picture.dtype == np.uint8
        for side in range(count):
            assert np.all(picture[:360, 404 * side : 404 * side + 400] == 51 + number * count + side)
        for side in range(count - 1):
            assert np.all(picture[:360, 404 * side + 400 : 404 * side + 404] == [1, 2, 3])
        assert picture[360, 0].tolist() == [1, 2, 3] and np.all(picture[361, 2:] == 7)
    assert next(film_pictures(replace(plan, dark=False))).shape == (388, width, 3) and lines[-1][2] is False


def test_a_film_is_twelve_seconds_of_ten_frames_if_not_told_else(
    episodes: RecordedEpisodes, monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    monkeypatch.setattr(film_module, "read_run", lambda path: SimpleNamespace(kind="comparison"))
    monkeypatch.setattr(film_module, "load_part", lambda run, part: episodes)
    monkeypatch.setattr(film_module, "write_film", lambda pictures, path, fps: None)
    made = film(str(tmp_path), f"{tmp_path}/film.GIF")
    assert (len(made.frames), made.frames_per_second, made.policies) == (120, 10, episodes.policies)
