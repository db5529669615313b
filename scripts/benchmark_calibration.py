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
import time
from collections.abc import Callable
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

from pickenv.arm import Geometry
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration import align, complete_model, frames_model, identify
from pickenv.calibration.identification.least_squares import Identification
from pickenv.errors import InputError
from pickenv.experiments.peers import FEW, HELD_OUT, LIMIT, PEERS, PeerTask, accuracy_on, read_peer_task, run_peer
from pickenv.files import write_text
from pickenv.threads import single_threaded

ROOT = Path(__file__).parents[1]


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


def run_pickenv(task: PeerTask, runs: int) -> tuple[dict[str, Any], Identification, Identification]:
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
        **accuracy_on(found.geometry, task),
        "version": own_version(),
        "note": "base and tool from nominal, then rank-aware Gauss-Newton with an analytic Jacobian",
    }
    return row, aligned, found


def run_scipy(task: PeerTask, aligned: Identification, found: Identification, runs: int) -> dict[str, Any]:
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
        **accuracy_on(moved(result.x), task),
        "version": scipy.__version__,
        "note": "least_squares, 2-point Jacobian, on pickenv's vectorised kinematics and its identifiable parameters"
        + ("" if result.status > 0 else "; not converged"),
    }


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
    limit: Annotated[float, typer.Option(help="Seconds that one peer may take.")] = LIMIT,
) -> None:
    """Run the comparison and print it."""
    console, log = Console(), Console(stderr=True)
    on = machine()
    try:
        task = read_peer_task(data.resolve(), seed)
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
            systems[peer.name] = run_peer(
                peer, task.first(peer.poses), start.geometry, folder, limit=limit, install=True
            )
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
