"""Comparisons: the same fruit for all, numbers recomputed, one number in every place, and who may take part."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces
from markdown_it import MarkdownIt
from rerun.chunk import RrdReader
from typer.testing import CliRunner

import pickenv
from pickenv import compare
from pickenv.agents import PolicyComparison, foreign_policy
from pickenv.agents.evaluation.compare import write_comparison
from pickenv.arm import forward, load_plant, nominal_points, pose_error, true_points
from pickenv.base import InputError, mean_interval, paired_share_interval, share_interval
from pickenv.calibration import Calibration, fit, random_joints, simulated_tracker
from pickenv.cli import app
from pickenv.inspect import Comparison, RecordedEpisodes, load_part, read_run
from pickenv.inspect.colours import as_sentence, in_words, lane, policy_colours, policy_rank
from pickenv.inspect.recordings.policy_recording import record_policies
from pickenv.inspect.runs import comparison_summary
from pickenv.inspect.runs.comparison_summary import pick_share
from pickenv.inspect.runs.recorded_episodes import missing_positions
from pickenv.orchard import load_gripper

EPISODES = 12


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    plant, rng = load_plant("qiao2026"), np.random.default_rng(0)
    measured = simulated_tracker(plant, random_joints(plant.arm.nominal, 60, rng), rng)
    return fit(plant.arm, measured, known_frames=True).calibration


@pytest.fixture(scope="module")
def found(calibration: Calibration) -> PolicyComparison:
    return pickenv.compare(["scripted"], compensate=[calibration, "none"], episodes=EPISODES, grid_step=0.4, seed=5)


@pytest.fixture(scope="module")
def folder(
    found: PolicyComparison,
    tmp_path_factory: pytest.TempPathFactory,
    unwritten: Callable[[], AbstractContextManager[None]],
) -> Path:
    path = tmp_path_factory.mktemp("runs") / "compared"
    with unwritten():
        write_comparison(found, path)
    return path


def test_policies_stand_in_order_and_reach_for_the_same_fruit(found: PolicyComparison) -> None:
    raw, ls = found.episodes.policies
    assert [raw.label, ls.label, raw.key, ls.key] == ["raw", "LS", "raw", "ls"]
    np.testing.assert_array_equal(raw.fruit_position, ls.fruit_position)
    assert len(np.unique(raw.fruit_position[:, 0], axis=0)) == EPISODES
    assert len(set(found.episodes.seeds)) == EPISODES


def test_what_a_film_draws_is_what_the_arm_did(found: PolicyComparison, calibration: Calibration) -> None:
    """The believed arm ends at the believed tool, the true arm at the true one, which the plant puts there."""
    episodes, plant = found.episodes, load_plant("qiao2026")
    assert isinstance(episodes, Comparison)
    for policy in episodes.policies:
        believed = nominal_points(episodes.nominal, policy.joint_target[:, -1])[:, -1]
        true = true_points(episodes.plant.geometry, policy.joint_command[:, -1], policy.tool_position[:, -1])[:, -1]
        np.testing.assert_allclose(true, policy.tool_position[:, -1], atol=1e-12)
        np.testing.assert_allclose(true, plant.tool_pose(policy.joint_command[:, -1]).position, atol=2e-5)
        np.testing.assert_allclose(believed, policy.fruit_position[:, -1], atol=1e-4)  # a scripted policy believes so
        np.testing.assert_allclose(
            policy.position_error_mm, 1e3 * np.linalg.norm(policy.tool_position - policy.fruit_position, axis=-1)
        )
    raw, ls = episodes.policies
    np.testing.assert_array_equal(raw.joint_command, raw.joint_target)
    np.testing.assert_allclose(
        ls.joint_command[:, -1], calibration.compensator()(ls.joint_target[:, -1]), rtol=0, atol=1e-12
    )


def test_rows_and_differences_are_those_of_the_episodes(found: PolicyComparison) -> None:
    raw, ls = found.episodes.policies
    rows = comparison_summary.policy_rows(found.episodes)
    (line,) = comparison_summary.policy_differences(found.episodes)
    ends = {policy.key: policy.position_error_mm[:, -1] for policy in (raw, ls)}
    for row in rows:
        misses = ends[row["key"]]
        assert row["mean_mm"] == pytest.approx(misses.mean())
        assert row["ci95_mm"] == pytest.approx(list(mean_interval(misses) or ()))
        taken = int(np.sum(misses < 5.0))  # Li's cup, and scripted attitudes are well within its angle
        assert (row["picked"], row["tried"]) == (taken, EPISODES)
        assert row["share_ci95"] == pytest.approx(list(share_interval(taken, EPISODES)))
    change = ends["ls"] - ends["raw"]
    assert line["difference_mm"] == pytest.approx(change.mean())
    assert line["ci95_mm"] == pytest.approx(list(mean_interval(change) or ()))
    assert line["nearer"] == int(np.sum(change < 0.0))
    assert line["significant"] and line["difference_mm"] < -0.8


def test_a_policys_field_is_where_it_ends_when_sent_to_each_goal(found: PolicyComparison) -> None:
    comparison = found.episodes
    assert isinstance(comparison, Comparison) and len(comparison.grid.points) >= 4
    plant = load_plant("qiao2026")
    joints = comparison.grid.joints
    settled = pose_error(forward(plant.arm.nominal, joints), plant.tool_pose(joints))
    raw, ls = comparison.policies
    np.testing.assert_allclose(raw.field_errors, settled[:, :3], atol=5e-5)
    assert np.mean(np.linalg.norm(ls.field_errors, axis=1) < np.linalg.norm(raw.field_errors, axis=1)) > 0.7


def test_one_number_in_the_terminal_the_json_the_page_and_the_recording(
    found: PolicyComparison, folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from rerun.chunk import RrdReader

    from pickenv.commands.comparing import _print_comparison

    monkeypatch.setenv("COLUMNS", "200")
    _print_comparison(found.episodes, details=True)
    terminal = capsys.readouterr().out
    terminal += " ".join(terminal.split())
    page = html.unescape((folder / "report.html").read_text(encoding="utf-8"))
    store = RrdReader(folder / "comparison.rrd").stream().collect()
    words = next(
        batch.column("TextDocument:text").to_pylist()[0][0]
        for chunk in store.stream()
        if chunk.entity_path == "/verdict"
        for batch in [chunk.to_record_batch()]
    )
    content = json.loads((folder / "comparison.json").read_text(encoding="utf-8"))
    cells = [cell for row in comparison_summary.policy_cells(found.episodes) for cell in row]
    cells += [cell for line in comparison_summary.difference_cells(found.episodes) for cell in line]
    for cell in cells:
        assert cell in terminal and in_words(cell) in page and in_words(cell) in words, cell
    for text in (content["headline"], content["explanation"]):
        assert text in terminal and as_sentence(text) in page and as_sentence(text) in words, text
    between = content["matters"]
    assert (between["from"], between["to"]) == ("raw", "LS")
    for change in between["changes"]:
        for policy, key in zip(found.episodes.policies, ("before", "after"), strict=True):
            apart = 1e3 * (policy.fruit_position - policy.tool_position)[:, -1]
            across = np.linalg.norm(np.cross(apart, policy.tool_rotation[:, -1, :, 2]), axis=1)
            share = pick_share(load_gripper(change["gripper"]), across, change["perception_mm"])
            assert change[key] == pytest.approx(share)
        assert f"<td>{100 * change['before']:.1f}</td><td>{100 * change['after']:.1f}</td>" in page
    most = max(between["changes"], key=lambda each: each["after"] - each["before"])
    second = content["explanation"].split(". ")[1]
    assert f"with {most['gripper']} and the fruit seen" in second
    assert f"{100 * most['before']:.0f} % taken with raw, {100 * most['after']:.0f} % with LS" in second
    for row in content["rows"]:
        assert f"{row['mean_mm']:.3f} (" in words
        names = [
            name
            for chunk in store.stream()
            if chunk.entity_path == f"/distance/{lane(row['key'])}"
            for batch in [chunk.to_record_batch()]
            if "SeriesLines:names" in batch.schema.names
            for name in batch.column("SeriesLines:names").to_pylist()[0]
        ]
        assert names == [in_words(f"{row['policy']}: {row['mean_mm']:.3f} mm")]


def test_names_stand_in_the_recordings_tables_sign_by_sign(found: PolicyComparison) -> None:
    names = ("raw|a", "c*d* <b> [x](y) `z`")
    policies = [replace(policy, label=name) for policy, name in zip(found.episodes.policies, names, strict=True)]
    episodes = replace(found.episodes, policies=tuple(policies))
    page = MarkdownIt().enable("table").render(comparison_summary.comparison_markdown(episodes))
    cells = re.findall(r"<td[^>]*>(.*?)</td>", page)
    for name in map(html.escape, names):
        assert cells.count(name) == 2, "as a policy and in a difference"
        assert name in page.partition("<table>")[0], "in the verdict"


def test_a_run_folder_gives_back_every_episode(found: PolicyComparison, folder: Path) -> None:
    run = read_run(folder)
    episodes = load_part(run, RecordedEpisodes)
    for one, other in zip(episodes.policies, found.episodes.policies, strict=True):
        for name, values in vars(one).items():
            np.testing.assert_array_equal(values, getattr(other, name))
    for name in ("env_id", "plant_name", "gripper", "tolerance_mm", "seed", "seeds", "period"):
        assert getattr(episodes, name) == getattr(found.episodes, name)
    assert isinstance(episodes, Comparison)
    (folder / "episodes.npz").write_bytes((folder / "episodes.npz").read_bytes()[:-1])
    with pytest.raises(InputError, match="not what the run wrote"):
        load_part(run, RecordedEpisodes)


class Pointing(gym.Env[Any, Any]):
    """A tool that steps towards a fruit; not one of pickenv's."""

    observation_space = spaces.Box(-1.0, 1.0, (3,), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (3,), np.float32)

    def __init__(self, told: tuple[str, ...] = ("tool_position", "fruit_position")) -> None:
        self.told = told

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.tool, self.fruit, self.moment = np.zeros(3), self.np_random.uniform(0.2, 0.8, 3), 0
        return self._seen()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.tool, self.moment = self.tool + 0.1 * np.asarray(action, dtype=float), self.moment + 1
        seen, info = self._seen()
        return seen, -float(np.linalg.norm(self.fruit - self.tool)), False, self.moment == 12, info

    def _seen(self) -> tuple[Any, dict[str, Any]]:
        info = {"tool_position": self.tool.copy(), "fruit_position": self.fruit.copy()}
        return np.float32(self.fruit - self.tool), {name: info[name] for name in self.told}


gym.register("tests/Pointing-v0", Pointing)

MAKER = """
import numpy as np
class Straight:
    def reset(self): pass
    def act(self, observation): return np.clip(10.0 * observation, -1.0, 1.0)
def make_policy(env, seed): return Straight()
"""


@pytest.fixture
def straight(tmp_path: Path) -> Path:
    path = tmp_path / "straight.py"
    path.write_text(MAKER, encoding="utf-8")
    return path


def test_a_foreign_environment_and_a_strangers_file_are_compared_drawn_and_reported(
    straight: Path, tmp_path: Path, unwritten: Callable[[], AbstractContextManager[None]]
) -> None:
    found = pickenv.compare(["random", straight], "tests/Pointing-v0", episodes=EPISODES)
    rows = {row["policy"]: row for row in comparison_summary.policy_rows(found.episodes)}
    assert not isinstance(found.episodes, Comparison) and found.episodes.nominal is None
    assert rows["straight"]["picked"] == EPISODES and rows["straight"]["mean_mm"] < 1e-3
    assert rows["random"]["picked"] == 0 and rows["random"]["attitude_deg"] is None
    with unwritten():
        written = {path.name for path in write_comparison(found, tmp_path / "run")}
    assert {"comparison.rrd", "report.html", "distance_over_time.png"} <= written
    assert "comparison.npz" not in written


def test_time_goes_by_the_control_period() -> None:
    settled = {}
    for period in (0.05, 0.1):
        found = pickenv.compare(["scripted"], episodes=2, grid_step=0.4, control_period_s=period).episodes
        assert found.period == period
        settled[period] = found.period * int((found.policies[0].position_error_mm[0] > 5.0).sum())
    assert settled[0.05] == pytest.approx(settled[0.1], abs=0.15)  # joints are as fast whatever the period
    with pytest.raises(InputError, match="give one control_period_s"):
        pickenv.compare(["scripted"], episodes=2, control_period_s=[0.05, 0.1])


@pytest.mark.parametrize(
    ("lines", "fault"),
    [
        ("def make_policy(env, seed):", "line 1: IndentationError: expected an indented block"),
        ("\nimport nowhere_at_all", "line 2: ModuleNotFoundError: No module named 'nowhere_at_all'"),
        ("def make_policy(env, seed):\n    return 1 / 0", "line 2: ZeroDivisionError: division by zero"),
        ("", "defines no make_policy"),
        ("def make_policy(env, seed): return 3", "has no act"),
    ],
)
def test_faults_of_a_strangers_file_are_said_with_its_line(lines: str, fault: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(lines, encoding="utf-8")
    with pytest.raises(InputError, match=r"mine\.py") as refused:
        foreign_policy(path, None, 0)
    assert fault in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("told", "missing"),
    [
        ((), "lacks 'tool_position' and 'fruit_position'"),
        (("tool_position",), "lacks 'fruit_position'"),
    ],
)
def test_what_an_environment_does_not_tell_is_said(told: tuple[str, ...], missing: str) -> None:
    with pytest.raises(InputError, match=missing):
        pickenv.compare(["random"], "tests/Pointing-v0", episodes=1, told=told)


@pytest.mark.parametrize("value", [[1.0, 2.0], "here", [0.0, np.nan, 0.0], 3.0])
def test_a_position_that_is_none_is_refused(value: Any) -> None:
    with pytest.raises(InputError, match="three finite numbers in m"):
        missing_positions({"tool_position": value, "fruit_position": np.zeros(3)})


@pytest.mark.slow
def test_a_model_of_stable_baselines_takes_part_where_it_fits(tmp_path: Path) -> None:
    sb3 = pytest.importorskip("stable_baselines3")
    env = gym.make("tests/Pointing-v0", max_episode_steps=12)
    for name in ("PPO", "A2C", "SAC", "TD3"):
        getattr(sb3, name)("MlpPolicy", env, seed=0, policy_kwargs={"net_arch": [8]}).save(tmp_path / f"{name}.zip")
    files = [tmp_path / f"{name}.zip" for name in ("PPO", "A2C", "SAC", "TD3")]
    found = pickenv.compare(files, "tests/Pointing-v0", episodes=2)
    for path, policy in zip(files, found.episodes.policies, strict=True):
        model = getattr(sb3, path.stem).load(path)
        inner = Pointing()
        seen, _ = inner.reset(seed=found.episodes.seeds[0])
        for _ in range(12):
            seen, *_ = inner.step(model.predict(seen, deterministic=True)[0])
        np.testing.assert_allclose(policy.tool_position[0, -1], inner.tool, atol=1e-6)
    with pytest.raises(InputError, match="was trained on observations"):
        pickenv.compare([files[0]], episodes=1, grid_step=0.4)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda folder: pickenv.compare([]), "nothing to compare"),
        (lambda folder: pickenv.compare(["scripted"], "no/Such-v0"), "cannot make the environment 'no/Such-v0'"),
        (lambda folder: pickenv.compare(["scripted"] * 3, compensate=["none", "none"]), "3 policies and 2 calibr"),
        (lambda folder: pickenv.compare(["scripted", "scripted"]), "two policies are called 'raw'"),
        (lambda folder: pickenv.compare(["scripted"], labels=["a", "b"]), "1 policies and 2 labels"),
        (lambda folder: pickenv.compare(["scripted"], arms="per_episode"), "use `pickenv evaluate`"),
        (lambda folder: pickenv.compare(["nobody"]), "unknown policy 'nobody'"),
        (lambda folder: pickenv.compare([folder / "none.zip"]), "does not exist"),
        (lambda folder: pickenv.compare(["scripted"], episodes=0), "episodes is 0"),
        (lambda folder: pickenv.compare(["scripted"], gripper="claw"), "claw"),
    ],
)
def test_what_cannot_be_compared_is_one_sentence(
    make: Callable[[Path], PolicyComparison], complaint: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=re.escape(complaint)):
        make(tmp_path)


def test_the_gripper_of_a_comparison_of_pickers_is_the_one_that_picks(monkeypatch: pytest.MonkeyPatch) -> None:
    made, plain = [], gym.make

    def making(name: str, **given: Any) -> Any:
        made.append(plain(name, **given))
        return made[-1]

    monkeypatch.setattr(gym, "make", making)
    found = pickenv.compare(["scripted"], "pickenv/Pick-v0", episodes=1, gripper="compliant_hand", fruit=1.0)
    assert found.command.count("--gripper compliant_hand") == 1
    assert found.episodes.gripper == made[-1].unwrapped.orchard.gripper.name == "compliant_hand"
    pickenv.compare(["random"], episodes=1, gripper="compliant_hand", grid_step=0.6)  # a reach has no gripper


def test_options_take_their_values_up_to_the_next_option() -> None:
    import typer

    from pickenv.commands.comparing import SeveralValues

    found: dict[str, Any] = {}

    def command(policies: list[str], compensate: list[str] = [], env: str = "") -> None:  # noqa: B006
        found.update(policies=policies, compensate=compensate, env=env)

    app = typer.Typer()
    app.command(cls=SeveralValues)(command)
    app(["a", "b", "--compensate", "none", "cal.npz#ls", "--env", "e"], standalone_mode=False)
    assert found == {"policies": ["a", "b"], "compensate": ["none", "cal.npz#ls"], "env": "e"}


def test_a_difference_of_paired_shares_has_newcombes_interval() -> None:
    """Newcombe 1998 (Stat. Med. 17, 2635), method 10, of 36, 12, 2 and 0 pairs: 0.0569 to 0.3404."""
    one = np.repeat([True, True, False, False], [36, 12, 2, 0])
    other = np.repeat([True, False, True, False], [36, 12, 2, 0])
    assert paired_share_interval(one, other) == pytest.approx((0.0569, 0.3404), abs=5e-5)
    low, high = paired_share_interval(other, one)
    assert (low, high) == pytest.approx((-0.3404, -0.0569), abs=5e-5)


def test_a_colour_is_a_names_own_and_no_two_of_a_set_share_one() -> None:
    assert policy_colours(["my ppo"]) == policy_colours(["raw", "my ppo"])[1:]
    assert policy_colours(["ppo_raw"]) == policy_colours(["raw"])
    names = ["scripted, raw", "servo, raw", "raw", "LS", "LS+BPNN", "ppo"]
    assert len(set(policy_colours(names))) == len(names)
    assert sorted(["ppo", "LS+BPNN", "raw", "LS"], key=policy_rank) == ["raw", "LS", "LS+BPNN", "ppo"]
    keys = ["raw", "ls", "ls_bpnn", "ppo"]
    assert sorted(map(lane, keys)) == [lane(key) for key in keys]


@pytest.mark.parametrize("words", ["scripted --compensate --episodes 2", "scripted --compensate"])
def test_an_option_of_several_values_needs_one(words):
    ran = CliRunner().invoke(app, ["compare", *words.split()])
    assert "--compensate has no value; give one or more" in str(ran.exception) + ran.output


def test_the_command_of_a_comparison_allows_what_the_call_allowed(tmp_path):
    plant, rng = load_plant("qiao2026"), np.random.default_rng(0)
    rows = simulated_tracker(plant, random_joints(plant.arm.nominal, 60, rng), rng)
    file = fit(plant.arm, rows, known_frames=False).calibration.save(tmp_path / "fitted")
    found = compare(["scripted"], compensate=[file], allow=["fitted-frames"], episodes=1, grid_step=0.6)
    assert "--allow fitted-frames" in found.command


def test_no_two_policies_of_a_recording_share_a_colour(found: PolicyComparison, tmp_path: Path) -> None:
    (policy, *_) = found.episodes.policies
    both = tuple(replace(policy, key=key, label=key) for key in ("scripted_raw", "servo_raw"))
    seen: dict[str, list[int]] = {}
    for chunk in RrdReader(record_policies(replace(found.episodes, policies=both), tmp_path / "c.rrd")).stream():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if name.endswith(("SeriesLines:colors", "Points3D:colors")):
                seen.setdefault(chunk.entity_path, batch.column(name).to_pylist()[0])
    assert seen["/distance/4_servo_raw"] == seen["/ends/servo_raw"] != seen["/distance/4_scripted_raw"]
