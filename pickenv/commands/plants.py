"""Commands about the simulated true arm: `pickenv effects` and `pickenv iso9283`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

JsonFile = Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")]


def effects(
    plant: Annotated[str, typer.Option(help="Plant preset or plant file (.toml).")] = "orchard",
    reaches: Annotated[int, typer.Option(help="Reaches to average over.", min=2)] = 300,
    dwell: Annotated[float, typer.Option(help="Waiting time after arrival, s.", min=0.0)] = 0.5,
    hours: Annotated[float, typer.Option(help="Time since the machine was switched on, h.", min=0.0)] = 2.0,
    seed: Annotated[int, typer.Option(help="Seed of the reaches.", min=0)] = 0,
    json_file: JsonFile = None,
) -> None:
    """Each effect's share of the tip error of a simulated arm, in mm: alone, taken away, and all together."""
    import numpy as np

    from pickenv.arm import load_plant
    from pickenv.arm.effect_shares import draw_reaches, effect_shares
    from pickenv.arm.motion import Pace
    from pickenv.files import write_text

    chosen = load_plant(plant)
    joints = draw_reaches(chosen, reaches, np.random.default_rng(seed))
    shares = effect_shares(chosen, joints, running_time=3600.0 * hours, pace=Pace(dwell=dwell))
    print(shares.report())
    if json_file is not None:
        print(f"wrote {write_text(json_file, json.dumps(shares.as_dict(), indent=2) + chr(10))}")


def iso9283(
    plant: Annotated[str, typer.Option(help="Plant preset or plant file (.toml).")] = "orchard",
    calibration: Annotated[Path | None, typer.Option(help="Fitted calibration (.npz) to test as well.")] = None,
    cycles: Annotated[int, typer.Option(help="Measurements per pose; 30 by the standard.", min=2)] = 30,
    speed: Annotated[float, typer.Option(help="Share of the largest speed.", min=0.01, max=1.0)] = 1.0,
    dwell: Annotated[float, typer.Option(help="Waiting time before each measurement, s.", min=0.0)] = 2.0,
    seed: Annotated[int, typer.Option(help="Seed of friction and instrument noise.", min=0)] = 0,
    json_file: JsonFile = None,
    out: Annotated[Path | None, typer.Option(help="Run folder for `pickenv figures` and `pickenv report`.")] = None,
) -> None:
    """Accuracy AP, repeatability RP, vAP and drift dAP of the simulated arm by ISO 9283, raw and calibrated."""
    import numpy as np

    from calibration import Calibration
    from calibration.iso9283 import Iso9283Settings
    from calibration.iso9283 import iso9283 as test
    from pickenv.arm import load_plant
    from pickenv.arm.motion import Pace
    from pickenv.files import write_text

    chosen = load_plant(plant)
    fitted = Calibration.load(calibration, chosen.arm) if calibration is not None else None
    result = test(
        chosen,
        fitted.compensator() if fitted is not None else None,
        rng=np.random.default_rng(seed),
        settings=Iso9283Settings(cycles=cycles, pace=Pace(speed=speed, dwell=dwell)),
        reference=fitted.nominal if fitted is not None else None,
    )
    print(result.report())
    if json_file is not None:
        print(f"wrote {write_text(json_file, json.dumps(result.as_dict(), indent=2) + chr(10))}")
    if out is not None:
        from pickenv.inspect.run_folder import ISO9283, recorded_run

        with_calibration = "" if calibration is None else f" --calibration {calibration}"
        command = f"pickenv iso9283 --plant {plant}{with_calibration} --cycles {cycles} --speed {speed} --dwell {dwell}"
        with recorded_run(out, "iso9283", f"{command} --seed {seed}", seed):
            print(f"wrote {write_text(out / ISO9283, json.dumps(result.as_dict(), indent=2) + chr(10))}")
