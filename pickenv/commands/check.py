"""Commands about files: `pickenv check` verifies them to the bit, `pickenv schema` prints what they may contain."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, make_dataclass
from inspect import isfunction
from pathlib import Path
from pkgutil import resolve_name
from typing import Annotated, Any

from typer import Option

import pickenv
from pickenv.base import InputError, check_sealed_parquet, read_container, refusing_damage, separate, write_json

REFUSED = 3
"""Exit code if a file is damaged, or was not written by pickenv."""

REMAKE = "make it anew with the command that made it"
BENCH_FILES = ("measured_gains.json", "leaderboard.md")
"""Files of `pickenv bench`. A folder that has one of these but no list of its files counts as damaged."""

SEALED = (".npz", ".pt", ".parquet")
"""Suffixes of the files that contain a seal, that is a checksum of their content."""


@dataclass(frozen=True)
class Finding:
    """The result of checking one file.

    Attributes:
        path: The file.
        what: Kind of the file, such as "calibration" or "file of a run".
        version: Version of the file's format; None if the format has no version of its own.
        about: What the file belongs to, in a few words.
        reason: Why the file is refused, in one sentence; None if the file is sound.
    """

    path: str
    what: str
    version: int | None = None
    about: str = ""
    reason: str | None = None

    def line(self) -> str:
        """Return the finding as one line of text."""
        if self.reason is not None:
            return f"REFUSED  {self.reason if self.path in self.reason else f'{self.path}: {self.reason}'}"
        version = "" if self.version is None else f", format {self.version}"
        return f"sound    {self.path}: {self.what}{version}{', ' if self.about else ''}{self.about}"


SHOWN = 20
"""Largest number of sound files for which a line each is printed without `--details`."""


def check(
    paths: list[Path],
    details: Annotated[bool, Option("--details")] = False,
    json_file: Annotated[Path | None, Option("--json")] = None,
) -> None:
    """Verify files and run folders from end to end; exit code 3 if one is damaged, edited, missing or foreign.

    Args:
        paths: Calibrations, policies, checkpoints, chunks, traces, or whole folders.
        details: Print a line for every sound file, however many there are.
        json_file: Write the findings to this file.

    Examples:
        pickenv check runs/demo
        pickenv check my_arm.npz

    More: figures-and-reports.md
    """
    inside = [file for path in paths if path.is_dir() for file in path.rglob("*") if file.is_file()]
    separate({"PATHS": [*paths, *inside]}, {"--json": json_file})
    findings: list[Finding] = []
    for path in paths:
        for finding in findings_of(path):
            if details or finding.reason is not None or len(findings) < SHOWN:
                print(finding.line())
            findings.append(finding)
    refused = sum(finding.reason is not None for finding in findings)
    print(f"{len(findings)} checked, {refused} refused")
    if len(findings) > SHOWN and not details:
        print("more: --details prints a line for every file")
    if json_file is not None:
        content = {"sound": refused == 0, "files": [asdict(finding) for finding in findings]}
        print(f"wrote {write_json(json_file, content)}")
    if refused:
        sys.exit(REFUSED)


def findings_of(path: Path) -> list[Finding]:
    """Check a file, or every file of a folder, and return the findings.

    Raises:
        InputError: If there is no such file or folder.
    """
    with refusing_damage(path, "a path", "give the path of a file or a folder"):
        folder, missing = path.is_dir(), not path.exists()
    if missing:
        raise InputError(f"{path} does not exist; give the path of a file or a folder")
    return folder_findings(path) if folder else [file_finding(path)]


def folder_findings(folder: Path) -> list[Finding]:
    """Check every file of a run, of a study, or of any other folder that contains runs or files with a checksum."""
    from pickenv.experiments.engine import RECORD as EXPERIMENT
    from pickenv.experiments.policy_tables import EPISODES
    from pickenv.inspect.runs.run_folder import LIST, PARTS, RECORD, STUDY

    if (folder / RECORD).exists() or (folder / LIST).exists():
        return listed_findings(folder)
    if (folder / EXPERIMENT).exists():
        return _faults("file of an experiment", pickenv.experiments.check_experiment(folder))
    files = [name for name in BENCH_FILES if (folder / name).exists()]
    if files:
        return [Finding(str(folder / LIST), "list of files", reason=f"is missing beside {files[0]}; {REMAKE}")]
    if (folder / STUDY).exists():
        return _faults("file of a study", pickenv.experiments.check_folder(folder))
    runs = {record.parent for name in (RECORD, LIST, EXPERIMENT) for record in folder.rglob(name)}
    runs = {run for run in runs if not runs & set(run.parents)}
    sealed = sorted(path for path in folder.rglob("*") if path.suffix in SEALED and path.is_file())
    sealed = [path for path in sealed if not runs & set(path.parents)]
    if not sealed and not runs:
        return [Finding(str(folder), "folder", reason="holds neither a complete run nor any file with a seal")]
    findings = [finding for run in sorted(runs) for finding in folder_findings(run)]
    for path in sealed:
        lost = path.name in {EPISODES, *PARTS.values()}
        reason = f"its run is not complete: {path.parent / RECORD} is missing; {REMAKE}"
        findings.append(Finding(str(path), "file of a run", reason=reason) if lost else file_finding(path))
    return findings


def _faults(what: str, faults: Iterable[tuple[Path, str | None]]) -> list[Finding]:
    """Return a finding for each pair in ``faults``: a file's path and its fault, or None for a sound file.

    ``what`` is the kind of all these files, as findings name it.
    """
    return [Finding(str(path), what, reason=reason) for path, reason in faults]


def listed_findings(folder: Path) -> list[Finding]:
    """Check the record of a run, or the list of a folder's files, and then the files.

    Files in the folder that the record or list does not name are checked too.
    """
    from pickenv.inspect.runs.run_folder import FORMAT, LIST, RECORD, faults_of, faults_of_list

    is_run = (folder / RECORD).exists()
    record, what = (str(folder / RECORD), "record of a run") if is_run else (str(folder / LIST), "list of files")
    try:
        if is_run:
            run = pickenv.inspect.read_run(folder)
            faults, about = faults_of(run), Finding(record, f"{what} ({run.kind})", FORMAT, f"made by `{run.command}`")
        else:
            faults = faults_of_list(folder)
            about = Finding(record, f"list of {len(faults)} files")
    except InputError as error:
        return [Finding(record, what, reason=str(error))]
    sealed = {path for path, reason in faults if reason is None and path.suffix in SEALED}
    findings = zip(faults, _faults("file of the run", faults), strict=True)
    return [about, *(file_finding(path) if path in sealed else finding for (path, _), finding in findings)]


def file_finding(path: Path) -> Finding:
    """Check one file, and return the finding."""
    kind = "file"
    try:
        kind, version = _kind_of(path)
        return Finding(str(path), kind, version, _verified(path, kind))
    except InputError as error:
        return Finding(str(path), kind, reason=str(error))


def _kind_of(path: Path) -> tuple[str, int | None]:
    """Return the kind of a file, as `Finding` names it, and the version of its format or None.

    Archives (.npz) contain both; the kind of any other file follows from its suffix.
    """
    if path.suffix == ".parquet":
        return "chunk of a study", None
    if path.suffix == ".pt":
        from pickenv.agents.training.training import FORMAT

        return "checkpoint", FORMAT  # it may be far larger than other files, and is read once
    if path.suffix == ".npz":
        from pickenv.inspect.runs.run_folder import LARGEST

        container = read_container(path, None, remake=REMAKE, limit=LARGEST)
        return container.kind, container.version
    raise InputError(f"{path} carries no seal; files that do end in {', '.join(SEALED)}")


def _verified(path: Path, kind: str) -> str:
    """Verify a file of the kind ``kind``, a name that `_kind_of` returned; return a few words about its content.

    The function that reads this kind decides which versions it accepts.

    Raises:
        InputError: If the file is damaged or of a version that is not accepted.
    """
    match kind:
        case "calibration":
            return _calibration(path)
        case "twin":
            plant = pickenv.arm.read_twin(path)
            assert plant.posterior is not None
            return f"of arm '{plant.arm.name}', {plant.posterior.factor.shape[1]} parameters with their covariance"
        case "policy" | "policy with a memory":
            policy = pickenv.load_policy(path) if kind == "policy" else pickenv.agents.load_remembering(path)
            return f"{policy.algorithm} on arm '{policy.arm}'"
        case "checkpoint":
            from pickenv.agents.training.training import read_checkpoint

            read_checkpoint(path)
            return "of a training"
        case "chunk of a study":
            remake = "run the study again to make it anew"
            with refusing_damage(path, "a chunk", remake):
                content = path.read_bytes()
            check_sealed_parquet(content, path, remake)
            return "whether it belongs to its study is found by checking the study's folder"
        case "CalibrationTrace" | "Comparison" | "HarvestTrace" | "RecordedEpisodes":
            from pickenv.inspect.runs.run_folder import load_numbers

            load_numbers(path, getattr(pickenv.inspect, kind), "the command that wrote it")
            return "the numbers behind figures"
    raise InputError(f"{path} holds a {kind[:40]}, which this program does not know; update pickenv")


def _calibration(path: Path) -> str:
    from pickenv.experiments.methods import ORIGIN

    calibration = pickenv.Calibration.load(path, whole=True)
    origin = calibration.record.get(ORIGIN)
    key = re.search("-([0-9a-f]{16})$", path.stem)  # as `pickenv evaluate --cache` names them
    if origin is not None and key is not None and not str(origin).startswith(key[1]):
        raise InputError(f"{path} is the calibration of another arm or protocol than its name says; delete it")
    unit = "" if calibration.unit is None else f", unit '{calibration.unit}'"
    return f"arm '{calibration.arm_name}'{unit}, geometry {calibration.arm_fingerprint}"


def schema(kind: str) -> None:
    """Print the JSON schema of a kind of TOML file; an unknown kind lists the known kinds.

    Args:
        kind: arm, plant, description, study, …

    Examples:
        pickenv schema description

    More: column-descriptions.md
    """
    from pickenv.base import json_schema  # late: it loads pydantic

    if kind not in FILES:
        raise InputError(f"there is no kind of file '{kind}'; give one of {', '.join(FILES)}")
    print(json.dumps(json_schema(class_of_file(kind)), indent=2))


FILES: Mapping[str, str | tuple[str, Mapping[str, str]]] = {
    "arm": "pickenv.arm.files.arm_file:ArmFile",
    "plant": "pickenv.arm.plant.plant_file:any_plant_file",
    "tolerances": "pickenv.arm:Tolerances",
    "description": "pickenv.calibration.reading.description:description_file",
    "board": ("BoardFile", {"board": "pickenv.calibration.camera.boards:Board"}),
    "study": "pickenv.experiments:StudyConfig",
    "branch": "pickenv.orchard:Branch",
    "camera": "pickenv.orchard:Camera",
    "canopy": "pickenv.orchard:Canopy",
    "detachment": "pickenv.orchard:Detachment",
    "fruit": "pickenv.orchard:FruitMap",
    "fruit_size": "pickenv.orchard:FruitSize",
    "gripper": "pickenv.orchard.gripper:gripper_file",
    "look": "pickenv.orchard:Look",
    "station": "pickenv.orchard:Station",
    "suction": "pickenv.orchard:Suction",
    "vision": "pickenv.orchard:StereoCamera",
    "machine": "pickenv.harvester.machine:MachineFile",
    "strategy": (
        "Strategy",
        {
            "zones": "pickenv.harvester:Grid",
            "search": "pickenv.harvester.pick_points:Search",
            "optimiser": "pickenv.harvester.optimiser:Effort",
        },
    ),
    "picking": (
        "PickingFile",
        {
            "pick": "pickenv.harvester:Picking",
            "task": "pickenv.envs.harvesting.harvest_task:Rules",
            "lab": "pickenv.harvester.pick_points:Lab",
            "trees": "pickenv.harvester.pick_points:Orchard",
        },
    ),
}
"""For each kind of file, where its class is found: "module:name" of the class, or of a function that returns it. For a
kind with several sections, a pair: the name of the class to make, and "module:name" of each section's class."""


def class_of_file(kind: str) -> Any:
    """Return the class into which a kind of file is read, given the name of the kind, a key of `FILES`."""
    from pickenv.base import toml_table

    place = FILES[kind]
    if isinstance(place, str):
        result = resolve_name(place)
        return result() if isfunction(result) else result
    name, sections = place
    return toml_table(make_dataclass(name, [(key, resolve_name(part)) for key, part in sections.items()]))
