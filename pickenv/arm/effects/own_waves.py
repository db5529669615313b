"""What no two arms of one design share, and no data sheet tells: waves of the drives, and structure finer than a grid.

A plant file says how such waves are spread; a design has one draw of them, by the file's seed, and every arm drawn from
it has its own. Drives: a sin + b cos of each period, whose order (cycles per turn, or per length) lies evenly between
two bounds, with a and b normal and falling with the order. Structure: random features of a Gaussian process of the
joints (`pickenv.arm.effects.residual_field`), which displaces the tool. Units: m, rad.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from scipy.special import ndtri

from pickenv.arm.effects.residual_field import Features, ResidualField
from pickenv.arm.effects.structure import Harmonic
from pickenv.arm.files.joint_keys import ByJoint, number_per_joint
from pickenv.arm.kinematics.geometry import Array
from pickenv.errors import InputError
from pickenv.toml_tables import ARCMIN, DEG, MM, NUMBER, WHOLE, Then, toml_table

SEED = WHOLE.not_negative


def standard_normal_of(even: Array) -> Array:
    """Standard normal numbers of even ones."""
    return np.asarray(ndtri(np.clip(even, 1e-12, 1.0 - 1e-12)))


@toml_table
class WavesTable:
    """[drive_harmonics] of a plant file.

    Attributes:
        seed: Of the design's own draw.
        decay: Coefficients fall as order to the power of minus this.
        joints: Per joint the number of waves, the standard deviation of a coefficient at the longest period, and the
            longest and the shortest period.
    """

    seed: Annotated[int, SEED]
    decay: Annotated[float, NUMBER.not_negative]
    joints: Annotated[
        tuple[Any, ...],
        ByJoint(
            waves=(WHOLE.at_least(1), WHOLE.at_least(1)),
            amplitude=(ARCMIN.not_negative, MM.not_negative),
            longest=(DEG.positive, MM.positive),
            shortest=(DEG.positive, MM.positive),
        ),
    ]


@dataclass(frozen=True)
class WaveSpread:
    """How one wave of a drive is spread over arms.

    Attributes:
        joint: Index of the joint (from 0).
        std: Standard deviation of a coefficient at the longest period, rad or m.
        longest: Longest period, rad or m.
        shortest: Shortest period.
        decay: Coefficients fall as order to the power of minus this.
    """

    joint: int
    std: float
    longest: float
    shortest: float
    decay: float


@dataclass(frozen=True)
class DriveHarmonics:
    """Periodic errors of the drives that an arm has for itself.

    Attributes:
        spread: How each is spread over arms.
        harmonics: Those of this arm.
    """

    spread: tuple[WaveSpread, ...]
    harmonics: tuple[Harmonic, ...]


def drawn_harmonics(spread: Sequence[WaveSpread], even: Array) -> DriveHarmonics:
    """The drives of arms.

    Args:
        spread: How each of the W waves is spread.
        even: Even random numbers ``(..., 3 W)``: of each wave the order, and two coefficients.
    """
    order, sine, cosine = np.moveaxis(even.reshape(*even.shape[:-1], len(spread), 3), -1, 0)
    harmonics = []
    for k, wave in enumerate(spread):
        first, last = 1.0 / wave.longest, 1.0 / wave.shortest
        per = first + (last - first) * order[..., k]
        std = wave.std * (first / per) ** wave.decay
        a, b = std * standard_normal_of(sine[..., k]), std * standard_normal_of(cosine[..., k])
        sizes = (np.hypot(a, b), 1.0 / per, np.arctan2(b, a))
        harmonics.append(Harmonic(wave.joint, *(size if size.ndim else float(size) for size in sizes)))
    return DriveHarmonics(tuple(spread), tuple(harmonics))


def drive_harmonics_of(table: WavesTable, _context: Any) -> DriveHarmonics:
    """The effect of a plant file: the design's own draw.

    Raises:
        InputError: If a shortest period is not below the longest.
    """
    for entry in table.joints:
        if entry.shortest >= entry.longest:
            raise InputError(
                f"the shortest period of joint {entry.joint + 1} in [drive_harmonics] is not below its longest; give a "
                "shorter one"
            )
    spread = tuple(
        WaveSpread(entry.joint, entry.amplitude, entry.longest, entry.shortest, table.decay)
        for entry in table.joints
        for _ in range(entry.waves)
    )
    return drawn_harmonics(spread, np.random.default_rng(table.seed).random(3 * len(spread)))


@toml_table
class StructureTable:
    """[local_structure] of a plant file.

    Attributes:
        seed: Of the waves, which all arms share, and of the design's own weights.
        position: Standard deviation of the tool's displacement along each axis, m.
        waves: Number of waves of each axis.
        joints: Length scale of each joint that matters.
    """

    seed: Annotated[int, SEED]
    position: Annotated[float, MM.not_negative]
    waves: Annotated[int, WHOLE.within(1, 1000)]
    joints: Annotated[tuple[Any, ...], ByJoint(length=(DEG.positive, MM.positive))]


@dataclass(frozen=True, eq=False)
class LocalStructure:
    """Displacement of the tool that changes over fractions of a degree, of one arm or of many.

    Attributes:
        std: Standard deviation of a weight over arms, m.
        field: The waves with their weights.
    """

    std: float
    field: ResidualField

    @property
    def weights(self) -> int:
        """Number of weights of one arm."""
        return 2 * self.field.features.outputs * self.field.features.count


def drawn_structure(structure: LocalStructure, even: Array) -> LocalStructure:
    """The structure of other arms.

    Args:
        structure: Of one of them.
        even: Even random numbers ``(..., weights)``.
    """
    features = structure.field.features
    weight = structure.std * standard_normal_of(even).reshape(*even.shape[:-1], features.outputs, 2, features.count)
    return replace(structure, field=replace(structure.field, weight=weight.astype(np.float32)))


def local_structure_of(table: StructureTable, context: Any) -> LocalStructure:
    """The effect of a plant file: the design's own draw."""
    lengths = np.array(number_per_joint(table, "length", context))
    joints = len(lengths)
    per_length = np.divide(1.0, lengths, out=np.zeros(joints), where=lengths > 0)
    rng = np.random.default_rng(table.seed)
    frequency = (rng.standard_normal((joints, 3 * table.waves)) * per_length[:, None]).astype(np.float32)
    features = Features(frequency, (0.0,) * joints, (False,) * joints, 3)
    upright = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    blank = ResidualField(features, np.zeros((3, 2, table.waves), np.float32), (0.0, 0.0, 0.0), upright)
    structure = LocalStructure(table.position / math.sqrt(table.waves), blank)
    return drawn_structure(structure, rng.random(structure.weights))


OWN_WAVES = {
    "drive_harmonics": Annotated[Any, Then(drive_harmonics_of, WavesTable)],
    "local_structure": Annotated[Any, Then(local_structure_of, StructureTable)],
}
"""By effect: what a plant file holds, and what is made of it."""
