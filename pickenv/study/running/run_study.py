"""Run a study, or go on with one: only chunks that are not on disk yet are computed. Then the summary."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from pickenv import __version__
from pickenv.errors import InputError
from pickenv.locks import locked
from pickenv.study.design.config import LS, RAW, StudyConfig
from pickenv.study.design.protocol import Protocol, prepared_study
from pickenv.study.results import study_folder
from pickenv.study.results.row_table import Study, held, setting_columns, write_chunk
from pickenv.study.running.runners import Crew, Executor, Work, load_executor, run_serial

BATCHED = "batched"
"""Works on all arms of a chunk at once, in this process; the other executors work arm by arm."""

Progress = Callable[[int, int], None]
"""Called with (arms done, arms in all)."""


def run_study(
    config: StudyConfig,
    folder: Path,
    *,
    executor: str = "joblib",
    crew: Crew | None = None,
    device: str = "cpu",
    progress: Progress | None = None,
    warn: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Compute what is missing of a study and summarise it.

    Args:
        config: The study.
        folder: Results; chunks already there are kept.
        executor: A name of `pickenv.study.running.runners.EXECUTORS`, or "batched".
        crew: Workers and address.
        device: Where "batched" computes: "cpu" or "cuda".
        progress: Told how many arms are done.
        warn: Told of damaged files, which are computed again.

    Returns:
        The summary, which is also written to ``folder/summary.json``.

    Raises:
        InputError: If the executor is unknown, or the folder holds another study, holds files that do not belong to it,
            or is being worked in.
    """
    crew = (crew or Crew()).for_executor(executor)
    run = _batched_run(crew, device) if executor == BATCHED else load_executor(executor)
    protocol = prepared_study(config)
    work = _work(protocol, executor, device)
    with locked(folder):
        study = study_folder.open_folder(
            folder, config, f"batched on {device}" if executor == BATCHED else "arm by arm"
        )
        missing, damaged = study_folder.missing_chunks(folder, study)
        for path in damaged:
            if warn is not None:
                warn(f"{path} is damaged and is computed again")
        done = config.arms - sum(len(config.arms_of(chunk)) for chunk in missing)
        reused = len(config.chunks()) - len(missing)
        report = progress or (lambda done, total: None)
        report(done, config.arms)
        begin = time.perf_counter()
        if missing:
            for chunk, rows in run(missing, work, crew):
                write_chunk(folder, chunk, rows, study)
                done += len(config.arms_of(chunk))
                report(done, config.arms)
        return _summary(protocol, study, folder, executor, time.perf_counter() - begin, reused)


def _batched_run(crew: Crew, device: str) -> Executor:
    """Chunks one after the other; with several workers, each works on batches of its own."""
    return run_serial if device != "cpu" or (crew.workers or 1) == 1 else load_executor("joblib")


def _work(protocol: Protocol, executor: str, device: str) -> Work[Any]:
    """What is done with a chunk."""
    if executor != BATCHED:
        from pickenv.study.running.arm_by_arm import evaluate_chunk

        return partial(evaluate_chunk, protocol)
    learnt = sorted({setting.method for setting in protocol.settings} - {RAW, LS})
    if learnt:
        raise InputError(f"the batched executor has no {learnt[0]}; give --executor joblib, or leave that method out")
    from pickenv.study.running.batched import check_device, evaluate_batch

    check_device(device)
    return partial(evaluate_batch, protocol, device=device)


def _summary(
    protocol: Protocol, study: Study, folder: Path, executor: str, seconds: float, reused: int
) -> dict[str, Any]:
    from pickenv.study.results.quantiles import quantiles_of, yields_of

    config, rows = study.config, study_folder.read_rows(folder)
    yields = yields_of(rows, config.share).to_pylist()
    quantiles = [{key: _known(value) for key, value in row.items()} for row in quantiles_of(rows).to_pylist()]
    summary = {
        "plant": config.plant,
        "simulated": True,
        "pickenv": __version__,
        "arms": config.arms,
        "settings": len(study.settings),
        "fruit": config.fruit,
        "seed": config.seed,
        "radius_mm": config.radius_mm,
        "share": config.share,
        "executor": executor,
        "seconds": seconds,
        "chunks_reused": reused,
        "config_sha256": study.sha256,
        "table_sha256": study_folder.table_sha256(folder),
        "yield": yields,
        "quantiles_mm": [row for row in quantiles if row["quantity"].endswith("_mm")],
        "quantiles_deg": [row for row in quantiles if row["quantity"].endswith("_deg")],
        "components": [_components(protocol, row["setting"]) for row in held(yields, ("method",))],
    }
    # The summary comes last: where it stands, the study is complete.
    return study_folder.write_record(folder / study_folder.SUMMARY, summary)


def _components(protocol: Protocol, number: int) -> dict[str, Any]:
    """What the differences between arms come from in a setting that stands for its method, or why it is not known."""
    from pickenv.study.running.components import components_of

    setting = protocol.settings[number]
    try:
        return setting_columns(setting) | {"shares": components_of(protocol, setting), "missing": None}
    except InputError as error:
        return setting_columns(setting) | {"shares": [], "missing": str(error)}


def _known(value: Any) -> Any:
    """None for a quantile of no arms: JSON has no NaN."""
    return None if isinstance(value, float) and math.isnan(value) else value
