"""Run folders: what kind of run a folder holds, how it was made, and the numbers behind its figures and its report.

`run.json` is taken away when a run begins to write and written last, so where it stands the run is complete.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from calibration.calibration import DAMAGE
from pickenv.errors import InputError
from pickenv.files import write_text
from pickenv.inspect.calibration_trace import CalibrationTrace
from pickenv.inspect.comparison import Comparison
from pickenv.inspect.harvest_trace import HarvestTrace
from pickenv.inspect.saved import load, save, versions
from pickenv.locks import locked

RECORD = "run.json"
COMPARISON = "comparison.npz"
TRACE = "calibration_trace.npz"
HARVEST = "harvest.npz"
ISO9283 = "iso9283.json"
REPORT = "report.html"
STUDY = "study.toml"
"""The configuration in a study's folder, which has no `run.json`."""

FORMAT = 1

MADE_BY: Mapping[str, str] = {
    "demo": "pickenv demo --out RUN",
    "calibration": "pickenv calibrate FILE --arm ARM --run RUN",
    "evaluation": "pickenv evaluate --out RUN",
    "iso9283": "pickenv iso9283 --out RUN",
    "harvest": "python scripts/reproduce_li2016.py --out RUN",
    "study": "pickenv study CONFIG --out RUN",
}
"""The kinds of run, each with the command that makes such a folder."""


@dataclass(frozen=True)
class Run:
    """A complete run folder.

    Attributes:
        folder: Where it is.
        kind: One of `MADE_BY`.
        command: Command line that makes the same numbers again.
        seed: Seed of everything random; None where there is none, or several.
        versions: Versions of what computed it, by package.
    """

    folder: Path
    kind: str
    command: str
    seed: int | None
    versions: Mapping[str, str]

    @property
    def made_by(self) -> str:
        """How such a folder is made, for error messages."""
        return MADE_BY[self.kind].replace("RUN", shlex.quote(str(self.folder)))


@contextmanager
def recorded_run(folder: Path, kind: str, command: str, seed: int | None) -> Iterator[Run]:
    """Write a run's files inside this context; `run.json` is written when all of them stand.

    Args:
        folder: The run folder; made where it is missing.
        kind: One of `MADE_BY`.
        command: Command line that makes the same numbers again.
        seed: Seed of everything random.

    Raises:
        InputError: If another process is writing into the folder, or it cannot be written.
    """
    run = Run(folder, kind, command, seed, versions())
    with locked(folder):
        if (folder / RECORD).is_file():
            (folder / RECORD).unlink()
        yield run
        content = {"format": FORMAT, "kind": kind, "command": command, "seed": seed, "versions": run.versions}
        write_text(folder / RECORD, json.dumps(content, indent=2) + "\n")


def read_run(folder: str | Path) -> Run:
    """What kind of run ``folder`` holds.

    Raises:
        InputError: If it is no run folder, is incomplete, damaged, or newer than this program.
    """
    folder = Path(folder)
    record = folder / RECORD
    ways = "; ".join(f"`{command}`" for command in MADE_BY.values())
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder; make a run folder with one of {ways}")
    if not record.is_file():
        if (folder / STUDY).is_file():
            return Run(folder, "study", MADE_BY["study"], None, {})
        raise InputError(f"{folder} holds no {RECORD}, so it holds no complete run; make one with one of {ways}")
    try:
        content = json.loads(record.read_text(encoding="utf-8"))
        file_format, kind, command = int(content["format"]), str(content["kind"]), str(content["command"])
        made_with = {str(name): str(version) for name, version in content["versions"].items()}
        seed = None if content["seed"] is None else int(content["seed"])
    except DAMAGE as error:
        raise InputError(f"{record} is damaged ({error}); make the run again with one of {ways}") from error
    if file_format > FORMAT or kind not in MADE_BY:
        raise InputError(f"{record} is of a newer pickenv (format {file_format}, kind '{kind}'); update pickenv")
    return Run(folder, kind, command, seed, made_with)


def save_comparison(folder: Path, comparison: Comparison) -> Path:
    """Write ``comparison`` into a run folder."""
    return save(folder / COMPARISON, comparison, seed=comparison.seed)


def load_comparison(folder: Path) -> Comparison:
    """The comparison of a run folder, to the bit; raises `InputError` as `pickenv.inspect.saved.load`."""
    return load(folder / COMPARISON, Comparison, f"pickenv demo --out {folder}")


def save_trace(folder: Path, trace: CalibrationTrace, seed: int | None = None) -> Path:
    """Write a calibration's trace into a run folder."""
    return save(folder / TRACE, trace, seed=seed)


def load_trace(run: Run) -> CalibrationTrace:
    """The calibration's trace of a run folder, to the bit; raises `InputError` as `pickenv.inspect.saved.load`."""
    return load(run.folder / TRACE, CalibrationTrace, run.made_by)


def save_harvest(folder: Path, trace: HarvestTrace, seed: int) -> Path:
    """Write a harvester's trace into a run folder."""
    return save(folder / HARVEST, trace, seed=seed)


def load_harvest(run: Run) -> HarvestTrace:
    """The harvester's trace of a run folder; raises `InputError` as `pickenv.inspect.saved.load`."""
    return load(run.folder / HARVEST, HarvestTrace, run.made_by)


def load_iso9283(run: Run) -> dict[str, Any]:
    """The result of a test by ISO 9283, as it was written.

    Raises:
        InputError: If the file is missing or damaged.
    """
    path = run.folder / ISO9283
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        found["raw"]["poses"], found["settings"], found["plant"], found["standard"]
    except DAMAGE as error:
        raise InputError(f"{path} is missing or damaged ({error}); `{run.made_by}` makes it anew") from error
    return found


def written_report(run: Run) -> str:
    """The page that was written with the run, for runs whose page needs more than the folder keeps.

    Raises:
        InputError: If there is none.
    """
    path = run.folder / REPORT
    if not path.is_file():
        raise InputError(f"{path} does not exist: measurements of this kind have no report page; see `pickenv figures`")
    return path.read_text(encoding="utf-8")
