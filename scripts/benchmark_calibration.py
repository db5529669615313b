"""Calibrate one real arm with pickenv and with its peers, side by side: same rows, same split, same start.

The data are 1000 laser-tracker positions of a UR5 (Jacobi 2025): 800 of a seeded shuffle for the fit, 200 held out, and
the data set's own 20 random poses. SciPy, robotkinecal and pybotics are given base and tool already fitted, and the
time of that is charged to pickenv alone; FIGAROH has a closed form of its own for them. Each peer is installed from
PyPI into an environment of its own. Loading of packages, arms and files is not timed, save that FIGAROH reads its data
file itself. Times are medians, because machines are rarely quiet; processor times and the best run are in the JSON too.

Run: python scripts/benchmark_calibration.py [--json FILE] [--no-peers] [--data DIR] [--runs 15]
"""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import scipy
import typer
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from scipy.optimize import least_squares

from pickenv.arm import Geometry, Pose, load_arm
from pickenv.arm.files.urdf_text import urdf_text
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration import Measurements, align, complete_model, frames_model, identify, read_measurements
from pickenv.calibration.identification.least_squares import Identification
from pickenv.calibration.model.splits import random_split
from pickenv.errors import InputError
from pickenv.files import write_text
from pickenv.threads import single_threaded

ROOT = Path(__file__).parents[1]
WORKERS = ROOT / "scripts" / "peers"
HELD_OUT = 200
FEW = 100
"""Poses for systems that need minutes; pickenv is run on the same ones for their ratio."""


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
class Task:
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

    def first(self, poses: int | None) -> Task:
        """The task with only the first ``poses`` training rows; all of them for None."""
        return self if poses is None else replace(self, train=self.train.select(np.arange(poses)))


def read_task(data: Path, seed: int) -> Task:
    """Read the UR5 set and split it."""
    folder = data / "ur5_wam_jacobi2025" / "UR5"
    nominal = load_arm("ur5").nominal
    files = [folder / f"3D_UR5_uncalibrated_{kind}_cleaned.csv" for kind in ("grid", "random")]
    for file in files:
        if not file.is_file():
            raise InputError(f"{file} does not exist; give the folder of data sets with --data or PICKENV_DATA")
    grid, random = (read_measurements(file, nominal, "ur5_jacobi2025") for file in files)
    train, held_out = random_split(len(grid), HELD_OUT, np.random.default_rng(seed))
    return Task(nominal, grid.select(train), grid.select(held_out), random)


def accuracy(geometry: Geometry, task: Task) -> dict[str, float]:
    """Errors on the rows that the fit has not seen, mm."""
    held_out, random = (
        np.linalg.norm(rows.difference(geometry), axis=1) * 1e3 for rows in (task.held_out, task.random)
    )
    return {"held_out_rms_mm": float(np.sqrt(np.mean(held_out**2))), "random_poses_mean_mm": float(np.mean(random))}


def timed(function: Callable[[], Any], runs: int) -> tuple[Any, Array]:
    """The last result, and seconds ``(2, runs)`` by the clock and of the processor, after one run that is not counted.

    NumPy's threads are held to one where pickenv holds them, so that processor time is time by the clock when quiet.
    """
    function()
    seconds = []
    for _ in range(runs):
        begin, cpu = time.perf_counter(), time.process_time()
        result = function()
        seconds.append((time.perf_counter() - begin, time.process_time() - cpu))
    return result, np.array(seconds).T


def times(seconds: Array) -> dict[str, float]:
    """Medians by the clock and of the processor, and the best run."""
    return {
        "seconds": float(np.median(seconds[0])),
        "best_seconds": float(np.min(seconds[0])),
        "cpu_seconds": float(np.median(seconds[1])),
    }


def run_pickenv(task: Task, runs: int) -> tuple[dict[str, Any], Identification, Identification]:
    """Align base and tool, then identify; everything a calibration needs, covariance and rank included."""
    frames, model = frames_model(task.nominal), complete_model(task.nominal)
    aligned, align_seconds = timed(lambda: align(task.nominal, task.train, frames), runs)
    found, solve_seconds = timed(lambda: identify(model, aligned.geometry, task.train), runs)
    row = {
        **times(align_seconds + solve_seconds),
        "align_seconds": float(np.median(align_seconds[0])),
        "solve_seconds": float(np.median(solve_seconds[0])),
        "runs": runs,
        "poses": len(task.train),
        "parameters": found.identifiability.rank,
        "iterations": f"{len(aligned.residual_rms) - 1} + {len(found.residual_rms) - 1} iterations",
        **accuracy(found.geometry, task),
        "version": own_version(),
        "note": "base and tool from nominal, then rank-aware Gauss-Newton with an analytic Jacobian",
    }
    return row, aligned, found


def run_scipy(task: Task, aligned: Identification, found: Identification, runs: int) -> dict[str, Any]:
    """SciPy's solver on our vectorised kinematics and on the parameters that our rank analysis kept."""
    model, kept = complete_model(task.nominal), found.identifiability.kept
    columns, scale, weight = model.columns[kept], model.tolerance[kept], task.train.row_weights

    def moved(values: Array) -> Geometry:
        delta = np.zeros(len(task.nominal.parameter_names))
        delta[columns] = values * scale
        return aligned.geometry.displaced(delta)

    def errors(values: Array) -> Array:
        return np.asarray((task.train.difference(moved(values)) * weight).ravel())

    with single_threaded():
        result, seconds = timed(lambda: least_squares(errors, np.zeros(len(columns)), jac="2-point"), runs)
    return {
        **times(seconds),
        "solve_seconds": float(np.median(seconds[0])),
        "runs": runs,
        "poses": len(task.train),
        "parameters": len(columns),
        "iterations": f"{result.nfev} evaluations with {result.njev} finite-difference Jacobians",
        **accuracy(moved(result.x), task),
        "version": scipy.__version__,
        "note": "least_squares, 2-point Jacobian, on pickenv's vectorised kinematics and its identifiable parameters"
        + ("" if result.status > 0 else "; not converged"),
    }


def problem_of(task: Task, start: Geometry, runs: int) -> dict[str, Any]:
    """What a worker reads; see scripts/peers/problem.py."""
    names = tuple(f"joint_{i + 1}" for i in range(start.joints))
    descriptions = [urdf_text(replace(arm, joint_names=names), "arm") for arm in (start, task.nominal)]
    rows = {"": task.train, "held_out_": task.held_out, "random_": task.random}
    found: dict[str, Any] = {name: getattr(start, name).tolist() for name in ("alpha", "a", "theta", "d")}
    found |= {"base": matrix(start.base), "tool": matrix(start.tool), "runs": runs}
    found |= dict(zip(("urdf", "nominal_urdf"), descriptions, strict=True))
    for prefix, part in rows.items():
        found |= {f"{prefix}joints": part.joints.tolist(), f"{prefix}position": part.position.tolist()}
    return found


def matrix(pose: Pose) -> list[list[float]]:
    """A pose as a homogeneous matrix."""
    upper = np.concatenate([pose.rotation, pose.position[:, None]], axis=1)
    return [*upper.tolist(), [0.0, 0.0, 0.0, 1.0]]


def environment(peer: Peer, folder: Path) -> Path:
    """The Python of the peer's own environment, made when it is not there yet.

    Raises:
        InputError: If it cannot be made, with the installer's last words.
    """
    home = folder.resolve() / f"{peer.name}-{peer.version}"
    python = home / ("Scripts/python.exe" if os.name == "nt" else "bin/python")
    done = home / "installed"
    if done.is_file():
        return python
    install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", f"{peer.name}=={peer.version}"]
    for command in ([sys.executable, "-m", "venv", "--clear", home], install):
        ended = subprocess.run(command, capture_output=True, text=True)
        if ended.returncode:
            raise InputError(f"cannot be installed: {last_words(ended.stderr or ended.stdout)}")
    done.touch()
    return python


def run_peer(peer: Peer, task: Task, start: Geometry, folder: Path, limit: float) -> dict[str, Any]:
    """Run a peer in its own process.

    Raises:
        InputError: If it cannot be installed, fails, or takes longer than ``limit`` seconds.
    """
    python = environment(peer, folder)
    with tempfile.TemporaryDirectory() as scratch:
        given, answer = Path(scratch) / "problem.json", Path(scratch) / "result.json"
        given.write_text(json.dumps(problem_of(task, start, peer.runs)), encoding="utf-8")
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


def own_version() -> str:
    """The version of pickenv, also in a checkout that was never installed."""
    try:
        return version("pickenv")
    except PackageNotFoundError:
        return "not installed"


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    model = platform.processor() or platform.machine()
    listing = Path("/proc/cpuinfo")
    if listing.is_file():
        names = [line.partition(":")[2].strip() for line in listing.read_text().splitlines() if "model name" in line]
        model = names[0] if names else model
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    load = os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    return {
        "cpu": model,
        "cores": usable,
        "load_before": load,
        "platform": platform.system(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }


def ratios_of(systems: dict[str, dict[str, Any]]) -> dict[str, float]:
    """How many times as long each other system takes, on the same number of poses.

    All against pickenv's whole calibration: ``NAME_vs_pickenv`` with the peer's own preparation, the same in processor
    time (``NAME_vs_pickenv_cpu``), and the peer's solver call alone (``NAME_solve_vs_pickenv``).
    """
    ours = {row["poses"]: row for name, row in systems.items() if name.startswith("pickenv")}
    ratios = {}
    for name, row in systems.items():
        if not name.startswith("pickenv") and row["seconds"] is not None:
            mine = ours[row["poses"]]
            ratios[f"{name}_vs_pickenv"] = row["seconds"] / mine["seconds"]
            ratios[f"{name}_vs_pickenv_cpu"] = row["cpu_seconds"] / mine["cpu_seconds"]
            ratios[f"{name}_solve_vs_pickenv"] = row["solve_seconds"] / mine["seconds"]
    return ratios


def print_result(result: dict[str, Any], console: Console) -> None:
    """The table, with units, and what must be known to read it."""
    title = f"UR5 by laser tracker: RMS on {HELD_OUT} held-out poses, mean on 20 random poses"
    caption = "free: parameters; x: whole time against pickenv's on as many poses, x CPU: the same in processor time"
    table = Table(title=title, caption=caption, box=SIMPLE_HEAD, padding=(0, 0, 0, 1))
    table.add_column("system", no_wrap=True)
    units = ("poses", "free", "whole\ns", "solver\ns", "CPU\ns", "held-out\nRMS mm", "random\nmm", "x", "x\nCPU")
    for name in units:
        table.add_column(name, justify="right")
    for name, row in result["systems"].items():
        if row["seconds"] is None:
            table.add_row(name, *["-"] * len(units))
            continue
        seconds = [f"{row[key]:.4f}" for key in ("seconds", "solve_seconds", "cpu_seconds")]
        errors = [f"{row[key]:.4f}" for key in ("held_out_rms_mm", "random_poses_mean_mm")]
        ratios = [result["ratios"].get(f"{name}_vs_pickenv{kind}", 1.0) for kind in ("", "_cpu")]
        slower = [f"{ratio:.0f}" for ratio in ratios]
        table.add_row(name, str(row["poses"]), str(row["parameters"]), *seconds, *errors, *slower)
    console.print(table)
    lines = []
    for name, row in result["systems"].items():
        done = "" if row["seconds"] is None else f" ({row['iterations']}; median of {row['runs']})"
        lines.append(f"{name} {row['version']}: {row['note']}{done}")
    on = result["machine"]
    load = "unknown" if on["load_before"] is None else f"{on['load_before']:.1f}"
    lines.append(
        f"{on['cores']} cores of {on['cpu']}, load {load} before, Python {on['python']}, NumPy {on['numpy']}, "
        f"SciPy {on['scipy']}"
    )
    for line in lines:
        console.print(line, markup=False, highlight=False)


def main(
    json_file: Annotated[Path | None, typer.Option("--json", help="Also write the figures to this file.")] = None,
    peers: Annotated[bool, typer.Option("--peers/--no-peers", help="Install and run the peers too.")] = True,
    data: Annotated[Path, typer.Option(envvar="PICKENV_DATA", help="Folder of the measured data sets.")] = ROOT
    / "../shared/data",
    runs: Annotated[int, typer.Option(help="Repetitions of pickenv; of SciPy a third of them.", min=1)] = 15,
    seed: Annotated[int, typer.Option(help="Seed of the split.")] = 0,
    folder: Annotated[Path, typer.Option("--peers-folder", help="Where the peers' environments are kept.")] = ROOT
    / "runs/peers",
    limit: Annotated[float, typer.Option(help="Seconds that one peer may take.")] = 900.0,
) -> None:
    """Run the comparison and print it."""
    console, log = Console(), Console(stderr=True)
    on = machine()
    try:
        task = read_task(data.resolve(), seed)
    except InputError as error:
        log.print(str(error), markup=False, highlight=False, soft_wrap=True)
        raise typer.Exit(2) from None
    few = task.first(FEW)
    row, aligned, found = run_pickenv(task, runs)
    systems = {"pickenv": row}
    few_row, few_aligned, _ = run_pickenv(few, runs)
    systems[f"pickenv_{FEW}"] = few_row
    systems["scipy_2point"] = run_scipy(task, aligned, found, max(1, runs // 3))
    for peer in PEERS if peers else ():
        log.print(f"{peer.name} {peer.version} …", highlight=False)
        start = aligned if peer.poses is None else few_aligned
        try:
            systems[peer.name] = run_peer(peer, task.first(peer.poses), start.geometry, folder, limit)
        except InputError as error:
            missing = dict.fromkeys(("seconds", "held_out_rms_mm"))
            systems[peer.name] = {**missing, "version": peer.version, "note": f"no figures, {error}"}
    result = {
        "data": {"set": "ur5_wam_jacobi2025", "train": len(task.train), "held_out": HELD_OUT, "split_seed": seed},
        "machine": on,
        "systems": systems,
        "ratios": ratios_of(systems),
    }
    print_result(result, console)
    if json_file is not None:
        write_text(json_file, json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    typer.run(main)
