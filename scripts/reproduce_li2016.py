"""Li et al. 2016, number by number: printed in the paper, found here, and why they differ; then better than the paper.

Tables 1 to 3, Figs 2, 5, 8 and 9, eqs (1) to (12), pick points and the recovery experiment of an apple machine with
three slave arms; then the same simulated trees with calibration, better pick points and better assignment. Simulated
throughout: the paper's machine is not at hand.

Each table, figure, equation and the experiment has a verdict (reproduced, not reproduced, fitted) with its reason;
`--json` holds {"tables": {"2": {"verdict", "reason", "rows"}, …}, "figures": {…}, "equations", "experiments"}. The 46
of 56 apples are a prediction over the constants that the paper leaves open (`papers.li2016_prediction`), and beside it
stands what the machine recovers with stereo eyes of its own.

Run: python scripts/reproduce_li2016.py [--json FILE] [--quick] [--trees N] [--sessions N] [--out FOLDER]
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer
from papers import li2016_verdicts as verdicts
from papers.li2016_equations import PAPER, equations, pick_points, reach_shares
from papers.li2016_figures import reached_in_area, recovered, segmentation_steps, target_area, work_area
from papers.li2016_page import print_li_tables, write_li_page
from papers.li2016_prediction import prediction, sessions
from papers.li2016_segmentation import Segmentation, figure_5, segmentation
from papers.li2016_trace import trace_of
from rich.console import Console
from rich.progress import Progress
from rich.table import Table

from pickenv.arm import Plant
from pickenv.arm.kinematics.geometry import Array
from pickenv.calibration import Calibration, fit, random_joints, simulated_tracker
from pickenv.errors import InputError
from pickenv.files import write_text
from pickenv.harvester.arm_paths import ultrasonic_hold
from pickenv.harvester.harvest import Harvest, Strategy
from pickenv.harvester.harvest_summary import Measure, funnel, funnel_shares, summary
from pickenv.harvester.machine import Machine, load_machine
from pickenv.harvester.optimiser import assign
from pickenv.harvester.pick_point import pick_point
from pickenv.harvester.picking import load_picking
from pickenv.harvester.rules import lower_bound
from pickenv.harvester.strategies import work_images, work_trees
from pickenv.harvester.trees import load_lab, load_orchard, sample_image
from pickenv.harvester.true_machine import Controller, TrueMachine, load_true_machine, tip_errors
from pickenv.harvester.work import timetable, zone_work
from pickenv.harvester.zones import load_grid
from pickenv.inspect.figures.run_drawings import Drawing, write_drawings
from pickenv.inspect.recordings.harvest_recording import inspect_harvest
from pickenv.inspect.reports.harvest_report import drawings, page
from pickenv.inspect.runs.harvest_trace import HarvestTrace
from pickenv.inspect.runs.run_folder import recorded_run, save_part
from pickenv.orchard import VISIONS

ARMS = ("left", "middle", "right")
TARGETS_MM = {name: tuple(PAPER["section4_2"][f"{name}_target"]) for name in ARMS}
PICK_POINT_MM = tuple(PAPER["section4_2"]["pick_point"])
TABLE2, TABLE3_MM = PAPER["table2"], PAPER["table3"]
POSES = 60
SEED = 2016
EXACT = 0.45
"""m between slaves, for which Table 2 is exact."""
DENSITIES = (12.0, 40.0)
"""Fruit per metre of row for the throughput by arms: a thin row, and a heavy crop."""


def table2(spacing: float) -> dict[str, Array]:
    """Joint displacements of section 4.2 for a slave spacing, in the paper's units and order (mm, rad)."""
    machine = load_machine(spacing=spacing)
    master = machine.master_inverse(np.array(PICK_POINT_MM) * 1e-3)
    moved = (master - machine.master_start) * (1, 1e3, 1e3)
    joints = machine.slave_inverse(master, np.array(list(TARGETS_MM.values())) * 1e-3)
    found = {"master": moved}
    for i, name in enumerate(ARMS):
        found[name] = (joints[i, i] - machine.slave_home) * (1e3, 1, 1e3)
    return found


def calibrated_controller(true: TrueMachine, rng: np.random.Generator, *, positions_only: bool = False) -> Controller:
    """Measure the master and each slave with the tracker, identify them, and believe the result."""

    def believed(plant: Plant) -> Any:
        measured = simulated_tracker(plant, random_joints(plant.arm.nominal, POSES, rng), rng)
        found: Calibration = fit(plant.arm, measured.positions_only() if positions_only else measured).calibration
        return found.compensator()

    return Controller(true.machine, believed(true.master), tuple(believed(plant) for plant in true.slaves))


def table3(true: TrueMachine, controller: Controller, runs: int, rng: np.random.Generator) -> Array:
    """Position errors in mm of frame 3 and the cups in ``runs`` zones of the lab, (runs, 1 + arms)."""
    machine = true.machine
    masters = np.array([pick_point(machine, sample_image(machine, rng).fruit).master for _ in range(runs)])
    slaves = rng.uniform(machine.slave.lower, machine.slave.upper, (runs, machine.arms, 3))
    spread = rng.normal(size=(runs, 1 + machine.arms, 3)) * true.repeatability
    return np.linalg.norm(tip_errors(true, controller, masters, slaves) + spread, axis=-1) * 1e3


def strategies(raw: Controller, calibrated: Controller) -> list[Strategy]:
    """From the paper's way to the best, one step at a time; the last reads its pictures better."""
    return [
        Strategy("raw", raw),
        Strategy("calibrated", calibrated),
        Strategy("points", calibrated, pick_point="search"),
        Strategy("assigned", calibrated, "search", "search", guard=False),
        Strategy("optimised", calibrated, "search", "search", guard=False, looks=2, unload_full=True),
        Strategy("circles", calibrated, "search", "search", False, looks=2, unload_full=True, detector="circles"),
    ]


@dataclass(frozen=True)
class Study:
    """What the comparison found.

    Attributes:
        trees: Harvests of trees by strategy.
        measures: Their measures by strategy.
        images: Measures of Li's experiment by strategy.
    """

    trees: dict[str, list[Harvest]]
    measures: dict[str, dict[str, Measure]]
    images: dict[str, dict[str, Measure]]


def compare(
    true: TrueMachine, ways: list[Strategy], trees: int, images: int, workers: int, vision: str = "measured_errors"
) -> Study:
    """The same trees, leafy, and images of Li's bare tree under each strategy, seen as ``vision`` says."""
    model, orchard, grid = load_picking(), load_orchard(), load_grid()
    worked, measures, seen = {}, {}, {}
    for way in ways:
        shown = {"vision": vision, "seed": SEED}
        worked[way.name] = work_trees(true, way, model, orchard, grid, count=trees, workers=workers, **shown)
        measures[way.name] = summary(true.machine, worked[way.name])
        seen[way.name] = summary(true.machine, work_images(true, way, model, count=images, **shown))
    return Study(worked, measures, seen)


def assignments(machine: Machine, zones: int, fruit: int, rng: np.random.Generator) -> dict[str, float]:
    """Mean makespan by method, s, over zones of ``fruit`` fruit; with the lower bound."""
    names = ("li", "columns", "nearest", "hungarian", "search", "cp-sat")
    found = dict.fromkeys(("lower bound", *names), 0.0)
    for _ in range(zones):
        corner = np.array([rng.uniform(-0.9, 0.9) - 0.35, -1.4, rng.uniform(0.42, 1.87)])
        places = corner + np.array([0.7, 0.4, 0.55]) * rng.random((fruit, 3))
        work = zone_work(machine, pick_point(machine, places).master, places)
        found["lower bound"] += lower_bound(work) / zones
        for name in names:
            try:
                hold = ultrasonic_hold(machine, work, rng) if name == "li" else None
                found[name] += timetable(work, assign(work, name), hold=hold).makespan / zones
            except InputError:  # OR-Tools is an extra
                found[name] = float("nan")
    return found


def our_comparison(console: Console, study: Study, plans: dict[int, dict[str, float]]) -> None:
    """What calibration, pick points and assignment are worth."""
    table = Table(
        "measure", *study.measures, title="The same trees; 95 % intervals over trees where there are ten or more"
    )
    for key in study.measures["raw"]:
        table.add_row(key, *(str(measures[key]) for measures in study.measures.values()))
    console.print(table)
    table = Table("stage", *study.trees, title="Funnel, fruit of all trees")
    for stage in funnel(study.trees["raw"]):
        table.add_row(stage, *(str(funnel(harvests)[stage]) for harvests in study.trees.values()))
    for stage in funnel(study.trees["raw"]):
        table.add_row(f"{stage}, share", *(str(funnel_shares(harvests)[stage]) for harvests in study.trees.values()))
    console.print(table)
    table = Table("assignment", *(f"{n} fruit" for n in plans), title="Mean makespan of a zone, s")
    for name in plans[next(iter(plans))]:
        table.add_row(name, *(f"{plan[name]:.2f}" for plan in plans.values()))
    console.print(table)


def by_arms(trees: int) -> dict[str, dict[int, Measure]]:
    """Picks per hour by number of slave arms, machine and fruit perfectly known and zones as wide as the machine."""
    found: dict[str, dict[int, Measure]] = {}
    for density in DENSITIES:
        label = f"{density:g} fruit per metre of row"
        found[label] = {}
        for count in range(1, 7):
            true = load_true_machine(load_machine(slaves=count)).ideal()
            grid = replace(load_grid(), columns=int(np.ceil(2.5 / (0.15 + count * true.machine.spacing))))
            way = strategies(Controller(true.machine), Controller(true.machine))[-1]
            orchard = load_orchard(per_metre=density)
            done = work_trees(true, way, load_picking(), orchard, grid, count=trees, seed=SEED, vision="ideal")
            found[label][count] = summary(true.machine, done)["picks_per_hour"]
    return found


def main(
    json_file: Annotated[Path | None, typer.Option("--json", help="Write the numbers here.")] = None,
    quick: Annotated[bool, typer.Option(help="Few trees and sessions: to see that it runs.")] = False,
    trees: Annotated[int, typer.Option(min=1, help="Simulated trees.")] = 200,
    count: Annotated[int, typer.Option("--sessions", min=40, help="Sessions of the experiment.")] = 1000,
    out: Annotated[Path, typer.Option(help="Folder of figures and the recording.")] = Path("runs/li2016"),
    workers: Annotated[int, typer.Option(min=1, help="Processes.")] = 2,
    vision: Annotated[str, typer.Option(help="How fruit is seen: measured_errors, rendered or ideal.")] = VISIONS[1],
) -> None:
    """Print the tables, draw the figures, write the recording and the JSON."""
    console, begin = Console(width=160), time.perf_counter()
    trees, images, count = (min(trees, 12), 40, min(count, 100)) if quick else (trees, 400, count)
    of_rest, of_equations, of_picture, of_sessions = np.random.SeedSequence(SEED).spawn(4)
    rng, machine = np.random.default_rng(of_rest), load_machine()
    exact = load_machine(spacing=EXACT)  # Fig. 9 is of section 4.2, as Table 2 is
    true = load_true_machine(machine)
    raw, calibrated = Controller(machine), calibrated_controller(true, rng)
    known = {"raw": raw, "calibrated": calibrated}
    known["positions only"] = calibrated_controller(true, rng, positions_only=True)
    errors = {name: table3(true, way, load_lab().runs, rng) for name, way in known.items()}
    with Progress() as bars:
        task = bars.add_task("56 apples", total=count)
        found = sessions(true, Strategy("raw", raw), count, of_sessions, lambda: bars.advance(task))
    study = compare(true, strategies(raw, calibrated), trees, images, workers, vision)
    reach = reach_shares(machine, 20 if quick else 200, rng)
    plans = {n: assignments(machine, 2 if quick else 10, n, rng) for n in (7, 20)}
    our_comparison(console, study, plans)
    throughput = by_arms(2 if quick else 12)
    trace = trace_of(machine, exact, study.trees, study.measures, throughput, TARGETS_MM, PICK_POINT_MM)
    picture_rng = np.random.default_rng(of_picture)
    picture = segmentation(sample_image(machine, picture_rng), picture_rng)
    judged = verdicts_of(machine, errors, trace, np.random.default_rng(of_equations))
    judged["equations"]["pick points"] = verdicts.pick_points(
        PICK_POINT_MM, pick_points(machine, exact, np.array(list(TARGETS_MM.values())) * 1e-3), reach
    )
    judged["figures"] = dict(sorted((judged["figures"] | {"5": figure_5(picture)}).items()))
    judged["experiments"] = {
        "46 of 56": prediction(PAPER["picking"], found),
        "own eyes": verdicts.own_eyes(
            PAPER["picking"],
            {name: measures["recovery"] for name, measures in study.images.items()},
            load_lab().canopy,
            vision,
            images,
        ),
    }
    print_li_tables(console, judged)
    dense = max(study.trees["optimised"], key=lambda h: max(len(r.fruit) for r in h.rounds))
    command = "python scripts/reproduce_li2016.py"
    command += " --quick" if quick else f" --trees {trees} --sessions {count}"
    command += "" if vision == VISIONS[1] else f" --vision {vision}"
    with recorded_run(out, "harvest", command, SEED) as run:
        save_part(out, trace, SEED)
        shown = [d for d in drawings(run) if d.name in ("workspace", "joint_curves")]
        shown = figures_of(machine, picture, judged, shown)
        for path in write_drawings([*drawings(run), *shown[:2], shown[-1]], out / "figures"):
            console.print(f"figure {path}")
        console.print(f"recording {inspect_harvest(machine, dense, out / 'zone.rrd')}")
        console.print(f"report {write_text(out / 'report.html', page(run))}")
        console.print(f"page {write_li_page(judged, shown, command, out / 'reproduction.html')}")
    if json_file is not None:
        whole = {**judged, "simulated": True, **report(study, plans, throughput, trees)}
        write_text(json_file, json.dumps(whole, indent=2) + "\n")
    console.print(f"{time.perf_counter() - begin:.0f} s")


def figures_of(
    machine: Machine, picture: Segmentation, judged: dict[str, dict[str, Any]], shared: list[Drawing]
) -> list[Drawing]:
    """Figures 2, 5, 8 and 9 with their verdicts, and the prediction of the experiment."""
    figures, experiment = judged["figures"], judged["experiments"]["46 of 56"]

    def titled(number: str, text: str) -> str:
        return f"Figure {number} ({figures[number]['verdict']}): {text}"

    cloud, curves = shared
    return [
        Drawing("work_area", titled("2", "the area that the machine is made for."), lambda: work_area(machine, PAPER)),
        Drawing(
            "segmentation",
            titled("5", "from a picture to centroids, on a rendered picture."),
            lambda: segmentation_steps(picture),
        ),
        replace(cloud, caption=titled("8", cloud.caption)),
        replace(curves, caption=titled("9", f"{curves.caption} Slaves {1e3 * EXACT:.0f} mm apart.")),
        Drawing(
            "prediction",
            f"The experiment ({experiment['verdict']}): what sessions recover over the open constants.",
            lambda: recovered(experiment),
        ),
    ]


def verdicts_of(
    machine: Machine, errors: dict[str, Array], trace: HarvestTrace, rng: np.random.Generator
) -> dict[str, dict[str, Any]]:
    """Verdicts on tables, equations and figures, each by name."""
    by_spacing = {spacing: table2(spacing * 1e-3) for spacing in (300, 350, 450)}
    lifts = [machine.d1 + ends[[1, 3]].sum() for ends in (machine.lower, machine.upper)]
    low, high = (float((lift + machine.base_height) * 1e3) for lift in lifts)
    # As printed: d2 from 720 and d4 from 0 mm, on top of frame 1.
    literal = [float((machine.d1 + machine.base_height) * 1e3 + d2 + d4) for d2, d4 in ((720, 0), (2220, 600))]
    joints = rng.uniform(machine.lower, machine.upper, (20_000, machine.joints))
    cloud = machine.tips(joints[:, :3], joints[:, 3:].reshape(-1, machine.arms, 3)) * 1e3
    headings = np.repeat(np.degrees(joints[:, 0]) + 90.0, machine.arms)
    # Curves stand arm by arm, three joints each, in Table 2's order for the master: theta, z, r.
    last = [curve[-1] * (1.0 if "theta" in name else 1e3) for name, curve in trace.curves.moved.items()]
    ends = {name: [float(v) for v in last[3 * i : 3 * i + 3]] for i, name in enumerate(TABLE2)}
    theta = PAPER["figure2"]["theta_deg"]
    length = float(1e3 * (machine.master.nominal.upper[2] + machine.a4 + machine.slave.upper[2]))
    return {
        "tables": {
            "1": verdicts.table_1((low, high), (literal[0], literal[1])),
            "2": verdicts.table_2(TABLE2, by_spacing),
            "3": verdicts.table_3(TABLE3_MM, errors, ("master", *ARMS)),
        },
        "equations": equations(machine, load_machine(spacing=EXACT), rng),
        "figures": {
            "2": verdicts.figure_2(PAPER, length, (low, high), reached_in_area(machine, target_area(PAPER)[2], theta)),
            "8": verdicts.figure_8(cloud.reshape(-1, 3), headings, theta),
            "9": verdicts.figure_9(TABLE2, ends, round(EXACT * 1e3)),
        },
    }


def report(
    study: Study,
    plans: dict[int, dict[str, float]],
    throughput: dict[str, dict[int, Measure]],
    trees: int,
) -> dict[str, Any]:
    """The numbers as JSON; rates of recovery are those of Li's experiment, picks per hour those of the trees."""
    recovery = {}
    for name in study.measures:
        images, measures = study.images[name]["recovery"], study.measures[name]
        recovery[name] = {
            "rate": images.value,
            "ci95": [images.low, images.high],
            "picks_per_hour": measures["picks_per_hour"].value,
            "collisions": int(measures["collisions"].value + study.images[name]["collisions"].value),
            "trees": {key: [m.value, m.low, m.high] for key, m in measures.items()},
            "funnel": funnel(study.trees[name]),
            "funnel_shares": {key: [m.value, m.low, m.high] for key, m in funnel_shares(study.trees[name]).items()},
        }
    return {
        "recovery": recovery,
        "makespan_s": plans,
        "picks_per_hour_by_arms": {
            label: {n: [m.value, m.low, m.high] for n, m in measures.items()} for label, measures in throughput.items()
        },
        "trees": trees,
    }


if __name__ == "__main__":
    typer.run(main)
