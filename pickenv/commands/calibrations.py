"""Commands around a calibration: plan-poses before it, its report page, apply and export after it."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from pickenv.errors import InputError

if TYPE_CHECKING:
    from calibration.held_out import Judged
    from pickenv.inspect.calibration_report import Evidence

ARM = typer.Option(help="Arm name or arm file (.toml, .urdf).", show_default=False)
CALIBRATION = typer.Argument(help="Calibration file (.npz).", show_default=False)


def plan_poses(
    arm: Annotated[str, ARM],
    n: Annotated[int, typer.Option("--n", help="Poses to measure.", min=1)] = 30,
    kind: Annotated[str, typer.Option(help="What will be measured: pose or position.")] = "pose",
    criterion: Annotated[
        str, typer.Option(help="d-optimal, or test-poses to be accurate at the poses of --at.")
    ] = "d-optimal",
    at: Annotated[
        Path | None, typer.Option(help="CSV of joints or tool poses where accuracy matters.", show_default=False)
    ] = None,
    frames: Annotated[
        str, typer.Option(help="fitted: base and tool will be fitted too; known: the arm's own parameters alone.")
    ] = "fitted",
    candidates: Annotated[int, typer.Option(help="Poses to choose from.", min=10)] = 2000,
    seed: Annotated[int, typer.Option(help="Seed of candidates and exchange.", min=0)] = 0,
    out: Annotated[Path | None, typer.Option(help="Write the joints in measuring order (.csv).")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
) -> None:
    """Choose poses to measure that tell the most about an arm, within its joint limits, ordered for short travel."""
    from calibration.error_model import complete_model, link_model
    from calibration.planning import plan_poses as plan
    from calibration.targets import joints_of, read_targets
    from pickenv.arm import load_arm
    from pickenv.files import write_text

    if frames not in ("fitted", "known"):
        raise InputError(f"frames is '{frames}'; give fitted or known")
    chosen = load_arm(arm)
    planned = plan(
        chosen,
        (complete_model if frames == "fitted" else link_model)(chosen.nominal),
        n,
        np.random.default_rng(seed),
        candidates=candidates,
        kind=kind,
        criterion=criterion,
        test_joints=None if at is None else joints_of(read_targets(at, chosen.nominal), chosen.nominal),
    )
    print(planned.report())
    if out is not None:
        print(f"wrote {planned.write_csv(out, chosen.nominal.prismatic)}")
    if json_file is not None:
        print(f"wrote {write_text(json_file, json.dumps(planned.as_dict(), indent=2) + chr(10))}")


def write_run(
    folder: Path, command: str, seed: int, evidence: Evidence, judged: Judged, seeds: Mapping[str, Any]
) -> list[Path]:
    """Write the run folder of `pickenv calibrate --run`: calibration, figures, report, and what figures are made of."""
    from calibration.uncertainty import with_uncertainty
    from pickenv.files import write_text
    from pickenv.inspect.calibration_report import write_calibration_report
    from pickenv.inspect.calibration_trace import trace_of
    from pickenv.inspect.run_folder import REPORT, recorded_run, save_trace

    errors = {"nominal": evidence.before, "calibrated": evidence.after}
    if evidence.best is not None:
        errors["with residual"] = evidence.best
    calibration = evidence.fit.calibration
    trace = trace_of(evidence.fit, {"identification": evidence.train, "test": evidence.test}, errors)
    with recorded_run(folder, "calibration", command, seed):
        return [
            with_uncertainty(calibration, evidence.fit.identification, evidence.test).save(folder / "calibration"),
            save_trace(folder, trace, seed),
            write_text(folder / "figures.json", json.dumps(judged.as_dict(), indent=2) + "\n"),
            write_calibration_report(folder / REPORT, evidence, seeds),
        ]


def apply(
    calibration: Annotated[Path, CALIBRATION],
    targets: Annotated[
        Path, typer.Argument(help="CSV of joint targets (q1_deg, …) or tool poses (x_mm … rz_deg).", show_default=False)
    ],
    arm: Annotated[str, ARM],
    out: Annotated[Path, typer.Option(help="Write the corrected commands (.csv).")] = Path("commands.csv"),
    frame: Annotated[
        str, typer.Option(help="Frame of pose targets: controller, or instrument (where the calibration was measured).")
    ] = "controller",
    payload_kg: Annotated[float | None, typer.Option(help="Mass held, where the calibration asks for it.")] = None,
    temperature_k: Annotated[float | None, typer.Option(help="Temperature rise above the reference, likewise.")] = None,
) -> None:
    """Turn nominal joint or pose targets into corrected joint commands, with the error and uncertainty to expect."""
    from calibration.apply import apply_calibration
    from calibration.arm_model import Conditions
    from calibration.calibration import Calibration
    from calibration.targets import read_targets
    from pickenv.arm import load_arm

    chosen = load_arm(arm)
    loaded = Calibration.load(calibration, chosen)
    conditions = Conditions(
        payload=None if payload_kg is None else np.array(payload_kg),
        temperature=None if temperature_k is None else np.array(temperature_k),
    )
    commands = apply_calibration(
        loaded, chosen, read_targets(targets, chosen.nominal), frame=frame, conditions=conditions
    )
    print(commands.report())
    print(f"wrote {commands.write_csv(out)}")


def export(
    calibration: Annotated[Path, CALIBRATION],
    arm: Annotated[str, ARM],
    toml: Annotated[Path | None, typer.Option(help="Write the corrected arm as an arm file (.toml).")] = None,
    urdf: Annotated[Path | None, typer.Option(help="Write the corrected arm as URDF.")] = None,
    onnx: Annotated[Path | None, typer.Option(help="Write the learnt network as ONNX.")] = None,
) -> None:
    """Write the corrected arm as TOML or URDF, and its learnt residual as ONNX, for other programs."""
    from calibration.calibration import Calibration
    from calibration.export import write_arm_toml, write_arm_urdf, write_onnx
    from pickenv.arm import load_arm

    if toml is None and urdf is None and onnx is None:
        raise InputError("nothing to write; give --toml, --urdf or --onnx with a file name")
    chosen = load_arm(arm)
    loaded = Calibration.load(calibration, chosen)
    if toml is not None:
        print(f"wrote {write_arm_toml(loaded, chosen, toml)}")
    if urdf is not None:
        print(f"wrote {write_arm_urdf(loaded, chosen, urdf)}")
    if onnx is not None:
        print(f"wrote {write_onnx(loaded, onnx)}")
