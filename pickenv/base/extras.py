"""What does not come with the core, and the sentence that says how to get it.

The core calibrates, compensates and makes environments. Everything heavier is an extra, loaded when it is first used.
Where pickenv is installed, wherever it came from, `pip install 'pickenv[learn]'` adds networks, `pickenv[all]`
everything.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from importlib.util import find_spec
from types import MappingProxyType

from pickenv.base.errors import InputError

EXTRAS: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "learn": ("torch",),
        "rl": ("stable_baselines3", "sb3_contrib", "tensorboard"),
        "inspect": ("rerun", "plotly", "matplotlib", "jinja2", "PIL"),
        "render": ("vtkmodules", "imageio_ffmpeg"),
        "camera": ("cv2",),
        "study": ("pyarrow", "joblib", "pandas"),
        "ray": ("ray",),
        "harvest": ("skimage", "ortools", "pettingzoo"),
        "export": ("onnx",),
        "data": ("minari",),
        "compiled": ("llvmlite",),
    }
)
"""Extras by name, and what programs import of each."""


class MissingExtra(InputError, ImportError):
    """A package of an extra that is not installed; the message is the command that installs it."""


def extra_of(module: str) -> str | None:
    """The extra that brings a module (``torch``, ``torch.nn``), or None."""
    top = module.partition(".")[0]
    return next((extra for extra, modules in EXTRAS.items() if top in modules), None)


def missing(module: str) -> MissingExtra:
    """What to raise where a module of an extra is not there."""
    top = module.partition(".")[0]
    return MissingExtra(f"this needs {top}, which is not installed; get it with: {command_for(str(extra_of(top)))}")


def command_for(*extras: str) -> str:
    """The command that adds extras to the pickenv that is installed."""
    return f"pip install 'pickenv[{','.join(extras)}]'"


def absent_extras(*extras: str) -> tuple[str, ...]:
    """Those of these extras of which a package is not installed."""
    return tuple(extra for extra in extras if not all(map(is_there, EXTRAS[extra])))


def require(*modules: str) -> None:
    """See to it that modules of extras are there, before they are imported.

    Raises:
        MissingExtra: If one is not; the message names it and the command that installs it.
    """
    for module in modules:
        if not is_there(module):
            raise missing(module)


def is_there(module: str) -> bool:
    """Whether a module can be imported, without doing so."""
    return sys.modules[module] is not None if module in sys.modules else find_spec(module) is not None
