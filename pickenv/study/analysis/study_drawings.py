"""Which figures a study's rows allow, each with its caption, and which are left out and why."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
from pyarrow.dataset import Dataset

from pickenv.errors import InputError
from pickenv.inspect.figures.run_drawings import Drawing, Drawings, NotDrawn
from pickenv.study.analysis import study_figures as figures
from pickenv.study.analysis.sensitivity import sensitivities_of
from pickenv.study.analysis.single_arms import Placement, place
from pickenv.study.analysis.study_verdict import specified
from pickenv.study.design.config import RAW, StudyConfig
from pickenv.study.design.protocol import Protocol, prepared_study
from pickenv.study.results.quantiles import quantiles_of, yields_of
from pickenv.study.results.row_table import Row, held
from pickenv.study.results.study_folder import read_rows, study_of

DENSE = tuple(float(p) for p in np.linspace(0.01, 0.99, 99))
"""Probabilities of the distributions that are drawn."""
AXES = {
    "it_grade": "the grade of the machined lengths",
    "poses": "the number of calibration poses",
    "noise_mm": "the tracker's noise",
    "payload_kg": "the payload",
}


@dataclass(frozen=True, eq=False)
class Findings:
    """What a study found, computed once for figures and report.

    Attributes:
        config: The study.
        protocol: The study made ready.
        rows: Its rows, verified.
        yields: From `yields.yields_of`.
        quantiles: From `quantiles.quantiles_of`.
        dense: Quantiles of the mean position error at `DENSE`.
        sensitivities: For one setting of each method, all else in the middle of what was varied, from
            `sensitivity.sensitivities_of`, by number; or why there is none.
        placements: For the same settings, where the design's own true arm stands, or why nowhere; empty where the
            design has no true arm of its own.
    """

    config: StudyConfig
    protocol: Protocol
    rows: Dataset
    yields: pa.Table
    quantiles: pa.Table
    dense: pa.Table
    sensitivities: dict[int, pa.Table | str]
    placements: dict[int, Placement | str]

    def row(self, setting: int) -> dict[str, Any]:
        """The yield of a setting, with its columns."""
        found: dict[str, Any] = self.yields.slice(setting, 1).to_pylist()[0]
        return found


def gather(folder: str | Path) -> Findings:
    """Analyse a study's rows.

    Raises:
        InputError: If the folder holds no study or no rows.
    """
    config, rows = study_of(folder), read_rows(folder)
    protocol = prepared_study(config)
    design, yields = protocol.design, yields_of(rows, config.share)
    sensitivities: dict[int, pa.Table | str] = {}
    placements: dict[int, Placement | str] = {}
    for setting in (row["setting"] for row in held(yields.to_pylist(), ("method",))):
        try:
            sensitivities[setting] = sensitivities_of(rows, setting)
        except InputError as error:
            sensitivities[setting] = str(error)
        if any((getattr(design.geometry, name) != getattr(protocol.nominal, name)).any() for name in ("alpha", "a")):
            try:
                placements[setting] = place(protocol, rows, protocol.settings[setting], design, f"{design.name} itself")
            except InputError as error:
                placements[setting] = str(error)
    return Findings(
        config=config,
        protocol=protocol,
        rows=rows,
        yields=yields,
        quantiles=quantiles_of(rows),
        dense=quantiles_of(rows, ["error_mean_mm"], DENSE),
        sensitivities=sensitivities,
        placements=placements,
    )


def study_drawings(found: Findings) -> Drawings:
    """The figures of a study."""
    rows, wanted = found.yields.to_pylist(), specified(found.config)
    judged = any(row["failed"] < row["arms"] for row in rows)
    drawings: list[Drawing | NotDrawn] = []
    for along, words in AXES.items():
        if along not in figures.varied(rows):
            drawings.append(NotDrawn(f"yield_by_{along}", f"the study does not vary {words}"))
            continue
        drawings.append(
            Drawing(
                f"yield_by_{along}",
                f"Share of arms that pick {wanted}, against {words}, with Wilson 95 % bands.",
                partial(figures.yield_curves, found.yields, along, wanted),
            )
        )
        if judged:
            drawings.append(
                Drawing(
                    f"error_by_{along}",
                    f"Mean position error of the median arm against {words}; bands hold the middle 90 % of arms.",
                    partial(figures.error_curves, found.quantiles, along),
                )
            )
    if judged:
        drawings.append(
            Drawing(
                "error_distribution",
                "How the arms' mean position errors are distributed.",
                partial(figures.distributions, found.dense, radius_mm=found.config.radius_mm),
            )
        )
    for setting, table in found.sensitivities.items():
        label, name = figures.setting_label(found.row(setting)), f"sensitivity_{_word(found.row(setting))}"
        if isinstance(table, str):
            drawings.append(NotDrawn(name, table))
        else:
            caption = f"What each tolerance explains of the variance between arms, each at its own fruit: {label}."
            drawings.append(Drawing(name, caption, partial(figures.tornado, table, label)))
    for setting, placement in found.placements.items():
        name = f"placement_{_word(found.row(setting))}"
        if isinstance(placement, str):
            drawings.append(NotDrawn(name, placement))
        else:
            caption = f"Where {placement.arm} stands in its population: {figures.setting_label(found.row(setting))}."
            share = (placement.percentile, *placement.interval)
            draw = partial(figures.arm_among_population, found.dense, setting, placement.error_mm, placement.arm, share)
            drawings.append(Drawing(name, caption, draw))
    return drawings


def _word(row: Row) -> str:
    """A setting's method as part of a file name."""
    return RAW if row["method"] == RAW else str(row["method"]).replace("+", "_")
