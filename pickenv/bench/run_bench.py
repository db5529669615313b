"""The benchmark of calibrations as one run: parts that are kept when done, and the tables that they make.

A part (a fold or a row of a measured robot, a peer) is kept in the folder by a hash of its settings, the
bytes of its data, and the code. Every part has a random stream of its own, so that the figures are the same whatever
is run beside it, and by however many processes.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pickenv.bench.gains import SPLITS, Fold, Gain, folds_of, gains_of, judged_fold
from pickenv.bench.peers import PEERS, judged_peer, judged_pickenv
from pickenv.bench.real_sets import SETS, learnable
from pickenv.bench.spread_rows import SPREAD, spread_figures
from pickenv.calibration.model.observations import same_poses
from pickenv.errors import InputError
from pickenv.experiments.engine import spread
from pickenv.files import write_json
from pickenv.provenance import code_fingerprint

PEER_SET = "ur5"
"""The set that peers are judged on."""

TWINNED = ("ur5", "wam", "ur10_a", "ur10_b", "ur10_c", "ur10_d", "positioner")
"""Sets of poses or positions, enough of them for five folds: of these twins are made and residuals learnt."""

GAINS = {f"gain_{name}_{split}": (name, split) for name in TWINNED for split in SPLITS}
"""Predicted beside measured gains: robot's set and split."""

OURS = "pickenv"
PEER_ROWS = {f"peer_{name}": name for name in (OURS, *(peer.name for peer in PEERS))}
ROWS = (*GAINS, *SPREAD, *PEER_ROWS)
"""Every row that can be asked for."""

QUICK = ("gain_ur5_random", "gain_ur5_blocks", "ur5_random")


@dataclass(frozen=True)
class BenchSettings:
    """How much is computed.

    Attributes:
        rows: Rows of a set at most for predicted and measured gains, equally spaced in its file.
        folds: Parts of these rows that are held out in turn.
        draws: Arms drawn from each fold's twin.
        splits: Random splits of those rows.
        seed: Of everything random.
    """

    rows: int = 600
    folds: int = 5
    draws: int = 2
    splits: int = 10
    seed: int = 0

    @staticmethod
    def quick() -> BenchSettings:
        """About a minute for the UR5."""
        return BenchSettings(rows=160, folds=2)


@dataclass(frozen=True, eq=False)
class Bench:
    """What was found.

    Attributes:
        settings: How much was computed.
        gains: Gains by robot and split.
        used: Rows in a set's file, and rows used, by robot.
        spread: Figures of the rows of measured robots, by name.
        peers: Errors of peers on UR5's rows, by name.
        skipped: Rows that were not made, and why.
    """

    settings: BenchSettings
    gains: Mapping[tuple[str, str], Sequence[Gain]]
    used: Mapping[str, tuple[int, int]]
    spread: Mapping[str, Mapping[str, Any]]
    peers: Mapping[str, Mapping[str, Any]]
    skipped: Mapping[str, str]


@dataclass(frozen=True)
class Part:
    """One piece of work: a row, and which of its folds."""

    row: str
    number: int = 0


def run_bench(
    rows: Sequence[str],
    settings: BenchSettings,
    data: Path,
    out: Path,
    peers: Path,
    *,
    workers: int = 1,
    progress: Callable[[int, int], None] | None = None,
) -> Bench:
    """Make these rows, or go on with them.

    Args:
        rows: Some of `ROWS`.
        settings: How much.
        data: Folder of the data sets.
        out: Folder for what is done.
        peers: Folder of the peers' environments.
        workers: Processes.
        progress: Called with (parts done, parts in all).

    Raises:
        InputError: If a row has no such name, or none has data.
    """
    for name in rows:
        if name not in ROWS:
            raise InputError(f"unknown row '{name}'; give some of {', '.join(ROWS)}")
    skipped: dict[str, str] = {}
    parts: dict[Part, Path] = {}
    for name in rows:
        try:
            key = _key(name, settings, data)
        except InputError as error:
            skipped[name] = str(error)
            continue
        count = settings.folds if name in GAINS else 1
        parts |= {Part(name, i): out / "parts" / f"{name}_{i}_{key}.json" for i in range(count)}
    if not parts:
        raise InputError(next(iter(skipped.values()), "no rows were asked for"))
    todo = [part for part, file in parts.items() if not file.is_file()]
    done = len(parts) - len(todo)
    if progress is not None:
        progress(done, len(parts))
    work = partial(_nth_part, todo, settings, data, peers)
    for number, found in spread(work, range(len(todo)), "serial" if workers == 1 else "loky", workers):
        if "reason" in found:  # may be mended by the next run, so it is not kept
            skipped[todo[number].row] = found["reason"]
        else:
            write_json(parts[todo[number]], found)
        done += 1
        if progress is not None:
            progress(done, len(parts))
    content = {
        part: json.loads(file.read_text(encoding="utf-8")) for part, file in parts.items() if part.row not in skipped
    }
    return _put_together(settings, content, skipped)


def _nth_part(parts: Sequence[Part], settings: BenchSettings, data: Path, peers: Path, number: int) -> dict[str, Any]:
    """Figures of one part, or the reason why there are none."""
    try:
        return _worked(parts[number], settings, data, peers)
    except InputError as error:
        return {"reason": str(error)}


def _worked(part: Part, settings: BenchSettings, data: Path, peers: Path) -> dict[str, Any]:
    """Figures of one part."""
    if part.row in SPREAD:
        return spread_figures(SPREAD[part.row], data, settings.splits, settings.seed)
    if part.row in PEER_ROWS:
        name = PEER_ROWS[part.row]
        if name == OURS:
            return judged_pickenv(data)
        return judged_peer(next(peer for peer in PEERS if peer.name == name), data, peers)
    name, split = GAINS[part.row]
    arm, rows, _ = SETS[name].load(data)
    chosen = learnable(arm, rows, settings.rows)
    place = (list(SETS).index(name), SPLITS.index(split))
    shuffle, *seeds = np.random.SeedSequence(settings.seed, spawn_key=place).spawn(1 + settings.folds)
    folds = folds_of(same_poses(chosen.joints), split, settings.folds, np.random.default_rng(shuffle))
    fold = judged_fold(arm, chosen, folds[part.number], settings.draws, seeds[part.number])
    return {"in_file": len(rows.joints), "rows": len(chosen), **fold.as_dict()}


def _key(row: str, settings: BenchSettings, data: Path) -> str:
    """What a row's figures depend on."""
    name = SPREAD[row].name if row in SPREAD else GAINS[row][0] if row in GAINS else PEER_SET
    spec = asdict(SPREAD[row]) if row in SPREAD else None
    seen = hashlib.sha256(json.dumps([row, spec, asdict(SETS[name]), asdict(settings), code_fingerprint()]).encode())
    for files in SETS[name].found(data):
        for path in files:
            seen.update(path.read_bytes())
    return seen.hexdigest()[:16]


def _put_together(
    settings: BenchSettings, content: Mapping[Part, Mapping[str, Any]], skipped: Mapping[str, str]
) -> Bench:
    """The figures by row."""
    gains: dict[tuple[str, str], Sequence[Gain]] = {}
    used: dict[str, tuple[int, int]] = {}
    for row in dict.fromkeys(part.row for part in content if part.row in GAINS):
        name, split = GAINS[row]
        folds = [found for part, found in content.items() if part.row == row]
        gains[SETS[name].robot, split] = gains_of([Fold.from_dict(fold) for fold in folds], split)
        used[SETS[name].robot] = folds[0]["in_file"], folds[0]["rows"]
    others = {part.row: found for part, found in content.items() if part.row not in GAINS}
    return Bench(
        settings=settings,
        gains=gains,
        used=used,
        spread={row: found for row, found in others.items() if row in SPREAD},
        peers={PEER_ROWS[row]: found for row, found in others.items() if row in PEER_ROWS},
        skipped=skipped,
    )
