"""Every import of ours that stands anywhere, in code, pages, notebooks and texts that are run elsewhere, is there."""

import importlib
import re
from functools import partial
from inspect import unwrap
from pathlib import Path

ROOT = Path(__file__).parents[1]
IMPORT = re.compile(r"from (pickenv[\w.]*) import (?:\(([^)]*)\)|([\w, ]+(?: as \w+)?))")
KINDS = (".py", ".pyi", ".md", ".ipynb", ".toml", ".yml")
LEFT = {"docs/changelog.md", "CHANGELOG.md", "tests/test_architecture.py"}
"""What tells of the past, and of imports that nobody should write."""


def places() -> list[Path]:
    """Files of the project, without what was made in it."""
    folders = ("agents", "calibration", "docs", "papers", "pickenv", "scripts", "tests", ".ci", ".github")
    found = [path for folder in folders for path in (ROOT / folder).rglob("*") if path.suffix in KINDS]
    made = ("_build", "_generated", "__pycache__")
    return [path for path in [*found, *ROOT.glob("*.md")] if not any(part in made for part in path.parts)]


def named() -> dict[tuple[str, str], str]:
    """Module and name of each import, with a file that has it."""
    imports: dict[tuple[str, str], str] = {}
    for path in places():
        place = path.relative_to(ROOT).as_posix()
        if place in LEFT:
            continue
        for module, many, few in IMPORT.findall(path.read_text(encoding="utf-8")):
            for part in re.sub(r"#.*|\\n|\"|'", " ", many or few).split(","):
                if words := part.split():
                    imports.setdefault((module, words[0]), place)
    return imports


def test_every_import_of_ours_is_there() -> None:
    imports = named()
    assert len(imports) > 500
    lost = []
    for (module, name), place in imports.items():
        try:
            found = importlib.import_module(module)
            if not hasattr(found, name):
                importlib.import_module(f"{module}.{name}")
        except ImportError as error:
            if (error.name or "pickenv").startswith(("pickenv", "calibration", "agents")):
                lost.append(f"{place}: from {module} import {name}")
    assert not lost, "\n".join(lost)


def test_every_function_helps_with_its_own_words() -> None:
    """`help` of a partial tells of functools, and so do the pages made from it."""
    things = {f"{m}.{n}": getattr(importlib.import_module(m), n, None) for m, n in named() if m.count(".") < 2}
    assert not [name for name, thing in things.items() if isinstance(unwrap(thing), partial)]
