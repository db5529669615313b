"""Run experiments: measure units at every combination of factors, and keep the resulting rows in a folder.

An experiment measures each unit (an arm, a seed, a part of a file's rows) at every combination of its factors. The
values of a unit or factor are its levels. A piece is the work at one level of each unit and factor; it gives any number
of rows. The random numbers of a piece depend on the experiment's seed and on the levels of its units alone. Two levels
of a factor are therefore measured with the same arms, fruit and noise. A backend computes the pieces: this process, or
several processes of this machine. Results do not depend on the backend.

In a folder, every piece is a Parquet file with a seal, that is a checksum of its content. The file's name contains a
hash over everything that the rows depend on: inputs, levels and the code that computes numbers. A piece whose file
exists is not computed again. `check_experiment` verifies a whole folder.
"""

from __future__ import annotations

import math
import os
import re
import threading
import time
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache, partial
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm.files.arm import content_sha256
from pickenv.base import (
    Estimate as Estimate,
    InputError,
    check_known,
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

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa

BACKENDS = ("serial", "loky")
"""Names of the backends: this process, and several processes of this machine."""

ATTEMPTS = 4
"""Number of attempts to compute the remaining pieces when worker processes die."""


def spread(
    work: Callable[[int], Any], numbers: Sequence[int], backend: str = "serial", workers: int | None = None
) -> Iterator[tuple[int, Any]]:
    """Call ``work`` with each number, and yield (number, result) as the calls end, in any order.

    When a call raises an exception, no further call is started. The calls in progress end, and their results are
    yielded. Then the exception is raised. If the exception were raised at once, loky would kill all workers.

    Args:
        work: Function to call; a module-level function if other processes are to call it.
        numbers: The numbers that ``work`` is called with.
        backend: "serial" (this process) or "loky" (processes of this machine), as in `BACKENDS`.
        workers: Number of processes; None for one per core.

    Raises:
        InputError: If the backend is unknown or not installed, or its processes keep dying.
    """
    check_known("backend", backend, BACKENDS)
    if backend == "serial" or not numbers:
        for number in numbers:
            yield number, work(number)
        return
    require("joblib")
    from joblib import Parallel, delayed
    from joblib.externals.loky.process_executor import TerminatedWorkerError

    todo, failures = list(numbers), list[Exception]()

    def begun(left: Sequence[int]) -> Iterator[Any]:
        for number in left:
            if failures:
                return
            yield delayed(_numbered)(work, number, os.getpid())

    for _ in range(ATTEMPTS):
        parallel = Parallel(
            n_jobs=workers or -1, backend="loky", return_as="generator_unordered", batch_size=1, pre_dispatch="n_jobs"
        )
        results = parallel(begun(tuple(todo)))
        try:
            for number, result, failure in results:
                todo.remove(number)
                if failure is None:
                    yield number, result
                else:
                    failures.append(failure)
            if failures:
                raise failures[0]
            return
        except TerminatedWorkerError:
            continue
        finally:
            with warnings.catch_warnings():  # nobody takes the other results, as after an interrupt
                warnings.filterwarnings("ignore", ".*tasks", UserWarning, "joblib")
                results.close()
    raise InputError(
        f"the processes that worked on piece {todo[0]} died {ATTEMPTS} times ({len(todo)} are left); give fewer "
        "workers or smaller pieces if memory ran out, and run it again to go on"
    )


def _numbered(work: Callable[[int], Any], number: int, driver: int) -> tuple[int, Any, Exception | None]:
    """Call ``work`` in a worker process; return the number, the result, and the exception or None.

    If ``work`` raises an exception, the result is None. The worker ends when the process with the id ``driver`` dies.
    """
    from joblib.externals.loky import process_executor

    _end_with(driver)
    # A process that loads torch after its first piece has no leak; one that is ended for it is waited for.
    process_executor._MAX_MEMORY_LEAK_SIZE = math.inf
    try:
        return number, work(number), None
    except Exception as error:
        if not isinstance(error, InputError):
            error.add_note(traceback.format_exc())  # where in the worker; a traceback itself cannot be sent
        return number, None, error


@lru_cache(maxsize=1)
def _end_with(driver: int) -> None:
    """Make this worker process end soon after its parent, the process with the id ``driver``, has ended.

    A worker without a parent would wait for ever for someone to fetch its results.
    """

    def watch() -> None:
        while os.getppid() == driver:
            time.sleep(1.0)
        os._exit(1)

    if os.getppid() == driver:  # a single worker is the driver itself
        threading.Thread(target=watch, daemon=True).start()


RECORD = "experiment.json"
"""Name of the file in an experiment's folder that lists the pieces, their keys, and the versions of the packages that
made them."""

AGAIN = "run the experiment again, which makes it anew"

Levels = Mapping[str, Any]
Columns = Mapping[str, NDArray[Any]]
Progress = Callable[[str, int, int], None]
"""Function called with (name of the experiment, pieces done, total number of pieces)."""

Refused = Callable[[Levels, InputError], None]
Piece = tuple[Levels, tuple[int, ...]]
"""A piece of an experiment: one level of each unit and factor, as two values. The first has the levels by the name of
the factor or unit. The second has the index of each unit's level, from 0. These indices and the experiment's seed
determine the piece's random numbers."""


@dataclass(frozen=True)
class Rows:
    """A table of results (not of readings), stored as one array per column; all columns have the same number of rows.

    Attributes:
        columns: Array of each column ``(N, ...)``, by the column's name.
    """

    columns: Columns

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(next(iter(self.columns.values()), ()))

    def __getitem__(self, name: str) -> NDArray[Any]:
        """Return the column with this name."""
        return self.columns[name]

    def where(self, **levels: Any) -> Rows:
        """Return the rows in which each named column has the given value, or one of the values of a given tuple."""
        taken = np.ones(len(self), dtype=np.bool_)
        for name, level in levels.items() if self.columns else ():
            taken &= np.isin(self.columns[name], level if isinstance(level, tuple) else (level,))
        return Rows({name: values[taken] for name, values in self.columns.items()})

    def levels(self, *names: str) -> list[tuple[Any, ...]]:
        """Return the distinct combinations of values of these columns, in order of first appearance."""
        columns = [self.columns[name].tolist() for name in names] if self.columns else []
        return list(dict.fromkeys(zip(*columns, strict=True)))

    def dicts(self) -> list[dict[str, Any]]:
        """Return each row as a dict of plain Python values."""
        lists = {name: values.tolist() for name, values in self.columns.items()}
        return [dict(zip(lists, row, strict=True)) for row in zip(*lists.values(), strict=True)]

    def pandas(self) -> pd.DataFrame:
        """Return the rows as a pandas table; a column with more than one dimension becomes a column of lists."""
        import pandas as pd

        return pd.DataFrame({name: col if col.ndim == 1 else list(col) for name, col in self.columns.items()})

    def arrow(self) -> pa.Table:
        """Return the rows as a pyarrow table; a column with more than one dimension becomes nested fixed-size lists."""
        import pyarrow as pa

        return pa.table({name: _arrow_of(values) for name, values in self.columns.items()})

    @staticmethod
    def of_arrow(table: pa.Table) -> Rows:
        """Make rows from a table that `arrow` returned."""
        return Rows({name: _array_of(table.column(name).combine_chunks()) for name in table.column_names})

    @staticmethod
    def of(rows: Columns | Rows | Sequence[Mapping[str, Any]]) -> Rows:
        """Make rows from columns, or from a sequence of mappings, one for each row.

        Raises:
            ValueError: If the columns have different lengths, or the mappings different keys or another order of keys.
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
    """Concatenate tables of rows; NaN, or empty text, fills the rows of a part that lacks a column.

    If a column holds arrays that are shorter in one part than in another, the shorter arrays are filled up in the same
    way.
    """
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
    """An experiment: units that are measured at every combination of factors.

    Attributes:
        name: Name in file names and messages.
        units: Names and levels (values) of what is sampled, such as ``{"arm": range(64)}``; intervals are computed over
            units.
        factors: Names and levels of what is compared, such as ``{"method": ("raw", "ls")}``.
        measure: Function that returns the rows of a piece, that is of one level of each unit and factor: columns, or
            one mapping per row. It is called with ``rng`` and these levels by name. ``rng`` depends on the unit, and is
            the same at every level of the factors. For use in other processes it must be a module-level function, or a
            `functools.partial` of one.
        seed: Seed of all random numbers.
        inputs: Everything that the rows depend on besides levels, seed and code: settings, plants, hashes of files. Or
            a function that returns all this as a tuple, called with the levels by name.
        fits: Function that returns whether a combination is measured, called with one level of each unit and factor by
            name. None: all combinations are measured.
    """

    name: str
    units: Mapping[str, Sequence[Any]]
    factors: Mapping[str, Sequence[Any]]
    measure: Callable[..., Columns | Rows | Sequence[Mapping[str, Any]]] = field(compare=False)
    seed: int = 0
    inputs: tuple[Any, ...] | Callable[..., tuple[Any, ...]] = ()
    fits: Callable[..., bool] | None = field(default=None, compare=False)

    def pieces(self) -> list[Piece]:
        """Return the pieces that `fits` accepts, that is the combinations of one level of each unit and factor.

        The first factor varies slowest, the last unit fastest.
        """
        pieces: list[Piece] = []
        for levels in product(*self.factors.values()):
            for places in product(*(range(len(values)) for values in self.units.values())):
                units = {name: self.units[name][at] for name, at in zip(self.units, places, strict=True)}
                arguments = dict(zip(self.factors, levels, strict=True)) | units
                if self.fits is None or self.fits(**arguments):
                    pieces.append((arguments, places))
        return pieces

    def measured(self, piece: Piece) -> Rows:
        """Measure one of `pieces`, and return its rows; their first columns are the levels of units and factors."""
        levels, place = piece
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=place))
        with single_threaded():
            rows = Rows.of(self.measure(rng=rng, **levels))
        first = {name: np.full(len(rows), value) for name, value in levels.items() if name not in rows.columns}
        return Rows(first | dict(rows.columns))

    def key(self, piece: Piece) -> str:
        """Return one hash over everything that the rows of one of `pieces` depend on: levels, seed, inputs and code."""
        levels, place = piece
        inputs = self.inputs(**levels) if callable(self.inputs) else self.inputs
        return input_key(self.name, self.seed, inputs, dict(levels), place)


def input_key(*inputs: Any) -> str:
    """Return one hash over ``inputs`` and over the code that computes numbers.

    Callers store a result under this hash, and compute it only if no result with this hash is stored.
    """
    return content_sha256(*inputs, code_fingerprint())


def _file_name(name: str, levels: Levels, key: str) -> str:
    """Return the name of the file that stores one piece of the experiment ``name``.

    The piece has these ``levels`` of its units and factors, by name, and the hash ``key`` from `Experiment.key`.
    """
    label = re.sub(r"[^A-Za-z0-9.]+", "-", "_".join(map(str, levels.values()))).strip("-")[-80:]
    return f"{name}_{label}_{key[:16]}.parquet"


def run(
    experiment: Experiment,
    folder: str | Path | None = None,
    *,
    backend: str = "serial",
    workers: int | None = None,
    progress: Progress | None = None,
    refused: Refused | None = None,
) -> Rows:
    """Measure the pieces that the folder lacks, and return the rows of all pieces, in the order of `Experiment.pieces`.

    A piece is the work at one level of each unit and factor. A piece whose file is damaged is computed again, with a
    warning.

    Args:
        experiment: The experiment.
        folder: Folder that keeps the pieces for later runs; None keeps nothing.
        backend: "serial" (this process), or "loky" (processes of this machine).
        workers: Number of processes; None for one per core.
        progress: Called with (name of the experiment, pieces done, total number of pieces).
        refused: Called with the levels of a piece that cannot be measured, and with the `InputError` that says why.
            Such a piece has no rows, and the next run tries it again. If None, the first such piece ends the run with
            its error.

    Raises:
        InputError: If the backend is unknown or not installed, another process works in the folder, worker processes
            keep dying, or a piece cannot be measured and ``refused`` is None.
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
    """Measure the pieces that a folder lacks, and return the files of all measured pieces in the order of the pieces.

    The arguments are as for `run`, except that ``folder`` is required. Each piece is written when it is measured, so
    the rows of all pieces need not fit into memory together. pyarrow can read the files as one data set.
    """
    folder, pieces = Path(folder), experiment.pieces()
    require("pyarrow")
    with locked(folder):
        keys = [experiment.key(piece) for piece in pieces]
        names = [_file_name(experiment.name, levels, key) for (levels, _), key in zip(pieces, keys, strict=True)]
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
    """Compute the pieces with the indices ``todo`` (from 0), and yield index and rows of each, in any order.

    All further arguments are as for `run`.
    """
    done = len(pieces) - len(todo)
    for number, rows in spread(partial(_measured, experiment, pieces, refused is None), todo, backend, workers):
        if isinstance(rows, Rows):
            yield number, rows
        elif refused is not None:
            refused(pieces[number][0], rows)
        done += 1
        if progress is not None:
            progress(experiment.name, done, len(pieces))


def _measured(experiment: Experiment, pieces: Sequence[Piece], ends: bool, number: int) -> Rows | InputError:
    """Measure the piece with the index ``number`` (from 0), and return its rows.

    If the piece cannot be measured, the `InputError` is raised if ``ends`` is True, and returned otherwise.
    """
    try:
        return experiment.measured(pieces[number])
    except InputError as error:
        if ends:
            raise
        return error


# A folder of pieces.


def kept_rows(folder: str | Path) -> Rows:
    """Read all rows of the last run of an experiment in this folder, and verify the file of each piece.

    Raises:
        InputError: If the folder holds no such run, the run is incomplete, or a file is damaged or was edited.
    """
    return joined([Rows.of_arrow(table) for _, table in kept_tables(folder)])


def kept_tables(folder: str | Path) -> Iterator[tuple[Path, pa.Table]]:
    """Yield the file and the table of each piece (one level of each unit and factor) of the folder's last run.

    Each piece is verified when it is read; only one table is in memory at a time.

    Raises:
        InputError: If the folder holds no run, the run is incomplete, or a file is damaged or was edited.
    """
    folder = Path(folder)
    record = _read_record(folder / RECORD)
    for name in record["last"]:
        yield folder / name, piece_table(folder / name, record["pieces"][name])


def _write_record(folder: Path, pieces: Mapping[str, str]) -> None:
    """Write the record of a folder (`RECORD`), which lists the files of pieces, each with the key of its piece.

    The record lists ``pieces`` (keys by file name). It also lists pieces of earlier runs if their files are in the
    folder.
    """
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
    """Write rows as one Parquet file with a checksum, completely or not at all.

    Args:
        path: The file.
        rows: The rows.
        name: Name of the experiment, which the file records.
        key: Text that identifies the rows, usually `Experiment.key`; `piece_table` needs the same text to read them.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    sink = pa.BufferOutputStream()
    table = rows.arrow().replace_schema_metadata({"pickenv.key": key, "pickenv.experiment": name})
    pq.write_table(table, sink, compression="zstd")
    content = sealed_parquet(sink.getvalue().to_pybytes())
    write_whole(path, lambda temporary: temporary.write_bytes(content))


def piece_table(path: Path, key: str) -> pa.Table:
    """Read the file of one piece of an experiment as a table, and verify its checksum and key.

    Args:
        path: The file.
        key: The key that the file must have been written with.

    Raises:
        InputError: If the file is missing or damaged, or was written with another key.
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
    """Verify every file in an experiment's folder.

    Returns:
        Pairs (path, fault). The first pair is for the record (`RECORD`), which lists the files of all pieces. The
        following pairs, sorted by name, are for the listed files and for all further files in the folder. The fault is
        None for a sound file, else a sentence that says why the file is refused. If the record is damaged, its pair is
        the only one.
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
    """Return the message of the `InputError` that ``read`` raises for ``arguments``; None if it raises none."""
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
    """Write rows as a table into a .csv or .parquet file, completely or not at all, and return the path.

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
    """Return the column heads, and the lines of cells, of a pivot table as text.

    Args:
        rows: One mapping for each cell of the pivot table.
        names: Keys of ``rows`` that become the first columns; each combination of their values has one line.
        across: Key of ``rows`` whose values become the heads of all further columns.
        cell: Function that maps one of ``rows`` to the text of its cell.
    """
    columns = list(dict.fromkeys(row[across] for row in rows))
    lines: dict[tuple[str, ...], dict[Any, str]] = {}
    for row in rows:
        lines.setdefault(tuple(str(row[name]) for name in names), {})[row[across]] = cell(row)
    cells = [[*key, *(line.get(column, "") for column in columns)] for key, line in lines.items()]
    return [*names, *map(str, columns)], cells
