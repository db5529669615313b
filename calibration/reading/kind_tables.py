"""Tables of a column description that say what was measured, one class for each way of saying it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import KW_ONLY
from math import inf
from typing import Annotated, Any

from pickenv.errors import InputError
from pickenv.toml_tables import DEG, MM, Check, Key, Then, fault, toml_table

LENGTHS, ANGLES = ("mm", "m"), ("deg", "rad")
KNOWN, FITTED = "known", "fitted"
TILTS = ("deg", "rad", "g")
LOST = ("zeros", "empty")


def one_of(names: Iterable[str]) -> Check:
    """A check that a value is among these."""
    allowed = tuple(names)
    return Check(allowed.__contains__, f"one of {', '.join(allowed)}")


COLUMN = Check(lambda value: isinstance(value, str), "the name of a column or an expression")
COLUMNS = Check(
    lambda value: isinstance(value, list) and all(isinstance(item, str) for item in value),
    "a list of column names or expressions",
)


def _lost(found: Any, _context: Any) -> tuple[str, ...]:
    marks = [found] if isinstance(found, str) else found
    if not isinstance(marks, list) or any(mark not in LOST for mark in marks):
        raise fault(f"how lost reflectors are marked, of {', '.join(LOST)}")
    return tuple(marks)


@toml_table
class LengthsTable:
    """[position]; fields are called as in `pickenv.calibration.reading.description.ColumnDescription`."""

    _: KW_ONLY
    position: Annotated[tuple[str, ...], COLUMNS, Key("columns")]
    position_unit: Annotated[str, one_of(LENGTHS), Key("unit")]
    position_std: Annotated[float, MM.positive, Key("std_mm")] | None = None
    position_std_columns: Annotated[tuple[str, ...], COLUMNS, Key("std_columns")] = ()


@toml_table
class ReflectorsTable(LengthsTable):
    """[reflectors]."""

    lost: Annotated[tuple[str, ...], Then(_lost, Any)] = ()
    places: Annotated[tuple[float, ...], MM] = ()
    places_std: Annotated[float, MM.not_negative] = 1e-4

    def __post_init__(self) -> None:
        if self.places and len(self.places) != len(self.position):
            raise InputError(
                f"places_mm of [reflectors] has {len(self.places)} numbers for {len(self.position)} columns; give x, y "
                "and z of each reflector in turn"
            )


@toml_table
class ContactTable:
    """[touches] or [plane], and what every contact says: its uncertainty, and which point of the tool it is about."""

    _: KW_ONLY
    position_std: Annotated[float, MM.positive, Key("std_mm")] = 1e-4
    tool: Annotated[str, one_of((KNOWN, FITTED))] = KNOWN
    tool_point: Annotated[tuple[float, float, float], MM, Key("tool_mm")] = (0.0, 0.0, 0.0)
    tool_std: Annotated[float, MM.not_negative] = 0.0
    contact: Annotated[str, COLUMN] | None = None

    @property
    def tip_std(self) -> float:
        """Standard uncertainty of the tool point, m; infinite where it is to be found."""
        return inf if self.tool == FITTED else self.tool_std

    @property
    def position(self) -> tuple[str, ...]:
        """No columns."""
        return ()


@toml_table
class SocketsTable(ContactTable):
    """[sockets]."""

    column: Annotated[tuple[str, ...], Then(lambda name, _: (name,), Annotated[str, COLUMN])] = ()
    spacing: Annotated[float, MM.positive] | None = None
    spacing_std: Annotated[float, MM.positive] = 5e-5

    @property
    def position(self) -> tuple[str, ...]:
        """The column that numbers the sockets, where there is one."""
        return self.column


@toml_table
class ReadingTable(ContactTable):
    """What [wire] and [dial] share: one column of readings."""

    columns: Annotated[tuple[str, ...], COLUMNS]
    position_unit: Annotated[str, one_of(LENGTHS), Key("unit")]
    scale: Annotated[str, one_of((KNOWN, FITTED))] = KNOWN

    @property
    def position(self) -> tuple[str, ...]:
        """The column."""
        return self.columns

    @property
    def scale_std(self) -> float:
        """Of the reading's scale."""
        return inf if self.scale == FITTED else 0.0


@toml_table
class WireTable(ReadingTable):
    """[wire]: a draw wire to an anchor."""

    zero: Annotated[str, one_of((KNOWN, FITTED)), Key("zero")] = FITTED
    begin: Annotated[float, MM, Key("zero_mm")] = 0.0

    @property
    def zero_std(self) -> float:
        """Of what is read at length 0, m."""
        return inf if self.zero == FITTED else 0.0


@toml_table
class DialTable(ReadingTable):
    """[dial]: a dial gauge along a fixed axis."""

    free: Annotated[float, MM] = 0.0


@toml_table
class BarTable(ContactTable):
    """[bar]: a ball bar, whose length is found where it is not given."""

    length: Annotated[float, MM.positive] | None = None
    length_std: Annotated[float, MM.not_negative] = 0.0


@toml_table
class RadiusTable(ContactTable):
    """[sphere] or [edge]: what the tool point keeps from its centre or edge, found where it is not given."""

    length: Annotated[float, MM.positive, Key("radius_mm")] | None = None
    length_std: Annotated[float, MM.not_negative, Key("radius_std_mm")] = 0.0


@toml_table
class TiltTable:
    """[tilt]: components of down along the axes of an inclinometer or accelerometer."""

    _: KW_ONLY
    position: Annotated[tuple[str, ...], COLUMNS, Key("columns")]
    position_unit: Annotated[str, one_of(TILTS), Key("unit")]
    position_std: Annotated[float, DEG.positive, Key("std_deg")] = 1e-3
    mount: Annotated[str, one_of((KNOWN, FITTED))] = FITTED
    base: Annotated[str, one_of((KNOWN, FITTED))] = FITTED
