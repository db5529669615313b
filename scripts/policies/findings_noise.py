"""Open loop calibrated against closed loop raw: who wins at which camera noise. Part of `findings.py`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pickenv.agents.evaluation.grid import GridSettings, PolicyGrid
from pickenv.agents.evaluation.grid_tables import with_interval
from pickenv.agents.evaluation.rollout import roll_out
from pickenv.agents.policies.scripted import ServoReach
from pickenv.arm.kinematics.geometry import Array
from pickenv.inspect.colours import policy_colours, policy_label
from pickenv.inspect.figures.style import WIDTH, new_figure, plain_decades, rgb
from pickenv.intervals import Ends, mean_interval, statistic_interval

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GAINS = (1.0, 0.3, 0.1)
SWEPT = {"qiao2026": GAINS, "field": GAINS[-1:]}
"""Gains of the servo by plant; on `field` only that which averages most."""
RMSE_MM = np.array([0.01, 0.03, 0.1, 0.3, 1.0, 2.0, 4.0, 6.0, 10.0])
"""RMSE of the camera in space: sqrt(3) times its standard deviation per axis."""
CAMERA_MM = 6.0
"""Azure Kinect outdoors at 1.5 m."""


@dataclass(frozen=True, eq=False)
class Noise:
    """Mean errors of each arm, mm.

    Attributes:
        plant: The plant.
        open_loop: By compensation ``(arms,)``; the fruit's position is known.
        servo: By gain, raw arms ``(arms, N)``, for each of `RMSE_MM`; the fruit's position is known.
    """

    plant: str
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


def run_noise(settings: GridSettings, grid: PolicyGrid, plant: str, gains: tuple[float, ...]) -> Noise:
    """Sweep the camera's noise on raw arms of a plant, once for each gain of the servo."""

    def errors(gain: float, rmse: float) -> Array:
        found = roll_out(
            lambda env, seed: ServoReach(env, gain=gain),
            settings.arms,
            settings.episodes,
            settings.seed,
            plant=plant,
            tolerances=settings.tolerances,
            population_seed=settings.population_seed,
            feedback="camera",
            camera_noise_mm=float(rmse / np.sqrt(3.0)),
        )
        return found.reaches.position_error_mm.reshape(-1, settings.arms).mean(axis=0)

    cells = {key: grid.cell("scripted", key, "encoders", plant) for key in grid.settings.compensations}
    return Noise(
        plant=plant,
        open_loop={key: cell.errors_mm.mean(axis=(1, 2)) for key, cell in cells.items()},
        servo={gain: np.stack([errors(gain, rmse) for rmse in RMSE_MM], axis=1) for gain in gains},
    )


def noise_figure(swept: list[Noise]) -> Figure:
    """Mean error against the camera's RMSE, with the crossings and their intervals, a panel for each plant."""
    keys = list(swept[0].open_loop)
    colours = dict(zip(keys, rgb(policy_colours(keys)), strict=True))
    lines = dict(zip(GAINS, (":", "--", "-"), strict=True))
    with new_figure(WIDTH, 3.6) as figure:
        panels: Any = figure.subplots(1, len(swept), sharey=True, squeeze=False)[0]
        for axes, noise in zip(panels, swept, strict=True):
            for key, values in noise.open_loop.items():
                axes.axhline(values.mean(), color=colours[key])
            for gain, errors in noise.servo.items():
                axes.plot(RMSE_MM, errors.mean(axis=0), lines[gain], color="0.2")
                for key, values in noise.open_loop.items():
                    found = noise.crossing(gain, key)
                    if found is not None:
                        axes.plot([found[0]], [values.mean()], "o", color=colours[key], markersize=4)
                        if found[1] is not None:
                            axes.plot(found[1], [values.mean()] * 2, color=colours[key], linewidth=4.0, alpha=0.5)
            axes.axvline(CAMERA_MM, color="0.8", zorder=0)
            axes.set(xscale="log", yscale="log", xlabel="RMSE of the camera (mm)", title=noise.plant)
            plain_decades(axes.xaxis)
            plain_decades(axes.yaxis)
        panels[0].set_ylabel("mean position error (mm)")
        handles = [
            panels[0].plot([], [], color=colours[key], label=f"open loop, {policy_label(key)}")[0] for key in keys
        ]
        handles += [
            panels[0].plot([], [], line, color="0.2", label=f"servo, raw, gain {gain:g}")[0]
            for gain, line in lines.items()
        ]
        camera = f"a camera of {CAMERA_MM:g} mm"
        handles.append(panels[0].plot([], [], color="0.8", linewidth=2.0, label=camera)[0])
        figure.legend(handles=handles, loc="outside lower center", ncols=4)
    return figure


def noise_sentence(swept: list[Noise]) -> str:
    """What the figure says."""
    return (
        f"With a camera of {CAMERA_MM:g} mm RMSE a servo on raw arms that averages its pictures (gain {GAINS[-1]:g}) "
        f"leaves, against the arm calibrated and blind, {'; '.join(map(_said_of, swept))}. A camera's bias cannot be "
        "averaged and is not in this study."
    )


def at_camera(noise: Noise) -> Array:
    """What the servo that averages most leaves of each arm ``(arms,)``, mm, with a camera of `CAMERA_MM`."""
    return noise.servo[GAINS[-1]][:, int(np.argmin(np.abs(RMSE_MM - CAMERA_MM)))]


def _said_of(noise: Noise) -> str:
    """One plant in words."""
    servo, ls = at_camera(noise), noise.open_loop["ls"]
    wins = [f"{_said(noise.crossing(GAINS[-1], key))} mm against {policy_label(key)}" for key in ("ls", "best")]
    return (
        f"on `{noise.plant}` {with_interval(float(servo.mean()), mean_interval(servo), 2)} mm against "
        f"{with_interval(float(ls.mean()), mean_interval(ls), 2)} mm of LS, and wins with a camera better than "
        f"{' and '.join(wins)}"
    )


def noise_tables(swept: list[Noise]) -> list[str]:
    """The crossings."""
    keys = [key for key in swept[0].open_loop if key != "raw"]
    heads = " | ".join(f"against {policy_label(key)}" for key in keys)
    lines = [
        f"Open loop against servo on raw arms, {len(swept[0].open_loop['raw'])} arms per plant: RMSE of the camera "
        "(mm) at which both leave the same mean error, 95 % interval over arms; with a better camera the servo wins.",
        "",
        f"| plant | servo's gain | {heads} | servo at {CAMERA_MM:g} mm (mm) |",
        "|---|---|" + "---|" * (len(keys) + 1),
    ]
    at = int(np.argmin(np.abs(RMSE_MM - CAMERA_MM)))
    for noise in swept:
        for gain, errors in noise.servo.items():
            servo = errors[:, at]
            found = " | ".join(_said(noise.crossing(gain, key)) for key in keys)
            left = with_interval(float(servo.mean()), mean_interval(servo), 2)
            lines.append(f"| {noise.plant} | {gain:g} | {found} | {left} |")
    return [*lines, ""]


def _said(crossing: tuple[float, Ends | None] | None) -> str:
    return "outside the sweep" if crossing is None else with_interval(*crossing, 2)
