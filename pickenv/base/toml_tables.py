"""Read TOML files into frozen dataclasses, whose fields give the keys and whose annotations give units and checks.

`toml_table` makes the dataclass. The key of a field annotated with a `Unit` ends in the unit, and the object has the
value in SI units. For example, ``length: Annotated[float, MM.positive]`` is ``length_mm`` in the file, and in m in the
object.

`read_toml` returns the object. For a faulty file it raises an error with file, line, key, table, value and what to give
instead. Pydantic makes the checks; it is imported when the first file is read.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import MISSING, dataclass, field, fields, is_dataclass, make_dataclass, replace
from functools import cache, partial, reduce
from operator import getitem
from pathlib import Path
from typing import Annotated, Any, TypeVar, cast, dataclass_transform, get_args, get_origin, get_type_hints

from pickenv.base.errors import InputError
from pickenv.base.files import is_file, parsed, read_text, shortened, unknown

Thing = TypeVar("Thing")
Class = TypeVar("Class", bound=type)

INTEGERS = 1 << 63
"""Bound of TOML integers, which have 64 bits: they are at least minus this number, and below it."""


def fault(wanted: str, kind: str = "wanted", **said: Any) -> Exception:
    """Return the exception that a check of a value raises.

    Args:
        wanted: What the user should give: "a positive number" makes a message that ends "give a positive number".
        kind: Type of the error: "wanted" for a wrong value, or another word that `_fault` knows, such as "unknown".
        said: Further values by name that `_fault` puts into the message, such as the unknown ``key``.
    """
    from pydantic_core import PydanticCustomError

    return PydanticCustomError(cast(Any, kind), "{wanted}", {"wanted": f"give {wanted}", **said})


@dataclass(frozen=True)
class Check:
    """Annotation of a field that tests its value as it is in the file, before conversion to SI units.

    Attributes:
        test: Function that returns whether the value is valid.
        wanted: What the user should give if the test fails.
    """

    test: Callable[[Any], bool]
    wanted: str

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Return the pydantic schema of the annotated type ``source``, with the test before it."""
        from pydantic_core import core_schema as core

        return core.no_info_before_validator_function(self.checked, handler(source))

    def checked(self, value: Any) -> Any:
        """Return the value if it passes the test; else raise a `fault`."""
        if not self.test(value):
            raise fault(self.wanted)
        return value


@dataclass(frozen=True)
class Unit:
    """Annotation of a number, or of tuples of numbers, with the unit in the file, its conversion to SI, and bounds.

    Attributes:
        name: Ending of the key; empty for numbers without a unit.
        scale: SI units per unit, by which the file's value is multiplied.
        per: Units per SI unit, by which the file's value is divided. Use it instead of ``scale`` if a division
            rounds to the nearest number and a multiplication does not.
        most: Largest magnitude, in the file's unit. A larger one is a slip or is in a wrong unit.
        least: Smallest value, in the file's unit; None for minus ``most``.
        above: Whether ``least`` itself is refused.
        whole: Whether the number must be an integer.
        why: Reason for the bounds, which messages state. If it is given, messages name both bounds.
    """

    name: str = ""
    scale: float = 1.0
    per: float = 1.0
    most: float = math.inf
    least: float | None = None
    above: bool = False
    whole: bool = False
    why: str | None = None

    @property
    def positive(self) -> Unit:
        """This unit, for numbers above zero only."""
        return replace(self, least=0.0, above=True)

    @property
    def not_negative(self) -> Unit:
        """This unit, for numbers from zero upwards only."""
        return replace(self, least=0.0)

    def at_least(self, least: float) -> Unit:
        """Return this unit, for numbers of at least ``least`` only, in the file's unit."""
        return replace(self, least=least)

    def within(self, least: float, most: float, why: str = "") -> Unit:
        """Return this unit, for numbers from ``least`` to ``most`` only, in the file's unit, both included.

        ``why`` is the reason for the bounds, which messages state.
        """
        return replace(self, least=least, most=most, why=why)

    @property
    def wanted(self) -> str:
        """Description of a valid number, for messages."""
        number = "a whole number" if self.whole else "a number" if self.least is not None else "a finite number"
        unit, why = f" {self.name}" if self.name else "", f": {self.why}" if self.why else ""
        if self.why is not None and not self.above:
            return f"{number} from {self.least:.15g} to {self.most:.15g}{unit}{why}"
        low = " above zero" if self.above else "" if self.least is None else f" of at least {self.least:g}"
        zero = " that is not negative" if self.least == 0 and not self.above else low
        return f"{number}{zero}" + (f", at most {self.most:g}{unit}{why}" if self.most < math.inf else "")

    def holds(self, value: float) -> bool:
        """Return whether a number in SI units is within the bounds."""
        ends = (-self.most if self.least is None else self.least), self.most
        low, high = (end * self.scale / self.per for end in ends)
        return math.isfinite(value) and (low < value if self.above else low <= value) and value <= high

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Return the pydantic schema of ``source``: a number, or tuples of numbers, nested as they are annotated."""
        from pydantic_core import core_schema as core

        if get_origin(source) is tuple:
            parts = tuple(part if part is Ellipsis else Annotated[part, self] for part in get_args(source))
            count = 0 if Ellipsis in parts else len(parts)
            numbers = f"{count} numbers" if count else "a list of numbers"
            check = Check(lambda value: isinstance(value, list) and len(value) == (count or len(value)), numbers)
            schema = handler.generate_schema(tuple[parts])  # type: ignore[valid-type]
            return core.no_info_before_validator_function(check.checked, schema)
        number = int if self.whole else float
        bounds: Any = {"gt" if self.above else "ge": -self.most if self.least is None else self.least, "le": self.most}
        bounds = {key: number(bound) for key, bound in bounds.items() if math.isfinite(bound)}
        schema = core.float_schema(strict=True, allow_inf_nan=False, **bounds)
        if self.whole:
            schema = core.no_info_before_validator_function(
                lambda value: int(value) if isinstance(value, float) and value.is_integer() else value,
                core.int_schema(strict=True, **bounds),
            )
        schema = core.custom_error_schema(schema, "wanted", custom_error_message=f"give {self.wanted}")
        if self.scale == self.per == 1.0:
            return schema
        return core.no_info_after_validator_function(lambda value: value * self.scale / self.per, schema)


@dataclass(frozen=True)
class Then:
    """Annotation of a field that converts its checked value with a function.

    Attributes:
        make: Function of the checked value and of the ``context`` given to `read_toml`.
        source: Type of the value in the file; None for the annotated type.
    """

    make: Callable[[Any, Any], Any]
    source: Any = None

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Return the pydantic schema of the file's value, followed by the conversion to the annotated type."""
        from pydantic_core import core_schema as core

        schema = handler(source) if self.source is None else handler.generate_schema(self.source)
        return core.with_info_after_validator_function(lambda found, info: self.make(found, info.context), schema)


@dataclass(frozen=True)
class Kinds:
    """Annotation of a union of table classes.

    Attributes:
        tell: Function that returns the class of a table, given the table's keys and values.
    """

    tell: Callable[[Mapping[str, Any]], Any]

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        """Return the pydantic schema of the union ``source``, in which ``tell`` selects a table's class.

        The tag of a class in the schema is its name in angle brackets.
        """
        from pydantic_core import core_schema as core

        kinds = {f"<{kind.__name__}>": handler.generate_schema(kind) for kind in get_args(source)}
        return core.tagged_union_schema(
            kinds, lambda value: f"<{self.tell(value if isinstance(value, Mapping) else {}).__name__}>"
        )


@dataclass(frozen=True)
class Key:
    """Annotation of a field whose key differs from its name and unit, or which is in a section of the file.

    Attributes:
        name: Key in the file; empty for the field's name and unit.
        section: Name of the section (table) that has the key; empty for the top level.
    """

    name: str = ""
    section: str = ""


GRAVITY = 9.80665
"""Standard acceleration of gravity, m/s^2 (ISO 80000-3)."""

NUMBER, WHOLE = Unit(), Unit(whole=True)
SHARE = NUMBER.within(0.0, 1.0)
MM, UM, M = Unit("mm", 1e-3, most=1e5), Unit("um", 1e-6, most=1e8), Unit("m", most=100.0)
DEG, RAD = Unit("deg", math.pi / 180.0, most=3600.0), Unit("rad", most=20.0 * math.pi)
ARCMIN = Unit("arcmin", math.radians(1 / 60), most=2.16e5)
ARCSEC = Unit("arcsec", math.radians(1 / 3600), most=1.296e7)
MM_PER_S, DEG_PER_S = Unit("mm_per_s", 1e-3, most=1e5), Unit("deg_per_s", math.pi / 180.0, most=36000.0)
M_PER_S, RAD_PER_S = Unit("m_per_s", most=100.0), Unit("rad_per_s", most=200.0 * math.pi)
KG, KG_PER_M, KELVIN = Unit("kg", most=1e4), Unit("kg_per_m", most=1e4), Unit("K", most=1e3)
NEWTON, NEWTON_METRE = Unit("N", most=1e7), Unit("N_m", most=1e7)
SECONDS, MILLISECONDS, HOURS = Unit("s"), Unit("ms", 1e-3), Unit("h", 3600.0)
PX, WHOLE_PX, LX = Unit("px"), Unit("px", whole=True), Unit("lx")

TO_SI = {unit.name: unit.scale for unit in (DEG, RAD, MM, M)}
"""SI units per unit of a joint or a coordinate, by the unit's name."""


def afterwards(test: Callable[[Any], bool], wanted: str) -> Then:
    """Return an annotation that tests a field's value in SI units, after conversion; `Check` tests it before.

    Args:
        test: Function that returns whether the value is valid.
        wanted: What the user should give if the test fails.
    """
    return Then(lambda value, _: Check(test, wanted).checked(value))


ONCE = afterwards(lambda values: 0 < len(set(values)) == len(values), "a list of at least one entry, each entry once")
"""Annotation of a list that is not empty and has no entry twice."""

IN_ORDER = afterwards(lambda ends: ends[0] <= ends[1], "the lower number first")
"""Annotation of a range (two numbers, which may be equal) with the lower number first."""

LINE = Check(lambda value: isinstance(value, str) and value.isprintable(), "a text of one line")

REQUIRED = "required"
"""Annotation of a field that a file must give although its class has a default."""

FILLED_IN = ("name", "source")
"""Fields that a file may leave out although their class has no default."""


@dataclass_transform(frozen_default=True)
def toml_table(kind: Class) -> Class:
    """Make a class a frozen dataclass that `read_toml` reads from a TOML table.

    The table may have only the keys of the class's fields. It must have the keys of all fields without a default,
    except the fields in `FILLED_IN`.
    """
    table: Any = kind if "__dataclass_fields__" in vars(kind) else dataclass(frozen=True)(kind)
    table.__pydantic_config__ = {"alias_generator": lambda name: _keys(table)[name][0], "extra": "forbid"}
    table.__get_pydantic_core_schema__ = staticmethod(_schema)
    table.__get_pydantic_json_schema__ = staticmethod(partial(_json, table))
    return cast(Class, table)


def _schema(kind: Any, handler: Any) -> Any:
    """Return the pydantic schema of a table class ``kind``.

    It reports unknown keys first, then wrong values, then missing keys.
    """
    from pydantic import ValidationError
    from pydantic_core import core_schema as core

    def check(value: Any, inner: Any) -> Any:
        if not isinstance(value, Mapping):
            raise fault("a table", "no table")
        keys, thing = dict(_keys(kind).values()), None
        if unknown := [key for key in value if key not in keys]:
            raise fault("", "unknown", key=str(unknown[0]), known=sorted(keys))
        try:
            thing = inner(value)
        except ValidationError as error:
            if not all(_lacks(fault_of_key) for fault_of_key in error.errors(include_url=False)):
                raise
        if absent := [key for key, advice in keys.items() if advice and key not in value]:
            raise fault(keys[absent[0]], "missing", key=absent[0])
        return thing

    return core.no_info_wrap_validator_function(check, handler(kind))


def _json(kind: Any, schema: Any, handler: Any) -> Any:
    """Return the JSON schema of a table class ``kind`` from its pydantic schema, with the table's required keys.

    Defaults are left out, because they are in SI units, not in the file's units.
    """
    reference = handler(schema)
    table = handler.resolve_ref_schema(reference)
    table["required"] = [key for key, advice in _keys(kind).values() if advice]
    for part in table["properties"].values():
        part.pop("default", None)
        part.pop("title", None)
    return reference


def _marks(hint: Any) -> Iterator[Any]:
    """Yield the annotations of a type hint, of its members if it is a union, and of the ``source`` of each `Then`."""
    for part in (hint, *get_args(hint)):
        for mark in getattr(part, "__metadata__", ()):
            yield from (mark, *(_marks(mark.source) if isinstance(mark, Then) else ()))


@cache
def units_of(kind: Any) -> dict[str, Unit]:
    """Return the units of a table class by the names of its fields; fields without a `Unit` are left out."""
    hints = get_type_hints(kind, include_extras=True)
    return {name: mark for name, hint in hints.items() for mark in _marks(hint) if isinstance(mark, Unit)}


@cache
def _keys(kind: Any) -> dict[str, tuple[str, str]]:
    """Return for each field of a table class its key in the file, and advice for the message if the key is missing.

    The advice says what to give; it is empty if the key may be missing.
    """
    keys, hints = {}, get_type_hints(kind, include_extras=True)
    for part in fields(kind):
        marks = list(_marks(hints[part.name]))
        unit = units_of(kind).get(part.name, NUMBER).name
        plain = f"{part.name}_{unit}" if unit else part.name
        key = next((mark.name for mark in marks if isinstance(mark, Key) and mark.name), plain)
        usual = "this table" if is_dataclass(hints[part.name]) else "it"
        advice = next((mark.wanted for mark in marks if isinstance(mark, Unit | Check)), usual)
        optional = part.name in FILLED_IN or part.default is not MISSING or part.default_factory is not MISSING
        keys[part.name] = (key, "" if optional and REQUIRED not in marks else advice)
    return keys


@cache
def _file_of(kind: Any) -> Any:
    """Return the type of a file from which the class ``kind`` is read; its fields may be in sections (`Key`)."""
    groups: dict[str, list[Any]] = {}
    for attribute in fields(kind) if is_dataclass(kind) else ():
        hint = get_type_hints(kind, include_extras=True)[attribute.name]
        section = next((mark.section for mark in _marks(hint) if isinstance(mark, Key)), "")
        default = field(default=attribute.default, default_factory=attribute.default_factory, kw_only=True)
        groups.setdefault(section, []).append((attribute.name, hint, default))
    if set(groups) <= {""}:
        return kind
    members_of_file = groups.pop("", [])
    for section, members in groups.items():
        part = toml_table(make_dataclass(section, members, frozen=True))
        factory: Any = MISSING if any(advice for _, advice in _keys(part).values()) else part
        members_of_file.append((section, part, field(default_factory=factory, kw_only=True)))

    names = {attribute.name for attribute in fields(kind)}
    if "source" not in names:  # every file may say where its numbers come from
        members_of_file.append(("source", str, field(default="", kw_only=True)))

    def flat(found: Any, _context: Any) -> Any:
        values = {name: value for name, value in vars(found).items() if name in names - groups.keys()}
        values |= {name: value for section in groups for name, value in vars(getattr(found, section)).items()}
        return kind(**values)

    return Annotated[kind, Then(flat, toml_table(make_dataclass("File", members_of_file, frozen=True)))]


@cache
def _adapter(kind: Any) -> Any:
    from pydantic import TypeAdapter

    return TypeAdapter(_file_of(kind))


def json_schema(kind: Any) -> dict[str, Any]:
    """Return the JSON schema, for editors, of the files from which objects of the class ``kind`` are read."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_adapter(kind).json_schema()}


def read_toml(kind: type[Thing], path: str | Path, *, section: str = "", context: Any = None) -> Thing:
    """Read and check a TOML file, and make the object of class ``kind`` from it.

    Args:
        kind: A class made by `toml_table`.
        path: The file. Its stem is the object's ``name`` if the file gives none.
        section: The table of the file to read; "" for the whole file.
        context: Any object; the conversions of fields (`Then.make`) get it as their second argument.

    Raises:
        InputError: If the file cannot be read, a key is unknown or missing, or a value fails its check.
    """
    content, text = toml_of(path)
    if section not in content and section:
        raise InputError(f"{path}: section [{section}] is missing")
    return made(kind, content, str(path), text=text, section=section, context=context)


def shipped_in(folder: Path) -> list[str]:
    """Return the names (stems) of the TOML files in a folder that comes with pickenv, sorted."""
    return sorted(path.stem for path in folder.glob("*.toml"))


def file_named(kind: str, name: str | Path, folder: Path, endings: str = ".toml") -> Path:
    """Return the path of a TOML file, given the name of a shipped file or a path.

    Args:
        kind: What the file describes, for messages: "arm".
        name: Name of a shipped file without its suffix, or a path ending in .toml.
        folder: Folder of the shipped files.
        endings: Endings of the files that a path may name, as the error message lists them: ".toml, .npz".

    Raises:
        InputError: If there is no such file.
    """
    is_path = Path(name).suffix == ".toml"
    path = Path(name) if is_path else folder / f"{name}.toml"
    if is_file(path):
        return path
    fault = f"{kind} file {shortened(path, 300)} does not exist" if is_path else f"unknown {kind} '{shortened(name)}'"
    raise InputError(f"{fault}; give one of {shipped_in(folder)} or a path to a file ({endings})")


def toml_of(path: str | Path) -> tuple[dict[str, Any], str]:
    """Return the content of a TOML file, unchecked, and its text.

    Raises:
        InputError: If the file cannot be read or is not valid TOML. The message says why.
    """
    text = read_text(path, "a TOML file")
    return parsed(lambda: _without_huge(tomllib.loads(text), ""), path, "TOML"), text


def _without_huge(value: Any, key: str) -> Any:
    """Return ``value``; raise a ValueError that names ``key`` if an integer in it has more than TOML's 64 bits.

    Python reads such integers, but later arithmetic with them fails.
    """
    for part in value if isinstance(value, list) else ():
        _without_huge(part, key)
    for name, part in value.items() if isinstance(value, dict) else ():
        _without_huge(part, name)
    if isinstance(value, int) and not -INTEGERS <= value < INTEGERS:
        raise ValueError(f"{key} is an integer of more than 64 bits")
    return value


def made(
    kind: type[Thing],
    content: Mapping[str, Any],
    where: str,
    *,
    text: str = "",
    name: str = "",
    section: str = "",
    context: Any = None,
) -> Thing:
    """Check a file's content, and make the object of class ``kind`` from it.

    Args:
        kind: A class made by `toml_table`.
        content: The content, as `tomllib` gives it.
        where: The file, for messages.
        text: The file's text, so that messages can name lines.
        name: The object's name if it is not the stem of the file; "" otherwise.
        section: The key of the content to use; "" for the whole content.
        context: Any object; the conversions of fields (`Then.make`) get it as their second argument.

    Raises:
        InputError: If a key is unknown or missing, or a value fails its check.
    """
    from pydantic import ValidationError

    table = content[section] if section else content
    if isinstance(table, Mapping):
        filled = {"name": name or Path(where).stem, "source": ""}
        table = {**{key: filled[key] for key in FILLED_IN if key in _keys(cast(Any, kind))}, **table}
    try:
        return cast(Thing, _adapter(cast(Any, kind)).validate_python(table, context=context))
    except ValidationError as error:
        first: Any = min(error.errors(include_url=False), key=_lacks)
        first["loc"] = [*([section] if section else []), *first["loc"]]
        raise InputError(_sentence(first, content, where, text, name and repr(name))) from error


# The sentence that says what is wrong: file, line, key, table, value and what to give.


def _lacks(error: Any) -> bool:
    """Return whether one of pydantic's errors is about a missing key; pickenv reports missing keys itself."""
    return error["type"] == "missing" and "ctx" not in error


WORDS = {"literal_error": "give {expected}", "string_type": "give a text", "tuple_type": "give a list"}
"""What a message tells the user to give, by the type of pydantic's own error."""


def _sentence(error: Mapping[str, Any], content: Any, where: str, text: str, owner: str) -> str:
    """Return the message for one of pydantic's errors: file, line and what is wrong.

    Args:
        error: The error as pydantic gives it; parts of its ``loc`` in angle brackets are tags of unions.
        content: The content of the file.
        where: The file.
        text: The file's text, so that the message can name the line; empty for no line.
        owner: Name of the object that the file describes; empty for none.
    """
    place = [part for part in error["loc"] if not str(part).startswith("<")]
    key = error.get("ctx", {}).get("key") if error["type"] == "unknown" else None
    line = line_of(text, place if key is None else [*place, key])
    return f"{where}{f', line {line}' if line else ''}: {_fault(error, place, content, owner)}"


def _fault(error: Mapping[str, Any], place: list[Any], content: Any, owner: str) -> str:
    """Return what is wrong with a value, without the file: the key, its table, the value, and what to give instead.

    Args:
        error: The error as pydantic reports it.
        place: Keys of tables and indices in lists (from 0) that lead to the value.
        content: The whole file, as TOML gives it.
        owner: Name of what the file describes, for keys outside of tables.
    """
    details, kind = error.get("ctx", {}), error["type"]
    inside = _table_at(place, content) or owner
    match kind:
        case "value_error":  # a dataclass or a reader said it in a sentence of its own
            return str(details["error"])
        case "no table":
            return f"{inside or shortened(place[-1])} must be a table"
        case "unknown":
            return unknown("key", details["key"], details["known"], f" in {inside}" if inside else "")
        case "missing":
            return f"{details['key']}{f' of {inside}' if inside else ''} is missing; {details['wanted']}"
    depth = max(i for i, part in enumerate(place) if isinstance(part, str))
    key = str(place[depth]) + "".join(f"[{part}]" for part in place[depth + 1 :])
    inside, value = _table_at(place[:depth], content) or owner, error["input"]
    brief = f"{value:g}" if isinstance(value, float) and float(f"{value:g}") == value else repr(value)
    advice = WORDS[kind].format(**details) if kind in WORDS else error["msg"]
    return f"{key}{f' of {inside}' if inside else ''} is {shortened(brief)}; {advice}"


def _table_at(place: list[Any], content: Any) -> str:
    """Return the name, in messages, of the table at ``place`` in a file: "[load]", "entry 2 of [backlash.joints]".

    ``place`` is the list of keys and list indices (from 0) that lead to the table. Entries in messages count from 1.
    The name is empty for the whole file.
    """
    names = ".".join(part for part in place if isinstance(part, str))
    if not place or isinstance(place[-1], str):
        return f"[{names}]" * bool(place)
    number = _at(content, place).get("number") if isinstance(_at(content, place), Mapping) else None
    if isinstance(number, int) and len(place) == 2:
        return f"{names.removesuffix('s')} {number}"
    return f"entry {place[-1] + 1} of [{names}]"


def _at(content: Any, place: list[Any]) -> Any:
    """Return the value to which the keys and list indices in ``place`` lead, in a file's content, or None."""
    with suppress(LookupError, TypeError):
        return reduce(getitem, place, content)
    return None


CLOSING = ("", "]", "]]", "]]]", '"""', "'''")
"""Endings that are tried to complete a value that is still open at the end of a line."""

MOST_READ = 1_000_000
"""Largest number of characters that are parsed to find a line. Beyond it, a message names the key without a line."""


def line_of(text: str, place: list[Any]) -> int | None:
    """Return the line, from 1, at which the value at ``place`` of a valid TOML file begins, or None.

    If the file has no such value, the line of the table that would hold it is returned. The last key of ``place`` may
    stand in several lines. The text up to each of them is parsed in turn, after closing its open brackets and quotes.
    The first line whose parsed text has the value is returned, or None after `MOST_READ` characters.

    Args:
        text: The file's text.
        place: Keys of tables and indices in lists (from 0) that lead to the value.
    """
    while place and _at(tomllib.loads(text), place) is None:
        place = place[:-1]
    depth = max((i for i, part in enumerate(place) if isinstance(part, str)), default=-1)
    lines, reached, budget = text.split("\n") if place else [], False, MOST_READ
    for number, line in enumerate(lines, 1):
        names_key = place[depth] in line and not line.lstrip().startswith("#")
        reached = reached or names_key
        if names_key or (reached and depth < len(place) - 1):
            for closing in CLOSING:
                read = "\n".join([*lines[:number], closing])
                budget -= len(read)
                if budget < 0:
                    return None
                if _at(_parsed(read), place) is not None:
                    return number
    return None


def _parsed(text: str) -> Any:
    with suppress(tomllib.TOMLDecodeError):
        return tomllib.loads(text)
    return None
