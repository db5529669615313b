"""A zone being picked, as a Rerun recording: master and slaves moving, fruit and its fate, a lane per arm, distances.

Columns without wall-clock times, so equal harvests give equal files. Time line: sim_time, seconds of the zone. Metres
in space, mm on plots.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from pickenv.files import write_whole
from pickenv.harvester.harvest import Harvest, slave_joints_at
from pickenv.harvester.interference import arm_distances
from pickenv.harvester.machine import Machine

STEP = 0.05
COLOURS = ((0, 114, 178), (230, 159, 0), (0, 158, 115), (204, 121, 167), (86, 180, 233), (240, 228, 66))
FRUIT = {"hanging": (222, 202, 160), "collected": (0, 158, 115), "missed": (208, 32, 38)}
STEEL = (190, 194, 204)


def record_zone(path: Path, machine: Machine, harvest: Harvest) -> Path:
    """Record the round of ``harvest`` with most picks."""
    return write_whole(path, lambda temporary: _write(temporary, machine, harvest))


def _write(path: Path, machine: Machine, harvest: Harvest) -> None:
    r = max(harvest.rounds, key=lambda item: len(item.fruit))
    at = np.arange(0.0, r.times.makespan + 1.0, STEP)
    slaves = slave_joints_at(machine, r.work, r.times, at)
    tips = machine.tips(np.broadcast_to(r.master, (len(at), 3)), slaves)
    stretched = slaves.copy()
    stretched[..., 1:] = (0.0, 0.0)
    pivots = machine.tips(np.broadcast_to(r.master, (len(at), 3)), stretched)
    frame = machine.frame3(r.master)
    with rr.RecordingStream("pickenv", recording_id=f"harvest-{r.zone.name.replace(' ', '_').replace(',', '')}") as rec:
        rec.save(str(path), default_blueprint=_blueprint(machine))
        column = rr.TimeColumn("sim_time", duration=at)
        rec.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        shoulder = np.array([0.0, 0.0, frame[2]])
        rec.log(
            "/world/master",
            rr.LineStrips3D([[[0, 0, 0], [0, 0, 2.2]], [shoulder, frame]], colors=STEEL, radii=0.03),
            static=True,
        )
        for arm in range(machine.arms):
            lines = np.stack([pivots[:, arm], tips[:, arm]], axis=1)
            rec.send_columns(
                f"/world/slave_{arm + 1}",
                indexes=[column],
                columns=rr.LineStrips3D.columns(
                    strips=list(lines), colors=[COLOURS[arm]] * len(at), radii=[machine.body.radius / 2] * len(at)
                ),
            )
            _lane(rec, arm, r.times, r.outcome.collected)
        _fruit(rec, harvest, r)
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


def _lane(rec: rr.RecordingStream, arm: int, times: object, collected: object) -> None:
    """One Gantt lane: travelling, out, and how the pick ended."""
    mine = np.flatnonzero(times.arm == arm)  # type: ignore[attr-defined]
    name = f"/arms/slave_{arm + 1}"
    rec.log(
        name,
        rr.StateConfiguration(
            values=["travel", "collected", "missed"],
            labels=["travel", "out, collected", "out, missed"],
            colors=[STEEL, FRUIT["collected"], FRUIT["missed"]],
        ),
        static=True,
    )
    moments, states = [0.0], ["travel"]
    for pick in mine[np.argsort(times.start[mine])]:  # type: ignore[attr-defined]
        moments += [float(times.start[pick]), float(times.end[pick])]  # type: ignore[attr-defined]
        states += ["collected" if collected[pick] else "missed", "travel"]  # type: ignore[index]
    rec.send_columns(
        name,
        indexes=[rr.TimeColumn("sim_time", duration=np.array(moments))],
        columns=rr.StateChange.columns(state=states),
    )


def _fruit(rec: rr.RecordingStream, harvest: Harvest, r: object) -> None:
    """Fruit of the zone; it changes colour when its pick ends."""
    numbers = np.flatnonzero(r.zone.holds(harvest.tree.fruit))  # type: ignore[attr-defined]
    picks = {int(number): i for i, number in enumerate(r.fruit)}  # type: ignore[attr-defined]
    ends = r.times.end  # type: ignore[attr-defined]
    moments = np.concatenate([[0.0], np.sort(ends)])
    colours = []
    for moment in moments:
        for number in numbers.tolist():
            i = picks.get(number)
            over = i is not None and ends[i] <= moment
            state = "hanging" if not over else "collected" if r.outcome.collected[i] else "missed"  # type: ignore[attr-defined]
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


def _blueprint(machine: Machine) -> rrb.Blueprint:
    lanes = [f"+ /arms/slave_{i + 1}" for i in range(machine.arms)]
    return rrb.Blueprint(
        rrb.Vertical(
            rrb.Spatial3DView(
                origin="/world",
                contents=["+ /world/**"],
                name="Master, slaves and fruit (m)",
                background=(18, 18, 22),
                eye_controls=rrb.EyeControls3D(position=(1.8, 1.2, 2.6), look_target=(0, -0.9, 1.3), eye_up=(0, 0, 1)),
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
