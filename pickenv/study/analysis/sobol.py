"""Sobol indices of groups of tolerances: how the variance of the squared error divides among them (Saltelli 2010).

Unlike the regression of `pickenv.study.analysis.sensitivity` they include interactions and need no model, but arms of
their own. The tracker does not err here. Each row of the sample has fruit and poses of its own, the same for all arms
that are compared in it: the indices are averages over fruit and poses. Output: squared RMS error, mm^2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import qmc

from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.plant.plant import Plant
from pickenv.arm.plant.tolerances import plants_from, random_columns
from pickenv.errors import InputError
from pickenv.study.design.config import LS, RAW, Setting
from pickenv.study.design.protocol import Circumstances, Protocol, prepared_study
from pickenv.study.results.outcomes import figures
from pickenv.study.results.quantiles import variance_indices
from pickenv.study.results.row_table import OK
from pickenv.study.results.study_folder import SOBOL, SOBOL_AGAIN, read_record, study_at, write_record

GROUPS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "joint stiffness": ("joint_compliance", ("joint_stiffness",)),
    "flexural rigidity": ("boom_bending", ("flexural_rigidity",)),
    "bearing stiffness": ("slide_compliance", ("bearing_stiffness",)),
    "transmission error": ("transmission_error", ("lead", "transmission_error", "phase")),
    "drive harmonics": ("drive_harmonics", ("drive_harmonics",)),
    "local structure": ("local_structure", ("local_structure",)),
    "roller clearance": ("roller_play", ("roller_clearance",)),
    "backlash": ("backlash", ("backlash",)),
    "friction": ("stick_band", ("friction",)),
    "temperature": ("thermal_growth", ("temperature_rise",)),
    "ground": ("base_tilt", ("ground_stiffness", "sinkage")),
}
"""For each group of effects, the effect and the random numbers (`random_columns`) that it takes; an effect of random
numbers of its own is a group too."""
STREAM = 7
"""Key of the random numbers, apart from those of the study's rows."""
SCRAMBLES = 32
"""Independent Sobol sequences that a sample consists of; the intervals are over them."""
LEAST = 8 * SCRAMBLES
"""Rows of a sample at least: with fewer the intervals hold too seldom."""
SAMPLES = 2048
"""Rows of a sample when nothing else is asked."""


def tolerance_groups(design: Plant) -> dict[str, list[int]]:
    """Columns of an arm's even random numbers by group; effects that the design has not are left out."""
    columns, n = random_columns(design), design.arm.nominal.joints
    alpha, a, theta, d = (list(columns["geometry"][k * n : (k + 1) * n]) for k in range(4))
    own = {name.replace("_", " "): (name, (f"own {name}",)) for name in design.names if f"own {name}" in columns}
    effects = {
        group: [i for key in keys for i in columns[key]]
        for group, (name, keys) in ({**GROUPS, **own}).items()
        if design.effect(name) is not None
    }
    return {"angles": alpha + theta, "lengths": a + d, **effects}


def sobol_of(protocol: Protocol, setting: Setting, samples: int) -> list[dict[str, Any]]:
    """Sobol indices of the groups in one setting.

    Args:
        protocol: The study.
        setting: One of its settings, raw or least squares.
        samples: A power of two; (groups + 2) times as many arms are made.

    Returns:
        As `sobol_indices`, with the number of arms.

    Raises:
        InputError: If the setting's method is another, or an arm cannot be judged.
    """
    from pickenv.study.running.batched import judge_batch

    if setting.method not in (RAW, LS):
        raise InputError(
            f"Sobol indices of method '{setting.method}' would take too long; choose a setting of raw or ls"
        )
    groups = tolerance_groups(protocol.design)
    tolerances = replace(protocol.tolerances[setting.tolerances], it_grade=setting.it_grade)
    active = [i for columns in groups.values() for i in columns]
    every = max(columns.stop for columns in random_columns(protocol.design).values())

    @cache
    def given(row: int) -> Circumstances:
        return protocol.circumstances(protocol.config.arms + row).perfect

    def squared_error(even: Array, rows: NDArray[np.int64]) -> Array:
        whole = np.full((len(even), every), 0.5)
        whole[:, active] = even
        plants = plants_from(protocol.design, tolerances, whole)
        outcomes = judge_batch(protocol, setting, plants, [given(row) for row in rows.tolist()])
        for status in outcomes.status:
            if status != OK:
                raise InputError(f"Sobol indices of setting {setting.number} need every arm's error: {status}")
        return figures(outcomes.position, outcomes.attitude, protocol.config.radius_mm)["error_rms_mm"] ** 2

    places = np.cumsum([0, *(len(columns) for columns in groups.values())]).tolist()
    numbered = {name: range(a, b) for name, a, b in zip(groups, places, places[1:], strict=False)}
    rng = np.random.default_rng(np.random.SeedSequence(protocol.config.seed, spawn_key=(STREAM,)))
    rows = sobol_indices(squared_error, numbered, samples, rng)
    return [row | {"arms": samples * (len(groups) + 2)} for row in rows]


def sobol_indices(
    model: Callable[[Array, NDArray[np.int64]], Array],
    groups: Mapping[str, Sequence[int]],
    samples: int,
    rng: np.random.Generator,
) -> list[dict[str, Any]]:
    """Sobol indices, first and total, of groups of independent inputs.

    Args:
        model: From even random numbers ``(N, d)`` in 0..1, and the rows of the sample that they stand in ``(N,)``, to
            one finite number for each ``(N,)``. What it makes of the row's number is averaged over.
        groups: For each group, which inputs belong to it; together they name every input once.
        samples: Rows of the sample, a power of two; the model is evaluated (number of groups + 2) times as often.
        rng: Draws the scrambled Sobol sequences, `SCRAMBLES` of them.

    Returns:
        As `variance_indices`. Total minus first order is interaction.

    Raises:
        InputError: If the groups do not name every input once, or ``samples`` is no power of two or too few.
    """
    inputs = sorted(i for group in groups.values() for i in group)
    d = len(inputs)
    if inputs != list(range(d)) or not d:
        raise InputError(f"the groups name inputs {inputs}; name each of 0 to {max(inputs, default=0)} once")
    if samples < LEAST or samples & (samples - 1):
        raise InputError(f"{samples} samples; give a power of two from {LEAST}, such as {SAMPLES}")
    each, rows = samples // SCRAMBLES, np.arange(samples)
    even = np.concatenate([qmc.Sobol(2 * d, rng=rng).random(each) for _ in range(SCRAMBLES)])
    first, second = even[:, :d], even[:, d:]

    def found(numbers: Array) -> Array:
        return model(numbers, rows).reshape(SCRAMBLES, each)

    mixed = []
    for group in groups.values():
        swapped = first.copy()
        swapped[:, list(group)] = second[:, list(group)]
        mixed.append(found(swapped))
    return variance_indices(found(first), found(second), np.stack(mixed), list(groups))


def write_sobol(folder: str | Path, settings: list[int], samples: int) -> Path:
    """Compute the indices of some settings of a study and write them into its folder, where the report finds them.

    Raises:
        InputError: As `sobol_of`.
    """
    study = study_at(folder)
    protocol, path = prepared_study(study.config), Path(folder) / SOBOL
    found = {f"{number}": sobol_of(protocol, protocol.settings[number], samples) for number in settings}
    write_record(path, {"config_sha256": study.sha256, "indices": found})
    return path


def read_sobol(folder: str | Path) -> dict[int, list[dict[str, Any]]]:
    """What `write_sobol` wrote; empty where nothing was written.

    Raises:
        InputError: If the file is damaged, edited or about another study.
    """
    path = Path(folder) / SOBOL
    if not path.is_file():
        return {}
    found = read_record(path, study_at(folder), SOBOL_AGAIN)
    return {int(number): list(rows) for number, rows in found["indices"].items()}
