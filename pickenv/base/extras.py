"""Optional dependencies (extras), and lazy imports: a module that needs an extra is imported when it is first used.

The core calibrates, compensates and makes environments. All heavier dependencies are extras.
`pip install 'pickenv[learn]'` adds networks to an installed pickenv, wherever it came from. `pickenv[all]` adds
everything.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from typing import Any

import lazy_loader

from pickenv.base.errors import InputError

EXTRAS: Mapping[str, tuple[str, ...]] = {
    "learn": ("torch",),
    "rl": ("stable_baselines3", "sb3_contrib", "tensorboard", "tqdm"),
    "inspect": ("rerun", "plotly", "matplotlib", "jinja2", "PIL"),
    "scene": ("mujoco",),
    "render": ("mujoco", "imageio_ffmpeg", "moviepy"),
    "camera": ("cv2",),
    "recordings": ("rosbags",),
    "study": ("pyarrow", "joblib", "pandas"),
    "harvest": ("skimage", "ortools", "pettingzoo"),
    "export": ("onnx",),
    "data": ("minari", "h5py"),
    "compiled": ("llvmlite",),
}
"""The modules that each extra brings, by the extra's name."""


class MissingExtra(InputError, ImportError):
    """Raised if a package of an extra is not installed; the message has the command that installs it."""


def extra_of(module: str) -> str | None:
    """Return the name of the extra that brings a module (``torch``, ``torch.nn``), or None."""
    return next((extra for extra, modules in EXTRAS.items() if module.partition(".")[0] in modules), None)


def missing(module: str) -> MissingExtra:
    """Return the error to raise if ``module``, which an extra brings, is not installed."""
    top = module.partition(".")[0]
    return MissingExtra(f"this needs {top}, which is not installed; get it with: {command_for(str(extra_of(top)))}")


def command_for(*extras: str) -> str:
    """Return the shell command that adds extras, given by their names, to the installed pickenv."""
    return f"pip install 'pickenv[{','.join(extras)}]'"


def absent_extras(*extras: str) -> tuple[str, ...]:
    """Return the names of the ``extras`` whose packages are not all installed."""
    return tuple(extra for extra in extras if not all(map(is_there, EXTRAS[extra])))


def require(*modules: str) -> None:
    """Check that modules of extras are installed, before they are imported.

    Raises:
        MissingExtra: If a module is not installed; the message names it and the command that installs it.
    """
    if absent := [module for module in modules if not is_there(module)]:
        raise missing(absent[0])


def is_there(module: str) -> bool:
    """Return whether a module can be imported, without importing it."""
    return sys.modules[module] is not None if module in sys.modules else find_spec(module) is not None


def offered(package: str, file: str) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` for a package that lazily exports what its stub imports.

    Using a name raises `MissingExtra` if its module needs an extra (optional package) that is not installed.

    Args:
        package: Name of the package.
        file: Path of the package's ``__init__.py``. The stub, ``__init__.pyi``, is in the same folder.
    """
    load, directory, names = lazy_loader.attach_stub(package, file)

    def attribute(name: str) -> Any:
        try:
            return load(name)
        except ModuleNotFoundError as error:
            if error.name is None or extra_of(error.name) is None:
                raise
            raise missing(error.name) from error

    return attribute, directory, names
