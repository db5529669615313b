"""Frames per second of render() at 480 x 360 px for every environment, with MuJoCo and without, beside FetchReach's.

Per second of processor time, which other work on the machine hardly changes, and per second. Only render() is timed:
the arm moves by a random action between two frames. A peer draws with MuJoCo or Bullet, headless.

Run: python scripts/benchmark_pictures.py [--json FILE] [--no-peers] [--seconds 4]
"""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import gymnasium as gym
import typer
from benchmark_envs import peers
from measuring import EnvironmentPeers, JsonFile, NoPeers, figure, in_fresh_process
from peers.run_envs import drawn_per_second

import pickenv  # noqa: F401  (registers the environments)
from pickenv.base import write_json
from pickenv.commands.showing import print_table
from pickenv.pictures.drawers import PLAIN, drawer_name


def measured(seconds: float) -> dict[str, Any]:
    """All environments with the drawer that this process takes."""
    names = sorted(name for name in gym.registry if name.startswith("pickenv/"))
    rates = {name: drawn_per_second(gym.make(name, render_mode="rgb_array"), seconds) for name in names}
    return {"drawer": drawer_name(), "rates": rates}


def said(rates: Sequence[float] | None) -> list[str]:
    """Frames per second of processor time, and per second, as they are printed."""
    return [figure(rate, ".0f") for rate in rates or (None, None)]


def main(
    json_file: JsonFile = None,
    no_peers: NoPeers = False,
    seconds: Annotated[float, typer.Option(help="Of drawing, for each environment and drawer, s.", min=0.1)] = 4.0,
    folder: EnvironmentPeers = Path("runs/peers/envs"),
) -> None:
    """Measure and print."""
    solid = in_fresh_process(measured, seconds)
    os.environ[PLAIN] = "1"
    plain = in_fresh_process(measured, seconds)
    drawn = solid["rates"] if solid["drawer"] == "mujoco" else {}
    frames = {name: {"mujoco": drawn.get(name), "plain": rates} for name, rates in plain["rates"].items()}
    os.environ.setdefault("MUJOCO_GL", "egl")  # for the peer, which else asks for a screen
    others = {} if no_peers else peers(folder, seconds, "frames")
    heads = ("environment", "MuJoCo, processor", "MuJoCo", "plain, processor", "plain")
    rows = [(name, *said(rates["mujoco"]), *said(rates["plain"])) for name, rates in frames.items()]
    title = "Frames of 480 x 360 px: per second of processor time, and per second"
    print_table(title, heads, rows, words=("environment",))
    for name, peer in others.items():
        processor, wall = said(peer["frames_per_s"])
        words = f"{processor} per second of processor time, {wall} per second"
        print(f"{name}, its own drawing: {words if peer['frames_per_s'] else peer['note']}")
    if json_file is not None:
        write_json(json_file, {"frames_per_s": frames, "peers": others, "cores": os.cpu_count()})


if __name__ == "__main__":
    typer.run(main)
