"""What `pickenv COMMAND --help` ends with: commands as they are typed, and where to read more."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import metadata
from types import MappingProxyType

EXAMPLES: Mapping[str, tuple[str, tuple[str, ...]]] = MappingProxyType(
    {
        "calibrate": (
            "calibrating-a-robot.md",
            (
                "pickenv calibrate tracker.csv --arm ur5e --out my_arm.npz --report my_arm.html",
                "pickenv calibrate views.csv --arm so101 --columns webcam.toml --out so101.npz",
            ),
        ),
        "verify": ("calibrating-a-robot.md", ("pickenv verify my_arm.npz new_poses.csv --refit base",)),
        "plan-poses": ("calibrating-a-robot.md", ("pickenv plan-poses --arm ur5e --n 40 --out poses.csv",)),
        "board": ("so101.md", ("pickenv board charuco_a4 --out board.pdf",)),
        "apply": ("applying-a-calibration.md", ("pickenv apply my_arm.npz targets.csv --arm ur5e --out commands.csv",)),
        "export": (
            "applying-a-calibration.md",
            ("pickenv export my_arm.npz --onto robot.urdf --out robot_calibrated.urdf",),
        ),
        "check": ("figures-and-reports.md", ("pickenv check runs/demo", "pickenv check my_arm.npz")),
        "arms": ("commands.md", ("pickenv arms",)),
        "schema": ("column-descriptions.md", ("pickenv schema description",)),
        "demo": ("quickstart.md", ("pickenv demo --quick", "pickenv inspect runs/demo")),
        "twin": ("twin.md", ("pickenv twin my_arm.npz --out twin.toml",)),
        "effects": ("commands.md", ("pickenv effects --plant orchard",)),
        "iso9283": ("commands.md", ("pickenv iso9283 --plant qiao2026 --out runs/iso",)),
        "conditions": ("conditions.md", ("pickenv conditions orchard --out runs/conditions",)),
        "train": ("commands.md", ("pickenv train --steps 100000 --compensate my_arm.npz --out runs/policy",)),
        "evaluate": ("findings.md", ("pickenv evaluate --policy runs/policy --out runs/comparison",)),
        "datasets": (
            "clients.md",
            ("pickenv datasets --out runs/datasets", "pickenv datasets --task pick --quality expert"),
        ),
        "compare": (
            "comparing-policies.md",
            ("pickenv compare scripted scripted --compensate none my_arm.npz --episodes 20 --out runs/compare",),
        ),
        "study": ("tolerance-studies.md", ("pickenv study scripts/tolerance_study.toml --quick --out runs/study",)),
        "experiment": ("experiments.md", ("pickenv experiment noise_cost.toml --quick --json noise_cost.json",)),
        "inspect": ("recordings.md", ("pickenv inspect runs/demo", "pickenv inspect runs/demo --web")),
        "film": ("films.md", ("pickenv film runs/compare --out film.gif",)),
        "figures": ("figures-and-reports.md", ("pickenv figures runs/demo --format pdf --out figures",)),
        "report": ("figures-and-reports.md", ("pickenv report runs/demo",)),
    }
)
"""Page and examples of each command."""


def examples(command: str) -> str:
    """The end of a command's help; empty where there are no examples.

    Args:
        command: As typed, "plan-poses".
    """
    page, lines = EXAMPLES.get(command, ("", ()))
    typed = [f"[bold]{line}[/bold]" for line in lines]
    return "\n\n".join(["Examples:", *typed, f"More: {pages_address()}/{page}"]) if lines else ""


def pages_address() -> str:
    """Where the pages stand: the address that the package itself names, or the folder of a checkout."""
    try:
        addresses = metadata.metadata("pickenv").get_all("Project-URL") or []
    except metadata.PackageNotFoundError:
        addresses = []
    return next((text.partition(", ")[2] for text in addresses if text.startswith("Documentation, ")), "docs")
