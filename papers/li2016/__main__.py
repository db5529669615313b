"""Li et al. 2016, number by number: printed in the paper, found here, and why they differ; then better than the paper.

Tables 1 to 3, Figs 2, 5, 8 and 9, eqs (1) to (12), pick points and the recovery experiment of an apple machine with
three slave arms; then the same simulated trees with calibration, better pick points and better assignment. Simulated
throughout: the paper's machine is not at hand.

Each table, figure, equation and the experiment has a verdict (reproduced, not reproduced, fitted) with its reason;
`--json` holds {"tables": {"2": {"verdict", "reason", "rows"}, …}, "figures": {…}, "equations", "experiments"}. The 46
of 56 apples are a prediction over the constants that the paper leaves open (`papers.li2016.prediction`), and beside it
stands what the machine recovers with stereo eyes of its own.

Run: python -m papers.li2016 [--json FILE] [--quick] [--trees N] [--sessions N] [--out FOLDER]
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer
from rich.progress import Progress

from papers.li2016 import verdicts
from papers.li2016.comparison import (
    SEED,
    assignments,
    by_arms,
    calibrated_controller,
    compare,
    comparison_tables,
    displacements,
    report,
    run_errors,
    strategies,
    trace_of,
)
from papers.li2016.equations import ARMS, EXACT, PAPER, equations, pick_points, reach_shares
from papers.li2016.lab import sample_image
from papers.li2016.page import NOTES, drawings, reached_in_area, sections, target_area
from papers.li2016.prediction import prediction, sessions
from papers.li2016.segmentation import figure_5, segmentation
from papers.pages import headline, print_tables, write_page
from pickenv.arm import Array
from pickenv.base import write_text
from pickenv.harvester import Controller, Machine, Strategy, load_lab, load_machine, load_true_machine
from pickenv.inspect import inspect_harvest, write_drawings
from pickenv.inspect.reports import harvest_report
from pickenv.inspect.reports.report_page import Section
from pickenv.inspect.runs.run_folder import recorded_run, save_part
from pickenv.inspect.runs.traces import HarvestTrace


def main(
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the numbers here.")] = None,
    quick: Annotated[bool, typer.Option(help="Few trees and sessions: to see that it runs.")] = False,
    trees: Annotated[int, typer.Option(min=1, help="Simulated trees.")] = 200,
    count: Annotated[int, typer.Option("--sessions", min=40, help="Sessions of the experiment.")] = 1000,
    out: Annotated[Path, typer.Option(help="Folder of figures and the recording.")] = Path("runs/li2016"),
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    vision: Annotated[
        Literal["measured_errors", "rendered", "ideal"], typer.Option(help="How fruit is seen.")
    ] = "measured_errors",
    seed: Annotated[int, typer.Option(min=0, help="Seed of everything random.")] = SEED,
) -> None:
    """Print the tables, draw the figures, write the recording and the JSON."""
    begin = time.perf_counter()
    command = "python -m papers.li2016" + (" --quick" if quick else f" --trees {trees} --sessions {count}")
    command += "" if vision == "measured_errors" else f" --vision {vision}"
    command += "" if seed == SEED else f" --seed {seed}"
    trees, images, count = (min(trees, 12), 40, min(count, 200)) if quick else (trees, 400, count)
    of_rest, of_equations, of_picture, of_sessions = np.random.SeedSequence(seed).spawn(4)
    rng, picture_rng = np.random.default_rng(of_rest), np.random.default_rng(of_picture)
    machine, exact = load_machine(), load_machine(spacing=EXACT)  # Fig. 9 is of section 4.2, as Table 2 is
    true, lab = load_true_machine(machine), load_lab()
    raw, calibrated = Controller(machine), calibrated_controller(true, rng)
    known = {"raw": raw, "calibrated": calibrated}
    known["positions only"] = calibrated_controller(true, rng, positions_only=True)
    errors = {name: run_errors(true, way, lab.runs, rng) for name, way in known.items()}
    with Progress() as bars:
        task = bars.add_task("56 apples", total=count)
        drawn = sessions(true, Strategy("raw", raw), count, of_sessions, lambda: bars.advance(task))
    study = compare(true, strategies(raw, calibrated), trees, images, workers, vision, seed)
    reach = reach_shares(machine, 20 if quick else 200, rng)
    plans = {n: assignments(machine, 2 if quick else 10, n, rng) for n in (7, 20)}
    print_tables(comparison_tables(study, plans))
    throughput = by_arms(2 if quick else 12, seed)
    trace = trace_of(machine, exact, study, throughput)
    picture = segmentation(sample_image(machine, picture_rng), picture_rng)
    result = verdicts_of(machine, exact, errors, trace, np.random.default_rng(of_equations))
    points = verdicts.pick_points(PAPER["section4_2"]["pick_point"], pick_points(machine, exact), reach)
    result["equations"]["pick points"] = points
    result["figures"] = dict(sorted((result["figures"] | {"5": figure_5(picture)}).items()))
    recovery = {name: measures["recovery"] for name, measures in study.images.items()}
    result["experiments"] = {
        "46 of 56": prediction(PAPER["picking"], drawn),
        "own eyes": verdicts.own_eyes(PAPER["picking"], recovery, lab.canopy, vision, images),
    }
    *tables, figures = sections(result)
    print_tables([part for section in (*tables, figures) for part in section.parts])
    print(headline(result))
    dense = max(study.trees["optimised"], key=lambda h: max(len(r.fruit) for r in h.rounds))
    with recorded_run(out, "harvest", command, seed) as run:
        save_part(out, trace, seed)
        shared = {d.name: d for d in harvest_report.drawings(run)}
        shown = drawings(machine, picture, result, shared["workspace"], shared["joint_curves"])
        for path in write_drawings([*shared.values(), *shown[:2], shown[-1]], out / "figures"):
            print(f"figure {path}")
        print(f"recording {inspect_harvest(machine, dense, out / 'zone.rrd')}")
        print(f"report {write_text(out / 'report.html', harvest_report.page(run))}")
        page = write_page(
            out / "reproduction.html",
            "Li et al. 2016, reproduced in simulation",
            "An apple machine with three slave arms: the paper beside ours, and why they differ",
            result,
            NOTES,
            [*tables, Section("Figures", [*figures.parts, *shown])],
            {"Reproduce": command},
        )
        print(f"page {page}")
    if json_file is not None:
        whole = {**result, "simulated": True, **report(study, plans, throughput)}
        write_text(json_file, json.dumps(whole, indent=2) + "\n")
    print(f"{time.perf_counter() - begin:.0f} s")


def verdicts_of(
    machine: Machine, exact: Machine, errors: Mapping[str, Array], trace: HarvestTrace, rng: np.random.Generator
) -> dict[str, dict[str, Any]]:
    """Verdicts on tables, equations and figures, each by name."""
    by_spacing = {spacing: displacements(spacing * 1e-3) for spacing in (300, 350, 450)}
    lifts = [machine.d1 + ends[[1, 3]].sum() for ends in (machine.lower, machine.upper)]
    low, high = (float((lift + machine.base_height) * 1e3) for lift in lifts)
    # As printed: d2 from 720 and d4 from 0 mm, on top of frame 1.
    literal = [float((machine.d1 + machine.base_height) * 1e3 + d2 + d4) for d2, d4 in ((720, 0), (2220, 600))]
    joints = rng.uniform(machine.lower, machine.upper, (20_000, machine.joints))
    cloud = machine.tips(joints[:, :3], joints[:, 3:].reshape(-1, machine.arms, 3)) * 1e3
    headings = np.repeat(np.degrees(joints[:, 0]) + 90.0, machine.arms)
    # Curves stand arm by arm, three joints each, in Table 2's order for the master: theta, z, r.
    last = [curve[-1] * (1.0 if "theta" in name else 1e3) for name, curve in trace.curves[1].items()]
    ends = {name: [float(v) for v in last[3 * i : 3 * i + 3]] for i, name in enumerate(PAPER["table2"])}
    theta = PAPER["figure2"]["theta_deg"]
    length = float(1e3 * (machine.master.nominal.upper[2] + machine.a4 + machine.slave.upper[2]))
    return {
        "tables": {
            "1": verdicts.table_1((low, high), (literal[0], literal[1])),
            "2": verdicts.table_2(PAPER["table2"], by_spacing),
            "3": verdicts.table_3(PAPER["table3"], errors, ("master", *ARMS)),
        },
        "equations": equations(machine, exact, rng),
        "figures": {
            "2": verdicts.figure_2(PAPER, length, (low, high), reached_in_area(machine, target_area()[2], theta)),
            "8": verdicts.figure_8(cloud.reshape(-1, 3), headings, theta),
            "9": verdicts.figure_9(PAPER["table2"], ends, round(EXACT * 1e3)),
        },
    }


if __name__ == "__main__":
    typer.run(main)
