"""A calibration → `pickenv twin` → gymnasium.make with that plant, as docs/twin.md has it: errors raw and calibrated.

From an empty folder. The last number on the screen is the mean error of calibrated reaches on arms that the data allow,
mm (simulated arm qiao2026); it is what the calibration's report promised, and raw arms err as the true one does.
"""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import gymnasium_robotics
import mujoco
import numpy as np
import pytest

import pickenv
from pickenv.agents import ScriptedReach, episode_seeds, run_reaches
from pickenv.arm import forward, geometry_in_mujoco, joints_in_mujoco, load_arm
from tests.journeys.pages import ROOT, walked

gym.register_envs(gymnasium_robotics)
PAGE = (ROOT / "docs/twin.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, list[str]]:
    """An empty folder in which all blocks of the page were run, and what each printed."""
    folder = tmp_path_factory.mktemp("home")
    return folder, walked("twin.md", folder)


def shown(said: list[str]) -> tuple[float, float]:
    """Raw and calibrated mean error, mm, of the block that reaches."""
    (text,) = (text for text in said if re.fullmatch(r"\d+\.\d+ mm\n\d+\.\d+ mm\n", text))
    raw, calibrated = re.findall(r"\d+\.\d+", text)
    return float(raw), float(calibrated)


@pytest.mark.slow
def test_calibrated_arms_of_the_twin_err_as_the_report_promised(home: tuple[Path, list[str]]) -> None:
    folder, said = home
    raw, calibrated = shown(said)
    promised = json.loads((folder / "my_arm.json").read_text(encoding="utf-8"))["held_out"]["own_mean_ci95_mm"]
    assert 0.5 * promised[0] <= calibrated <= 1.5 * promised[1]
    env = gym.make("pickenv/Reach-v0", plant="qiao2026")
    true = run_reaches(env, ScriptedReach(env), episode_seeds(0, 100)).position_error_mm.mean()
    assert raw == pytest.approx(true, rel=0.1)


@pytest.mark.slow
def test_the_hand_of_anothers_task_errs_as_far_as_its_arm_does(home: tuple[Path, list[str]]) -> None:
    (text,) = re.findall(r"the hand errs by (\d+\.\d) mm\n$", "".join(home[1]))
    env = gym.make("FetchPickAndPlace-v4")
    env.reset(seed=0)
    inner: Any = env.unwrapped
    nominal = geometry_in_mujoco(inner.model, "robot0:grip", None, inner.data)
    joints = joints_in_mujoco(inner.model, inner.data, nominal)
    tools = [forward(arm, joints).position for arm in (nominal, replace(nominal, d=nominal.d + 0.003))]
    assert float(text) == pytest.approx(1e3 * np.linalg.norm(tools[1] - tools[0]), abs=0.05)


@pytest.mark.slow
def test_mujoco_has_the_calibrated_arm_and_those_that_the_data_allow(home: tuple[Path, list[str]]) -> None:
    folder, _ = home
    found = pickenv.Calibration.load(folder / "my_arm.npz").identified
    nominal = load_arm("qiao2026").nominal
    joints = np.random.default_rng(0).uniform(nominal.lower, nominal.upper, (50, nominal.joints))
    tools = {}
    for name in ("", "_nominal", "_1", "_2", "_3", "_4"):
        model = mujoco.MjModel.from_xml_path(str(folder / f"my_arm{name}.xml"))
        data, tools[name] = mujoco.MjData(model), np.zeros((50, 3))
        for row, q in zip(tools[name], joints, strict=True):
            data.qpos[:] = q
            mujoco.mj_kinematics(model, data)
            row[:] = data.site("tool").xpos
    for name, geometry in (("", found), ("_nominal", nominal)):
        np.testing.assert_allclose(tools[name], forward(geometry, joints).position, rtol=0, atol=1e-8)
    apart = [np.linalg.norm(tools[f"_{i}"] - tools[""], axis=1).mean() for i in range(1, 5)]
    assert 0 < max(apart) < np.linalg.norm(tools["_nominal"] - tools[""], axis=1).mean()


def test_every_file_that_the_page_names_exists() -> None:
    links = re.findall(r"\]\(([^)\s#]+)\)", PAGE)
    assert [link for link in links if not (ROOT / "docs" / link).exists()] == []
    scripts = set(re.findall(r"scripts/[\w/]+\.(?:py|toml)", PAGE))
    assert len(scripts) == 2 and [name for name in scripts if not (ROOT / name).is_file()] == []
