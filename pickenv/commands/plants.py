"""Commands about arms and the simulated true arm: `pickenv arms`, `pickenv effects` and `pickenv iso9283`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pickenv.base import check_limit, command_line, obey, separate, write_json
from pickenv.commands.handing_over import deliver

JsonFile = Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")]


def arms(json_file: JsonFile = None) -> None:
    """List the arms that come with pickenv: name, joints (R turns, P slides), reach and where the numbers come from."""
    from pickenv.arm import load_arm, shipped_arms
    from pickenv.arm.kinematics.inverse import farthest
    from pickenv.commands.showing import print_table

    separate({}, {"--json": json_file})
    found = []
    for name in shipped_arms():
        arm = load_arm(name)
        kinds = "".join("P" if slides else "R" for slides in arm.nominal.prismatic)
        reach = round(1e3 * farthest(arm.nominal), 1)
        found.append({"name": name, "joints": kinds, "reach_mm": reach, "source": arm.source})
    rows = [[str(cell) for cell in row.values()] for row in found]
    deliver(
        [(json_file, lambda path: write_json(path, {"arms": found}))],
        lambda: print_table(
            "arms that come with pickenv",
            ("name", "joints", "reach (mm)", "source"),
            rows,
            words=("name", "joints", "source"),
            caption="reach: the farthest that the tool gets from the arm's base",
        ),
    )


def effects(
    plant: Annotated[str, typer.Option(help="Plant preset or plant file (.toml).")] = "orchard",
    reaches: Annotated[int, typer.Option(help="Reaches to average over.", min=2)] = 300,
    dwell: Annotated[float, typer.Option(help="Waiting time after arrival, s.", min=0.0)] = 0.5,
    hours: Annotated[float, typer.Option(help="Time since the machine was switched on, h.", min=0.0)] = 2.0,
    seed: Annotated[int, typer.Option(help="Seed of the reaches.", min=0)] = 0,
    json_file: JsonFile = None,
) -> None:
    """Each effect's share of the tip error of a simulated arm, in mm: alone, what is left without it, and all."""
    import numpy as np

    from pickenv.arm import load_plant
    from pickenv.arm.plant.campaign import Pace, draw_reaches, effect_shares

    check_limit("--reaches", reaches, "reaches")
    check_limit("--dwell", dwell, "dwell_s")
    check_limit("--hours", hours, "hours")
    separate({"--plant": plant}, {"--json": json_file})
    chosen = load_plant(plant)
    joints = draw_reaches(chosen, reaches, np.random.default_rng(seed))
    shares = effect_shares(chosen, joints, running_time=3600.0 * hours, pace=Pace(dwell=dwell))
    deliver([(json_file, lambda path: write_json(path, shares.as_dict()))], lambda: print(shares.report()))


def iso9283(
    plant: Annotated[str, typer.Option(help="Plant preset or plant file (.toml).")] = "orchard",
    calibration: Annotated[Path | None, typer.Option(help="Fitted calibration (.npz) to test as well.")] = None,
    allow: Annotated[
        list[str] | None, typer.Option(help="Test the calibration in spite of this: fitted-frames, do-not-use.")
    ] = None,
    cycles: Annotated[int, typer.Option(help="Measurements per pose; 30 by the standard.", min=2)] = 30,
    speed: Annotated[float, typer.Option(help="Share of the largest speed.", min=0.01, max=1.0)] = 1.0,
    dwell: Annotated[float, typer.Option(help="Waiting time before each measurement, s.", min=0.0)] = 2.0,
    seed: Annotated[int, typer.Option(help="Seed of friction and instrument noise.", min=0)] = 0,
    json_file: JsonFile = None,
    out: Annotated[Path | None, typer.Option(help="Run folder for `pickenv figures` and `pickenv report`.")] = None,
) -> None:
    """Accuracy AP, repeatability RP, vAP and drift dAP of the simulated arm by ISO 9283, raw and calibrated."""
    import numpy as np

    from pickenv.arm import load_plant
    from pickenv.arm.plant.campaign import Pace
    from pickenv.arm.plant.iso9283 import Iso9283Settings, iso9283 as test
    from pickenv.calibration import Calibration
    from pickenv.inspect.runs.run_folder import ISO9283, RECORD, recorded_run

    check_limit("--cycles", cycles, "cycles")
    check_limit("--dwell", dwell, "dwell_s")
    separate(
        {"--plant": plant, "--calibration": [] if calibration is None else [calibration, f"{calibration}.npz"]},
        {"--out": [] if out is None else [out / RECORD, out / ISO9283], "--json": json_file},
    )
    chosen = load_plant(plant)
    fitted = Calibration.load(calibration, chosen.arm) if calibration is not None else None
    if fitted is not None:
        obey(fitted.reservations(), allow or ())
    result = test(
        chosen,
        fitted.compensator() if fitted is not None else None,
        rng=np.random.default_rng(seed),
        settings=Iso9283Settings(cycles=cycles, pace=Pace(speed=speed, dwell=dwell)),
        reference=fitted.nominal if fitted is not None else None,
    )
    settings = {"cycles": cycles, "speed": speed, "dwell": dwell, "seed": seed}
    command = command_line("pickenv", "iso9283", plant=plant, calibration=calibration, **settings)

    def write_run(folder: Path) -> Path:
        with recorded_run(folder, "iso9283", command, seed):
            return write_json(folder / ISO9283, result.as_dict())

    deliver(
        [(json_file, lambda path: write_json(path, result.as_dict())), (out, write_run)],
        lambda: print(result.report()),
    )
