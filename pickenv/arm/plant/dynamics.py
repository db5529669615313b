"""What the true arm remembers from one moment to the next; `pickenv.arm.plant.plant` moves it on."""

from __future__ import annotations

from typing import NamedTuple

from pickenv.arm.kinematics.forward import Scalar

Components = tuple[Scalar, ...]


class PlantState(NamedTuple):
    """What a plant remembers; every part is empty while its effect is off, and each component has the joints' shape.

    Attributes:
        motor: Motor positions, n of them, rad or m (servo).
        friction: Joint displacements behind the friction, n (stick band).
        backlash: Joint displacements behind the gaps, n (backlash).
        profile: Motion profiles, n (settling).
        vibration: Displacements of the swinging modes, n (settling).
        rate: Velocities of what swings, n, rad/s or m/s (settling).
        rise: Temperature rise, one, K (thermal growth).
        sinkage: Creep about x and y in rad, settlement in m (base tilt).
    """

    motor: Components = ()
    friction: Components = ()
    backlash: Components = ()
    profile: Components = ()
    vibration: Components = ()
    rate: Components = ()
    rise: Components = ()
    sinkage: Components = ()
