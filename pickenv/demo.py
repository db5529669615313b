"""Demonstrate Qiao 2026's protocol in simulation: calibrate the arm, compensate it, pick, and measure the error.

Measurements at 100 poses identify the geometry, at 200 poses they train the network, and at 100 poses they test both.
Then the same scripted policy reaches for the same seeded fruit three times: with the arm raw, calibrated by least
squares (LS), and calibrated by least squares and network (LS+BPNN).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

import pickenv
from pickenv.agents import Reaches, ScriptedReach, episode_seeds, run_reaches
from pickenv.arm import Array, Plant, forward, load_plant, noncompensable_error, pose_error
from pickenv.base import absent_extras, command_line, share_interval, write_json, write_text
from pickenv.calibration import BpnnSettings, Compensator, Measurements, Result, error_statistics, fit, held_out_r2
from pickenv.experiments.engine import Progress
from pickenv.experiments.gains import FIELD, ROWS, BlockedGain, blocked_gains, grid_joints, measured_gains, random_sets
from pickenv.inspect import Comparison, Run
from pickenv.inspect.colours import policy_label
from pickenv.inspect.runs.comparison_summary import Change, gripped, matters, pick_changes
from pickenv.inspect.runs.recorded_episodes import ended, field_grid
from pickenv.inspect.runs.run_folder import MATTERS_FILE, recorded_run, save_part
from pickenv.inspect.runs.traces import CalibrationTrace, trace_of
from pickenv.orchard import misalignment
from pickenv.wrappers import CompensationWrapper

OTHER = "orchard"
"""Preset of a simulated arm with every effect, on which the demonstration shows how least squares changes picks."""

PLANT, POSES = "qiao2026", {"identification": 100, "network": 200, "test": 100}
"""The simulated arm, and the numbers of poses by their purpose, as in the paper."""

TOLERANCES = (1.0, 10.0)
"""Largest position error, mm, and attitude error, deg, of a successful reach. Position is judged more strictly than by
any gripper: the raw arm's error would be within the 5 mm that Li's cup tolerates."""

Compensators = dict[str, Compensator | None]
"""Compensators by policy; None if commands go to the arm unchanged."""


@dataclass(frozen=True)
class DemoSettings:
    """Sizes of the demonstration; the defaults are the paper's protocol.

    Attributes:
        seed: Seed of all random numbers.
        reaches: Number of fruit to reach for.
        epochs: Training epochs of the network.
        grid_step: Cell size of the error field, m.
        gain_poses: Number of poses on a grid, for judging a network's gain on held-out contiguous parts of the grid; 0
            does not judge the gain.
        network: Whether a network learns the residuals of least squares, which needs torch.
    """

    seed: int = 0
    reaches: int = 100
    epochs: int = 500
    grid_step: float = 0.1
    gain_poses: int = ROWS
    network: bool = True

    @staticmethod
    def quick(seed: int) -> DemoSettings:
        """Return settings of a shorter run for trying things out, with worse results than the paper's protocol."""
        return DemoSettings(seed=seed, reaches=20, epochs=100, grid_step=0.2)

    @property
    def is_quick(self) -> bool:
        """Whether these are the settings of `quick`, with or without network."""
        return replace(self, network=True) == DemoSettings.quick(self.seed)

    def command(self) -> str:
        """Return the command line that computes the same numbers, or the call of `run_demo` if no command line does."""
        if not self.is_quick and replace(self, network=True) != DemoSettings(self.seed):
            return f"run_demo({self!r})"
        return command_line("pickenv", "demo", seed=self.seed, quick=self.is_quick, no_network=not self.network)


@dataclass(frozen=True, eq=False)
class DemoResult:
    """All results of the demonstration.

    Attributes:
        settings: The settings of the run.
        plant: The plant, that is the simulated true arm with its errors.
        calibrated: The calibration, and the errors that it leaves at the test poses.
        sets: Measurements by purpose: "identification" for least squares, "network" for its training, "test" held out.
        test_errors: For each policy ("raw", "ls" and so on), the tool's true pose minus the wanted pose at the N test
            poses ``(N, 6)``, m and rad.
        reaches: For each policy, the final states of its reaches.
        comparison: Reaches and error field, for recording and figures.
        gains: Share of the error that a network removes on held-out contiguous rows, for arms drawn from `plant`, and
            for arms drawn from the preset "field".
        cases: For `plant` and for the preset `OTHER`, by name, how calibration changes picks.
    """

    settings: DemoSettings
    plant: Plant
    calibrated: Result
    sets: dict[str, Measurements]
    test_errors: dict[str, Array]
    reaches: dict[str, Reaches]
    comparison: Comparison
    gains: list[BlockedGain]
    cases: dict[str, list[Change]]


def run_demo(settings: DemoSettings, progress: Progress | None = None) -> DemoResult:
    """Run the protocol and return its results; no file is written.

    Args:
        settings: Sizes and seed.
        progress: Called with (stage, done, total).
    """
    report = progress or (lambda stage, done, total: None)
    plant = load_plant(PLANT)
    of_poses, of_network, of_grid, *of_gains, of_case = np.random.SeedSequence(settings.seed).spawn(6)
    measured = random_sets(plant, tuple(POSES.values()), np.random.default_rng(of_poses))
    sets = dict(zip(POSES, measured, strict=True))
    report("measuring", 1, 1)
    choices = pickenv.Choices(fit="full", terms="none", residual="none", frames="known")  # as the paper does
    if settings.network:
        learning = BpnnSettings(epochs=settings.epochs)
        choices = replace(choices, residual="bpnn", learn_from=sets["network"], settings=learning)
    learn = np.random.default_rng(of_network)
    rows, test = sets["identification"], sets["test"]
    result = pickenv.calibrate(plant.arm, rows, test=test, choices=choices, rng=learn, progress=report)
    calibration = result.calibration
    compensators: Compensators = {"raw": None, "ls": calibration.compensator(with_residual=False)}
    if calibration.learnt is not None:
        compensators["ls_bpnn"] = calibration.compensator()
    reaches = _reaches(settings, compensators, report)
    gains: list[BlockedGain] = []
    if settings.gain_poses and settings.network:
        joints = grid_joints(plant.arm.nominal, settings.gain_poses, np.random.default_rng(of_grid))
        gains = blocked_gains(dict(zip((PLANT, FIELD), of_gains, strict=True)), joints, progress=report)
    comparison = _comparison(settings, plant, result, compensators, reaches)
    lateral = [lateral_mm for lateral_mm, _ in gripped(comparison).values()]
    cases = {plant.name: pick_changes(lateral[0], lateral[-1])}
    cases[OTHER] = _other_case(settings, np.random.default_rng(of_case))
    test_errors = {key: _errors(plant, test.joints, compensator) for key, compensator in compensators.items()}
    return DemoResult(settings, plant, result, sets, test_errors, reaches, comparison, gains, cases)


def _reaches(settings: DemoSettings, compensators: Compensators, report: Progress) -> dict[str, Reaches]:
    """Run the same reaches with every policy, and return their final states by policy.

    ``report`` is called with (stage, reaches done, total).
    """
    reaches, seeds, (radius, angle) = {}, episode_seeds(settings.seed, settings.reaches), TOLERANCES
    total = len(compensators) * len(seeds)
    for number, (key, compensator) in enumerate(compensators.items()):
        env: Any = gym.make("pickenv/Reach-v0", plant=PLANT, tolerance_mm=radius, angle_tolerance_deg=angle)
        env = env if compensator is None else CompensationWrapper(env, compensator)

        def reached(done: int, earlier: int = number * len(seeds)) -> None:
            report("reaching", earlier + done, total)

        reaches[key] = run_reaches(env, ScriptedReach(env), seeds, reached)
    return reaches


def _errors(plant: Plant, joints: Array, compensator: Compensator | None) -> Array:
    """Return the true tool poses minus the nominal ones at ``joints (N, n)``: ``(N, 6)``, m and rad.

    The true arm's drives get the joints as ``compensator`` corrects them, or unchanged if it is None.
    """
    command = joints if compensator is None else compensator(joints)
    return pose_error(forward(plant.arm.nominal, joints), plant.tool_pose(command))


def _other_case(settings: DemoSettings, rng: np.random.Generator) -> list[Change]:
    """Return how a calibration by least squares changes picks on the simulated arm `OTHER`.

    The picks are at upright tool poses on a regular grid, with the arm at rest.
    """
    plant = load_plant(OTHER)
    nominal = plant.arm.nominal
    (poses,) = random_sets(plant, (POSES["identification"],), rng)
    compensator = fit(plant.arm, poses, known_frames=True).calibration.compensator(with_residual=False)
    joints = field_grid(nominal, settings.grid_step, settings.seed).joints
    target = forward(nominal, joints)
    lateral: list[Array] = []
    for command in (joints, compensator(joints)):
        true = plant.tool_pose(command)
        axis = true.rotation[..., 2]
        lateral.append(1e3 * misalignment(target.position - true.position, axis, target.rotation[..., 2])[0])
    return pick_changes(lateral[0], lateral[1])


def _comparison(
    settings: DemoSettings, plant: Plant, result: Result, compensators: Compensators, reaches: dict[str, Reaches]
) -> Comparison:
    """Return what pictures and recording show: the error field on a regular grid of upright tool poses, and reaches.

    ``result`` is the calibration's result; ``compensators`` and ``reaches`` have one entry per policy.
    """
    grid = field_grid(plant.arm.nominal, settings.grid_step, settings.seed)
    return Comparison(
        policies=tuple(
            ended(policy_label(key), reaches[key], key).with_field(_errors(plant, grid.joints, compensator))
            for key, compensator in compensators.items()
        ),
        plant=plant,
        tolerance_mm=TOLERANCES[0],
        seed=settings.seed,
        seeds=reaches["raw"].seeds,
        grid=grid,
        field_uncertainty=result.uncertainty.standard(result.calibration.model, grid.joints)[0],
    )


def summarise(result: DemoResult) -> dict[str, Any]:
    """Return the numbers of a demonstration as a mapping for JSON, which is written as `summary.json`."""
    settings, calibration = result.settings, result.calibrated.calibration
    rank = result.calibrated.fit.identification.identifiability
    policies, r2 = {}, None
    for key, ends in result.reaches.items():
        policies[key] = _figures(ends.pose_error, ends.noncompensable)
        policies[key]["success_rate"] = float(ends.success.mean())
        policies[key]["success_ci95"] = share_interval(int(ends.success.sum()), len(ends.success))
    test, geometry = result.sets["test"], result.plant.geometry
    errors = {key: _figures(e, noncompensable_error(geometry, test.joints, e)) for key, e in result.test_errors.items()}
    if calibration.learnt is not None:
        values = held_out_r2(test.difference(calibration.identified), calibration.learnt.predict(test.joints))
        r2 = dict(zip(("x", "y", "z", "rx", "ry", "rz"), map(float, values), strict=True))
    return {
        "seed": settings.seed,
        "network": settings.network,
        "plant": PLANT,
        "tolerance_mm": TOLERANCES[0],
        "attitude_tolerance_deg": TOLERANCES[1],
        "reaches": settings.reaches,
        "quick": settings.is_quick,
        "pickenv": pickenv.__version__,
        "simulated": True,
        "intervals": "over the fruit reached with this one calibration",
        "poses": {name: len(rows) for name, rows in result.sets.items()},
        "matters": [matters(name, changes) for name, changes in result.cases.items()],
        "policies": policies,
        "test_poses": errors,
        "identifiability": {
            "parameters": len(rank.names),
            "rank": rank.rank,
            "dropped": list(rank.dropped),
            "absorbed_by": rank.dropped,
            "condition": rank.condition,
        },
        "blocked": {
            "ranges": "over drawn arms, or 95 % over ten blocks of a measured one",
            "simulated": [asdict(gain) for gain in result.gains],
            "measured": [asdict(arm) for arm in measured_gains()],
        },
        "bpnn_r2": r2,
    }


def _figures(error: Array, impossible: Array) -> dict[str, Any]:
    return {
        "position_mm": error_statistics(error[:, :3] * 1e3).as_dict(),
        "attitude_deg": error_statistics(np.degrees(error[:, 3:])).as_dict(),
        "noncompensable_deg": float(np.degrees(np.linalg.norm(impossible[:, 3:], axis=1)).mean()),
    }


def write_run(result: DemoResult, out: Path, progress: Progress | None = None) -> list[Path]:
    """Write the run folder, and return the files written.

    The folder contains data, calibration and summary. Figures, page and recording are written too, if the extra
    `inspect` is installed. If `inspect` is installed afterwards, `pickenv report` and `pickenv inspect` make the page
    and the recording.

    Args:
        result: Results of `run_demo`.
        out: The run folder.
        progress: Called with (stage, done, total).
    """
    labelled = {policy_label(key): error for key, error in result.test_errors.items()}
    trace, settings = trace_of(result.calibrated.fit, result.sets, labelled), result.settings
    prefixes = {"identification": "", "network": "network_", "test": "test_"}
    with recorded_run(out, "demo", settings.command(), settings.seed) as run:
        written = [rows.write_csv(out / f"{prefixes[name]}measurements.csv") for name, rows in result.sets.items()]
        written += [
            result.calibrated.calibration.save(out / "calibration"),
            save_part(out, result.comparison, settings.seed),
            save_part(out, trace, settings.seed),
            write_json(out / MATTERS_FILE, result.cases),
        ]
        if not absent_extras("inspect"):
            written += _shown(result.comparison, trace, run, progress or (lambda stage, done, total: None))
        written.append(write_json(out / "summary.json", summarise(result)))
    return written


def _shown(comparison: Comparison, trace: CalibrationTrace, run: Run, report: Progress) -> list[Path]:
    """Write figures, recording and page into the folder of ``run``, and return their paths.

    ``report`` is called with (stage, done, total).
    """
    from pickenv.inspect import comparison_drawings, record_comparison, trace_drawings, write_drawings
    from pickenv.inspect.reports.demo_report import page

    drawings = [*comparison_drawings(comparison), *trace_drawings(trace)]
    written = write_drawings(drawings, run.folder / "figures", ("png",), report)
    written.append(record_comparison(comparison, run.folder / "errors.rrd"))
    report("recording", 1, 1)
    written.append(write_text(run.folder / "report.html", page(run)))
    return written
