"""Links grow with temperature, L (1 + alpha dT), and the arm warms up over the first hours: dT' = (final - dT) / tau.

dT is the rise above the temperature at which the true geometry holds. Units: K, s.
"""

from __future__ import annotations

from collections.abc import Sequence
from types import ModuleType
from typing import Annotated

from pickenv.arm.files.joint_keys import PER_JOINT
from pickenv.arm.kinematics.backend import exponential
from pickenv.arm.kinematics.forward import Chain, Scalar
from pickenv.toml_tables import HOURS, KELVIN, Unit, toml_table


@toml_table
class ThermalGrowth:
    """Growth of each link with the arm's temperature.

    Attributes:
        expansion: Coefficient of linear expansion alpha of each link, 1/K.
        initial_rise: Temperature rise when the arm is switched on, K.
        final_rise: Temperature rise of the warm arm, K.
        time_constant: Time constant of the warm-up, s.
    """

    expansion: Annotated[tuple[Scalar, ...], Unit("um_per_m_K", 1e-6).not_negative, PER_JOINT]
    initial_rise: Annotated[Scalar, KELVIN]
    final_rise: Annotated[Scalar, KELVIN]
    time_constant: Annotated[Scalar, HOURS.positive]


def warmed(m: ModuleType, thermal: ThermalGrowth, rise: Scalar, dt: Scalar) -> Scalar:
    """Temperature rise in K, ``dt`` seconds after it was ``rise``."""
    return thermal.final_rise + (rise - thermal.final_rise) * exponential(m, -dt / thermal.time_constant)


def grown_chain(thermal: ThermalGrowth, chain: Chain, rise: Scalar) -> Chain:
    """The chain with a and d of every link grown by a temperature rise of ``rise`` K."""
    links = []
    for link, alpha in zip(chain.links, thermal.expansion, strict=True):
        factor = 1.0 + alpha * rise
        links.append(link._replace(a=link.a * factor, d=link.d * factor))
    return chain._replace(links=tuple(links))


def grown_joints(thermal: ThermalGrowth, chain: Chain, joints: Sequence[Scalar], rise: Scalar) -> list[Scalar]:
    """Joint displacements of the warm arm: what a slide has run out grows with its rack, angles stay."""
    numbers = zip(chain.links, joints, thermal.expansion, strict=True)
    return [value * (1.0 + alpha * rise) if link.prismatic else value for link, value, alpha in numbers]
