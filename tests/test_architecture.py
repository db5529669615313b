"""The house stands: imports run downwards only, entering is cheap, rooms stay small, errors are not swallowed."""

import ast
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

ROOT = Path(__file__).parents[1]
PACKAGES = ("pickenv", "calibration", "agents")

GROUND = (
    "pickenv.files",
    "pickenv.limits",
    "pickenv.locks",
    "pickenv.sealed",
    "pickenv.container",
    "pickenv.provenance",
    "pickenv.reservations",
    "pickenv.texts",
    "pickenv.toml_faults",
    "pickenv.toml_tables",
)
# Floors from the ground up; each floor is a list of rooms, each room the module prefixes it consists of.
FLOORS: tuple[tuple[tuple[str, ...], ...], ...] = (
    (("pickenv.errors",),),
    (GROUND,),
    (("pickenv.arm",), ("pickenv.orchard",)),
    (("calibration",), ("pickenv.harvester",)),
    (("pickenv.envs", "pickenv.wrappers"), ("pickenv.inspect",), ("pickenv.zoo",)),
    (("agents",),),
    (("pickenv.cli", "pickenv.demo", "pickenv.commands", "pickenv.study", "pickenv.__main__"),),
)
DOORSTEP = 2  # `import pickenv` itself rests on the foundation and loads no room
# Narrower than the floors: what these rooms may import, and nothing else of ours.
ONLY = {
    "calibration": ("pickenv.arm", "pickenv.errors", *GROUND),
    "pickenv.envs": ("pickenv.arm", "pickenv.orchard", "pickenv.harvester", "pickenv.errors", *GROUND),
}
HEAVY = (
    *("torch", "stable_baselines3", "sb3_contrib", "rerun", "matplotlib", "plotly", "PIL", "skimage", "sklearn"),
    *("pyarrow", "pandas", "ray", "grpc", "joblib", "ortools", "onnx", "onnxruntime", "tensorboard", "pettingzoo"),
    *("mujoco", "typer", "rich", "yaml", "tqdm", "pydantic"),
)
DOORS = {"pickenv": 500, "pickenv.arm": 1300, "calibration": 1300}
"""Where to enter, and how many modules at most come along: about a third more than do (315, 923 and 952)."""
LINES_PER_MODULE = 450


def within(module: str, prefix: str) -> bool:
    return module == prefix or module.startswith(prefix + ".")


def place(module: str) -> tuple[int, str] | None:
    """The floor of a module and the name of its room; None where it belongs to no room."""
    if module == "pickenv":
        return DOORSTEP, module
    for floor, rooms in enumerate(FLOORS):
        for room in rooms:
            if any(within(module, prefix) for prefix in room):
                return floor, room[0]
    return None


def module_name(path: Path, root: Path) -> str:
    parts = path.relative_to(root).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def imported_modules(path: Path, root: Path) -> Iterator[str]:
    """Every module of ours that a file imports, wherever in the file: `from a import b` yields a.b."""
    package = path.relative_to(root).parent.parts
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) - node.level + 1] if node.level else ()
            base = ".".join((*above, *([node.module] if node.module else [])))
            names = [f"{base}.{alias.name}" for alias in node.names]
        else:
            continue
        yield from (name for name in names if name.split(".")[0] in PACKAGES)


def modules(root: Path) -> list[Path]:
    return sorted(path for package in PACKAGES for path in (root / package).rglob("*.py"))


def violations(root: Path) -> list[str]:
    """One sentence for each module without a room and each import that does not run downwards."""
    found = []
    for path in modules(root):
        module = module_name(path, root)
        here = place(module)
        if here is None:
            found.append(f"{module} stands in no room")
            continue
        for name in imported_modules(path, root):
            there = place(name)
            if name == "pickenv" or (there is None and name.rpartition(".")[0] == "pickenv"):
                continue  # the doorstep, or a name that it defines, such as its version
            if there is None:
                found.append(f"{module} imports {name}, which stands in no room")
            elif here[1] != there[1] and (
                there[0] >= here[0] or not any(within(name, low) for low in ONLY.get(here[1], PACKAGES))
            ):
                found.append(f"{module} imports {name}")
    return found


def test_imports_run_downwards_only() -> None:
    assert violations(ROOT) == []


@pytest.mark.parametrize(
    ("file", "line", "complaint"),
    [
        ("pickenv/arm/spy.py", "from pickenv.calibration import Calibration", "imports calibration.Calibration"),
        ("pickenv/arm/spy.py", "from ..inspect import figures", "imports pickenv.inspect.figures.style"),
        ("pickenv/arm/spy.py", "from pickenv.orchard import fruit", "imports pickenv.orchard.fruit"),
        ("pickenv/errors.py", "def late():\n    import pickenv.files", "imports pickenv.files"),
        ("calibration/spy.py", "from pickenv import orchard", "imports pickenv.orchard"),
        ("calibration/spy.py", "import pickenv.envs.reaching.reach", "imports pickenv.envs.reaching.reach"),
        ("pickenv/wrappers/spy.py", "import pickenv.calibration", "imports calibration"),
        ("pickenv/inspect/spy.py", "from pickenv.wrappers import compensation", "imports pickenv.wrappers"),
        ("agents/spy.py", "from pickenv.cli import main", "imports pickenv.cli.main"),
        ("pickenv/__init__.py", "from pickenv.arm import load_arm", "imports pickenv.arm.load_arm"),
        ("pickenv/attic.py", "import math", "stands in no room"),
    ],
)
def test_an_import_upwards_or_sideways_is_found(tmp_path: Path, file: str, line: str, complaint: str) -> None:
    path = tmp_path / file
    path.parent.mkdir(parents=True)
    path.write_text(line + "\n", encoding="utf-8")
    (found,) = violations(tmp_path)
    assert complaint in found


@pytest.mark.parametrize(
    ("file", "line"),
    [
        (
            "calibration/fine.py",
            "from pickenv.arm import Plant\nfrom pickenv.calibration.assessment.metrics import mean\nimport math",
        ),
        ("pickenv/inspect/fine.py", "from ..arm import Plant\nfrom . import figures\nfrom calibration import metrics"),
        ("pickenv/wrappers/fine.py", "from pickenv.envs.reaching.reach import ReachEnv"),
        ("pickenv/cli.py", "import pickenv.agents.evaluate\nfrom pickenv import __version__\nimport pickenv"),
        ("pickenv/__init__.py", "from pickenv.errors import InputError\nimport gymnasium"),
    ],
)
def test_an_import_downwards_is_welcome(tmp_path: Path, file: str, line: str) -> None:
    path = tmp_path / file
    path.parent.mkdir(parents=True)
    path.write_text(line + "\n", encoding="utf-8")
    assert violations(tmp_path) == []


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
    assert {module for module in loaded_by("pickenv") if within(module, "pickenv")} == {"pickenv", "pickenv.errors"}
    assert not {"scipy", *PACKAGES[1:]} & {module.partition(".")[0] for module in loaded_by("pickenv")}


def test_how_long_entering_takes(benchmark: BenchmarkFixture) -> None:
    """A fresh interpreter, and `import pickenv` in it; nothing is asserted about time."""
    assert benchmark(entered, "import pickenv; print(pickenv.__name__)") == "pickenv\n"


def test_no_module_outgrows_its_room() -> None:
    lengths = {module_name(path, ROOT): len(path.read_text(encoding="utf-8").splitlines()) for path in modules(ROOT)}
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
    found = {module_name(path, ROOT): swallowed(path.read_text(encoding="utf-8")) for path in modules(ROOT)}
    assert {module: lines for module, lines in found.items() if lines} == {}
    assert swallowed("try:\n    f()\nexcept ValueError:\n    pass") == [3]
    assert swallowed("try:\n    f()\nexcept:\n    g()") == [3]
    assert swallowed("try:\n    f()\nexcept ValueError:\n    g()") == []
