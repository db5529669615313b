"""What the benchmarks share: their options, clocks, the machine that they run on, and tables in Markdown."""

import multiprocessing
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Annotated, Any, NoReturn

import numpy as np
import scipy
import typer

from pickenv.arm import Array
from pickenv.base import InputError

ROOT = Path(__file__).parents[1]
DATA = ROOT / "../shared/data"
JsonFile = Annotated[Path | None, typer.Option("--json", help="Also write the figures to this file.")]
DataFolder = Annotated[Path, typer.Option(envvar="PICKENV_DATA", help="Folder of the measured data sets.")]
NoPeers = Annotated[bool, typer.Option("--no-peers", help="Leave the peers out; nothing is installed.")]
EnvironmentPeers = Annotated[Path, typer.Option(help="Where the peers' packages are installed.")]


def rate(step: Callable[[], int], seconds: float, clock: Callable[[], float] = time.process_time) -> float:
    """Best of three rounds of environment steps per second: other work on the machine only ever slows a round.

    ``clock`` counts seconds: of the processor, for what runs on one core, or of the wall.
    """
    step()
    best = 0.0
    for _ in range(3):
        steps, begin = 0, clock()
        while clock() - begin < seconds / 3:
            steps += step()
        best = max(best, steps / (clock() - begin))
    return best


def fastest(
    steps: Mapping[str, Callable[[], Any]], seconds: float, clock: Callable[[], float] = time.perf_counter
) -> dict[str, float]:
    """Least time of each, s; taken in turns, so that other work on the machine meets all alike."""
    best, begin = dict.fromkeys(steps, float("inf")), time.perf_counter()
    while time.perf_counter() - begin < seconds:
        for name, step in steps.items():
            before = clock()
            step()
            best[name] = min(best[name], clock() - before)
    return best


def timed(function: Callable[[], Any], runs: int) -> tuple[Any, Array]:
    """The last result, and seconds ``(2, runs)`` by the clock and of the processor, after one run that is not counted.

    NumPy's threads are held to one where pickenv holds them, so that processor time is time by the clock when quiet.
    """
    function()
    seconds = []
    for _ in range(runs):
        begin, cpu = time.perf_counter(), time.process_time()
        result = function()
        seconds.append((time.perf_counter() - begin, time.process_time() - cpu))
    return result, np.array(seconds).T


def in_fresh_process(function: Callable[..., Any], *arguments: Any) -> Any:
    """What a function returns in a process of its own, which nothing before has warmed or set."""
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as fresh:
        return fresh.submit(function, *arguments).result()


def machine() -> dict[str, Any]:
    """What the figures were measured on."""
    listing = Path("/proc/cpuinfo")
    lines = listing.read_text().splitlines() if listing.is_file() else []
    names = [line.partition(":")[2].strip() for line in lines if "model name" in line]
    return {
        "cpu": names[0] if names else platform.processor() or platform.machine(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "load_before": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "platform": platform.system(),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "scipy": scipy.__version__,
    }


def refuse(sentence: str) -> NoReturn:
    """Say what is wrong, and end with exit code 2."""
    print(sentence, file=sys.stderr)
    raise typer.Exit(2)


def figure(value: float | None, form: str) -> str:
    """A number as it is printed; a dash for what was not measured."""
    return "-" if value is None else format(value, form)


def markdown_table(heads: Sequence[str], rows: Iterable[Sequence[str]], words: Collection[str]) -> str:
    """A table in Markdown; columns other than ``words`` are set to the right."""
    rule = [":--" if head in words else "--:" for head in heads]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (heads, rule, *rows))


def python_with(home: Path, *packages: str) -> Path:
    """The Python of an environment that has these packages from PyPI; it is made if it is missing or has others.

    Raises:
        InputError: If it cannot be made, with the installer's last words.
    """
    home = home.resolve()
    python, done = home / ("Scripts/python.exe" if os.name == "nt" else "bin/python"), home / "installed"
    install = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", *packages]
    wanted = "\n".join(packages)
    if done.is_file() and done.read_text(encoding="utf-8") == wanted:
        return python
    for command in ([sys.executable, "-m", "venv", "--clear", home], install):
        ended = subprocess.run(command, capture_output=True, text=True)
        if ended.returncode:
            raise InputError(f"cannot be installed: {last_words(ended.stderr or ended.stdout)}")
    done.write_text(wanted, encoding="utf-8")
    return python


def last_words(text: str) -> str:
    """The last line of a text that mentions an error, or else its last line that is not blank."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    errors = [line for line in lines if "error" in line.lower()]
    return (errors or lines or ["without a word"])[-1]
