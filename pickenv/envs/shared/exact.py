"""Zeros and ones that cost nothing: an arm's table is full of right angles, and arrays need not be multiplied by them.

A chain with `Exact` entries gives `pickenv.arm.kinematics.forward.frames` on NumPy arrays a third of its work. Sines
and cosines within 1e-15 of 0, 1 and -1 count as exact, which is within the rounding of the others.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from pickenv.arm import Frame, Plant
from pickenv.arm.kinematics.forward import Chain, Scalar
from pickenv.arm.plant.plant import Ready

ROUNDING = 1e-15
FACTORS = ("cos_alpha", "sin_alpha", "a", "d", "cos_theta", "sin_theta")


class Exact:
    """0, 1 or -1 as a factor or summand of arrays."""

    __slots__ = ("value",)
    __array_ufunc__ = None  # arrays leave the arithmetic to this class

    def __init__(self, value: float) -> None:
        self.value = value

    def __mul__(self, other: Any) -> Any:
        if self.value == 0.0:
            return self
        return other if self.value == 1.0 else -other

    __rmul__ = __mul__

    def __add__(self, other: Any) -> Any:
        return other if self.value == 0.0 else other + self.value

    __radd__ = __add__

    def __sub__(self, other: Any) -> Any:
        return -other if self.value == 0.0 else self.value - other

    def __rsub__(self, other: Any) -> Any:
        return other if self.value == 0.0 else other - self.value

    def __neg__(self) -> Exact:
        return Exact(-self.value)


def exact(value: Scalar) -> Any:
    """``value``, as an `Exact` where it is one; arrays, one entry per arm, stay as they are."""
    for whole in (0.0, 1.0, -1.0) if isinstance(value, float) else ():
        if abs(value - whole) < ROUNDING:
            return Exact(whole)
    return value


def exact_chain(chain: Chain) -> Chain:
    """A chain of plain numbers with its zeros and ones made `Exact`; joint angles at zero stay numbers."""
    links = tuple(link._replace(**{name: exact(getattr(link, name)) for name in FACTORS}) for link in chain.links)
    tool = None if chain.tool is None else tuple(exact(value) for value in chain.tool)
    return Chain(tuple(exact(value) for value in chain.base), links, tool)


def exact_plant(plant: Plant) -> Plant:
    """A plant whose frames start from, and whose masses are summed with, zeros and ones that cost nothing."""
    load = plant.load
    if load is not None and isinstance(load.payload, float):
        centre = tuple(tuple(exact(value) for value in point) for point in load.centre)
        load = replace(load, centre=centre, payload=exact(load.payload))
    chain = plant.chain._replace(base=tuple(exact(value) for value in plant.chain.base))
    return replace(plant, load=load, ready=Ready(plant.geometry, chain))


def inexact(frame: Frame) -> tuple[Scalar, ...]:
    """A frame with plain numbers in the place of `Exact` ones."""
    return tuple(value.value if type(value) is Exact else value for value in frame)
