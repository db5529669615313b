"""Other people's clients on the environments: each in its own virtual environment, with the recipe of docs/clients.md.

    python .ci/clients/run_clients.py --folder .venv-clients --json .ci/clients/clients.json
    python .ci/clients/run_clients.py --client skrl --quick

A client's environment sees the packages of the Python that runs this script (pickenv, torch, Stable-Baselines3), and
gets what clients.toml names of its own. What was run is kept in the folder, by recipe and versions, and not run again.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import re
import resource
import shlex
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from pickenv.base import write_json, write_text

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PAGE = ROOT / "docs" / "clients.md"
PACKAGES = HERE / "clients.toml"
BLOCK = re.compile(r"^```(python|sh|\{literalinclude\} \S+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
PRINTED = re.compile(r"^(\w+): ([\d.]+) mm$", re.MULTILINE)
SHORT = 3840
"""Steps of a quick run."""


def clients() -> dict[str, dict[str, Any]]:
    """What clients.toml says of each: heading of its recipe, module that it is imported by, pinned packages."""
    return tomllib.loads(PACKAGES.read_text(encoding="utf-8"))


def recipe(heading: str) -> list[tuple[str, str]]:
    """Language and text of the blocks under a heading of the page, and of files that it includes."""
    text = PAGE.read_text(encoding="utf-8")
    found = BLOCK.findall(text[text.index(f"\n## {heading}\n") :].split("\n## ")[1])
    return [_read(language, block) for language, block in found]


def _read(language: str, block: str) -> tuple[str, str]:
    """A block as it stands, or the file that it includes."""
    _, include, name = language.partition("{literalinclude} ")
    return ("python", (PAGE.parent / name).read_text(encoding="utf-8")) if include else (language, block)


def shortened(text: str) -> str:
    """A block with a training of a few seconds."""
    return re.sub(r"(?<=steps = )[\d_]+|(?<=steps, epochs = )[\d_]+|(?<=--n-timesteps )\d+", str(SHORT), text)


def recipe_hash(packages: Sequence[str], blocks: Sequence[tuple[str, str]]) -> str:
    """What a result belongs to."""
    return hashlib.sha256(json.dumps([packages, blocks]).encode()).hexdigest()


def commands(blocks: Sequence[tuple[str, str]], python: str) -> Iterator[list[str]]:
    """Blocks as commands, one for each Python block and each line of a shell's."""
    for language, text in blocks:
        if language == "python":
            yield [python, "-W", "ignore", "-c", text]
        else:
            for line in text.splitlines():
                words = shlex.split(line)
                program = {"python": [], "pickenv": ["-m", "pickenv.cli"]}[words[0]]
                yield [python, "-W", "ignore", *program, *words[1:]]


def set_up(folder: Path, packages: Sequence[str]) -> str:
    """Make a client's environment, or find it as it is; gives its Python."""
    said = folder / "packages.json"
    python = folder / "bin" / "python"
    if said.exists() and json.loads(said.read_text(encoding="utf-8")) == list(packages):
        return str(python)
    venv.create(folder, with_pip=True, clear=True)
    site = next(folder.glob("lib/python*/site-packages"))
    write_text(site / "parent.pth", f"{ROOT}\n{sysconfig.get_paths()['purelib']}\n")
    if packages:
        given = ["--no-deps", "--ignore-requires-python", *packages]
        pip = [str(python), "-m", "pip", "--disable-pip-version-check", "--quiet", "install", *given]
        subprocess.run(pip, check=True)
    write_json(said, list(packages))
    return str(python)


def run(name: str, folder: Path, quick: bool) -> dict[str, Any]:
    """Run a client's recipe, or give what it printed before.

    Raises:
        RuntimeError: If a command of it fails.
    """
    client = clients()[name]
    packages, blocks = client["packages"], recipe(client["heading"])
    if quick:
        blocks = [(language, shortened(text)) for language, text in blocks]
    key = recipe_hash(packages, blocks)
    kept = folder / "results" / f"{name}-{key[:16]}.json"
    if kept.exists():
        found: dict[str, Any] = json.loads(kept.read_text(encoding="utf-8"))
        return found
    python = set_up(folder / name, packages)
    place = folder / "work" / f"{name}-{key[:16]}"
    shutil.rmtree(place, ignore_errors=True)  # of a run that was cut off: RL Zoo counts what it finds
    place.mkdir(parents=True)
    given = os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1", "MPLBACKEND": "Agg"}
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    said = ""
    for command in commands(blocks, python):
        done = subprocess.run(command, cwd=place, env=given, capture_output=True, text=True)
        if done.returncode != 0:
            raise RuntimeError(f"{name}: {done.stdout[-2000:]}\n{done.stderr[-4000:]}")
        said += done.stdout
    seconds = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime - before
    row = {"client": name, "packages": packages, "processor_s": round(seconds, 1), "quick": quick, "recipe": key}
    row |= {key: float(mm) for key, mm in PRINTED.findall(said)}
    write_json(kept, row)
    return row


def main() -> None:
    """Run clients one after the other and print their rows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--client", action="append", choices=clients(), help="a client, again for another; all if left out"
    )
    parser.add_argument(
        "--folder", type=Path, default=ROOT / ".venv-clients", help="where environments and results are kept"
    )
    parser.add_argument("--quick", action="store_true", help="trainings of a few seconds, to see that they run")
    parser.add_argument("--json", type=Path, help="write the rows here")
    given = parser.parse_args()
    rows = []
    for name in given.client or clients():
        rows.append(run(name, given.folder.resolve(), given.quick))
        print("; ".join(f"{key} {value}" for key, value in rows[-1].items() if key != "packages"), flush=True)
    if given.json:
        write_json(given.json, rows)


if __name__ == "__main__":
    sys.exit(main())
