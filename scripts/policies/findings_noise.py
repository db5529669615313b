"""Open loop calibrated against closed loop raw: who wins at which camera noise. Part of `findings.py`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pickenv.agents.evaluation.grid import GridSettings, PolicyGrid
from pickenv.agents.evaluation.grid_figures import LABELS
from pickenv.agents.evaluation.grid_tables import with_interval
from pickenv.agents.evaluation.rollout import roll_out
from pickenv.agents.policies.servo import ServoReach
from pickenv.arm.kinematics.geometry import Array
from pickenv.inspect.colours import policy_colours
from pickenv.inspect.figures.style import WIDTH, new_figure, plain_decades, rgb
from pickenv.intervals import Ends, mean_interval, statistic_interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GAINS = (1.0, 0.3, 0.1)
RMSE_MM = np.array([0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0, 6.0, 10.0])
"""RMSE of the camera in space: sqrt(3) times its standard deviation per axis."""
CAMERA_MM = 6.0
"""Azure Kinect outdoors at 1.5 m."""


@dataclass(frozen=True, eq=False)
class Noise:
    """Mean errors of each arm, mm.

    Attributes:
        open_loop: By compensation ``(arms,)``; the fruit's position is known.
        servo: By gain, raw arms ``(arms, N)``, for each of `RMSE_MM`; the fruit's position is known.
    """

    open_loop: dict[str, Array]
    servo: dict[float, Array]

    def crossing(self, gain: float, compensation: str) -> tuple[float, Ends | None] | None:
        """RMSE [mm] at which the raw servo is as bad as the open loop, and its interval; None outside the sweep."""
        table = np.column_stack([self.open_loop[compensation], self.servo[gain]])
        found = _log_crossing(table)
        if not np.isfinite(found):
            return None
        ends = statistic_interval(table, _log_crossing)
        return float(np.exp(found)), (float(np.exp(ends[0])), float(np.exp(ends[1]))) if ends else None


def _log_crossing(table: Array) -> float:
    """Of rows (open loop, servo at each RMSE), one per arm: the logarithm of the RMSE where the means cross, or NaN."""
    mean = table.mean(axis=0)
    gap, x = np.log(mean[1:] / mean[0]), np.log(RMSE_MM)
    above = np.flatnonzero((gap[:-1] < 0) & (gap[1:] >= 0))
    if not len(above):
        return float("nan")
    i = int(above[0])
    return float(x[i] - gap[i] * (x[i + 1] - x[i]) / (gap[i + 1] - gap[i]))


def run_noise(settings: GridSettings, grid: PolicyGrid) -> Noise:
    """Sweep the camera's noise on raw arms of the plant qiao2026."""

    def errors(gain: float, rmse: float) -> Array:
        found = roll_out(
            lambda env, seed: ServoReach(env, gain=gain),
            settings.arms,
            settings.episodes,
            settings.seed,
            plant="qiao2026",
            tolerances=settings.tolerances,
            population_seed=settings.population_seed,
            feedback="camera",
            camera_noise_mm=float(rmse / np.sqrt(3.0)),
        )
        return found.reaches.position_error_mm.reshape(-1, settings.arms).mean(axis=0)

    cells = {key: grid.cell("scripted", key, "encoders", "qiao2026") for key in grid.settings.compensations}
    return Noise(
        open_loop={key: cell.errors_mm.mean(axis=(1, 2)) for key, cell in cells.items()},
        servo={gain: np.stack([errors(gain, rmse) for rmse in RMSE_MM], axis=1) for gain in GAINS},
    )


def noise_figure(noise: Noise) -> Figure:
    """Mean error against the camera's RMSE, with the crossings and their intervals."""
    keys = list(noise.open_loop)
    colours = dict(zip(keys, rgb(policy_colours(keys)), strict=True))
    with new_figure(WIDTH, 3.2) as figure:
        axes: Any = figure.subplots()
        for key, values in noise.open_loop.items():
            axes.axhline(values.mean(), color=colours[key], label=f"open loop, {LABELS[key]}")
        for line, gain in zip(("-", "--", ":"), GAINS, strict=True):
            axes.plot(RMSE_MM, noise.servo[gain].mean(axis=0), line, color="0.2", label=f"servo, raw, gain {gain:g}")
            for key, values in noise.open_loop.items():
                found = noise.crossing(gain, key)
                if found is not None:
                    axes.plot([found[0]], [values.mean()], "o", color=colours[key], markersize=4)
                    if found[1] is not None:
                        axes.plot(found[1], [values.mean()] * 2, color=colours[key], linewidth=4.0, alpha=0.5)
        axes.axvline(CAMERA_MM, color="0.8", zorder=0)
        axes.set(xscale="log", yscale="log", xlabel="RMSE of the camera (mm)", ylabel="mean position error (mm)")
        plain_decades(axes.xaxis)
        plain_decades(axes.yaxis)
        figure.legend(loc="outside right center")
    return figure


def noise_sentence(noise: Noise) -> str:
    """What the figure says."""
    at = int(np.argmin(np.abs(RMSE_MM - CAMERA_MM)))
    servo, ls = noise.servo[GAINS[-1]][:, at], noise.open_loop["ls"]
    return (
        f"With a camera of {CAMERA_MM:g} mm RMSE a servo on raw arms that averages its pictures (gain {GAINS[-1]:g}) "
        "leaves "
        f"{with_interval(float(servo.mean()), mean_interval(servo), 2)} mm and the arm calibrated by least squares, "
        "blind, "
        f"{with_interval(float(ls.mean()), mean_interval(ls), 2)} mm; with a camera better than "
        f"{_said(noise.crossing(GAINS[-1], 'ls'))} mm the servo wins. A camera's bias cannot be averaged and is not in "
        "this study."
    )


def noise_tables(noise: Noise) -> list[str]:
    """The crossings."""
    keys = [key for key in noise.open_loop if key != "raw"]
    lines = [
        f"Open loop against servo on raw arms of `qiao2026`, {len(noise.open_loop['raw'])} arms: RMSE of the camera "
        "(mm) "
        "at which both leave the same mean error, 95 % interval over arms; with a better camera the servo wins.",
        "",
        "| servo's gain | "
        + " | ".join(f"against {LABELS[key]}" for key in keys)
        + f" | servo at {CAMERA_MM:g} mm (mm) |",
        "|---|" + "---|" * (len(keys) + 1),
    ]
    at = int(np.argmin(np.abs(RMSE_MM - CAMERA_MM)))
    for gain in GAINS:
        servo = noise.servo[gain][:, at]
        found = [_said(noise.crossing(gain, key)) for key in keys]
        lines.append(
            f"| {gain:g} | " + " | ".join(found) + f" | {with_interval(float(servo.mean()), mean_interval(servo), 2)} |"
        )
    return [*lines, ""]


def _said(crossing: tuple[float, Ends | None] | None) -> str:
    return "outside the sweep" if crossing is None else with_interval(*crossing, 2)
