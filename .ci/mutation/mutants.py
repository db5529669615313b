"""Would the tests notice? One operator, number or condition at a time is changed in the lines that make numbers.

mutmut makes the mutants; each is tried in a copy of the project, against the tests of its room alone, and is killed if
one of them fails or does not end in time. What is written after each mutant is taken up again by the next run: a mutant
is tried again only if its file has changed or, where it survived, the tests of its room have. Text, messages, what a
decorator covers and how a drawing looks are left as they are, and so are changes that make no difference
(mutants_equivalent.toml). A sample's score is kept when its room is done, and stands whatever becomes of the tests; the
page is made of what is kept.

Run: python .ci/mutation/mutants.py [--room NAME]... [--sample N] [--seed S] [--again] [--known]
     [--json FILE] [--also FILE]... [--page FILE]
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import shutil
import signal
import tempfile
import time
import tomllib
from collections import Counter
from collections.abc import Iterable, Iterator, Set
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import libcst as cst
import typer
from libcst.metadata import MetadataWrapper, PositionProvider
from mutants_score import Equivalents, Score, as_lines, page_of, read_equivalents, score_of, summary_of, table
from mutants_trials import LIBRARIES, ROOT, WARM, copied_project, run_tests
from mutmut.mutation import mutators
from mutmut.mutation.file_mutation import MutationVisitor
from mutmut.mutation.pragma_handling import IgnoredCode

LEAST_SECONDS, PATIENCE = 120.0, 5.0
"""A room's tests may take this long, or this many times as long as they do without a mutant."""
KEPT = Path(__file__).with_name("mutants_kept.json")
"""Verdicts of today's files, and the scores of samples."""


@dataclass(frozen=True)
class Room:
    """Lines that make numbers, and the tests that should notice a change in them.

    Attributes:
        sources: Modules.
        tests: Test modules, quickest first.
        most: How many of its mutants are tried, at random, unless a run says otherwise.
    """

    sources: list[str]
    tests: list[str]
    most: int


ROOMS = {
    name: Room(**table)
    for name, table in tomllib.loads(Path(__file__).with_name("mutants_rooms.toml").read_text(encoding="utf-8")).items()
}


@dataclass(frozen=True)
class Mutant:
    """One change.

    Attributes:
        path: The file.
        line: Its first line, from 1.
        text: That line as it stands.
        change: What stood there, and what stands there now.
        module: The file as it is.
        old: What is changed in it.
        new: Into what.
    """

    path: str
    line: int
    text: str
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


def dropped_options(looks: Set[str], call: cst.Call) -> Iterator[cst.CSTNode]:
    """The call without one of its named arguments; without another, or with None, mutmut's ideas, it only crashes."""
    named = {i for i, argument in enumerate(call.args) if argument.keyword is not None and not is_left(argument, looks)}
    shorter = [found for found in mutators.operator_arg_removal(call) if len(found.args) < len(call.args)]
    return (found for i, found in enumerate(shorter) if i in named)


LOOKS = (
    "alpha aspect bbox bbox_to_anchor borderaxespad borderpad capsize clip_on color colors columnspacing edgecolor "
    "edgecolors extend facecolor facecolors fontsize frameon ha handlelength handletextpad headlength headwidth "
    "height_ratios hspace labelpad labelsize labelspacing length linestyle linestyles linewidth linewidths loc "
    "location lw marker markersize mew minor ms ncols pad rasterized rotation s sharex sharey shrink size squeeze "
    "style textcoords va visible weight which width_ratios wspace xlim xytext ylim zorder"
)
"""Options in `DRAWINGS` that say how a drawing looks; no number that it shows."""
DRAWINGS = "pickenv/inspect/figures/"


def is_left(node: cst.CSTNode, looks: Set[str]) -> bool:
    """Whether it is an option that changes no number where the input is sound.

    The ``strict=True`` of a zip, whose lengths are equal then; a ``dtype=float``; how a drawing looks.
    """
    if not isinstance(node, cst.Arg) or node.keyword is None:
        return False
    is_float = isinstance(node.value, cst.Name) and node.value.value == "float"
    name = node.keyword.value
    return name == "strict" or (name == "dtype" and is_float) or name in looks


def sizes_to_work_out(call: cst.Call) -> list[cst.CSTNode]:
    """The 1 in ``reshape(-1, ...)``: NumPy works out the size in place of any number below zero."""
    if not (isinstance(call.func, cst.Attribute) and call.func.attr.value == "reshape"):
        return []
    return [argument.value.expression for argument in call.args if isinstance(argument.value, cst.UnaryOperation)]


OPERATORS: mutators.OPERATORS_TYPE = [
    (cst.BaseNumber, mutators.operator_number),
    (cst.Name, mutators.operator_name),
    (cst.AugAssign, mutators.operator_augmented_assignment),
    (cst.UnaryOperation, mutators.operator_remove_unary_ops),
    (cst.CSTNode, mutators.operator_keywords),
    (cst.CSTNode, mutators.operator_swap_op),
    (cst.IfExp, mutators.operator_if_exp),
]
"""Of mutmut's, those that change a number or which way is taken."""


class Changes(MutationVisitor):
    """mutmut's search for changes, but for what is said to people, and for how what is drawn looks."""

    def __init__(self, looks: Set[str]) -> None:
        operators = [*OPERATORS, (cst.Call, partial(dropped_options, looks))]
        super().__init__(operators, IgnoredCode(set(), set(), set()))
        self.looks, self.left = looks, list[cst.CSTNode]()

    def on_visit(self, node: cst.CSTNode) -> bool:
        """Whether to look into a node."""
        if isinstance(node, cst.Call):
            self.left += sizes_to_work_out(node)
        said = isinstance(node, cst.Raise | cst.Assert | cst.FormattedString)
        return not said and not is_left(node, self.looks) and node not in self.left and super().on_visit(node)


def mutants_of(path: str, code: str) -> list[Mutant]:
    """Every mutant of a file, in the order of its lines."""
    wrapper = MetadataWrapper(cst.parse_module(code))
    places = wrapper.resolve(PositionProvider)
    visitor = Changes(set(LOOKS.split() if path.startswith(DRAWINGS) else ()))
    module = wrapper.visit(visitor)
    lines = code.splitlines()
    found: list[Mutant] = []
    seen = Counter[tuple[int, str]]()
    for mutation in visitor.mutations:
        old, new = mutation.original_node, mutation.mutated_node
        line = places[old].start.line if old in places else 0
        change = " ".join(f"{module.code_for_node(old)} -> {module.code_for_node(new)}".split())
        seen[line, change] += 1
        if seen[line, change] > 1:
            change += f" (no. {seen[line, change]})"
        found.append(Mutant(path, line, lines[line - 1].strip() if line else "", change, module, old, new))
    return found


def mutants_in(name: str) -> list[Mutant]:
    """Every mutant of a room."""
    return [m for path in ROOMS[name].sources for m in mutants_of(path, (ROOT / path).read_text(encoding="utf-8"))]


def shuffled(name: str, seed: int, equivalents: Equivalents) -> list[Mutant]:
    """A room's mutants that matter in random order: the first are a sample, and a larger one holds a smaller."""
    found = mutants_in(name)
    random.Random(f"{seed} {name}").shuffle(found)
    return [m for m in found if (m.path, m.text, m.change) not in equivalents]


def fingerprint(paths: Iterable[Path]) -> str:
    """Of the contents of files."""
    return hashlib.sha256(b"\0".join(path.read_bytes() for path in sorted(paths))).hexdigest()[:16]


def nearest_first(path: str, tests: Iterable[str]) -> list[str]:
    """Test modules, those first that carry the name of the file."""
    return sorted(tests, key=lambda test: Path(path).stem not in test)


def of_todays_files(known: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Those verdicts whose file is the same: of survivors too, whatever has become of the tests."""
    files = {path: fingerprint([ROOT / path]) for room in ROOMS.values() for path in room.sources}
    return {key: told for key, told in known.items() if told["file"] == files.get(key.split(":")[0])}


def still_true(known: dict[str, dict[str, Any]]) -> dict[str, dict[str, Any]]:
    """Those verdicts that a new trial would repeat: the file is the same and, of a survivor, the room's tests."""
    tests = {name: fingerprint(ROOT / test for test in room.tests) for name, room in ROOMS.items()}
    files = {path: fingerprint([ROOT / path]) for room in ROOMS.values() for path in room.sources}
    return {
        key: told
        for key, told in known.items()
        if told["file"] == files.get(key.split(":")[0]) and told["tests"] in ("any", tests.get(told["room"]))
    }


def try_room(name: str, mutants: list[Mutant], known: dict[str, dict[str, Any]], copy: Path) -> Iterator[Mutant]:
    """Try a room's mutants but those ``known``, put the verdicts there, and name each mutant when it has one."""
    tests = ROOMS[name].tests
    tests_now = fingerprint(ROOT / test for test in tests)
    files_now = {path: fingerprint([ROOT / path]) for path in ROOMS[name].sources}
    limit: float | None = None
    for mutant in mutants:
        if mutant.key in known:
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


def kept_in(files: Iterable[Path]) -> tuple[list[Score], dict[str, dict[str, Any]]]:
    """Scores of samples, each of the first file that has it, and verdicts, each of the last one, that files hold."""
    samples: dict[tuple[int | None, str], Score] = {}
    verdicts: dict[str, dict[str, Any]] = {}
    for path in files:
        kept = json.loads(path.read_text(encoding="utf-8"))
        for told in kept["samples"]:
            samples.setdefault((told["seed"], told["room"]), Score(**told))
        verdicts |= kept["mutants"]
    return list(samples.values()), verdicts


def main(
    room: Annotated[list[str] | None, typer.Option(help=f"One of {', '.join(ROOMS)}; all when left out.")] = None,
    sample: Annotated[
        int | None, typer.Option(min=0, help="Mutants of each room, at random; the room's own number, or all with 0.")
    ] = None,
    seed: Annotated[int, typer.Option(help="Seed of the sample.")] = 0,
    again: Annotated[bool, typer.Option("--again", help="No sample: try anew what survives in today's files.")] = False,
    known_only: Annotated[bool, typer.Option("--known", help="Try nothing: the page of what is kept.")] = False,
    json_file: Annotated[Path, typer.Option("--json", help="Where verdicts and scores are kept.")] = KEPT,
    also: Annotated[list[Path] | None, typer.Option(help="What other runs kept, taken over.")] = None,
    page: Annotated[
        Path, typer.Option(help="The page, its numbers in _static beside it; written when no room is named.")
    ] = ROOT / "docs/mutants.md",
) -> None:
    """Change the lines that make numbers, one at a time, and count what the tests notice."""
    from pickenv.base import write_text  # late: see WARM

    names = room or list(ROOMS)
    if unknown := set(names) - set(ROOMS):
        raise SystemExit(f"unknown room '{min(unknown)}'; give one of {', '.join(ROOMS)}")
    samples, told = kept_in([*([json_file] if json_file.exists() else []), *(also or ())])
    kept, known, equivalents = of_todays_files(told), still_true(told), read_equivalents()
    if again:
        known = {key: verdict for key, verdict in known.items() if verdict["verdict"] != "passed"}
    json_file.parent.mkdir(parents=True, exist_ok=True)
    os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    os.environ |= {
        "MPLBACKEND": "Agg",
        "PICKENV_DATA": os.environ.get("PICKENV_DATA") or str(ROOT.parent / "shared/data"),
    }
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ended from outside is ended as by Ctrl-C
    WARM.set_forkserver_preload(["__main__", *LIBRARIES])
    mutants = {name: shuffled(name, seed, equivalents) for name in names}
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) if known_only else copied_project(Path(folder))
        for name in () if known_only else names:
            drawn = mutants[name][: ROOMS[name].most if sample is None else sample or None]
            if again:
                drawn = [m for m in mutants[name] if m.key in kept and kept[m.key]["verdict"] == "passed"]
            for mutant in try_room(name, drawn, known, copy):
                kept[mutant.key] = known[mutant.key]
                if known[mutant.key]["verdict"] == "passed":
                    print(f"survives: {mutant.key}", flush=True)
                write_text(json_file, as_lines(samples, kept))
            verdicts = [kept[mutant.key]["verdict"] for mutant in drawn]
            if not again and not any((one.seed, one.room) == (seed, name) for one in samples):
                samples.append(score_of(name, len(mutants[name]), verdicts, seed))
                write_text(json_file, as_lines(samples, kept))
            print(f"{name}: {len(verdicts)} tried, {verdicts.count('passed')} survive", flush=True)
    tried = {name: {m.key: kept[m.key]["verdict"] for m in found if m.key in kept} for name, found in mutants.items()}
    now = [score_of(name, len(mutants[name]), list(verdicts.values())) for name, verdicts in tried.items() if verdicts]
    survivors = [key for verdicts in tried.values() for key, verdict in verdicts.items() if verdict == "passed"]
    print(table(now))
    print(f"{len(survivors)} survive; each is a test to write, or a change that makes no difference")
    write_text(json_file, as_lines(samples, kept))
    if not room:
        summary = summary_of(now, samples, survivors, equivalents)
        write_text(page.parent / f"_static/{page.stem}.json", json.dumps(summary, indent=1, ensure_ascii=False) + "\n")
        write_text(page, page_of(summary))


if __name__ == "__main__":
    typer.run(main)
