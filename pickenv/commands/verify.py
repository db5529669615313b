"""`pickenv verify`: is an old calibration still good? Judged on new rows, from another station if asked."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pickenv.base import separate, write_json
from pickenv.commands.handing_over import deliver
from pickenv.commands.showing import with_options

NOT_GOOD = 3
"""Exit code where the calibration is not what it was."""


def verify(
    calibration: Annotated[Path, typer.Argument(help="Calibration file (.npz).", show_default=False)],
    files: Annotated[list[Path], typer.Argument(help="New poses or positions of the same robot.", show_default=False)],
    columns: Annotated[str | None, typer.Option(help="Column description, by name or path; ours if left out.")] = None,
    refit: Annotated[
        str | None,
        typer.Option(help="Find base, tool or base,tool anew first: the instrument or its target was moved."),
    ] = None,
    refit_rows: Annotated[
        int | None, typer.Option(help="Rows to find them from; the others judge. 6 if left out.", min=3)
    ] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")] = None,
) -> None:
    """Judge an old calibration on new rows: does it beat the nominal arm, is it as good as promised, was this measured?

    Still good, worse than nominal, drifted, outside what was measured, another station or another arm.

    The verdict comes first; unless it is "still good" the exit code is 3.
    """
    from pickenv.calibration import Calibration, read_observations
    from pickenv.calibration.pipeline.verification import frames_and_rows, verify as verified

    separate({"CALIBRATION": calibration, "FILES": files, "--columns": columns}, {"--json": json_file})
    old = Calibration.load(calibration)
    data = read_observations(files, old.arm, columns).observations
    found = verified(old, data, *frames_and_rows(refit, refit_rows))
    deliver([(json_file, lambda path: write_json(path, found.as_dict()))], lambda: print(with_options(found.text())))
    if found.status != "still good":
        raise typer.Exit(NOT_GOOD)
