"""Speed of the environments, with peers in the same run: step, step + inference and step + training apart.

Fair reading: pickenv's step is kinematics with the plant's physics (compliance, bending, drives), no contacts and no
collisions; FetchReach runs 20 MuJoCo substeps a step and PandaReach 20 Bullet substeps. Random fresh actions, resets,
rewards and observations are included everywhere.

Run: python scripts/benchmark_envs.py [--json FILE] [--no-peers] [--quick]
"""

from __future__ import annotations

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
from rich.console import Console
from rich.table import Table

import pickenv  # noqa: F401
from pickenv.files import write_text

PEER_PACKAGES = ("gymnasium-robotics==1.4.2", "mujoco<3.12", "panda-gym==3.0.7")
WHAT = {
    "FetchReach-v4": "20 MuJoCo substeps, contacts",
    "PandaReach-v3": "20 Bullet substeps, contacts",
    "CartPole-v1 native": "4 numbers, no arm",
}


def rate(step: Callable[[], int], seconds: float, rounds: int = 3) -> float:
    """Best of some rounds of environment steps per second: other work on the machine only ever slows a round."""
    step()
    best = 0.0
    for _ in range(rounds):
        steps, begin = 0, time.perf_counter()
        while time.perf_counter() - begin < seconds / rounds:
            steps += step()
        best = max(best, steps / (time.perf_counter() - begin))
    return best


def single(name: str, seconds: float, **arguments: Any) -> float:
    """A single environment with Gymnasium's standard wrappers."""
    env = gym.make(name, **arguments)
    env.reset(seed=0)
    env.action_space.seed(0)

    def step() -> int:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
        return 1

    return rate(step, seconds)


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


def torch_vector(count: int, seconds: float, device: str, dtype: str, compiled: bool) -> float:
    """The torch executor: actions drawn on the device, the step compiled or eager."""
    import torch

    envs = gym.make_vec(
        "pickenv/Reach-v0",
        num_envs=count,
        executor="torch",
        device=device,
        dtype=dtype,
        compiled=compiled,
        pose_infos=False,
    )
    envs.reset(seed=0)
    generator = torch.Generator(device=device).manual_seed(0)

    def step() -> int:
        envs.step(torch.rand((count, 6), generator=generator, device=device) * 2 - 1)
        if device == "cuda":
            torch.cuda.synchronize()
        return count

    step()
    return rate(step, seconds)


def inference(count: int, seconds: float) -> float:
    """Native NumPy environments with a 64-64 network choosing the actions."""
    import torch

    torch.set_num_threads(1)
    network = torch.nn.Sequential(
        torch.nn.Linear(18, 64), torch.nn.Tanh(), torch.nn.Linear(64, 64), torch.nn.Tanh(), torch.nn.Linear(64, 6)
    )

    def policy(observations: Any) -> Any:
        with torch.no_grad():
            return network(torch.as_tensor(observations)).clamp(-1, 1).numpy()

    return vector("pickenv/Reach-v0", count, seconds, policy)


def training(count: int, native: bool, steps: int) -> float:
    """Steps per second of SB3's PPO, through the native adapter or through DummyVecEnv."""
    import torch
    from stable_baselines3 import PPO
    from stable_baselines3.common.env_util import make_vec_env

    from pickenv.wrappers.sb3 import make_sb3_vec

    torch.set_num_threads(1)
    envs = make_sb3_vec("pickenv/Reach-v0", count) if native else make_vec_env("pickenv/Reach-v0", count)
    model = PPO("MlpPolicy", envs, n_steps=max(steps // count // 4, 8), batch_size=512, n_epochs=4, seed=0)
    model.learn(count * 8)
    begin = time.perf_counter()
    model.learn(steps)
    return model.num_timesteps / (time.perf_counter() - begin)


def peers(folder: Path, seconds: float) -> dict[str, dict[str, Any]]:
    """FetchReach and PandaReach in an environment of packages of their own, made on demand."""
    python, done = folder / "bin" / "python", folder / "installed"
    try:
        if not done.exists():
            subprocess.run([sys.executable, "-m", "venv", "--clear", folder], check=True, capture_output=True)
            install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *PEER_PACKAGES]
            subprocess.run(install, check=True, capture_output=True)
            done.touch()
        worker = Path(__file__).parent / "peers" / "run_envs.py"
        ended = subprocess.run([python, worker, str(seconds)], check=True, capture_output=True, text=True, timeout=600)
        return dict(json.loads(ended.stdout.strip().splitlines()[-1]))
    except (subprocess.SubprocessError, OSError) as error:
        return {
            name: {"steps_per_s": None, "note": f"cannot be run: {error}"}
            for name in ("FetchReach-v4", "PandaReach-v3")
        }


def main(
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
    no_peers: Annotated[bool, typer.Option("--no-peers", help="Leave the peers out.")] = False,
    quick: Annotated[bool, typer.Option("--quick", help="Short rounds, small sizes, nothing compiled.")] = False,
    folder: Annotated[Path, typer.Option(help="Where the peers' packages are installed.")] = Path("runs/peers/envs"),
) -> None:
    """Measure and print."""
    seconds = 1.0 if quick else 4.0
    envs: dict[str, dict[str, Any]] = {}

    def add(name: str, num_envs: int, backend: str, value: float | None, note: str = "") -> None:
        envs[name] = {"num_envs": num_envs, "steps_per_s": value, "backend": backend, "note": note}
        print(f"{name}: {'-' if value is None else f'{value:,.0f} steps/s'} {note}", file=sys.stderr)

    if not no_peers:
        for name, found in peers(folder, seconds).items():
            add(name, 1, "engine", found["steps_per_s"], found["note"] or WHAT[name])
        add("CartPole-v1 native 4096", 4096, "numpy", vector("CartPole-v1", 4096, seconds), WHAT["CartPole-v1 native"])
    add("Reach single", 1, "floats", single("pickenv/Reach-v0", seconds), "plant qiao2026, gym.make")
    for count in (1024, 4096) if quick else (1024, 4096, 65_536, 1_048_576):
        add(f"Reach native {count}", count, "numpy", vector("pickenv/Reach-v0", count, seconds), "plant qiao2026")
    if not quick:
        value = torch_vector(131_072, seconds, "cpu", "float32", True)
        add("Reach torch.compile 131072", 131_072, "torch cpu float32 compiled", value, "plant qiao2026")
    add("Reach torch eager 4096", 4096, "torch cpu float64", torch_vector(4096, seconds, "cpu", "float64", False))
    add("Reach native 4096 + inference", 4096, "numpy + torch", inference(4096, seconds), "64-64 network")
    steps = 8_192 if quick else 65_536
    add("PPO native adapter 64", 64, "sb3", training(64, True, steps), "step + training")
    add("PPO DummyVecEnv 64", 64, "sb3", training(64, False, steps // 4), "step + training")
    import torch

    if torch.cuda.is_available():
        for count in (131_072, 4_194_304):
            value = torch_vector(count, seconds, "cuda", "float32", True)
            add(f"Reach torch.compile cuda {count}", count, "torch cuda float32 compiled", value)
    gpu = "measured" if torch.cuda.is_available() else "no CUDA device here: not measured"

    def ratio(one: str, other: str) -> float | None:
        a, b = envs.get(one, {}).get("steps_per_s"), envs.get(other, {}).get("steps_per_s")
        return None if a is None or b is None else a / b

    ratios = {
        "single_vs_fetchreach": ratio("Reach single", "FetchReach-v4"),
        "single_vs_pandareach": ratio("Reach single", "PandaReach-v3"),
        "native_4096_vs_fetchreach": ratio("Reach native 4096", "FetchReach-v4"),
        "native_4096_vs_cartpole": ratio("Reach native 4096", "CartPole-v1 native 4096"),
        "ppo_adapter_vs_dummy": ratio("PPO native adapter 64", "PPO DummyVecEnv 64"),
    }
    table = Table(title=f"Environment steps per second on {os.cpu_count()} cores (GPU: {gpu})")
    for head in ("environment", "environments", "backend", "steps/s", "note"):
        table.add_column(head, justify="right" if head in ("environments", "steps/s") else "left")
    for name, row in envs.items():
        value = row["steps_per_s"]
        table.add_row(
            name, f"{row['num_envs']:,}", row["backend"], "-" if value is None else f"{value:,.0f}", row["note"]
        )
    console = Console(width=150)
    console.print(table)
    for name, value in ratios.items():
        if value is not None:
            console.print(f"{name}: {value:.1f}")
    if json_file is not None:
        text = json.dumps({"envs": envs, "ratios": ratios, "gpu": gpu, "cores": os.cpu_count()}, indent=2)
        console.print(f"wrote {write_text(json_file, text + chr(10))}")


if __name__ == "__main__":
    typer.run(main)
