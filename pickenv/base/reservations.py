"""Reservations: what stands against using something, by name. Refused, unless whoever uses it names the reservation."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from pickenv.base.errors import InputError

DO_NOT_USE = "do-not-use"
"""The verdict on a calibration is that it should not be used."""

FITTED_FRAMES = "fitted-frames"
"""A calibration's base and tool were fitted: what the arm does in its own base frame is not known."""

NAMES = (DO_NOT_USE, FITTED_FRAMES)


def obey(reservations: Mapping[str, str], allow: Collection[str], concerns: Collection[str] = NAMES) -> None:
    """Refuse what has a reservation that concerns this use and was not allowed by name.

    Args:
        reservations: Sentence that says what is wrong and what to do, by name.
        allow: Names that the user accepts.
        concerns: Names that matter for this use.

    Raises:
        InputError: The sentence; or if a name allowed does not exist.
    """
    unknown = [name for name in allow if name not in NAMES]
    if unknown:
        raise InputError(f"unknown reservation '{unknown[0]}'; give one of {', '.join(NAMES)}")
    for name, sentence in reservations.items():
        if name in concerns and name not in allow:
            raise InputError(f"{sentence}; allow '{name}' by name to use it all the same")
