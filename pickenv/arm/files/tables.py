"""Tables of a TOML file, read with care: finite numbers of the right sign, and a sentence that names a wrong one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from pickenv.arm.files.arm_file import Arm, refuse_unknown
from pickenv.arm.files.plausible import largest
from pickenv.errors import InputError
from pickenv.texts import shortened

RADIANS = {"arcmin": math.radians(1.0 / 60.0), "arcsec": math.radians(1.0 / 3600.0)}
METRES = {"mm": 1e-3, "um": 1e-6}


class Table:
    """A TOML table that reads non-negative finite numbers and says which one is wrong."""

    def __init__(self, table: Any, name: str, where: str, keys: Iterable[str]) -> None:
        """Take ``table``, called ``name`` in the file ``where``; keys other than ``keys`` are refused."""
        if not isinstance(table, Mapping):
            raise InputError(f"{where}: [{name}] must be a table")
        refuse_unknown(table, keys, where, f"[{name}]")
        self.table, self.name, self.where = table, name, where

    def fail(self, key: str, wanted: str) -> InputError:
        """The error to raise for ``key``, when it should have been ``wanted``."""
        given = shortened(repr(self.table[key])) if key in self.table else "missing"
        return InputError(f"{self.where}: {key} of [{self.name}] is {given}; give {wanted}")

    def number(self, key: str, *, positive: bool = False, signed: bool = False, default: float | None = None) -> float:
        """A finite number, not negative unless ``signed``, above zero if ``positive``."""
        value = self.table.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise self.fail(key, "a finite number")
        if not signed and (value < 0 or (positive and value == 0)):
            raise self.fail(key, "a number above zero" if positive else "a number that is not negative")
        if abs(value) > largest(key):
            raise self.fail(key, f"at most {largest(key):g}")
        return float(value)

    def numbers(self, key: str, count: int, *, positive: bool = False, signed: bool = False) -> tuple[float, ...]:
        """A list of ``count`` such numbers."""
        values = self.table.get(key)
        if not isinstance(values, list) or len(values) != count:
            raise self.fail(key, f"{count} numbers")
        for value in values:
            Table({key: value}, self.name, self.where, (key,)).number(key, positive=positive, signed=signed)
        return tuple(float(value) for value in values)

    def choice(self, key: str, allowed: Iterable[str], default: str) -> str:
        """One of ``allowed``."""
        value = self.table.get(key, default)
        allowed = tuple(allowed)
        if value not in allowed:
            raise self.fail(key, f"one of {', '.join(allowed)}")
        return str(value)

    def joint_index(self, arm: Arm) -> int:
        """The key ``joint`` as an index from 0."""
        value = self.number("joint", positive=True)
        if value != int(value) or value > arm.nominal.joints:
            raise self.fail("joint", f"a joint number from 1 to {arm.nominal.joints}")
        return int(value) - 1

    def slide_index(self, arm: Arm) -> int:
        """The key ``joint`` as the index of a prismatic joint."""
        joint = self.joint_index(arm)
        if not arm.nominal.prismatic[joint]:
            raise self.fail("joint", f"a prismatic joint: joint {joint + 1} of {arm.name} is revolute")
        return joint

    def entries(self, key: str, keys: Iterable[str]) -> list[Table]:
        """A list of tables under ``key``; empty where it is missing."""
        found = self.table.get(key, [])
        if not isinstance(found, list):
            raise self.fail(key, "a list of tables")
        return [Table(entry, f"{self.name}.{key}", self.where, keys) for entry in found]

    def by_joint(self, arm: Arm, keys: Iterable[str]) -> dict[int, Table]:
        """The list of tables under ``joints``, one per joint that it names."""
        tables: dict[int, Table] = {}
        for entry in self.entries("joints", ("joint", *keys)):
            joint = entry.joint_index(arm)
            if joint in tables:
                raise entry.fail("joint", "each joint once")
            tables[joint] = entry
        return tables
