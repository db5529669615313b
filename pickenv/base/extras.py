"""Packages that do not come with the core (extras), and the sentence that says how to install them.

The core calibrates, compensates and makes environments. Everything heavier is an extra, loaded when it is first used.
Where pickenv is installed, wherever it came from, `pip install 'pickenv[learn]'` adds networks, `pickenv[all]`
everything.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from importlib.util import find_spec

from pickenv.base.errors import InputError

EXTRAS: Mapping[str, tuple[str, ...]] = {
    "learn": ("torch",),
    "rl": ("stable_baselines3", "sb3_contrib", "tensorboard"),
    "inspect": ("rerun", "plotly", "matplotlib", "jinja2", "PIL"),
    "scene": ("mujoco",),
    "render": ("mujoco", "imageio_ffmpeg", "moviepy"),
    "camera": ("cv2",),
    "recordings": ("rosbags",),
    "study": ("pyarrow", "joblib", "pandas"),
    "harvest": ("skimage", "ortools", "pettingzoo"),
    "export": ("onnx",),
    "data": ("minari",),
    "compiled": ("llvmlite",),
}
"""Extras by name, each with the modules that it brings."""


class MissingExtra(InputError, ImportError):
    """The error that a package of an extra is not installed; its message has the command that installs it."""


def extra_of(module: str) -> str | None:
    """The extra that brings a module (``torch``, ``torch.nn``), or None."""
    return next((extra for extra, modules in EXTRAS.items() if module.partition(".")[0] in modules), None)


def missing(module: str) -> MissingExtra:
    """The error to raise where a module of an extra is not installed."""
    top = module.partition(".")[0]
    return MissingExtra(f"this needs {top}, which is not installed; get it with: {command_for(str(extra_of(top)))}")


def command_for(*extras: str) -> str:
    """The command that adds extras to the pickenv that is installed."""
    return f"pip install 'pickenv[{','.join(extras)}]'"


def absent_extras(*extras: str) -> tuple[str, ...]:
    """The extras, among those given, of which a package is not installed."""
    return tuple(extra for extra in extras if not all(map(is_there, EXTRAS[extra])))


def require(*modules: str) -> None:
    """Check that modules of extras are installed, before they are imported.

    Raises:
        MissingExtra: If a module is not installed; the message names it and the command that installs it.
    """
    if absent := [module for module in modules if not is_there(module)]:
        raise missing(absent[0])


def is_there(module: str) -> bool:
    """Whether a module can be imported; it is not imported to find out."""
    return sys.modules[module] is not None if module in sys.modules else find_spec(module) is not None
