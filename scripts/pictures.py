"""Make pictures of docs/images again: each by the lines of its card in docs/gallery.md, or by a command named here.

Run: python scripts/pictures.py gallery-pick.webp mdh.svg
"""

import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Any
from unittest.mock import patch

import matplotlib.pyplot as plt
import typer
from matplotlib.figure import Figure
from measuring import ROOT
from PIL import Image

from pickenv.base import Estimate
from pickenv.experiments import load_experiment
from pickenv.inspect import estimates_figure, save_figure
from pickenv.inspect.colours import in_words
from pickenv.inspect.figures import style

BLOCK = re.compile(r"^```(python|sh)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
BROWSER = ("make docs", "make test-browser", "python .ci/docs_screenshots.py runs/browser/screenshots")
TABLES = {
    "findings-camera.png": ("A camera that looks all", "error (mm)", "With a camera in every period, raw is as good"),
    "findings-instrument.png": ("A drifting machine", "error behind least squares (mm)", "Orchard: measure in time"),
    "findings-afar.png": ("One look from afar", "error (mm)", "From afar a Gaussian process pays, from near nothing"),
    "findings-constants.png": ("What least squares", "share of raw error removed (%)", "The same for every constant"),
    "findings-ground.png": ("The ground decides", "error of raw arms (mm)", "Soft ground makes raw arms err most"),
}
"""Pictures of a section's first table in docs/findings.md: how its title begins, what the numbers are, the message."""

KEPT = {
    "findings-aggregates.png": ("findings_policies", "Least squares remove most, a Gaussian process more"),
    "findings-success.png": ("findings_policies", "A calibration changes picks where the machine drifts"),
    "findings-reality.png": ("findings_policies", "What is learnt removes less on the rough arm"),
    "findings-transfer.png": ("findings_transfer", "Wherever it was trained, a policy differs by less than 0.05 mm"),
    "visuomotor.png": ("scene", "Calibrated arms keep their fruit; eyes do if the camera is in its place"),
    "clones.png": ("clones", "The blind script needs a calibrated arm; networks that see do not, whoever demonstrated"),
}
KEPT |= {f"{name}-dark.png": KEPT[f"{name}.png"] for name in ("visuomotor", "clones")}
"""Pictures of numbers that the ledger has all, with their study and message."""

NIGHT = {"#1c2024": "#e8eaed", "#5b6470": "#a4adb8", "#dde1e6": "#343a41", "#ffffff": "#14171a"}
"""Colours of a dark page in the places of those of a light one."""

CALL = "cd scripts && python -c 'import pictures; pictures.draw_{}'"
COMMANDS: dict[str, Sequence[str]] = {
    **dict.fromkeys(("comparing-policies-*.png", "explorer-*.webp", "inspection-*.webp"), BROWSER),
    "conditions-orchard.png": (
        "pickenv conditions orchard --out runs/conditions",
        "cp runs/conditions/figures/error_by_condition.png docs/images/conditions-orchard.png",
    ),
    "fetch-reach.png": ("python scripts/fetch_arms.py", "cp runs/fetch_arms/success.png docs/images/fetch-reach.png"),
    **{name: (CALL.format(f'table("{name}")'),) for name in TABLES},
    "home-results.svg": (CALL.format("results()"),),
    "study-grades.png": ("python scripts/studies/tolerance_docs.py",),
}
"""Shell lines by picture, where neither a study nor a card leaves a file of the picture's name."""


def cards() -> dict[str, list[str]]:
    """Shell lines of each of the gallery's cards, by its picture; a program becomes an argument of Python."""
    lines: dict[str, list[str]] = {}
    for card in (ROOT / "docs/gallery.md").read_text(encoding="utf-8").split("\n## ")[1:]:
        (picture,) = re.findall(r"\(images/([^)]+)\)", card)
        lines[picture] = []
        for language, text in BLOCK.findall(card):
            lines[picture] += [f"python -c {shlex.quote(text)}"] if language == "python" else text.splitlines()
    return lines


def studies() -> dict[str, list[str]]:
    """The shell line that draws each study's pictures, by picture; from the ledger where it has all their numbers."""
    lines: dict[str, list[str]] = {}
    for path in sorted((ROOT / "scripts/studies").glob("*.toml")):
        table = tomllib.loads(path.read_text(encoding="utf-8"))
        names = [*table.get("figures", ()), *(each.get("figure") for each in table.get("estimate", ()))]
        line = f"pickenv experiment scripts/studies/{path.name} --figures docs/images"
        lines |= {f"{name}.png": [line] for name in names if name}
    return lines | {picture: [CALL.format(f'kept("{picture}")')] for picture in KEPT}


def draw_kept(picture: str) -> Path:
    """Draw a study's picture from the ledger, without the study."""
    name, message = KEPT[picture]
    study = load_experiment(ROOT / f"scripts/studies/{name}.toml")
    (number,) = (number for number in study.numbers if f"{number.figure}.png" == picture.replace("-dark", ""))
    ledger = json.loads((ROOT / "docs/_static/claims.json").read_text(encoding="utf-8"))["rows"]
    rows = [
        {**row["levels"], "estimate": Estimate(row["value"], tuple(row["ci95"]))}
        for row in ledger
        if (row["experiment"], row["title"]) == (name, number.title)
    ]
    looks: dict[str, Any] = {name: getattr(number, name) for name in ("x", "panels", "log", "scale")}
    label = in_words(number.title).replace("squares's", "squares'")
    with patch.dict(style.STYLE, night() if picture.endswith("-dark.png") else {}):
        return saved(estimates_figure(rows, label, number.by, colour=number.across, **looks), message, picture)


def night() -> dict[str, str]:
    """The style of a dark page, where it differs."""
    colours = {name: NIGHT.get(value, value) for name, value in style.STYLE.items() if isinstance(value, str)}
    return colours | dict.fromkeys(("figure.facecolor", "axes.facecolor", "savefig.facecolor"), NIGHT[style.PAPER])


def saved(figure: Figure, message: str, picture: str) -> Path:
    """Save a picture with its message, in few colours, which is a third of the bytes."""
    figure.suptitle(message, x=0.01, ha="left", fontsize=9.0, fontweight="bold")
    path = save_figure(figure, ROOT / "docs/images" / picture)
    Image.open(path).convert("RGB").quantize(64).save(path, optimize=True)
    return path


def draw_table(picture: str) -> Path:
    """Draw a finding's table, whose numbers are the ledger's: a line for each row, a colour for each column."""
    start, label, message = TABLES[picture]
    text = (ROOT / "docs/findings.md").read_text(encoding="utf-8").split(f"\n## {start}")[1].split("<!-- end of")[0]
    table = [[cell.strip() for cell in line.strip("|").split("|")] for line in re.findall(r"^\|.*\|$", text, re.M)]
    heads, rows = table[0], []
    for cells in table[2:]:
        words = [cell for cell in cells if not re.fullmatch(r"-?[\d.]+( \(.*\))?|", cell)]
        for head, cell in zip(heads, cells, strict=True):
            if (match := re.fullmatch(r"(-?[\d.]+) \((-?[\d.]+) to (-?[\d.]+)\)", cell)) is not None:
                value, *ends = map(float, match.groups())
                levels = {"row": ", ".join(map(in_words, words)), "column": f"× {head}" if head[0].isdigit() else head}
                rows.append(levels | {"estimate": Estimate(value, (ends[0], ends[1]))})
    figure = estimates_figure(rows, f"{label}, mean over arms", ("row", "column"))
    return saved(figure, message, picture)


def draw_results() -> Path:
    """Draw the home page's strip of results from its table: three arms, the error of each by model."""
    home = re.sub(r"<!--.*?-->", "", (ROOT / "docs/index.md").read_text(encoding="utf-8"))
    lines = [line.strip("| ").split(" | ") for line in home.splitlines() if line.startswith("| ")][1:]
    figure, panels = plt.subplots(1, len(lines), figsize=(8.0, 2.0), layout="constrained", sharey=True)
    panels[0].set_yticks([0, -1, -2], ["as drawn", "least squares", "best model"])
    for panel, (arm, *cells) in zip(panels, lines, strict=True):
        values = [[float(number) for number in re.findall(r"[\d.]+", cell)] for cell in cells[:3]]
        for row, ((value, low, high), colour) in enumerate(zip(values, ("#e69f00", "#0072b2", "#009e73"), strict=True)):
            panel.plot([low, high], [-row, -row], color=colour, lw=3)
            panel.plot(value, -row, "o", color=colour)
        kind = "simulated" if "simulated" in arm else "measured"
        title = f"{arm.split(', ')[0].strip('`')}, {kind}:\n{values[0][0]:.3g} to {values[2][0]:.2g} mm"
        panel.set(xscale="log", xlabel="error (mm)", xlim=(0.04, 15), ylim=(-2.5, 0.5))
        panel.set_xticks([0.1, 1, 10], ["0.1", "1", "10"])
        panel.set_xticks([], minor=True)
        panel.set_title(title, fontsize=10)
    return save_figure(figure, ROOT / "docs/images/home-results.svg")


def lines_of(picture: str) -> Sequence[str]:
    """Shell lines that make a picture, run in the repository."""
    for name, lines in (COMMANDS | studies()).items():
        if fnmatch(picture, name):
            return lines
    return [*(f"mkdir -p runs && cd runs && {line}" for line in cards()[picture]), f"cp runs/{picture} docs/images"]


def main(names: list[str]) -> None:
    """Make pictures."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for line in (line for name in names for line in lines_of(name)):
        subprocess.run(line, shell=True, check=True, cwd=ROOT, env=os.environ | {"PATH": path, "MPLBACKEND": "Agg"})


if __name__ == "__main__":
    typer.run(main)
