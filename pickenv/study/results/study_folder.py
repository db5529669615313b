"""A study's folder: what was asked, the chunks of rows, what was found; each checked against the others when read.

It holds `study.toml` (the configuration, with its hash), `rows/chunk-00000.parquet`, … (each written whole or not at
all) and, when the study is complete, `summary.json`. Every hash is computed again from what it is the hash of.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.dataset as ds

from pickenv.errors import InputError
from pickenv.files import write_text
from pickenv.sealed import parquet_is_sealed
from pickenv.study.design.config import StudyConfig, load_study
from pickenv.study.results.row_table import Study, chunk_path, column_bytes, read_chunk
from pickenv.toml_tables import toml_of

SUMMARY, SOBOL = "summary.json", "sobol.json"
SOBOL_AGAIN = "run `pickenv study` with --sobol again"


def open_folder(folder: Path, config: StudyConfig, arithmetic: str) -> Study:
    """Claim a folder for a study: write its configuration, or check that it holds the same one.

    Args:
        folder: The folder; made if need be.
        config: The study.
        arithmetic: How the rows are computed.

    Raises:
        InputError: If the folder holds the results of another configuration, or rows of an unknown one.
    """
    study, described = Study(config, arithmetic), folder / "study.toml"
    if not described.is_file():
        if (folder / "rows").exists():
            raise InputError(f"{folder} holds rows but no study.toml that says of what; give another --out")
        write_text(described, f'sha256 = "{study.sha256}"\narithmetic = "{arithmetic}"\n{config.toml()}')
        return study
    found = study_at(folder)
    if found.sha256 != study.sha256:
        raise InputError(
            f"{folder} holds the results of another configuration (hash {found.sha256[:12]}, this one has "
            f"{study.sha256[:12]}); give another --out, or that configuration to go on"
        )
    if found.arithmetic != arithmetic:
        raise InputError(
            f"{folder} holds rows computed {found.arithmetic}, and rows computed {arithmetic} differ from them in the "
            "last digits; go on with the executor that began it, or give another --out"
        )
    return study


def study_at(folder: str | Path) -> Study:
    """The study of a results folder, its hash computed again.

    Raises:
        InputError: If the folder holds no study, or another one than its hash says.
    """
    path = Path(folder) / "study.toml"
    config, (content, _) = load_study(path), toml_of(path)
    study, said = Study(config, str(content.get("arithmetic"))), str(content.get("sha256", ""))
    if not said:
        raise InputError(f"{path} is not the record of a results folder; give another folder")
    if said != study.sha256:
        raise InputError(
            f"{path} was edited, or its plant or tolerance classes have changed, since its rows were computed (hash "
            f"{said[:12]}, its content has {study.sha256[:12]}); put it back as it was, or run the study in another "
            "folder"
        )
    return study


def study_of(folder: str | Path) -> StudyConfig:
    """The configuration of a results folder; see `study_at`."""
    return study_at(folder).config


def missing_chunks(folder: Path, study: Study) -> tuple[list[int], list[Path]]:
    """Which chunks are still to be computed, and which of their files are there but damaged.

    Every file is read to its end; one whose seal does not hold counts as missing.

    Raises:
        InputError: If a file is whole but does not belong here: of another study, another chunk, or of no number.
    """
    refuse_strays(folder, study)
    missing, damaged = [], []
    for chunk in study.config.chunks():
        path = chunk_path(folder, chunk)
        if path.is_file():
            if parquet_is_sealed(path.read_bytes()):
                read_chunk(folder, chunk, study)
                continue
            damaged.append(path)
        missing.append(chunk)
    return missing, damaged


def refuse_strays(folder: Path, study: Study) -> None:
    """Refuse files among the rows that are none of the study's chunks.

    Raises:
        InputError: If there is one; what interrupted writes leave behind, hidden files, are passed over.
    """
    named = {chunk_path(folder, chunk) for chunk in study.config.chunks()}
    for path in _listed(folder / "rows"):
        if path not in named and not path.name.startswith("."):
            raise InputError(
                f"{path} is no part of this study, whose rows are {len(named)} chunks from number 0; take it out of "
                "the folder"
            )


def read_rows(folder: str | Path) -> ds.Dataset:
    """All rows of a folder, every chunk verified, to be streamed in batches.

    Raises:
        InputError: If the folder holds no rows, or a chunk is missing or is not what it should be.
    """
    folder = Path(folder)
    for _ in batches(folder):
        pass
    return ds.dataset([str(chunk_path(folder, chunk)) for chunk in study_of(folder).chunks()], format="parquet")


def batches(folder: str | Path) -> Iterator[pa.Table]:
    """The rows in order, a chunk at a time, each verified: memory does not grow with the number of arms.

    Raises:
        InputError: As `read_rows`.
    """
    folder = Path(folder)
    if not any(path.suffix == ".parquet" for path in _listed(folder / "rows")):
        raise InputError(f"{folder / 'rows'} holds no results; run `pickenv study` first")
    study = study_at(folder)
    refuse_strays(folder, study)
    for chunk in study.config.chunks():
        yield read_chunk(folder, chunk, study)


def table_sha256(folder: str | Path) -> str:
    """Hash of all rows, sorted by arm and setting; it does not depend on how they are cut into files.

    Each column is hashed on its own, numbers as little-endian bytes and texts as UTF-8 lines, then names and hashes
    together.
    """
    hashes: dict[str, Any] = {}
    for table in batches(folder):
        for name in table.column_names:
            hashes.setdefault(name, hashlib.sha256()).update(column_bytes(table.column(name)))
    lines = "".join(f"{name} {digest.hexdigest()}\n" for name, digest in hashes.items())
    return hashlib.sha256(lines.encode()).hexdigest()


def write_record(path: Path, content: Mapping[str, Any]) -> dict[str, Any]:
    """Write JSON that carries the hash of its own content; returns it with the hash ("sha256")."""
    sealed = {**content, "sha256": _content_sha256(content)}
    write_text(path, json.dumps(sealed, indent=2, allow_nan=False) + "\n")
    return sealed


def read_record(path: Path, study: Study, again: str) -> dict[str, Any]:
    """What `write_record` wrote about a study ("config_sha256").

    Args:
        path: The file.
        study: The study that it must be about.
        again: What to do about a file that is refused, as the end of a sentence.

    Raises:
        InputError: If it is missing, damaged, edited, or about another study.
    """
    try:
        found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        said, about = found.pop("sha256"), found["config_sha256"]
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(f"{path} is missing or damaged; {again}") from error
    if said != _content_sha256(found):
        raise InputError(f"{path} was edited or damaged after it was written (its hash does not hold); {again}")
    if about != study.sha256:
        raise InputError(f"{path} is about another study (hash {str(about)[:12]}, not {study.sha256[:12]}); {again}")
    return found


def read_summary(folder: str | Path) -> dict[str, Any]:
    """The summary of a finished study.

    Raises:
        InputError: If it is missing, damaged, edited, or of another study or other rows.
    """
    path = Path(folder) / SUMMARY
    again = f"run `pickenv study CONFIG --out {folder}` again to go on"
    summary = read_record(path, study_at(folder), f"the study is not finished: {again}")
    if summary["table_sha256"] != table_sha256(folder):
        raise InputError(f"{path} was made from other rows than those beside it; {again}")
    return summary


def check_folder(folder: str | Path) -> list[tuple[Path, str | None]]:
    """Verify a study's folder from end to end.

    What can be made anew from these (report, figures, recording) is not looked at.

    Returns:
        The configuration, every file among the rows, missing chunks, the summary and Sobol indices where there are
        some: each with None, or the sentence that says why it is refused.
    """
    folder = Path(folder)
    found = [(folder / "study.toml", _said(partial(study_at, folder)))]
    rows = _listed(folder / "rows")
    if found[0][1] is not None:
        rest = [path for path in (*rows, folder / SUMMARY, folder / SOBOL) if path.is_file()]
        return found + [(path, f"{path} cannot be judged without a sound {found[0][0]}") for path in rest]
    study = study_at(folder)
    chunks = {chunk_path(folder, chunk): chunk for chunk in study.config.chunks()}
    for path in sorted({*chunks, *rows}):
        if path in chunks:
            found.append((path, _said(partial(read_chunk, folder, chunks[path], study))))
        elif path.name.startswith("."):
            found.append((path, f"{path} was left behind by an interrupted write; delete it"))
        else:
            found.append((path, f"{path} is no part of this study; take it out of the folder"))
    found.append((folder / SUMMARY, _said(partial(read_summary, folder))))
    if (folder / SOBOL).exists():
        found.append((folder / SOBOL, _said(partial(read_record, folder / SOBOL, study, SOBOL_AGAIN))))
    return found


def _said(read: Callable[[], Any]) -> str | None:
    """The sentence with which reading is refused."""
    try:
        read()
    except InputError as error:
        return str(error)
    return None


def _listed(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.is_dir() else []


def _content_sha256(content: Mapping[str, Any]) -> str:
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
