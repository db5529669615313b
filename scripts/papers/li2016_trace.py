"""What the reproduction of Li 2016 leaves for its figures: trees, funnels, throughput, workspace and joint curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pickenv.harvester.harvest import Harvest
from pickenv.harvester.harvest_summary import Measure, funnel
from pickenv.harvester.joint_motion import joint_curves, workspace
from pickenv.harvester.machine import Machine
from pickenv.inspect.runs.harvest_trace import HarvestTrace, JointCurves, picked_tree

CLOUD = 4000
"""Points of the workspace cloud."""


def trace_of(
    machine: Machine,
    shown: Machine,
    trees: Mapping[str, Sequence[Harvest]],
    measures: Mapping[str, Mapping[str, Measure]],
    throughput: Mapping[str, Mapping[int, Measure]],
    targets_mm: Mapping[str, tuple[int, int, int]],
    pick_point_mm: tuple[int, int, int],
) -> HarvestTrace:
    """The trace of the comparison; one tree of each strategy is kept, and the curves are those of ``shown``."""
    return HarvestTrace(
        trees={name: picked_tree(harvests[0]) for name, harvests in trees.items()},
        funnels={name: funnel(harvests) for name, harvests in trees.items()},
        measures=measures,
        throughput=throughput,
        cloud=workspace(machine, CLOUD, np.random.default_rng(0)),
        curves=curves(shown, targets_mm, pick_point_mm),
        tree_count=len(next(iter(trees.values()))),
    )


def curves(
    machine: Machine, targets_mm: Mapping[str, tuple[int, int, int]], pick_point_mm: tuple[int, int, int]
) -> JointCurves:
    """Fig. 9: joint displacements of section 4.2 over time, with the machine's own spacing."""
    master = machine.master_inverse(np.array(pick_point_mm) * 1e-3)
    joints = machine.slave_inverse(master, np.array(list(targets_mm.values())) * 1e-3)
    goal = np.array([joints[i, i].clip(machine.slave.lower, machine.slave.upper) for i in range(machine.arms)])
    start = np.concatenate([machine.master_start, *[machine.slave_home] * machine.arms])
    time, moved = joint_curves(machine, start, np.concatenate([master, goal.ravel()]))
    names = [f"master {joint}" for joint in ("theta1", "d2", "d3")]
    names += [f"{arm} {joint}" for arm in targets_mm for joint in ("d4", "theta5", "d6")]
    turning = tuple(name for name in names if "theta" in name)
    return JointCurves(time, dict(zip(names, moved.T, strict=True)), turning)
