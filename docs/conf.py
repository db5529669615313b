"""The site: `make docs` builds these pages, the reference and the environments' cards into docs/_build/html.

The reference lists every public name of every room, and cards are the environments' own docstrings, which are Markdown:
both are written into docs/_generated when the site is built, so that neither can be forgotten.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import os
import re
import sys
import tomllib
from pathlib import Path
from types import ModuleType
from typing import Any, get_origin

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

import gymnasium  # noqa: E402
from pygments.lexers import TextLexer  # noqa: E402
from sphinx.pycode import ModuleAnalyzer  # noqa: E402

import pickenv  # noqa: E402

project, author, release = "pickenv", "pickenv developers", pickenv.__version__
copyright = "pickenv developers"
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_copybutton"]
exclude_patterns = ["_build"]
nb_execution_mode = "cache"  # executed anew when a block changes; make clean forgets
nb_execution_cache_path = str(HERE / "_build/.notebooks")
nb_execution_in_temp = True
os.environ["MPLBACKEND"] = "module://matplotlib_inline.backend_inline"  # figures stand under their blocks
nb_execution_raise_on_error = True
nb_execution_timeout = 1800
nb_merge_streams = True
myst_enable_extensions = ["colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = f"pickenv {release}"
html_copy_source = False
html_static_path, html_css_files = ["_static"], ["site.css"]
html_theme_options = {"sidebar_hide_name": False}
default_role = "code"  # docstrings write `name`, as Markdown does
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
autodoc_default_options = {"members": True}
autodoc_type_aliases = {name: name for name in ("Array", "ArrayLike", "Scalar", "Pose", "Frame", "Compensate")}
napoleon_google_docstring, napoleon_numpy_docstring = True, False
napoleon_use_rtype = False
napoleon_use_ivar, napoleon_attr_annotations = True, False
suppress_warnings = ["autodoc.import_cycle"]
copybutton_exclude = ".linenos, .gp"

ROOMS = {
    "pickenv": "The front door",
    "pickenv.arm": "Arms and plants",
    "pickenv.calibration": "Calibration",
    "pickenv.envs": "Environments",
    "pickenv.wrappers": "Wrappers",
    "pickenv.agents": "Policies, training, evaluation",
    "pickenv.inspect": "Recordings, figures, reports",
    "pickenv.experiments": "Experiments and tolerance studies",
    "pickenv.orchard": "Fruit, canopy, camera, gripper",
    "pickenv.harvester": "The machine of Li 2016",
    "pickenv.base": "Errors, files, tables with units, intervals, seeds",
}
"""Rooms with a face, and their titles; a thing is described where it is offered first."""


CARDS = {
    str(spec.entry_point).partition(":")[2]: name.partition("/")[2]
    for name, spec in sorted(gymnasium.registry.items())
    if name.startswith("pickenv/")
}
"""Card of each environment, by the name of its class."""


def offered(module: ModuleType) -> dict[str, Any]:
    """Functions, classes and other objects that a room offers; rooms inside it have pages of their own."""
    names = [name for name in dir(module) if not name.startswith("_")]
    found = {name: getattr(module, name) for name in names}
    return {name: thing for name, thing in found.items() if not inspect.ismodule(thing)}


def reference_page(room: str, first: dict[int | str, str]) -> str:
    """A room's page: each thing that it offers, described where it is offered first."""
    module = importlib.import_module(room)
    title = f"{ROOMS[room]}: ``{room}``"
    lines = [title, "=" * len(title), "", f".. currentmodule:: {room}", "", _first_line(module), ""]
    for name, thing in offered(module).items():
        home = first.setdefault(id(thing) if callable(thing) else name, f"{room}.{name}")
        if home != f"{room}.{name}":
            lines += [f".. py:data:: {room}.{name}", "   :no-index:", "", f"   See `{home}`.", ""]
            continue
        if get_origin(thing) or (inspect.isclass(thing) and thing.__name__ != name):  # a type by another name
            lines += [f".. py:data:: {name}", "", f"   `{thing}`", ""]
            continue
        if not callable(thing):
            lines += [f".. py:data:: {name}", "", *(f"   {line}" for line in constant_words(module, name)), ""]
            continue
        kind = "autoclass" if inspect.isclass(thing) else "autofunction"
        options = ["   :no-members:"] if _is_environment(thing) else []
        lines += [f".. {kind}:: {room}.{name}", *options, ""]
    return "\n".join(lines)


def constant_words(module: ModuleType, name: str) -> list[str]:
    """The text below a constant that a room offers, in the module that its stub names."""
    stub = ast.parse(Path(str(module.__file__)).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in stub.body if isinstance(node, ast.ImportFrom)]
    (home,) = [node.module for node in imports for alias in node.names if alias.name == name]
    words = ModuleAnalyzer.for_module(f"{module.__name__}.{home}").find_attr_docs()
    return words.get(("", name), [])


def _first_line(module: ModuleType) -> str:
    return (inspect.getdoc(module) or "").split("\n\n")[0].replace("\n", " ")


def _is_environment(thing: Any) -> bool:
    return inspect.isclass(thing) and issubclass(thing, gymnasium.Env | gymnasium.vector.VectorEnv)


def environment_page(name: str) -> str:
    """An environment's card: its own docstring under its name."""
    entry = str(gymnasium.spec(name).entry_point)
    module, _, attribute = entry.partition(":")
    text = inspect.getdoc(getattr(importlib.import_module(module), attribute)) or ""
    return (
        f'# `{name}`\n\n```python\nimport gymnasium\nimport pickenv\n\nenv = gymnasium.make("{name}")\n```\n\n{text}\n'
    )


def cards_of_files() -> dict[str, str]:
    """Cards of shipped policies, which stand beside them, and tables of arms and plants with their sources."""
    baselines = HERE.parent / "agents/policies/baselines"
    pages = {f"cards/policies/{path.stem}.md": path.read_text(encoding="utf-8") for path in baselines.glob("*.md")}
    for kind, folder, shipped in (
        ("arms", "pickenv/arm/files/arms", pickenv.arm.shipped_arms()),
        ("plants", "pickenv/arm/plant/plants", pickenv.arm.shipped_plants()),
    ):
        lines = [f"# Shipped {kind}", ""]
        for name in sorted(shipped):
            table = tomllib.loads((HERE.parent / folder / f"{name}.toml").read_text(encoding="utf-8"))
            tables = sorted(key for key, value in table.items() if isinstance(value, dict))
            what = f"{table['joint_count']} joints" if kind == "arms" else f"of arm `{table['arm']}`"
            lines += [f"## `{name}`", "", f"{what}. {table['source']}", ""]
            lines += [f"What acts: {', '.join(tables).replace('_', ' ') or 'geometry alone'}.", ""] * (kind == "plants")
        pages[f"cards/{kind}.md"] = "\n".join(lines)
    return pages


RECORDING = HERE / "_generated/recordings/episodes-scripted.rrd"


def write_recording() -> None:
    """Three reaches of the scripted policy, to be downloaded and looked at; kept until `make clean`."""
    if not RECORDING.exists():
        env = pickenv.inspect.LogRerun(
            gymnasium.make("pickenv/Reach-v0", plant="qiao2026"), RECORDING.parent, policy="scripted"
        )
        pickenv.run_reaches(env, pickenv.agents.ScriptedReach(env), seeds=range(3))
        env.close()


def write_generated() -> None:
    """Write reference and cards; what is there unchanged keeps its time, so that a second build is quick."""
    first: dict[int | str, str] = {}
    pages = {}
    for room in ROOMS:
        pages[f"reference/{room}.rst"] = reference_page(room, first)
    index = ["Reference", "=========", "", ".. toctree::", "   :maxdepth: 1", "", *(f"   {room}" for room in ROOMS), ""]
    pages["reference/index.rst"] = "\n".join(index)
    for card in CARDS.values():
        pages[f"environments/{card}.md"] = environment_page(f"pickenv/{card}")
    cards = "\n".join(CARDS.values())
    pages["environments/index.md"] = f"# Cards of the environments\n\n```{{toctree}}\n:maxdepth: 1\n\n{cards}\n```\n"
    pages |= cards_of_files()
    for name, text in pages.items():
        path = HERE / "_generated" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def plain(_app: Any, _what: str, _name: str, thing: Any, _options: Any, lines: list[str]) -> None:
    """Docstrings are written to be read as they are; what Sphinx would take for its own marks is quoted."""
    if _is_environment(thing) or getattr(thing, "__name__", None) in CARDS:
        card = CARDS.get(thing.__name__)
        lines[1:] = ["", f"Its card: :doc:`/_generated/environments/{card}`."] if card else []
    for i, line in enumerate(lines):
        parts = re.split(r"(``.*?``|`[^`]*`)", line)
        lines[i] = "".join(part if part.startswith("`") else _quoted(part) for part in parts)


def _quoted(text: str) -> str:
    return re.sub(r"(?<=\w)_(?=[\s,.;)])", r"\\_", re.sub(r"([|])|(?<=\s)([*])(?=\w)", r"\\\g<0>", text))


def skipped(_app: Any, _what: str, _name: str, thing: Any, skip: bool, _options: Any) -> bool | None:
    """Fields of a named tuple stand in its docstring."""
    return True if type(thing).__name__ == "_tuplegetter" else skip or None


def short(
    _app: Any, _what: str, _name: str, _thing: Any, _options: Any, signature: str | None, returned: str | None
) -> tuple[str | None, str | None]:
    """Types by their last name."""
    texts = []
    for text in (signature, returned):
        plainer = re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text or "")
        texts.append(re.sub(r"~(?:\w+\.)*(\w+)|\bpickenv(?:\.\w+)*\.(\w+)", r"\1\2", plainer) or None)
    return texts[0], texts[1]


REPAIRS = (
    (r'<p class="caption" role="heading">', r'<p class="caption" role="heading" aria-level="2">'),
    (r'<aside class="sidebar-drawer">', r'<aside class="sidebar-drawer" aria-label="Pages of the site">'),
    (r'<aside class="(toc-drawer[^"]*)">', r'<aside class="\1" aria-label="Parts of this page">'),
    (r"<pre>(?=<span></span>)", r'<pre tabindex="0">'),
    (r'<th class="([^"]*)"><p></p></th>', r'<td class="\1"></td>'),
    (r'<div class="(table-wrapper[^"]*)">', r'<div class="\1" tabindex="0">'),
)
"""What the theme leaves out of its pages, and who reads them by ear or by keyboard needs."""


def repaired(app: Any, error: Exception | None) -> None:
    """Mend every page that was written."""
    for page in Path(app.outdir).rglob("*.html") if error is None and app.builder.name == "html" else ():
        text = page.read_text(encoding="utf-8")
        mended = text
        for wrong, right in REPAIRS:
            mended = re.sub(wrong, right, mended)
        if mended != text:
            page.write_text(mended, encoding="utf-8")


def setup(app: Any) -> None:
    """Generate pages before Sphinx looks for them."""
    write_generated()
    write_recording()
    app.add_lexer("csv", TextLexer)
    app.connect("autodoc-process-docstring", plain)
    app.connect("autodoc-process-signature", short)
    app.connect("autodoc-skip-member", skipped)
    app.connect("build-finished", repaired)
