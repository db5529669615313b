"""The machine by the paper's way and better ones: its arms calibrated, the same trees worked, zones planned."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from papers.li2016.cp_sat import cp_sat
from papers.li2016.equations import ARMS, section_4_2
from papers.li2016.lab import sample_image, work_images
from papers.li2016.worth import funnel_shares, summary
from papers.pages import table
from pickenv.arm import Array, Plant
from pickenv.base import InputError
from pickenv.calibration import fit, random_joints, simulated_tracker
from pickenv.harvester import (
    Controller,
    Harvest,
    Machine,
    Measure,
    Strategy,
    TrueMachine,
    assign,
    funnel,
    load_grid,
    load_machine,
    load_orchard,
    load_picking,
    load_true_machine,
    lower_bound,
    pick_point,
    profile,
    timetable,
    travel_time,
    ultrasonic_hold,
    work_trees,
    zone_work,
)
from pickenv.inspect.reports.report_page import PageTable
from pickenv.inspect.runs.traces import HarvestTrace, picked_tree

POSES = 60
SEED = 2016
DENSITIES = (12.0, 40.0)
"""Fruit per metre of row for the throughput by arms: a thin row, and a heavy crop."""
CLOUD = 4000
"""Points of the workspace cloud."""


def displacements(spacing: float) -> dict[str, Array]:
    """Joint displacements of section 4.2 for a slave spacing, in Table 2's units and order (mm, rad)."""
    machine = load_machine(spacing=spacing)
    master, slaves = section_4_2(machine)
    moved = (slaves - machine.slave_home) * (1e3, 1, 1e3)
    return {"master": (master - machine.master_start) * (1, 1e3, 1e3), **dict(zip(ARMS, moved, strict=True))}


def joint_curves(machine: Machine, start: ArrayLike, end: ArrayLike, count: int = 101) -> tuple[Array, Array]:
    """Displacement of all joints over time, master first and then the slaves together, as in Fig. 9.

    Args:
        machine: The machine.
        start: Joints of the whole machine, (3 + 3 arms,).
        end: Joints at the end.
        count: Number of times.

    Returns:
        Times (count,), s, and displacements from the start (count, 3 + 3 arms), rad or m.
    """
    start, end = np.asarray(start, dtype=float), np.asarray(end, dtype=float)
    distance = end - start
    acceleration = np.concatenate([machine.master_acceleration, *[machine.slave_acceleration] * machine.arms])
    times = travel_time(distance, machine.speed, acceleration)
    begin = np.concatenate([np.zeros(3), np.full(machine.joints - 3, times[:3].max())])
    t = np.linspace(0.0, float((begin + times).max()), count)
    return t, profile(t[:, None] - begin, distance, machine.speed, acceleration)


def workspace(machine: Machine, count: int, rng: np.random.Generator) -> Array:
    """Cups of all slaves at joints drawn evenly within the limits: Fig. 8, (count, arms, 3)."""
    joints = rng.uniform(machine.lower, machine.upper, (count, machine.joints))
    return machine.tips(joints[:, :3], joints[:, 3:].reshape(count, machine.arms, 3))


def curves(machine: Machine) -> tuple[Array, dict[str, Array], tuple[str, ...]]:
    """Fig. 9: times, joint displacements of section 4.2 by name with the machine's own spacing, and names that turn."""
    master, slaves = section_4_2(machine)
    start = np.concatenate([machine.master_start, *[machine.slave_home] * machine.arms])
    goal = np.concatenate([master, slaves.clip(machine.slave.lower, machine.slave.upper).ravel()])
    time, moved = joint_curves(machine, start, goal)
    names = [f"master {joint}" for joint in ("theta1", "d2", "d3")]
    names += [f"{arm} {joint}" for arm in ARMS for joint in ("d4", "theta5", "d6")]
    turning = tuple(name for name in names if "theta" in name)
    return time, dict(zip(names, moved.T, strict=True)), turning


def calibrated_controller(true: TrueMachine, rng: np.random.Generator, *, positions_only: bool = False) -> Controller:
    """Measure the master and each slave with the tracker, identify them, and believe the result."""

    def believed(plant: Plant) -> Callable[[Array], Array]:
        measured = simulated_tracker(plant, random_joints(plant.arm.nominal, POSES, rng), rng)
        return fit(plant.arm, measured.positions_only() if positions_only else measured).calibration.compensator()

    return Controller(true.machine, believed(true.master), tuple(believed(plant) for plant in true.slaves))


def tip_errors(true: TrueMachine, controller: Controller, masters: Sequence[ArrayLike] | Array, slaves: Array) -> Array:
    """Errors of frame 3 and all cups, (poses, 1 + arms, 3) m, for nominal joints (poses, 3) and (poses, arms, 3)."""
    masters = np.asarray(masters, dtype=float)
    joints = np.concatenate([masters, slaves.reshape(len(masters), -1)], axis=-1)
    commands = controller(joints)
    cups = true.tips(commands[:, :3], commands[:, 3:].reshape(slaves.shape)) - true.machine.tips(masters, slaves)
    frame = true.frame3(commands[:, :3]).position - true.machine.frame3(masters)
    return np.concatenate([frame[:, None], cups], axis=1)


def run_errors(true: TrueMachine, controller: Controller, runs: int, rng: np.random.Generator) -> Array:
    """Position errors in mm of frame 3 and the cups in ``runs`` zones of the lab ``(runs, 1 + arms)``."""
    machine = true.machine
    masters = np.array([pick_point(machine, sample_image(machine, rng).fruit) for _ in range(runs)])
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
class Comparison:
    """Strategies on the same trees and images, and zones planned by each method.

    Attributes:
        trees: Harvests of trees by strategy.
        measures: Their measures by strategy.
        images: Measures of Li's experiment by strategy.
    """

    trees: dict[str, list[Harvest]]
    measures: dict[str, dict[str, Measure]]
    images: dict[str, dict[str, Measure]]


def compare(
    true: TrueMachine, ways: list[Strategy], trees: int, images: int, workers: int, vision: str, seed: int
) -> Comparison:
    """The same trees, leafy, and images of Li's bare tree under each strategy, seen as ``vision`` says."""
    model, orchard, grid = load_picking(), load_orchard(), load_grid()
    worked, pictured = {}, {}
    for way in ways:
        words = {"vision": vision, "seed": seed}
        worked[way.name] = work_trees(true, way, model, orchard, grid, count=trees, workers=workers, **words)
        pictured[way.name] = work_images(true, way, model, count=images, **words)
    measures, shares = (
        {name: summary(true.machine, harvests) for name, harvests in done.items()} for done in (worked, pictured)
    )
    return Comparison(worked, measures, shares)


def assignments(machine: Machine, zones: int, fruit: int, rng: np.random.Generator) -> dict[str, float]:
    """Mean makespan by method, s, over zones of ``fruit`` fruit; with the lower bound."""
    names = ("li", "columns", "nearest", "hungarian", "search", "cp-sat")
    makespans = dict.fromkeys(("lower bound", *names), 0.0)
    for _ in range(zones):
        corner = np.array([rng.uniform(-0.9, 0.9) - 0.35, -1.4, rng.uniform(0.42, 1.87)])
        places = corner + np.array([0.7, 0.4, 0.55]) * rng.random((fruit, 3))
        work = zone_work(machine, pick_point(machine, places), places)
        makespans["lower bound"] += lower_bound(work) / zones
        for name in names:
            try:
                hold = ultrasonic_hold(machine, work, rng) if name == "li" else None
                plan = cp_sat(work) if name == "cp-sat" else assign(work, name)
                makespans[name] += timetable(work, plan, hold=hold).makespan / zones
            except InputError:  # OR-Tools is an extra
                makespans[name] = float("nan")
    return makespans


def by_arms(trees: int, seed: int) -> dict[str, dict[int, Measure]]:
    """Picks per hour by number of slave arms, machine and fruit perfectly known and zones as wide as the machine."""

    def picks_per_hour(density: float, count: int) -> Measure:
        true = load_true_machine(load_machine(slaves=count)).ideal()
        grid = replace(load_grid(), columns=int(np.ceil(2.5 / (0.15 + count * true.machine.spacing))))
        way = strategies(Controller(true.machine), Controller(true.machine))[-1]
        orchard = load_orchard(per_metre=density)
        done = work_trees(true, way, load_picking(), orchard, grid, count=trees, seed=seed, vision="ideal")
        return summary(true.machine, done)["picks_per_hour"]

    return {
        f"{density:g} fruit per metre of row": {count: picks_per_hour(density, count) for count in range(1, 7)}
        for density in DENSITIES
    }


def trace_of(
    machine: Machine, exact: Machine, study: Comparison, throughput: Mapping[str, Mapping[int, Measure]]
) -> HarvestTrace:
    """The trace of the comparison; one tree of each strategy is kept, and the curves are those of ``exact``."""
    return HarvestTrace(
        trees={name: picked_tree(harvests[0]) for name, harvests in study.trees.items()},
        funnels={name: funnel(harvests) for name, harvests in study.trees.items()},
        measures=study.measures,
        throughput=throughput,
        cloud=workspace(machine, CLOUD, np.random.default_rng(0)),
        curves=curves(exact),
        tree_count=len(next(iter(study.trees.values()))),
    )


def comparison_tables(study: Comparison, plans: Mapping[int, Mapping[str, float]]) -> list[PageTable]:
    """What calibration, pick points and assignment are worth."""

    def beside(head: str, columns: Mapping[str, Mapping[str, Any]], end: str = "") -> list[dict[str, str]]:
        first = next(iter(columns.values()))
        return [{head: key + end} | {name: str(values[key]) for name, values in columns.items()} for key in first]

    title = "The same trees; 95 % intervals over trees where there are ten or more"
    counts = {name: funnel(harvests) for name, harvests in study.trees.items()}
    shares = {name: funnel_shares(harvests) for name, harvests in study.trees.items()}
    makespans = [
        {"assignment": name} | {f"{fruit} fruit": plan[name] for fruit, plan in plans.items()}
        for name in next(iter(plans.values()))
    ]
    return [
        table(title, beside("measure", study.measures)),
        table("Funnel, fruit of all trees", beside("stage", counts) + beside("stage", shares, ", share")),
        table("Mean makespan of a zone, s", makespans, form=".2f"),
    ]


def report(
    study: Comparison, plans: Mapping[int, Mapping[str, float]], throughput: Mapping[str, Mapping[int, Measure]]
) -> dict[str, Any]:
    """The numbers as JSON; rates of recovery are those of Li's experiment, picks per hour those of the trees."""

    def spans(measures: Mapping[Any, Measure]) -> dict[Any, list[float | None]]:
        return {key: [m.value, m.low, m.high] for key, m in measures.items()}

    recovery = {}
    for name, measures in study.measures.items():
        images, harvests = study.images[name], study.trees[name]
        rate, *ends = spans(images)["recovery"]
        recovery[name] = {
            "rate": rate,
            "ci95": ends,
            "picks_per_hour": measures["picks_per_hour"].value,
            "collisions": int(measures["collisions"].value + images["collisions"].value),
            "trees": spans(measures),
            "funnel": funnel(harvests),
            "funnel_shares": spans(funnel_shares(harvests)),
        }
    return {
        "recovery": recovery,
        "makespan_s": plans,
        "picks_per_hour_by_arms": {label: spans(measures) for label, measures in throughput.items()},
        "trees": len(next(iter(study.trees.values()))),
    }
