"""Write a harvested zone as a Rerun recording: moving machine, outcomes of fruit, Gantt lanes and arm distances.

The time line is `sim_time`, the time in the zone, s. Units: m in space, mm on plots.
"""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from pickenv.arm import Array
from pickenv.base import InputError
from pickenv.harvester import Harvest, Machine
from pickenv.harvester.harvest_run import Round
from pickenv.harvester.machine import master_time, profile
from pickenv.harvester.work import arm_distances, slave_joints_at
from pickenv.inspect.colours import FRUIT, GREEN, GREY, RED, STEEL, Rgb, arm_colour
from pickenv.inspect.recordings.scribe import Scribe, f32, layout, seen_from, view_of, write_recording

STEP = 0.05
"""Time between two recorded moments, s."""
FATES: dict[str, Rgb] = {"hanging": FRUIT, "collected": GREEN, "missed": RED}
COLUMN_RADIUS, BOOM_RADIUS, FRUIT_RADIUS = 0.03, 0.02, 0.03
"""Radii as drawn, m."""


def inspect_harvest(machine: Machine, harvest: Harvest, path: str | Path) -> Path:
    """Write a recording of the round with the most picks on a harvested tree.

    A round is a picture of a zone and the picks that follow from it.

    Args:
        machine: The harvester.
        harvest: The harvest of one tree.
        path: The file to write (.rrd).

    Returns:
        The path written.

    Raises:
        InputError: If no round took place on the tree, or the file cannot be written.
    """
    if not harvest.rounds:
        raise InputError("the harvest has no round, so there is no zone to show; harvest a tree with fruit in reach")
    busiest = max(harvest.rounds, key=lambda item: len(item.fruit))
    zone = busiest.zone.name.replace(",", "").replace(" ", "_")
    fruit = harvest.tree.fruit[busiest.zone.holds(harvest.tree.fruit)]
    masters = np.stack([machine.master_start, busiest.master])
    resting = machine.tips(masters, np.broadcast_to(machine.slave_home, (2, machine.arms, 3))).reshape(-1, 3)
    return write_recording(
        path,
        f"harvest-{zone}",
        _blueprint(np.concatenate([fruit, resting]), machine.frame3(busiest.master), machine.arms),
        lambda stream: _send(stream, machine, harvest, busiest),
    )


def _send(stream: rr.RecordingStream, machine: Machine, harvest: Harvest, shown: Round) -> None:
    arrival = float(master_time(machine, machine.master_start, shown.master))
    at = np.arange(0.0, arrival + shown.times.makespan + 1.0, STEP)
    masters = machine.master_start + profile(
        at[:, None], shown.master - machine.master_start, machine.master.speed, machine.master_acceleration
    )
    slaves = slave_joints_at(machine, shown.work, shown.times, at - arrival)
    scribe = Scribe(stream, [rr.TimeColumn("sim_time", duration=at)])
    _send_machine(scribe, machine, masters, slaves)
    for arm in range(machine.arms):
        _send_lane(stream, arm, shown, arrival)
    _send_fruit(stream, harvest, shown, arrival)
    _send_distances(scribe, machine, slaves)


def _send_machine(scribe: Scribe, machine: Machine, masters: Array, slaves: Array) -> None:
    """Send column, boom with rail, and A slave arms, which move along the time lines.

    ``masters`` ``(T, 3)`` and ``slaves`` ``(T, A, 3)`` are the joints of master and slaves at each time, rad or m.
    """
    drawn_in = slaves.copy()
    drawn_in[..., 1:] = 0.0
    tips, pivots, frame = machine.tips(masters, slaves), machine.tips(masters, drawn_in), machine.frame3(masters)
    scribe.still("world", rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    pillar = [[[0.0, 0.0, 0.0], [0.0, 0.0, float(machine.upper[1]) + machine.d1]]]
    scribe.still("world/master/column", rr.LineStrips3D(pillar, colors=[STEEL], radii=[COLUMN_RADIUS]))
    rail = pivots[:, [0, -1]]
    rail[..., 2] = frame[:, None, 2]
    boom = np.concatenate([(frame * (0.0, 0.0, 1.0))[:, None], frame[:, None], rail], axis=1)
    _send_strip(scribe, "world/master/boom", boom, STEEL, BOOM_RADIUS)
    for arm in range(machine.arms):
        ends = np.stack([pivots[:, arm], tips[:, arm]], axis=1)
        _send_strip(scribe, f"world/slave_{arm + 1}", ends, arm_colour(arm), machine.body.radius / 2.0)


def _send_strip(scribe: Scribe, entity: str, points: Array, colour: Rgb, radius: float) -> None:
    scribe.still(entity, rr.LineStrips3D.from_fields(colors=[colour], radii=[radius]))
    scribe.along(entity, rr.LineStrips3D.columns(strips=list(f32(points))))


def _send_lane(stream: rr.RecordingStream, arm: int, shown: Round, arrival: float) -> None:
    """Send the lane of a slave arm in the Gantt chart, with the outcome of each pick.

    At each time the master carries the arm, or the arm travels, or it is out on a pick.

    Args:
        stream: The recording.
        arm: Index of the slave arm, from 0.
        shown: The round, that is a picture of a zone and the picks that follow.
        arrival: Time at which the master stands and picking begins, s.
    """
    mine = np.flatnonzero(shown.times.arm == arm)
    moments, states = [0.0, arrival], ["carried", "travel"]
    for pick in mine[np.argsort(shown.times.start[mine])]:
        moments += [arrival + float(shown.times.start[pick]), arrival + float(shown.times.end[pick])]
        states += ["collected" if shown.collected[pick] else "missed", "travel"]
    scribe = Scribe(stream, [rr.TimeColumn("sim_time", duration=np.array(moments))])
    looks = {"carried": ("carried", GREY), "travel": ("travel", STEEL)}
    looks |= {fate: (f"out, {fate}", FATES[fate]) for fate in ("collected", "missed")}
    scribe.lane(f"arms/slave_{arm + 1}", looks, states)


def _send_fruit(stream: rr.RecordingStream, harvest: Harvest, shown: Round, arrival: float) -> None:
    """Send the fruit that hangs in the zone when the round begins; each fruit changes colour when its pick ends.

    ``arrival`` is the time at which the master arm stands and picking begins, s.
    """
    gone = harvest.detached.copy()
    for later in harvest.rounds[harvest.rounds.index(shown) :]:
        gone[later.fruit[later.fruit >= 0]] = False
    numbers = np.flatnonzero(shown.zone.holds(harvest.tree.fruit) & ~gone)
    moments = np.concatenate([[0.0], arrival + np.sort(shown.times.end)])
    scribe = Scribe(stream, [rr.TimeColumn("sim_time", duration=moments)])
    places = rr.Points3D.from_fields(positions=f32(harvest.tree.fruit[numbers]), radii=[FRUIT_RADIUS] * len(numbers))
    scribe.still("world/fruit", places)
    changing = rr.Points3D.columns(colors=fates(shown, numbers, moments - arrival).reshape(-1, 3))
    scribe.along("world/fruit", changing.partition([len(numbers)] * len(moments)))


def fates(shown: Round, numbers: NDArray[np.intp], at: Array) -> NDArray[np.uint8]:
    """Return colours ``(T, F, 3)`` that show at each time whether each fruit hangs, was collected or was missed.

    Args:
        shown: The round, that is a picture of a zone and the picks that follow.
        numbers: Indices of the F fruit to show, among the tree's fruit ``(F,)``, from 0.
        at: Times since picking began ``(T,)``, s.
    """
    colours = np.broadcast_to(np.array(FATES["hanging"], dtype=np.uint8), (len(at), len(numbers), 3)).copy()
    place = {number: i for i, number in enumerate(numbers.tolist())}
    for pick, number in enumerate(shown.fruit.tolist()):
        if number in place:
            fate = "collected" if shown.collected[pick] else "missed"
            colours[at >= shown.times.end[pick], place[number]] = FATES[fate]
    return colours


def _send_distances(scribe: Scribe, machine: Machine, slaves: Array) -> None:
    """Send the distance between every two slave arms, mm, and the smallest distance allowed; nothing for one arm.

    ``slaves`` ``(T, A, 3)`` are the slaves' joints over time, rad or m.
    """
    if machine.arms < 2:
        return
    near = 1e3 * arm_distances(machine, slaves)
    for pair, (a, b) in enumerate(combinations(range(1, machine.arms + 1), 2)):
        scribe.curve(f"distance/{a}_{b}", f"slaves {a} and {b}", arm_colour(pair), near[:, pair])
    scribe.curve("distance/limit", "least allowed", RED, np.full(len(slaves), 1e3 * machine.body.clearance))


def _blueprint(shown: Array, frame: Array, arms: int) -> rrb.Blueprint:
    """Return the layout: a view of the machine from the side and from behind, then the lanes and the distances.

    Args:
        shown: Points that the eye must see ``(N, 3)``, m.
        frame: Position of the master arm's frame 3 while it stands ``(3,)``, m. The horizontal direction from the base
            to this frame is "ahead".
        arms: Number of slaves.
    """
    low, high = shown.min(axis=0), shown.max(axis=0)
    look, radius = (low + high) / 2.0, float(np.linalg.norm(high - low)) / 2.0
    ahead = frame * (1.0, 1.0, 0.0) / np.linalg.norm(frame[:2])
    eye = look + 1.8 * radius * (0.8 * np.array([ahead[1], -ahead[0], 0.0]) - 0.6 * ahead + (0.0, 0.0, 0.5))
    views = [
        seen_from(eye, look, "/world", ["+ /world/**"], "Master, slaves and fruit, m", ground=False),
        view_of(rrb.StateTimelineView, "arms", "Slaves: travel, out and collected, out and missed (red)"),
    ]
    if arms > 1:
        views.append(view_of(rrb.TimeSeriesView, "distance", "Distance between slaves, mm"))
    return layout(rrb.Vertical(*views, row_shares=[4.0, 1.4, 2.0][: len(views)]), "sim_time")
