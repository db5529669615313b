"""Every environment can be seen: pictures of one size, the same for the same seed, true to what `info` says."""

from __future__ import annotations

import subprocess
import sys

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.wrappers import RecordVideo

import pickenv  # noqa: F401
from pickenv.arm import forward, load_arm
from pickenv.base import InputError
from pickenv.pictures.shapes import GAIN

IDS = sorted(name for name in gym.registry if name.startswith("pickenv/"))
NATIVE = [name for name in IDS if gym.registry[name].vector_entry_point]


def words(env):
    return [each.text for each in env.unwrapped._stage().words]


@pytest.mark.parametrize("name", IDS)
def test_pictures_have_one_size_follow_the_arm_and_repeat(name):
    env, twin = (gym.make(name, render_mode="rgb_array") for _ in range(2))
    assert env.metadata["render_modes"] == ["human", "rgb_array"]
    with pytest.raises(InputError, match="before reset"):
        env.unwrapped.render()
    action = np.ones(env.action_space.shape, dtype=np.float32)
    pictures = []
    for each in (env, twin):
        each.reset(seed=3)
        pictures.append([each.render()])
        each.step(action)
        pictures[-1].append(each.render())
    for picture in pictures[0]:
        assert picture.shape == (360, 480, 3) and picture.dtype == np.uint8
    np.testing.assert_array_equal(pictures[0], pictures[1])
    assert (pictures[0][0] != pictures[0][1]).any(axis=-1).sum() > 100
    env.unwrapped.dark = True
    assert env.render().mean() < pictures[0][1].mean() - 50


@pytest.mark.parametrize("name", IDS)
def test_drawing_changes_nothing(name):
    """An environment that is drawn at every step goes the way of one that is not."""
    seen, unseen = gym.make(name, render_mode="rgb_array"), gym.make(name)
    assert str(seen.reset(seed=1)[1]) == str(unseen.reset(seed=1)[1])
    rng = np.random.default_rng(0)
    for _ in range(3):
        seen.render()
        action = rng.uniform(-1, 1, seen.action_space.shape).astype(np.float32)
        one, other = seen.step(action), unseen.step(action)
        assert str(one) == str(other)


@pytest.mark.parametrize("name", IDS)
def test_a_window_is_shown_at_each_step(name, monkeypatch):
    monkeypatch.setenv("MPLBACKEND", "agg")
    env = gym.make(name, render_mode="human")
    shown = []
    env.reset(seed=0)
    monkeypatch.setattr(env.unwrapped._window, "show", lambda picture: shown.append(picture))
    env.step(env.action_space.sample())
    assert [picture.shape for picture in shown] == [(360, 480, 3)]
    env.close()


def test_a_window_needs_a_display(monkeypatch):
    for name in ("MPLBACKEND", "DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")
    with pytest.raises(InputError, match="needs a display"):
        gym.make("pickenv/Reach-v0", render_mode="human").reset(seed=0)


@pytest.mark.parametrize("name", NATIVE)
def test_native_environments_show_each_what_a_single_one_shows(name):
    envs = gym.make_vec(name, num_envs=2, render_mode="rgb_array")
    envs.reset(seed=5)
    for i, picture in enumerate(envs.render()):
        single = gym.make(name, render_mode="rgb_array")
        single.reset(seed=5 + i)
        assert (np.abs(picture.astype(int) - single.render()).max(axis=-1) > 2).mean() < 0.002


def translucent(stage):
    return [(rods, rods.colour[0, 3]) for rods in stage.rods if len(rods.colour) and rods.colour[0, 3] < 255]


@pytest.mark.parametrize("plant", ["orchard", "ideal"])
def test_the_ghost_stands_as_many_times_off_as_the_words_say(plant):
    env = gym.make("pickenv/Reach-v0", plant=plant, render_mode="rgb_array")
    env.reset(seed=2)
    for _ in range(5):
        observation, _, _, _, info = env.step(env.action_space.sample() * 0.0 + 0.3)
    stage = env.unwrapped._stage()
    ((rods, opacity),) = translucent(stage)
    assert 60 < opacity < 200
    believed = observation[6:9].astype(float)
    wanted = info["tool_position"] + GAIN * (believed - info["tool_position"])
    np.testing.assert_allclose(rods.end[-1], wanted, atol=1e-5)
    assert any(f"deviation × {GAIN}" in text for text in words(env))
    off = np.linalg.norm(rods.end[-1] - info["tool_position"])
    assert off < 1e-5 if plant == "ideal" else off > 0.01


def test_words_and_dial_of_a_reach_say_what_info_says():
    env = gym.make("pickenv/Reach-v0", plant="orchard", tolerance_mm=7.0, render_mode="rgb_array")
    env.reset(seed=2)
    _, _, _, _, info = env.step(env.action_space.sample())
    assert words(env)[0] == f"{info['position_error_mm']:.2f} mm, {info['attitude_error_deg']:.2f}° from the fruit"
    dial = env.unwrapped._stage().dial
    assert dial.tolerance_mm == 7.0
    axis = forward(load_arm("qiao2026").nominal, info["joint_command"]).rotation[:, 2]
    offset = info["tool_position"] - info["fruit_position"]
    across = 1e3 * np.linalg.norm(offset - (offset @ axis) * axis)
    assert np.linalg.norm(dial.marks_mm[-1]) == pytest.approx(across, rel=1e-6)


def test_words_of_a_canopy_and_of_a_zone_say_what_info_says():
    from pickenv.agents import ScriptedHarvest, ScriptedPick

    for name, policy, steps in (("pickenv/Pick-v0", ScriptedPick, 60), ("pickenv/Harvest-v0", ScriptedHarvest, 60)):
        env = gym.make(name, render_mode="rgb_array")
        acting = policy(env)
        observation, info = env.reset(seed=0)
        for _ in range(steps):
            observation, _, _, _, info = env.step(acting.act(observation))
        assert info["collected"] > 0
        assert words(env)[0] == f"picked {info['collected']} of {info['reachable']}"


@pytest.mark.slow
@pytest.mark.parametrize("name", IDS)
def test_record_video_films_every_id(name, tmp_path):
    pytest.importorskip("moviepy")
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg")
    env = RecordVideo(gym.make(name, render_mode="rgb_array"), str(tmp_path / "films"), episode_trigger=lambda _: True)
    env.reset(seed=0)
    for _ in range(4):
        env.step(env.action_space.sample())
    env.close()
    (path,) = (tmp_path / "films").glob("*.mp4")
    frames, seconds = imageio_ffmpeg.count_frames_and_secs(str(path))
    lasts = 5 / env.metadata["render_fps"]  # of the arm's time
    assert frames == 5 and seconds == pytest.approx(lasts, rel=0.22)


@pytest.mark.slow
def test_making_an_environment_loads_nothing_that_draws():
    without = [name for name in IDS if name != "pickenv/PickScene-v0"]
    code = f"import sys, gymnasium, pickenv\nfor name in {without!r}: gymnasium.make(name).reset(seed=0)\n"
    code += "assert 'mujoco' not in sys.modules\n"
    code += "gymnasium.make('pickenv/PickScene-v0').reset(seed=0)\n"  # which MuJoCo simulates
    code += "print({'pickenv.pictures.mujoco_drawer', 'matplotlib', 'PIL'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout.strip() == "set()", done.stderr
