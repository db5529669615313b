"""Keep what benchmarks took, as ratios to a yardstick of the same run, and say what became slower.

Machines differ from run to run, so times are divided by that of one computation that never changes: products of 10 000
pairs of 4 x 4 matrices in NumPy. History is a CSV file with one row per benchmark and run.

Run: make benchmark ARGS=--benchmark-json=new.json; python .ci/benchmark_history.py new.json history.csv
"""

from __future__ import annotations

import csv
import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from statistics import median

import numpy as np

SLOWER = 1.5
"""How many times its earlier ratio a benchmark may take."""
LOOK_BACK = 5
"""Earlier runs whose median is compared with."""
HEADS = ("commit", "benchmark", "ratio")


def yardstick(repeats: int = 50) -> float:
    """Median time of the yardstick, s."""
    pairs = np.random.default_rng(0).standard_normal((2, 10_000, 4, 4))
    times = []
    for _ in range(repeats):
        begin = time.perf_counter()
        pairs[0] @ pairs[1]
        times.append(time.perf_counter() - begin)
    return median(times)


def slower(history: Sequence[Mapping[str, str]], ratios: Mapping[str, float]) -> list[str]:
    """One sentence for each benchmark that takes `SLOWER` times as long as the median of its last runs.

    Args:
        history: Earlier rows, oldest first.
        ratios: Of this run, by benchmark.
    """
    said = []
    for name, ratio in ratios.items():
        earlier = [float(row["ratio"]) for row in history if row["benchmark"] == name][-LOOK_BACK:]
        if earlier and ratio > SLOWER * median(earlier):
            said.append(f"{name} takes {ratio / median(earlier):.2f} times as long as in the last {len(earlier)} runs")
    return said


def main() -> None:
    """Add a run to the history; exit code 1 if something became slower."""
    new, path = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")), Path(sys.argv[2])
    unit = yardstick()
    ratios = {each["fullname"]: each["stats"]["median"] / unit for each in new["benchmarks"]}
    history: list[dict[str, str]] = []
    if path.exists():
        with path.open(newline="", encoding="utf-8") as file:
            history = list(csv.DictReader(file))
    commit = str(new.get("commit_info", {}).get("id", ""))[:12]
    rows = [{"commit": commit, "benchmark": name, "ratio": f"{ratio:.4g}"} for name, ratio in ratios.items()]
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, HEADS)
        writer.writeheader()
        writer.writerows([*history, *rows])
    said = slower(history, ratios)
    print("\n".join(said) or f"{len(ratios)} benchmarks, none slower than {SLOWER} times its earlier runs")
    sys.exit(1 if said else 0)


if __name__ == "__main__":
    main()
