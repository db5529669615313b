"""Registry of extensions by kind and name: extensions shipped with pickenv, and extensions of other packages.

A class or function is registered by a decorator, ``@pickenv.register("residual", "forest")``, or by an entry point of
an installed package. The entry point ``forest = "module:Forest"`` is in the group ``pickenv.residual``. It is imported
when that name is first requested. The extensions shipped with pickenv are in the modules of `SHIPPED`. These are
imported when their kind is first requested.
"""

from __future__ import annotations

import re
import sys
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from importlib import import_module, metadata
from typing import Any, TypeVar

from pickenv.base.errors import InputError

SHIPPED: Mapping[str, tuple[str, ...]] = {
    "arm_format": ("pickenv.arm.files.arm_file", "pickenv.arm.files.urdf", "pickenv.arm.files.mjcf"),
    "instrument": ("pickenv.calibration.reading.read", "pickenv.calibration.reading.kind_readers"),
    "observation": tuple(f"pickenv.calibration.model.{name}" for name in ("measurements", "kinds", "pixels")),
    "residual": ("pickenv.calibration.residuals.bpnn", "pickenv.calibration.residuals.gaussian_process"),
    "effect": tuple(f"pickenv.arm.effects.{name}" for name in ("structure", "drives", "ground", "residual_field")),
    "exporter": tuple(f"pickenv.calibration.delivery.{name}" for name in ("onto_files", "joint_offsets", "export")),
    "report": ("pickenv.inspect.runs.run_folder",),
    "gripper": ("pickenv.orchard.gripper",),
    "policy": ("pickenv.agents.policies.scripted", "pickenv.agents.policies.adaptive"),
    "backend": ("pickenv.envs.reaching.vector",),
}
"""Modules that register the extensions shipped with pickenv, by kind. `names` lists extensions in this order."""

KINDS = tuple(SHIPPED)
"""All kinds of extension. `docs/extending.md` describes what an extension of each kind must have."""

Thing = TypeVar("Thing", bound=Callable[..., Any])


@dataclass(frozen=True)
class Origin:
    """The package or module that an extension comes from; a saved file that needs the extension records it.

    Attributes:
        package: Name of the distribution, such as "forest-for-pickenv"; "" for the code of a script or a notebook.
        version: Version of the distribution; "" without a package.
        module: Name of the module if there is no package; else "".
    """

    package: str = ""
    version: str = ""
    module: str = ""

    def __str__(self) -> str:
        return f"the package {self.package} {self.version}" if self.package else f"the module {self.module}"


_entries: dict[str, dict[str, tuple[Any, Origin]]] = {kind: {} for kind in KINDS}
"""The registered classes and functions by kind and name, each with its origin."""


def register(kind: str, name: str) -> Callable[[Thing], Thing]:
    """Return a decorator that registers a class or function as an extension and returns it unchanged.

    To register a value, register a function that returns it.

    Args:
        kind: Kind of extension, such as "residual" or "effect" (one of `KINDS`).
        name: Name of the extension: letters, digits, ``_`` and ``-``. A package may replace its own extension.

    Raises:
        InputError: If the kind is unknown, the name is not of this form, or another package has registered the name.
    """
    _check_kind(kind)
    if re.fullmatch(r"[A-Za-z0-9_-]+", name) is None:
        raise InputError(f"{kind} '{name}' is no name; take letters, digits, _ and - only")

    def keep(thing: Thing) -> Thing:
        if not callable(thing) or not hasattr(thing, "__qualname__"):
            raise InputError(f"{kind} '{name}' is neither a class nor a function; register what makes it")
        _keep(kind, name, thing, _origin_of_module(thing.__module__))
        return thing

    return keep


def names(kind: str) -> tuple[str, ...]:
    """Return the names of all extensions of a kind, such as "residual", without importing other packages.

    Names shipped with pickenv come first. The others follow in alphabetical order.
    """
    _import_shipped(kind)
    entries = _entries[kind]
    shipped = [name for module in SHIPPED[kind] for name in entries if entries[name][0].__module__ == module]
    return (*shipped, *sorted({*entries, *_entry_points(kind)} - set(shipped)))


def get(kind: str, name: str, *, package: str = "", version: str = "", module: str = "") -> Any:
    """Return the class or function registered under a kind and name; import the package that offers it if needed.

    Args:
        kind: Kind of extension, such as "residual" or "effect" (one of `KINDS`).
        name: Name of the extension.
        package: The package that a saved file names as the extension's origin (`Origin`); "" for any.
        version: The version of that package when the file was saved.
        module: The module that the file names, if the extension came from no package.

    Raises:
        InputError: If nothing is registered under this name, its package cannot be imported, or it does not come from
            the given package or module.
    """
    _import_shipped(kind)
    if name not in _entries[kind]:
        _load_entry_point(kind, name)
    if (entry := _entries[kind].get(name)) is None and not (package or module):
        raise InputError(f"there is no {kind} '{name}'; give one of {', '.join(names(kind)) or 'none: there are none'}")
    source = Origin(package, version, module)
    if entry is not None and (not package or package == entry[1].package):
        return entry[0]
    if entry is not None:
        raise InputError(f"{kind} '{name}' comes from {source}, but here from {entry[1]}; install the former alone")
    if not package:
        raise InputError(f"{kind} '{name}' comes from {source}, which is of no package: import it first")
    way, state = f"pip install {package}=={version}", "is installed in another version that lacks it"
    try:
        metadata.version(package)
    except metadata.PackageNotFoundError:
        way, state = f"pip install {package}", "is not installed"
    raise InputError(f"{kind} '{name}' comes from {source}, which {state}: {way}")


def origin(kind: str, name: str) -> Origin:
    """Return the package and version that an extension comes from, without importing the package.

    ``kind`` is a kind of extension, such as "residual" (one of `KINDS`); ``name`` is the extension's name.

    Raises:
        InputError: If nothing is registered under this kind and name.
    """
    _import_shipped(kind)
    if name not in _entries[kind]:
        offers = _entry_points(kind).get(name, ())
        if len(offers) == 1:
            return _origin_of_entry_point(offers[0])
        get(kind, name)
    return _entries[kind][name][1]


def registered_as(thing: Any) -> tuple[str, str] | None:
    """Return the kind and name under which a class or function is registered, or None.

    Entry points of installed packages count as registered.
    """
    keys = [(kind, name) for kind, entries in _entries.items() for name in entries if entries[name][0] is thing]
    place = f"{thing.__module__}:{thing.__qualname__}"
    points = (point for point in _installed(tuple(sys.path)) if point.value == place)
    keys += [(point.group.removeprefix("pickenv."), point.name) for point in points]
    return keys[0] if keys else None


def load_all(kind: str) -> dict[str, Any]:
    """Load all extensions of a kind, such as "residual", and return them by name.

    An extension that cannot be loaded is left out, with a warning.
    """
    things = {}
    for name in names(kind):
        try:
            things[name] = get(kind, name)
        except InputError as error:
            warnings.warn(str(error), stacklevel=2)
    return things


def packages() -> dict[str, str]:
    """Return the versions, by name, of all other packages that extend pickenv, because results may depend on them.

    These are installed packages with entry points, and packages with registered extensions.
    """
    sources = {_origin_of_entry_point(point) for point in _installed(tuple(sys.path))}
    sources |= {source for entries in _entries.values() for _, source in entries.values()}
    return {s.package: s.version for s in sorted(sources, key=str) if s.package not in ("", "pickenv")}


def _check_kind(kind: str) -> None:
    if kind not in KINDS:
        raise InputError(f"there is no kind '{kind}' of extension; give one of {', '.join(KINDS)}")


def _import_shipped(kind: str) -> None:
    _check_kind(kind)
    for module in SHIPPED[kind]:
        import_module(module)


def _keep(kind: str, name: str, thing: Any, source: Origin) -> None:
    if source.package != "pickenv":
        _import_shipped(kind)
    holders = {_entries[kind][name][1]} if name in _entries[kind] else set()
    if not holders and source.package != "pickenv":
        holders = {_origin_of_entry_point(point) for point in _entry_points(kind).get(name, ())}
    if any((holder.package, holder.module) != (source.package, source.module) for holder in holders):
        raise InputError(f"{kind} '{name}' is held by {' and by '.join(map(str, holders))}; take another name")
    _entries[kind][name] = (thing, source)


def _load_entry_point(kind: str, name: str) -> None:
    if not (offers := _entry_points(kind).get(name, ())):
        return
    sources = [_origin_of_entry_point(point) for point in offers]
    if len(offers) > 1:
        raise InputError(f"{kind} '{name}' is offered by {' and by '.join(map(str, sources))}; keep one of them only")
    try:
        thing = offers[0].load()
    except Exception as error:
        cause = f"{type(error).__name__}: {error}"
        raise InputError(f"{kind} '{name}' of {sources[0]} cannot be loaded ({cause}); mend or remove it") from error
    if not hasattr(thing, "__qualname__"):
        raise InputError(f"{kind} '{name}' of {sources[0]} is neither a class nor a function; mend its entry point")
    _keep(kind, name, thing, sources[0])


def _entry_points(kind: str) -> Mapping[str, tuple[metadata.EntryPoint, ...]]:
    """Return the entry points of a kind by name.

    An entry point with the name of a shipped extension is left out, with a warning.
    """
    offers: dict[str, tuple[metadata.EntryPoint, ...]] = {}
    for point in _installed(tuple(sys.path)):
        entry = _entries[kind].get(point.name)
        if point.group == f"pickenv.{kind}" and entry is not None and entry[1].package == "pickenv":
            source = _origin_of_entry_point(point)
            warnings.warn(f"{kind} '{point.name}' of {source} is left aside: pickenv ships that name", stacklevel=3)
        elif point.group == f"pickenv.{kind}":
            offers[point.name] = (*offers.get(point.name, ()), point)
    return offers


@lru_cache(maxsize=4)
def _installed(path: tuple[str, ...]) -> tuple[metadata.EntryPoint, ...]:
    """Return all entry points in pickenv's groups; ``path`` is Python's search path, used only as the cache key."""
    del path
    points = metadata.entry_points()
    return tuple(point for kind in KINDS for point in points.select(group=f"pickenv.{kind}"))


def _origin_of_entry_point(point: metadata.EntryPoint) -> Origin:
    return Origin(point.dist.name, point.dist.version) if point.dist is not None else Origin("", "", point.module)


def _origin_of_module(module: str) -> Origin:
    if (top := module.partition(".")[0]) == "pickenv":
        return Origin("pickenv", import_module("pickenv").__version__)
    for point in _installed(tuple(sys.path)):  # an editable install lists its entry points, but not its modules
        if point.module.partition(".")[0] == top and point.dist is not None:
            return _origin_of_entry_point(point)
    packages = metadata.packages_distributions().get(top, ())
    return Origin(packages[0], metadata.version(packages[0])) if packages else Origin("", "", module)
