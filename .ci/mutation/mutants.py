"""Would the tests notice? One operator, number or condition at a time is changed, in functions drawn at random.

A sample is of fixed size, with a seed that is said before: every function of the package is as likely as any other,
and one change to each that is drawn is tried. There is no drawing again. mutmut makes the changes. All tests run once
without any, to see which run which lines. Each change is then tried in a copy of the project against the tests that
run its line: first those of files that name the function, then its module, then those of its room, until one fails,
does not end in time, or all that take `BUDGET` together have passed. A test counts only if it passes in the same
company without the change. Text, messages, what a decorator covers and how a drawing looks are left as they are. Of a
survivor that makes no difference the record may say why, under "makes_no_difference": it is then left out of the share.

Run: python .ci/mutation/mutants.py [--count N] [--seed S] [--out FILE] [--page FILE]
A run that was cut off goes on where it was.
"""

from __future__ import annotations

import ast
import json
import os
import random
import re
import shutil
import signal
import tempfile
import time
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cache, partial
from itertools import accumulate, islice
from pathlib import Path
from typing import Annotated, Any

import libcst as cst
import typer
from libcst.metadata import MetadataWrapper, PositionProvider
from mutants_trials import LIBRARIES, PACKAGES, ROOT, WARM, Notes, Trial, copied_project
from mutmut.mutation import mutators
from mutmut.mutation.file_mutation import MutationVisitor
from mutmut.mutation.pragma_handling import IgnoredCode

LEAST_SECONDS, PATIENCE = 120.0, 5.0
"""Tests may take this long, or this many times as long as they do without a mutant."""
SAMPLE = 120
"""Functions of a sample."""

BUDGET = 900.0
"""Seconds, without a mutant, of the tests that one is tried against."""
COPIES = 2
"""Changes tried side by side."""
RECORD, PAGE = ROOT / "docs/_static/mutants.json", ROOT / "docs/mutants.md"


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


@cache
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


def functions() -> list[tuple[str, str, range]]:
    """Every function of the package: its file, its name, that of its class in front, and its lines."""
    found = []
    for path in sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py")):
        name = path.relative_to(ROOT).as_posix()
        tree = ast.parse(path.read_text(encoding="utf-8"))
        for owner in (tree, *(node for node in tree.body if isinstance(node, ast.ClassDef))):
            prefix = f"{owner.name}." if isinstance(owner, ast.ClassDef) else ""
            for node in owner.body:
                if isinstance(node, ast.FunctionDef) and node.end_lineno is not None:
                    found.append((name, prefix + node.name, range(node.lineno, node.end_lineno + 1)))
    return found


def sample(seed: int) -> Iterator[tuple[str, Mutant]]:
    """Functions in random order, those with nothing to change left out, and one change to each.

    A function's place and change depend on the seed and its name alone, so that a sample can be gone on with while
    other functions come and go.
    """
    own = {(path, name): random.Random(f"{seed} {path} {name}") for path, name, _ in functions()}
    places = {function: drawing.random() for function, drawing in own.items()}
    for path, name, lines in sorted(functions(), key=lambda function: places[function[:2]]):
        mutants = [m for m in mutants_of(path, (ROOT / path).read_text(encoding="utf-8")) if m.line in lines]
        if mutants:
            yield name, own[path, name].choice(mutants)


def files_near(path: str, function: str) -> list[str]:
    """Test files, nearest first: those that name the function, those that name its module, those of its room."""
    parts = Path(path).parts
    rooms = ["/".join(parts[start:end]) for start, end in ((1, -1), (0, -1), (1, -2), (0, 1))]
    words = [function.split(".")[-1], function.split(".")[0], Path(path).stem]
    near: list[tuple[int, str]] = []
    for test in sorted((ROOT / "tests").rglob("test_*.py")):
        text, place = test.read_text(encoding="utf-8"), test.relative_to(ROOT).as_posix()
        named = [bool(re.search(rf"\b{re.escape(word)}\b", text)) or word in test.stem for word in words]
        mine = [place.startswith(f"tests/{room}/") for room in rooms if room]
        score = 8 * named[0] + 4 * named[1] + 4 * named[2] + (8 >> mine.index(True) if True in mine else 0)
        if score:
            near.append((-score, place))
    return [place for _, place in sorted(near)]


def tests_for(function: str, mutant: Mutant, notes: Notes) -> list[str]:
    """Tests that run the mutant's line, nearest first, then quickest, as many as take `BUDGET` together, one at least.

    If no test runs it (it runs as the package is loaded, or in another program), all tests of the files nearby count.
    """
    files = {file: place for place, file in enumerate(files_near(mutant.path, function))}
    runs = notes.tests.get((mutant.path, mutant.line)) or {
        test for test in notes.seconds if test.split("::")[0] in files
    }
    ordered = sorted(runs, key=lambda test: (files.get(test.split("::")[0], len(files)), notes.seconds[test], test))
    ends = accumulate(notes.seconds[test] for test in ordered)
    return [test for i, (test, end) in enumerate(zip(ordered, ends, strict=True)) if i == 0 or end <= BUDGET]


def patience(tests: list[str], notes: Notes) -> float:
    """Seconds that tests may take."""
    return max(LEAST_SECONDS, PATIENCE * sum(notes.seconds[test] for test in tests))


def trials(mutant: Mutant, tests: list[str], copy: Path, notes: Notes) -> Generator[Trial, None, str]:
    """Try a mutant, run by run, and return the test that notices it, or "" where it survives."""
    while tests:
        (copy / mutant.path).write_text(mutant.code, encoding="utf-8")
        trial = Trial.start(copy, tests, patience(tests, notes))
        yield trial
        code, test = trial.verdict()
        shutil.copyfile(ROOT / mutant.path, copy / mutant.path)
        if code == 0:
            return ""
        same = tests[: tests.index(test) + 1] if test in tests else tests
        trial = Trial.start(copy, same, patience(same, notes))
        yield trial
        if trial.verdict()[0] == 0:
            return test if code is not None else f"{test}, which did not end in time"
        tests = [other for other in tests if other != same[-1]]  # it fails in this company without the mutant, too
    return ""


def verdicts(
    drawn: Iterable[tuple[str, Mutant]], copies: Iterable[Path], notes: Notes
) -> Iterator[tuple[str, Mutant, str]]:
    """Try mutants side by side, one in each copy; yield each with the test that notices it, as it is known."""
    waiting, free = iter(drawn), list(copies)
    running: list[tuple[str, Mutant, Path, Generator[Trial, None, str], Trial]] = []
    try:
        while True:
            for function, mutant in islice(waiting, len(free)):
                copy = free.pop()
                trying = trials(mutant, tests_for(function, mutant, notes), copy, notes)
                running.append((function, mutant, copy, trying, next(trying)))
            if not running:
                return
            time.sleep(0.05)
            for one in [one for one in running if one[-1].ended()]:
                running.remove(one)
                function, mutant, copy, trying, _ = one
                try:
                    running.append((function, mutant, copy, trying, next(trying)))
                except StopIteration as end:
                    free.append(copy)
                    yield function, mutant, end.value
    finally:
        for *_, trial in running:
            trial.verdict()


def noted(copies: list[Path]) -> Notes:
    """Run all tests once, shared between the copies, and note which run which lines."""
    files = sorted(path.relative_to(ROOT).as_posix() for path in (ROOT / "tests").rglob("test_*.py"))
    paths = [copy.with_name(f"{copy.name}.notes") for copy in copies]
    running = [Trial.start(copy, files[i :: len(copies)], float("inf"), paths[i]) for i, copy in enumerate(copies)]
    try:
        while not all(trial.ended() for trial in running):
            time.sleep(0.5)
    finally:
        for trial in running:
            trial.verdict()
    return Notes.read(dict(zip(copies, paths, strict=True)))


def counts_of(tried: Sequence[Mapping[str, Any]]) -> tuple[int, int]:
    """How many mutants are noticed, and of how many that make a difference."""
    killed = sum(bool(one["noticed_by"]) for one in tried)
    return killed, len(tried) - sum(bool(one.get("makes_no_difference")) for one in tried)


def page_of(record: Mapping[str, Any]) -> str:
    """The page: the share with its interval, and what survived."""
    from pickenv.base import share_interval  # late: see WARM

    tried = record["mutants"]
    killed, counted = counts_of(tried)
    equivalent = len(tried) - counted
    low, high = share_interval(killed, counted)
    earlier = "".join(
        f" An earlier sample, with seed {one['seed']}, ended after {one['tried']}: {one['noticed']} of"
        f" {one['counted']} noticed."
        for one in record.get("earlier", [])
    )
    rows = [
        f"| `{one['function']}` | {one['file']} | `{one['change'].replace('|', chr(92) + '|')}` |"
        for one in tried
        if not one["noticed_by"] and not one.get("makes_no_difference")
    ]
    counts = f"{len(tried)} functions were drawn with seed {record['seed']}, and never again. {equivalent} changes"
    share = f"{100 * killed / counted:.0f} % ({100 * low:.0f} to {100 * high:.0f})**."
    share += f" They are drawn in this order until {SAMPLE} are tried." if len(tried) < SAMPLE else ""
    return PAGE_TEXT.format(
        counts=counts, counted=counted, killed=killed, share=share, earlier=earlier, rows="\n".join(rows)
    )


PAGE_TEXT = f"""# Would the tests notice?

This page says which share of small changes to the code the tests notice.

One operator, number, condition or option is changed in a function that is drawn at random. Every function of the
package is as likely as any other. {{counts}} make no difference; of the other {{counted}} the tests notice {{killed}},
**{{share}}

A change is tried against the tests of `make test` that run its line, nearest first, as many as take {BUDGET:.0f} s.
Others might notice more. Tests written for a survivor afterwards do not raise the share: only another sample
does.{{earlier}}

What survived:

| function | file | change |
|---|---|---|
{{rows}}

[mutants.json](_static/mutants.json) says of each which test noticed it. `make mutants` draws a sample whose seed is the
date's.
"""


def main(
    count: Annotated[int, typer.Option(min=1, help="Functions drawn.")] = SAMPLE,
    seed: Annotated[int | None, typer.Option(help="Seed of the sample; the date's, as 20261231, if left out.")] = None,
    out: Annotated[Path, typer.Option(help="Where verdicts are kept, and taken up again.")] = RECORD,
    page: Annotated[Path | None, typer.Option(help="The page that is written.")] = PAGE,
) -> None:
    """Change functions drawn at random, one change each, and count what the tests notice."""
    from pickenv.base import write_json, write_text  # late: see WARM

    seed = int(time.strftime("%Y%m%d")) if seed is None else seed
    record: dict[str, Any] = json.loads(out.read_text(encoding="utf-8")) if out.is_file() else {}
    if record.get("seed") != seed:
        earlier = record.get("earlier", [])
        if record.get("mutants"):
            noticed, counted = counts_of(record["mutants"])
            earlier.append(
                {"seed": record["seed"], "tried": len(record["mutants"]), "noticed": noticed, "counted": counted}
            )
        record = {"seed": seed, "earlier": earlier, "mutants": []}
    known = {(one["file"], one["function"]) for one in record["mutants"]}
    os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    data = os.environ.get("PICKENV_DATA") or str(ROOT.parent / "shared/data")
    os.environ |= {"MPLBACKEND": "Agg", "PICKENV_DATA": data}
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # ended from outside is ended as by Ctrl-C
    WARM.set_forkserver_preload(["__main__", *LIBRARIES])
    with tempfile.TemporaryDirectory() as folder:
        copies = [copied_project(Path(folder), f"project{i}") for i in range(COPIES)]
        drawn = list(islice(sample(seed), count))
        places = {(mutant.path, function): place for place, (function, mutant) in enumerate(drawn)}
        missing = [(function, mutant) for function, mutant in drawn if (mutant.path, function) not in known]
        for function, mutant, noticed in verdicts(missing, copies, noted(copies) if missing else Notes({}, {})):
            told = {"function": function, "file": mutant.path, "line": mutant.text, "change": mutant.change}
            record["mutants"].append(told | {"noticed_by": noticed})
            record["mutants"].sort(key=lambda one: places.get((one["file"], one["function"]), -1))
            print(f"{len(record['mutants'])}/{count} {noticed or 'SURVIVES'}: {mutant.key}", flush=True)
            write_json(out, record)
    if page is not None:
        write_text(page, page_of(record))


if __name__ == "__main__":
    typer.run(main)
