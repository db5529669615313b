"""Speed of the environments, with peers in the same run: step, step + inference and step + training apart.

Fair reading: pickenv's step is kinematics with the plant's physics (compliance, bending, drives), no contacts and no
collisions; FetchReach runs 20 MuJoCo substeps a step and PandaReach 20 Bullet substeps. Random fresh actions, resets,
rewards and observations are included everywhere. What runs on one core is timed by the processor's clock. What a
calibration between policy and arm costs, and what single precision does to positions, is measured too.

Run: python scripts/benchmark_envs.py [--json FILE] [--no-peers] [--quick] [--device cuda]
"""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import numpy as np
import typer
from measuring import EnvironmentPeers, JsonFile, NoPeers, fastest, figure, python_with, rate
from peers.run_envs import stepper

import pickenv  # noqa: F401
from pickenv.arm import load_plant
from pickenv.base import InputError, write_json
from pickenv.calibration import Compensator, fit, random_joints, simulated_tracker
from pickenv.commands.showing import print_table

ROLLOUT = 8192
"""Environment steps between two updates in the comparison of trainings, whatever the number of environments."""

TRAINED = (16, 64, 256)
"""Numbers of environments in that comparison."""

REACH = "pickenv/Reach-v0"
EXECUTORS = ("numpy", "compiled")
"""Of native vectors on NumPy's arrays: with every operation a call of NumPy, and as machine code."""

PEER_PACKAGES = ("gymnasium-robotics==1.4.2", "mujoco<3.12", "panda-gym==3.0.7")
PLANT, PICKED = "plant qiao2026", "plant orchard, ten fruit"
SINGLE = {"Reach": PLANT, "Harvest": "three slaves, eight fruit", "Pick": PICKED}
"""Environments that are stepped alone, and what they hold."""
SEES = {"obs_type": "pixels_agent_pos", "pixels": 64}
SCENES: dict[str, tuple[dict[str, Any], str]] = {
    "PickScene states": ({"plant": "coarse:ur5e"}, "10 MuJoCo substeps, contacts"),
    "PickScene states, all effects": ({"plant": "orchard"}, "10 MuJoCo substeps, contacts, plant orchard"),
    "PickScene pictures": ({"plant": "coarse:ur5e", "cameras": ["wrist"], **SEES}, "one of 64 px in each step"),
}
"""Scenes in contact that are stepped alone: their arguments, and what they hold."""
WHAT = {
    "FetchReach-v4": "20 MuJoCo substeps, contacts",
    "FetchPickAndPlace-v4": "20 MuJoCo substeps, contacts",
    "PandaReach-v3": "20 Bullet substeps, contacts",
}
RATIOS = {
    "single_vs_fetchreach": ("Reach single", "FetchReach-v4"),
    "harvest_single_vs_fetchreach": ("Harvest single", "FetchReach-v4"),
    "pick_single_vs_fetchreach": ("Pick single", "FetchReach-v4"),
    "pick_native_256_vs_fetchreach": ("Pick native 256", "FetchReach-v4"),
    "scene_states_vs_fetchpickandplace": ("PickScene states", "FetchPickAndPlace-v4"),
    "single_vs_pandareach": ("Reach single", "PandaReach-v3"),
    **{f"native_{count}_vs_fetchreach": (f"Reach native {count}", "FetchReach-v4") for count in (16, 256, 4096)},
    "native_4096_vs_cartpole": ("Reach native 4096", "CartPole-v1 native 4096"),
    **{f"ppo_adapter_vs_dummy_{n}": (f"PPO native adapter {n}", f"PPO DummyVecEnv {n}") for n in TRAINED},
}
"""Of which environments' steps per second."""


def vector(
    name: str, count: int, seconds: float, policy: Callable[[Any], Any] | None = None, **arguments: Any
) -> float:
    """A native vector environment; ``policy`` maps observations to actions, else actions are fresh random numbers."""
    envs = gym.make_vec(name, num_envs=count, **arguments)
    observations, _ = envs.reset(seed=0)
    rng = np.random.default_rng(0)
    discrete = not hasattr(envs.single_action_space, "high")
    state = {"observations": observations}

    def step() -> int:
        if policy is not None:
            actions = policy(state["observations"])
        elif discrete:
            actions = rng.integers(0, 2, count)
        else:
            actions = rng.uniform(-1, 1, (count, envs.single_action_space.shape[0])).astype(np.float32)
        state["observations"] = envs.step(actions)[0]
        return count

    return rate(step, seconds)


def on_torch(count: int, device: str, dtype: str, compiled: bool, **more: Any) -> Any:
    """Environments of the torch executor."""
    place: dict[str, Any] = {"executor": "torch", "device": device, "dtype": dtype}
    return gym.make_vec(REACH, num_envs=count, compiled=compiled, **place, **more)


def torch_vector(count: int, seconds: float, device: str, dtype: str, compiled: bool) -> float:
    """The torch executor: actions drawn on the device, the step compiled or eager."""
    import torch

    envs = on_torch(count, device, dtype, compiled, pose_infos=False)
    envs.reset(seed=0)
    generator = torch.Generator(device=device).manual_seed(0)

    def step() -> int:
        envs.step(torch.rand((count, 6), generator=generator, device=device) * 2 - 1)
        if device != "cpu":
            torch.cuda.synchronize()
        return count

    return rate(step, seconds, clock=time.perf_counter)


def inference(count: int, seconds: float) -> float:
    """Native NumPy environments with a 64-64 network choosing the actions."""
    import torch

    torch.set_num_threads(1)
    linear, tanh = torch.nn.Linear, torch.nn.Tanh()
    network = torch.nn.Sequential(linear(18, 64), tanh, linear(64, 64), tanh, linear(64, 6))

    def policy(observations: Any) -> Any:
        with torch.no_grad():
            return network(torch.as_tensor(observations)).clamp(-1, 1).numpy()

    return vector(REACH, count, seconds, policy)


def compensators() -> dict[str, Compensator | None]:
    """None, and the paper's two calibrations of the arm: 100 poses for geometry, 200 more for the network."""
    plant, rng = load_plant("qiao2026"), np.random.default_rng(0)
    first, second = (simulated_tracker(plant, random_joints(plant.arm.nominal, n, rng), rng) for n in (100, 200))
    calibration = fit(plant.arm, first, second, known_frames=True, rng=rng).calibration
    return {
        "none": None,
        "LS": calibration.compensator(with_residual=False),
        "LS+BPNN": calibration.compensator(),
        "LS+BPNN, one iteration in single precision": calibration.compensator(iterations=1, single_precision=True),
    }


def compensation(count: int, seconds: float) -> dict[str, dict[str, float]]:
    """What a calibration adds to a single step, us, and to a step of a vector environment.

    `vector_ratio` is by how much a step on NumPy takes longer, `compiled_ratio` a compiled one, and
    `compiled_steps_per_s` how many environment steps a second are left of it.
    """
    rng = np.random.default_rng(0)
    single, many = {}, {}
    for name, compensator in compensators().items():
        env: Any = gym.make(REACH, max_episode_steps=-1).unwrapped
        action, actions = (rng.uniform(-1, 1, size).astype(np.float32) for size in (6, (count, 6)))
        vectors: Any = [gym.make_vec(REACH, count, max_episode_steps=None, executor=name) for name in EXECUTORS]
        for each in (env, *(envs.unwrapped for envs in vectors)):
            each.compensator = compensator
            each.reset(seed=0)
            each.step(action if each is env else actions)  # what is compiled is compiled
        single[name] = lambda env=env, action=action: [env.step(action) for _ in range(20)]
        for executor, envs in zip(EXECUTORS, vectors, strict=True):
            many[f"{name} {executor}"] = lambda envs=envs.unwrapped, actions=actions: envs.step(actions)
    alone, all_ = (fastest(steps, seconds, time.process_time) for steps in (single, many))
    return {
        name: {
            "single_us": 1e6 * (alone[name] - alone["none"]) / 20,
            "vector_ratio": all_[f"{name} numpy"] / all_["none numpy"],
            "compiled_ratio": all_[f"{name} compiled"] / all_["none compiled"],
            "compiled_steps_per_s": count / all_[f"{name} compiled"],
        }
        for name in alone
        if name != "none"
    }


def single_precision_um(device: str, count: int = 100_000) -> float:
    """Largest distance, um, between the tools of float32 on a device and of float64 on NumPy after ten steps."""
    import torch

    double, single = gym.make_vec(REACH, num_envs=count), on_torch(count, device, "float32", False)
    rng = np.random.default_rng(0)
    for envs in (double, single):
        envs.reset(seed=0)
    for _ in range(10):
        actions = rng.uniform(-1, 1, (count, 6)).astype(np.float32)
        expected = double.step(actions)[4]["tool_position"]
        found = single.step(torch.as_tensor(actions, device=device))[4]["tool_position"]
    return float(1e6 * np.linalg.norm(found.double().cpu().numpy() - expected, axis=1).max())


def training(count: int, seconds: float) -> tuple[float, float]:
    """Steps per second of SB3's PPO through the native adapter and through DummyVecEnv.

    Both learn from rollouts of 8192 steps, four epochs in batches of 512, and take turns.
    """
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env

    from pickenv.wrappers import make_sb3_vec

    torch.set_num_threads(1)
    models = {}
    for name, make in (("native", make_sb3_vec), ("dummy", make_vec_env)):
        settings: dict[str, Any] = {"n_steps": ROLLOUT // count, "batch_size": 512, "n_epochs": 4}
        models[name] = PPO("MlpPolicy", make(REACH, count), seed=0, device="cpu", **settings)
        models[name].learn(ROLLOUT)
    steps = {name: lambda model=model: model.learn(ROLLOUT) for name, model in models.items()}
    best = fastest(steps, 2 * seconds)
    return ROLLOUT / best["native"], ROLLOUT / best["dummy"]


def peers(folder: Path, seconds: float, *words: str) -> dict[str, dict[str, Any]]:
    """FetchReach and PandaReach in an environment of packages of their own, made on demand; words go to `run_envs`."""
    try:
        worker = Path(__file__).parent / "peers" / "run_envs.py"
        command = [python_with(folder, *PEER_PACKAGES), worker, str(seconds), *words]
        ended = subprocess.run(command, check=True, capture_output=True, text=True, timeout=600)
        return dict(json.loads(ended.stdout.strip().splitlines()[-1]))
    except (subprocess.SubprocessError, OSError, InputError) as error:
        note = f"cannot be run: {error}"
        return {name: {"steps_per_s": None, "frames_per_s": None, "note": note} for name in WHAT}


def main(
    json_file: JsonFile = None,
    no_peers: NoPeers = False,
    quick: Annotated[bool, typer.Option("--quick", help="Short rounds, small sizes, nothing compiled.")] = False,
    device: Annotated[str, typer.Option(help="Where torch runs: cpu, or cuda for a graphics processor.")] = "cpu",
    folder: EnvironmentPeers = Path("runs/peers/envs"),
) -> None:
    """Measure and print."""
    seconds = 1.0 if quick else 4.0
    envs: dict[str, dict[str, Any]] = {}

    def add(name: str, num_envs: int, backend: str, value: float | None, note: str = "") -> None:
        envs[name] = {"num_envs": num_envs, "steps_per_s": value, "backend": backend, "note": note}
        print(f"{name}: {'-' if value is None else f'{value:,.0f} steps/s'} {note}", file=sys.stderr)

    try:
        apart = single_precision_um(device, 10_000 if quick else 100_000)
    except InputError as error:
        raise typer.BadParameter(str(error), param_hint="--device") from error
    if not no_peers:
        for name, found in peers(folder, seconds).items():
            add(name, 1, "engine", found["steps_per_s"], found["note"] or WHAT[name])
        add("CartPole-v1 native 4096", 4096, "numpy", vector("CartPole-v1", 4096, seconds), "4 numbers, no arm")
    for name, what in SINGLE.items():
        add(f"{name} single", 1, "auto", rate(stepper(gym.make(f"pickenv/{name}-v0")), seconds), f"{what}, gym.make")
    for name, (arguments, what) in SCENES.items():
        add(name, 1, "mujoco", rate(stepper(gym.make("pickenv/PickScene-v0", **arguments)), seconds), what)
    for count in (1, 16, 256, 1024):
        add(f"Pick native {count}", count, "numpy", vector("pickenv/Pick-v0", count, seconds), PICKED)
    for count in (16, 64, 256, 4096) if quick else (16, 64, 256, 1024, 4096, 65_536, 1_048_576):
        for executor in EXECUTORS:
            value = vector(REACH, count, seconds, executor=executor)
            name = f"Reach native {count}" + (", NumPy alone" if executor == "numpy" else "")
            add(name, count, executor, value, PLANT)
    for count in () if quick else (131_072,) if device == "cpu" else (131_072, 4_194_304):
        value = torch_vector(count, seconds, device, "float32", True)
        add(f"Reach torch.compile {count}", count, f"torch {device} float32 compiled", value, PLANT)
    value = torch_vector(4096, seconds, device, "float64", False)
    add("Reach torch eager 4096", 4096, f"torch {device} float64", value)
    add("Reach native 4096 + inference", 4096, "numpy + torch", inference(4096, seconds), "64-64 network")
    for count in TRAINED:
        for name, value in zip(("native adapter", "DummyVecEnv"), training(count, seconds), strict=True):
            add(f"PPO {name} {count}", count, "sb3", value, "step + training")
    added = compensation(4096, seconds)

    ratios: dict[str, float | None] = {}
    for name, pair in RATIOS.items():
        ours, theirs = (envs.get(member, {}).get("steps_per_s") for member in pair)
        ratios[name] = None if ours is None or theirs is None else ours / theirs
    rows = [
        (name, f"{row['num_envs']:,}", row["backend"], figure(row["steps_per_s"], ",.0f"), row["note"])
        for name, row in envs.items()
    ]
    print_table(
        f"Environment steps per second on {os.cpu_count()} cores (torch on {device})",
        ("environment", "environments", "backend", "steps/s", "note"),
        rows,
        words=("environment", "backend", "note"),
    )
    for name, value in ratios.items():
        if value is not None:
            print(f"{name}: {value:.1f}")
    for name, cost in added.items():
        print(
            f"{name} in between: {cost['single_us']:.0f} us more per single step, a step of 4096 takes "
            f"{cost['vector_ratio']:.1f} times as long on NumPy, {cost['compiled_ratio']:.1f} times compiled, which is "
            f"{cost['compiled_steps_per_s']:,.0f} steps/s"
        )
    print(f"float32 on {device} against float64: the tools are at most {apart:.2f} um apart")
    if json_file is not None:
        result = {"envs": envs, "ratios": ratios, "compensation": added, "float32_um": apart}
        print(f"wrote {write_json(json_file, result | {'device': device, 'cores': os.cpu_count()})}")


if __name__ == "__main__":
    typer.run(main)
