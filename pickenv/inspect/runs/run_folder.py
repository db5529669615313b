"""Run folders: the kind of a run, how it was made, and the data behind its figures and its report.

`run.json` is deleted when a run begins to write, and is written last. So a folder with `run.json` has a complete run.
This file lists the SHA-256 of every file that the run wrote, and has a hash of its own content.
"""

from __future__ import annotations

import json
import os
import shlex
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

from pickenv.base import (
    InputError,
    code_fingerprint,
    command_line,
    file_sha256,
    locked,
    read_sealed_json,
    refusing_damage,
    register,
    registry,
    sealed_json,
    versions,
    write_text,
)
from pickenv.inspect.runs.calibration_trace import CalibrationTrace
from pickenv.inspect.runs.harvest_trace import HarvestTrace
from pickenv.inspect.runs.recorded_episodes import Comparison, RecordedEpisodes
from pickenv.inspect.runs.saved import load_numbers, save_numbers

RECORD = "run.json"
LIST = "files.json"
"""Name of the file that lists the files of a folder which is itself no run, but holds several runs, tables and
calibrations."""

PARTS: Mapping[type, str] = {
    Comparison: "comparison.npz",
    CalibrationTrace: "calibration_trace.npz",
    HarvestTrace: "harvest.npz",
    RecordedEpisodes: "episodes.npz",
}
"""Names of the files with the data behind figures, by class."""

Part = TypeVar("Part", Comparison, CalibrationTrace, HarvestTrace, RecordedEpisodes)
ISO9283 = "iso9283.json"
CONDITIONS = "conditions.json"
MATTERS_FILE = "matters.json"
REPORT = "report.html"
STUDY = "study.toml"
"""Name of the configuration file in a study's folder, which has no `run.json`."""

FORMAT = 2


@dataclass(frozen=True)
class RunKind:
    """A kind of run.

    Attributes:
        made_by: The command that makes a run folder of this kind.
        pages: The module that defines ``drawings(run)`` and ``page(run, picture)`` for this kind.
    """

    made_by: str
    pages: str


def _kind(pages: str, *words: str, **options: str) -> RunKind:
    return RunKind(command_line(*words, **options), f"pickenv.{pages}")


_KINDS: Mapping[str, RunKind] = {
    "demo": _kind("inspect.reports.demo_report", "pickenv", "demo", out="RUN"),
    "calibration": _kind("inspect.reports.calibration_report", "pickenv", "calibrate", "FILE", arm="ARM", run="RUN"),
    "comparison": _kind("inspect.reports.comparison_report", "pickenv", "compare", "POLICY", "POLICY", out="RUN"),
    "evaluation": _kind("experiments.policy_tables", "pickenv", "evaluate", out="RUN"),
    "iso9283": _kind("inspect.reports.iso9283_report", "pickenv", "iso9283", out="RUN"),
    "conditions": _kind("inspect.reports.conditions_report", "pickenv", "conditions", "PLANT", out="RUN"),
    "harvest": _kind("inspect.reports.harvest_report", "python", "-m", "papers.li2016", out="RUN"),
    "study": _kind("experiments.study_report", "pickenv", "study", "CONFIG", out="RUN"),
}
for _name, _run_kind in _KINDS.items():
    register("report", _name)(lambda run_kind=_run_kind: run_kind)


def run_kind(name: str, **source: str) -> RunKind:
    """Return the registered kind of run with a name.

    Args:
        name: Name of the kind, such as "demo".
        source: ``package`` and ``version`` of the kind, as the run's record names them; arguments of `registry.get`.

    Raises:
        InputError: If no kind of that name is registered.
    """
    kind: RunKind = registry.get("report", name, **source)()
    return kind


TakePicture: TypeAlias = Callable[[Path], bytes | None]
"""Function that returns a picture (WebP) of a recording, given its path, or None if it cannot, such as
`viewer_picture`."""


@dataclass(frozen=True)
class Run:
    """A complete run folder.

    Attributes:
        folder: The folder.
        kind: Name of a registered kind of run, such as "demo".
        command: Command line that makes the same numbers again.
        seed: Seed of everything random; None where there is no seed, or several.
        versions: Versions of the packages that computed the run, by package.
        code: Fingerprint of the code that computed the run (`pickenv.base.provenance.code_fingerprint`).
        files: SHA-256 of each file that the run wrote, by its path inside the folder; None while the run writes, and
            for a study, whose chunks carry hashes of their own.
    """

    folder: Path
    kind: str
    command: str
    seed: int | None
    versions: Mapping[str, str]
    code: str = ""
    files: Mapping[str, str] | None = None

    @property
    def made_by(self) -> str:
        """The command that makes this run folder, for error messages."""
        return run_kind(self.kind).made_by.replace("RUN", shlex.quote(str(self.folder)))


@contextmanager
def recorded_run(folder: Path, kind: str, command: str, seed: int | None) -> Iterator[Run]:
    """Return a context in which a run writes its files; at the end `run.json` is written, unless an error occurs.

    Args:
        folder: The run folder. Missing folders are made.
        kind: Name of a registered kind of run.
        command: Command line that makes the same numbers again.
        seed: Seed of everything random; None where there is no seed, or several.

    Raises:
        InputError: If another process is writing into the folder, or the folder cannot be written.
    """
    run_kind(kind)
    run = Run(folder, kind, command, seed, versions(), code_fingerprint())
    with locked(folder):
        (folder / RECORD).unlink(missing_ok=True)
        before = _stamps(folder)
        yield run
        write_text(folder / RECORD, _record_text(replace(run, files=_changed_since(folder, before))))


@contextmanager
def added_to(run: Run) -> Iterator[None]:
    """Return a context in which further files, such as figures, are written into a complete run's folder.

    When the context ends, `run.json` is written again and lists these files too.
    """
    before = _stamps(run.folder)
    yield
    changed = _changed_since(run.folder, before)
    if run.files is not None and changed:
        latest = read_run(run.folder)  # another command may have added its own since
        added = replace(latest, files={**(latest.files or {}), **changed})
        write_text(run.folder / RECORD, _record_text(added))


def _stamps(folder: Path) -> dict[str, tuple[int, int, int]]:
    """Return inode, time, ns, and size, bytes, of every file in a folder but hidden ones, by its path in the folder.

    Writing a file again changes these numbers.
    """
    stamps = {}
    for root, folders, names in os.walk(folder):
        folders[:] = [name for name in folders if not name.startswith(".")]
        for path in (Path(root, name) for name in names if not name.startswith(".")):
            if path.is_file():
                state = path.stat()
                stamps[path.relative_to(folder).as_posix()] = (state.st_ino, state.st_mtime_ns, state.st_size)
    return stamps


def _changed_since(folder: Path, before: Mapping[str, object]) -> dict[str, str]:
    """Return the SHA-256, by path in the folder, of files written since ``before``, an earlier result of `_stamps`."""
    now = _stamps(folder)
    return {name: file_sha256(folder / name) for name in sorted(now) if now[name] != before.get(name)}


def _record_text(run: Run) -> str:
    """Return the only valid text of `run.json` for a run: it includes a hash of its other content."""
    content = {"format": FORMAT, **vars(run), "files": run.files or {}}
    del content["folder"]
    return sealed_json(content)


def read_run(folder: str | Path) -> Run:
    """Return the run in a folder.

    Raises:
        InputError: If the folder is no run folder, or the run is incomplete, damaged, edited, or of another version.
    """
    folder = Path(folder)
    record = folder / RECORD
    ways = "; ".join(f"`{kind().made_by}`" for kind in registry.load_all("report").values())
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder; make a run folder with one of {ways}")
    if not record.is_file():
        if (folder / STUDY).is_file():
            return Run(folder, "study", run_kind("study").made_by, None, {})
        raise InputError(f"{folder} holds no {RECORD}, so it holds no complete run; make one with one of {ways}")
    remake = f"make the run again with one of {ways}"
    with refusing_damage(record, "a run's record", remake):
        text = record.read_text(encoding="utf-8")
        content = json.loads(text)
        file_format, kind = int(content["format"]), str(content["kind"])
        others = {str(name): str(version) for name, version in content["versions"].items() if name not in versions()}
    if kind not in registry.names("report") and others:
        run_kind(kind, package=next(iter(others)), version=next(iter(others.values())))
    if file_format > FORMAT or kind not in registry.names("report"):
        raise InputError(f"{record} is of a newer pickenv (format {file_format}, kind '{kind[:40]}'); update pickenv")
    if file_format < FORMAT:
        raise InputError(f"{record} was written by an earlier version, without hashes of the run's files; {remake}")
    with refusing_damage(record, "a run's record", remake):
        made_with = {str(name): str(version) for name, version in content["versions"].items()}
        files = {str(name): str(hashed) for name, hashed in content["files"].items()}
        seed = None if content["seed"] is None else int(content["seed"])
        run = Run(folder, kind, str(content["command"]), seed, made_with, str(content["code"]), files)
        if text != _record_text(run):
            raise ValueError("it was edited: its own hash is another")
    return run


def faults_of(run: Run) -> list[tuple[Path, str | None]]:
    """Return every file that ``run`` lists or that lies in its folder, with the file's fault, or None for a sound file.

    A file may be missing, edited, or stray: in the folder, but not written by this run.
    """
    return _faults(run.folder, run.files or {}, RECORD)


def _faults(folder: Path, listed: Mapping[str, str], own: str) -> list[tuple[Path, str | None]]:
    stamps = _stamps(folder)
    faults: list[tuple[Path, str | None]] = []
    for name in sorted({*listed, *stamps} - {own}):
        path, reason = folder / name, None
        if name not in stamps:
            reason = "is missing; the run wrote it"
        elif name not in listed:
            reason = "is stray: this run did not write it"
        elif file_sha256(path) != listed[name]:
            reason = "was edited since the run wrote it"
        faults.append((path, reason))
    return faults


@contextmanager
def listed_files(folder: Path) -> Iterator[None]:
    """Return a context in which more files are written into a folder.

    The list of the folder's files (`LIST`) is deleted when the context begins, and written when the context ends.
    """
    (folder / LIST).unlink(missing_ok=True)
    yield
    files = {name: file_sha256(folder / name) for name in sorted(_stamps(folder))}
    write_text(folder / LIST, sealed_json({"files": files}))


def faults_of_list(folder: Path) -> list[tuple[Path, str | None]]:
    """Return every file that `LIST` names or that lies in the folder, with the file's fault, or None if it is sound.

    Raises:
        InputError: If the list is damaged or was edited.
    """
    path, remake = folder / LIST, "run the command that made the folder again; it goes on from what is sound"
    return _faults(folder, read_sealed_json(path, "a list of files", remake, "files")["files"], LIST)


def unedited(run: Run, name: str) -> Path:
    """Return the path of the run's file ``name``, after a check that the file is as the run wrote it.

    Raises:
        InputError: If the file is missing or not as the run wrote it.
    """
    path = run.folder / name
    if not path.is_file():
        raise InputError(f"{path} does not exist; `{run.made_by}` makes it anew")
    if run.files is not None and file_sha256(path) != run.files.get(name):
        raise InputError(f"{path} is not what the run wrote, it was edited or exchanged; `{run.made_by}` makes it anew")
    return path


def save_part(folder: Path, part: Part, seed: int | None, kind: type | None = None) -> Path:
    """Write the data behind figures into a run folder, and return the path.

    Args:
        folder: The run folder.
        part: The data, an object of one of the classes in `PARTS` or derived from one.
        seed: Seed of the run.
        kind: Class of `PARTS` that is named in the file; the object's class when left out.
    """
    kind = kind or type(part)
    return save_numbers(folder / PARTS[kind], part, seed=seed, kind=kind)


def load_part(run: Run, kind: type[Part]) -> Part:
    """Read the data behind a run's figures exactly as they were saved.

    Args:
        run: The run.
        kind: The class of the data, one of `PARTS`.

    Raises:
        InputError: If the file is missing, edited, of another class, or of another version. Also if it needs the
            effect of a package that is not installed.
    """
    return load_numbers(unedited(run, PARTS[kind]), kind, run.made_by)


def load_result(run: Run, name: str) -> dict[str, Any]:
    """Read the file ``name`` of a run's results in JSON, such as `ISO9283`.

    Raises:
        InputError: If the file is missing or not as the run wrote it.
    """
    return dict(json.loads(unedited(run, name).read_text(encoding="utf-8")))
