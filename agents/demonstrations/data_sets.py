"""Minari data sets for learning without an environment, recorded with expert, medium and random policies.

Task "reach" is recorded on `pickenv/ReachScaled-v0`, because a network that reads a gap in metres hardly notices
millimetres. Task "pick" is recorded on `pickenv/Pick-v0`. Tasks "scene" and "sight" are recorded on
`pickenv/PickScene-v0`, "sight" with images.

Each data set is written to its folder completely or not at all. A card describes it and holds the hashes of its files.
Data sets that exist are kept, so that an interrupted run can continue.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import pickenv  # noqa: F401  (registers the environments)
from pickenv.agents.policies.learned import load_policy
from pickenv.agents.policies.policy import Policy
from pickenv.agents.policies.scripted import HASTY, RandomReach, ScriptedPick, ScriptedScene, ServoScene
from pickenv.arm import LINK_PARAMETERS
from pickenv.base import InputError, check_limit, file_sha256, locked, require, seed_words, stream, versions, write_json
from pickenv.base.files import Progress
from pickenv.envs import check_choice, check_count

SCENE = "pickenv/PickScene-v0"
TASKS = {"reach": "pickenv/ReachScaled-v0", "pick": "pickenv/Pick-v0", "scene": SCENE, "sight": SCENE}

QUALITIES = ("expert", "medium", "random")

EPISODES = {"reach": 256, "pick": 32, "scene": 64, "sight": 150}

POLICIES = {
    **{(task, "random"): "actions drawn evenly" for task in TASKS},
    ("reach", "expert"): "the shipped baseline ppo_encoders, without noise",
    ("reach", "medium"): "the shipped baseline ppo_encoders, every other action (by chance) drawn evenly instead",
    ("pick", "expert"): "ScriptedPick: gentle, waits until the arm has settled",
    ("pick", "medium"): "ScriptedPick with HASTY: full speed, no waiting",
    ("scene", "expert"): "ScriptedScene with a perfect arm",
    ("scene", "medium"): "ScriptedScene with an arm that errs",
    ("sight", "expert"): "ServoScene with a perfect arm; it sees the fruit exactly",
    ("sight", "medium"): "ServoScene with an arm that errs; it sees the fruit exactly",
}

SIGHT: Mapping[str, Any] = {
    "obs_type": "pixels_environment_state_agent_pos",
    "cameras": ["wrist"],
    "within_mm": 60.0,
    "feedback": "camera",
}
"""Arguments of the environment of task "sight". They add two things to the observations: images, and
in the state the gap that a camera measures."""

ARMS: Mapping[tuple[str, str], dict[str, Any]] = {
    ("scene", "expert"): {"plant": "ideal:so101"},
    ("scene", "medium"): {"plant": "coarse:so101", "error_mm": 5.0},
    ("scene", "random"): {"plant": "ideal:so101"},
    ("sight", "expert"): {"plant": "ideal:ur5e", **SIGHT},
    ("sight", "medium"): {"plant": "coarse:ur5e", "error_mm": 5.0, **SIGHT},
    ("sight", "random"): {"plant": "ideal:ur5e", **SIGHT},
}
"""Arguments of the environment for data sets that use another arm than the environment's default arm."""

COLUMNS = ("observations", "actions", "rewards", "terminations", "truncations")

LICENCE = "MIT"
CARD = "card.json"
FORMAT = 1
"""Version of the data sets' format; a data set of another version is refused."""


def datasets(
    out: str | Path = "runs/datasets",
    tasks: Sequence[str] = ("reach",),
    qualities: Sequence[str] = QUALITIES,
    *,
    episodes: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
) -> list[dict[str, Any]]:
    """Record Minari data sets.

    `minari.MinariDataset(FOLDER / "pickenv/reach/expert-v0/data")` reads one of them.

    Args:
        out: Folder of data sets; Minari finds them by name if MINARI_DATASETS_PATH is this folder.
        tasks: Any of "reach", "pick", "scene" and "sight".
        qualities: Any of "expert", "medium" and "random".
        episodes: Number of episodes in each data set; by default 256 reaches, 32 canopies, 64 scenes or 150 sights.
        seed: Seed of episodes and of random actions. Different seeds, tasks or qualities share no random numbers.
        progress: Called with (name, episodes done, total).

    Returns:
        One card per data set. It holds name, environment, policy, seeds, steps, mean return and error, licence and
        versions. It also holds the link parameters of the believed and the true arm, and the SHA-256 of the files.

    Raises:
        InputError: If a task or quality is unknown, or an existing data set was changed or made with other settings.
            Also if another process is at work in the folder.
        MissingExtra: If Minari is not installed.
    """
    for name in tasks:
        check_choice("task", name, tuple(TASKS))
    for name in qualities:
        check_choice("quality", name, QUALITIES)
    check_limit("seed", seed, "seed")
    if episodes is not None:
        check_count("episodes", episodes)
        check_limit("episodes", episodes, "episodes")
    require("minari", "h5py")
    out, report = Path(out), progress or (lambda name, done, total: None)
    with locked(out):
        return [_kept_or_made(out, task, quality, episodes, seed, report) for task in tasks for quality in qualities]


def _kept_or_made(
    out: Path, task: str, quality: str, episodes: int | None, seed: int, report: Progress
) -> dict[str, Any]:
    count, name = episodes or EPISODES[task], f"pickenv/{task}/{quality}-v0"
    settings = {"name": name, "format": FORMAT, "seed": seed, "episodes": count}
    folder = out / name
    if folder.exists():
        report(name, count, count)
        return _kept(folder, settings)
    parts = stream(seed, "datasets", list(TASKS).index(task), QUALITIES.index(quality)).spawn(2)
    seeds, rng = seed_words(parts[0], count), np.random.default_rng(parts[1])
    rows: list[dict[str, Any]] = []
    for episode in _reaches(quality, seeds, rng) if task == "reach" else _episodes(task, quality, seeds, rng):
        rows.append(episode)
        report(name, len(rows), count)
    card = settings | {
        "environment": TASKS[task],
        "arguments": ARMS.get((task, quality), {}),
        "policy": POLICIES[task, quality],
        "seeds": seeds,
        "steps": sum(len(row["rewards"]) for row in rows),
        "mean_return": float(np.mean([row["rewards"].sum() for row in rows])),
        **{key: float(np.mean([row["said"][key] for row in rows])) for key in rows[0]["said"]},
        "licence": LICENCE,
        "simulated": True,
        "versions": versions("gymnasium", "minari"),
    }
    return _write(folder, name, rows, card)


def _reaches(quality: str, seeds: Sequence[int], rng: np.random.Generator) -> Iterator[dict[str, Any]]:
    """Run one reach per seed, all in one vector environment, then yield the columns (arrays by name) of each episode.

    Args:
        quality: Name for the share of the actions that is random: none ("expert"), half ("medium") or all ("random").
        seeds: Seeds of the episodes.
        rng: Random generator of the random actions.
    """
    envs: Any = gym.make_vec(TASKS["reach"], num_envs=len(seeds), autoreset_mode="Disabled", executor="numpy")
    policy = load_policy("ppo_encoders", envs.unwrapped.task.plant.arm)
    observations, _ = envs.reset(seed=list(seeds))
    rows: dict[str, list[Any]] = {"observations": [observations]} | {name: [] for name in COLUMNS[1:]}
    for _ in range(envs.unwrapped.max_episode_steps):
        noise = rng.uniform(-1.0, 1.0, envs.action_space.shape).astype(np.float32)
        learnt = policy.act(envs.raw) / envs.scaling.share(envs.raw, np)
        random = rng.random(len(seeds)) < {"expert": 0.0, "medium": 0.5, "random": 1.0}[quality]
        action = np.clip(np.where(random[:, None], noise, learnt), -1.0, 1.0).astype(np.float32)
        observations, reward, terminated, truncated, infos = envs.step(action)
        for name, values in zip(COLUMNS, (observations, action, reward, terminated, truncated), strict=True):
            rows[name].append(np.array(values))
    columns = {name: np.stack(values, axis=1) for name, values in rows.items()}
    for i, seed in enumerate(seeds):
        result = {"final_error_mm": infos["position_error_mm"][i], "success": infos["is_success"][i]}
        yield {"seed": seed, "said": result} | {name: column[i] for name, column in columns.items()}


def _episodes(task: str, quality: str, seeds: Sequence[int], rng: np.random.Generator) -> Iterator[dict[str, Any]]:
    """Record one canopy or scene per seed, and yield the columns (arrays by name) of each episode.

    Args:
        task: "pick", "scene" or "sight".
        quality: "random" for random actions; "expert" or "medium" for the policies that `POLICIES` describes.
        seeds: Seeds of the episodes.
        rng: Random generator of the random actions.
    """
    env = gym.make(TASKS[task], **ARMS.get((task, quality), {}))
    if quality == "random":
        policy: Any = RandomReach(env, rng)
    elif task == "pick":
        policy = ScriptedPick(env, **(HASTY if quality == "medium" else {}))
    else:
        policy = {"scene": ScriptedScene, "sight": ServoScene}[task](env)
    key, name = ("collected", "collected") if task == "pick" else ("success", "is_success")
    for seed in seeds:
        row, info = recorded_episode(env, policy, seed)
        yield {"seed": seed, "said": {key: info[name]}} | row


def recorded_episode(env: Any, policy: Policy, seed: int) -> tuple[dict[str, Any], dict[str, Any]]:
    """Run one episode of a policy, and return its recorded columns and the last `info`.

    Args:
        env: Environment whose episodes end, for instance by a time limit.
        policy: Policy to run; its actions are clipped to -1 to 1.
        seed: Seed of the episode.

    Returns:
        The columns by name, and the last `info`. "observations" has one entry more than "actions", "rewards",
        "terminations" and "truncations". Observations that are dictionaries become a dictionary of arrays.
    """
    observation, info = env.reset(seed=seed)
    policy.reset()
    rows: dict[str, list[Any]] = {"observations": [observation]} | {name: [] for name in COLUMNS[1:]}
    ended = False
    while not ended:
        action = np.clip(policy.act(observation), -1.0, 1.0).astype(np.float32)
        observation, reward, terminated, truncated, info = env.step(action)
        for name, value in zip(COLUMNS, (observation, action, reward, terminated, truncated), strict=True):
            rows[name].append(value)
        ended = terminated or truncated
    return {name: _stacked(column) for name, column in rows.items()}, info


def arms_of(env: Any) -> dict[str, dict[str, list[float]]]:
    """Return the link parameters of an environment's nominal arm ("believed") and true arm ("true"), m and rad.

    `datasets` writes them into the card of a data set.
    """
    plant = env.unwrapped.plant
    arms = {"believed": plant.arm.nominal, "true": plant.geometry}
    return {name: {key: getattr(arm, key).tolist() for key in LINK_PARAMETERS} for name, arm in arms.items()}


def _stacked(values: Sequence[Any]) -> Any:
    """Stack the values of successive steps into one array, or dictionaries of values into a dictionary of arrays."""
    if isinstance(values[0], Mapping):
        return {name: _stacked([value[name] for value in values]) for name in values[0]}
    return np.array(values)


def _numbers(column: Any) -> bytes:
    """Return the bytes of all numbers of a column, which may be an array or a dictionary of columns."""
    return b"".join(map(_numbers, column.values())) if isinstance(column, Mapping) else column.tobytes()


def _write(folder: Path, name: str, episodes: Sequence[dict[str, Any]], card: dict[str, Any]) -> dict[str, Any]:
    """Write a data set and its card, and move them into ``folder`` once both are complete; return the final card.

    Args:
        folder: Folder of the data set.
        name: Minari's name of the data set.
        episodes: Columns of each episode.
        card: Entries of the card so far.
    """
    from unittest.mock import patch  # late: it brings asyncio

    import minari
    from minari.data_collector import EpisodeBuffer

    out = folder.parents[2].resolve()  # Minari loses its way on relative paths
    env = gym.make(card["environment"], **card["arguments"])
    with tempfile.TemporaryDirectory(prefix=".unfinished-", dir=out, ignore_cleanup_errors=True) as temporary:
        recorded = ({key: value for key, value in episode.items() if key != "said"} for episode in episodes)
        buffers = [EpisodeBuffer(id=i, **columns) for i, columns in enumerate(recorded)]
        with patch.dict(os.environ, MINARI_DATASETS_PATH=temporary), warnings.catch_warnings():
            warnings.filterwarnings("ignore", message=".*is set to None.*")  # addresses of people
            minari.create_dataset_from_buffers(
                name,
                buffers,
                env=env,
                algorithm_name=card["policy"],
                author="pickenv",
                description=f"{card['policy']}; simulated; seed {card['seed']}; licence {LICENCE}",
                requirements=[f"pickenv=={card['versions']['pickenv']}"],
            )
        complete = Path(temporary) / name
        # Over the numbers of all episodes, which a run with the same seed gives again.
        content = b"".join(_numbers(episode[name]) for episode in episodes for name in COLUMNS)
        digest = hashlib.sha256(content).hexdigest()
        card |= {"arms": arms_of(env), "sha256": _hashes(complete), "content_sha256": digest}
        write_json(complete / CARD, card)
        for inner in (folder.parent, folder.parent.parent):  # Minari finds what stands in a folder that says it is one
            inner.mkdir(parents=True, exist_ok=True)
            if not (inner / "namespace_metadata.json").exists():
                write_json(inner / "namespace_metadata.json", {})
        shutil.move(complete, folder)
    return card


def _hashes(folder: Path) -> dict[str, str]:
    paths = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != CARD)
    return {path.relative_to(folder).as_posix(): file_sha256(path) for path in paths}


def _kept(folder: Path, asked: dict[str, Any]) -> dict[str, Any]:
    """Return the card of the data set in a folder, after a check of its files and of its settings against ``asked``.

    Raises:
        InputError: If the data set has no card, its settings differ from ``asked``, or its files were changed.
    """
    otherwise = f"{folder} %s; take it away to have it made anew, or give another `out`"
    try:
        card: dict[str, Any] = json.loads((folder / CARD).read_text(encoding="utf-8"))
        changed = card["sha256"] != _hashes(folder)
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(otherwise % "has no card of a data set") from error
    if changed:
        raise InputError(otherwise % "was changed since it was written")
    if differing := [f"{key} {card.get(key)}, not {value}" for key, value in asked.items() if card.get(key) != value]:
        raise InputError(otherwise % f"was made with {' and '.join(differing)}")
    return card
