"""Do other seeds agree? `python scripts/policies/findings_seeds.py` holds docs/findings.md against five fresh seeds.

Other seeds mean other arms, fruit, pictures, calibrations and networks, as many as in `findings.py`. What the page's
sentences say, and every other number of the scripted policy, is worked out at six seeds and written to
docs/findings-seeds.md, but for the last section, whose fifteen trainings are a factor of their own there. Each interval
is asked whether it holds each other seed's number: two estimates differ by sqrt(2) of one's spread, so that about 83 %
are due. A seed that is done is not run again. Options: `--runs`, `--out`, `--workers`, `--arms`.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import defaultdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[2]))
sys.path.insert(0, str(Path(__file__).parent))

from findings import ADAPTIVE, PLANTS, Sizes, adapted, by_plant, run_ideal, settings_of
from findings_day import day_changes, run_day
from findings_noise import CAMERA_MM, GAINS, SWEPT, at_camera, run_noise
from findings_reality import HARD, IDEAL_ON, MODELS, SMOOTH, changed, removed

from pickenv.agents.evaluation.grid import PolicyGrid
from pickenv.agents.evaluation.grid_tables import with_interval
from pickenv.files import write_text
from pickenv.inspect.colours import policy_label
from pickenv.intervals import Estimate, mean_interval

SEEDS = range(6)
"""The first is that of docs/findings.md."""
NUMBERS = {
    "ci95": "mean_mm",
    "median_arm_ci95": "median_arm_mm",
    "p95_arm_ci95": "p95_arm_mm",
    "success_ci95": "success_rate",
}
"""Of each row of a comparison: intervals, and what they are of."""
WORDS = {
    "mean_mm": "mean error, mm",
    "median_arm_mm": "error of the median arm, mm",
    "p95_arm_mm": "error of the 95th percentile arm, mm",
    "success_rate": "share of the fruit taken",
    "difference": "difference between calibrations, mm",
    "removed": "share of LS's error removed",
    "instrument": "what the instrument changes, mm",
    "servo": "servo with a camera, mm",
    "crossing": "camera that equals a calibration, mm",
}

Claim = dict[str, Any]
"""A number: ``kind``, ``what`` in words, ``value``, ``ci95`` (both ends, an open one None, or None), and whether a
sentence of the page says it (``said``)."""


def claims_at(seed: int, sizes: Sizes, runs: Path, workers: int) -> list[Claim]:
    """Every number with an interval at a seed."""
    calibrations = runs / "calibrations"
    grid = by_plant(PLANTS, sizes, calibrations, workers, seed, policies=("scripted",), feedback=("encoders",))
    servo = by_plant(
        dict.fromkeys(SWEPT, ("raw",)), sizes, calibrations, 1, seed, policies=("servo",), feedback=("camera",)
    )
    ideal = run_ideal(sizes, calibrations, seed)
    found = [*policy_claims(grid), *policy_claims(servo), *reality_claims(grid, ideal)]
    found += noise_claims(grid, sizes, seed)
    adaptive = by_plant(
        dict.fromkeys(ADAPTIVE, ("raw",)), sizes, calibrations, 1, seed, policies=("adaptive",), feedback=("camera",)
    )
    for plant in ADAPTIVE:
        for part, each in adapted(adaptive, plant).items():
            found.append(claim("while picking", f"{plant}, adaptive from raw, {part}, mm", each, said=True))
    parts = ("the workshop's change", "the filter's further change")
    changes = day_changes(run_day(settings_of(sizes, seed), sizes.picks))
    return found + [claim("a day", f"{name}, mm", each, said=True) for name, each in zip(parts, changes, strict=True)]


def claim(kind: str, what: str, found: Estimate, said: bool = False) -> Claim:
    """A number in words."""
    ends = None if found.ci95 is None else list(found.ci95)
    return {"kind": kind, "what": what, "value": found.value, "ci95": ends, "said": said}


def policy_claims(grid: PolicyGrid) -> list[Claim]:
    """Errors, successes and differences of policies."""
    found: list[Claim] = []
    for row in grid.rows():
        name = f"{row['plant']}, {row['policy']}, {policy_label(row['compensation'])}"
        for interval, number in NUMBERS.items():
            said = number == "mean_mm"
            what = f"{name}, {WORDS[number]}"
            if number == "success_rate":
                what += f", {row['gripper']}"
                said = row["gripper"] == "li_cup" and row["compensation"] in ("raw", "ls")
            each = Estimate(row[number], row[interval])
            if not any(one["what"] == what for one in found):
                found.append(claim(number, what, each, said))
    for line in grid.comparisons():
        what = f"{line['plant']}, {line['policy']}, {policy_label(line['from'])} to {policy_label(line['to'])}, mm"
        found.append(claim("difference", what, Estimate(line["difference_mm"], line["ci95"])))
    return found


def reality_claims(grid: PolicyGrid, ideal: PolicyGrid) -> list[Claim]:
    """What models remove, and what the instrument changes."""
    found = [
        claim(
            "removed", f"{plant}, share of LS's error removed by {policy_label(key)}", removed(grid, key, plant), True
        )
        for plant in (SMOOTH, HARD)
        for key in MODELS
    ]
    changes = {plant: changed(grid, ideal, plant) for plant in IDEAL_ON}
    return found + [claim("instrument", f"{plant}, instrument, mm", each, True) for plant, each in changes.items()]


def noise_claims(grid: PolicyGrid, sizes: Sizes, seed: int) -> list[Claim]:
    """The servo that averages most against the open loop."""
    found: list[Claim] = []
    for plant in SWEPT:
        noise = run_noise(settings_of(sizes, seed), grid, plant, GAINS[-1:])
        servo = at_camera(noise)
        left = Estimate(float(servo.mean()), mean_interval(servo))
        found.append(claim("servo", f"{plant}, servo with a camera of {CAMERA_MM:g} mm, mm", left, True))
        for key in ("ls", "best"):
            if (crossing := noise.crossing(GAINS[-1], key)) is not None:
                what = f"{plant}, camera that equals {policy_label(key)}, mm"
                found.append(claim("crossing", what, Estimate(*crossing), True))
    return found


def holds(interval: list[float | None] | None, value: float) -> bool:
    """Whether an interval holds a number; open ends hold all on their side."""
    if interval is None:
        return False
    low, high = interval
    return (low is None or low <= value) and (high is None or value <= high)


def counted(by_seed: list[dict[str, Claim]]) -> dict[str, tuple[int, int]]:
    """By kind, and of all: how often a seed's interval holds another seed's number, and of how many."""
    counts: defaultdict[str, list[bool]] = defaultdict(list)
    for i, claims in enumerate(by_seed):
        for j, others in enumerate(by_seed):
            for what in claims if i != j else ():
                if what in others and claims[what]["ci95"] is not None:
                    counts[claims[what]["kind"]].append(holds(claims[what]["ci95"], others[what]["value"]))
    every = [held for each in counts.values() for held in each]
    return {kind: (sum(each), len(each)) for kind, each in [*counts.items(), ("all", every)]}


def page_lines(by_seed: list[dict[str, Claim]]) -> list[str]:
    """docs/findings-seeds.md."""
    first, others = by_seed[0], by_seed[1:]
    lines = [
        "# Findings at other seeds",
        "",
        "Made by `python scripts/policies/findings_seeds.py`: the numbers of [Findings](findings.md), simulated, with "
        f"other arms, fruit, pictures, calibrations and networks at seeds 1 to {len(others)}. Left out are the learned "
        "policies: what carries over from training has five trainings of each there.",
        "",
        "How often a 95 % interval of one seed holds the number of another seed, over all pairs; about 83 % are due, "
        "for both numbers vary. Numbers of one seed share its arms and are not independent of one another.",
        "",
        "| number | intervals that hold | of | share |",
        "|---|--:|--:|--:|",
    ]
    for kind, (held, tried) in counted(by_seed).items():
        lines.append(f"| {WORDS.get(kind, kind)} | {held} | {tried} | {100 * held / tried:.0f} % |")
    seeds = " | ".join(f"seed {seed}" for seed in range(1, len(by_seed)))
    lines += [
        "",
        "What the sentences of the page say, at seed 0 with its 95 % interval, and at the other seeds.",
        "",
        f"| what | seed 0 | {seeds} | inside |",
        "|---|--:|" + "--:|" * (len(others) + 1),
    ]
    for what, each in first.items():
        if each["said"]:
            values = [other[what]["value"] for other in others]
            inside = sum(holds(each["ci95"], value) for value in values) if each["ci95"] else "–"
            numbers = " | ".join(f"{value:.3g}" for value in values)
            own = with_interval(each["value"], each["ci95"], 3)
            lines.append(f"| {what} | {own} | {numbers} | {inside} |")
    return lines


def main() -> None:
    """Run six seeds and count."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=Path, default=Path("runs/findings"))
    parser.add_argument("--out", type=Path, default=Path("docs/findings-seeds.md"))
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="Processes that fit residual models.")
    parser.add_argument("--arms", type=int, default=Sizes().arms)
    options = parser.parse_args()
    sizes, by_seed = Sizes(arms=options.arms), []
    for seed in SEEDS:
        kept = options.runs / "seeds" / f"{sizes.arms}-arms-seed-{seed}.json"
        if not kept.exists():
            kept.parent.mkdir(parents=True, exist_ok=True)
            write_text(kept, json.dumps(claims_at(seed, sizes, options.runs, options.workers), indent=1))
        by_seed.append({each["what"]: each for each in json.loads(kept.read_text(encoding="utf-8"))})
        print(f"seed {seed} done", flush=True)
    for kind, (held, tried) in counted(by_seed).items():
        print(f"{WORDS.get(kind, kind)}: {held} of {tried} ({100 * held / tried:.0f} %)")
    write_text(options.out.parent / "_static" / "findings-seeds.json", json.dumps(by_seed, indent=1) + "\n")
    print(f"wrote {write_text(options.out, chr(10).join(page_lines(by_seed)) + chr(10))}")


if __name__ == "__main__":
    main()
