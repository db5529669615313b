"""Equations (1) to (12) of Li et al. 2016 as printed, held against the machine: which hold, and which are misprints.

The machine (`pickenv.harvester.machine`) is the judge: its forward kinematics are eq (4), which the tests compare with
a product of transforms. Joints of a slave turn from -pi/2, so theta5 of the paper is the machine's minus pi/2. m, rad.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from papers.pages import judged
from pickenv.arm import Array
from pickenv.base import InputError
from pickenv.harvester import Machine, pick_point
from pickenv.harvester.pick_points import METHODS, border_indices, pick_heading

PAPER: Mapping[str, Any] = tomllib.loads((Path(__file__).parent / "paper.toml").read_text(encoding="utf-8"))
HOLDS_M = 1e-9
"""An equation holds if it places the tool within this, m."""
DRAWN = 500
EXACT = 0.45
"""m between slaves, for which Table 2 is exact."""
ARMS = ("left", "middle", "right")
PICK_POINT = np.array(PAPER["section4_2"]["pick_point"]) * 1e-3
TARGETS = np.array([PAPER["section4_2"][f"{arm}_target"] for arm in ARMS]) * 1e-3
"""Of section 4.2, m."""


def section_4_2(machine: Machine) -> tuple[Array, Array]:
    """The master's joints at the printed pick point ``(3,)``, and each slave's at its own target ``(arms, 3)``."""
    master = machine.master_inverse(PICK_POINT)
    return master, np.einsum("iij->ij", machine.slave_inverse(master, TARGETS))


def link(theta: float, d: float, a: float, alpha: float) -> Array:
    """Eq (1): modified D-H transform ``(4, 4)``."""
    c, s, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array([[c, -s, 0, a], [s * ca, c * ca, -sa, -d * sa], [s * sa, c * sa, ca, d * ca], [0, 0, 0, 1.0]])


def chained(machine: Machine, master: Array, slave: Array, offset: float, theta4: float = np.pi / 2) -> Array:
    """The cup's frame by eq (1) with Table 1, ``theta4`` in place of the printed -pi/2; (4, 4)."""
    theta1, d2, d3 = master
    d4, swing, d6 = slave
    half = np.pi / 2
    rows = [(theta1, machine.d1, 0.0, 0.0), (-half, d2, 0.0, 0.0), (0.0, d3, machine.a2, -half)]
    rows += [(theta4, d4, offset, half), (swing - half, 0.0, machine.a4, 0.0), (0.0, d6, 0.0, -half)]
    frame = np.eye(4)
    for row in rows:
        frame = frame @ link(*row)
    return frame


def printed_product(machine: Machine, master: Array, slave: Array, offset: float) -> Array:
    """Eqs (2) and (3) as printed, multiplied; (4, 4)."""
    theta1, d2, d3 = master
    d4, swing, d6 = slave
    s1, c1, s5, c5 = np.sin(theta1), np.cos(theta1), np.sin(swing - np.pi / 2), np.cos(swing - np.pi / 2)
    x, y = d3 * c1 + machine.a2 * s1, d3 * s1 - machine.a2 * c1
    second = np.array([[s1, 0, c1, x], [-c1, 0, s1, y], [0, -1, 0, machine.d1 + d2], [0, 0, 0, 1.0]])
    ahead = [c5, 0, -s5, -d6 * s5 + machine.a4]
    third = np.array([[-s5, 0, -c5, offset - d6 * c5], [0, 1, 0, -d4], ahead, [0, 0, 0, 1.0]])
    return second @ third


def printed_pose(machine: Machine, master: Array, slave: Array, offset: float) -> Array:
    """Eq (4) as printed, with o_z = 1; (4, 4)."""
    theta1, d2, d3 = master
    d4, swing, d6 = slave
    turn = theta1 + swing - np.pi / 2
    side, ahead = machine.a2 + offset, machine.a4 + d3
    x = -d6 * np.sin(turn) + ahead * np.cos(theta1) + side * np.sin(theta1)
    y = d6 * np.cos(turn) + ahead * np.sin(theta1) - side * np.cos(theta1)
    c, s = np.cos(turn), np.sin(turn)
    return np.array([[c, 0, -s, x], [s, 0, c, y], [0, 1, 0, d4 + d2 + machine.d1], [0, 0, 0, 1.0]])


def master_by_equation_5(machine: Machine, position: Array) -> Array:
    """Master joints by eq (5) as printed, (..., 3)."""
    x, y, z = np.moveaxis(position, -1, 0)
    away = np.hypot(x, y)
    theta1 = np.pi / 2 - np.arccos(x / away) - np.arccos(machine.a2 / away)
    return np.stack([theta1, z - machine.d1, np.sqrt(away**2 - machine.a2**2)], -1)


def slaves_by_equation_6(machine: Machine, master: Array, targets: Array) -> Array:
    """Each slave's joints for its own target (arms, 3) by eq (6) as printed, arctan of a quotient; (arms, 3)."""
    theta1, d2, d3 = master
    side, ahead = machine.a2 + machine.offsets, machine.a4 + d3
    a = targets[:, 0] - ahead * np.cos(theta1) - side * np.sin(theta1)
    b = targets[:, 1] - ahead * np.sin(theta1) + side * np.cos(theta1)
    swing = -theta1 - np.arctan(a / b) + np.pi / 2
    return np.stack([targets[:, 2] - d2 - machine.d1, swing, np.hypot(a, b)], -1)


def farthest(one: Array, other: Array) -> float:
    """Largest distance of two sets of points (..., 3), m."""
    return float(np.linalg.norm(one - other, axis=-1).max())


def equation(name: str, printed_mm: float, corrected_mm: float | None, misprint: str) -> dict[str, Any]:
    """One equation with its verdict: it holds as printed, or what it misses by."""
    holds = printed_mm <= 1e3 * HOLDS_M
    row = {"equation": name, "as_printed_misses_mm": printed_mm, "corrected_misses_mm": corrected_mm}
    reason = f"holds as printed{'; ' + misprint if misprint else ''}" if holds else misprint
    return judged(holds, reason, [row | {"misprint": misprint or "none"}])


def equations(machine: Machine, exact: Machine, rng: np.random.Generator) -> dict[str, Any]:
    """Verdicts on eqs (1) to (12), by number.

    Args:
        machine: The machine as the paper's text has it.
        exact: The same with the spacing that Table 2 holds for.
        rng: Draws joints and fruit.
    """
    joints = rng.uniform(machine.lower, machine.upper, (DRAWN, machine.joints))
    masters, slaves = joints[:, :3], joints[:, 3:6]
    offset = float(machine.offsets[0])
    true = machine.tips(masters, np.repeat(slaves[:, None], machine.arms, 1))[:, 0]
    pairs = list(zip(masters, slaves, strict=True))
    table_1 = np.array([chained(machine, *pair, offset, -np.pi / 2)[:3, 3] for pair in pairs])
    turned = np.array([chained(machine, *pair, offset)[:3, 3] for pair in pairs])
    product = np.array([printed_product(machine, *pair, offset) for pair in pairs])
    printed = np.array([printed_pose(machine, *pair, offset) for pair in pairs])
    axes = float(np.abs(product[:, :3, :3] - printed[:, :3, :3]).max())
    found = {
        "1": equation(
            "(1) with Table 1",
            1e3 * farthest(table_1, true),
            1e3 * farthest(turned, true),
            f"Table 1's theta4 = -pi/2 puts the cup up to {farthest(table_1, true):.2f} m off; +pi/2 gives eqs (3) and "
            "(4). Its column alpha_i is alpha_(i-1) of eq (1)",
        ),
        "2-3": equation("(2), (3)", 1e3 * farthest(product[:, :3, 3], true), None, ""),
        "4": equation(
            "(4)",
            1e3 * farthest(printed[:, :3, 3], true),
            None,
            f"the position; o_z = 1 is a misprint for -1, which eqs (2) and (3) give (they differ by {axes:.0f}): as "
            f"printed the axes have determinant {np.linalg.det(printed[0, :3, :3]):.0f}",
        ),
    }
    return found | inverse_equations(machine, exact, rng) | pick_point_equations(machine, rng)


def inverse_equations(machine: Machine, exact: Machine, rng: np.random.Generator) -> dict[str, Any]:
    """Eqs (5) and (6): back through the forward kinematics."""
    away = rng.uniform(0.3, 1.0, (DRAWN, 3)) * np.where(rng.random((DRAWN, 3)) < 0.5, -1.0, 1.0)
    front = np.where(np.arange(3) == 1, -np.abs(away), away)  # the trees stand at negative y
    behind = front * (1.0, -1.0, 1.0)
    in_front, at_back = (
        1e3 * farthest(machine.frame3(master_by_equation_5(machine, points)), points) for points in (front, behind)
    )
    mended = 1e3 * farthest(machine.frame3(machine.master_inverse(behind)), behind)
    master, slaves = section_4_2(exact)
    off = np.linalg.norm(exact.tips(master, slaves_by_equation_6(exact, master, TARGETS)) - TARGETS, axis=-1)
    return {
        "5": equation(
            "(5)",
            in_front,
            mended,
            f"for y > 0 it misses by up to {1e-3 * at_back:.2f} m: arccos knows no sign; the trees stand at y < 0",
        ),
        "6": equation(
            "(6)",
            1e3 * float(off.max()),
            1e3 * farthest(exact.tips(master, slaves), TARGETS),
            f"a principal arctangent takes the wrong branch for {int((off > HOLDS_M).sum())} of the paper's own three "
            f"targets, {off.min():.2f} to {off.max():.2f} m off; two arguments mend it",
        ),
    }


def pick_point_equations(machine: Machine, rng: np.random.Generator) -> dict[str, Any]:
    """Eqs (7) to (12): what each asks for, and what it gives."""
    zones = [zone(rng) for _ in range(DRAWN)]
    borders = [(each[list(border_indices(each, True))], each[list(border_indices(each))]) for each in zones]
    swapped = [farthest(*pair) for pair in borders]
    stroke = float(machine.slave.upper[0] - machine.slave.lower[0])
    fruit = zones[0]
    lowest = float(fruit[:, 2].min())
    height = lowest + stroke / 2 - machine.d1  # d2 of eq (8)
    low = machine.tips(np.array([-np.pi / 2, height, 0.5]), np.tile(machine.slave_home, (machine.arms, 1)))[0, 2]
    nearest = np.array([np.hypot(each[:, 0], each[:, 1]).min() for each in zones])
    ahead = np.hypot(nearest, machine.a2) - nearest  # r_z + a4 + l0 is ``nearest``, but it is set a2 aside
    asides, gaps = [], []
    for each, away in zip(zones, nearest, strict=True):
        reach = away - machine.a4 - machine.slave_home[2]
        heading = pick_heading(each, float(machine.offsets[-1]))
        place = np.array([reach * np.cos(heading), reach * np.sin(heading), 0.5])
        master = machine.master_inverse(place)
        gaps.append(abs(float(np.degrees(master[0] - heading))))
        asides.append(farthest(machine.frame3(np.array([heading, master[1], reach])), place))
    return {
        "7": equation(
            "(7)",
            1e3 * max(swapped),
            None,
            f"arctan(X/Y) grows to the left for Y > 0 only; at Y < 0, where the trees stand, it names the opposite "
            f"border fruit in {np.mean(np.array(swapped) > 0):.0%} of zones",
        ),
        "8": equation("(8)", 1e3 * abs(float(low) - lowest), None, "the lowest fruit stands at the slide's lower end"),
        "9": equation(
            "(9)",
            1e3 * float(ahead.max()),
            None,
            f"a2 = {1e3 * machine.a2:.0f} mm is left out: the cup at its shortest stands up to "
            f"{1e3 * ahead.max():.0f} mm beyond the nearest fruit",
        ),
        "10-12": equation(
            "(10)-(12)",
            1e3 * max(asides),
            None,
            f"theta2 is found as a heading and used as frame 3's polar angle: a2 turns the machine by "
            f"{min(gaps):.1f} to {max(gaps):.1f} deg from where it should look",
        ),
    }


def zone(rng: np.random.Generator, count: int = 12) -> Array:
    """Fruit of a zone as the machine meets them, at negative y ``(count, 3)``, m."""
    corner = np.array([rng.uniform(-0.5, 0.5) - 0.42, -1.4, rng.uniform(0.42, 1.82)])
    return np.asarray(corner + np.array([0.84, 0.4, 0.6]) * rng.random((count, 3)))


def reach_shares(machine: Machine, zones: int, rng: np.random.Generator) -> dict[str, float]:
    """Share of twelve fruit a zone that the arms reach from each pick point."""
    found = dict.fromkeys(METHODS, 0.0)
    for _ in range(zones):
        fruit = zone(rng)
        for method in METHODS:
            found[method] += in_reach(machine, pick_point(machine, fruit, method), fruit) / len(fruit) / zones
    return found


def in_reach(machine: Machine, master: Array, fruit: Array) -> int:
    """Number of fruit that an arm reaches from master joints ``(3,)``."""
    return int(machine.reach(master, fruit).any(axis=0).sum())


def pick_points(machine: Machine, exact: Machine) -> list[dict[str, Any]]:
    """Pick points of the three targets of section 4.2 by every reading of eqs (7)-(12), and the paper's own.

    Args:
        machine: The machine as the text has it.
        exact: With the spacing that Table 2 holds for.
    """
    printed = np.array(PAPER["section4_2"]["pick_point"], dtype=float)

    def row(method: str, position: Sequence[float] | None, counts: Sequence[int | None]) -> dict[str, Any]:
        apart = None if position is None else float(np.linalg.norm(np.asarray(position) - printed))
        spacings = (round(1e3 * each.spacing) for each in (machine, exact))
        reached = {f"targets_reached_at_{mm}_mm": n for mm, n in zip(spacings, counts, strict=True)}
        return {
            "method": method,
            "pick_point_mm": None if position is None else [round(float(v), 1) for v in position],
            "apart_mm": apart,
        } | reached

    own = [in_reach(each, each.master_inverse(PICK_POINT), TARGETS) for each in (machine, exact)]
    rows = [row("the paper's", printed.tolist(), own)]
    for method in METHODS:
        counts: list[int | None] = []
        position = None
        for each in (machine, exact):
            try:
                master = pick_point(each, TARGETS, method)
            except InputError:  # the point is nearer to the axis than frame 3 can come
                counts.append(None)
                continue
            counts.append(in_reach(each, master, TARGETS))
            if each is machine:
                position = (machine.frame3(master) * 1e3).tolist()
        rows.append(row(method, position, counts))
    return rows
