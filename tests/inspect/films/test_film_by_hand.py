"""What a film states of an arm without a picture of it, worked out by hand: attempts, lengths, speed, places, marks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from pickenv.arm import Plant, forward, load_arm, nominal_points
from pickenv.base import InputError
from pickenv.inspect import RecordedEpisodes, RecordedPolicy, film
from pickenv.inspect.colours import RED
from pickenv.inspect.films import film as film_module
from pickenv.inspect.films.film import (
    HALF,
    Film,
    arm_parts,
    attempts_of,
    film_stage,
    grasp_offset,
    plan_film,
    seen_along,
    tool_axis,
)
from pickenv.pictures.shapes import GAIN, MISSED_FRUIT, RIPE, hand_solids, sprig
from pickenv.pictures.stage import Eye

A, B, C = [0.5, 0.0, 0.3], [0.5, 0.2, 0.3], [0.3, 0.1, 0.6]
OFF = np.array([0.002, 0.003, 0.001])
UP, SIDE = np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0])


def of_tracks(
    fruit: Sequence[Sequence[Sequence[float]]],
    misses: Sequence[dict[int, float]],
    picks: Sequence[dict[int, int]],
    tool: np.ndarray | None = None,
    label: str = "raw",
) -> RecordedPolicy:
    """A policy whose tool is `OFF` beside its fruit; ``misses`` and ``picks`` by moment of each episode."""
    longest = max(map(len, fruit))
    shape = (len(fruit), longest)
    places = np.array([[*track, *[track[-1]] * (longest - len(track))] for track in fruit])
    miss, picked = np.full(shape, np.nan), np.zeros(shape, dtype=np.int64)
    for e in range(len(fruit)):
        for moment, mm in misses[e].items():
            miss[e, moment] = mm
        for moment, count in picks[e].items():
            picked[e, moment:] += count
    tool = places + OFF if tool is None else tool
    nothing = np.zeros((*shape, 0))
    return RecordedPolicy(
        label=label, key=label.lower(), moments=np.array([len(track) for track in fruit]), joint_target=nothing,
        joint_command=nothing, tool_position=tool, tool_rotation=np.full((*shape, 3, 3), np.nan),
        fruit_position=places, position_error_mm=1e3 * np.linalg.norm(tool - places, axis=-1),
        attitude_error_deg=np.zeros(shape), success=np.zeros(shape, bool), picked=picked, miss_mm=miss,
        reward=np.zeros(shape),
    )  # fmt: skip


def run_of(*policies: RecordedPolicy) -> RecordedEpisodes:
    return RecordedEpisodes(
        env_id="x/Pick", plant=None, gripper="li_cup", tolerance_mm=5.0, seed=0,
        seeds=tuple(range(len(policies[0].moments))), period=0.1, policies=policies,
    )  # fmt: skip


def moved(place: Sequence[float], metres: float) -> list[float]:
    return [place[0] + metres, place[1], place[2]]


@pytest.mark.parametrize(
    ("track", "misses", "picks", "found"),
    [
        ([A] * 6 + [B] * 4, {3: 2.0, 8: 9.0}, {5: 1}, [(0, 3, 5, True), (6, 8, 8, False)]),
        ([A] * 6 + [B] * 4, {3: 2.0, 8: 9.0}, {8: 1}, [(0, 3, 5, False), (6, 8, 8, True)]),
        ([A] * 6 + [B] * 4, {3: 2.0, 8: 9.0}, {4: 1}, [(0, 3, 4, True), (5, 8, 8, False)]),
        ([A] * 3 + [B] * 5, {3: 7.0}, {}, [(0, 3, 3, False)]),  # the next fruit at the moment of closing
        ([A] * 4 + [moved(A, 0.061)] * 3, {2: 7.0}, {}, [(0, 2, 3, False)]),
        ([A] * 4 + [moved(A, 0.059)] * 3, {2: 7.0}, {}, [(0, 2, 2, False)]),  # it swings, and is the same
        ([A] * 5, {0: 1.0, 4: 3.0}, {0: 1}, [(0, 0, 0, True), (1, 4, 4, False)]),
        ([A] * 5, {4: 3.0}, {4: 2}, [(0, 4, 4, True)]),
        ([A] * 5, {}, {}, []),
    ],
)
def test_attempts_begin_after_the_last_and_end_with_the_pick_or_the_next_fruit(track, misses, picks, found):
    policy = of_tracks([track, [B] * 12], [misses, {}], [picks, {}])
    assert attempts_of(policy, 0) == found and attempts_of(policy, 1) == []


def test_the_offset_of_a_grasp_is_from_the_fruit_that_was_gone_for():
    track, close = [A] * 3 + [B] * 5, 3
    policy = of_tracks([track], [{close: 7.0}], [{}])
    np.testing.assert_allclose(grasp_offset(policy, 0, 3), np.array(B) + OFF - A, atol=1e-12)
    np.testing.assert_allclose(grasp_offset(policy, 0, 5), OFF, atol=1e-12)
    np.testing.assert_allclose(grasp_offset(policy, 0, 0), OFF, atol=1e-12)
    swung = of_tracks([[A] * 3 + [moved(A, 0.02)] * 3], [{close: 7.0}], [{}])
    np.testing.assert_allclose(grasp_offset(swung, 0, 3), OFF, atol=1e-12)


@pytest.mark.parametrize(
    ("seconds", "fps", "episodes"), [(6.0, 10, 3), (4.9, 10, 3), (4.8, 10, 2), (1.0, 10, 1), (19.6, 10, 12)]
)
def test_as_many_episodes_are_shown_as_three_moments_to_a_frame_allow(seconds, fps, episodes):
    """Each has 40 moments, and its last nine times more."""
    policy = of_tracks([[A] * 40] * 12, [{10: 2.0, 30: 2.0}] * 12, [{}] * 12)
    plan = plan_film(run_of(policy), seconds=seconds, frames_per_second=fps)
    count = round(seconds * fps)
    assert (
        len(plan.frames) == count and plan.frames_per_second == fps and plan.policies == (policy,) and not plan.reaching
    )
    assert plan.speed == pytest.approx(49 * episodes * 0.1 / seconds)
    way = [(e, t) for e in range(episodes) for t in [*range(40), *[39] * 9]]
    expected = [way[round(i)] for i in np.linspace(0, len(way) - 1, count)]
    assert list(plan.frames) == expected


@pytest.mark.parametrize(("step", "arrived"), [(4e-4, 5), (6e-4, 11)])
def test_a_reach_is_shown_until_its_tools_stand(step, arrived):
    """The tool comes by 10 mm at a time for five moments, and then crawls."""
    along = np.cumsum([0.0] + [0.01] * 5 + [step] * 6 + [0.0] * 8)
    tool = np.array(A) + along[:, None] * UP
    policy = of_tracks([[A] * 20], [{19: 3.0}], [{19: 1}], tool=tool[None])
    slow = of_tracks([[A] * 20], [{19: 3.0}], [{}], tool=np.broadcast_to(A, (1, 20, 3)), label="LS")
    plan = plan_film(run_of(policy, slow, policy), seconds=2.0, frames_per_second=20)
    assert plan.reaching and plan.policies == (policy, policy)
    assert plan.speed == pytest.approx((arrived + 1 + 9) * 0.1 / 2.0)
    way = [*range(arrived + 1), *[19] * 9]
    assert {moment for _, moment in plan.frames} == set(way) and plan.frames[-1] == (0, 19)
    still = plan_film(run_of(slow), seconds=1.0)
    assert still.reaching and {moment for _, moment in still.frames} == {0, 19}
    twice = of_tracks([[A] * 20], [{3: 3.0, 19: 3.0}], [{}])
    assert not plan_film(run_of(policy, twice)).reaching
    assert not plan_film(run_of(of_tracks([[A] * 20], [{}], [{3: 1, 5: 1}]))).reaching


def test_films_last_one_to_120_seconds_of_one_to_60_frames():
    episodes = run_of(of_tracks([[A] * 5], [{}], [{}]))
    for seconds, fps in ((1.0, 1), (120.0, 1), (1.0, 60)):
        assert len(plan_film(episodes, seconds=seconds, frames_per_second=fps).frames) == round(seconds * fps)
    for seconds, fps in ((0.99, 10), (120.1, 10), (2.0, 0), (2.0, 61)):
        with pytest.raises(InputError, match="give 1 to 120 s, 1 to 60"):
            plan_film(episodes, seconds=seconds, frames_per_second=fps)


@pytest.fixture
def film_set() -> Film:
    """Two policies for three fruit, the last two 44 mm apart for one of them: one misses B, the other takes all."""
    near = moved(B, 0.044)
    raw = of_tracks([[A] * 6 + [B] * 4, [C] * 4], [{3: 2.0, 8: 9.0}, {3: 4.0}], [{5: 1}, {3: 1}])
    ls = of_tracks([[A] * 4 + [near] * 6, [C] * 4], [{3: 1.0, 8: 1.5}, {3: 0.5}], [{3: 1, 8: 1}, {3: 1}], label="LS")
    return plan_film(run_of(raw, ls), seconds=6.0)


def test_fruit_is_one_where_policies_go_for_it_within_45_mm(film_set):
    assert film_set.shown == [0, 1]
    np.testing.assert_array_equal(film_set.fruit[0], [A, B])
    np.testing.assert_array_equal(film_set.fruit[1], [C])
    assert film_set.attempts[0][0] == [(0, 3, 5, True), (6, 8, 8, False)]
    assert film_set.attempts[1][0] == [(0, 3, 3, True), (4, 8, 8, True)]
    farther = film_set.policies[1].fruit_position.copy()
    farther[0, 4:, 0] = 0.5 + 0.046
    apart = replace(film_set.policies[1], fruit_position=farther)
    made = replace(film_set, policies=(film_set.policies[0], apart))
    np.testing.assert_allclose(made.fruit[0], [A, B, [0.546, 0.2, 0.3]])


def test_the_ground_lies_at_least_200_mm_below_all_and_at_halves_of_a_metre(film_set):
    assert film_set.points[:, 2].min() == pytest.approx(0.3) and film_set.ground == 0.0
    lower = film_set.policies[0].tool_position.copy()
    lower[..., 2] -= 0.15
    low = replace(film_set.policies[0], tool_position=lower)
    assert replace(film_set, policies=(low, film_set.policies[1])).ground == -0.5
    assert len(film_set.points) == 3 + 2 * 2 * 10


def test_everything_is_in_sight_of_an_eye_behind_the_arm(film_set):
    columns, rows, depth = film_set.eye.project(film_set.points, HALF).T
    assert (depth > 0).all() and columns.min() >= 0 and columns.max() <= 400 and rows.min() >= 0 and rows.max() <= 360
    gaze = film_set.eye.target - film_set.eye.position
    ahead = np.concatenate([film_set.fruit[0], film_set.fruit[1]]).mean(axis=0)[:2]
    assert gaze[:2] @ ahead > 0 and gaze[2] < 0 and np.cross([*ahead, 0.0], gaze)[2] < 0  # from its left, looking down


@pytest.mark.parametrize(
    ("side", "episode", "moment", "hanging", "held", "missed", "marks"),
    [
        (0, 0, 2, [A, B], [], 0, 0),
        (0, 0, 4, [B], [A], 0, 1),
        (0, 0, 5, [B], [], 0, 1),
        (0, 0, 8, [B], [], 1, 2),
        (1, 0, 3, [B], [], 0, 1),
        (1, 0, 9, [], [], 0, 2),
        (0, 1, 0, [C], [], 0, 2),
        (0, 1, 3, [], [], 0, 3),
    ],
)
def test_each_fruit_hangs_is_held_gone_or_missed_as_the_policy_left_it(
    film_set, side, episode, moment, hanging, held, missed, marks
):
    number = film_set.frames.index((episode, moment))
    stage = film_stage(film_set, number, side)
    assert [words.large for words in stage.words[:4]] == [True, False, False, False]  # the policy's name
    drawn, crate = stage.balls[-2:]
    places = sorted([*map(list, hanging), *map(list, held)])
    np.testing.assert_allclose(
        np.reshape(sorted(drawn.start.tolist()), (-1, 3)), np.reshape(places, (-1, 3)), atol=1e-12
    )
    assert len(crate.start) == film_set.stated(number)[side].picked and (drawn.radius == 0.03).all()
    stems = np.concatenate([rods.start for rods in stage.rods if (rods.radius == 0.004).all()])
    np.testing.assert_allclose(stems - [0.0, 0.0, 0.027], np.reshape(hanging, (-1, 3)), atol=1e-12)
    colours = [tuple(colour) for colour in drawn.colour[:, :3].tolist()]
    assert colours.count(tuple(MISSED_FRUIT)) == missed and colours.count(tuple(RIPE)) == len(places) - missed
    assert len(stage.dial.marks_mm) == marks and stage.dial.tolerance_mm == 5.0
    right = np.cross(film_set.eye.axes()[2], UP)
    right /= np.linalg.norm(right)
    across = [1e3 * OFF @ right, 1e3 * OFF @ np.cross(UP, right)]
    np.testing.assert_allclose(stage.dial.marks_mm, [across] * marks if marks else np.empty((0, 2)), atol=1e-9)
    said = [words for words in stage.words if words.text.startswith("missed by")]
    assert len(said) == missed
    for words in said:
        assert words.text == "missed by 9.0 mm" and words.colour == RED
        np.testing.assert_allclose(words.place, np.array(B) - [0.0, 0.0, 0.045])


def test_words_about_a_miss_are_lighter_on_dark_pages(film_set):
    stage = film_stage(replace(film_set, dark=True), film_set.frames.index((0, 8)), 0)
    assert [words.colour for words in stage.words if words.text.startswith("missed")] == [(255, 128, 128)]


def test_a_reach_has_its_fruit_with_a_sprig_and_a_crate():
    plan = plan_film(run_of(of_tracks([[A] * 6], [{5: 3.0}], [{5: 1}])), seconds=2.0)
    for moment, picked in ((0, 0), (5, 1)):
        stage = film_stage(plan, plan.frames.index((0, moment)), 0)
        fruit, crate = stage.balls[-2:]
        stems = [len(rods.start) for rods in stage.rods if (rods.radius == 0.004).all()]
        assert (len(fruit.start), sum(stems), len(crate.start)) == (1, 1 - picked, picked)
        drawn = sprig(np.array(A), 0.06)
        np.testing.assert_array_equal(stage.rods[-1].start, drawn[0][0].start)
        np.testing.assert_array_equal(stage.meshes[-1].corners, drawn[2][0].corners)


@pytest.mark.parametrize(("moment", "closed"), [(4, False), (5, True), (7, True)])
def test_a_hand_is_closed_from_the_grasp_on(moment, closed):
    policy = of_tracks([[A] * 8], [{5: 3.0}], [{}])
    episodes = replace(run_of(policy), gripper="compliant_hand")
    found = arm_parts(episodes, policy, 0, moment, (1, 2, 3))
    expected = hand_solids(policy.tool_position[0, moment], UP, 0.0375, closed)
    np.testing.assert_array_equal(found[0][0].end, expected[0][0].end)
    other = hand_solids(policy.tool_position[0, moment], UP, 0.0375, not closed)
    assert not np.allclose(found[0][0].end, other[0][0].end)


def test_the_ghost_stands_where_the_tool_of_the_believed_arm_would_be():
    """Also of an arm whose last link has a length."""
    arm = load_arm("ur5")
    nominal = arm.nominal
    target = (nominal.lower + nominal.upper) / 2 + 0.3
    believed = forward(nominal, target).position
    assert np.linalg.norm(nominal_points(nominal, target)[-2] - believed) > 0.01
    policy = of_tracks([[A] * 4], [{}], [{}], tool=np.broadcast_to(believed + 0.002 * SIDE, (1, 4, 3)))
    joints = np.broadcast_to(target, (1, 4, 6))
    policy = replace(policy, joint_target=joints, joint_command=joints + 0.01)
    found = arm_parts(replace(run_of(policy), plant=Plant("ur5", arm, nominal)), policy, 0, 2, (1, 2, 3))
    ghost = next(rods for rods in found[0] if len(rods.colour) and rods.colour[0, 3] < 255)
    np.testing.assert_allclose(ghost.end[-1], believed + (1 - GAIN) * 0.002 * SIDE, atol=1e-9)


def test_an_offset_is_seen_across_the_tool_from_where_the_eye_stands():
    ahead = Eye(np.array([0.0, -5.0, 0.0]), np.zeros(3)).axes()[2]
    np.testing.assert_allclose(seen_along(UP, np.array([1.0, 2.0, 3.0]), ahead), [1.0, 2.0], atol=1e-12)
    np.testing.assert_allclose(
        seen_along(np.array([1.0, 0.0, 0.0]), np.array([1.0, 2.0, 3.0]), ahead), [-3.0, 2.0], atol=1e-12
    )
    policy = of_tracks([[A] * 4], [{}], [{}])
    np.testing.assert_array_equal(tool_axis(policy, 0, 1), UP)
    turned = np.zeros((1, 4, 3, 3))
    turned[0, 1] = np.arange(9.0).reshape(3, 3)
    np.testing.assert_array_equal(tool_axis(replace(policy, tool_rotation=turned), 0, 1), [2.0, 5.0, 8.0])


def test_a_film_goes_into_folders_that_are_made_or_there_and_says_what_it_states(film_set, tmp_path, monkeypatch):
    kinds = iter(["comparison", "comparison", "demo"])
    monkeypatch.setattr(film_module, "read_run", lambda path: SimpleNamespace(kind=next(kinds)))
    monkeypatch.setattr(film_module, "load_part", lambda run, part: film_set.episodes)
    monkeypatch.setattr(film_module, "write_film", lambda pictures, path, fps: path.write_text(f"{fps}"))
    out = tmp_path / "some" / "where" / "film.mp4"
    for fps in (5, 20):
        made = film(tmp_path, out, policies=["LS"], seconds=2.0, frames_per_second=fps)
        assert out.read_text() == str(fps)
        assert vars(made) == vars(plan_film(film_set.episodes, ["LS"], 2.0, fps))
    with pytest.raises(InputError, match="is a run of kind 'demo'"):
        film(tmp_path, out)
    with pytest.raises(InputError, match=r"let it end in \.gif or \.mp4"):
        film(tmp_path, "film.avi")


def test_a_film_is_as_dark_as_it_is_asked_to_be_and_tells_how_far_it_is(film_set, tmp_path, monkeypatch):
    """All that is drawn from is passed on, and light is what nobody asks to be dark."""
    drawn: list[tuple[object, ...]] = []
    monkeypatch.setattr(film_module, "read_run", lambda path: SimpleNamespace(kind="comparison"))
    monkeypatch.setattr(film_module, "load_part", lambda run, part: film_set.episodes)
    monkeypatch.setattr(film_module, "write_film", lambda pictures, path, fps: None)
    monkeypatch.setattr(
        film_module,
        "film_pictures",
        lambda film, progress=None: drawn.append((vars(film), progress)),
    )
    for given, dark, progress in (({}, False, None), ({"dark": True, "progress": print}, True, print)):
        film(tmp_path, tmp_path / "film.gif", seconds=2.0, **given)
        assert drawn.pop() == (vars(plan_film(film_set.episodes, (), 2.0, 10, dark)), progress)
