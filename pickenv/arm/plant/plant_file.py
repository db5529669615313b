"""Read plants (simulated true arms) by name or from TOML files.

A plant file names an arm and has the size and source of each effect. The presets are in the folder `plants`. The plant
of a calibrated arm is a file of another kind (`pickenv.arm.plant.populations`). A name may also stand for an arm
without error ("ideal:ur5e"), or for an arm of a tolerance class ("coarse:ur5e").
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass, make_dataclass, replace
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from pickenv.arm.effects.drives import ThermalGrowth
from pickenv.arm.effects.effect import gravity_torques, table_of
from pickenv.arm.effects.structure import Backlash, JointCompliance
from pickenv.arm.files.arm import Arm, Load
from pickenv.arm.files.arm_file import load_arm, shipped_arms
from pickenv.arm.kinematics.forward import chain_of, frames
from pickenv.arm.kinematics.geometry import Array
from pickenv.arm.kinematics.inverse import halton_joints
from pickenv.arm.plant.plant import Plant, Unmeasured
from pickenv.arm.plant.populations import (
    SizesTable,
    Tolerances,
    draw_plants,
    load_tolerances,
    read_twin,
    shipped_tolerances,
)
from pickenv.base import InputError, is_file, listed, registry, shortened, stream, toml_tables

PLANTS = Path(__file__).parent / "plants"

NUMBERED = re.compile(r"(.+)#(\d{1,9})")
"""Pattern of a plant's name followed by "#" and the number of a draw of its unmeasured constants."""

NAMED = toml_tables.Check(lambda value: isinstance(value, str), "the name of a shipped arm or a path to an arm file")


def _arm(name: Any, context: Any) -> Arm:
    """Return the arm that a plant file names, and store it in ``context`` for the tables that are read later."""
    context["arm"] = arm = one_link_per_joint(load_arm(name))
    return arm


def one_link_per_joint(arm: Arm) -> Arm:
    """Check that each joint of an arm moves exactly one link, and return the arm.

    Raises:
        InputError: If the arm has a `Coupling`.
    """
    if arm.nominal.coupling is not None:
        raise InputError(f"a joint of arm '{arm.name}' moves several links, which no effect of a plant knows yet")
    return arm


@cache
def plant_file(effects: tuple[str, ...]) -> Any:
    """Return the class for the content of a plant file, with an optional table for each of these effects.

    Args:
        effects: Names of the effects.

    Raises:
        InputError: If an effect is not registered, or cannot be loaded.
    """
    tables = {name: table_of(name) for name in effects}
    optional = {"load": Load} | {name: table for name, table in tables.items() if table is not None}
    members: list[Any] = [
        ("arm", Annotated[Arm, toml_tables.Then(_arm, Annotated[str, NAMED])]),
        ("name", Annotated[str, toml_tables.LINE]),
        ("source", str),
        ("unmeasured", tuple[Unmeasured, ...], ()),
        *((key, table | None if isinstance(table, type) else table, None) for key, table in optional.items()),
    ]
    return toml_tables.toml_table(make_dataclass("PlantFile", members, frozen=True))


def any_plant_file() -> Any:
    """Return the class for the content of a plant file, with an optional table for each registered effect."""
    return plant_file(tuple(registry.load_all("effect")))


def shipped_effects() -> tuple[str, ...]:
    """Return the names of the effects that come with pickenv."""
    return tuple(name for name in registry.names("effect") if registry.origin("effect", name).package == "pickenv")


def shipped_plants() -> list[str]:
    """Return the names of the plant presets that come with pickenv."""
    return toml_tables.shipped_in(PLANTS)


def read_plant(name: str | Path) -> Plant:
    """Read a plant (a simulated true arm) by a preset's name, from a TOML file, or from a calibrated arm's file (.npz).

    A TOML file names an arm. The plant's true geometry is the arm's true geometry, or the nominal one if the arm's file
    gives no other.

    Args:
        name: Name or path. It may end in "#" and the number of a draw of unmeasured constants, as in `load_plant`.

    Raises:
        InputError: If the plant is unknown or a number is outside its limits; the message names the file and the key.
    """
    if (draw := NUMBERED.fullmatch(str(name))) and not is_file(str(name)):
        if NUMBERED.fullmatch(draw[1]) and not is_file(draw[1]):
            raise InputError(f"plant '{shortened(name)}' names two draws of its constants; give one number after #")
        return with_drawn_constants(read_plant(draw[1]), int(draw[2]))
    if Path(name).suffix == ".npz":
        return read_twin(name)
    path = toml_tables.file_named("plant", name, PLANTS, ".toml, .npz")
    tables, _ = toml_tables.toml_of(path)
    foreign = (name for name in registry.names("effect") if name in tables)
    kind = plant_file(tuple(dict.fromkeys((*shipped_effects(), *foreign))))
    parts = dict(vars(toml_tables.read_toml(kind, path, context={})))
    arm, called, load, unmeasured, _ = (parts.pop(key) for key in ("arm", "name", "load", "unmeasured", "source"))
    effects = tuple(effect for effect in parts.values() if effect is not None)
    for effect in effects:
        if effect.needs_load and load is None:
            raise InputError(f"{path}: {effect.name} needs [load], the masses that gravity pulls at")
        if fault := effect.fault(arm):
            raise InputError(f"{path}: {fault}")
    plant = Plant(called, arm, arm.nominal if arm.true is None else arm.true, load, effects, unmeasured=unmeasured)
    for names in ([group.name for group in unmeasured], [name for group in unmeasured for name in group.constants]):
        if twice := [name for i, name in enumerate(names) if name in names[:i]]:
            raise InputError(f"{path}: [[unmeasured]] has '{shortened(twice[0])}' twice; give it once")
    try:
        plant_times(plant, {group.name: 1.0 for group in unmeasured})
    except AttributeError as error:
        raise InputError(f"{path}: [[unmeasured]]: {error}") from error
    return plant


# Constants that nobody measured are larger or smaller in the whole design, not from arm to arm: which arms a policy
# meets is drawn after them. A draw has a number, and a plant of these constants a name: "orchard#3".


def plant_times(plant: Plant, times: Mapping[str, float]) -> Plant:
    """Return the plant with groups of unmeasured constants multiplied by factors.

    Constants of effects that the plant does not have are ignored.

    Args:
        plant: The plant, a single arm.
        times: Factors by the names of `Unmeasured` groups.

    Raises:
        ValueError: If the plant has no group of this name.
        AttributeError: If a group names an effect or a number that does not exist.
    """
    groups = {group.name: group.constants for group in plant.unmeasured}
    effects = {effect.name: effect for effect in plant.effects}
    for name, factor in times.items():
        if name not in groups:
            raise ValueError(f"plant '{plant.name}' has no unmeasured constants '{name}'; it has {listed(groups)}")
        for constant in groups[name]:
            effect, _, number = constant.partition(".")
            if effect in effects:
                effects[effect] = _multiplied(effects[effect], number, factor)
            elif effect not in registry.names("effect"):
                raise AttributeError(f"there is no effect '{shortened(effect)}'")
    return replace(plant, effects=tuple(effects.values()))


def _multiplied(thing: Any, path: str, factor: float) -> Any:
    """Return a copy of ``thing`` with the number or numbers at ``path`` multiplied by ``factor``.

    Args:
        thing: A dataclass object, or a tuple of such objects.
        path: Attribute names with dots between.
        factor: The factor.
    """
    if isinstance(thing, tuple):
        return tuple(_multiplied(part, path, factor) for part in thing)
    if not path:
        if not isinstance(thing, float | np.ndarray):
            raise AttributeError(f"{shortened(repr(thing))} is no size that a factor could multiply")
        return factor * thing
    name, _, rest = path.partition(".")
    if not is_dataclass(thing) or isinstance(thing, type) or name not in (field.name for field in fields(thing)):
        raise AttributeError(f"'{type(thing).__name__}' has no number '{shortened(name)}'")
    return replace(thing, **{name: _multiplied(getattr(thing, name), rest, factor)})


def with_drawn_constants(plant: Plant, draw: int) -> Plant:
    """Return the plant with each group of unmeasured constants multiplied by a uniform random factor from its range.

    Args:
        plant: The plant, a single arm.
        draw: Number of the draw, which is its seed.

    Raises:
        InputError: If the plant has no unmeasured constants.
    """
    if not plant.unmeasured:
        raise InputError(f"plant '{plant.name}' has no [[unmeasured]] constants to draw; leave out #{draw}")
    rng = np.random.default_rng(stream(draw, "constants"))
    times = {group.name: float(rng.uniform(*group.times)) for group in plant.unmeasured}
    return replace(plant_times(plant, times), name=f"{plant.name}#{draw}")


# Plants by name. Of an arm that comes with a plant, that plant's effects are taken. Any other arm is sized by the
# class: how far joints yield under the arm's own weight, the gaps in its gears, and how it warms up. Only the ratio of
# a bare arm's masses counts then, as nothing else hangs on it: each link is a rod of one mass per length.


IDEAL = "ideal"
"""Name of the plant without any error, whose true geometry is the nominal one."""

SAMPLES = 2**10
"""Number of poses from which a joint's largest gravity torque is computed."""

LEAST_TORQUE = 0.01
"""A joint's stiffness and preload are computed from the joint's largest gravity torque. This is the lower bound of that
torque, as a share of the largest torque of all joints of the same type (revolute or prismatic)."""


def load_plant(name: str | Path, *, without: Iterable[str] = ()) -> Plant:
    """Read a plant, that is a simulated true arm with its errors.

    Args:
        name: A preset's name, a path to a plant file (.toml) or to a twin of a calibrated arm (.npz), "ideal:ARM", or
            "CLASS:ARM". CLASS is the name or path of a tolerance class. ARM is the name or path of an arm; after a
            class it may also be a plant. "CLASS:ARM" is the design from which `draw_arms` draws arms. A plant's name
            may end in "#" and a number, such as "#3": then its unmeasured constants come from the random draw with this
            number (`with_drawn_constants`).
        without: Names of effects to switch off.

    Raises:
        InputError: If plant, arm, class or effect are unknown or a number is outside its limits; the message names
            the file and the key.
    """
    kind, arm_name = _split(name)
    if kind == IDEAL:
        arm = one_link_per_joint(load_arm(arm_name))
        plant = Plant(name=IDEAL, arm=arm, geometry=arm.nominal)
    else:
        plant = replace(_design(arm_name, load_tolerances(kind)), name=str(name)) if kind else read_plant(name)
    return plant.without(without)


def class_of(name: str | Path) -> Tolerances | None:
    """Return the tolerance class with which a plant's name begins ("coarse:ur5e"); None if it begins with none."""
    kind, _ = _split(name)
    return load_tolerances(kind) if kind not in ("", IDEAL) else None


def draw_arms(
    name: str | Path, tolerances: str | Path, count: int, rng: np.random.Generator, *, without: Iterable[str] = ()
) -> Plant:
    """Draw true arms of one design, as one plant (simulated true arm) whose numbers are arrays, by `draw_plants`.

    Args:
        name: Name of the design: any name that `load_plant` takes. If it begins with a tolerance class, that class is
            used.
        tolerances: Tolerance class, by name or path, if ``name`` begins with none.
        count: Number of arms, at least 1.
        rng: Parent of the arms' random streams.
        without: Names of effects to switch off.

    Raises:
        InputError: If `load_plant` or `draw_plants` raises one.
    """
    return draw_plants(load_plant(name, without=without), class_of(name) or load_tolerances(tolerances), count, rng)


def bare_plant(arm: Arm, sizes: SizesTable, final_rise: float) -> Plant:
    """Return the plant of an arm without a plant file: with backlash, compliance and thermal growth.

    Its masses come from the arm's file, or else from `rods`.

    Args:
        arm: The arm.
        sizes: Sizes of the effects.
        final_rise: Temperature rise of the warm arm, counted from the temperature of the measured geometry, K.
    """
    one_link_per_joint(arm)
    slides, load = np.array(arm.nominal.prismatic), arm.load or rods(arm)
    torques = _largest_torques(arm, load)
    torques = np.maximum(torques, [LEAST_TORQUE * torques[slides == slide].max() for slide in slides])
    torques[torques == 0] = 1.0  # gravity loads no joint of the kind: whatever the stiffness, none yields
    sags = [sizes.sliding_sag if slide else sizes.turning_sag for slide in slides]
    gaps = tuple(sizes.sliding_gap if slide else sizes.turning_gap for slide in slides)
    backlash = Backlash(gaps, tuple((sizes.preload_share * torques).tolist()))
    compliance = JointCompliance(tuple((torques / sags).tolist()))
    growth = ThermalGrowth((sizes.expansion,) * len(slides), 0.0, final_rise, sizes.warm_up)
    return Plant(arm.name, arm, arm.nominal, load, (backlash, compliance, growth))


def rods(arm: Arm) -> Load:
    """Return the masses of an arm whose links are rods of 1 kg/m.

    Each rod runs from a joint to the next, or to the tool, with slides in the middle of their range.
    """
    g = arm.nominal
    after = np.arange(1, g.joints)
    d = g.d[after] + np.where(g.prismatic, (g.lower + g.upper) / 2, 0.0)[after]
    ends = np.stack([g.a[after], -d * np.sin(g.alpha[after]), d * np.cos(g.alpha[after])], axis=-1)
    ends = np.concatenate([ends, g.tool.position[None]])
    mass = np.linalg.norm(ends, axis=-1)
    x, y, z = (ends / 2.0).T.tolist()
    return Load(tuple(mass.tolist()), tuple(zip(x, y, z, strict=True)))


def _largest_torques(arm: Arm, load: Load) -> Array:
    """Return the largest magnitude of the gravity torque or force on each joint ``(n,)``, N*m or N, over many poses."""
    chain = chain_of(arm.nominal)
    torques = gravity_torques(chain, frames(np, chain, list(halton_joints(arm.nominal, SAMPLES).T)), load)
    return np.array([np.abs(torque).max() for torque in torques])


def _split(name: str | Path) -> tuple[str, str]:
    """Split a name such as "coarse:ur5e" into two: tolerance class or "ideal" (empty if neither), and arm or plant.

    After "ideal" or "CLASS:" without an arm, the arm is "qiao2026".
    """
    kind, colon, arm_name = str(name).partition(":")
    if kind == IDEAL or (colon and (kind in shipped_tolerances() or kind.endswith(".toml"))):
        return kind, arm_name or "qiao2026"
    if colon and not is_file(str(name)) and (arm_name in (*shipped_arms(), *shipped_plants())):
        names = ", ".join((IDEAL, *shipped_tolerances()))
        raise InputError(f"unknown tolerance class '{shortened(kind)}'; give one of {names}, or a path (.toml)")
    return "", arm_name


def _design(name: str, tolerances: Tolerances) -> Plant:
    """Return the plant called ``name``; if ``name`` is an arm, a plant with effects sized by the tolerance class."""
    file = name.partition("#")[0]
    plant_file = file.endswith(".toml") and is_file(file) and "arm" in toml_tables.toml_of(file)[0]
    if plant_file or file in shipped_plants() or name.endswith(".npz"):
        return read_plant(name)
    if tolerances.sizes is None:
        needs = f"[sizes], which arm '{shortened(name)}' needs as it comes without a plant"
        raise InputError(f"tolerance class '{tolerances.name}' has no {needs}; give them, or a plant file")
    return bare_plant(load_arm(name), tolerances.sizes, sum(tolerances.temperature_rise) / 2)
