"""`pickenv twin`: a calibrated arm as a plant for every environment."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pickenv.base import DO_NOT_USE, npz_path, obey, separate, write_json
from pickenv.commands.corrections import ALLOW, CALIBRATION, UNIT
from pickenv.commands.handing_over import deliver
from pickenv.commands.showing import with_options


def twin(
    calibration: Annotated[Path, CALIBRATION],
    out: Annotated[Path, typer.Option(help="Write the plant (.npz).")] = Path("my_arm.npz"),
    arm: Annotated[
        str | None, typer.Option(help="Arm name or arm file; by its name in the calibration if left out.")
    ] = None,
    rows: Annotated[
        list[Path] | None,
        typer.Option(
            help="Poses or positions that it was fitted to, where it has no Gaussian process.", show_default=False
        ),
    ] = None,
    columns: Annotated[str | None, typer.Option(help="Column description of --rows; ours if left out.")] = None,
    seed: Annotated[int, typer.Option(help="Seed of the residual's waves.", min=0)] = 0,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Write what was said of the plant to this file.", show_default=False)
    ] = None,
    unit: Annotated[str | None, UNIT] = None,
    allow: Annotated[list[str] | None, ALLOW] = None,
) -> None:
    """Make a plant whose truth is what a calibration found, and whose arms are drawn from what its data allow.

    Environments take it as plant="my_arm.npz"; with arms="per_episode" each episode has another arm of them.
    """
    from pickenv.arm import load_arm, write_twin
    from pickenv.base import InputError
    from pickenv.calibration import Calibration, Measurements, read_observations, twin as made

    if columns is not None and rows is None:
        raise InputError("--columns describes the files of --rows; give those too")
    path = npz_path(out)
    separate({"CALIBRATION": calibration, "--arm": arm, "--rows": rows or []}, {"--out": path, "--json": json_file})
    loaded = Calibration.load(calibration, None, unit)
    chosen = load_arm(arm or loaded.arm_name)
    obey(loaded.reservations(), allow or (), (DO_NOT_USE,))
    data = None if not rows else read_observations(rows, chosen.nominal, columns).observations
    if data is not None and not isinstance(data, Measurements):
        raise InputError(f"--rows holds {data.kind}, not poses or positions; leave it out")
    plant = made(loaded, chosen, data, name=path.stem, seed=seed)
    assert plant.posterior is not None
    known = plant.posterior
    told = {
        "name": plant.name,
        "arm": chosen.name,
        "parameters": known.factor.shape[1],
        "not_identified": len(known.unseen),
        "notes": list(known.notes),
    }
    lines = [
        f"{plant.name}: {told['parameters']} parameters of arm '{chosen.name}' as found, {told['not_identified']} that "
        "were not identified",
        *(f"  {note}" for note in known.notes),
    ]
    deliver(
        [(path, lambda file: write_twin(plant, file)), (json_file, lambda file: write_json(file, told))],
        lambda: print(with_options("\n".join(lines))),
    )
