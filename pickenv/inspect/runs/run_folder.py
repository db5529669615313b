"""Run folders: the kind of a run, how it was made, and the data behind its figures and its report.

`run.json` is deleted when a run begins to write, and is written last. So a folder with `run.json` has a complete run.
`run.json` lists the SHA-256 of every file that the run wrote, and has a hash of its own content.

Data are frozen dataclasses of numbers and arrays, which are read back exactly without executing anything. Such a file
is a container (`pickenv.base`): a header in JSON, which names arrays, and the arrays. Reading creates only objects of
these classes: the class that the caller names, its subclasses, registered effects, and all classes in the type hints of
these classes.
"""

from __future__ import annotations

import json
import os
import shlex
import typing
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array
from pickenv.arm.plant.plant_file import shipped_effects
from pickenv.base import (
    InputError,
    code_fingerprint,
    command_line,
    file_sha256,
    locked,
    read_container,
    read_sealed_json,
    refusing_damage,
    register,
    registry,
    sealed_json,
    versions,
    write_container,
    write_text,
)
from pickenv.inspect.runs.recorded_episodes import Comparison, RecordedEpisodes
from pickenv.inspect.runs.traces import CalibrationTrace, HarvestTrace


def capsules(points: Array, parts: list[int]) -> tuple[Array, Array, Array]:
    """Return capsules (rods with round ends) along some segments of polylines.

    Args:
        points: Points of the polylines ``(..., K, 3)``, m.
        parts: Indices, from 0, of the first points of the P segments, from `drawn_parts`.

    Returns:
        Three arrays. The first has the centre of each capsule's first end ``(..., P, 3)``, m. The second has the
        distance between the centres of the two ends ``(..., P)``, m. The third has the quaternion that turns the z axis
        into the capsule's direction ``(..., P, 4)``, order x, y, z, w.
    """
    start, end = points[..., parts, :], points[..., [i + 1 for i in parts], :]
    along = end - start
    length = np.linalg.norm(along, axis=-1)
    safe = np.where(length > 1e-9, length, 1.0)[..., None]
    direction = np.where(length[..., None] > 1e-9, along / safe, [0.0, 0.0, 1.0])
    # Half-way quaternion from z to the direction; straight down is turned about x.
    w = 1.0 + direction[..., 2]
    down = w < 1e-9
    quaternion = np.stack([-direction[..., 1], direction[..., 0], np.zeros_like(w), w], axis=-1)
    quaternion[down] = [1.0, 0.0, 0.0, 0.0]
    quaternion /= np.linalg.norm(quaternion, axis=-1, keepdims=True)
    return start, length, quaternion


# Where the eye stands: at one point for every picture of a comparison, on screen and on paper. Metres, radians.


EYE_TURN, EYE_LIFT = 0.5, 0.45
"""Angles of the camera beside and above the normal of the field's widest upright face, rad."""


def shown_box(comparison: Comparison) -> tuple[Array, float]:
    """Return the centre ``(3,)`` and the radius of the box of the field's grid, m; the camera looks at the centre."""
    size = comparison.grid.size
    return comparison.grid.corner + size / 2.0, float(np.linalg.norm(size) / 2.0)


def eye_direction(comparison: Comparison) -> Array:
    """Return the unit vector ``(3,)`` from the field to the camera.

    The camera looks obliquely at the widest upright face of the field's box, from the side away from the arm's base. In
    an oblique view, front cells hide fewer of the cells behind.
    """
    width_x, width_y, _ = comparison.grid.shape
    x, y, _ = shown_box(comparison)[0] - comparison.nominal.base.position
    outward = float(np.arctan2(y, x))
    along_x = width_y > width_x or (width_y == width_x and abs(x) > abs(y))
    normal = float(np.arctan2(0.0, x) if along_x else np.arctan2(y, 0.0))
    turn = normal + (EYE_TURN if np.sin(outward - normal) >= 0.0 else -EYE_TURN)
    return np.array([np.cos(turn) * np.cos(EYE_LIFT), np.sin(turn) * np.cos(EYE_LIFT), np.sin(EYE_LIFT)])


def cut_away(comparison: Comparison) -> NDArray[np.bool_]:
    """Return whether each point of the field ``(F,)`` is in the corner that is nearest to the camera.

    Voxels in that corner would hide all others.
    """
    offset = comparison.grid.points - shown_box(comparison)[0]
    return np.asarray(np.all(offset * np.sign(eye_direction(comparison)) > 0.0, axis=-1))


LARGEST = 1 << 34
"""Largest size of a file, and of its unpacked content, bytes. It is large because recorded episodes are large."""
DATA_FORMAT, DATA_FORMATS = 3, {"Comparison": 4, "RecordedEpisodes": 4, "HarvestTrace": 4}
"""Format version of the files of most classes, and the format versions of all other classes, by the class's name."""

Saved = TypeVar("Saved")


def save_numbers(path: str | Path, value: Any, *, seed: int | None = None, kind: type | None = None) -> Path:
    """Write a frozen dataclass to ``path`` (.npz) atomically, and return the path; equal values give equal bytes.

    Args:
        path: The file.
        value: The object: dataclasses, named tuples, tuples, mappings, arrays, numbers, text and None, nested.
        seed: Seed of the run that made the object, for the record.
        kind: Class that is named in the file: the object's class (when left out) or one of its base classes.

    Raises:
        InputError: If the file cannot be written.
    """
    arrays: dict[str, np.ndarray] = {}
    sources: dict[str, Any] = {}
    header = {"seed": seed, "content": _pack(value, arrays, sources)} | ({"others": sources} if sources else {})
    name = (kind or type(value)).__name__
    return write_container(path, name, header, arrays, version=DATA_FORMATS.get(name, DATA_FORMAT), compressed=True)


def load_numbers(path: str | Path, kind: type[Saved], made_by: str) -> Saved:
    """Read the object in a file that `save_numbers` wrote.

    Args:
        path: The file.
        kind: The class that the file must hold.
        made_by: The command that makes the file, for error messages.

    Raises:
        InputError: If the file is missing, damaged in any byte, of another kind, or of another version. Also if it
            needs the effect of a package that is not installed; the message names the package.
    """
    remake = f"`{made_by}` makes it anew"
    version = DATA_FORMATS.get(kind.__name__, DATA_FORMAT)
    container = read_container(path, kind.__name__, remake=remake, version=version, limit=LARGEST)
    effects = [registry.get("effect", name) for name in shipped_effects()]
    try:
        others = {key: registry.get(*key.split(" "), **by) for key, by in container.header.get("others", {}).items()}
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    classes = _classes(kind, *kind.__subclasses__(), *effects, *others.values()) | others
    with refusing_damage(path, f"a {kind.__name__} file", remake):
        content = _unpack(container.header["content"], container.arrays, classes)
        if not isinstance(content, kind):
            raise TypeError(f"it holds a {type(content).__name__}")
    return content


def _pack(value: Any, arrays: dict[str, np.ndarray], sources: dict[str, Any]) -> Any:
    if value is None or isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        name = f"array{len(arrays)}"
        arrays[name] = value
        return {"array": name}
    names = [field.name for field in fields(value)] if is_dataclass(value) else getattr(value, "_fields", None)
    if names is not None:
        kind = type(value).__name__
        registered = registry.registered_as(type(value))
        if registered is not None and (source := registry.origin(*registered)).package != "pickenv":
            kind = " ".join(registered)
            sources[kind] = asdict(source)
        return {"class": kind, "fields": {name: _pack(getattr(value, name), arrays, sources) for name in names}}
    if isinstance(value, tuple | list):
        return {"tuple": [_pack(item, arrays, sources) for item in value]}
    if isinstance(value, Mapping):
        return {"mapping": [[_pack(part, arrays, sources) for part in pair] for pair in value.items()]}
    raise TypeError(f"a {type(value).__name__} cannot be saved; give arrays, numbers, text, or dataclasses of them")


def _unpack(packed: Any, arrays: Mapping[str, np.ndarray], classes: Mapping[str, Callable[..., Any]]) -> Any:
    if not isinstance(packed, dict):
        return packed
    if "array" in packed:
        return arrays[packed["array"]]
    if "tuple" in packed:
        return tuple(_unpack(item, arrays, classes) for item in packed["tuple"])
    if "mapping" in packed:
        return {_unpack(key, arrays, classes): _unpack(item, arrays, classes) for key, item in packed["mapping"]}
    return classes[packed["class"]](**{name: _unpack(item, arrays, classes) for name, item in packed["fields"].items()})


def _classes(*roots: Any) -> dict[str, Any]:
    """Return the dataclasses and named tuples in ``roots`` and in their type hints, recursively, by name."""
    classes: dict[str, Any] = {}
    hints = [*roots]
    while hints:
        hint = hints.pop()
        hints += typing.get_args(hint)
        is_record = isinstance(hint, type) and (is_dataclass(hint) or hasattr(hint, "_fields"))
        if is_record and hint.__name__ not in classes:
            classes[hint.__name__] = hint
            hints += typing.get_type_hints(hint).values()
    return classes


RECORD = "run.json"
LIST = "files.json"
"""Name of the list of files of a folder that is no run itself, but holds several runs, tables and calibrations."""

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
    return typing.cast("RunKind", registry.get("report", name, **source)())


TakePicture: TypeAlias = Callable[[Path], bytes | None]
"""Function, such as `viewer_picture`, from a recording's path to its picture (WebP), or None if it cannot be made."""


@dataclass(frozen=True)
class Run:
    """A complete run folder.

    Attributes:
        folder: The folder.
        kind: Name of a registered kind of run, such as "demo".
        command: Command line that makes the same numbers again.
        seed: Seed of everything random; None if there is no seed, or if there are several.
        versions: Versions of the packages that computed the run, by package.
        code: Fingerprint of the code that computed the run (`pickenv.base.reproducibility.code_fingerprint`).
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
        seed: Seed of everything random; None if there is no seed, or if there are several.

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
        write_text(run.folder / RECORD, _record_text(replace(latest, files={**(latest.files or {}), **changed})))


def _stamps(folder: Path) -> dict[str, tuple[int, int, int]]:
    """Return inode, time of change (ns) and size (bytes) of every file in a folder, by the file's path in the folder.

    Hidden files are left out. Writing a file again changes these numbers.
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
    """Return the text that `run.json` must have for a run; the text includes a hash of its other content."""
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
        made_with = {str(name): str(version) for name, version in content["versions"].items()}
    others = {name: version for name, version in made_with.items() if name not in versions()}
    if kind not in registry.names("report") and others:
        run_kind(kind, package=next(iter(others)), version=next(iter(others.values())))
    if file_format > FORMAT or kind not in registry.names("report"):
        raise InputError(f"{record} is of a newer pickenv (format {file_format}, kind '{kind[:40]}'); update pickenv")
    if file_format < FORMAT:
        raise InputError(f"{record} was written by an earlier version, without hashes of the run's files; {remake}")
    with refusing_damage(record, "a run's record", remake):
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
