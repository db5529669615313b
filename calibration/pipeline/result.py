"""The result of a calibration: verdict, held-out errors, identified parameters, and rows left out.

All outputs are made from one `Result`. The terminal prints `Result.summary` or `Result.report`, the HTML page shows
the tables of `Result.blocks`, and `Result.as_dict` holds the values for JSON. The saved calibration has the verdict in
its record. Units: mm and degrees in outputs, SI inside.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.arm import Arm, Array, Geometry, Plant, draw_plants, forward, load_tolerances
from pickenv.base import Ends, InputError, folded, require, screen_width, shortened
from pickenv.calibration.assessment import instrument, screen
from pickenv.calibration.assessment.quality import Quality, grade_quality, workspace_error
from pickenv.calibration.compensation.compensator import Compensator
from pickenv.calibration.identification import diagnosis
from pickenv.calibration.identification.term_choice import TermChoice
from pickenv.calibration.model.arm_model import CARRIER, ArmModel, fitted_model
from pickenv.calibration.model.measurements import joint_columns, random_joints
from pickenv.calibration.model.observations import MISS_UNITS, Clocks, Observations, equally_spaced, origins_of
from pickenv.calibration.pipeline import fitting
from pickenv.calibration.pipeline.calibration import (
    MEASURED_REGION,
    QUANTITIES,
    UNCERTAINTY,
    WITHOUT_RESIDUAL,
    Calibration,
    PoseUncertainty,
    Sizes,
    variance_by_station,
)
from pickenv.calibration.pipeline.twin import SCATTER, SCATTER_PARTS, scatter_of, twin
from pickenv.calibration.reading.read import joints_of, read_targets
from pickenv.calibration.residuals.residual_models import GateVerdict, position_rms, selected, verdicts_record

CAUTIONS, CAUTION = 3, 100
"""Largest number of cautions in a summary, and of characters in a line; each caution takes two lines at most."""

SIGMAS = 2.0
"""Change of a parameter, in its standard deviations, above which the parameter counts as moved."""


def has_moved(row: Mapping[str, Any]) -> bool:
    """Return whether a parameter changed by more than `SIGMAS` of its standard deviations.

    Args:
        row: The parameter, an entry of `Result.parameters`.
    """
    return bool(abs(row["change"]) > SIGMAS * row["std"])


@dataclass(frozen=True, eq=False)
class Result:
    """A calibration with its verdict and the errors on held-out rows.

    Attributes:
        arm: The arm.
        fit: The fit whose calibration is used.
        geometric: The fit of the geometry alone.
        train: The rows that the calibration was fitted to.
        test: The held-out rows. If rows were held out block by block, these are all rows, ordered by block.
        held_out: Errors on the held-out rows.
        quality: The verdict and the findings that it comes from.
        uncertainty: Uncertainty of predicted poses.
        base_frame: Interval of the error in the robot's own base frame; None if base and tool were known.
        unlearnt: Uncertainty of predicted poses without the learnt residual; None if none was learnt.
        terms: The chosen terms and the errors of each candidate; None if terms were not chosen from the rows.
        gate: Verdicts on the residual models; empty if none was judged.
        left_out: The outlier rows. Each says whether it was left out, or kept all the same.
        unit: Serial number of the robot; None if it was not given.
        pixels: Reprojection errors, for JSON; None if no pictures were taken.
        stations: Which frames (base, tool) differ from file to file, as the caller stated. None if this was decided
            from the rows.
    """

    arm: Arm
    fit: fitting.Fit
    geometric: fitting.Fit
    train: Observations
    test: Observations
    held_out: fitting.HeldOut
    quality: Quality
    uncertainty: PoseUncertainty
    base_frame: instrument.BaseFrameError | None
    unlearnt: PoseUncertainty | None = None
    terms: TermChoice | None = None
    gate: tuple[GateVerdict, ...] = ()
    left_out: tuple[diagnosis.LeftOut, ...] = ()
    unit: str | None = None
    pixels: dict[str, Any] | None = None
    stations: str | None = None

    @property
    def known_frames(self) -> bool:
        """Whether base and tool were known."""
        return self.geometric.aligned is None

    @property
    def has_nominal(self) -> bool:
        """Whether the arm has a nominal model.

        It has none if tool poses were given in place of joint values. Then only frames are fitted.
        """
        return self.arm.name != CARRIER

    @property
    def errors(self) -> Mapping[str, Array]:
        """Held-out errors ``(M, 6)``, ``(M, 3)`` or ``(M, 1)``, m and rad, by model; the last model is the one used."""
        return self.held_out.errors

    @property
    def miss_unit(self) -> str:
        """The unit of held-out errors in outputs: "mm", or "deg" if only directions were measured."""
        return self.train.miss_unit

    @property
    def best_model(self) -> str:
        """Name of the model that the calibration uses, the last of `errors`; "geometry" where none was learnt."""
        last = list(self.errors)[-1]
        return "geometry" if last in (fitting.GEOMETRIC, fitting.AS_CHOSEN) else last

    @property
    def best(self) -> screen.ErrorStatistics:
        """Statistics of the held-out position errors of the model that is used, in `miss_unit`."""
        return list(self.position.values())[-1]

    @cached_property
    def position(self) -> dict[str, screen.ErrorStatistics]:
        """Statistics of held-out position errors by model, in `miss_unit`."""
        blocks = self.held_out.together
        scale = MISS_UNITS[self.miss_unit]
        return {name: screen.error_statistics(values[:, :3] * scale, blocks) for name, values in self.errors.items()}

    @cached_property
    def attitude(self) -> dict[str, screen.ErrorStatistics]:
        """Statistics of held-out attitude errors by model, deg; empty if no attitude was measured."""
        wide = {name: values for name, values in self.errors.items() if values.shape[1] == 6}
        blocks = self.held_out.together
        return {name: screen.error_statistics(np.degrees(values[:, 3:]), blocks) for name, values in wide.items()}

    @cached_property
    def calibration(self) -> Calibration:
        """The calibration with verdict, base-frame error and uncertainty in its record; `save` writes this one."""
        fitted, over, region, scatter = self.fit.calibration, self.quality.workspace, None, None
        if np.isfinite(self.uncertainty.covariance).all() and self.arm.nominal.tree is None:
            region = (self.unlearnt or self.uncertainty).region(fitted.model, self.train)
        if self.train.poses is not None:
            parts = scatter_of(self.train.poses, origins_of(self.train).repeat)
            scatter = dict(zip(SCATTER_PARTS, parts, strict=True))
        entries = {
            "verdict": self.quality.as_dict(),
            UNCERTAINTY: self.uncertainty.as_record(),
            WITHOUT_RESIDUAL: None if self.unlearnt is None else self.unlearnt.as_record(),
            MEASURED_REGION: region,
            "base_frame": None if self.base_frame is None else self.base_frame.as_dict(),
            "unit": self.unit,
            "held_out": {
                "how": self.held_out.text(len(self.test.joints), len(self.train.joints)),
                f"mean_{self.miss_unit}": self.best.mean,
                f"mean_ci95_{self.miss_unit}": self.best.mean_ci95,
            },
            "workspace": None if over is None else over.as_dict(),
            "harmonics": {"note": screen.OWN, "found": self.harmonics} if self.harmonics else None,
            "stiffnesses": self.stiffnesses or None,
            SCATTER: scatter,
            "stations": self.set_ups or None,
            "left_out": [f"{item.file}:{item.line}" for item in self.left_out if not item.kept],
        }
        stated = {name: entry for name, entry in entries.items() if entry is not None}
        return replace(fitted, record={**fitted.record, **stated})

    @cached_property
    def harmonics(self) -> list[dict[str, Any]]:
        """The identified harmonics of the drives, the largest first, deg or mm; empty if there are none."""
        return screen.harmonic_rows(self.fit.identification)

    @cached_property
    def stiffnesses(self) -> list[dict[str, Any]]:
        """The identified stiffnesses of the joints; empty if the calibration has no compliance term."""
        return screen.stiffness_rows(self.fit.identification, self.train)

    @property
    def own_mean_ci95(self) -> Ends | None:
        """95 % interval of the arm's own mean error in the instrument's frame, mm; None if there are too few rows.

        The upper end is the upper end of the interval for the mean held-out error. If poses or positions were measured,
        the instrument's noise is subtracted from the lower end, because a held-out error contains this noise and the
        arm's own error does not.
        """
        if self.best.mean_ci95 is None:
            return None
        low, high = self.best.mean_ci95
        if self.test.poses is None:
            return low, high
        noise = 3.0 * (self.test.poses.position_std * 1e3) ** 2
        return low * float(np.sqrt(max(0.0, 1.0 - noise / max(self.best.rms**2, 1e-300)))), high

    @property
    def frames_text(self) -> str:
        """Text that says whether base and tool were fitted, and gives the error in the robot's own base frame."""
        if self.base_frame is not None:
            return self.base_frame.sentences()
        if self.arm.nominal.tree is not None:
            return "each sensor's and each target's place was fitted; errors are of the motion of one against the other"
        words = "base and tool are known; in the robot's own base frame the mean error at poses like those held out is "
        if self.own_mean_ci95 is None:
            mean = screen.figure(self.best.mean)
            return f"{words}{mean} mm ({self.held_out.no_interval}; with the instrument's noise)"
        low, high = map(screen.figure, self.own_mean_ci95)
        return f"{words}{low} to {high} mm (95 % interval; the lower end without the instrument's noise)"

    @property
    def _within95(self) -> Sizes:
        """Two arrays ``(M,)`` at the held-out rows: bounds on the position error, m, and on the attitude error, rad.

        95 of 100 errors are below their bound. An array is None if it is unknown. For a whole robot, the
        base and tool of each station are used.
        """
        sure, test = self.uncertainty, self.test
        if self.arm.nominal.tree is None:
            return self.calibration.uncertainty(test.joints, test.conditions)[1]
        return sure.within95(sure.standard_of(variance_by_station(self.fit.identification, test) + sure.scatter))

    def blocks(self) -> tuple[screen.Block, ...]:
        """Return the tables that terminal and HTML page show after verdict and frames; empty tables are left out."""
        over = self.quality.workspace
        blocks = [self._errors(), instrument.set_up_block(self.set_ups, self.stations)]
        blocks += [] if over is None else [over.block()]
        blocks.append(self._parameters())
        far = "far off, and kept" if any(item.kept for item in self.left_out) else "left out"
        places = tuple((item.text(),) for item in self.left_out)
        note = "" if self.pixels is not None else "too far off to be measurements of these poses"
        blocks.append(screen.Block(f"{self.held_out.rows.capitalize()} {far}", (), places, note, "left_out"))
        if self.terms is not None:
            scale, (names, blocked_rms, _) = MISS_UNITS[self.miss_unit], self.terms
            rows = tuple((name, screen.figure(value * scale)) for name, value in blocked_rms.items())
            heads = ("terms", f"RMS on blocks ({self.miss_unit})")
            choice = f"{names}, chosen on blocks of the training rows"
            blocks.append(screen.Block("Further terms", heads, rows, choice, "terms"))
        blocks += [screen.stiffness_block(self.stiffnesses), screen.harmonic_block(self.harmonics)]
        blocks += [self._gate()] if self.gate else []
        blocks += [] if self.pixels is None else [fitting.pixel_block(self.pixels, fitting.view_names(self.test.views))]
        blocks += [self.uncertainty.block(self._within95), self._facts()]
        return tuple(block for block in blocks if block.rows)

    def __str__(self) -> str:
        """Return `summary`."""
        return self.summary()

    def compensator(self) -> Compensator:
        """Return the map from joint targets to joint commands; `Calibration.compensator` takes options."""
        return self.calibration.compensator()

    def plant(self) -> Plant:
        """Return the calibrated arm as a plant, that is a simulated true arm for every environment.

        See `pickenv.calibration.pipeline.twin.twin`.
        """
        return twin(self.calibration, self.arm, self.train.poses)

    def sample(self, n: int, seed: int, tolerances: str = "medium") -> Plant:
        """Draw arms from the posterior of the calibration, as one plant (simulated true arms) that holds all of them.

        Args:
            n: Number of arms.
            seed: Seed of the draw.
            tolerances: Name of the tolerance class from which parameters that were not identified are drawn.
        """
        return draw_plants(self.plant(), load_tolerances(tolerances), n, np.random.default_rng(seed))

    def save(self, path: str | Path) -> Path:
        """Write the calibration with its verdict as one file (.npz), and return the file's path."""
        return self.calibration.save(path)

    def export(self, out: str | Path, *, kind: str | None = None, onto: str | Path | None = None) -> Path:
        """Write the calibration to a file that a robot, controller or other program reads, and return the file's path.

        Args:
            out: The file to write.
            kind: Name of the kind of file; if None, it follows from the name of ``onto`` or else of ``out``.
            onto: The robot's own file. The written copy differs only in what the calibration corrects. See
                `pickenv.calibration.export`.
        """
        from pickenv.calibration.delivery.export import export

        return export(self.calibration, out, kind=kind, onto=onto, arm=self.arm).path

    def write_page(self, path: str | Path, seeds: Mapping[str, Any] | None = None) -> Path:
        """Write the report as one HTML page, and return the page's path.

        Args:
            path: The page.
            seeds: Seeds of random draws by name, which the page states.
        """
        require("jinja2", "matplotlib", "plotly")
        from pickenv.inspect import write_calibration_report

        return write_calibration_report(path, self, seeds)

    def summary(self) -> str:
        """Return the most important results as text of at most 22 lines of 100 characters; `report` returns all.

        They are the verdict, cautions before use, held-out errors, and the expected errors where the arm will work.
        """
        width = screen_width()
        lines = self._verdict_lines()
        cautions = [f"  {weight}: {text}" for weight, text in self.quality.others if weight != "note"]
        for caution in cautions[:CAUTIONS]:
            lines += folded(shortened(caution, 2 * min(width, CAUTION) - 8), width)
        if len(cautions) > CAUTIONS:
            lines.append(f"  and {len(cautions) - CAUTIONS} cautions more")
        if self.base_frame is not None:
            lines += folded(self.base_frame.brief(), width)
        how = self.held_out.text(len(self.test.joints), len(self.train.joints)).partition(":")[0].partition(";")[0]
        blocks = [replace(self._errors(), note=f"{how}; {self.best_model} is used")]
        if self.quality.workspace is not None:
            over = self.quality.workspace.block()
            rows = tuple(row[:-1] for row in over.rows)
            note = "by the fitted geometry; RMS, 95 % interval"
            blocks.append(replace(over, header=over.header[:-1], rows=rows, note=note))
        lines += [block.text() for block in blocks if block.rows]
        lines += [line for clock in self.clocks for line in folded(f"recording {clock.text()}", width)]
        for verdict in self.gate:
            if "pip install" in verdict.reason:  # what the reader can change
                lines += folded(f"{verdict.model}: {verdict.reason}", width)
        if self.pixels is not None:
            pictures = fitting.pixel_block(self.pixels, fitting.view_names(self.test.views))
            lines += [f"{name}: {pixels}" for name, pixels in pictures.rows[1:3]]
        if self.left_out:
            kept = "kept, though far off" if any(item.kept for item in self.left_out) else "left out as far off"
            more = f", and {len(self.left_out) - 1} more" if len(self.left_out) > 1 else ""
            lines += folded(f"{kept}: {self.left_out[0].text()}{more}", width)
        return "\n".join(lines)

    def report(self) -> str:
        """Return all results as text for the terminal, which begins with the verdict."""
        lines = self._verdict_lines()
        sentences = [f"  {weight}: {text}" for weight, text in self.quality.others] + [f"frames: {self.frames_text}"]
        lines += [line for sentence in sentences for line in folded(sentence, screen_width())]
        return "\n".join([*lines, *(block.text() for block in self.blocks())])

    def _verdict_lines(self) -> list[str]:
        """Return the verdict and its reason, folded to the terminal's width."""
        return folded(f"verdict: {self.quality.grade.upper()}: {self.quality.reason}", screen_width())

    def _errors(self) -> screen.Block:
        """Return the table of errors on held-out rows, one row per model."""
        figures = ("RMS", "mean", "95 % interval", "p95", "max")
        header: tuple[str, ...] = ("model", *(f"{name} ({self.miss_unit})" for name in figures))
        header += ("attitude mean (deg)",) if self.attitude else ()
        nominal = "nominal" if self.known_frames else "nominal, base and tool fitted"
        labels = {fitting.NOMINAL: nominal, fitting.GEOMETRIC: "geometry"}
        rows = []
        for name, s in self.position.items():
            if name == fitting.NOMINAL and not self.has_nominal:
                continue
            turned = (screen.figure(self.attitude[name].mean),) if name in self.attitude else ()
            rows.append((labels.get(name, name), *screen.error_cells(s), *turned))
        note = f"{self.held_out.text(len(self.test.joints), len(self.train.joints))}; used: {self.best_model}"
        return screen.Block(f"Errors on held-out {self.held_out.rows}", header, tuple(rows), note, "errors")

    @property
    def clocks(self) -> tuple[Clocks, ...]:
        """The fitted clocks of the recordings from which the rows were read; empty if the rows are no recordings."""
        return origins_of(self.train).clocks

    @cached_property
    def set_ups(self) -> list[dict[str, Any]]:
        """The set-ups of the files, that is placements of instrument and target, as values for JSON (`set_ups_of`).

        Empty if there is only one file.
        """
        return instrument.set_ups_of(self.geometric.identification, self.train)

    def parameters(self) -> list[dict[str, Any]]:
        """Return each fitted parameter: its name, its unit, its change and its standard deviation, in that unit.

        The change is relative to the nominal geometry. For an unknown of the instrument, the value takes its place.
        ``prior_std`` is the standard deviation before measuring. ``narrowed`` is the share, 0 to 1, by which the rows
        have narrowed the prior. Both are None if the parameter had no prior.
        """
        solution, model = self.fit.identification, self.fit.calibration.model
        changes = ArmModel.of(self.fit.calibration.nominal, model.terms).difference(model)
        change = dict(zip(model.parameter_names, changes, strict=True)) | solution.unknowns
        rows, identified = [], solution.identifiability
        columns = zip(identified.names, solution.standard_deviation, solution.prior_std, solution.narrowed, strict=True)
        for name, std, before, narrowed in columns:
            if name not in identified.kept_names:
                continue
            unit, scale = screen.unit_of(name, model.geometry.parameter_names)
            row = {"name": name, "unit": unit, "change": float(change[name] * scale), "std": float(std * scale)}
            proper = np.isfinite(before)
            row["prior_std"] = float(before * scale) if proper else None
            row["narrowed"] = float(narrowed) if proper else None
            rows.append(row)
        return rows

    def plain_parameters(self) -> list[dict[str, Any]]:
        """Return the entries of `parameters` except those with separate tables.

        Harmonics, compliances, and the frames of further set-ups are left out. Changes of these frames say nothing,
        because their starting values are arbitrary.
        """
        return [row for row in self.parameters() if not re.match(r"periodic|compliance|(base|tool)\d", row["name"])]

    def _parameters(self) -> screen.Block:
        """Return the table of the parameters that moved (`has_moved`)."""
        every, rows = self.plain_parameters(), []
        for row in filter(has_moved, every):
            share = "" if row["narrowed"] is None else f"{100 * row['narrowed']:.0f} %"
            rows.append((row["name"], screen.figure(row["change"]), screen.figure(row["std"]), row["unit"], share))
        heads = ("parameter", "change", "± 1 sigma", "unit", "told by the rows")
        note = f"those of {len(every)} that moved by more than {SIGMAS:g} sigma; {self.prior_text}"
        return screen.Block("Parameters", heads, tuple(rows), note)

    @property
    def prior_text(self) -> str:
        """Text that names the prior of the parameters, with the factors on its standard deviations."""
        prior = self.geometric.identification.prior
        if prior is None or not prior.proper:
            return "nothing was expected of them beforehand"
        scales = ", ".join(f"{name} times {screen.figure(scale)}" for name, scale in prior.scales.items())
        return f"expected beforehand: {prior.source}" + (f", the widths of {scales}" if scales else "")

    def _gate(self) -> screen.Block:
        """Return the table of the verdicts on residual models."""
        rows = [("without", screen.figure(self.gate[0].geometric_blocked_rms * 1e3), "")]
        for v in self.gate:
            rows.append((v.model, "-" if v.blocked_rms is None else screen.figure(v.blocked_rms * 1e3), v.reason))
        model = selected(self.gate)
        verdict = f"'{model}' is used" if model else "none is used"
        header, note = ("model", "blocked hold-out, RMS (mm)", "verdict"), f"{verdict}; judged within the training rows"
        return screen.Block("Learnt residual models", header, tuple(rows), note, "residual_models")

    def _facts(self) -> screen.Block:
        """Return the table of further facts: kind of measurement, condition number, iterations and clocks."""
        solution = self.geometric.identification
        rows = [
            ("measured", self.train.kind),
            ("condition number of the geometry", screen.figure(self.quality.observability["condition"])),
            (
                "least squares",
                f"{len(solution.residual_rms) - 1} iterations, {screen.figure(1e3 * solution.solve_seconds)} ms",
            ),
        ]
        rows += [("recording", clock.text()) for clock in self.clocks]
        if (repeat := origins_of(self.train).repeat) is not None:
            rows.append(("repeatability of a position by the files", f"{repeat * 1e3:.4f} mm"))
        return screen.Block("Evidence", (), tuple(rows), key="evidence")

    def as_dict(self) -> dict[str, Any]:
        """Return the result as values for JSON."""
        solution = self.geometric.identification
        prior, unit, over = solution.prior, self.miss_unit, self.quality.workspace
        nominal, geometric, best = self.position[fitting.NOMINAL], self.position[fitting.GEOMETRIC], self.best
        held_out: dict[str, Any] = {
            f"nominal_rms_{unit}": nominal.rms,
            f"geometric_rms_{unit}": geometric.rms,
            f"geometric_mean_{unit}": geometric.mean,
            f"geometric_mean_ci95_{unit}": geometric.mean_ci95,
            f"best_rms_{unit}": best.rms,
            f"best_mean_{unit}": best.mean,
            f"best_mean_ci95_{unit}": best.mean_ci95,
            f"own_mean_ci95_{unit}": self.own_mean_ci95,
            "best_model": self.best_model,
            "how": self.held_out.text(len(self.test.joints), len(self.train.joints)),
            **{f"{name}_{unit}": statistics.as_dict() for name, statistics in self.position.items()},
            **{f"{name}_deg": statistics.as_dict() for name, statistics in self.attitude.items()},
        }
        terms = None
        if self.terms is not None:
            names, blocked_rms, _ = self.terms
            tried = {name: value * MISS_UNITS[unit] for name, value in blocked_rms.items()}
            terms = {"chosen": names, f"blocked_rms_{unit}": tried}
        return {
            "verdict": self.quality.as_dict(),
            "arm": self.arm.name,
            "unit": self.unit,
            "kind": solution.kind,
            "frames": "known" if self.known_frames else "fitted",
            "within95": {name: self.uncertainty.factors.get(name) for name in QUANTITIES},
            "within95_by_pose": self.uncertainty.bounds(self._within95),
            "base_frame": None if self.base_frame is None else self.base_frame.as_dict(),
            "stations": self.set_ups,
            "rows": {"train": len(self.train.joints), "test": len(self.test.joints)},
            "left_out_rows": [vars(item) for item in self.left_out],
            "parameters": len(solution.identifiability.names),
            "rank": solution.identifiability.rank,
            "parameters_told": solution.spent,
            "changes": self.parameters(),
            "dropped": solution.identifiability.dropped,
            "workspace": None if over is None else over.as_dict(),
            "prior": None if prior is None else {"source": prior.source, "scales": dict(prior.scales)},
            "condition": self.quality.observability["condition"],
            "converged": self.fit.identification.converged,
            "iterations": len(solution.residual_rms) - 1,
            "solve_seconds": solution.solve_seconds,
            "held_out": held_out,
            "repeat_mm": None if (repeat := origins_of(self.train).repeat) is None else repeat * 1e3,
            "recordings": [clock.as_dict() for clock in self.clocks],
            "terms": terms,
            "harmonics": {"note": screen.OWN, "found": self.harmonics} if self.harmonics else None,
            "stiffnesses": self.stiffnesses or None,
            "gate": verdicts_record(self.gate),
            **(self.pixels or {}),
        }


WORKSPACE_POSES, TRIALS = 400, 200_000
"""Number of joint vectors that represent a workspace, and number of draws to find such vectors within a box."""
LEAST_TARGETS = 8
"""Least number of targets that represent a workspace. They give twice the equations that base and tool explain."""


def workspace_joints(text: str | Path | None, geometry: Geometry, frames: str | None = None) -> tuple[str, Array]:
    """Return a workspace's name, and joints ``(M, n)``, rad or m, that represent it.

    Random joints are drawn with a fixed seed, so equal inputs give equal joints.

    Args:
        text: A file of targets (joints or tool poses in pickenv's own columns), or ranges joined by commas. Ranges of
            joints are in deg or mm (``q1=-90:90``). Ranges of the tool's position in the controller's base frame are in
            mm (``x=300:900``). Joints without a range move within their limits. None for all poses within the limits.
        geometry: The arm's nominal geometry.
        frames: Whether base and tool are "known", as in `Choices.frames`; then a file may have any number of targets.

    Raises:
        InputError: If a range cannot be read, the arm hardly reaches anything in it, or a file has too few targets.
    """
    rng = np.random.default_rng(0)
    if text is None:
        return "the joint limits", random_joints(geometry, WORKSPACE_POSES, rng)
    if "=" not in str(text):
        joints = joints_of(read_targets(text, geometry), geometry)
        if len(joints) < LEAST_TARGETS and frames != "known":
            few = f"{len(joints)} targets are no workspace; give {LEAST_TARGETS} or more"
            raise InputError(f"{text}: {few}, or `frames='known'` if base and tool are not fitted")
        return f"the targets of {text}", joints[equally_spaced(len(joints), WORKSPACE_POSES)]
    axes = [*(name.split("_")[0] for name in joint_columns(geometry.prismatic)), "x", "y", "z"]
    units = [1e-3 if slides else np.radians(1.0) for slides in (*geometry.prismatic, True, True, True)]
    bounds = np.array([*zip(geometry.lower, geometry.upper, strict=True), *[(-np.inf, np.inf)] * 3])
    for part in map(str.strip, str(text).split(",")):
        name, _, ends = part.partition("=")
        try:
            low, high = (float(end) for end in ends.split(":"))
        except ValueError:
            raise InputError(f"workspace '{part}' is no range; write q1=-90:90 (deg or mm) or x=300:900 (mm)") from None
        if not low < high:
            raise InputError(f"workspace '{part}' is empty; give the lower end first")
        if name not in axes:
            raise InputError(f"workspace '{part}' names no joint or axis; give some of {', '.join(axes)}")
        i = axes.index(name)
        bounds[i] = max(low * units[i], bounds[i, 0]), min(high * units[i], bounds[i, 1])
        if not bounds[i, 0] < bounds[i, 1]:
            raise InputError(f"workspace '{part}' lies outside the limits of {[*geometry.joint_names, *'xyz'][i]}")
    (lower, upper), box = bounds[:-3].T, bounds[-3:]
    joints = rng.uniform(lower, upper, (TRIALS if np.isfinite(box).any() else WORKSPACE_POSES, geometry.joints))
    if np.isfinite(box).any():
        place = forward(geometry, joints).position
        joints = joints[((place >= box[:, 0]) & (place <= box[:, 1])).all(axis=1)][:WORKSPACE_POSES]
        if len(joints) < 10:
            raise InputError(
                f"the arm reaches hardly anything within workspace '{text}'; check its axes, in mm from the base"
            )
    return f"workspace {text}", joints


# A calibration judged on rows that it never saw: everything that a result says is worked out here.


def assess(
    arm: Arm,
    fit: fitting.Fit,
    train: Observations,
    test: Observations,
    *,
    fits: Mapping[str, fitting.Fit] | None = None,
    held_out: fitting.HeldOut | None = None,
    left_out: tuple[diagnosis.LeftOut, ...] = (),
    workspace: tuple[str, Array] | None = None,
) -> Result:
    """Judge a calibration on held-out rows.

    Args:
        arm: The arm.
        fit: The fit whose calibration is used.
        train: The rows that the calibration was fitted to.
        test: The held-out rows.
        fits: The fits by name, in order. The first fits the geometry alone, each further one adds terms or a residual
            model, and the last is ``fit``. If None, they are ``fit`` without and with its learnt residual.
        held_out: Errors on the held-out rows; if None, they are computed from ``fits``.
        left_out: Outlier rows.
        workspace: Name of the workspace where the arm will work, and joints ``(M, n)``, rad or m, that represent it.
            If None, all poses within the joint limits.
    """
    learnt = fit.calibration.learnt
    if fits is None:
        fits = {fitting.GEOMETRIC: replace(fit, calibration=fit.calibration.without_residual())}
        fits |= {} if learnt is None else {f"geometry+{learnt.kind}": fit}
    bare = next(iter(fits.values()))
    aligned = bare.aligned
    held_out = held_out or fitting.held_out_of(fits, test)
    after = list(held_out.errors.values())[-1]
    before = None if arm.name == CARRIER else held_out.errors[fitting.NOMINAL]
    if train.poses is not None:
        words = "stated noise" if train.poses.std_stated else "noise assumed, since none is stated,"
        noise = f"{words} of {train.poses.position_std * 1e3:.4g} mm"
    else:
        stated = bool(train.stations) and all(getattr(part, "std_stated", False) for part in train.parts)
        noise = "stated noise" if stated else "noise stated or assumed"
    sure, unlearnt = fitting.pose_uncertainties(fit, held_out, train, test)
    base_frame = None
    rows = len(train.joints) + (held_out.blocks is None) * len(test.joints)
    if aligned is not None and arm.nominal.tree is None:
        remaining, tracked = after, fitting.tracked_rows(fit.identification, test) is not None
        if not tracked:  # then the misses are not one per row: any may go with any pose
            places = np.random.default_rng(0).integers(0, len(after), len(test.joints))
            remaining = np.pad(after, ((0, 0), (0, 3 - min(after.shape[1], 3))))[places]
        if train.miss_unit != "mm":
            remaining = np.full_like(remaining, np.nan)
        base_frame = instrument.base_frame_error(arm.nominal, bare.calibration.nominal, test.joints, remaining, tracked)
    pixels = None if train.views is None else fitting.pixel_figures(bare, train.views, held_out)
    name, region = workspace or workspace_joints(None, arm.nominal)
    remains = position_rms(after) if train.miss_unit == "mm" else 0.0
    between = train.conditions.between
    over = workspace_error(fit.identification, bare.calibration.nominal, train.joints, region, name, remains, between)
    model = fitted_model(arm.name, bare.calibration.nominal, aligned is None)
    quality = grade_quality(
        fit.identification,
        fitting.missed_by(fit.identification, train),
        before,
        after,
        over,
        geometric=bare.identification,
        parametric=held_out.parametric,
        blocks=test.rows_of_misses if held_out.blocks is None else held_out.blocks,
        noise=noise,
        said=(
            *instrument.said_against(bare.identification, train),
            *diagnosis.said_of_repeats(train, test if held_out.blocks is None else test.select(np.arange(0))),
            *diagnosis.said_of_rows(left_out, rows + sum(not item.kept for item in left_out)),
            *diagnosis.said_of_files(left_out, (train, test)),
            *diagnosis.said_of_stations(bare.identification, train),
            *diagnosis.said_of_moves(bare.identification, train),
            *instrument.said_of_instruments(model, bare.identification, train),
            *instrument.said_of_conditions(
                fit.calibration.model, learnt is not None and learnt.inputs.conditions > 0, train
            ),
        ),
        unit=train.miss_unit,
        rows=(len(test.joints), held_out.rows),
    )
    return Result(
        arm, fit, bare, train, test, held_out, quality, sure, base_frame, unlearnt, left_out=left_out, pixels=pixels
    )
