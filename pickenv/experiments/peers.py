"""Other people's calibrations of the UR5 on the same rows, each in its own process and Python environment.

800 positions of a seeded shuffle for the fit, 200 held out, and the data set's own 20 random poses (Jacobi 2025). Base
and tool are fitted already for those that cannot do it. What drives each package lies in scripts/peers of a checkout.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

import pickenv
from pickenv.arm import Geometry, Pose, load_arm
from pickenv.arm.files.urdf import urdf_text
from pickenv.calibration import Measurements, align, complete_model, frames_model, identify, read_measurements
from pickenv.calibration.model.observations import random_split, same_poses
from pickenv.errors import InputError

WORKERS = Path(pickenv.__file__).parents[1] / "scripts" / "peers"
HELD_OUT = 200
FEW = 100
"""Poses for systems that need minutes; pickenv is run on the same ones for their ratio."""

LIMIT = 900.0
"""Seconds that one peer may take."""


@dataclass(frozen=True)
class Peer:
    """A package from PyPI.

    Attributes:
        name: Its name there.
        version: The pinned version.
        method: What it does, for the table.
        poses: Poses that it is given, or None for all of the training rows.
        runs: How often it is repeated.
    """

    name: str
    version: str
    method: str
    poses: int | None = None
    runs: int = 3


PEERS = (
    Peer("figaroh", "1.0.2", "base parameters by QR, closed-form frames, MINPACK LM, one pose at a time"),
    Peer("robotkinecal", "0.1.0", "product of exponentials, Gauss-Newton, one pose at a time"),
    Peer("pybotics", "3.1.2", "modified DH, SciPy on norms of errors, 2-point Jacobian", poses=FEW, runs=1),
)


@dataclass(frozen=True, eq=False)
class PeerTask:
    """The data of the comparison.

    Attributes:
        nominal: The arm as its maker describes it.
        train: Rows for the fit.
        held_out: Rows held out.
        random: The data set's random poses.
    """

    nominal: Geometry
    train: Measurements
    held_out: Measurements
    random: Measurements

    def first(self, poses: int | None) -> PeerTask:
        """The task with only the first ``poses`` training rows; all of them for None."""
        return self if poses is None else replace(self, train=self.train.select(np.arange(poses)))


def read_peer_task(data: Path, seed: int) -> PeerTask:
    """Read the UR5 set and split it."""
    folder = data / "ur5_wam_jacobi2025" / "UR5"
    nominal = load_arm("ur5").nominal
    files = [folder / f"3D_UR5_uncalibrated_{kind}_cleaned.csv" for kind in ("grid", "random")]
    for file in files:
        if not file.is_file():
            raise InputError(f"{file} does not exist; give the folder of data sets with --data or PICKENV_DATA")
    grid, random = (read_measurements(file, nominal, "ur5_jacobi2025") for file in files)
    train, held_out = random_split(same_poses(grid.joints), HELD_OUT, np.random.default_rng(seed))
    return PeerTask(nominal, grid.select(train), grid.select(held_out), random)


def accuracy_on(geometry: Geometry, task: PeerTask) -> dict[str, float]:
    """Errors on the rows that the fit has not seen, mm."""
    held_out, random = (
        np.linalg.norm(rows.difference(geometry), axis=1) * 1e3 for rows in (task.held_out, task.random)
    )
    return {"held_out_rms_mm": float(np.sqrt(np.mean(held_out**2))), "random_poses_mean_mm": float(np.mean(random))}


def peer_problem(task: PeerTask, start: Geometry, runs: int) -> dict[str, Any]:
    """What a worker reads; see scripts/peers/problem.py."""
    names = tuple(f"joint_{i + 1}" for i in range(start.joints))
    descriptions = [urdf_text(replace(arm, joint_names=names), "arm") for arm in (start, task.nominal)]
    rows = {"": task.train, "held_out_": task.held_out, "random_": task.random}
    found: dict[str, Any] = {name: getattr(start, name).tolist() for name in ("alpha", "a", "theta", "d")}
    found |= {"base": homogeneous(start.base), "tool": homogeneous(start.tool), "runs": runs}
    found |= dict(zip(("urdf", "nominal_urdf"), descriptions, strict=True))
    for prefix, part in rows.items():
        found |= {f"{prefix}joints": part.joints.tolist(), f"{prefix}position": part.position.tolist()}
    return found


def homogeneous(pose: Pose) -> list[list[float]]:
    """A pose as a homogeneous matrix."""
    upper = np.concatenate([pose.rotation, pose.position[:, None]], axis=1)
    return [*upper.tolist(), [0.0, 0.0, 0.0, 1.0]]


def peer_python(peer: Peer, folder: Path, install: bool) -> Path:
    """The Python of the peer's own environment, made when it is not there yet and ``install`` says so.

    Raises:
        InputError: If it is not there, or cannot be made, with the installer's last words.
    """
    home = folder.resolve() / f"{peer.name}-{peer.version}"
    python = home / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    done = home / "installed"
    if done.is_file():
        return python
    if not install:
        how = "python scripts/benchmark_calibration.py installs it there"
        raise InputError(f"{peer.name} {peer.version} is not installed in {folder}; {how}")
    pip = ["-m", "pip", "install", "--quiet", "--disable-pip-version-check", f"{peer.name}=={peer.version}"]
    for command in ([sys.executable, "-m", "venv", "--clear", str(home)], [str(python), *pip]):
        ended = subprocess.run(command, capture_output=True, text=True)
        if ended.returncode:
            raise InputError(f"cannot be installed: {last_words(ended.stderr or ended.stdout)}")
    done.touch()
    return python


def run_peer(
    peer: Peer, task: PeerTask, start: Geometry, folder: Path, *, limit: float = LIMIT, install: bool = False
) -> dict[str, Any]:
    """Run a peer in its own process.

    Args:
        peer: The peer.
        task: The rows; it is given as many as it can take.
        start: The arm with base and tool fitted.
        folder: Where the peers' environments are kept.
        limit: Seconds that it may take.
        install: Whether it is installed there when it is not yet.

    Raises:
        InputError: If it cannot be installed, fails, or takes longer than ``limit`` seconds.
    """
    python = peer_python(peer, folder, install)
    with tempfile.TemporaryDirectory() as scratch:
        given, answer = Path(scratch) / "problem.json", Path(scratch) / "result.json"
        given.write_text(json.dumps(peer_problem(task, start, peer.runs)), encoding="utf-8")
        command = [python, WORKERS / f"run_{peer.name}.py", given, answer]
        clean = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
        try:
            ended = subprocess.run(command, capture_output=True, text=True, timeout=limit, cwd=scratch, env=clean)
        except subprocess.TimeoutExpired:
            raise InputError(f"not done after {limit:g} s") from None
        if ended.returncode or not answer.is_file():
            raise InputError(f"failed: {last_words(ended.stderr)}")
        result: dict[str, Any] = json.loads(answer.read_text(encoding="utf-8"))
    remark = result.pop("remark")
    return result | {"version": peer.version, "note": peer.method + (f"; {remark}" if remark else "")}


def last_words(text: str) -> str:
    """The last line that says something."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    errors = [line for line in lines if "error" in line.lower()]
    return (errors or lines or ["without a word"])[-1]


def judged_peer(peer: Peer | None, data: Path, folder: Path) -> dict[str, Any]:
    """Errors of a peer, or of our own least squares where it is None, on the same rows, mm.

    "nominal" are those with base and tool fitted alone.

    Raises:
        InputError: If the data are missing, or the peer is not installed, fails, or takes too long.
    """
    task = read_peer_task(data, 0).first(None if peer is None else peer.poses)
    start = align(task.nominal, task.train, frames_model(task.nominal)).geometry
    if peer is None:
        fitted = identify(complete_model(task.nominal), start, task.train).geometry
        errors: dict[str, Any] = {**accuracy_on(fitted, task), "note": "least squares"}
    else:
        errors = run_peer(peer, task, start, folder)
    return {**errors, "nominal": accuracy_on(start, task)}
