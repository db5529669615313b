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
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
import typer
from measuring import DATA, ROOT, DataFolder, JsonFile, figure, last_words, machine, python_with, refuse, timed
from scipy.optimize import least_squares

from pickenv.arm import Array, Geometry, Pose
from pickenv.arm.files.urdf import urdf_text
from pickenv.base import InputError, single_threaded, versions, write_json
from pickenv.calibration import Identification, Measurements, align, complete_model, frames_model, identify
from pickenv.calibration.model.observations import random_split, same_poses
from pickenv.commands.showing import print_table
from pickenv.experiments import SETS

FEW = 100
"""Poses for systems that need minutes; pickenv is run on the same ones for their ratio."""
WORKERS = ROOT / "scripts" / "peers"
HELD_OUT = 200
"""Rows held out of the fit."""
LIMIT = 900.0
"""Seconds that one peer may take."""


class Peer(NamedTuple):
    """A package from PyPI that is compared with pickenv.

    Attributes:
        name: Its name on PyPI.
        version: The pinned version.
        method: Its method in words, for the table.
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


class PeerTask(NamedTuple):
    """The data that peers are compared on.

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
        return self if poses is None else self._replace(train=self.train.select(np.arange(poses)))


def read_peer_task(data: Path, seed: int) -> PeerTask:
    """Read the UR5 set and split it."""
    arm, grid, random = SETS["ur5"].load(data)
    assert isinstance(grid, Measurements) and isinstance(random, Measurements)
    train, held_out = random_split(same_poses(grid.joints), HELD_OUT, np.random.default_rng(seed))
    return PeerTask(arm.nominal, grid.select(train), grid.select(held_out), random)


def accuracy_on(geometry: Geometry, task: PeerTask) -> dict[str, float]:
    """Errors on the rows that the fit has not seen, mm."""
    held_out, random = (
        np.linalg.norm(rows.difference(geometry), axis=1) * 1e3 for rows in (task.held_out, task.random)
    )
    return {"held_out_rms_mm": float(np.sqrt(np.mean(held_out**2))), "random_poses_mean_mm": float(np.mean(random))}


def peer_problem(task: PeerTask, start: Geometry, runs: int) -> dict[str, Any]:
    """The problem that a peer's worker process reads; see scripts/peers/problem.py."""
    names = tuple(f"joint_{i + 1}" for i in range(start.joints))
    rows = {"": task.train, "held_out_": task.held_out, "random_": task.random}
    problem: dict[str, Any] = {name: getattr(start, name).tolist() for name in ("alpha", "a", "theta", "d")}
    problem |= {"base": homogeneous(start.base), "tool": homogeneous(start.tool), "runs": runs}
    for name, arm in {"urdf": start, "nominal_urdf": task.nominal}.items():
        problem[name] = urdf_text(replace(arm, joint_names=names), "arm")
    for prefix, part in rows.items():
        problem |= {f"{prefix}joints": part.joints.tolist(), f"{prefix}position": part.position.tolist()}
    return problem


def homogeneous(pose: Pose) -> list[list[float]]:
    """A pose as a homogeneous matrix."""
    return [*np.column_stack([pose.rotation, pose.position]).tolist(), [0.0, 0.0, 0.0, 1.0]]


def run_peer(peer: Peer, task: PeerTask, start: Geometry, folder: Path, limit: float = LIMIT) -> dict[str, Any]:
    """Run a peer in its own process and Python environment, where it is installed if it is not there yet.

    Args:
        peer: The peer.
        task: The data; the peer is given as many rows as it can take.
        start: The arm with base and tool fitted.
        folder: Where the peers' environments are kept.
        limit: Seconds that it may take.

    Raises:
        InputError: If it cannot be installed, fails, or takes longer than ``limit`` seconds.
    """
    python = python_with(folder / f"{peer.name}-{peer.version}", f"{peer.name}=={peer.version}")
    with tempfile.TemporaryDirectory() as scratch:
        problem, answer = Path(scratch) / "problem.json", Path(scratch) / "result.json"
        problem.write_text(json.dumps(peer_problem(task, start, peer.runs)), encoding="utf-8")
        command = [python, WORKERS / f"run_{peer.name}.py", problem, answer]
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


def row_of(task: PeerTask, geometry: Geometry, about: dict[str, Any], seconds: Array, **parts: Array) -> dict[str, Any]:
    """The figures of a system that runs in this process, and what there is to say ``about`` it.

    Times ``(2, runs)`` are given by the clock and of the processor; their medians and the best run are taken, of parts
    by the clock.
    """
    row = {"seconds": np.median(seconds[0]), "best_seconds": np.min(seconds[0]), "cpu_seconds": np.median(seconds[1])}
    row |= {f"{name}_seconds": np.median(part[0]) for name, part in parts.items()}
    times = {name: float(value) for name, value in row.items()} | {"runs": len(seconds[0]), "poses": len(task.train)}
    return times | about | accuracy_on(geometry, task)


def run_pickenv(task: PeerTask, runs: int) -> tuple[dict[str, Any], Identification, Identification]:
    """Align base and tool, then identify; everything a calibration needs, covariance and rank included."""
    frames, model = frames_model(task.nominal), complete_model(task.nominal)
    aligned, align_seconds = timed(lambda: align(task.nominal, task.train, frames), runs)
    fitted, solve_seconds = timed(lambda: identify(model, aligned.geometry, task.train), runs)
    about = {
        "parameters": fitted.identifiability.rank,
        "iterations": f"{len(aligned.residual_rms) - 1} + {len(fitted.residual_rms) - 1} iterations",
        "version": versions()["pickenv"],
        "note": "base and tool from nominal, then rank-aware Gauss-Newton with an analytic Jacobian",
    }
    parts = {"align": align_seconds, "solve": solve_seconds}
    return row_of(task, fitted.geometry, about, align_seconds + solve_seconds, **parts), aligned, fitted


def run_scipy(task: PeerTask, aligned: Identification, fitted: Identification, runs: int) -> dict[str, Any]:
    """SciPy's solver on our vectorised kinematics and on the parameters that our rank analysis kept."""
    model, kept = complete_model(task.nominal), fitted.identifiability.kept
    columns, scale, weight = model.columns[kept], model.tolerance[kept], task.train.row_weights

    def moved(values: Array) -> Geometry:
        delta = np.zeros(len(task.nominal.parameter_names))
        delta[columns] = values * scale
        return aligned.geometry.displaced(delta)

    def errors(values: Array) -> Array:
        return np.asarray((task.train.difference(moved(values)) * weight).ravel())

    with single_threaded():
        result, seconds = timed(lambda: least_squares(errors, np.zeros(len(columns)), jac="2-point"), runs)
    note = "least_squares, 2-point Jacobian, on pickenv's vectorised kinematics and its identifiable parameters"
    about = {
        "parameters": len(columns),
        "iterations": f"{result.nfev} evaluations with {result.njev} finite-difference Jacobians",
        "version": versions("scipy")["scipy"],
        "note": note + ("" if result.status > 0 else "; not converged"),
    }
    return row_of(task, moved(result.x), about, seconds, solve=seconds)


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


FIGURES = {
    "whole\ns": "seconds",
    "solver\ns": "solve_seconds",
    "CPU\ns": "cpu_seconds",
    "held-out\nRMS mm": "held_out_rms_mm",
    "random\nmm": "random_poses_mean_mm",
}


def print_result(result: dict[str, Any]) -> None:
    """The table, with units, and what must be known to read it."""
    rows, lines = [], []
    for name, row in result["systems"].items():
        solved = row["seconds"] is not None
        figures = [figure(row.get(key), ".4f") for key in FIGURES.values()]
        kinds = (f"{name}_vs_pickenv", f"{name}_vs_pickenv_cpu")
        ratios = [figure(result["ratios"].get(kind, 1.0 if solved else None), ".0f") for kind in kinds]
        rows.append([name, str(row.get("poses", "-")), str(row.get("parameters", "-")), *figures, *ratios])
        done = f" ({row['iterations']}; median of {row['runs']})" if solved else ""
        lines.append(f"{name} {row['version']}: {row['note']}{done}")
    print_table(
        f"UR5 by laser tracker: RMS on {HELD_OUT} held-out poses, mean on 20 random poses",
        ("system", "poses", "free", *FIGURES, "x", "x\nCPU"),
        rows,
        words=("system",),
        caption="free: parameters; x: whole time against pickenv's on as many poses, x CPU: the same in processor time",
    )
    print("\n".join([*lines, machine_words(result["machine"])]))


def machine_words(on: dict[str, Any]) -> str:
    """The machine in a line."""
    load = "unknown" if on["load_before"] is None else f"{on['load_before']:.1f}"
    versions = f"Python {on['python']}, NumPy {on['numpy']}, SciPy {on['scipy']}"
    return f"{on['cores']} cores of {on['cpu']}, load {load} before, {versions}"


def main(
    json_file: JsonFile = None,
    peers: Annotated[bool, typer.Option("--peers/--no-peers", help="Install and run the peers too.")] = True,
    data: DataFolder = DATA,
    runs: Annotated[int, typer.Option(help="Repetitions of pickenv; of SciPy a third of them.", min=1)] = 15,
    seed: Annotated[int, typer.Option(help="Seed of the split.")] = 0,
    folder: Annotated[Path, typer.Option("--peers-folder", help="Where the peers' environments are kept.")] = ROOT
    / "runs/peers",
    limit: Annotated[float, typer.Option(help="Seconds that one peer may take.")] = LIMIT,
) -> None:
    """Run the comparison and print it."""
    on = machine()
    try:
        task = read_peer_task(data.resolve(), seed)
    except InputError as error:
        refuse(str(error))
    few = task.first(FEW)
    systems: dict[str, dict[str, Any]] = {}
    systems["pickenv"], aligned, fitted = run_pickenv(task, runs)
    systems[f"pickenv_{FEW}"], few_aligned, _ = run_pickenv(few, runs)
    systems["scipy_2point"] = run_scipy(task, aligned, fitted, max(1, runs // 3))
    for peer in PEERS if peers else ():
        print(f"{peer.name} {peer.version} …", file=sys.stderr)
        start = aligned if peer.poses is None else few_aligned
        try:
            systems[peer.name] = run_peer(peer, task.first(peer.poses), start.geometry, folder, limit)
        except InputError as error:
            about = {"version": peer.version, "note": f"no figures, {error}"}
            systems[peer.name] = {"seconds": None, "held_out_rms_mm": None, **about}
    result = {
        "data": {"set": "ur5_wam_jacobi2025", "train": len(task.train), "held_out": HELD_OUT, "split_seed": seed},
        "machine": on,
        "systems": systems,
        "ratios": ratios_of(systems),
    }
    print_result(result)
    if json_file is not None:
        write_json(json_file, result)


if __name__ == "__main__":
    typer.run(main)
