"""Four newcomers walk through the README: every line typed in a fresh environment, timed, up to its last number.

Each walk clones the checkout, makes an environment without caches, and types what the README prints, in its order and
nothing else. The table says how many commands that were, how long they took on the clock and of processor time (which
other programs on the computer lengthen less), and what the environment takes on the disk. The JSON holds the
newcomer's last line as well.

Run: python .ci/walks.py [--only NAME] [--out runs/walks.json]

With all four walked, the table of docs/installation.md is written anew.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import shlex
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/installation.md"
TABLE = re.compile(r"^\| newcomer \|.*?(?=\n\n)", re.MULTILINE | re.DOTALL)
BLOCK = re.compile(r"^```(\w+)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
FULL = ("python scripts/install_torch.py", 'pip install ".[rl,inspect]"')
CORE = ("pip install .",)


@dataclass(frozen=True)
class Newcomer:
    """Who walks, and which parts of the README are theirs.

    Attributes:
        install: The lines of the README that install what they need.
        parts: Heads of the parts that they type after the demonstration.
        last: Pattern of the line with their last number, in what the last command prints.
    """

    install: tuple[str, ...]
    parts: tuple[str, ...]
    last: str


NEWCOMERS: Mapping[str, Newcomer] = {
    "RL researcher": Newcomer(FULL, ("Ten lines", "Train and compare policies"), r".*[-+][\d.]+ \(.*"),
    "calibration engineer": Newcomer(CORE, ("Calibrate a robot of your own",), r"verdict: .*"),
    "orchard roboticist": Newcomer(CORE, ("Plan a harvest",), r".*raw to ls .* mm.*"),
    "student": Newcomer(CORE, ("Ten lines",), r"corrected: .* mm.*"),
}


@dataclass(frozen=True)
class Walk:
    """What a walk took.

    Attributes:
        who: The newcomer.
        typed: The commands; a program counts as one.
        seconds: Of each, on the clock.
        processor_seconds: Of each, of all its processes.
        megabytes: What the environment takes on the disk.
        last: The last line that they read.
    """

    who: str
    typed: tuple[str, ...]
    seconds: tuple[float, ...]
    processor_seconds: tuple[float, ...]
    megabytes: float
    last: str


def part(readme: str, head: str) -> str:
    """The text under a head, up to the next one."""
    found = re.search(rf"^#+ {re.escape(head)}$(.*?)(?=^#+ |\Z)", readme, re.M | re.S)
    if found is None:
        raise SystemExit(f"README has no part '{head}'")
    return found[1]


def typed(readme: str, newcomer: Newcomer) -> list[tuple[str, str]]:
    """What a newcomer types, as language and text: the way in, the demonstration, then their parts.

    Args:
        readme: The README.
        newcomer: Who.
    """
    lines: list[tuple[str, str]] = []
    for head in ("Install", *newcomer.parts):
        for language, text in BLOCK.findall(part(readme, head)):
            lines += [(language, text)] if language == "python" else [("sh", line) for line in text.splitlines()]
    kept = [each for each in lines if each[1] not in (*FULL, *CORE)]
    demo = next(i for i, each in enumerate(kept) if each[1].startswith("pickenv demo"))
    kept[demo:demo] = [("sh", line) for line in newcomer.install]
    return [("sh", "git clone pickenv && cd pickenv"), *kept]


def megabytes(folder: Path) -> float:
    """What a folder takes on the disk."""
    return sum(path.lstat().st_blocks * 512 for path in folder.rglob("*")) / 1e6


def walk(who: str, python: str, folder: Path) -> Walk:
    """Walk as a newcomer, in an empty folder.

    Raises:
        SystemExit: If a command fails, or prints no last number; with what it said.
    """
    newcomer, place = NEWCOMERS[who], folder / "pickenv"
    lines = typed((ROOT / "README.md").read_text(encoding="utf-8"), newcomer)
    kept = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    path = os.pathsep.join([str(place / ".venv/bin"), *os.environ["PATH"].split(os.pathsep)])
    environment = kept | {"PATH": path, "PIP_NO_CACHE_DIR": "1", "MPLBACKEND": "Agg", "COLUMNS": "200"}
    seconds, busy, said = [], [], ""
    for language, text in lines:
        words: Sequence[str] = ["python", "-c", text] if language == "python" else shlex.split(text)
        if words[0] == "git":
            words = ["git", "clone", "--quiet", str(ROOT), str(place)]
        elif words[0] == "python3":
            words = [python, *words[1:]]
        start, before = time.perf_counter(), _processor_seconds()
        if words[0] != ".":  # activated by the path above
            cwd = folder if words[0] == "git" else place
            done = subprocess.run(words, cwd=cwd, env=environment, capture_output=True, text=True, check=False)
            if done.returncode:
                raise SystemExit(f"{who}: {text} ended with {done.returncode}\n{done.stdout}\n{done.stderr}")
            said = done.stdout
        seconds.append(round(time.perf_counter() - start, 1))
        busy.append(round(_processor_seconds() - before, 1))
        print(f"{who}: {seconds[-1]:6.1f} s  {text.splitlines()[0]}", file=sys.stderr, flush=True)
    found = re.findall(newcomer.last, said)
    if not found:
        raise SystemExit(f"{who}: no last number in what {lines[-1][1].splitlines()[0]} printed:\n{said}")
    commands = tuple(text for _, text in lines)
    last = " ".join(found[-1].replace("│", " ").split())
    return Walk(who, commands, tuple(seconds), tuple(busy), round(megabytes(place / ".venv"), 0), last)


def _processor_seconds() -> float:
    """Processor time of all commands so far."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def table(walks: Sequence[Walk]) -> str:
    """The walks as a Markdown table."""
    heads = ("newcomer", "commands", "minutes on the clock", "of processor time", "environment (MB)")
    rows = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for each in walks:
        minutes, busy = sum(each.seconds) / 60, sum(each.processor_seconds) / 60
        rows.append(f"| {each.who} | {len(each.typed)} | {minutes:.1f} | {busy:.1f} | {each.megabytes:.0f} |")
    return "\n".join(rows)


def main() -> None:
    """Walk, print the table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--only", choices=list(NEWCOMERS), action="append", help="Walk as this one alone.")
    parser.add_argument("--python", default=sys.executable, help="Python that makes the environments.")
    parser.add_argument("--out", type=Path, default=Path("runs/walks.json"), help="Where the JSON goes.")
    asked = parser.parse_args()
    known = json.loads(asked.out.read_text(encoding="utf-8")) if asked.out.exists() and asked.only else []
    walks = [Walk(**each) for each in known if each["who"] not in asked.only]
    for who in asked.only or NEWCOMERS:
        with tempfile.TemporaryDirectory(prefix="walk-") as folder:
            walks.append(walk(who, asked.python, Path(folder)))
        asked.out.parent.mkdir(parents=True, exist_ok=True)
        asked.out.write_text(json.dumps([asdict(each) for each in walks], indent=1), encoding="utf-8")
    said = table(sorted(walks, key=lambda each: list(NEWCOMERS).index(each.who)))
    print(said)
    if {each.who for each in walks} == set(NEWCOMERS):
        page = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(TABLE.sub(lambda _: said, page), encoding="utf-8")


if __name__ == "__main__":
    main()
