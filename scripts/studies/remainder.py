"""What geometry leaves of measured arms, and what it is made of: the numbers that the plant `field` is sized by.

UR5 (Jacobi 2025) and UR10, series A to D (Landgraf et al. 2021). Each tenth of a file is judged without itself: what is
left by geometry, by geometry with gravity, and with the drives' harmonics, which gives the variance of each part. The
harmonics of all rows give the spectrum: on which joints the waves are, and how their amplitudes, as displacements of
the tool, fall with the order. The choice of waves favours large ones, so small ones are missing in it. Shares of
variance are means over the sets; sizes in mm are those of the UR10, whose reach is that of the arm `qiao2026`.

Needs the measured data sets (PICKENV_DATA). Run: python scripts/studies/remainder.py [--out runs/remainder.json]
"""

from __future__ import annotations

import csv
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from pickenv.arm import Array, joint_jacobian, load_arm
from pickenv.calibration import Choices, Measurements, calibrate
from pickenv.calibration.identification.term_choice import harmonics_of
from pickenv.calibration.reading.read import read_measurements
from pickenv.errors import InputError
from pickenv.files import write_json

ROOT = Path(__file__).parents[2]
UR10, REPEATS = "ur10_ipa_landgraf2021/Series_{}/measurements_{}.csv", "ur10_landgraf2021_repeats"
SETS = {
    "UR5": ("ur5", "ur5_jacobi2025", "ur5_wam_jacobi2025/UR5/*grid*cleaned.csv"),
    "UR10 A": ("ur10", "ur10_landgraf2021", UR10.format("A", "grid")),
    "UR10 B": ("ur10", REPEATS, UR10.format("B", "joint_configurations")),
    "UR10 C": ("ur10", REPEATS, UR10.format("C", "random_poses")),
    "UR10 D": ("ur10", REPEATS, UR10.format("D", "iso_cubes")),
}
"""Arm, column description and file of each set."""

ROWS = 1500
"""Files with more rows are thinned to about so many, at equal steps."""

FIRST = 3
"""The waves of so many first joints make the spectrum; the wrist's are counted apart."""

LOWEST = 3.0
"""Slower waves than this, cycles per turn, cannot be told from one another, nor from geometry, over a joint's range."""


def rms(errors: Array) -> float:
    """Root mean square of position errors ``(N, 6)``, m, in mm."""
    return float(1e3 * np.sqrt(np.mean(np.sum(errors[:, :3] ** 2, axis=1))))


def decomposed(arm: str, rows: Measurements) -> dict[str, Any]:
    """What is left of one set on blocks held out, mm RMS, and the waves found on all of its rows."""
    left: dict[str, float] = {}
    for name, terms in (("gravity", "gravity"), ("periodic", "periodic"), ("best", "auto")):
        result = calibrate(load_arm(arm), rows, split="blocked", choices=Choices(terms=terms, residual="none"))
        assert result.held_out.blocks is not None
        left["geometry"] = rms(result.errors["geometric"])
        left[name] = rms(list(result.errors.values())[-1])
    found = result.fit.identification
    reach = np.sqrt(np.mean(np.sum(joint_jacobian(found.geometry, rows.joints)[:, :3] ** 2, axis=1), axis=0))
    waves = [
        {"joint": wave.joint + 1, "order": wave.order, "amplitude_mm": 1e3 * wave.amplitude * float(reach[wave.joint])}
        for wave in harmonics_of(found)
    ]
    return {"rows": len(rows), "left_mm": left, "chosen": result.held_out.used, "waves": waves}


def repeats(path: Path) -> float | None:
    """Standard deviation of repeated measurements in a file that states it, mm: median over poses, along three axes."""
    with path.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file, delimiter=";"))
    names = [f"measurement_std_{axis}" for axis in "xyz"]
    if not set(names) <= rows[0].keys():
        return None
    stds = np.array([[float(row[name].replace(",", ".")) for name in names] for row in rows])
    return float(np.median(np.sqrt(np.sum(stds**2, axis=1))))


def spectrum(sets: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """The numbers to size a plant by, of all sets together."""
    shares: dict[str, list[float]] = {"gravity": [], "waves": [], "rest": []}
    for found in sets.values():
        whole = found["left_mm"]["geometry"] ** 2
        gravity = max(1.0 - found["left_mm"]["gravity"] ** 2 / whole, 0.0)
        rest = min(found["left_mm"]["periodic"], found["left_mm"]["best"]) ** 2 / whole
        shares["gravity"].append(gravity)
        shares["rest"].append(rest)
        shares["waves"].append(max(1.0 - gravity - rest, 0.0))
    waves = [(name, wave) for name, found in sets.items() for wave in found["waves"] if wave["order"] >= LOWEST]
    first = [(name, wave) for name, wave in waves if wave["joint"] <= FIRST]
    # log amplitude = a constant of the set - decay * log order
    order = np.log([wave["order"] for _, wave in first])
    size = np.log([wave["amplitude_mm"] for _, wave in first])
    own = np.array([[name == each for each in sets] for name, _ in first], dtype=float)
    own = own[:, own.any(axis=0)]
    (*_, slope), *_ = np.linalg.lstsq(np.column_stack([own, order]), size, rcond=None)
    scatter = size - np.column_stack([own, order]) @ np.linalg.lstsq(np.column_stack([own, order]), size, rcond=None)[0]
    bare = order - own @ np.linalg.lstsq(own, order, rcond=None)[0]
    spread = float(np.sqrt(scatter @ scatter / (len(size) - own.shape[1] - 1) / (bare @ bare)))
    energy = {
        str(joint): float(sum(wave["amplitude_mm"] ** 2 for _, wave in waves if wave["joint"] == joint))
        for joint in range(1, 7)
    }
    total = sum(energy.values())
    ur10 = [found["left_mm"]["geometry"] for name, found in sets.items() if name.startswith("UR10")]
    repeated = [found["repeats_mm"] for found in sets.values() if found["repeats_mm"] is not None]
    return {
        "geometry_mm": float(np.mean(ur10)) if ur10 else None,
        "variance": {name: float(np.mean(values)) for name, values in shares.items()},
        "variance_of_each": {name: [float(value) for value in values] for name, values in shares.items()},
        "decay": -float(slope),
        "decay_std": spread,
        "wave_energy_by_joint": {joint: value / total for joint, value in energy.items()},
        "waves_each": len(first) / len(sets),
        "highest_order": max(wave["order"] for _, wave in waves),
        "repeats_mm": float(np.mean(repeated)) if repeated else None,
    }


def main(
    out: Annotated[Path, typer.Option(help="JSON file of all figures.")] = ROOT / "runs/remainder.json",
    data: Annotated[Path, typer.Option(envvar="PICKENV_DATA", help="Folder of the measured data sets.")] = ROOT
    / "../shared/data",
) -> None:
    """Decompose every set and print what is common to them."""
    sets: dict[str, Any] = {}
    print("| set | rows | geometry (mm) | + gravity | + harmonics | waves on joints 1-3, wrist | repeats (mm) |")
    print("|---|---|---|---|---|---|---|")
    for name, (arm, columns, pattern) in SETS.items():
        files = sorted(data.glob(pattern))
        if not files:
            raise InputError(f"no {pattern} in {data}; name the folder of the data sets in PICKENV_DATA")
        rows = read_measurements(files[0], load_arm(arm).nominal, columns)
        rows = rows.select(np.arange(0, len(rows), max(1, round(len(rows) / ROWS))))
        found = decomposed(arm, rows) | {"repeats_mm": repeats(files[0])}
        sets[name] = found
        left, fast = found["left_mm"], [w for w in found["waves"] if w["order"] >= LOWEST]
        counts = f"{sum(w['joint'] <= FIRST for w in fast)}, {sum(w['joint'] > FIRST for w in fast)}"
        again = "" if found["repeats_mm"] is None else f"{found['repeats_mm']:.3f}"
        print(
            f"| {name} | {found['rows']} | {left['geometry']:.3f} | {left['gravity']:.3f} | {left['periodic']:.3f} "
            f"| {counts} | {again} |",
            flush=True,
        )
    common = spectrum(sets)
    print(common)
    write_json(out, {"sets": sets, "common": common})


if __name__ == "__main__":
    typer.run(main)
