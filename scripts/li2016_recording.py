"""A zone being picked, as a Rerun recording: master and slaves moving, fruit and its fate, a lane per arm, distances.

Columns without wall-clock times, so equal harvests give equal files. Time line: sim_time, seconds of the zone. Metres
in space, mm on plots.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from pickenv.arm.geometry import Array
from pickenv.files import write_whole
from pickenv.harvester.harvest import Harvest, Round, slave_joints_at
from pickenv.harvester.interference import arm_distances
from pickenv.harvester.machine import Machine
from pickenv.harvester.motion import master_time, profile

STEP = 0.05
COLOURS = ((0, 114, 178), (230, 159, 0), (0, 158, 115), (204, 121, 167), (86, 180, 233), (240, 228, 66))
FRUIT = {"hanging": (222, 202, 160), "collected": (0, 158, 115), "missed": (208, 32, 38)}
STEEL = (190, 194, 204)


def record_zone(path: Path, machine: Machine, harvest: Harvest) -> Path:
    """Record the round of ``harvest`` with most picks."""
    return write_whole(path, lambda temporary: _write(temporary, machine, harvest))


def _write(path: Path, machine: Machine, harvest: Harvest) -> None:
    r = max(harvest.rounds, key=lambda item: len(item.fruit))
    arrival = float(master_time(machine, machine.master_start, r.master))
    at = np.arange(0.0, arrival + r.times.makespan + 1.0, STEP)
    masters = machine.master_start + profile(
        at[:, None], r.master - machine.master_start, machine.master.speed, machine.master_acceleration
    )
    slaves = slave_joints_at(machine, r.work, r.times, at - arrival)
    tips = machine.tips(masters, slaves)
    retracted = slaves.copy()
    retracted[..., 1:] = 0.0
    pivots = machine.tips(masters, retracted)
    frame = machine.frame3(masters)
    axis = frame * (0.0, 0.0, 1.0)
    rail = [pivots[:, 0], pivots[:, -1]]
    for end in rail:
        end[:, 2] = frame[:, 2]
    with rr.RecordingStream("pickenv", recording_id=f"harvest-{r.zone.name.replace(' ', '_').replace(',', '')}") as rec:
        rec.save(str(path), default_blueprint=_blueprint(frame[-1], r.work.arms))
        column = rr.TimeColumn("sim_time", duration=at)
        rec.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        pillar = [[[0.0, 0.0, 0.0], [0.0, 0.0, float(machine.upper[1]) + machine.d1]]]
        rec.log("/world/master/column", rr.LineStrips3D(pillar, colors=STEEL, radii=0.03), static=True)
        boom = np.stack([axis, frame, rail[0].copy(), rail[1].copy()], axis=1)
        rec.send_columns(
            "/world/master/boom",
            indexes=[column],
            columns=rr.LineStrips3D.columns(strips=list(boom), colors=[STEEL] * len(at), radii=[0.02] * len(at)),
        )
        pivots = machine.tips(masters, retracted)
        for arm in range(machine.arms):
            lines = np.stack([pivots[:, arm], tips[:, arm]], axis=1)
            rec.send_columns(
                f"/world/slave_{arm + 1}",
                indexes=[column],
                columns=rr.LineStrips3D.columns(
                    strips=list(lines), colors=[COLOURS[arm]] * len(at), radii=[machine.body.radius / 2] * len(at)
                ),
            )
            _lane(rec, arm, r, arrival)
        _fruit(rec, harvest, r, arrival)
        if machine.arms > 1:
            near = arm_distances(machine, slaves) * 1e3
            for pair, (a, b) in enumerate(zip(*np.triu_indices(machine.arms, 1), strict=True)):
                name = f"/distance/{a + 1}_{b + 1}"
                rec.log(
                    name, rr.SeriesLines(names=f"slaves {a + 1} and {b + 1}", colors=COLOURS[pair % 6]), static=True
                )
                rec.send_columns(name, indexes=[column], columns=rr.Scalars.columns(scalars=near[:, pair]))
            rec.log("/distance/limit", rr.SeriesLines(names="least allowed", colors=FRUIT["missed"]), static=True)
            limit = np.full(len(at), machine.body.clearance * 1e3)
            rec.send_columns("/distance/limit", indexes=[column], columns=rr.Scalars.columns(scalars=limit))


def _lane(rec: rr.RecordingStream, arm: int, r: Round, arrival: float) -> None:
    """One Gantt lane: carried by the master, travelling, out, and how the pick ended."""
    mine = np.flatnonzero(r.times.arm == arm)
    name = f"/arms/slave_{arm + 1}"
    rec.log(
        name,
        rr.StateConfiguration(
            values=["carried", "travel", "collected", "missed"],
            labels=["carried", "travel", "out, collected", "out, missed"],
            colors=[(96, 96, 104), STEEL, FRUIT["collected"], FRUIT["missed"]],
        ),
        static=True,
    )
    moments, states = [0.0, arrival], ["carried", "travel"]
    for pick in mine[np.argsort(r.times.start[mine])]:
        moments += [arrival + float(r.times.start[pick]), arrival + float(r.times.end[pick])]
        states += ["collected" if r.outcome.collected[pick] else "missed", "travel"]
    rec.send_columns(
        name,
        indexes=[rr.TimeColumn("sim_time", duration=np.array(moments))],
        columns=rr.StateChange.columns(state=states),
    )


def _fruit(rec: rr.RecordingStream, harvest: Harvest, r: Round, arrival: float) -> None:
    """Fruit of the zone; it changes colour when its pick ends."""
    numbers = np.flatnonzero(r.zone.holds(harvest.tree.fruit))
    picks = {int(number): i for i, number in enumerate(r.fruit)}
    ends = arrival + r.times.end
    moments = np.concatenate([[0.0], np.sort(ends)])
    colours = []
    for moment in moments:
        for number in numbers.tolist():
            i = picks.get(number)
            over = i is not None and ends[i] <= moment
            state = "hanging" if not over else "collected" if r.outcome.collected[i] else "missed"
            colours.append(FRUIT[state])
    n = len(numbers)
    rec.log(
        "/world/fruit", rr.Points3D.from_fields(positions=harvest.tree.fruit[numbers], radii=[0.03] * n), static=True
    )
    rec.send_columns(
        "/world/fruit",
        indexes=[rr.TimeColumn("sim_time", duration=moments)],
        columns=rr.Points3D.columns(colors=np.array(colours, dtype=np.uint8)).partition([n] * len(moments)),
    )


def _blueprint(frame: Array, arms: int) -> rrb.Blueprint:
    lanes = [f"+ /arms/slave_{i + 1}" for i in range(arms)]
    ahead = frame * (1.0, 1.0, 0.0) / np.linalg.norm(frame[:2])
    look = frame + 0.3 * ahead
    eye = look + 1.3 * np.array([ahead[1], -ahead[0], 0.0]) - 0.7 * ahead + (0.0, 0.0, 0.7)
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Spatial3DView(
                origin="/world",
                contents=["+ /world/**"],
                name="Master, slaves and fruit (m)",
                background=(18, 18, 22),
                eye_controls=rrb.EyeControls3D(position=eye, look_target=look, eye_up=(0, 0, 1)),
                line_grid=rrb.LineGrid3D(visible=False),
            ),
            rrb.StateTimelineView(
                origin="/arms", contents=lanes, name="Slaves: travel, out and collected, out and missed"
            ),
            rrb.TimeSeriesView(origin="/distance", contents=["+ /distance/**"], name="Distance between slaves (mm)"),
            row_shares=[4, 1.4, 2],
        ),
        rrb.TimePanel(timeline="sim_time", state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
    )
