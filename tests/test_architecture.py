"""The house stands: imports run downwards only, shelves have an order, one name means one thing, rooms stay small.

Rooms are the folders of the package; calibration and agents lie at the root of a checkout and are linked into it.
"""

import ast
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

ROOT = Path(__file__).parents[1]

# Floors from the ground up; each floor is a list of rooms, each room the module prefixes it consists of.
FLOORS: tuple[tuple[tuple[str, ...], ...], ...] = (
    (("pickenv.base",),),
    (("pickenv.arm",), ("pickenv.orchard",)),
    (("pickenv.calibration",), ("pickenv.harvester",), ("pickenv.pictures",)),
    (("pickenv.envs", "pickenv.wrappers"), ("pickenv.inspect",), ("pickenv.zoo",)),
    (("pickenv.agents",),),
    (
        (
            "pickenv.cli",
            "pickenv.demo",
            "pickenv.commands",
            "pickenv.experiments",
            "pickenv.__main__",
        ),
    ),
)
# Shelves of a room, from the bottom; those of one line stand side by side. A shelf imports from shelves below it only.
SHELVES: dict[str, tuple[tuple[str, ...], ...]] = {
    "pickenv.calibration": (
        ("model",),
        ("camera", "identification"),
        ("residuals", "compensation", "assessment", "planning", "reading"),
        ("pipeline",),
        ("delivery",),
    ),
    "pickenv.arm": (("kinematics",), ("files",), ("effects",), ("plant",)),
    "pickenv.envs": (("shared",), ("reaching",), ("picking", "harvesting"), ("scene",)),
    "pickenv.inspect": (("runs",), ("figures",), ("recordings", "reports", "films")),
    "pickenv.agents": (("policies",), ("demonstrations",), ("evaluation",), ("training",)),
}
# Narrower than the floors: what these rooms may import, and nothing else of ours.
ONLY = {
    "pickenv.calibration": ("pickenv.arm", "pickenv.base"),
    "pickenv.envs": ("pickenv.arm", "pickenv.orchard", "pickenv.harvester", "pickenv.pictures", "pickenv.base"),
}
# The ways up: a result writes its own page and files when it is asked to, and loads what writes them then.
UPWARDS = {
    ("pickenv.calibration.pipeline.result", "pickenv.inspect"),
    ("pickenv.calibration.pipeline.result", "pickenv.calibration.delivery.export"),
}
HEAVY = (
    *("torch", "stable_baselines3", "sb3_contrib", "rerun", "matplotlib", "plotly", "PIL", "skimage", "sklearn"),
    *(
        "pyarrow",
        "pandas",
        "grpc",
        "joblib",
        "ortools",
        "onnx",
        "onnxruntime",
        "llvmlite",
        "tensorboard",
        "pettingzoo",
        "rosbags",
    ),
    *("mujoco", "typer", "rich", "yaml", "tqdm", "pydantic"),
)
DOORS = {"pickenv": 500, "pickenv.arm": 1300, "pickenv.calibration": 1300}
"""Where to enter, and how many modules at most come along: about a third more than do (315, 923 and 952)."""
LINES_PER_MODULE = 700


def within(module: str, prefix: str) -> bool:
    return module == prefix or module.startswith(prefix + ".")


def place(module: str) -> tuple[int, str] | None:
    """The floor of a module and the name of its room; None where it belongs to no room."""
    for floor, rooms in enumerate(FLOORS):
        for room in rooms:
            if any(within(module, prefix) for prefix in room):
                return floor, room[0]
    return None


def shelf(module: str) -> tuple[str, int, str] | None:
    """The room of a module, the height of its shelf and the shelf; None where the room has none."""
    for room, heights in SHELVES.items():
        for height, names in enumerate(heights):
            for name in names:
                if within(module, f"{room}.{name}"):
                    return room, height, name
    return None


def modules(root: Path) -> dict[str, Path]:
    """Every module of the package and its file; links are followed."""
    files = (Path(folder) / name for folder, _, names in os.walk(root / "pickenv", followlinks=True) for name in names)
    named = {".".join(path.relative_to(root).with_suffix("").parts): path for path in files if path.suffix == ".py"}
    return {name.removesuffix(".__init__"): named[name] for name in sorted(named)}


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def imports(module: str, path: Path) -> Iterator[tuple[str, str | None]]:
    """Every import of ours, wherever in the file: the module, and the name taken from it; a face's, in its stub."""
    package = module.split(".") if path.name == "__init__.py" else module.split(".")[:-1]
    stub = path.with_suffix(".pyi")
    for node in ast.walk(tree_of(stub if stub.exists() else path)):
        if isinstance(node, ast.Import):
            found: list[tuple[str, str | None]] = [(alias.name, None) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else []
            base = ".".join((*above, *([node.module] if node.module else [])))
            found = [(base, alias.name) for alias in node.names]
        else:
            continue
        yield from ((base, name) for base, name in found if base.split(".")[0] in ("pickenv", "calibration", "agents"))


def defined_in(base: str, name: str | None, known: dict[str, Path]) -> str:
    """The module that an import reaches: through the face of a room to where the name is defined."""
    if name is None:
        return base
    if f"{base}.{name}" in known:
        return f"{base}.{name}"
    path = known.get(base)
    if path is not None and path.name == "__init__.py":
        for further, again in imports(base, path):
            if again == name and further != base:
                return defined_in(further, name, known)
    return base


def complaint(module: str, base: str, name: str | None, known: dict[str, Path]) -> str | None:
    """What is wrong with one import; None where it runs downwards."""
    here, text = place(module), base if name is None else f"{base}.{name}"
    target = text if place(text) and base == "pickenv" else defined_in(base, name, known)
    there = place(target)
    if base == "pickenv" and there is None:
        return None  # the doorstep, or a name that it defines, such as its version
    if there is None:
        return f"{module} imports {text}, which stands in no room"
    assert here is not None
    if (module, base) in UPWARDS:
        return None
    room = here[1]
    if room != there[1]:
        low = any(within(target, prefix) for prefix in ONLY.get(room, ("pickenv",)))
        return None if there[0] < here[0] and low else f"{module} imports {text}"
    mine, theirs = shelf(module), shelf(target)
    if mine and theirs and mine[2] != theirs[2] and theirs[1] >= mine[1]:
        return f"{module} imports {text}, from a shelf that is not below"
    return None


def violations(root: Path) -> list[str]:
    """One sentence for each module without a room or shelf and each import that does not run downwards."""
    found, known = [], modules(root)
    for module, path in known.items():
        if module == "pickenv":
            continue  # the doorstep hands out what the rooms have, and loads none: see below
        room = place(module)
        if room is None:
            found.append(f"{module} stands in no room")
            continue
        if path.name == "__init__.py":
            continue  # a face shows what its room has
        parent, _, name = module.rpartition(".")
        if parent in SHELVES and name not in OPEN:
            found.append(f"{module} stands on no shelf")
        said = (complaint(module, base, name, known) for base, name in imports(module, path))
        found += [text for text in said if text is not None]
    return found


OPEN = ("colours",)
"""Modules that a whole room shares and that stand before its shelves."""


def test_imports_run_downwards_only() -> None:
    assert violations(ROOT) == []


@pytest.mark.parametrize(
    ("file", "line", "complaint"),
    [
        ("arm/plant/spy.py", "from pickenv.calibration import Calibration", "imports pickenv.calibration.Calibration"),
        ("arm/plant/spy.py", "from ...inspect import figures", "imports pickenv.inspect.figures"),
        ("arm/plant/spy.py", "from pickenv.orchard import fruit", "imports pickenv.orchard.fruit"),
        ("arm/kinematics/spy.py", "from pickenv.arm.plant import plant", "from a shelf that is not below"),
        ("arm/spy.py", "import math", "stands on no shelf"),
        ("base/files.py", "def late():\n    import pickenv.arm", "imports pickenv.arm"),
        ("calibration/model/spy.py", "from pickenv import orchard", "imports pickenv.orchard"),
        ("calibration/model/spy.py", "import pickenv.envs.reach", "imports pickenv.envs.reach"),
        ("wrappers/spy.py", "import calibration", "stands in no room"),
        ("inspect/runs/spy.py", "from pickenv.wrappers import compensation", "imports pickenv.wrappers"),
        ("agents/policies/spy.py", "from pickenv.cli import main", "imports pickenv.cli.main"),
        ("attic.py", "import math", "stands in no room"),
    ],
)
def test_an_import_upwards_or_sideways_is_found(tmp_path: Path, file: str, line: str, complaint: str) -> None:
    path = tmp_path / "pickenv" / file
    path.parent.mkdir(parents=True)
    path.write_text(line + "\n", encoding="utf-8")
    (found,) = violations(tmp_path)
    assert complaint in found


@pytest.mark.parametrize(
    ("file", "line"),
    [
        ("calibration/pipeline/fine.py", "from pickenv.arm import Plant\nfrom pickenv.calibration.model import x"),
        ("inspect/figures/fine.py", "from ...arm import Plant\nfrom . import style\nfrom pickenv.calibration import y"),
        ("wrappers/fine.py", "from pickenv.envs.reaching.reach import ReachEnv"),
        ("cli.py", "import pickenv.agents.evaluation\nfrom pickenv import __version__\nimport pickenv"),
    ],
)
def test_an_import_downwards_is_welcome(tmp_path: Path, file: str, line: str) -> None:
    path = tmp_path / "pickenv" / file
    path.parent.mkdir(parents=True)
    path.write_text(line + "\n", encoding="utf-8")
    assert violations(tmp_path) == []


def circle(root: Path) -> list[str]:
    """Modules that import each other in a ring, wherever in their files; empty where none do."""
    known = modules(root)
    graph = {
        module: {defined_in(base, name, known) for base, name in imports(module, path) if (module, base) not in UPWARDS}
        for module, path in known.items()
        if path.name != "__init__.py"
    }
    try:
        TopologicalSorter({module: there - {module} for module, there in graph.items()}).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_no_modules_import_each_other() -> None:
    assert circle(ROOT) == []


def test_a_circle_is_found_even_inside_a_function(tmp_path: Path) -> None:
    for name, other in (("one", "two"), ("two", "one")):
        path = tmp_path / "pickenv/arm/plant" / f"{name}.py"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"def late():\n    from pickenv.arm.plant.{other} import x\n", encoding="utf-8")
    assert set(circle(tmp_path)) == {"pickenv.arm.plant.one", "pickenv.arm.plant.two"}


def public_names(root: Path) -> dict[str, list[str]]:
    """Functions and classes that a module offers, and the modules that define them; commands carry their own names."""
    found: dict[str, list[str]] = {}
    for module, path in modules(root).items():
        if (
            path.name == "__init__.py"
            or within(module, "pickenv.commands")
            or module in ("pickenv.cli", "pickenv.demo")
        ):
            continue
        for node in tree_of(path).body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                found.setdefault(node.name, []).append(module)
    return found


INTERFACE = ("drawings", "page")
"""What every module of a kind of run offers to look at (`pickenv.inspect.runs.run_folder.KINDS`)."""


def test_one_public_name_means_one_thing() -> None:
    shared = {name: homes for name, homes in public_names(ROOT).items() if len(homes) > 1}
    assert {name: homes for name, homes in shared.items() if name not in INTERFACE} == {}


def test_one_file_name_means_one_thing() -> None:
    homes: dict[str, list[str]] = {}
    for module, path in modules(ROOT).items():
        if path.name != "__init__.py" and not within(module, "pickenv.zoo"):
            homes.setdefault(path.stem, []).append(module)
    assert {name: found for name, found in homes.items() if len(found) > 1} == {}


def words_of(path: Path) -> Counter[str]:
    """Every name, attribute and word within strings of a file."""
    found: Counter[str] = Counter()
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.Name):
            found[node.id] += 1
        elif isinstance(node, ast.Attribute):
            found[node.attr] += 1
        elif isinstance(node, ast.alias):
            found[node.name.rpartition(".")[2]] += 1
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            name = node.value.rpartition(":")[2]  # what is loaded late stands as "package.module:name"
            found[name] += name.isidentifier()
    return found


def registered(path: Path, name: str) -> bool:
    """Whether a function or class of a file is registered, so that the registry hands it out."""
    nodes = (node for node in tree_of(path).body if isinstance(node, ast.FunctionDef | ast.ClassDef))
    marks = (mark for node in nodes if node.name == name for mark in node.decorator_list)
    return any(isinstance(mark, ast.Call) and getattr(mark.func, "id", "") == "register" for mark in marks)


def test_what_only_tests_call_does_not_stand_in_the_house() -> None:
    """A function or class is used by the house, its scripts or examples, registered, or offered by a room's face."""
    used: Counter[str] = Counter()
    for path in modules(ROOT).values():
        used += words_of(path)
        if (stub := path.with_suffix(".pyi")).exists():
            used += words_of(stub)
    for path in (path for folder in ("scripts", "papers") for path in (ROOT / folder).rglob("*.py")):
        used += words_of(path)
    prose = "\n".join(path.read_text(encoding="utf-8") for path in [ROOT / "README.md", *(ROOT / "docs").glob("*.md")])
    idle = [
        f"{module}.{name}"
        for name, homes in public_names(ROOT).items()
        for module in homes
        if used[name] == 0 and name not in prose and not registered(modules(ROOT)[module], name)
    ]
    assert idle == []


UNIT = re.compile(
    r"(?<![\w'/])(mm|um|m|deg|rad|kg|N|ms|s|h|K|px|lx|Hz|(milli|micro)?metres?|degrees?|radians?|kilograms?|newtons?|seconds?"
    r"|hours?|kelvins?)(?![\w'])"
)
WITH_UNITS_IN = ("pickenv.arm", "pickenv.orchard", "pickenv.harvester", "pickenv.envs")
IN_CODE = {
    "CONTROL_PERIOD": "an environment's period is part of what it is",
    "USUAL_TILT": "the usual value of an environment's argument",
    "STILL": "where an observation of Pick-v0 ends",
    "MOST_CAMERA_NOISE_MM": "a bound on arguments",
    "MOST_NUMBER": "a bound on arguments",
    "ROD_RADIUS": "how viewers draw a link; kinematics do not look at it",
    "SHORTEST_ROD": "the same",
    "POSITION_FIRST": "how a task is weighed",
    "DENSITY": "of the rods that stand for links nobody has weighed, so that a simulation runs",
    "LEAST_MASS": "the same",
    "STIFFNESS": "of the drives in that simulation",
    "DAMPING": "the same",
    "SHORTEST_LINK": "how viewers draw a link",
    "STEP_LIMIT": "the inverse's own",
    "DEGREES": "a conversion",
    "ROUNDING": "a rounding error",
    "OVERLAP": "where pushing fruit apart ends",
    "REVERSED": "where a formula changes",
    "TILT_LEVER": "which of two tables of one arm is the steadier",
    "STIRRED": "a rounding error of joints that stand still",
}
"""Numbers with a unit that belong to the code, and why; those of instruments, arms and fruit stand in TOML files."""


def numbers_with_units(source: str) -> list[str]:
    """Names of a module's constant numbers whose comment, or docstring below, names a unit."""
    body, lines, found = ast.parse(source).body, source.splitlines(), []
    for node, after in zip(body, [*body[1:], None], strict=True):
        if not isinstance(node, ast.Assign | ast.AnnAssign) or node.value is None:
            continue
        parts = [part for part in ast.walk(node.value) if not isinstance(part, ast.operator | ast.unaryop | ast.Load)]
        kinds = (ast.Constant, ast.Tuple, ast.BinOp, ast.UnaryOp)
        numbers = [part.value for part in parts if isinstance(part, ast.Constant)]
        if not all(isinstance(part, kinds) for part in parts) or not all(type(n) in (int, float) for n in numbers):
            continue
        said = lines[node.end_lineno - 1][node.end_col_offset :] if node.end_lineno and node.end_col_offset else ""
        if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant):
            said += f" {after.value.value}"
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        named = [name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)]
        found += [name for name in named if name.isupper() and UNIT.search(said)]
    return found


def test_numbers_with_units_stand_in_files() -> None:
    found = {
        f"{module}.{name}"
        for module, path in modules(ROOT).items()
        if any(within(module, room) for room in WITH_UNITS_IN)
        for name in numbers_with_units(path.read_text(encoding="utf-8"))
        if name not in IN_CODE
    }
    assert found == set()


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("MARGIN = 3  # px around a patch", ["MARGIN"]),
        ('ROD, SHORT = 0.015, 2 * 0.01\n"""m; of the rods."""', ["ROD", "SHORT"]),
        ('WARM: float = -4.5\n"""K above the ground\'s."""', ["WARM"]),
        ("TRIES = 1000  # draws until one of the arm's poses fits", []),
        ('NAMES = ("m", "mm")  # of units, m', []),
        ("late = 0.5  # s", []),
    ],
)
def test_a_number_with_a_unit_is_found(source: str, found: list[str]) -> None:
    assert numbers_with_units(source) == found


def entered(code: str) -> str:
    """What a fresh interpreter prints."""
    return subprocess.run([sys.executable, "-c", code], cwd=ROOT, check=True, capture_output=True, text=True).stdout


def loaded_by(door: str) -> set[str]:
    """Modules that importing ``door`` brings into a fresh interpreter."""
    bare = entered("import sys; print(*sys.modules)").split()
    return set(entered(f"import sys, {door}; print(*sys.modules)").split()) - set(bare)


@pytest.mark.parametrize(("door", "most"), DOORS.items())
def test_entering_loads_little_and_nothing_heavy(door: str, most: int) -> None:
    """What is loaded, not how long it takes: that is a benchmark."""
    loaded = loaded_by(door)
    assert door in loaded
    assert not set(HEAVY) & {module.partition(".")[0] for module in loaded}
    assert len(loaded) < most


def test_the_doorstep_loads_no_room() -> None:
    assert {module for module in loaded_by("pickenv") if within(module, "pickenv")} == {
        "pickenv",
        "pickenv.base",
        "pickenv.base.errors",
        "pickenv.base.extras",
    }
    assert "scipy" not in {module.partition(".")[0] for module in loaded_by("pickenv")}


def test_how_long_entering_takes(benchmark: BenchmarkFixture) -> None:
    """A fresh interpreter, and `import pickenv` in it; nothing is asserted about time."""
    assert benchmark(entered, "import pickenv; print(pickenv.__name__)") == "pickenv\n"


def test_no_module_outgrows_its_room() -> None:
    lengths = {module: len(path.read_text(encoding="utf-8").splitlines()) for module, path in modules(ROOT).items()}
    assert {module: length for module, length in lengths.items() if length > LINES_PER_MODULE} == {}


def swallowed(source: str) -> list[int]:
    """Lines of handlers that catch everything, or anything at all, and do nothing."""
    handlers = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ExceptHandler))
    return [
        handler.lineno
        for handler in handlers
        if handler.type is None or all(isinstance(statement, ast.Pass) for statement in handler.body)
    ]


def test_no_error_is_swallowed() -> None:
    found = {module: swallowed(path.read_text(encoding="utf-8")) for module, path in modules(ROOT).items()}
    assert {module: lines for module, lines in found.items() if lines} == {}
    assert swallowed("try:\n    f()\nexcept ValueError:\n    pass") == [3]
    assert swallowed("try:\n    f()\nexcept:\n    g()") == [3]
    assert swallowed("try:\n    f()\nexcept ValueError:\n    g()") == []
