"""Fruit: its number and sizes, the loads that detach it, and its swing on the branch.

Fruit grows in clusters, so its positions are not uniform. The fruiting wall, a vertical plane along the row, is divided
into square blocks. The number of clusters per block has a negative binomial distribution. Its mean depends on the
height of the block, and its ratio of variance to mean is the same everywhere. Each cluster has ``cluster_size`` fruit.
Blocks are independent, although in the field neighbours have correlations of 0.1 to 0.3.

A fruit on its branch is a damped spring-pendulum, so a push displaces it and its neighbours for some time. Each axis
obeys x'' + 2ζω x' + ω² x = 0, with ω² = g/l + k/m sideways and ω² = k/m upright. The solution is exact for any time
step. Units: m, s, N, kg. Axes as in canopy.py: x and y sideways, z up.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from pickenv.base import GRAVITY, KG, NEWTON, NEWTON_METRE, NUMBER, REQUIRED, WHOLE, InputError, Unit, toml_table
from pickenv.orchard import checks, preset_files
from pickenv.orchard.checks import MM, Array, Integers

# What it takes to pick a fruit: pull or twist, whichever limit is met first, log-normal over fruit. One strength per
# fruit scales both limits: a fruit that holds against pulling holds against twisting. Units: N, N·m, m.


QUANTILE_95 = 1.6448536269514722  # of the standard normal


@toml_table
class Detachment(checks.Preset):
    """Distribution of the loads that detach fruit.

    Attributes:
        pull_95: Pulling force that detaches 95 % of fruit, N.
        twist_95: Torque about the stem that detaches 95 % of fruit, N·m.
        spread: Standard deviation of the natural logarithm of both loads.
        stem: Length of the stem, m.
        source: Source of its numbers.
    """

    pull_95: Annotated[float, NEWTON.positive]
    twist_95: Annotated[float, NEWTON_METRE.positive]
    spread: Annotated[float, NUMBER.positive]
    stem: Annotated[float, MM.not_negative]
    source: str = ""


load_detachment = preset_files.loader("detachment", Detachment)
"""Read a `Detachment` by its name, one of `shipped("detachment")`, or from a TOML file by its path."""


def sample_strength(
    detachment: Detachment, shape: int | tuple[int, ...], rng: np.random.Generator
) -> tuple[Array, Array]:
    """Draw the loads that detach fruit: pulling forces, N, and torques, N·m, as two arrays of shape ``shape``.

    Both loads of a fruit have the same log-normal factor.
    """
    scale = np.exp(detachment.spread * (rng.normal(size=shape) - QUANTILE_95))
    return np.asarray(detachment.pull_95 * scale), np.asarray(detachment.twist_95 * scale)


@toml_table
class FruitMap(checks.Preset):
    """Distribution of the number of fruit per block of the fruiting wall along a row of trees.

    Attributes:
        block: Edge of the square blocks, m.
        row_means: Expected number of fruit per block at each height: one number per horizontal row of blocks, from the
            top row to the bottom row.
        cluster_size: Number of fruit per cluster.
        cluster_variance_ratio: Ratio of variance to mean of the number of clusters per block. With 1 it has a Poisson
            distribution; above 1 clusters are clumped.
        source: Source of its numbers.
    """

    block: Annotated[float, MM.positive]
    row_means: Annotated[tuple[float, ...], NUMBER.not_negative]
    cluster_size: Annotated[int, WHOLE.at_least(1), REQUIRED] = 1
    cluster_variance_ratio: Annotated[float, NUMBER.at_least(1), REQUIRED] = 1.0
    source: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.row_means:
            raise InputError("a fruit map needs at least one row of blocks; row_means is empty")

    @property
    def density(self) -> float:
        """Expected number of fruit per metre of the row of trees, over the whole height."""
        return sum(self.row_means) / self.block

    def scaled(self, density: float) -> FruitMap:
        """Return this map with ``density`` fruit per metre of the row of trees.

        Sizes of clusters, and the share of the fruit at each height, are unchanged.

        Raises:
            InputError: If the density is negative or this map has no fruit.
        """
        checks.numbers("the density of a fruit map (fruit per m)", density, lowest=0.0)
        if not self.density:
            raise InputError("a fruit map without apples cannot be scaled; give row_means above zero")
        return replace(self, row_means=tuple(mean * density / self.density for mean in self.row_means))

    def with_rows(self, rows: int) -> FruitMap:
        """Return this map divided into ``rows`` horizontal rows of blocks instead.

        The fruit per metre of the row of trees, and its distribution over the height, are unchanged.

        Raises:
            InputError: If ``rows`` is below 1.
        """
        if rows < 1:
            raise InputError(f"a fruit map cannot have {rows} rows of blocks; give 1 or more")
        below = np.concatenate([[0.0], np.cumsum(self.row_means)])
        shares = np.diff(np.interp(np.linspace(0.0, len(self.row_means), rows + 1), np.arange(len(below)), below))
        return replace(self, row_means=tuple(float(mean) for mean in shares))


def sample_counts(fruit_map: FruitMap, columns: int, rng: np.random.Generator, shape: tuple[int, ...] = ()) -> Integers:
    """Draw the number of fruit in each block, ``(*shape, rows, columns)``: ``rows`` blocks high, from top to bottom.

    Args:
        fruit_map: Distribution of the numbers; it has the number of rows of blocks.
        columns: Number of blocks along the row of trees.
        rng: Random generator for all draws.
        shape: Shape of the batch of independent samples; one sample by default.

    Raises:
        InputError: If ``columns`` is below 1.
    """
    if columns < 1:
        raise InputError(f"a row of trees cannot be {columns} blocks long; give 1 or more")
    means = np.array(fruit_map.row_means)[:, None] / fruit_map.cluster_size
    size = (*shape, len(means), columns)
    excess = fruit_map.cluster_variance_ratio - 1.0
    if excess < 1e-9:
        clusters = rng.poisson(np.broadcast_to(means, size))
    else:
        bearing = np.broadcast_to(means, size) > 0
        sampled = rng.negative_binomial(np.where(bearing, means / excess, 1.0), 1.0 / (1.0 + excess))
        clusters = np.where(bearing, sampled, 0)
    return np.asarray(clusters * fruit_map.cluster_size, dtype=np.int64)


@toml_table
class FruitSize(checks.Preset):
    """Truncated normal distribution of fruit diameters, and density of fruit.

    Attributes:
        mean: Mean diameter before truncation, m.
        std: Standard deviation before truncation, m.
        smallest: Smallest diameter, m.
        largest: Largest diameter, m.
        density: Mass per volume, kg/m³.
        source: Source of its numbers.
    """

    mean: Annotated[float, MM.positive]
    std: Annotated[float, MM.not_negative]
    smallest: Annotated[float, MM.positive]
    largest: Annotated[float, MM]
    density: Annotated[float, Unit("kg_per_m3").positive]
    source: str = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.smallest <= self.mean <= self.largest:
            raise InputError(
                f"fruit diameters from {self.smallest} to {self.largest} m do not hold their mean {self.mean} m"
            )


def sample_diameters(size: FruitSize, count: int, rng: np.random.Generator) -> Array:
    """Draw ``count`` diameters, m, from the truncated normal distribution, by inversion of one uniform number each."""
    from scipy.special import ndtr, ndtri

    uniform = rng.random(count)
    if size.std < 1e-9 * size.mean:
        return np.full(count, size.mean)
    low, high = ndtr((np.array([size.smallest, size.largest]) - size.mean) / size.std)
    return np.asarray(np.clip(size.mean + size.std * ndtri(low + uniform * (high - low)), size.smallest, size.largest))


def fruit_masses(size: FruitSize, diameters: ArrayLike) -> Array:
    """Return the masses of spherical fruit, kg, in an array of the same shape as their ``diameters``, m."""
    return np.asarray(size.density * np.pi / 6.0 * checks.numbers("fruit diameters", diameters, lowest=0.0) ** 3)


load_fruit_map = preset_files.loader("fruit", FruitMap)
"""Read a fruit map by its name, one of `shipped("fruit")`, or from a TOML file by its path."""


load_fruit_size = preset_files.loader("fruit_size", FruitSize)
"""Read a `FruitSize` by its name, one of `shipped("fruit_size")`, or from a TOML file by its path."""


@toml_table
class Branch(checks.Preset):
    """The branch that fruit hangs from: parameters of the damped spring-pendulum.

    Attributes:
        pendulum: Length of the pendulum, m.
        stiffness_sideways: Stiffness of the branch along x and y, in addition to the pendulum's, N/m.
        stiffness_upright: Stiffness of the branch along z, N/m.
        wood: Mass of wood that moves with the fruit, kg.
        damping_ratio: Damping ratio ζ (1 is critical damping).
        coupling: Distance from a pushed fruit at which its neighbours move by 1/e of the push, m.
        source: Source of its numbers.
    """

    pendulum: Annotated[float, MM.positive]
    stiffness_sideways: Annotated[float, Unit("N_per_m").not_negative]
    stiffness_upright: Annotated[float, Unit("N_per_m").positive]
    wood: Annotated[float, KG.not_negative]
    damping_ratio: Annotated[float, NUMBER.not_negative]
    coupling: Annotated[float, MM.positive]
    source: str = ""


load_branch = preset_files.loader("branch", Branch)
"""Read a branch by its name, one of `shipped("branch")`, or from a TOML file by its path."""


def natural_frequencies(branch: Branch, mass: ArrayLike) -> Array:
    """Return the undamped angular frequencies of a fruit's swings along x, y and z, rad/s, (..., 3).

    ``mass`` has the fruit masses, kg, (...).
    """
    moving = checks.numbers("the mass of fruit (kg)", mass, positive=True) + branch.wood
    omega = np.empty((*moving.shape, 3))
    omega[..., 0] = omega[..., 1] = np.sqrt(GRAVITY / branch.pendulum + branch.stiffness_sideways / moving)
    omega[..., 2] = np.sqrt(branch.stiffness_upright / moving)
    return omega


def swing(
    branch: Branch, displacement: ArrayLike, velocity: ArrayLike, mass: ArrayLike, dt: ArrayLike
) -> tuple[Array, Array]:
    """Return the displacement and velocity of freely swinging fruit after a time ``dt``.

    Args:
        branch: Branch that the fruit hangs from.
        displacement: Displacement from the position at rest, m, shape (..., 3).
        velocity: Velocity, m/s, shape (..., 3).
        mass: Fruit masses, kg, shape (...).
        dt: Time, s, shape (...); the solution is exact for any length.

    Returns:
        Displacement, m, and velocity, m/s, of shape (..., 3) each.

    Raises:
        InputError: If a number is not finite, a mass is not above zero, a time is negative, or a shape is wrong.
    """
    x = checks.points("the displacement of fruit", displacement)
    speed = checks.points("the velocity of fruit", velocity)
    time = checks.numbers("the time step (s)", dt, lowest=0.0)[..., None]
    return swung(branch, x, speed, natural_frequencies(branch, mass), time)


def swung(branch: Branch, x: Array, speed: Array, omega: Array, time: Array) -> tuple[Array, Array]:
    """Return the same displacement and velocity as `swing`, without its checks.

    Args:
        branch: Branch that the fruit hangs from.
        x: Displacement from the position at rest, m, shape (..., 3).
        speed: Velocity, m/s, shape (..., 3).
        omega: Undamped angular frequencies of `natural_frequencies`, rad/s, shape (..., 3).
        time: Time, s, shape (..., 1).
    """
    zeta = branch.damping_ratio
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
    moved = (even + drag * odd) * x + odd * speed
    return np.asarray(moved), np.asarray((even - drag * odd) * speed - omega**2 * odd * x)


def coupling(branch: Branch, distance: ArrayLike) -> Array:
    """Return the displacement of a fruit at ``distance``, m, from a pushed one, as a share of the push.

    The share is exp(−distance / branch.coupling).
    """
    return np.asarray(np.exp(-checks.numbers("the distance between fruit (m)", distance, lowest=0.0) / branch.coupling))


def pushed(branch: Branch, positions: ArrayLike, contact: ArrayLike, push: ArrayLike) -> Array:
    """Return the displacement of each fruit right after a push at one point.

    Args:
        branch: Branch that the fruit hangs from.
        positions: Fruit centres, m, shape (n, 3).
        contact: Point that the arm touches, m, shape (..., 3).
        push: Displacement at that point, m, shape (..., 3).

    Returns:
        Displacements, m, shape (..., n, 3), which are initial values for `swing`.
    """
    positions, contact = checks.points("fruit positions", positions), checks.points("the contact", contact)
    push = checks.points("the push", push)
    distance = np.linalg.norm(positions - contact[..., None, :], axis=-1)
    return np.asarray(coupling(branch, distance)[..., None] * push[..., None, :])
