"""Would the tests notice? One operator, number or condition at a time is changed in the lines that make numbers.

mutmut makes the mutants; each is tried in a copy of the project, against the tests of its room alone, and is killed if
one of them fails or does not end in time. What is written after each mutant is taken up again by the next run: a mutant
is tried again only if its file has changed or, where it survived, the tests of its room have. Text, messages and what a
decorator covers are left as they are.

Run: python scripts/mutants.py [--room NAME]... [--sample N] [--seed S] [--json FILE]
"""

from __future__ import annotations

import compileall
import hashlib
import json
import multiprocessing
import os
import random
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from py_compile import PycInvalidationMode
from typing import Annotated, Any

import libcst as cst
import typer
from libcst.metadata import MetadataWrapper, PositionProvider
from mutmut.mutation import mutators
from mutmut.mutation.file_mutation import MutationVisitor
from mutmut.mutation.pragma_handling import IgnoredCode

ROOT = Path(__file__).parents[1]
LEFT_BEHIND = (".git", ".venv", "runs", "dist", "__pycache__", ".*_cache", ".hypothesis", ".benchmarks", ".development")
LEAST_SECONDS, PATIENCE = 120.0, 5.0
"""A room's tests may take this long, or this many times as long as they do without a mutant."""
MOST_BYTES = 8 * 2**30
"""Of memory, for a mutant that never stops growing."""
WARM = multiprocessing.get_context("forkserver")
"""Every mutant has a new process, into which the libraries, and nothing of ours, are loaded already."""
LIBRARIES = [
    "pytest",
    "hypothesis.strategies",
    "gymnasium",
    "scipy.optimize",
    "scipy.stats",
    "torch",
    "pyarrow.dataset",
]


@dataclass(frozen=True)
class Room:
    """Lines that make numbers, and the tests that should notice a change in them.

    Attributes:
        sources: Modules, without ``.py``.
        tests: Test modules, without ``test_`` and ``.py``, quickest first.
    """

    sources: tuple[str, ...]
    tests: tuple[str, ...]


def room(sources: str, modules: str, tests: str, names: str) -> Room:
    """A room from folder and names of its modules, and of its tests."""
    return Room(
        tuple(f"{sources}/{name}.py" for name in modules.split()),
        tuple(f"{tests}/{Path(name).parent / f'test_{Path(name).name}.py'}" for name in names.split()),
    )


ROOMS = {
    "kinematics": room(
        "pickenv/arm/kinematics",
        "forward jacobians pose_error",
        "tests/arm",
        "kinematics/kinematics kinematics/jacobians kinematics/geometry kinematics/executors kinematics/random_chains "
        "plant/gravity_referee",
    ),
    "plant": room(
        "pickenv/arm",
        "plant/dynamics plant/plant effects/structure effects/drives effects/hysteresis effects/settling "
        "effects/thermal effects/ground",
        "tests/arm",
        "plant/plant effects/effects effects/backlash effects/thermal effects/ground effects/settling "
        "kinematics/executors plant/orchard_preset plant/gravity_referee",
    ),
    "least squares": room(
        "calibration",
        "identification/least_squares model/error_model model/identifiability",
        "tests/calibration",
        "identification/least_squares model/identifiability model/observations identification/align",
    ),
    "compensation": room(
        "calibration",
        "compensation/compensator pipeline/apply",
        "tests/calibration",
        "pipeline/apply compensation/compensation",
    ),
    "reward": room(
        "pickenv/envs/shared", "simulation task", "tests/envs", "reach compensation_wrapper registered vector"
    ),
    "picking": room(
        "pickenv/harvester",
        "picking work harvest",
        "tests/harvester",
        "picking assignment interference harvest environments",
    ),
    "yields": room(
        "pickenv/study",
        "results/outcomes results/quantiles results/yields",
        "tests/study",
        "yields quantiles rows report",
    ),
}


@dataclass(frozen=True)
class Mutant:
    """One change.

    Attributes:
        path: The file.
        line: Its first line, from 1.
        change: What stood there, and what stands there now.
        module: The file as it is.
        old: What is changed in it.
        new: Into what.
    """

    path: str
    line: int
    change: str
    module: cst.Module
    old: cst.CSTNode
    new: cst.CSTNode

    @property
    def key(self) -> str:
        """Where and what, in words."""
        return f"{self.path}:{self.line} {self.change}"

    @property
    def code(self) -> str:
        """The whole file with the change."""
        changed = self.module.deep_replace(self.old, self.new)
        assert isinstance(changed, cst.Module)
        return changed.code


def dropped_options(call: cst.Call) -> Iterator[cst.CSTNode]:
    """The call without one of its named arguments; without another, or with None, mutmut's ideas, it only crashes."""
    named = {i for i, argument in enumerate(call.args) if argument.keyword is not None and not is_guard(argument)}
    shorter = [found for found in mutators.operator_arg_removal(call) if len(found.args) < len(call.args)]
    return (found for i, found in enumerate(shorter) if i in named)


def is_guard(node: cst.CSTNode) -> bool:
    """Whether it is the ``strict=True`` of a zip, which changes nothing where lengths are equal."""
    return isinstance(node, cst.Arg) and node.keyword is not None and node.keyword.value == "strict"


OPERATORS: mutators.OPERATORS_TYPE = [
    (cst.BaseNumber, mutators.operator_number),
    (cst.Name, mutators.operator_name),
    (cst.AugAssign, mutators.operator_augmented_assignment),
    (cst.UnaryOperation, mutators.operator_remove_unary_ops),
    (cst.CSTNode, mutators.operator_keywords),
    (cst.CSTNode, mutators.operator_swap_op),
    (cst.IfExp, mutators.operator_if_exp),
    (cst.Call, dropped_options),
]
"""Of mutmut's, those that change a number or which way is taken."""


class Changes(MutationVisitor):
    """mutmut's search for changes, but for what is said to people."""

    def on_visit(self, node: cst.CSTNode) -> bool:
        """Whether to look into a node."""
        said = isinstance(node, cst.Raise | cst.Assert | cst.FormattedString)
        return not said and not is_guard(node) and super().on_visit(node)


def mutants_of(path: str, code: str) -> list[Mutant]:
    """Every mutant of a file, in the order of its lines."""
    wrapper = MetadataWrapper(cst.parse_module(code))
    places = wrapper.resolve(PositionProvider)
    visitor = Changes(OPERATORS, IgnoredCode(set(), set(), set()))
    module = wrapper.visit(visitor)
    found: list[Mutant] = []
    seen = Counter[tuple[int, str]]()
    for mutation in visitor.mutations:
        old, new = mutation.original_node, mutation.mutated_node
        line = places[old].start.line if old in places else 0
        change = " ".join(f"{module.code_for_node(old)} -> {module.code_for_node(new)}".split())
        seen[line, change] += 1
        if seen[line, change] > 1:
            change += f" (no. {seen[line, change]})"
        found.append(Mutant(path, line, change, module, old, new))
    return found


def shuffled(name: str, seed: int) -> list[Mutant]:
    """All of a room's mutants in random order: the first of them are a sample, and a larger one holds a smaller."""
    found = [m for path in ROOMS[name].sources for m in mutants_of(path, (ROOT / path).read_text(encoding="utf-8"))]
    random.Random(f"{seed} {name}").shuffle(found)
    return found


def fingerprint(paths: Iterable[Path]) -> str:
    """Of the contents of files."""
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in sorted(paths))).hexdigest()[:16]


def ask_pytest(copy: str, tests: list[str]) -> None:
    """End this process, which has nothing of ours loaded, as pytest ends in the copy."""
    os.setsid()
    if sys.platform == "linux":
        import resource

        resource.setrlimit(resource.RLIMIT_DATA, (MOST_BYTES, MOST_BYTES))
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in range(3):
        os.dup2(nowhere, stream)
    os.chdir(copy)
    os.environ["PYTHONPATH"] = copy
    sys.path.insert(0, copy)
    sys.dont_write_bytecode = True
    import pytest

    import pickenv

    assert Path(pickenv.__file__).is_relative_to(copy)
    options = ["-x", "-q", "--tb=no", "-p", "no:cacheprovider", "-W", "ignore::pytest.PytestAssertRewriteWarning"]
    os._exit(pytest.main([*options, *tests]))  # the warning: hypothesis is among the libraries loaded already


def run_tests(copy: Path, tests: Iterable[str], seconds: float | None) -> str:
    """What pytest says of the copy: "passed", "failed" (also: cannot even be imported) or "took too long"."""
    process = WARM.Process(target=ask_pytest, args=(str(copy), list(tests)))
    process.start()
    try:
        process.join(seconds)
        return {0: "passed", None: "took too long"}.get(process.exitcode, "failed")
    finally:  # with whatever the tests had started, also when we are interrupted
        if process.is_alive() and process.pid is not None:
            os.killpg(process.pid, signal.SIGKILL)
        process.join()


def nearest_first(path: str, tests: tuple[str, ...]) -> list[str]:
    """Test modules, those first that carry the name of the file."""
    return sorted(tests, key=lambda test: Path(path).stem not in test)


def try_room(name: str, mutants: list[Mutant], known: dict[str, dict[str, Any]], copy: Path) -> Iterator[Mutant]:
    """Try a room's mutants, put the verdicts into ``known``, and name each mutant when it has one."""
    tests = ROOMS[name].tests
    tests_now = fingerprint(ROOT / test for test in tests)
    files_now = {path: fingerprint([ROOT / path]) for path in ROOMS[name].sources}
    limit: float | None = None
    for mutant in mutants:
        before = known.get(mutant.key)
        if before is not None and before["file"] == files_now[mutant.path] and before["tests"] in ("any", tests_now):
            yield mutant
            continue
        if limit is None:
            begin = time.monotonic()
            if run_tests(copy, tests, None) != "passed":
                raise SystemExit(f"the tests of {name} fail without any mutant; mend them first")
            limit = max(LEAST_SECONDS, PATIENCE * (time.monotonic() - begin))
        begin = time.monotonic()
        (copy / mutant.path).write_text(mutant.code, encoding="utf-8")
        verdict = run_tests(copy, nearest_first(mutant.path, tests), limit)
        shutil.copyfile(ROOT / mutant.path, copy / mutant.path)
        known[mutant.key] = {
            "room": name,
            "verdict": verdict,
            "file": files_now[mutant.path],
            "tests": tests_now if verdict == "passed" else "any",
            "seconds": round(time.monotonic() - begin, 1),
        }
        yield mutant


def table(rows: dict[str, dict[str, Any]]) -> str:
    """The score by room, with Wilson's interval; what took too long counts as killed."""
    lines = [
        f"{'room':<14} {'mutants':>8} {'tried':>6} {'killed':>7} {'of these late':>14} {'score':>7}  95 % interval"
    ]
    for name, row in rows.items():
        low, high = row["interval"]
        lines.append(
            f"{name:<14} {row['mutants']:>8} {row['tried']:>6} {row['killed']:>7} {row['late']:>14} "
            f"{row['score']:>7.1%}  {low:.1%} to {high:.1%}"
        )
    return "\n".join(lines)


def row_of(mutants: int, verdicts: list[str]) -> dict[str, Any]:
    """The score of some verdicts."""
    from pickenv.intervals import share_interval as wilson_interval  # late: see WARM

    late, killed = verdicts.count("took too long"), len(verdicts) - verdicts.count("passed")
    return {
        "mutants": mutants,
        "tried": len(verdicts),
        "killed": killed,
        "late": late,
        "score": killed / len(verdicts),
        "interval": wilson_interval(killed, len(verdicts)),
    }


def main(
    room: Annotated[list[str] | None, typer.Option(help=f"One of {', '.join(ROOMS)}; all when left out.")] = None,
    sample: Annotated[
        int | None, typer.Option(min=1, help="Mutants of each room, at random; all when left out.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the sample.")] = 0,
    json_file: Annotated[Path, typer.Option("--json", help="Where verdicts are kept.")] = Path("runs/mutants.json"),
) -> None:
    """Change the lines that make numbers, one at a time, and count what the tests notice."""
    from pickenv.files import write_text  # late: see WARM

    names = room or list(ROOMS)
    if unknown := set(names) - set(ROOMS):
        raise SystemExit(f"unknown room '{min(unknown)}'; give one of {', '.join(ROOMS)}")
    known: dict[str, dict[str, Any]] = {}
    if json_file.exists():
        known = json.loads(json_file.read_text(encoding="utf-8"))["mutants"]
    mutants = {name: shuffled(name, seed) for name in names}
    json_file.parent.mkdir(parents=True, exist_ok=True)
    rows: dict[str, dict[str, Any]] = {}
    survivors: list[str] = []
    os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    os.environ |= {
        "MPLBACKEND": "Agg",
        "PICKENV_DATA": os.environ.get("PICKENV_DATA") or str(ROOT.parent / "shared/data"),
    }
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ended from outside is ended as by Ctrl-C
    WARM.set_forkserver_preload(["__main__", *LIBRARIES])
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "project"
        shutil.copytree(ROOT, copy, symlinks=True, ignore=shutil.ignore_patterns(*LEFT_BEHIND))
        for package in ("pickenv", "calibration", "agents"):
            compileall.compile_dir(copy / package, quiet=2, invalidation_mode=PycInvalidationMode.CHECKED_HASH)
        for name in names:
            verdicts: list[str] = []
            for mutant in try_room(name, mutants[name][:sample], known, copy):
                verdicts.append(known[mutant.key]["verdict"])
                if verdicts[-1] == "passed":
                    survivors.append(mutant.key)
                    print(f"survives: {mutant.key}", flush=True)
                rows[name] = row_of(len(mutants[name]), verdicts)
                result = {"sample": sample, "seed": seed, "rooms": rows, "mutants": known}
                write_text(json_file, json.dumps(result, indent=1, ensure_ascii=False) + "\n")
            print(f"{name}: {len(verdicts)} tried, {verdicts.count('passed')} survive", flush=True)
    print(table(rows))
    print(f"{len(survivors)} survive; each is a test to write, or a change that makes no difference")


if __name__ == "__main__":
    typer.run(main)
