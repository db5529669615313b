"""Run or continue a tolerance study, and read its folder: yields and quantiles per setting.

A study's folder contains `study.toml`, that is the configuration with its hash, and the folder `rows`. In `rows` is
an experiment whose units are chunks of arms, with one row for each arm and setting. A complete study
has `summary.json` too. Each part is checked against the others when it is read. The files in `rows` have the hash of
the study in their names, and the summary contains the hashes of study and rows.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.dataset as ds

from pickenv import __version__
from pickenv.base import (
    InputError,
    check_known,
    command_line,
    locked,
    quantile_levels,
    read_sealed_json,
    sealed_json,
    share_interval,
    toml_of,
    write_text,
)
from pickenv.experiments import study
from pickenv.experiments.engine import RECORD, Experiment, Rows, check_experiment, keep, kept_tables, refusal

Row = Mapping[str, Any]

ROWS, SUMMARY, SOBOL = "rows", "summary.json", "sobol.json"
"""Names of the parts of a study's folder: rows, summary and Sobol indices."""
SOBOL_AGAIN = "run `pickenv study` with `sobol` again"

BATCHED = "batched"
"""Name of the executor that computes all arms of a chunk at once; the other executors compute arm by arm."""
EXECUTORS = {"serial": "serial", "joblib": "loky", BATCHED: "loky"}
"""For each executor, the backend of `pickenv.experiments.run` that computes the chunks."""


def run_study(
    config: study.StudyConfig,
    folder: Path,
    *,
    executor: str = "joblib",
    workers: int | None = None,
    device: str = "cpu",
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, Any]:
    """Compute the chunks (groups of arms) that a study's folder lacks; write and return the study's summary.

    Args:
        config: The study.
        folder: Folder for results. Chunks that are there are kept; damaged chunks are computed again, with a warning.
        executor: "serial" (one process), "joblib" (several processes), or "batched" (many arms at once, in torch).
        workers: Number of processes; None for one per core, or for a single one with "batched".
        device: Device of "batched": "cpu" or "cuda".
        progress: Called with (arms done, total number of arms).

    Returns:
        The summary, which is also written to ``folder/summary.json``.

    Raises:
        InputError: If the executor is unknown, the folder holds another study, or another process works in it.
    """
    check_known("executor", executor, EXECUTORS)
    if device != "cpu" and executor != BATCHED:
        raise InputError(f"`device='{device}'` is for one executor; give `executor='{BATCHED}'` with it")
    protocol, backend, arithmetic = study.prepared_study(config), EXECUTORS[executor], "arm by arm"
    judge: study.Judge = study.judge_arms
    if executor == BATCHED:
        judge, arithmetic = _batched(protocol, device), f"batched on {device}"
        backend = "serial" if device != "cpu" or (workers or 1) == 1 else backend
    finished: list[int] = []

    def count(_: str, chunks: int, total: int) -> None:
        finished.append(chunks)
        if progress is not None:
            progress(min(chunks * config.chunk, config.arms), config.arms)

    with locked(folder):
        _claim(folder, config, arithmetic)
        inputs, measure = (config.sha256(), arithmetic), partial(study.evaluate_chunk, protocol, judge=judge)
        experiment = Experiment(_name(config), {"chunk": config.chunks()}, {}, measure, config.seed, inputs)
        begin = time.perf_counter()
        files = keep(experiment, folder / ROWS, backend=backend, workers=workers, progress=count)
        about = {"executor": executor, "seconds": time.perf_counter() - begin, "chunks_reused": finished[0]}
        # The summary comes last: where it stands, the study is complete.
        return write_record(folder / SUMMARY, _summary(protocol, folder, files, about))


def _batched(protocol: study.Protocol, device: str) -> study.Judge:
    learnt = sorted({setting.method for setting in protocol.settings} - {study.RAW, study.LS})
    if learnt:
        raise InputError(f"the batched executor has no {learnt[0]}; give `executor='joblib'`, or leave that method out")
    from pickenv.experiments.study_batched import check_device, judge_batch

    check_device(device)
    return partial(judge_batch, device=device)


def _name(config: study.StudyConfig) -> str:
    """Return the name of a study's experiment, with which the names of its files begin."""
    return f"study-{config.sha256()[:16]}"


def _summary(protocol: study.Protocol, folder: Path, files: Sequence[Path], about: Row) -> dict[str, Any]:
    config, table, rows = protocol.config, table_sha256(folder), ds.dataset([str(file) for file in files])
    yields, quantiles = yields_of(rows, config.share).to_pylist(), quantiles_of(rows).to_pylist()
    sizes = {"arms": config.arms, "settings": len(protocol.settings), "fruit": config.fruit, "seed": config.seed}
    by_unit = {f"quantiles_{u}": [row for row in quantiles if row["quantity"].endswith(f"_{u}")] for u in ("mm", "deg")}
    components = [_components(protocol, protocol.settings[row["setting"]]) for row in held(yields, ("method",))]
    return (
        {"plant": config.plant, "simulated": True, "pickenv": __version__, **sizes}
        | {"radius_mm": config.radius_mm, "share": config.share, **about}
        | {"config_sha256": config.sha256(), "table_sha256": table}
        | {"yield": yields, **by_unit, "components": components}
    )


def _components(protocol: study.Protocol, setting: study.Setting) -> dict[str, Any]:
    """Return a setting's columns, with the rows of `components_of` as "shares".

    If these cannot be computed, "missing" has the reason; otherwise "missing" is None.
    """
    from pickenv.experiments.study_variance import components_of

    try:
        return setting.columns() | {"shares": components_of(protocol, setting), "missing": None}
    except InputError as error:
        return setting.columns() | {"shares": [], "missing": str(error)}


# The folder.


def _claim(folder: Path, config: study.StudyConfig, arithmetic: str) -> None:
    """Claim a folder for a study: write the configuration, or check that the folder already has the same one.

    The ``arithmetic`` says how rows are computed, such as "arm by arm". It is written and checked in the same way.
    """
    described, sha256 = folder / "study.toml", config.sha256()
    if not described.is_file():
        if (folder / ROWS).exists():
            raise InputError(f"{folder} holds rows but no study.toml that says of what; give another `folder`")
        write_text(described, f'sha256 = "{sha256}"\narithmetic = "{arithmetic}"\n{config.toml()}')
        return
    recorded = study_of(folder).sha256()
    if recorded != sha256:
        raise InputError(
            f"{folder} holds the results of another configuration (hash {recorded[:12]}, this one has {sha256[:12]}); "
            "give another `folder`, or that configuration to go on"
        )
    before = toml_of(described)[0].get("arithmetic")
    if before != arithmetic:
        raise InputError(
            f"{folder} holds rows computed {before}, and rows computed {arithmetic} differ from them in the last "
            "digits; go on with the executor that began it, or give another `folder`"
        )


def study_of(folder: str | Path) -> study.StudyConfig:
    """Return the configuration of a study's folder, and verify the hash in `study.toml`.

    Raises:
        InputError: If the folder holds no study, or the hash belongs to another configuration.
    """
    path = Path(folder) / "study.toml"
    config, (content, _) = study.load_study(path), toml_of(path)
    recorded, sha256 = str(content.get("sha256", "")), config.sha256()
    if not recorded:
        raise InputError(f"{path} is not the record of a results folder; give another folder")
    if recorded != sha256:
        raise InputError(
            f"{path} was edited, or its plant or tolerance classes have changed, since its rows were computed (hash "
            f"{recorded[:12]}, its content has {sha256[:12]}); put it back as it was, or run the study in another "
            "folder"
        )
    return config


def _chunks(folder: str | Path) -> Iterator[tuple[Path, pa.Table]]:
    """Yield file and table of each chunk in order, verified; memory does not grow with the number of arms."""
    rows = Path(folder) / ROWS
    if not (rows / RECORD).is_file():
        raise InputError(f"{rows} holds no results; run `pickenv study` first")
    name = _name(study_of(folder))
    for path, table in kept_tables(rows):
        if not path.name.startswith(f"{name}_"):
            raise InputError(f"{path} belongs to another study than {name}; take the rows away and run the study again")
        yield path, table


def read_rows(folder: str | Path) -> ds.Dataset:
    """Return all rows of a study's folder as a data set that can be read in batches; every chunk is verified.

    Raises:
        InputError: If the folder holds no rows, or a chunk is missing, damaged or of another study.
    """
    return ds.dataset([str(path) for path, _ in _chunks(folder)], format="parquet")


def table_sha256(folder: str | Path) -> str:
    """Return one hash over all rows of a study, sorted by arm and setting; it does not depend on the size of chunks.

    Each column is hashed on its own, numbers as little-endian bytes and texts as UTF-8 lines. The result is one hash
    over the names of all columns and these hashes.

    Raises:
        InputError: If the folder holds no rows, or a chunk is missing, damaged or of another study.
    """
    hashes: dict[str, Any] = {}
    for _, table in _chunks(folder):
        for name in table.column_names:
            if name != "chunk":
                hashes.setdefault(name, hashlib.sha256()).update(_column_bytes(table.column(name)))
    lines = "".join(f"{name} {digest.hexdigest()}\n" for name, digest in hashes.items())
    return hashlib.sha256(lines.encode()).hexdigest()


def _column_bytes(column: pa.ChunkedArray) -> bytes:
    if pa.types.is_string(column.type):
        return "".join(f"{text}\n" for text in column.to_pylist()).encode()
    values = column.to_numpy()
    return bytes(values.astype(values.dtype.newbyteorder("<")).tobytes())


def write_record(path: Path, content: Row) -> dict[str, Any]:
    """Write JSON that contains the hash of its own content ("sha256"), and return the content with the hash."""
    text = sealed_json(content)
    write_text(path, text)
    return dict(json.loads(text))


def read_record(path: Path, sha256: str, again: str) -> dict[str, Any]:
    """Read a record that `write_record` wrote about a study, and verify it.

    Args:
        path: The file.
        sha256: Hash of the study, which must be equal to the record's entry "config_sha256".
        again: What the user can do about a refused file, as the end of the error's sentence.

    Raises:
        InputError: If the file is missing, damaged, edited, or about another study.
    """
    record = read_sealed_json(path, "a record of a study", again, "config_sha256")
    if (about := record["config_sha256"]) != sha256:
        raise InputError(f"{path} is about another study (hash {str(about)[:12]}, not {sha256[:12]}); {again}")
    return record


def read_summary(folder: str | Path) -> dict[str, Any]:
    """Read and verify the summary of a finished study.

    Raises:
        InputError: If the summary is missing, damaged, edited, or of another study or other rows.
    """
    path, command = Path(folder) / SUMMARY, command_line("pickenv", "study", "CONFIG", out=folder)
    again = f"run `{command}` again to go on"
    table = table_sha256(folder)
    summary = read_record(path, study_of(folder).sha256(), f"the study is not finished: {again}")
    if summary["table_sha256"] != table:
        raise InputError(f"{path} was made from other rows than those beside it; {again}")
    return summary


def write_sobol(folder: str | Path, settings: Sequence[int], samples: int) -> Path:
    """Compute the Sobol indices of some settings of a study, and write them into its folder for the report.

    Args:
        folder: The study's folder.
        settings: Numbers of the settings, from 0.
        samples: Size of the sample, a power of two.

    Raises:
        InputError: If a setting has a method other than raw or least squares, an arm cannot be judged, or ``samples``
            is no power of two or too few.
    """
    from pickenv.experiments.study_variance import sobol_of

    config, path = study_of(folder), Path(folder) / SOBOL
    protocol = study.prepared_study(config)
    indices = {f"{number}": sobol_of(protocol, protocol.settings[number], samples) for number in settings}
    write_record(path, {"config_sha256": config.sha256(), "indices": indices})
    return path


def read_sobol(folder: str | Path) -> dict[int, list[dict[str, Any]]]:
    """Read the rows of `sobol_of` that `write_sobol` wrote, by number of the setting, from 0; empty if there are none.

    Raises:
        InputError: If the file is damaged, edited or about another study.
    """
    path = Path(folder) / SOBOL
    if not path.is_file():
        return {}
    record = read_record(path, study_of(folder).sha256(), SOBOL_AGAIN)
    return {int(number): list(rows) for number, rows in record["indices"].items()}


def check_folder(folder: str | Path) -> list[tuple[Path, str | None]]:
    """Verify every file of a study's folder, except report, figures and recording, which can be made again.

    Returns:
        Pairs (path, fault) for the configuration, every file in the folder of rows, every missing chunk, the summary,
        and the Sobol indices if there are any. The fault is None for a sound file, else a sentence that says why the
        file is refused.
    """
    folder = Path(folder)
    described, rows = folder / "study.toml", check_experiment(folder / ROWS)
    if (fault := refusal(study_of, folder)) is not None:
        rows = [(path, reason or f"{path} cannot be judged without a sound {described}") for path, reason in rows]
    checks = [(described, fault), *rows, (folder / SUMMARY, refusal(read_summary, folder))]
    return checks + ([(folder / SOBOL, refusal(read_sobol, folder))] if (folder / SOBOL).exists() else [])


# Yields and quantiles. The rows are a Parquet data set of any size, of which memory holds a few columns of one setting.

VARIED = ("it_grade", "poses", "noise_mm", "payload_kg")
"""Columns, besides tolerance class and method, that a study may vary."""

PROBABILITIES = (0.05, 0.25, 0.5, 0.75, 0.95)


def held(rows: Sequence[Row], shown: Sequence[str]) -> list[Row]:
    """Return the rows in which every varied column, except those in ``shown``, is at its middle value.

    The middle grade is chosen among the grades of the middle tolerance class. The middle noise of attitudes is chosen
    among the values that occur with the middle noise of positions. Rows of raw arms have neither poses nor noise, and
    are kept for any values in these columns.
    """
    for name in ("tolerances", *VARIED):
        if name not in shown:
            middle = _middle(rows, name)
            free = name in ("poses", "noise_mm")
            rows = [row for row in rows if row[name] == middle or (free and row["method"] == study.RAW)]
    attitude = {
        noise: _middle([row for row in rows if row["noise_mm"] == noise], "noise_deg")
        for noise in {row["noise_mm"] for row in rows}
    }
    return [row for row in rows if row["noise_deg"] == attitude[row["noise_mm"]] or row["method"] == study.RAW]


def _middle(rows: Sequence[Row], name: str) -> Any:
    """Return the middle of the different values of the column ``name``.

    Numbers are sorted by size. Tolerance classes keep the order of the rows. Only the rows of calibrated arms count, if
    there are any. Of two middle values the first is returned.
    """
    calibrated = [row for row in rows if row["method"] != study.RAW] or rows
    values = list(dict.fromkeys(row[name] for row in calibrated))
    values = values if name == "tolerances" else sorted(values)
    return values[(len(values) - 1) // 2] if values else None


def yields_of(rows: ds.Dataset, required_share: float) -> pa.Table:
    """Compute the yield of every setting, that is the share of arms within specification, with Wilson's interval.

    An arm is within specification if the share of its fruit inside the specified radius reaches the required share. An
    arm without a result is never within specification. Shares are numbers from 0 to 1.

    Args:
        rows: Any number of a study's rows.
        required_share: Share of an arm's fruit that must lie within the specified radius.

    Returns:
        One row per setting: the setting's columns, ``arms``, ``failed`` (arms without a result), ``within`` (arms
        within specification), ``yield`` and Wilson's 95 % interval ``yield_low``, ``yield_high``.
    """
    table = []
    for setting, arms in _by_setting(rows, ("status", "share_within")):
        within = int(np.sum(arms["share_within"] >= required_share))  # a failed arm's share is NaN: not within
        low, high = share_interval(within, len(arms))
        counts = {"arms": len(arms), "failed": int(np.sum(arms["status"] != study.OK)), "within": within}
        table.append(setting | counts | {"yield": within / len(arms), "yield_low": low, "yield_high": high})
    return pa.Table.from_pylist(table)


def quantiles_of(
    rows: ds.Dataset, columns: Sequence[str] = study.FIGURES, probabilities: Sequence[float] = PROBABILITIES
) -> pa.Table:
    """Compute quantiles of the arms' errors in every setting, mm and degrees; arms without a result are left out.

    The i-th of N sorted values has probability (i - 1/2) / N (Hazen's definition). The 95 % band, from order
    statistics, needs no assumption about the distribution. With few arms the band of an extreme quantile has an open
    end. With fewer than 72 arms, this holds for quantiles below 5 % and above 95 %.

    Args:
        rows: Any number of a study's rows.
        columns: The columns of errors.
        probabilities: Probabilities of the quantiles.

    Returns:
        One row per setting, column and probability: the setting's columns, ``quantity``, ``arms``, ``probability``,
        ``value`` and the 95 % band ``low``, ``high``. An open end is null; ``value``, ``low`` and ``high`` are null if
        no arm has a result.
    """
    quantiles: dict[str, list[dict[str, Any]]] = {column: [] for column in columns}
    for setting, arms in _by_setting(rows, ("status", *columns)):
        arms = arms.where(status=study.OK)
        for probability in map(float, probabilities):
            levels = zip(("value", "low", "high"), (probability, *quantile_levels(len(arms), probability)), strict=True)
            names, places = zip(*((name, level) for name, level in levels if level is not None), strict=True)
            for column in columns:
                ends = np.quantile(arms[column], places, method="hazen").tolist() if len(arms) else ()
                about = {"arms": len(arms), "quantity": column, "probability": probability}
                band = dict.fromkeys(("value", "low", "high")) | dict(zip(names, ends, strict=False))
                quantiles[column].append(setting | about | band)
    return pa.Table.from_pylist([row for column in columns for row in quantiles[column]])


def _by_setting(rows: ds.Dataset, columns: Sequence[str]) -> Iterator[tuple[dict[str, Any], Rows]]:
    """Yield each setting, in order of its number, as its identifying columns and the given columns of its rows."""
    settings: dict[int, dict[str, Any]] = {}
    for batch in rows.to_batches(columns=list(study.SETTING), use_threads=False):
        groups = pa.Table.from_batches([batch]).group_by(list(study.SETTING), use_threads=False).aggregate([])
        settings |= {setting["setting"]: setting for setting in groups.to_pylist()}
    for number in sorted(settings):
        table = rows.to_table(columns=list(columns), filter=pc.field("setting") == number, use_threads=False)
        yield settings[number], Rows.of_arrow(table)
