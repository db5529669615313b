"""Fruit on its branch as a damped spring-pendulum, so that a push displaces fruit, and its neighbours, for a while.

Each axis obeys x'' + 2ζω x' + ω² x = F/m with ω² = g/l + k/m sideways and k/m upright; steps of constant force are
solved exactly, whatever their length. Units: m, s, N, kg. Axes as in canopy.py: x, y sideways, z up.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from pickenv.base import GRAVITY, KG, NUMBER, Unit, toml_table
from pickenv.orchard import checks, preset_files
from pickenv.orchard.checks import MM, Array


@toml_table
class Branch(checks.Preset):
    """What fruit hangs from.

    Attributes:
        pendulum: Length of the pendulum, m.
        stiffness_sideways: N/m.
        stiffness_upright: N/m.
        wood: Mass of wood that moves with the fruit, kg.
        damping_ratio: Share of critical damping.
        coupling: Distance over which a push on one fruit falls to 1/e at its neighbours, m.
        source: Where its numbers come from.
    """

    pendulum: Annotated[float, MM.positive]
    stiffness_sideways: Annotated[float, Unit("N_per_m").not_negative]
    stiffness_upright: Annotated[float, Unit("N_per_m").positive]
    wood: Annotated[float, KG.not_negative]
    damping_ratio: Annotated[float, NUMBER.not_negative]
    coupling: Annotated[float, MM.positive]
    source: str = ""


def load_branch(name: str | Path) -> Branch:
    """Read a branch by name (`shipped("branch")`) or from a path to a TOML file."""
    return preset_files.load("branch", name, Branch)


def natural_frequencies(branch: Branch, mass: ArrayLike) -> Array:
    """Undamped angular frequencies along x, y, z, rad/s, shape (..., 3), for fruit masses (...) in kg."""
    moving = _moving_mass(branch, mass)
    sideways = np.sqrt(GRAVITY / branch.pendulum + branch.stiffness_sideways / moving)
    return np.stack([sideways, sideways, np.sqrt(branch.stiffness_upright / moving)], axis=-1)


def swing(
    branch: Branch,
    displacement: ArrayLike,
    velocity: ArrayLike,
    mass: ArrayLike,
    dt: ArrayLike,
    force: ArrayLike = (0.0, 0.0, 0.0),
) -> tuple[Array, Array]:
    """Displacement and velocity of fruit after ``dt`` under a constant force.

    Args:
        branch: What the fruit hangs from.
        displacement: From where the fruit hangs at rest, m, shape (..., 3).
        velocity: m/s, shape (..., 3).
        mass: Fruit masses, kg, shape (...).
        dt: s, shape (...); exact for any length.
        force: On the fruit, N, shape (..., 3).

    Returns:
        Displacement and velocity, each of shape (..., 3).
    """
    start = checks.points("the displacement of fruit", displacement)
    speed = checks.points("the velocity of fruit", velocity)
    time = checks.numbers("the time step (s)", dt, lowest=0.0)[..., None]
    omega = natural_frequencies(branch, mass)
    rest = checks.points("the force on fruit", force) / (_moving_mass(branch, mass)[..., None] * omega**2)
    zeta, x = branch.damping_ratio, start - rest
    if zeta < 1.0:
        damped = omega * np.sqrt(1.0 - zeta**2)
        decay = np.exp(-zeta * omega * time)
        even, odd = decay * np.cos(damped * time), decay * np.sin(damped * time) / damped
    elif zeta == 1.0:
        even = np.exp(-omega * time)
        odd = even * time
    else:
        root = np.sqrt(zeta**2 - 1.0)
        slow, fast = np.exp(-(zeta - root) * omega * time), np.exp(-(zeta + root) * omega * time)
        even, odd = (slow + fast) / 2, (slow - fast) / (2 * omega * root)
    drag = zeta * omega
    return (
        np.asarray(rest + (even + drag * odd) * x + odd * speed),
        np.asarray((even - drag * odd) * speed - omega**2 * odd * x),
    )


def coupling(branch: Branch, distance: ArrayLike) -> Array:
    """Share of a push on one fruit that reaches another at ``distance`` m: 1 at the fruit itself, falling off by e."""
    return np.asarray(np.exp(-checks.numbers("the distance between fruit (m)", distance, lowest=0.0) / branch.coupling))


def pushed(branch: Branch, positions: ArrayLike, contact: ArrayLike, push: ArrayLike) -> Array:
    """How far a push displaces each fruit, neighbours of the touched one included.

    Args:
        branch: What the fruit hangs from.
        positions: Fruit centres, m, shape (n, 3).
        contact: Where the arm touches, m, shape (..., 3).
        push: How far it pushes, m, shape (..., 3).

    Returns:
        Displacements, m, shape (..., n, 3): start values for `swing`.
    """
    positions, contact = checks.points("fruit positions", positions), checks.points("the contact", contact)
    push = checks.points("the push", push)
    distance = np.linalg.norm(positions - contact[..., None, :], axis=-1)
    return np.asarray(coupling(branch, distance)[..., None] * push[..., None, :])


def _moving_mass(branch: Branch, mass: ArrayLike) -> Array:
    fruit = checks.numbers("the mass of fruit (kg)", mass)
    if (fruit <= 0).any():
        checks.positive("the mass of fruit (kg)", float(fruit.min()))
    return np.asarray(fruit + branch.wood)
