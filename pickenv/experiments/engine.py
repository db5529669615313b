"""The one engine for experiments: units × factors → rows, kept piece by piece, computed anywhere.

An experiment measures each unit (an arm, a seed, a fold of a file) at every combination of its factors. A piece of work
is one such combination; it gives any number of rows. Everything that a piece draws comes from the seed and its unit
alone, so that two levels of a factor meet the same arms, fruit and noise, and no backend changes a number.

In a folder every piece is a Parquet file with a seal, named by the hash of all that its rows depend on: inputs, levels
and the code that makes numbers. A piece that is there is not computed again; `check_experiment` verifies all.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.files.arm import content_sha256
from pickenv.base import (
    Estimate as Estimate,
    InputError,
    check_sealed_parquet,
    code_fingerprint,
    estimate as estimate,
    locked,
    parquet_is_sealed,
    read_sealed_json,
    require,
    sealed_json,
    sealed_parquet,
    single_threaded,
    versions,
    write_text,
    write_whole,
)
from pickenv.base.files import LOCK
from pickenv.experiments.executors import spread

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

RECORD = "experiment.json"
"""File in a folder of pieces that lists them, with their keys and the versions that made them."""

AGAIN = "run the experiment again, which makes it anew"

Levels = Mapping[str, Any]
Columns = Mapping[str, NDArray[Any]]
Progress = Callable[[str, int, int], None]
"""Called with (name of the experiment, pieces done, pieces in all)."""

Refused = Callable[[Levels, InputError], None]


@dataclass(frozen=True)
class Rows:
    """Rows as columns: arrays whose first axes have one length.

    Attributes:
        columns: The columns by name, ``(N, ...)``.
    """

    columns: Columns

    def __len__(self) -> int:
        """How many rows there are."""
        return len(next(iter(self.columns.values()), ()))

    def __getitem__(self, name: str) -> NDArray[Any]:
        """A column by its name."""
        return self.columns[name]

    def where(self, **levels: Any) -> Rows:
        """The rows at the given levels of columns; a tuple of levels selects the rows at any of them."""
        taken = np.ones(len(self), dtype=np.bool_)
        for name, level in levels.items() if self.columns else ():
            taken &= np.isin(self.columns[name], level if isinstance(level, tuple) else (level,))
        return Rows({name: values[taken] for name, values in self.columns.items()})

    def levels(self, *names: str) -> list[tuple[Any, ...]]:
        """The different combinations of levels of these columns, in the order of their first rows."""
        columns = [self.columns[name].tolist() for name in names] if self.columns else []
        return list(dict.fromkeys(zip(*columns, strict=True)))

    def dicts(self) -> list[dict[str, Any]]:
        """The rows one by one, as plain values."""
        lists = {name: values.tolist() for name, values in self.columns.items()}
        return [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)]

    def pandas(self) -> pd.DataFrame:
        """The rows as a table of pandas; a column of arrays becomes one of lists."""
        import pandas as pd

        flat = {name: values if values.ndim == 1 else list(values) for name, values in self.columns.items()}
        return pd.DataFrame(flat)

    def arrow(self) -> pa.Table:
        """The rows as a table of pyarrow; a column of arrays becomes one of nested lists of fixed lengths."""
        import pyarrow as pa

        return pa.table({name: _arrow_of(values) for name, values in self.columns.items()})

    @staticmethod
    def of_arrow(table: pa.Table) -> Rows:
        """Rows from a table that `arrow` made."""
        return Rows({name: _array_of(table.column(name).combine_chunks()) for name in table.column_names})

    @staticmethod
    def of(rows: Columns | Rows | Sequence[Mapping[str, Any]]) -> Rows:
        """Make rows from columns, or from one mapping per row.

        Raises:
            ValueError: If columns differ in length, or rows in their names.
        """
        if isinstance(rows, Rows):
            return rows
        if not isinstance(rows, Mapping):
            names = list(rows[0]) if rows else []
            if any(list(row) != names for row in rows):
                raise ValueError("rows of one experiment have the same names in the same order")
            rows = {name: np.array([row[name] for row in rows]) for name in names}
        columns = {name: np.atleast_1d(values) for name, values in rows.items()}  # one number is one row
        if len({len(values) for values in columns.values()}) > 1:
            raise ValueError(f"columns {', '.join(columns)} differ in length")
        return Rows(columns)


def joined(parts: Sequence[Rows]) -> Rows:
    """All parts as one; where a part lacks a column or has shorter arrays, NaN or empty text fills the gap."""
    filled = [part for part in parts if len(part)]
    names = dict.fromkeys(name for part in filled for name in part.columns)
    return Rows({name: _stacked([part.columns.get(name) for part in filled], list(map(len, filled))) for name in names})


def _stacked(columns: Sequence[NDArray[Any] | None], lengths: Sequence[int]) -> NDArray[Any]:
    present = [values for values in columns if values is not None]
    shape = tuple(map(max, zip(*(values.shape[1:] for values in present), strict=True)))
    kind: Any = np.result_type(*present)
    kind, filler = (kind, "") if kind.kind == "U" else (float, np.nan)
    stacked = []
    for values, length in zip(columns, lengths, strict=True):
        if values is None or values.shape[1:] != shape:
            padded = np.full((length, *shape), filler, dtype=kind)
            if values is not None:
                padded[tuple(map(slice, values.shape))] = values
            values = padded
        stacked.append(values)
    return np.concatenate(stacked)


@dataclass(frozen=True)
class Experiment:
    """Units that are measured at every combination of factors.

    Attributes:
        name: Name in file names and messages.
        units: What is drawn, and what an interval is over: names and values, such as ``{"arm": range(64)}``.
        factors: What is compared: names and levels, such as ``{"method": ("raw", "ls")}``.
        measure: Called with ``rng`` and one level of each unit and factor by name; gives rows: columns, or a mapping
            for each row. ``rng`` is the unit's own, and the same at every level of the factors. For other processes to
            call it, it must be a function of a module, or a `functools.partial` of one.
        seed: Seed of everything random.
        inputs: What the rows depend on beside levels, seed and code: settings, plants, hashes of files; or a function
            of the levels that gives it.
        fits: Called with one level of each unit and factor by name; says whether to measure this
            combination. All are measured when it is left out.
    """

    name: str
    units: Mapping[str, Sequence[Any]]
    factors: Mapping[str, Sequence[Any]]
    measure: Callable[..., Columns | Rows | Sequence[Mapping[str, Any]]] = field(compare=False)
    seed: int = 0
    inputs: tuple[Any, ...] | Callable[..., tuple[Any, ...]] = ()
    fits: Callable[..., bool] | None = field(default=None, compare=False)

    def pieces(self) -> list[Piece]:
        """The pieces of work: factors vary slowest, in their order."""
        pieces = []
        for levels in product(*self.factors.values()):
            for places in product(*(range(len(values)) for values in self.units.values())):
                units = {name: self.units[name][at] for name, at in zip(self.units, places, strict=True)}
                piece = Piece(dict(zip(self.factors, levels, strict=True)) | units, places)
                if self.fits is None or self.fits(**piece.levels):
                    pieces.append(piece)
        return pieces

    def measured(self, piece: Piece) -> Rows:
        """The rows of one piece, with its levels in front."""
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=piece.place))
        with single_threaded():
            rows = Rows.of(self.measure(rng=rng, **piece.levels))
        levels = {name: np.full(len(rows), value) for name, value in piece.levels.items() if name not in rows.columns}
        return Rows(levels | dict(rows.columns))

    def key(self, piece: Piece) -> str:
        """The hash of all that a piece's rows depend on."""
        inputs = self.inputs(**piece.levels) if callable(self.inputs) else self.inputs
        return input_key(self.name, self.seed, inputs, dict(piece.levels), piece.place)


def input_key(*inputs: Any) -> str:
    """The hash of inputs and of the code that makes numbers; a result kept under this hash is not computed again."""
    return content_sha256(*inputs, code_fingerprint())


@dataclass(frozen=True)
class Piece:
    """One combination of units and factors.

    Attributes:
        levels: Level of each factor and unit by name.
        place: Numbers of its units, which seed the piece's random numbers.
    """

    levels: Levels
    place: tuple[int, ...]

    @property
    def label(self) -> str:
        """The levels as part of a file's name."""
        return re.sub(r"[^A-Za-z0-9.]+", "-", "_".join(str(level) for level in self.levels.values())).strip("-")[-80:]


def run(
    experiment: Experiment,
    folder: str | Path | None = None,
    *,
    backend: str = "serial",
    workers: int | None = None,
    progress: Progress | None = None,
    refused: Refused | None = None,
) -> Rows:
    """Measure the pieces that are not measured yet, and return all rows in the order of the pieces.

    A damaged file is made anew, with a warning.

    Args:
        experiment: What is measured.
        folder: Where pieces are kept for the next time; nowhere when None.
        backend: "serial", or "loky" (processes of this machine).
        workers: Processes; as many as there are cores when None.
        progress: Told how many pieces are done.
        refused: Told the levels of pieces that cannot be measured, and why; they have no rows, and are tried again by
            the next run. The first of them ends the run when None.

    Raises:
        InputError: If the backend is unknown or not installed, the folder is being worked in, processes keep dying, or
            a piece cannot be measured and ``refused`` is None.
    """
    if folder is not None:
        keep(experiment, folder, backend=backend, workers=workers, progress=progress, refused=refused)
        return kept_rows(folder)
    pieces = experiment.pieces()
    parts = dict(_computed(experiment, pieces, range(len(pieces)), backend, workers, progress, refused))
    return joined([parts[number] for number in sorted(parts)])


def keep(
    experiment: Experiment,
    folder: str | Path,
    *,
    backend: str = "serial",
    workers: int | None = None,
    progress: Progress | None = None,
    refused: Refused | None = None,
) -> list[Path]:
    """Measure the pieces that a folder lacks, and return the files of all pieces in order; arguments as for `run`.

    Rows pass through memory piece by piece; pyarrow reads the files as one data set of any size.
    """
    folder, pieces = Path(folder), experiment.pieces()
    require("pyarrow")
    with locked(folder):
        keys = [experiment.key(piece) for piece in pieces]
        names = [f"{experiment.name}_{piece.label}_{key[:16]}.parquet" for piece, key in zip(pieces, keys, strict=True)]
        _write_record(folder, dict(zip(names, keys, strict=True)))
        files, todo = [folder / name for name in names], []
        for number, (file, key) in enumerate(zip(files, keys, strict=True)):
            if file.is_file() and parquet_is_sealed(file.read_bytes()):
                piece_table(file, key)
                continue
            if file.is_file():
                warnings.warn(f"{file} is damaged and is made anew", stacklevel=2)
            todo.append(number)
        if progress is not None:
            progress(experiment.name, len(pieces) - len(todo), len(pieces))
        refusals = set(todo)
        for number, rows in _computed(experiment, pieces, todo, backend, workers, progress, refused):
            write_piece(files[number], rows, experiment.name, keys[number])
            refusals.remove(number)
        measured = [number for number in range(len(pieces)) if number not in refusals]
        if refusals:
            _write_record(folder, {names[number]: keys[number] for number in measured})
    return [files[number] for number in measured]


def _computed(
    experiment: Experiment,
    pieces: Sequence[Piece],
    todo: Sequence[int],
    backend: str,
    workers: int | None,
    progress: Progress | None,
    refused: Refused | None,
) -> Iterator[tuple[int, Rows]]:
    """Compute the pieces in ``todo``: yield the number and the rows of each, in any order; arguments as for `run`."""
    done = len(pieces) - len(todo)
    for number, rows in spread(partial(_measured, experiment, pieces, refused is None), todo, backend, workers):
        if isinstance(rows, Rows):
            yield number, rows
        elif refused is not None:
            refused(pieces[number].levels, rows)
        done += 1
        if progress is not None:
            progress(experiment.name, done, len(pieces))


def _measured(experiment: Experiment, pieces: Sequence[Piece], ends: bool, number: int) -> Rows | InputError:
    """The rows of a piece, or why it cannot be measured; that is raised where it ends the work."""
    try:
        return experiment.measured(pieces[number])
    except InputError as error:
        if ends:
            raise
        return error


# A folder of pieces.


def kept_rows(folder: str | Path) -> Rows:
    """The rows of an experiment's last run in this folder, each piece verified.

    Raises:
        InputError: If there is no such run, it is not complete, or a file is damaged or was edited.
    """
    return joined([Rows.of_arrow(table) for _, table in kept_tables(folder)])


def kept_tables(folder: str | Path) -> Iterator[tuple[Path, pa.Table]]:
    """The file and the table of each piece of an experiment's last run, verified; only one at a time is in memory.

    Raises:
        InputError: As `kept_rows`.
    """
    folder = Path(folder)
    record = _read_record(folder / RECORD)
    for name in record["last"]:
        yield folder / name, piece_table(folder / name, record["pieces"][name])


def _write_record(folder: Path, pieces: Mapping[str, str]) -> None:
    """Write the record of a folder: these pieces, and the pieces of earlier runs that are still in it."""
    path, before = folder / RECORD, dict[str, str]()
    try:
        before |= _read_record(path)["pieces"] if path.is_file() else {}
    except InputError:
        warnings.warn(f"{path} is damaged and is made anew", stacklevel=2)
    earlier = {name: key for name, key in before.items() if (folder / name).is_file()}
    record = {"format": 1, "pieces": {**earlier, **pieces}, "last": list(pieces), "versions": dict(versions("pyarrow"))}
    write_text(path, sealed_json(record))


def _read_record(path: Path) -> dict[str, Any]:
    return read_sealed_json(path, "the record of an experiment", AGAIN, "pieces", "last")


def write_piece(path: Path, rows: Rows, name: str, key: str) -> None:
    """Write rows as one sealed file, whole or not at all; `piece_table` needs the same key to read it."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = pa.BufferOutputStream()
    table = rows.arrow().replace_schema_metadata({"pickenv.key": key, "pickenv.experiment": name})
    pq.write_table(table, sink, compression="zstd")
    content = sealed_parquet(sink.getvalue().to_pybytes())
    write_whole(path, lambda temporary: temporary.write_bytes(content))


def piece_table(path: Path, key: str) -> pa.Table:
    """The rows of one piece as a table.

    Raises:
        InputError: If the file is missing or damaged, or is another piece than its name says.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path} is missing; {AGAIN}") from error
    check_sealed_parquet(content, path, AGAIN)
    # Not `read_table`: threads of its scanner may outlive the program, and then abort it.
    table = pq.ParquetFile(pa.BufferReader(content)).read(use_threads=False)
    key_in_file = (table.schema.metadata or {}).get(b"pickenv.key", b"").decode()
    if key_in_file != key:
        raise InputError(f"{path} holds another piece than its name says (key {key_in_file[:12]}); {AGAIN}")
    return table


def check_experiment(folder: str | Path) -> list[tuple[Path, str | None]]:
    """Verify a folder of pieces from end to end.

    Returns:
        The record, every piece that it names and every other file beside them: each with None, or the sentence that
        says why it is refused.
    """
    folder = Path(folder)
    record = folder / RECORD
    try:
        pieces = _read_record(record)["pieces"]
    except InputError as error:
        return [(record, str(error))]
    verdicts: list[tuple[Path, str | None]] = [(record, None)]
    files = {path.name for path in folder.iterdir()} - {RECORD, LOCK}
    for name in sorted({*pieces, *files}):
        path = folder / name
        if name in pieces:
            reason = refusal(piece_table, path, pieces[name])
        elif name.startswith("."):
            reason = f"{path} was left behind by an interrupted write; delete it"
        else:
            reason = f"{path} is no piece of this experiment; take it out of the folder"
        verdicts.append((path, reason))
    return verdicts


def refusal(read: Callable[..., object], *arguments: Any) -> str | None:
    """The sentence with which a reader refuses what it is given; None if it takes it."""
    try:
        read(*arguments)
    except InputError as error:
        return str(error)
    return None


def _arrow_of(values: NDArray[Any]) -> Any:
    import pyarrow as pa

    if values.ndim == 1:
        return pa.array(values)
    inner = _arrow_of(values.reshape(-1, *values.shape[2:]))
    return pa.FixedSizeListArray.from_arrays(inner, values.shape[1])


def _array_of(column: Any) -> NDArray[Any]:
    import pyarrow as pa

    if pa.types.is_fixed_size_list(column.type):
        inner = _array_of(column.flatten())
        return inner.reshape(len(column), column.type.list_size, *inner.shape[1:])
    if pa.types.is_string(column.type):
        return np.array(column.to_pylist())
    return np.asarray(column.to_numpy(zero_copy_only=False))


def write_rows(path: Path, rows: Rows) -> Path:
    """Write rows as .csv or .parquet, whole or not at all.

    Raises:
        InputError: If the file has any other suffix.
    """
    if path.suffix not in (".csv", ".parquet"):
        raise InputError(f"cannot write {path}: give a file name that ends in .csv or .parquet")
    require("pandas", *(["pyarrow"] if path.suffix == ".parquet" else []))
    table = rows.pandas()
    write = partial(table.to_csv, index=False) if path.suffix == ".csv" else partial(table.to_parquet, index=False)
    return write_whole(path, write)


def pivot(
    rows: Sequence[Mapping[str, Any]], names: Sequence[str], across: str, cell: Callable[[Mapping[str, Any]], str]
) -> tuple[list[str], list[list[str]]]:
    """Heads and cells of a table: a line for each combination of ``names``, a column for each level of ``across``."""
    columns = list(dict.fromkeys(row[across] for row in rows))
    lines: dict[tuple[str, ...], dict[Any, str]] = {}
    for row in rows:
        lines.setdefault(tuple(str(row[name]) for name in names), {})[row[across]] = cell(row)
    cells = [[*key, *(line.get(column, "") for column in columns)] for key, line in lines.items()]
    return [*names, *map(str, columns)], cells
