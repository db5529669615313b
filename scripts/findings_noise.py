"""Open loop calibrated against closed loop raw: who wins at which camera noise. Part of `scripts/findings.py`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from pickenv.agents.evaluation.grid import GridSettings, PolicyGrid
from pickenv.agents.evaluation.grid_figures import LABELS, colour
from pickenv.agents.evaluation.rollout import roll_out
from pickenv.agents.policies.scripted import ScriptedReach
from pickenv.agents.policies.servo import ServoReach
from pickenv.arm.kinematics.geometry import Array
from pickenv.inspect.figures.style import WIDTH, new_figure, plain_decades

if TYPE_CHECKING:
    from matplotlib.figure import Figure

GAINS = (1.0, 0.3, 0.1)
RMSE_MM = np.array([0.05, 0.2, 0.5, 1.0, 2.0, 4.0, 6.0, 10.0, 20.0])
"""RMSE of the camera in space: sqrt(3) times its standard deviation per axis."""
CAMERA_MM = 6.0
"""Azure Kinect outdoors at 1.5 m."""


@dataclass(frozen=True, eq=False)
class Noise:
    """Mean errors of the sweep.

    Attributes:
        open_loop: By compensation, with the fruit's position known.
        servo: By gain, raw arms, one per entry of `RMSE_MM`, with the fruit's position known.
        same_open: Open loop, raw and best, where the same camera also gives the fruit's position.
        same_servo: The servo of the smallest gain with that camera.
    """

    open_loop: dict[str, float]
    servo: dict[float, Array]
    same_open: dict[str, Array]
    same_servo: Array

    def crossing(self, gain: float, compensation: str) -> float | None:
        """RMSE [mm] at which the raw servo is as bad as the calibrated open loop; None if that is outside the sweep."""
        gap = np.log(self.servo[gain] / self.open_loop[compensation])
        above = np.flatnonzero((gap[:-1] < 0) & (gap[1:] >= 0))
        if not len(above):
            return None
        i = int(above[0])
        share = -gap[i] / (gap[i + 1] - gap[i])
        x = np.log(RMSE_MM)
        return float(np.exp(x[i] + share * (x[i + 1] - x[i])))


def run_noise(settings: GridSettings, grid: PolicyGrid) -> Noise:
    """Sweep the camera's noise on raw arms of the plant qiao2026."""
    common: dict[str, Any] = {
        "plant": "qiao2026",
        "tolerances": settings.tolerances,
        "population_seed": settings.population_seed,
        "feedback": "camera",
    }

    def error(gain: float | None, rmse: float, *, fruit: bool) -> float:
        std = float(rmse / np.sqrt(3.0))
        noise = {"camera_noise_mm": std, "fruit_noise_mm": std if fruit else 0.0}
        found = roll_out(
            lambda env, seed: ScriptedReach(env) if gain is None else ServoReach(env, gain=gain),
            settings.arms,
            settings.episodes,
            settings.seed,
            **common,
            **noise,
        )
        return float(found.reaches.position_error_mm.mean())

    keys = grid.settings.compensations
    cells = {key: grid.cell("scripted", key, "encoders", "qiao2026") for key in keys}
    rng = np.random.default_rng(settings.seed)
    same: dict[str, Array] = {}
    for key in ("raw", keys[-1]):
        # In open loop the fruit's error adds to the arm's, vector by vector.
        vectors = cells[key].rollout.reaches.pose_error[:, :3] * 1e3
        unit = rng.normal(size=vectors.shape) / np.sqrt(3.0)
        same[key] = np.array([np.linalg.norm(vectors + rmse * unit, axis=1).mean() for rmse in RMSE_MM])
    return Noise(
        open_loop={key: float(cell.errors_mm.mean()) for key, cell in cells.items()},
        servo={gain: np.array([error(gain, rmse, fruit=False) for rmse in RMSE_MM]) for gain in GAINS},
        same_open=same,
        same_servo=np.array([error(GAINS[-1], rmse, fruit=True) for rmse in RMSE_MM]),
    )


def noise_figure(noise: Noise) -> Figure:
    """Mean error against the camera's RMSE, with the crossings."""
    with new_figure(WIDTH, 3.6) as figure:
        axes: Any = figure.subplots(1, 2, sharey=True)
        for key, value in noise.open_loop.items():
            axes[0].axhline(value, color=colour(key), label=f"open loop, {LABELS[key]}")
        for line, gain in zip(("-", "--", ":"), GAINS, strict=True):
            axes[0].plot(RMSE_MM, noise.servo[gain], line, color="0.2", label=f"servo, raw, gain {gain:g}")
            for key in noise.open_loop:
                crossing = noise.crossing(gain, key)
                if crossing is not None:
                    axes[0].plot([crossing], [noise.open_loop[key]], "o", color=colour(key), markersize=4)
        axes[0].axvline(CAMERA_MM, color="0.8", zorder=0)
        axes[0].set_title("fruit's position known")
        for key, values in noise.same_open.items():
            axes[1].plot(RMSE_MM, values, color=colour(key), label=f"open loop, {LABELS[key]}")
        axes[1].plot(RMSE_MM, noise.same_servo, ":", color="0.2", label=f"servo, raw, gain {GAINS[-1]:g}")
        axes[1].set_title("the same camera finds the fruit")
        for axis in axes:
            axis.set_xscale("log")
            axis.set_yscale("log")
            plain_decades(axis.xaxis)
            plain_decades(axis.yaxis)
            axis.set_xlabel("RMSE of the camera [mm]")
            axis.legend(fontsize=6)
        axes[0].set_ylabel("mean position error [mm]")
    return figure


def noise_section(noise: Noise) -> list[str]:
    """The sweep in words."""
    keys = [key for key in noise.open_loop if key != "raw"]
    at = int(np.argmin(np.abs(RMSE_MM - CAMERA_MM)))
    lines = [
        "## Open loop calibrated against closed loop raw",
        "",
        "Scripted reaches against visual servoing on raw arms of `qiao2026`, by the RMSE of the camera's view "
        "of the gap "
        "between tool and fruit. Where the fruit's position is known otherwise, the two are equally good at "
        "these RMSE [mm]; "
        "with a better camera the raw servo wins, with a worse one the calibrated open loop:",
        "",
        "| servo's gain | " + " | ".join(f"against {LABELS[key]}" for key in keys) + f" | servo at {CAMERA_MM:g} mm |",
        "|---|" + "---|" * (len(keys) + 1),
    ]
    for gain in GAINS:
        found = []
        for key in keys:
            crossing = noise.crossing(gain, key)
            outside = "below 0.05" if noise.servo[gain][0] > noise.open_loop[key] else "above 20"
            found.append(outside if crossing is None else f"{crossing:.2f}")
        lines.append(f"| {gain:g} | " + " | ".join(found) + f" | {noise.servo[gain][at]:.2f} |")
    worst = max(noise.open_loop[key] for key in keys)
    winners = [f"{gain:g}" for gain in GAINS if noise.servo[gain][at] < worst]
    verdict = (
        f"With gain {', '.join(winners)} it beats plain least squares even there"
        if winners
        else "Every calibrated arm in open loop is better there"
    )
    best = list(noise.same_open)[-1]
    return [
        *lines,
        "",
        f"With a {CAMERA_MM:g} mm camera the raw servo leaves {noise.servo[GAINS[0]][at]:.2f} mm if it believes each "
        f"picture, and {noise.servo[GAINS[-1]][at]:.2f} mm if it averages (gain {GAINS[-1]:g}); the calibrated "
        f"open loop "
        f"{min(noise.open_loop.values()):.2f} to {worst:.2f} mm. {verdict}.",
        "",
        f"Where the same {CAMERA_MM:g} mm camera must also find the fruit, once, the open loop inherits its "
        f"whole error: "
        f"{noise.same_open[best][at]:.2f} mm calibrated against {noise.same_servo[at]:.2f} mm for the averaging "
        f"raw servo. "
        "Noise that is new in every picture can be averaged; a camera's bias cannot, and is not in this study.",
        "",
        "![Error against the camera's noise](images/findings-noise.png)",
        "",
    ]
