"""Commands about files: `pickenv check`, is it what was written, to the bit? `pickenv schema`, what may it hold?"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, make_dataclass
from pathlib import Path
from typing import Annotated, Any

from typer import Option

from pickenv.base import InputError, check_sealed_parquet, read_container, refusing_damage, separate, write_json

REFUSED = 3
"""Exit code where something is damaged or foreign."""

REMAKE = "make it anew with the command that made it"
BENCH_PAGES = ("bench.md", "leaderboard.md")
"""What `pickenv bench` writes before the list of its folder's files."""

SEALED = (".npz", ".pt", ".parquet")
"""Suffixes of the files that carry a seal."""


@dataclass(frozen=True)
class Finding:
    """What was found about one file.

    Attributes:
        path: The file.
        what: What it is, as far as that could be read: "calibration", "file of a run".
        version: Version of its content; None where it has none of its own.
        about: Whose it is, in a few words.
        reason: Why it is refused, in one sentence; None if it is sound.
    """

    path: str
    what: str
    version: int | None = None
    about: str = ""
    reason: str | None = None

    def line(self) -> str:
        """One line for a person."""
        if self.reason is not None:
            return f"REFUSED  {self.reason if self.path in self.reason else f'{self.path}: {self.reason}'}"
        version = "" if self.version is None else f", format {self.version}"
        return f"sound    {self.path}: {self.what}{version}{', ' if self.about else ''}{self.about}"


def check(paths: list[Path], json_file: Annotated[Path | None, Option("--json")] = None) -> None:
    """Verify files and run folders from end to end; exit code 3 if one is damaged, edited, missing or foreign.

    Args:
        paths: Calibrations, policies, checkpoints, chunks, traces, or whole folders.
        json_file: Write what was found to this file.

    Examples:
        pickenv check runs/demo
        pickenv check my_arm.npz

    More: figures-and-reports.md
    """
    separate({}, {"--json": json_file})
    findings = []
    for path in paths:
        for finding in findings_of(path):
            print(finding.line())
            findings.append(finding)
    refused = sum(finding.reason is not None for finding in findings)
    print(f"{len(findings)} checked, {refused} refused")
    if json_file is not None:
        content = {"sound": refused == 0, "files": [asdict(finding) for finding in findings]}
        print(f"wrote {write_json(json_file, content)}")
    if refused:
        sys.exit(REFUSED)


def findings_of(path: Path) -> list[Finding]:
    """What is found about a file, or about every file of a folder.

    Raises:
        InputError: If there is no such file or folder.
    """
    with refusing_damage(path, "a path", "give the path of a file or a folder"):
        folder, missing = path.is_dir(), not path.exists()
    if missing:
        raise InputError(f"{path} does not exist; give the path of a file or a folder")
    return folder_findings(path) if folder else [file_finding(path)]


def folder_findings(folder: Path) -> list[Finding]:
    """What is found about every file of a run, of a study, or of another folder that holds runs or sealed files."""
    from pickenv.experiments import check_experiment
    from pickenv.experiments.engine import RECORD as EXPERIMENT
    from pickenv.experiments.policy_tables import EPISODES
    from pickenv.inspect.runs.run_folder import LIST, PARTS, RECORD, STUDY

    if (folder / RECORD).exists():
        return run_findings(folder)
    if (folder / LIST).exists():
        return listed_findings(folder)
    if (folder / EXPERIMENT).exists():
        return [Finding(str(path), "file of an experiment", reason=reason) for path, reason in check_experiment(folder)]
    pages = [name for name in BENCH_PAGES if (folder / name).exists()]
    if pages:
        return [Finding(str(folder / LIST), "list of files", reason=f"is missing beside {pages[0]}; {REMAKE}")]
    if (folder / STUDY).exists():
        from pickenv.experiments import check_folder

        return [Finding(str(path), "file of a study", reason=reason) for path, reason in check_folder(folder)]
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


def listed_findings(folder: Path) -> list[Finding]:
    """What is found about every file that a folder's own list names or that lies beside them."""
    from pickenv.inspect.runs.run_folder import LIST, faults_of_list

    try:
        faults = faults_of_list(folder)
    except InputError as error:
        return [Finding(str(folder / LIST), "list of files", reason=str(error))]
    return [Finding(str(folder / LIST), f"list of {len(faults)} files"), *_of_files(faults)]


def _of_files(faults: Sequence[tuple[Path, str | None]]) -> list[Finding]:
    """What is found about files of which it is known whether they are missing, stray or edited."""
    return [
        file_finding(path)
        if reason is None and path.suffix in SEALED
        else Finding(str(path), "file of the run", reason=reason)
        for path, reason in faults
    ]


def run_findings(folder: Path) -> list[Finding]:
    """What is found about a run folder's record and every file that it lists or that lies beside it."""
    from pickenv.inspect import read_run
    from pickenv.inspect.runs.run_folder import FORMAT, RECORD, faults_of

    record = str(folder / RECORD)
    try:
        run = read_run(folder)
    except InputError as error:
        return [Finding(record, "record of a run", reason=str(error))]
    return [
        Finding(record, f"record of a run ({run.kind})", FORMAT, f"made by `{run.command}`"),
        *_of_files(faults_of(run)),
    ]


def file_finding(path: Path) -> Finding:
    """What is found about one file."""
    kind = "file"
    try:
        kind = _kind_of(path)
        version, about = _READERS[kind](path) if kind in _READERS else _foreign(path, kind)
    except InputError as error:
        return Finding(str(path), kind, reason=str(error))
    return Finding(str(path), kind, version, about)


def _kind_of(path: Path) -> str:
    """What a file is; an archive says so itself."""
    if path.suffix == ".parquet":
        return "chunk of a study"
    if path.suffix == ".pt":
        return "checkpoint"  # it may be far larger than other files, and is read once
    if path.suffix == ".npz":
        return read_container(path, None, remake=REMAKE).kind
    raise InputError(f"{path} carries no seal; files that do end in {', '.join(SEALED)}")


def _foreign(path: Path, what: str) -> tuple[int | None, str]:
    raise InputError(f"{path} holds a {what[:40]}, which this program does not know; update pickenv")


def _twin(path: Path) -> tuple[int | None, str]:
    from pickenv.arm import read_twin
    from pickenv.arm.plant.twin_file import TWIN_FORMAT

    plant = read_twin(path)
    assert plant.posterior is not None
    return TWIN_FORMAT, f"of arm '{plant.arm.name}', {plant.posterior.factor.shape[1]} parameters with their covariance"


def _calibration(path: Path) -> tuple[int | None, str]:
    from pickenv.calibration import Calibration
    from pickenv.calibration.pipeline.calibration import FORMAT
    from pickenv.experiments.methods import ORIGIN

    calibration = Calibration.load(path)
    origin = calibration.record.get(ORIGIN)
    key = re.search("-([0-9a-f]{16})$", path.stem)  # as `pickenv evaluate --cache` names them
    if origin is not None and key is not None and not str(origin).startswith(key[1]):
        raise InputError(f"{path} is the calibration of another arm or protocol than its name says; delete it")
    unit = "" if calibration.unit is None else f", unit '{calibration.unit}'"
    return FORMAT, f"arm '{calibration.arm_name}'{unit}, geometry {calibration.arm_fingerprint}"


def _policy(path: Path) -> tuple[int | None, str]:
    from pickenv.agents import load_policy
    from pickenv.agents.policies.learned import FORMAT

    policy = load_policy(path)
    return FORMAT, f"{policy.algorithm} on arm '{policy.arm}'"


def _remembering(path: Path) -> tuple[int | None, str]:
    from pickenv.agents import load_remembering
    from pickenv.agents.policies.remembering import REMEMBERING_FORMAT

    policy = load_remembering(path)
    return REMEMBERING_FORMAT, f"{policy.algorithm} on arm '{policy.arm}'"


def _checkpoint(path: Path) -> tuple[int | None, str]:
    from pickenv.agents.training.checkpoints import FORMAT, check_checkpoint

    reason = check_checkpoint(path)
    if reason is not None:
        raise InputError(reason)
    return FORMAT, "of a training"


def _chunk(path: Path) -> tuple[int | None, str]:

    remake = "run the study again to make it anew"
    with refusing_damage(path, "a chunk", remake):
        content = path.read_bytes()
    check_sealed_parquet(content, path, remake)
    return None, "whether it belongs to its study is found by checking the study's folder"


def _saved(path: Path) -> tuple[int | None, str]:
    from pickenv.inspect import Comparison
    from pickenv.inspect.runs import saved
    from pickenv.inspect.runs.calibration_trace import CalibrationTrace
    from pickenv.inspect.runs.harvest_trace import HarvestTrace
    from pickenv.inspect.runs.recorded_episodes import RecordedEpisodes

    kinds: tuple[type, ...] = (CalibrationTrace, Comparison, HarvestTrace, RecordedEpisodes)
    name = read_container(path, None, remake=REMAKE).kind
    saved.load_numbers(path, next(kind for kind in kinds if kind.__name__ == name), "the command that wrote it")
    return saved.FORMATS.get(name, saved.FORMAT), "the numbers behind figures"


_READERS: Mapping[str, Callable[[Path], tuple[int | None, str]]] = {
    "calibration": _calibration,
    "twin": _twin,
    "policy": _policy,
    "policy with a memory": _remembering,
    "checkpoint": _checkpoint,
    "chunk of a study": _chunk,
    **dict.fromkeys(("CalibrationTrace", "Comparison", "HarvestTrace", "RecordedEpisodes"), _saved),
}
"""How each kind of file is verified: its version, and a few words about it."""


def schema(kind: str) -> None:
    """Print the JSON schema of a kind of TOML file; an unknown kind is answered with the known ones.

    Args:
        kind: arm, plant, description, study, …

    Examples:
        pickenv schema description

    More: column-descriptions.md
    """
    from pickenv.base import json_schema  # late: it loads pydantic

    classes = kinds()
    if kind not in classes:
        raise InputError(f"there is no kind of file '{kind}'; give one of {', '.join(classes)}")
    print(json.dumps(json_schema(classes[kind]), indent=2))


def kinds() -> dict[str, Any]:
    """The classes of all kinds of files; of orchard presets a file of one's own is meant."""
    from pickenv import orchard
    from pickenv.arm import Tolerances
    from pickenv.arm.files.arm_file import ArmFile
    from pickenv.arm.plant.plant_file import plant_file
    from pickenv.base import toml_table
    from pickenv.base.registry import load_all
    from pickenv.calibration.camera.boards import Board
    from pickenv.calibration.reading.description import description_file
    from pickenv.envs.harvesting.harvest_task import Rules
    from pickenv.experiments import StudyConfig
    from pickenv.harvester import Grid, Picking
    from pickenv.harvester.machine import MachineFile
    from pickenv.harvester.optimiser import Effort
    from pickenv.harvester.pick_points import Search
    from pickenv.harvester.trees import Lab, Orchard
    from pickenv.orchard import Station
    from pickenv.orchard.camera import CameraFile
    from pickenv.orchard.gripper import gripper_file

    return {
        "arm": ArmFile,
        "plant": plant_file(tuple(load_all("effect"))),
        "tolerances": Tolerances,
        "description": description_file(),
        "board": toml_table(make_dataclass("BoardFile", [("board", Board)])),
        "study": StudyConfig,
        "branch": orchard.Branch,
        "camera": CameraFile,
        "canopy": orchard.Canopy,
        "detachment": orchard.Detachment,
        "fruit": orchard.FruitMap,
        "fruit_size": orchard.FruitSize,
        "gripper": gripper_file(),
        "look": orchard.Look,
        "station": Station,
        "vision": orchard.StereoCamera,
        "machine": MachineFile,
        "strategy": toml_table(
            make_dataclass("Strategy", [("zones", Grid), ("search", Search), ("optimiser", Effort)])
        ),
        "picking": toml_table(
            make_dataclass("PickingFile", [("pick", Picking), ("task", Rules), ("lab", Lab), ("trees", Orchard)])
        ),
    }
