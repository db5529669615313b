"""The one result of a calibration: verdict, held-out errors, what was found, what was left out.

Whatever a screen shows of a calibration is made here, once: the terminal prints `Result.report`, the page shows the
same blocks, `Result.as_dict` holds the same values, and the saved calibration carries the verdict in its record. Units:
mm and degrees on screens, SI inside.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm import Arm
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration.assessment.base_frame import BaseFrameError, base_frame_error
from pickenv.calibration.assessment.metrics import ErrorStatistics, error_statistics
from pickenv.calibration.assessment.quality import Quality, grade_quality
from pickenv.calibration.assessment.screen import Block, figure, main_parts, unit_of
from pickenv.calibration.assessment.states import LOST, MEASURED
from pickenv.calibration.compensation.compensator import Compensator
from pickenv.calibration.identification.diagnosis import LeftOut, said_of_rows
from pickenv.calibration.identification.least_squares import describe_absorption
from pickenv.calibration.identification.term_choice import TermChoice
from pickenv.calibration.model.arm_model import ArmModel
from pickenv.calibration.model.coverage import Coverage, pose_coverage
from pickenv.calibration.model.error_model import geometric_model
from pickenv.calibration.model.finished_poses import CARRIER
from pickenv.calibration.model.lens import LENS_NAMES
from pickenv.calibration.model.measurements import Measurements
from pickenv.calibration.model.observations import Observations
from pickenv.calibration.model.pixels import PixelObservations
from pickenv.calibration.model.stacked import Stacked
from pickenv.calibration.pipeline.calibration import Calibration
from pickenv.calibration.pipeline.export import export
from pickenv.calibration.pipeline.fitting import Fit
from pickenv.calibration.pipeline.held_out import (
    AS_CHOSEN,
    GEOMETRIC,
    NOMINAL,
    HeldOut,
    held_out_of,
    what_is_left,
    without_residual,
)
from pickenv.calibration.pipeline.pixel_figures import PixelFigures, pixel_figures
from pickenv.calibration.pipeline.uncertainty import PoseUncertainty, pose_uncertainty
from pickenv.calibration.reading.read import NoiseFloor
from pickenv.calibration.residuals.gate import GateReport
from pickenv.intervals import Ends


@dataclass(frozen=True, eq=False)
class Result:
    """A calibration, judged.

    Attributes:
        arm: The arm.
        fit: The calibration that will be used, and its evidence.
        geometric: The calibration of the geometry alone.
        train: Rows it was fitted to.
        test: Rows held out; all of them, in their blocks' order, where each block was judged without itself.
        held_out: Errors on them.
        quality: The verdict and what it rests on.
        uncertainty: Of predicted poses.
        base_frame: The error in the robot's own base frame; None where base and tool were known.
        terms: How terms were chosen; None where they were not.
        gate: The residual models' verdicts; None where none was judged.
        floor: What the files say about noise; None if not read from files.
        left_out: Rows far off that were left out.
        unit: Serial number of the robot, where it was named.
        pixels: Reprojection errors; None where no pictures were taken.
    """

    arm: Arm
    fit: Fit
    geometric: Fit
    train: Observations
    test: Observations
    held_out: HeldOut
    quality: Quality
    uncertainty: PoseUncertainty
    base_frame: BaseFrameError | None
    terms: TermChoice | None = None
    gate: GateReport | None = None
    floor: NoiseFloor | None = None
    left_out: tuple[LeftOut, ...] = ()
    unit: str | None = None
    pixels: PixelFigures | None = None

    @property
    def known_frames(self) -> bool:
        """Whether base and tool were known."""
        return self.base_frame is None

    @property
    def errors(self) -> Mapping[str, Array]:
        """Held-out errors by model ``(M, 6)``, ``(M, 3)`` or ``(M, 1)``, m and rad; the last is what will be used."""
        return self.held_out.errors

    @property
    def best_model(self) -> str:
        """Name of the model that will be used."""
        last = list(self.errors)[-1]
        return "geometry" if last in (GEOMETRIC, AS_CHOSEN) else last

    @property
    def best(self) -> ErrorStatistics:
        """Held-out position errors of the model that will be used, mm."""
        return list(self.position.values())[-1]

    @cached_property
    def position(self) -> dict[str, ErrorStatistics]:
        """Held-out position errors by model, mm."""
        blocks = self.held_out.blocks
        return {name: error_statistics(values[:, :3] * 1e3, blocks) for name, values in self.errors.items()}

    @cached_property
    def attitude(self) -> dict[str, ErrorStatistics]:
        """Held-out attitude errors by model, deg; empty where no attitude was measured."""
        wide = {name: values for name, values in self.errors.items() if values.shape[1] == 6}
        blocks = self.held_out.blocks
        return {name: error_statistics(np.degrees(values[:, 3:]), blocks) for name, values in wide.items()}

    @cached_property
    def calibration(self) -> Calibration:
        """The calibration with verdict, frames and uncertainty in its record: what is saved and applied."""
        record = {**self.fit.calibration.record, "verdict": self.quality.as_dict()}
        record["uncertainty"] = self.uncertainty.as_record()
        if self.base_frame is not None:
            record["base_frame"] = self.base_frame.as_dict()
        if self.unit is not None:
            record["unit"] = self.unit
        record["held_out"] = {
            "how": self.held_out.text(len(self.test.joints), len(self.train.joints)),
            "mean_mm": self.best.mean,
            "mean_ci95_mm": self.best.mean_ci95,
        }
        record["left_out"] = [f"{item.file}:{item.line}" for item in self.left_out if not item.kept]
        return replace(self.fit.calibration, record=record)

    @property
    def own_mean_ci95(self) -> Ends | None:
        """95 % interval of the arm's own mean error in the instrument's frame, mm; None where there are too few rows.

        The upper end is that of the held-out errors; from the lower one the instrument's noise is taken off, which a
        held-out error contains and a reach does not.
        """
        if self.best.mean_ci95 is None:
            return None
        low, high = self.best.mean_ci95
        if not isinstance(self.test, Measurements):
            return low, high
        noise = 3.0 * (self.test.position_std * 1e3) ** 2
        return low * float(np.sqrt(max(0.0, 1.0 - noise / max(self.best.rms**2, 1e-300)))), high

    @property
    def frames_text(self) -> str:
        """What is known about base and tool, and the error in the robot's own base frame, in a sentence."""
        if self.base_frame is not None:
            return self.base_frame.sentences()
        known = "base and tool are known; in the robot's own base frame the mean error at poses like those held out is "
        if self.own_mean_ci95 is None:
            return known + f"{figure(self.best.mean)} mm ({self.held_out.no_interval}; with the instrument's noise)"
        low, high = self.own_mean_ci95
        return known + (
            f"{figure(low)} to {figure(high)} mm (95 % interval; the lower end without the instrument's noise)"
        )

    def blocks(self) -> tuple[Block, ...]:
        """What both the terminal and the page show, in order, after verdict and frames."""
        found = [self._errors(), self._parameters(), self._dropped()]
        if self.left_out:
            places = tuple((item.text(),) for item in self.left_out)
            kept = any(item.kept for item in self.left_out)
            note = "" if self.pixels is not None else "too far off to be measurements of these poses"
            found.append(Block("Rows far off, and kept" if kept else "Rows left out", (), places, note))
        if self.terms is not None:
            rows = tuple((name, figure(value * 1e3)) for name, value in self.terms.blocked_rms.items())
            note = f"{self.terms.chosen}, chosen on blocks of the training rows"
            found.append(Block("Further terms", ("terms", "RMS on blocks (mm)"), rows, note))
        if self.gate is not None:
            found.append(self._gate(self.gate))
        if self.pixels is not None:
            found.append(self.pixels.block())
        sure = self.uncertainty.block(self.fit.calibration.model, self.test.joints, self.test.conditions)
        found += [sure, self._facts()]
        return tuple(block for block in found if block.rows)

    def __str__(self) -> str:
        """The report."""
        return self.report()

    def compensator(self) -> Compensator:
        """The map from joint targets to joint commands; see `Calibration.compensator` for its options."""
        return self.calibration.compensator()

    def save(self, path: str | Path) -> Path:
        """Write the calibration, with its verdict, as one file (.npz)."""
        return self.calibration.save(path)

    def export(self, **files: str | Path) -> list[Path]:
        """Write what other programs take: ``toml``, ``urdf`` or ``onnx``; see `pickenv.calibration.export`."""
        return export(self.calibration, self.arm, **files)

    def write_page(self, path: str | Path) -> Path:
        """Write the report as one HTML page, of poses or positions."""
        from pickenv.inspect.reports.calibration_report import write_calibration_report

        return write_calibration_report(path, self)

    def report(self) -> str:
        """For the terminal: the verdict first."""
        verdict, _, reason = self.quality.verdict().partition(": ")
        lines = [f"verdict: {verdict.upper()}: {reason}"]
        lines += [f"  {finding.weight}: {finding.text}" for finding in self.quality.others]
        lines += [f"frames: {self.frames_text}", *(block.text() for block in self.blocks())]
        return "\n".join(lines)

    def _label(self, name: str) -> str:
        labels = {NOMINAL: "nominal" if self.known_frames else "nominal, base and tool fitted", GEOMETRIC: "geometry"}
        return labels.get(name, name)

    def _errors(self) -> Block:
        header: tuple[str, ...] = ("model", "RMS (mm)", "mean (mm)", "95 % interval (mm)", "p95 (mm)", "max (mm)")
        header += ("attitude mean (deg)",) if self.attitude else ()
        rows = []
        for name, s in self.position.items():
            interval = "none" if s.mean_ci95 is None else " to ".join(map(figure, s.mean_ci95))
            cells = (self._label(name), figure(s.rms), figure(s.mean), interval, figure(s.p95), figure(s.max))
            rows.append(cells + ((figure(self.attitude[name].mean),) if name in self.attitude else ()))
        note = f"{self.held_out.text(len(self.test.joints), len(self.train.joints))}; used: {self.best_model}"
        return Block("Errors on held-out rows", header, tuple(rows), note)

    def parameters(self) -> list[dict[str, Any]]:
        """Each identified parameter: name, change and standard deviation on screens' units, and what became of it."""
        found, model = self.fit.identification, self.fit.calibration.model
        moved = ArmModel.of(self.fit.calibration.nominal, model.terms).difference(model)
        change = dict(zip(model.parameter_names, moved, strict=True)) | found.unknowns
        known: dict[str, float] = {}
        for each in (self.geometric.identification, found):
            known |= zip(each.identifiability.names, each.standard_deviation, strict=True)
        lost, rows = {item.name for item in found.identifiability.dropped}, []
        for name in known:
            if name in lost:
                continue
            unit, scale = unit_of(name, model.geometry.parameter_names)
            row = {"name": name, "unit": unit, "change": float(change[name] * scale), "std": float(known[name] * scale)}
            rows.append(row | {"state": self.quality.states.of(name)})
        return rows

    def _parameters(self) -> Block:
        rows = [
            (row["name"], figure(row["change"]), figure(row["std"]), row["unit"])
            for row in self.parameters()
            if row["state"] == MEASURED
        ]
        return Block(
            "Parameters", ("parameter", "change", "± 1 sigma", "unit"), tuple(rows), self.quality.states.text()
        )

    def _dropped(self) -> Block:
        dropped = self.fit.identification.identifiability.dropped
        rows = [(item.name, describe_absorption(main_parts(item.absorbed_by))) for item in dropped]
        rows += [
            (row["name"], f"known to ± {figure(row['std'])} {row['unit']} only")
            for row in self.parameters()
            if row["state"] == LOST
        ]
        note = "left at their nominal value, with what absorbs them (m, rad), or known in sums with others only"
        return Block("Lost in others", (), tuple(rows), note)

    def _gate(self, gate: GateReport) -> Block:
        first = gate.verdicts[0]
        rows = [("without", figure(first.geometric_random_rms * 1e3), figure(first.geometric_blocked_rms * 1e3), "")]
        rows += [(v.model, figure(v.random_rms * 1e3), figure(v.blocked_rms * 1e3), v.reason) for v in gate.verdicts]
        chosen = f"'{gate.selected}' is used" if gate.selected else "none is used"
        header = ("model", "random hold-out, RMS (mm)", "blocked hold-out, RMS (mm)", "verdict")
        return Block("Learnt residual models", header, tuple(rows), f"{chosen}; judged within the training rows")

    def _facts(self) -> Block:
        found = self.geometric.identification
        rows = [
            ("measured", self.train.kind),
            ("condition number of the geometry", figure(self.quality.observability.condition)),
            ("least squares", f"{len(found.residual_rms) - 1} iterations, {figure(1e3 * found.solve_seconds)} ms"),
        ]
        if self.quality.coverage is not None:
            rows.append(("poses", self.quality.coverage.advice()))
        if self.floor is not None:
            rows.append(("noise floor of a position", self.floor.text()))
        return Block("Evidence", (), tuple(rows))

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        found = self.geometric.identification
        nominal, geometric, best = self.position[NOMINAL], self.position[GEOMETRIC], self.best
        held_out: dict[str, Any] = {
            "nominal_rms_mm": nominal.rms,
            "geometric_rms_mm": geometric.rms,
            "geometric_mean_mm": geometric.mean,
            "geometric_mean_ci95_mm": geometric.mean_ci95,
            "best_rms_mm": best.rms,
            "best_mean_mm": best.mean,
            "best_mean_ci95_mm": best.mean_ci95,
            "own_mean_ci95_mm": self.own_mean_ci95,
            "best_model": self.best_model,
            "how": self.held_out.text(len(self.test.joints), len(self.train.joints)),
            **{f"{name}_mm": statistics.as_dict() for name, statistics in self.position.items()},
            **{f"{name}_deg": statistics.as_dict() for name, statistics in self.attitude.items()},
        }
        terms = self.terms
        return {
            "verdict": self.quality.as_dict(),
            "arm": self.arm.name,
            "unit": self.unit,
            "kind": found.kind,
            "frames": "known" if self.known_frames else "fitted",
            "within95": self.uncertainty.within95_record(),
            "base_frame": None if self.base_frame is None else self.base_frame.as_dict(),
            "rows": {"train": len(self.train.joints), "test": len(self.test.joints)},
            "left_out_rows": [vars(item) for item in self.left_out],
            "parameters": len(found.identifiability.names),
            "rank": found.identifiability.rank,
            "states": self.quality.states.as_dict(),
            "changes": self.parameters(),
            "dropped": {item.name: item.absorbed_by for item in found.identifiability.dropped},
            "lost_to_poses": [] if self.quality.coverage is None else list(self.quality.coverage.lost),
            "condition": self.quality.observability.condition,
            "converged": self.fit.identification.converged,
            "solve_seconds": found.solve_seconds,
            "unknowns_mm": _in_mm({name: value for name, value in found.unknowns.items() if name not in LENS_NAMES}),
            "held_out": held_out,
            "noise_floor_mm": None if self.floor is None else _in_mm(vars(self.floor)),
            "terms": None if terms is None else {"chosen": terms.chosen, "blocked_rms_mm": _in_mm(terms.blocked_rms)},
            "gate": {} if self.gate is None else self.gate.as_dict()["models"],
            **({} if self.pixels is None else self.pixels.as_dict()),
        }


def _pixels(fit: Fit, train: Observations) -> PixelFigures | None:
    """Reprojection errors of the views that were fitted, where there are pictures."""
    return pixel_figures(fit, train) if isinstance(train, PixelObservations) else None


def _in_mm(lengths: Mapping[str, float | None]) -> dict[str, float | None]:
    return {name: None if value is None else value * 1e3 for name, value in lengths.items()}


def assess(
    arm: Arm,
    fit: Fit,
    train: Observations,
    test: Observations,
    *,
    fits: Mapping[str, Fit] | None = None,
    held_out: HeldOut | None = None,
    terms: TermChoice | None = None,
    gate: GateReport | None = None,
    left_out: tuple[LeftOut, ...] = (),
    coverage: Coverage | None = None,
) -> Result:
    """Judge a calibration on rows that it never saw.

    Args:
        arm: The arm.
        fit: The calibration that will be used.
        train: Rows it was fitted to.
        test: Rows held out.
        fits: The calibration of the geometry alone and what was added to it, step by step, by name; the last is
            ``fit``. When left out ``fit`` without and with its learnt residual.
        held_out: Errors on the rows held out; what the fits leave there when left out.
        terms: How terms were chosen.
        gate: The residual models' verdicts.
        left_out: Rows left out.
        coverage: What the poses hide, where it was computed already.
    """
    unlearnt = without_residual(fit)
    learnt = fit.calibration.learnt
    if fits is None:
        fits = {GEOMETRIC: unlearnt} if learnt is None else {GEOMETRIC: unlearnt, f"geometry+{learnt.kind}": fit}
    bare = next(iter(fits.values()))
    aligned = bare.aligned
    held_out = held_out or held_out_of(fits, train, test)
    after = list(held_out.errors.values())[-1]
    before = None if arm.name == CARRIER else held_out.errors[NOMINAL]
    if isinstance(test, Measurements) and isinstance(train, Measurements):
        if coverage is None:
            start = bare.calibration.nominal
            coverage = pose_coverage(geometric_model(start, aligned is None), start, train)
        said = "stated noise" if train.std_stated else "noise assumed, since none is stated,"
        noise = f"{said} of {train.position_std * 1e3:.4g} mm"
    else:
        noise = "noise stated or assumed"
    joints, conditions = None, None
    if not isinstance(test, Stacked):  # whose rows stand by station, and errors by block
        rows_of = test.rows_of_misses
        joints, conditions = test.joints[rows_of], test.conditions.select(rows_of)
    uncertainty = pose_uncertainty(fit.identification, after, joints, held_out.blocks, conditions)
    base_frame = None
    rows = len(train.joints) + (held_out.blocks is None) * len(test.joints)
    if aligned is not None:
        left, tracked = after, isinstance(test, Measurements)
        if not tracked:  # then the misses are not one per row: any may go with any pose
            drawn = np.random.default_rng(0).integers(0, len(after), len(test.joints))
            left = np.pad(after, ((0, 0), (0, 3 - min(after.shape[1], 3))))[drawn]
        base_frame = base_frame_error(arm.nominal, bare.calibration.nominal, test.joints, left, tracked)
    return Result(
        arm=arm,
        fit=fit,
        geometric=bare,
        train=train,
        test=test,
        held_out=held_out,
        quality=grade_quality(
            fit.identification,
            what_is_left(unlearnt, train),
            before,
            after,
            coverage,
            geometric=bare.identification,
            parametric=held_out.parametric,
            blocks=held_out.blocks,
            noise=noise,
            said=said_of_rows(left_out, rows + sum(not item.kept for item in left_out)),
        ),
        uncertainty=uncertainty,
        base_frame=base_frame,
        terms=terms,
        gate=gate,
        left_out=left_out,
        pixels=_pixels(bare, train),
    )
