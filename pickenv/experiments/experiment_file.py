"""Read experiments from TOML files: units to draw, factors to compare, a measuring function, and numbers to estimate.

An example:

title = "What least squares leave"
measure = "gains.py:left"                 # a function of a file beside this one, or of an installed "package:function"
seed = 0
quick = { arm = 10 }

[units]
arm = 64                                  # 0 to 63; or a list

[factors]
method = ["raw", "ls"]

[[estimate]]
title = "Mean error (mm)"
value = "error_mm"
by = ["method"]
over = ["arm"]
"""

from __future__ import annotations

import inspect
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass
from functools import partial
from importlib import import_module, invalidate_caches, metadata
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from pickenv.agents.policies.foreign import faults_in
from pickenv.base import WHOLE, Check, Estimate, InputError, Unit, estimate, file_sha256, listed, toml_of, toml_table
from pickenv.base.intervals import LEAST
from pickenv.base.toml_tables import made
from pickenv.experiments.engine import Experiment, Rows, pivot
from pickenv.inspect.colours import said

WORD = Check(lambda value: isinstance(value, str) and value != "", "a text")
NAMES = Check(
    lambda value: isinstance(value, list) and all(isinstance(name, str) for name in value), "a list of names of columns"
)
TABLE = Check(lambda value: isinstance(value, dict), "a table of names and values")
A_LIST = "a list of texts, numbers or truth values, at least one"
ONE_LEVEL = f"{A_LIST}, or a whole number above zero for 0, 1, … below it"
LEVELS = Check(
    lambda value: isinstance(value, dict) and all(map(_are_levels, value.values())),
    f"a table of names, each with {ONE_LEVEL}",
)
LISTS = Check(
    lambda value: isinstance(value, dict) and all(_are_levels(levels, False) for levels in value.values()),
    f"a table of names, each with {A_LIST}",
)
STATISTICS = ("mean", "share", "ratio", "removed")
STATISTIC = Check(
    lambda value: value in STATISTICS or _is_named(value) or (isinstance(value, float) and 0.0 < value < 1.0),
    f'one of {", ".join(STATISTICS)}, a probability for that quantile over units, or "file.py:function" of their means',
)


def _are_levels(value: Any, counted: bool = True) -> bool:
    """Return whether a value is a list of levels, or, if ``counted``, a positive number of levels."""
    if isinstance(value, list):
        return bool(value) and all(isinstance(level, str | int | float) for level in value)
    return counted and isinstance(value, int) and not isinstance(value, bool) and value > 0


def _is_named(value: Any) -> bool:
    return isinstance(value, str) and len(value.split(":")) == 2


LEAST_DRAWS = 39
"""Smallest number of draws of a design's constants for an interval. The range of 39 draws contains one further draw
with probability 95 %."""

FUNCTION = Check(_is_named, '"file.py:function" or "package.module:function"')


@toml_table
class Number:
    """One table of numbers, each with its interval.

    Attributes:
        title: Title above the table, with the unit.
        value: Column that the numbers are estimated from; a list of columns if the statistic needs several.
        by: Columns that identify a number; each combination of their values has one number.
        over: One or two columns of units; the intervals are over these units.
        of: Statistic to estimate: "mean", "share", "ratio", "removed" (relative reduction of the mean), a probability
            for its quantile over units, or "file.py:function" for a function of the units' means
            (`pickenv.base.intervals.estimate`).
        against: Reference value of one or several columns of ``by``. Each number then compares the rows at another
            value with the rows at the reference, pair by pair.
        where: Values, by column, that select the rows to use; None uses all rows.
        across: Column of ``by`` whose levels become columns of the table; None gives every level its own line.
        margin: If given, a verdict follows each number. The verdict of a difference whose whole interval lies within
            plus or minus this margin is "carries over".
        least: A mean of fewer units than this has no interval. A small number is enough if each unit is a run whose
            mean is nearly normal.
        lost: Limit above which a value counts as lost. The mean leaves lost values out; the share of lost values is
            printed beside the mean.
        draws: Unit whose level 0 is the design with its shipped constants, and whose other levels are draws of these
            constants (`pickenv.arm.plant.plant_file.with_drawn_constants`). The interval of a number then contains the
            number of one further draw with probability 95 %. At least `LEAST_DRAWS` draws are needed.
        spread: Whether the standard deviation and the range of the units' means are shown beside each number. The
            option needs a single column ``value``, no ``across``, and a statistic other than "removed".
        digits: Digits after the point.
        scale: Factor on the printed numbers, such as 100 for percent.
        figure: Name of the table's figure; None for no figure.
        x: Column of ``by`` on the x axis of the figure, which then has lines; None for whiskers.
        panels: Column of ``by``; each of its levels has a panel of the figure.
        log: Whether the figure's axis of numbers is logarithmic.
    """

    _: KW_ONLY
    title: Annotated[str, WORD]
    value: Annotated[Any, Check(lambda value: isinstance(value, str | list), "a column, or a list of columns")]
    by: Annotated[tuple[str, ...], NAMES] = ()
    over: Annotated[tuple[str, ...], NAMES]
    of: Annotated[Any, STATISTIC] = "mean"
    against: Annotated[dict[str, Any], TABLE] | None = None
    where: Annotated[dict[str, Any], TABLE] | None = None
    across: Annotated[str, WORD] | None = None
    least: Annotated[int, WHOLE.at_least(2)] = LEAST
    lost: float | None = None
    draws: Annotated[str, WORD] | None = None
    spread: bool = False
    margin: Annotated[float, Unit().positive] | None = None
    digits: Annotated[int, WHOLE.within(0, 9)] = 2
    scale: float = 1.0
    figure: Annotated[str, WORD] | None = None
    x: Annotated[str, WORD] | None = None
    panels: Annotated[str, WORD] | None = None
    log: bool = False


@toml_table
class _File:
    """The keys that an experiment's file may have, with the checks of their values."""

    _: KW_ONLY
    title: Annotated[str, WORD]
    measure: Annotated[str, FUNCTION]
    seed: Annotated[int, WHOLE.not_negative] = 0
    units: Annotated[dict[str, Any], LEVELS]
    factors: Annotated[dict[str, Any], LISTS] | None = None
    settings: Annotated[dict[str, Any], TABLE] | None = None
    quick: Annotated[dict[str, Any], TABLE] | None = None
    fits: Annotated[str, FUNCTION] | None = None
    estimate: tuple[Number, ...] = ()
    figures: Annotated[dict[str, str], TABLE] | None = None


@dataclass(frozen=True)
class ExperimentFile:
    """An experiment that was read from a file.

    Attributes:
        path: The file.
        title: The question that the experiment asks.
        experiment: The experiment.
        numbers: The tables of numbers to estimate from the experiment's rows.
        functions: The functions that the file names, by the text that names them ("file.py:function").
        figures: The functions that draw the rows, by the names of their figures.
    """

    path: Path
    title: str
    experiment: Experiment
    numbers: tuple[Number, ...]
    functions: Mapping[str, Callable[..., Any]]
    figures: Mapping[str, Callable[[Rows], Any]]

    def estimates(self, rows: Rows) -> list[dict[str, Any]]:
        """Estimate the tables of numbers from the experiment's rows.

        Returns:
            For each of ``numbers`` a dict with "title" and "rows". Each of these rows is a dict of levels by name,
            "estimate", and the further keys that `pickenv.base.intervals.estimate` gives.

        Raises:
            InputError: If a table names a column that the rows lack, or a comparison needs pairs of rows that do not
                match.
        """
        tables = []
        for number in self.numbers:
            of = self.functions.get(number.of, number.of) if isinstance(number.of, str) else number.of
            levels = {n: tuple(v) if isinstance(v, list) else v for n, v in (number.where or {}).items()}
            try:
                some = rows.where(**levels)
                asked = (number.value, number.by, number.over, of, number.against, number.least, number.lost)
                shipped = some if number.draws is None else some.where(**{number.draws: 0})
                made_of = estimate(shipped.columns, *asked)
                if number.draws is not None:
                    _widen(made_of, some, number.draws, asked)
            except KeyError as error:
                columns = listed(rows.columns)
                raise InputError(f"{self.path}: no column {error} for '{number.title}'; there are {columns}") from error
            except ValueError as error:
                raise InputError(f"{self.path}: '{number.title}': {error}") from error
            tables.append({"title": number.title, "rows": made_of})
        return tables


def _widen(rows: list[dict[str, Any]], measured: Rows, draws: str, asked: tuple[Any, ...]) -> None:
    """Replace intervals over units by intervals over draws of constants, in place; "sampled" keeps the old estimate.

    The range of K numbers contains one further number with probability (K - 1) / (K + 1), for any distribution.

    Args:
        rows: Estimates for the shipped constants, from `estimate`. These rows are changed.
        measured: The rows of the experiment.
        draws: Column with the index of the draw of constants; 0 is for the shipped constants.
        asked: The further arguments of `estimate`, after the columns, with which ``rows`` were estimated.
    """
    drawn: dict[tuple[Any, ...], list[float]] = {}
    for (draw,) in measured.levels(draws):
        for row in estimate(measured.where(**{draws: draw}).columns, *asked) if draw else ():
            drawn.setdefault(_levels_of(row), []).append(row["estimate"].value)
    for row in rows:
        own: Estimate = row["estimate"]
        if found := drawn.get(_levels_of(row)):
            ends = (min(found), max(found)) if len(found) >= LEAST_DRAWS else None
            missing = "" if ends else f"{len(found)} draws of constants are fewer than {LEAST_DRAWS}"
            row |= {"estimate": Estimate(own.value, ends, missing), "sampled": own}


def load_experiment(
    path: str | Path, *, quick: bool = False, seed: int | None = None, changes: Mapping[str, Any] | None = None
) -> ExperimentFile:
    """Read an experiment from a file; the Python code that the file names is executed.

    Args:
        path: The file (.toml).
        quick: Whether to replace units, factors and settings by the values in the file's table ``quick``.
        seed: Seed in place of the one in the file; None keeps the file's seed.
        changes: New values of units, factors and settings, by name, in place of the file's values.

    Raises:
        InputError: If the file is missing, or a key is unknown or its value refused; the message names file, line and
            key.
    """
    path = Path(path)
    content, text = toml_of(path)
    keys = made(_File, content, str(path), text=text)
    parts = {"units": keys.units, "factors": keys.factors or {}, "settings": keys.settings or {}}
    if quick and not keys.quick:
        raise InputError(f"{path} has no smaller sizes; leave `quick` out, or give the file a table quick")
    for name, value in {**((keys.quick or {}) if quick else {}), **(changes or {})}.items():
        part = next((part for part in parts.values() if name in part), None)
        if part is None:
            names = listed(name for part in parts.values() for name in part)
            raise InputError(f"{path} has no unit, factor or setting '{name}'; known are {names}")
        is_unit = part is parts["units"]
        if part is not parts["settings"] and not _are_levels(value, is_unit):
            raise InputError(f"{path}: {name} is {value!r}; give {ONE_LEVEL if is_unit else A_LIST}")
        part[name] = value
    if twice := [name for name in parts["units"] if name in parts["factors"] or name in parts["settings"]]:
        raise InputError(f"{path}: '{twice[0]}' is a unit and something else as well; give one of them another name")
    for number in keys.estimate:
        if reserved := [name for name in number.by if name in RESERVED]:
            raise InputError(
                f"{path}: '{reserved[0]}' in by of '{number.title}' is what results are called; rename the column"
            )
        for key in ("across", "x", "panels"):
            if (column := getattr(number, key)) not in (None, *number.by):
                by = listed(number.by)
                raise InputError(f"{path}: {key} of '{number.title}' is '{column}'; give one of its by: {by}")
        for key in ("x", "panels", "log"):
            if getattr(number, key) and number.figure is None:
                raise InputError(f"{path}: {key} of '{number.title}' is of its figure; give figure a name with it")
        several = isinstance(number.value, list) and len(number.value) > 1
        if number.spread and (several or number.of == "removed" or number.across is not None):
            raise InputError(
                f"{path}: spread of '{number.title}' is of one column's means, each in a line of its own; leave it "
                "out, or across, further columns and removed"
            )
    words = [keys.measure, keys.fits, *(keys.figures or {}).values()]
    words += [number.of for number in keys.estimate if _is_named(number.of)]
    functions = {word: _function(path, word) for word in words if word is not None}
    measure = functions[keys.measure]
    taken = inspect.signature(measure).parameters
    seed = keys.seed if seed is None else seed
    if "seed" in taken and not any("seed" in part for part in parts.values()):
        parts["settings"]["seed"] = seed
    for name in ("rng", *parts["units"], *parts["factors"], *parts["settings"]):
        if name not in taken and not any(parameter.kind is parameter.VAR_KEYWORD for parameter in taken.values()):
            raise InputError(f"{path}: {keys.measure} takes no argument '{name}'; it takes {listed(taken)}")
    experiment = Experiment(
        path.stem,
        {name: _levels(value) for name, value in parts["units"].items()},
        {name: _levels(value) for name, value in parts["factors"].items()},
        partial(_measured, keys.measure, measure, parts["settings"]),
        seed,
        (keys.measure, parts["settings"], [_origin(functions[word]) for word in sorted(functions)]),
        None if keys.fits is None else functions[keys.fits],
    )
    figures = {name: functions[word] for name, word in (keys.figures or {}).items()}
    return ExperimentFile(path, keys.title, experiment, keys.estimate, functions, figures)


def _measured(word: str, measure: Callable[..., Any], settings: Mapping[str, Any], **levels: Any) -> Rows:
    """Return the rows that a user's function measures; errors in the function are reported with file, line and levels.

    Args:
        word: Name of the function in the experiment's file, for messages.
        measure: The function. It is called with all of ``settings`` and ``levels`` by name.
        settings: Settings of the experiment, by name.
        levels: The generator "rng", and one level of each unit and factor, by name.
    """
    levels_in_words = ", ".join(f"{name}={level!r}" for name, level in levels.items() if name != "rng")
    with faults_in(Path(inspect.getsourcefile(measure) or word), f"function, or leave out {levels_in_words}"):
        return Rows.of(measure(**levels, **settings))


def _levels(value: int | Sequence[Any]) -> Sequence[Any]:
    return range(value) if isinstance(value, int) else list(value)


def _function(path: Path, word: str) -> Callable[..., Any]:
    """Return the function that ``word`` names: "file.py:function" or "package.module:function".

    A "file.py" is in the folder of ``path``, the experiment's file.
    """
    place, name = word.split(":")
    try:
        if place.endswith(".py"):
            with faults_in((path.parent / place).resolve(), "file"):
                module = _beside(path.parent / place)
        else:
            module = import_module(place)
        function = getattr(module, name)
    except (ImportError, OSError, AttributeError) as error:
        raise InputError(f"{path} names '{word}', which cannot be loaded: {error}; give {FUNCTION.wanted}") from error
    if not callable(function):
        raise InputError(f"{path} names '{word}', which is no function; give {FUNCTION.wanted}")
    return function  # type: ignore[no-any-return]


def _beside(file: Path) -> Any:
    """Import a module that lies beside an experiment's file, and let worker processes find it too."""
    folder = str(file.parent.resolve())
    if folder not in sys.path:
        sys.path.insert(0, folder)
        os.environ["PYTHONPATH"] = os.pathsep.join([folder, *filter(None, [os.environ.get("PYTHONPATH")])])
    invalidate_caches()  # the file may be younger than what Python remembers of its folder
    module = import_module(file.stem)
    if Path(str(module.__file__)).resolve() != file.resolve():
        raise ImportError(f"a module of the name {file.stem} is loaded from elsewhere; rename {file.name}")
    return module


def _origin(function: Callable[..., Any]) -> str:
    """Return a text that identifies a function's code: its package's version, and the SHA-256 of its file."""
    place = inspect.getsourcefile(inspect.unwrap(function))
    package = function.__module__.partition(".")[0]
    try:
        version = metadata.version(package)
    except metadata.PackageNotFoundError:
        version = ""
    return f"{version} {'' if place is None else file_sha256(Path(place))}"


MADE = ("estimate", "units", "runs", "lost", "sampled")
"""Keys of a row of estimates that are not names of levels."""

RESERVED = (*MADE, "value", "ci95", "no_interval", "lost_ci95", "sampled95", "std", "range")
"""Keys of a row of estimates, here and in JSON. Columns of ``by`` must not have these names."""


def plain_estimates(tables: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return the tables of `ExperimentFile.estimates` with plain values, for JSON.

    Each row has its levels, "value", the 95 % interval "ci95", and "no_interval", the reason why there is no interval.
    A row over several runs has "runs", the mean of each run. With several units, "std" and "range" are the
    standard deviation and the range of the units' means. If ``lost`` is set, "lost" is the share of lost values, and
    "lost_ci95" the interval of this share. If "ci95" is over draws of constants, "sampled95" is the interval over units
    for the shipped constants.
    """

    def plain(row: Mapping[str, Any]) -> dict[str, Any]:
        number, units = row["estimate"], row["units"]
        levels = {name: value for name, value in row.items() if name not in MADE}
        levels |= {"value": number.value, "ci95": number.ends, "no_interval": number.missing}
        if row["runs"] is not None and len(row["runs"]) > 1:
            levels |= {"runs": row["runs"].tolist()}
        if "sampled" in row:
            levels |= {"sampled95": row["sampled"].ends}
        if "lost" in row:
            levels |= {"lost": row["lost"].value, "lost_ci95": row["lost"].ends}
        if units is not None and len(units) > 1:
            levels |= {"std": float(units.std(ddof=1)), "range": [float(units.min()), float(units.max())]}
        return levels

    return [{"title": table["title"], "rows": [plain(row) for row in table["rows"]]} for table in tables]


def _levels_of(row: Mapping[str, Any]) -> tuple[Any, ...]:
    return tuple(value for name, value in row.items() if name not in MADE)


def number_table(number: Number, rows: Sequence[Mapping[str, Any]]) -> tuple[list[str], list[list[str]]]:
    """Return the column heads and the lines of cells of one table of numbers, as text.

    Args:
        number: The definition of the table. Each value of its column ``across`` becomes a column of the table.
        rows: The rows of the table, from `ExperimentFile.estimates`.
    """
    sign = "+" if number.against and number.of != "removed" else ""
    form = f"{sign}.{number.digits}f"

    def cell(row: Mapping[str, Any]) -> str:
        estimate: Estimate = row["estimate"]
        text = said(estimate.value, estimate.ci95, number.digits, number.scale, sign)
        if row["runs"] is not None and len(row["runs"]) > 1:  # five of which one fails have a mean that says little
            least, middle, most = (f"{number.scale * value:{form}}" for value in np.quantile(row["runs"], (0, 0.5, 1)))
            text += f", runs {least}, {middle}, {most}"
        if "lost" in row:
            text += f", lost {said(row['lost'].value, row['lost'].ci95, 1, 100.0, unit=' %')}"
        if number.margin is None or estimate.ci95 is None:
            return text
        return f"{text}: {estimate.verdict(number.margin)}"

    names = [name for name in number.by if name != number.across]
    if number.across is None:
        heads, cells = [*names, "number (95 % interval)"], []
        for row in rows:
            cells.append([*(str(row[name]) for name in names), cell(row)])
            if number.spread and row["units"] is not None:
                of_units = number.scale * row["units"]
                deviation = of_units.std(ddof=1) if len(of_units) > 1 else 0.0
                cells[-1] += [f"{deviation:{form}}", f"{of_units.min():{form}} to {of_units.max():{form}}"]
        return [*heads, *(["standard deviation", "range"] if number.spread else [])], cells
    return pivot(rows, names, number.across, cell)
