"""`pickenv schema`: what a TOML file may hold, as a JSON schema that editors complete and check files by."""

from __future__ import annotations

import json
from dataclasses import make_dataclass
from typing import Annotated, Any

import typer

from pickenv.base import InputError


def schema(kind: Annotated[str, typer.Argument(help="arm, plant, description, study, …")]) -> None:
    """Print the JSON schema of a kind of TOML file; an unknown kind is answered with the known ones."""
    from pickenv.base import json_schema

    known = kinds()
    if kind not in known:
        raise InputError(f"there is no kind of file '{kind}'; give one of {', '.join(known)}")
    print(json.dumps(json_schema(known[kind]), indent=2))


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
    from pickenv.harvester.trees import Lab, TreesTable
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
            make_dataclass("PickingFile", [("pick", Picking), ("task", Rules), ("lab", Lab), ("trees", TreesTable)])
        ),
    }
