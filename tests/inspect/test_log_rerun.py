"""Logged episodes: what is in the file is what `info` said, and logging changes nothing else."""

from __future__ import annotations

import doctest
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import nullcontext
from itertools import chain
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import pickenv  # noqa: F401  (registers the environments)
from pickenv.arm import forward
from pickenv.base import InputError
from pickenv.envs import HarvestEnv, ReachVectorEnv
from pickenv.inspect import LogRerun, LogRerunVector
from pickenv.inspect.recordings import log_rerun, viewing
from pickenv.inspect.recordings.episode_entities import capped_cubic
from pickenv.inspect.recordings.viewing import check_answers

RERUN = Path(sys.executable).with_name("rerun")
ROOT = Path(__file__).parents[2]


def always(_: int) -> bool:
    return True


def run(env: gym.Env[Any, Any], episodes: int, steps: int, seed: int = 3) -> list[list[dict[str, Any]]]:
    """Random actions; all infos, by episode."""
    env.action_space.seed(seed)
    infos = []
    for episode in range(episodes):
        _, info = env.reset(seed=seed if episode == 0 else None)
        infos.append([info])
        for _ in range(steps):
            _, reward, terminated, truncated, info = env.step(env.action_space.sample())
            infos[-1].append({**info, "reward": reward})
            if terminated or truncated:
                break
    env.close()
    return infos


def reach(tmp_path: Path, steps: int = 8, **arguments: Any) -> LogRerun[Any, Any]:
    env = gym.make("pickenv/Reach-v0", max_episode_steps=steps, tolerance_mm=5.0)
    return LogRerun(env, tmp_path, **{"episode_trigger": always, "policy": "raw", **arguments})


def test_every_value_is_read_back(tmp_path: Path, reader: Callable[[Path], Any]) -> None:
    episodes = run(reach(tmp_path), 3, 8)
    reading = reader(tmp_path / "episodes-raw.rrd")
    infos = [info for episode in episodes for info in episode]
    assert len(infos) == 27
    np.testing.assert_array_equal(reading.times("/outcome/1_raw", "step"), np.arange(27))
    np.testing.assert_array_equal(reading.times("/outcome/1_raw", "episode"), np.repeat([0, 1, 2], 9))
    seconds = 0.1 * np.arange(27) + np.repeat([0.0, 1.0, 2.0], 9)  # a second of nothing between episodes
    np.testing.assert_allclose(reading.times("/outcome/1_raw", "sim_time"), 1e9 * seconds)
    np.testing.assert_allclose(reading.times("/outcome/1_raw", "episode_time"), 1e8 * np.tile(np.arange(9), 3))
    fruit, tool, q = (np.array([i[key] for i in infos]) for key in ("fruit_position", "tool_position", "joint_command"))
    np.testing.assert_allclose(reading.values("/world/fruit/raw", "Points3D:positions"), fruit, atol=1e-6)
    np.testing.assert_allclose(reading.values("/world/miss/raw", "Arrows3D:vectors"), tool - fruit, atol=1e-6)
    np.testing.assert_allclose(reading.values("/world/miss/raw", "PickError:xyz_mm"), 1e3 * (tool - fruit), atol=1e-3)
    np.testing.assert_allclose(reading.values("/target/raw", "Points3D:positions"), 1e3 * (tool - fruit), atol=1e-3)
    distance = 1e3 * np.linalg.norm(tool - fruit, axis=1)
    np.testing.assert_allclose(overlaid(reading, "/distance/1_raw", 3), np.log10(distance), rtol=1e-12)
    numbers = overlaid(reading, "/metrics/mm/1_raw", 3)
    np.testing.assert_array_equal(numbers, [info["position_error_mm"] for info in infos])
    degrees = overlaid(reading, "/metrics/deg/1_raw", 3).reshape(27, 3)
    names = reading.values("/metrics/deg/1_raw", "SeriesLines:names").tolist()
    for name, column in zip(names, degrees.T, strict=True):
        key = name.removeprefix("raw, ").replace(" ", "_")
        np.testing.assert_array_equal(column, [info[key] for info in infos])
    rewards = overlaid(reading, "/metrics/other/1_raw", 3)
    np.testing.assert_array_equal(rewards, [info.get("reward", 0.0) for info in infos])
    states = reading.values("/outcome/1_raw", "StateChange:state")
    assert states.tolist() == ["yes" if info["is_success"] else "no" for info in infos]
    nominal = forward(gym.make("pickenv/Reach-v0").unwrapped.plant.arm.nominal, q).position
    np.testing.assert_allclose(rod_ends(reading, "/world/arm/nominal/raw", 27), nominal, atol=2e-6)
    np.testing.assert_allclose(rod_ends(reading, "/world/arm/true/raw", 27), tool, atol=2e-6)
    assert reading.unmatched_rules() == []
    assert len(reading.rules()) >= 8


def overlaid(reading: Any, entity: str, episodes: int) -> np.ndarray:
    """An entity's numbers, episode by episode as they lie over one another."""
    return np.concatenate([reading.values(f"{entity}/{number}", "Scalars:scalars") for number in range(episodes)])


def rod_ends(reading: Any, entity: str, moments: int) -> np.ndarray:
    start, (x, y, z, w), length = (
        reading.values(entity, "Capsules3D:translations"),
        reading.values(entity, "Capsules3D:quaternions").T,
        reading.values(entity, "Capsules3D:lengths"),
    )
    direction = np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)], axis=-1)
    return (start + length[:, None] * direction).reshape(moments, -1, 3)[:, -1]


def test_logging_changes_nothing(tmp_path: Path) -> None:
    logged = run(reach(tmp_path), 2, 8)
    plain = run(gym.make("pickenv/Reach-v0", max_episode_steps=8, tolerance_mm=5.0), 2, 8)
    for ours, theirs in zip(chain(*logged), chain(*plain), strict=True):
        for key in theirs:
            np.testing.assert_array_equal(ours[key], theirs[key])


def test_the_wrapper_is_part_of_the_environments_specification(tmp_path: Path) -> None:
    env = reach(tmp_path, name_prefix="again")
    assert env.spec is not None
    run(gym.make(env.spec), 1, 8)
    assert (tmp_path / "again-raw.rrd").is_file()


def test_the_schedule_is_that_of_record_video(tmp_path: Path, reader: Callable[[Path], Any]) -> None:
    wanted = [k for k in range(3001) if (k < 1000 and round(k ** (1 / 3)) ** 3 == k) or (k >= 1000 and k % 1000 == 0)]
    assert [k for k in range(3001) if capped_cubic(k)] == wanted
    run(reach(tmp_path, steps=2, episode_trigger=None), 10, 2)
    reading = reader(tmp_path / "episodes-raw.rrd")
    assert reading.times("/outcome/1_raw", "episode").tolist() == [0] * 3 + [1] * 3 + [8] * 3


def test_a_step_trigger_records_a_length(tmp_path: Path, reader: Callable[[Path], Any]) -> None:
    env = reach(tmp_path, episode_trigger=None, step_trigger=lambda k: k in (2, 12), recording_length=4)
    episodes = run(env, 3, 8)
    infos = [info["position_error_mm"] for episode in episodes for info in episode]
    reading = reader(tmp_path / "episodes-raw.rrd")
    numbers = overlaid(reading, "/metrics/mm/1_raw", 2)
    np.testing.assert_array_equal(numbers, [infos[i] for i in (3, 4, 5, 6, 14, 15, 16, 17)])
    assert reading.times("/outcome/1_raw", "step").tolist() == list(range(8))


def test_nothing_recorded_writes_nothing(tmp_path: Path) -> None:
    run(reach(tmp_path, episode_trigger=lambda _: False), 2, 8)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("make", "missing"),
    [
        (lambda: gym.make("pickenv/Pick-v0", max_episode_steps=5), None),
        (HarvestEnv, "lacks 'tool_position' and 'fruit_position'"),
    ],
)
def test_other_environments_are_logged_as_far_as_info_allows_and_what_is_missing_is_said(
    make: Callable[[], gym.Env[Any, Any]], missing: str | None, tmp_path: Path, reader: Callable[[Path], Any]
) -> None:
    with nullcontext() if missing is None else pytest.warns(UserWarning, match=missing):
        infos = run(LogRerun(make(), tmp_path, episode_trigger=always), 1, 5)[0]
    reading = reader(tmp_path / "episodes-policy.rrd")
    assert reading.unmatched_rules() == []
    assert ("/world/arm/true/policy" in reading.entities()) == ("tool_position" in infos[0])
    names = reading.values("/metrics/other/4_policy", "SeriesLines:names").tolist()
    values = overlaid(reading, "/metrics/other/4_policy", 1).reshape(6, -1)
    collected = values[:, names.index("policy, collected")]
    np.testing.assert_array_equal(collected, [info["collected"] for info in infos])


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_chosen_environments_of_a_vector_are_logged_as_if_alone(
    mode: str, tmp_path: Path, reader: Callable[[Path], Any]
) -> None:
    envs = ReachVectorEnv(4, max_episode_steps=3, autoreset_mode=mode)
    logged = LogRerunVector(envs, tmp_path, always, indices=(1, 3), policy="raw")
    logged.reset(seed=5)
    logged.action_space.seed(1)
    actions = [logged.action_space.sample() for _ in range(9)]
    for action in actions:
        logged.step(action)
    logged.close()
    reading = reader(tmp_path / "episodes-raw.rrd")
    assert reading.unmatched_rules() == []
    for i in (1, 3):
        alone = ReachVectorEnv(1, max_episode_steps=3, autoreset_mode=mode)
        _, infos = alone.reset(seed=5 + i)
        wanted, episodes = [infos["position_error_mm"][0]], [0]
        for action in actions:
            _, _, _, over, infos = alone.step(action[i : i + 1])
            if mode == "SameStep" and over[0]:
                wanted.append(infos["final_info"]["position_error_mm"][0])
                episodes += [episodes[-1], episodes[-1] + 1]
            else:
                episodes.append(episodes[-1] + (mode == "NextStep" and len(wanted) % 4 == 0))
            wanted.append(infos["position_error_mm"][0])
        found = overlaid(reading, f"/metrics/mm/1_raw/env_{i}", 1 + episodes[-1])
        np.testing.assert_array_equal(found, wanted)
        assert reading.times(f"/outcome/1_raw/env_{i}", "episode").tolist() == episodes


def test_a_vector_of_single_environments_is_logged_too(tmp_path: Path, reader: Callable[[Path], Any]) -> None:
    envs = gym.make_vec("pickenv/Reach-v0", 2, "sync", max_episode_steps=3)
    logged = LogRerunVector(envs, tmp_path, always, indices=(1,))
    logged.reset(seed=5)
    wanted = []
    for _ in range(3):
        *_, infos = logged.step(logged.action_space.sample())
        wanted.append(infos["position_error_mm"][1])
    logged.close()
    reading = reader(tmp_path / "episodes-policy.rrd")
    np.testing.assert_array_equal(overlaid(reading, "/metrics/mm/4_policy/env_1", 1)[1:], wanted)


def test_files_of_several_policies_are_one_recording(tmp_path: Path, reader: Callable[[Path], Any]) -> None:
    for policy in ("raw", "ls"):
        run(reach(tmp_path, policy=policy), 1, 8)
    both = tmp_path / "both.rrd"
    files = [tmp_path / f"episodes-{policy}.rrd" for policy in ("raw", "ls")]
    subprocess.run([RERUN, "rrd", "merge", *files, "-o", both], check=True, capture_output=True)
    from rerun.chunk import RrdReader

    (entry,) = RrdReader(both).recordings()
    assert (entry.application_id, entry.recording_id) == ("pickenv", "Reach-v0:qiao2026:seed3")
    store = RrdReader(both).stream().collect()
    entities = {column.entity_path for column in store.schema().component_columns()}
    assert {"/world/miss/raw", "/world/miss/ls", "/metrics/mm/1_raw", "/metrics/mm/2_ls"} <= entities


def test_equal_seeds_give_equal_files_and_other_seeds_others(tmp_path: Path) -> None:
    paths = []
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        run(reach(tmp_path / name), 2, 8, seed)
        paths.append(tmp_path / name / "episodes-raw.rrd")

    def compare(first: Path, second: Path) -> int:
        return subprocess.run(
            [RERUN, "rrd", "compare", "--unordered", first, second], capture_output=True, check=False
        ).returncode

    assert (compare(paths[0], paths[1]), compare(paths[0], paths[2])) == (0, 1)


KILLED = """
import sys, time
import gymnasium as gym
import pickenv  # noqa: F401  (registers the environments)
from pickenv.inspect import LogRerun
env = LogRerun(gym.make("pickenv/Reach-v0", max_episode_steps=4), sys.argv[1], lambda _: True)
while True:
    env.reset(seed=0)
    for _ in range(4):
        env.step(env.action_space.sample())
"""


@pytest.mark.slow
def test_a_killed_writer_leaves_a_recording_that_reads(
    tmp_path: Path, reader: Callable[[Path], Any], awaited: Callable[..., list[Any]]
) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    process = subprocess.Popen([sys.executable, "-c", KILLED, str(tmp_path)], env=environment)
    path = tmp_path / "episodes-policy.rrd"
    awaited(path, lambda chunks: sum(c.num_rows for c in chunks if c.entity_path == "/outcome/4_policy") >= 5)
    process.send_signal(signal.SIGKILL)
    process.wait()
    times = reader(path).times("/outcome/4_policy", "step")
    assert len(times) >= 5
    np.testing.assert_array_equal(times, np.arange(len(times)))
    assert subprocess.run([RERUN, "rrd", "verify", path], capture_output=True, check=False).returncode == 0


FULL = """
import resource, sys
import gymnasium as gym
import pickenv  # noqa: F401  (registers the environments)
from pickenv.base import InputError
from pickenv.inspect import LogRerun
env = LogRerun(gym.make("pickenv/Reach-v0", max_episode_steps=4), sys.argv[1], lambda _: True)
resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
try:
    for _ in range(3):
        env.reset(seed=0)
        for _ in range(4):
            env.step(env.action_space.sample())
except InputError as error:
    sys.exit(f"error: {error}")
"""


def test_a_full_disk_is_one_sentence(tmp_path: Path) -> None:
    command = [sys.executable, "-c", FULL, str(tmp_path)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(command, env=environment, check=False, capture_output=True, text=True, timeout=600)
    assert done.stderr == f"error: cannot write {tmp_path / 'episodes-policy.rrd'}: File too large\n"
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(InputError, match=r"file/episodes-raw\.rrd"):
        run(reach(tmp_path / "file"), 1, 8)


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ({"policy": "LS/raw"}, "'LS/raw' cannot name an entity"),
        ({"recording_length": -1}, "recording_length is -1"),
        ({"save_path": None}, "nothing would be logged"),
    ],
)
def test_impossible_arguments_are_refused(arguments: dict[str, Any], complaint: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=complaint):
        LogRerun(gym.make("pickenv/Reach-v0"), **{"save_path": tmp_path, **arguments})


@pytest.mark.parametrize("indices", [(), (4,), (1, 1), (-1,)])
def test_impossible_indices_are_refused(indices: tuple[int, ...], tmp_path: Path) -> None:
    with pytest.raises(InputError, match="different numbers from 0 to 3"):
        LogRerunVector(ReachVectorEnv(4), tmp_path, indices=indices)


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def scalars(chunks: list[Any]) -> list[np.ndarray]:
    """The errors of one policy, chunk by chunk."""
    batches = [chunk.to_record_batch() for chunk in chunks if chunk.entity_path == "/metrics/mm/1_raw/0"]
    columns = [batch.column("Scalars:scalars") for batch in batches if "Scalars:scalars" in batch.schema.names]
    return [column.flatten().to_numpy() for column in columns]


def test_a_server_and_a_file_get_the_same(
    tmp_path: Path, reader: Callable[[Path], Any], awaited: Callable[..., list[Any]]
) -> None:
    """A second process reads what is served, through rerun's own program."""
    port = free_port()
    env = reach(tmp_path, serve=port)
    env.action_space.seed(3)
    env.reset(seed=3)
    for _ in range(8):
        env.step(env.action_space.sample())
    check_answers(f"rerun+http://127.0.0.1:{port}/proxy")
    copy = tmp_path / "copy.rrd"
    command = [RERUN, f"rerun+http://127.0.0.1:{port}/proxy", "--save", copy, "--port", str(free_port())]
    taker = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        (served,) = scalars(awaited(copy, lambda chunks: bool(scalars(chunks))))
    finally:
        os.killpg(taker.pid, signal.SIGTERM)
        taker.wait()
        env.close()
    written = reader(tmp_path / "episodes-raw.rrd").values("/metrics/mm/1_raw/0", "Scalars:scalars")
    np.testing.assert_array_equal(served, written)


def test_a_viewer_that_does_not_answer_is_named(tmp_path: Path) -> None:
    url = f"rerun+http://127.0.0.1:{free_port()}/proxy"
    with pytest.raises(InputError, match="no viewer answers at rerun"):
        run(reach(tmp_path, connect=url), 1, 8)
    with pytest.raises(InputError, match="it looks like rerun"):
        check_answers("http://somewhere")


def test_without_a_screen_no_viewer_is_started(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "platform", "linux")
    monkeypatch.setattr(viewing, "VIEWER_PORT", free_port())
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(InputError, match="no screen"):
        run(reach(tmp_path, spawn=True), 1, 8)


@pytest.mark.browser
def test_a_viewer_is_started_on_this_machine_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []

    def popen(*arguments: Any, **options: Any) -> Any:
        started.append(subprocess.Popen(*arguments, **options))
        return started[-1]

    display = f":{free_port()}"
    screen = subprocess.Popen(["Xvfb", display], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    monkeypatch.setenv("DISPLAY", display)
    monkeypatch.setattr(viewing, "VIEWER_PORT", free_port())
    monkeypatch.setattr(viewing, "subprocess", SimpleNamespace(Popen=popen, DEVNULL=subprocess.DEVNULL))
    try:
        run(reach(tmp_path, spawn=True), 2, 8)
        check_answers(f"rerun+http://127.0.0.1:{viewing.VIEWER_PORT}/proxy")
    finally:
        for viewer in started:
            os.killpg(viewer.pid, signal.SIGTERM)
            viewer.wait()
        screen.terminate()
        screen.wait()


def test_the_example_in_the_docstring_works(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    result = doctest.testmod(log_rerun)
    assert (result.failed, result.attempted >= 6) == (0, True)
    assert (tmp_path / "runs" / "recordings" / "episodes-random.rrd").is_file()


@pytest.mark.parametrize("viewer", [{"spawn": True}, {"connect": "x"}, {"serve": 1}])
def test_each_live_viewer_is_somebody_to_show_to(viewer: dict[str, Any]) -> None:
    """No file is asked for then; a viewer is looked for when the first episode has ended."""
    LogRerun(gym.make("pickenv/Reach-v0"), **viewer).close()
