"""The error that pickenv raises for bad input, and limits of numbers that users give.

A message says what is wrong and what to do. A number outside the limits is a slip, or would make a run that never ends.
`LIMITS` serves command options, study files and environments. `pickenv.arm` has limits of its own for arm files.

A reservation is a named reason not to use a result, such as a calibration. `obey` refuses the use unless the user
allows that reservation.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from typing import Any


class InputError(ValueError):
    """Raised for bad input from a user, such as a damaged file, an unknown unit or an impossible option.

    The message is one sentence that names the thing at fault and says what to do. The command line prints it unchanged.
    """


COST = "more takes days and tells no more"
MEMORY = "more does not fit into a computer's memory"

LIMITS: Mapping[str, tuple[float, float, str]] = {
    "payload_kg": (0.0, 300.0, "arms that pick, and those calibrated here, carry less"),
    "temperature_K": (-200.0, 200.0, "no arm works that much cooler or warmer than it was calibrated"),
    "torque_Nm": (-1e5, 1e5, "no joint of an arm bears more"),
    "scatter_mm": (1e-6, 100.0, "no instrument scatters less, and one that scatters more measures no arm"),
    "position_mm": (0.0, 100.0, "an instrument that scatters more measures no arm"),
    "attitude_deg": (0.0, 10.0, "an instrument that scatters more measures no arm"),
    "radius_mm": (0.0, 1000.0, "who calls a metre near enough needs no study"),
    "weather_K": (0.0, 60.0, "no day in an orchard is that much cooler or warmer than usual"),
    "hours": (0.0, 10_000.0, "every machine is as warm as it gets long before"),
    "dwell_s": (0.0, 86_400.0, "every arm has come to rest long before"),
    "reaches": (2, 100_000, COST),
    "candidates": (10, 100_000, MEMORY),
    "cycles": (2, 10_000, COST),
    "arms": (1, 10_000_000, COST),
    "chunk": (1, 100_000, MEMORY),
    "fruit": (1, 100_000, COST),
    "poses": (1, 10_000, COST),
    "compared arms": (1, 10_000, MEMORY),
    "episodes": (1, 100_000, MEMORY),
    "epochs": (1, 100_000, COST),
    "population": (1, 1_000_000, MEMORY),
    "samples": (256, 2**20, COST),
    "seed": (0, 2**128, "random numbers come from 128 bits"),
    "seed of training": (0, 2**32 - 1, "stable-baselines3 takes 32 bits"),
}
"""Smallest value, largest value and the reason for these limits, by quantity. A quantity's name ends with its unit, if
it has one."""


def check_limit(name: str, value: Any, quantity: str) -> None:
    """Raise an error if a value is not a number, not finite, or outside the limits of its quantity.

    Args:
        name: Option or key that has the value, for the message: "--hours", or "study.toml: payload_kg of [picking]".
        value: The value.
        quantity: Name of the quantity, a key of `LIMITS`.

    Raises:
        InputError: If the value is refused. The message states the limits and their reason.
    """
    least, most, why = LIMITS[quantity]
    if not isinstance(value, int | float) or isinstance(value, bool) or not least <= value <= most:
        limits = f"{least:_.12g} to {most:_.12g}".replace("_", " ")
        raise InputError(f"{name} is {shown(value)}; give {limits}: {why}")


def shown(value: Any) -> str:
    """Return the ``repr`` of a value for a message, cut to 60 characters."""
    try:
        text = repr(value)
    except ValueError:
        return "a number of thousands of digits"
    return text if len(text) <= 60 else f"{text[:60]}…"


def check_known(kind: str, name: str, known: Iterable[str]) -> None:
    """Raise an `InputError` unless ``name`` is in ``known``; ``kind`` says in the message what is named: "detector"."""
    if name not in (names := tuple(known)):
        raise InputError(f"unknown {kind} '{name}'; give one of {', '.join(names)}")


DO_NOT_USE = "do-not-use"
"""Name of the reservation about a calibration whose verdict says that it should not be used."""

FITTED_FRAMES = "fitted-frames"
"""Name of the reservation about a calibration with fitted base and tool frames. Its errors in the arm's base frame are
unknown."""

NAMES = (DO_NOT_USE, FITTED_FRAMES)


def obey(reservations: Mapping[str, str], allow: Collection[str], concerns: Collection[str] = NAMES) -> None:
    """Raise an error if a reservation concerns this use and the user did not allow it.

    Args:
        reservations: For each reservation, by name, a sentence that says what is wrong and what to do.
        allow: Names of the reservations that the user allows.
        concerns: Names of the reservations that matter for this use.

    Raises:
        InputError: If there is such a reservation; the message has its sentence. Also if ``allow`` has an unknown name.
    """
    for name in allow:
        check_known("reservation", name, NAMES)
    for name, sentence in reservations.items():
        if name in concerns and name not in allow:
            raise InputError(f"{sentence}; allow '{name}' by name to use it all the same")
