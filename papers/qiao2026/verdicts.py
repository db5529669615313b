"""What of Qiao 2026 comes out again: a verdict for each table, equation and figure, decided by the numbers beside it.

`papers.pages` says what the verdicts are called.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy.stats import spearmanr

from papers.pages import FITTED, NOT, REPRODUCED, judged, word
from papers.qiao2026.equations import RANK_AWARE_17, RANK_AWARE_24
from pickenv.arm import Array

SAME = 0.02
"""Parameters of Table 2 agree within this, deg or mm: a digit of misprint is more."""
MOST = 2 / 3
"""So many of them make a column reproduced."""
ALIKE = 0.8
"""Rank correlation from which on the order of methods is the paper's."""
POINTS = 5.0
"""Reductions agree within so many percentage points."""
CLOSE = 0.1
"""Errors agree within this share."""
PARTS = ("alpha_deg", "a_mm", "d_mm", "theta_deg")


def column(table: Mapping[str, Any]) -> Array:
    """A column of Table 1, 2 or 5 in the model's order; NaN where it was removed."""
    return np.concatenate([table[part] for part in PARTS]).astype(float)


def none_if_nan(value: float) -> float | None:
    """For JSON."""
    return None if np.isnan(value) else float(value)


def table_2(paper: Mapping[str, Any], found: Mapping[str, Any]) -> dict[str, Any]:
    """Identified parameters without noise: the paper's 24 and 17 beside the minimum-norm 24 and the rank-aware 17."""
    true, solved = column(paper["table1"]["true"]), found["rows"][RANK_AWARE_24]["parameters"]
    theirs = {n: column(paper["table2"][f"identified_{n}"]) for n in (24, 17)}
    ours = {24: solved, 17: found["rows"][RANK_AWARE_17]["parameters"]}
    off = {n: np.abs([ours[n][name] for name in solved] - theirs[n]) for n in theirs}
    rows = []
    for i, name in enumerate(solved):
        same = {n: bool(apart[i] <= SAME) for n, apart in off.items() if not np.isnan(apart[i])}
        row: dict[str, Any] = {"parameter": name, "true": true[i]}
        for n in theirs:
            row |= {f"paper_{n}": none_if_nan(theirs[n][i]), f"ours_{n}": ours[n][name] if n in same else None}
        rows.append(
            row | {"why": why_parameter(name, same, ties(found["dropped"])), "verdict": word(all(same.values()))}
        )
    shares = {n: float(np.mean(apart[~np.isnan(apart)] <= SAME)) for n, apart in off.items()}
    nearer = np.median(off[24]) < np.median(np.abs(theirs[24] - true))
    reason = (
        f"{shares[24]:.0%} of the 24 lie within {SAME:g} deg or mm of the minimum-norm solution (a4 = a5, theta5 = "
        f"theta6), so that column is it, with misprints; of the 17 only {shares[17]:.0%} do: they have rank 15 and no "
        "single solution"
    )
    holds = min(shares.values()) >= MOST and bool(nearer)
    return judged(holds, reason, rows, shares={str(n): share for n, share in shares.items()})


def ties(dropped: Mapping[str, Sequence[str]]) -> dict[str, str]:
    """For each parameter that poses cannot tell from others, which those are: a5 is tied to a4, and a4 to a5."""
    found: dict[str, set[str]] = {}
    for name, others in dropped.items():
        for other in others:
            found.setdefault(name, set()).add(other)
            found.setdefault(other, set()).add(name)
    return {name: ", ".join(sorted(others)) for name, others in found.items()}


def why_parameter(name: str, same: Mapping[int, bool], tied: Mapping[str, str]) -> str:
    """Why a parameter of Table 2 is not the paper's."""
    off = [n for n, agrees in same.items() if not agrees]
    said = f"tied to {tied[name]}: any split fits" if name in tied else "identifiable by itself"
    if not off:
        return said
    if off == [17]:
        return f"{said}; 17 lack what d3 or theta2 explains"
    return f"{said}; the printed 24 is no least-squares solution: a misprint, or another solver"


def table_3(paper: Mapping[str, Any], found: Mapping[str, Any]) -> dict[str, Any]:
    """Errors and eta of 24 and 17 parameters; the paper's claim is that 17 are better than 24."""
    rows = []
    for key, name, why in (
        ("model_24", RANK_AWARE_24, "solved by rank, all that geometry can explain is gone"),
        ("model_17", RANK_AWARE_17, "one of d3 and theta2 is needed, both are gone"),
    ):
        row, theirs = found["rows"][name], paper["table3"][key]
        mean = row["position_mm"]["mean"]
        near = abs(mean / theirs[1] - 1) <= CLOSE and abs(row["eta_percent"] - theirs[0]) <= POINTS
        rows.append(
            {
                "model": key,
                "paper_eta_percent": theirs[0],
                "ours_eta_percent": row["eta_percent"],
                "paper_mm": theirs[1],
                "ours_mm": mean,
                "paper_deg": theirs[3],
                "ours_deg": row["attitude_deg"]["mean"],
                "why": f"{why}; the plant was sized so that about 0.55 mm remain; eta divides by numbers near zero",
                "verdict": word(near),
            }
        )
    all_of_them, fewer = rows
    better = fewer["ours_mm"] < all_of_them["ours_mm"]
    reason = (
        f"in the paper 17 parameters leave less than 24 ({fewer['paper_mm']:g} against {all_of_them['paper_mm']:g} "
        f"mm); solved with regard to rank they leave {'less' if better else 'more'} ({fewer['ours_mm']:.3f} against "
        f"{all_of_them['ours_mm']:.3f} mm), for one of d3 and theta2 is needed: the gain was the solver's"
    )
    return judged(better, reason, rows)


BLIND = ("RBF", "BPNN")
"""Networks that know no kinematics."""


def ranking(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The order of the seven methods on one plant, and how far it is the paper's."""
    mean = {row["method"]: (row["paper"][0], row["ours"][0]) for row in rows if row["method"] != "raw"}
    theirs, ours = zip(*mean.values(), strict=True)
    before = [name for name in BLIND if mean[name][1] < mean["LS"][1]]
    order = sorted(mean, key=lambda name: mean[name][1])
    correlation = float(spearmanr(theirs, ours).statistic)
    same = correlation >= ALIKE and order[0] == "LS+BPNN" and not before
    return {
        "rank_correlation": correlation,
        "order": order,
        "paper_order": sorted(mean, key=lambda name: mean[name][0]),
        "best": order[0],
        "blind_before_ls": before,
        "verdict": word(same),
    }


def table_4(by_plant: Mapping[str, Sequence[Mapping[str, Any]]], **more: Any) -> dict[str, Any]:
    """Eight methods on each plant; the paper's claims are their order, and that least squares + network is best."""
    plants, listed, said = {}, [], []
    for plant, rows in by_plant.items():
        found = ranking(rows)
        plants[plant] = found
        blind = " and ".join(found["blind_before_ls"])
        said.append(
            f"on {plant} the rank correlation with the paper's order is {found['rank_correlation']:.2f} and "
            f"{found['best']} leaves least (paper: LS+BPNN)"
            + (f", {blind} without kinematics less than LS: the opposite of the paper's conclusion" if blind else "")
        )
        listed += [row | judged_reduction(row) for row in rows]
    same = all(found["verdict"] == REPRODUCED for found in plants.values())
    reason = "; ".join(said) + "; what LS leaves on qiao2026 is fitted: that plant was sized for it"
    return judged(same, reason, listed, plants=plants, **more)


def judged_reduction(row: Mapping[str, Any]) -> dict[str, str]:
    """Why a row of Table 4 or 6 differs, and whether its reductions of both errors are the paper's within `POINTS`."""
    theirs, ours = row["reduction_percent"]["paper"], row["reduction_percent"]["ours"]
    near = all(abs(a - b) <= POINTS for a, b in zip(theirs, ours, strict=True))
    if row["method"] == "raw":
        near = all(abs(row["ours"][k] / row["paper"][k] - 1) <= CLOSE for k in (0, 2))
        return {
            "why": "Table 1's angles add up to 0.309 deg: no joint range gives the paper's raw attitude error",
            "verdict": word(near),
        }
    if row["method"] == "LS" and row.get("plant") == "qiao2026":
        return {"why": "the plant was sized so that about 0.55 mm remain, as in the paper", "verdict": FITTED}
    if row["method"] in ("LS", "EKF"):
        why = "geometry alone; from a smaller raw error the same remainder is a smaller reduction"
    elif row["method"] in BLIND:
        why = "learns geometry and dynamics together, from the 300 poses that every method has"
    elif row.get("plant") == "field":
        why = "what LS leaves of this plant changes within less than the poses are apart: a network removes little"
    else:
        why = "what our arm's dynamic error holds that joints predict, a network removes; the paper's arm held less"
    return {"why": why, "verdict": word(near)}


def claims(differences: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> dict[str, Any]:
    """The paper's conclusions on each plant: a claim holds where the interval over arms lies on the paper's side.

    Args:
        differences: For each claim, by plant, the difference with its interval.
    """
    found = {}
    for claim, by_plant in differences.items():
        rows, said = [], []
        for plant, row in by_plant.items():
            ends = row["ci95_mm"]
            if ends is None:
                holds, words = False, "too few arms for an interval"
            else:
                holds = ends[1] < 0
                words = "holds" if holds else "does not hold" if ends[0] > 0 else "cannot be told from no difference"
            rows.append({"plant": plant, **row, "verdict": word(holds)})
            said.append(f"on {plant} {words} ({row['ours_mm']:+.3f} mm; paper {row['paper_mm']:+.3f})")
        found[claim] = judged(all(row["verdict"] == REPRODUCED for row in rows), "; ".join(said), rows)
    return found


def conclusion(found: Mapping[str, Any], table_4: Mapping[str, Any]) -> str:
    """What follows for the paper's conclusion, in sentences made of the verdicts."""
    if all(row["ci95_mm"] is None for claim in found.values() for row in claim["rows"]):
        return "Too few arms for intervals: what stands of the paper's conclusions is for a full run to say."
    stand = [name for name, claim in found.items() if claim["verdict"] == REPRODUCED]
    fall = [name for name, claim in found.items() if claim["verdict"] != REPRODUCED]
    orders = ", ".join(f"{plant} {each['rank_correlation']:.2f}" for plant, each in table_4["plants"].items())
    kept = f"Of the paper's {len(found)} comparisons {len(stand)} stand{'s' * (len(stand) == 1)} on every plant tried"
    kept += f": {'; '.join(stand)}. " if stand else ". "
    lost = f"Not so: {'; '.join(fall)}. " if fall else ""
    changes = len({tuple(each["order"]) for each in table_4["plants"].values()}) > 1
    why = (
        " The order changes with the arm's unmodelled error, which the paper does not describe: it is no property of "
        "the methods."
    )
    return f"{kept}{lost}Rank correlation of the seven methods with the paper's order: {orders}." + why * changes


def table_5(paper: Mapping[str, Any], ours: Mapping[str, float]) -> dict[str, Any]:
    """The real arm's identified parameters, for which there are no data, beside those of both simulated arms."""
    real, simulated = column(paper["table5"]["identified_physical"]), column(paper["table2"]["identified_17"])
    rows = []
    for i, name in enumerate(ours):
        none = np.isnan(real[i])
        off = None if none else float(real[i] - simulated[i])
        rows.append(
            {
                "parameter": name,
                "paper_real": none_if_nan(real[i]),
                "paper_simulated": none_if_nan(simulated[i]),
                "ours": None if none else ours[name],
                "why": "removed in the paper"
                if off is None
                else f"no data of the real arm; it is the paper's simulated arm within {abs(off):.3f}",
                "verdict": NOT,
            }
        )
    apart = float(np.nanmax(np.abs(real - simulated)))
    reason = (
        "the measurements were not published; the real arm's parameters are those of the simulated arm within "
        f"{apart:.3f} deg or mm, which were set and not measured; ours are the paper's 17 on our simulated arm"
    )
    return judged(NOT, reason, rows, largest_difference=apart)


def table_6(rows: Sequence[Mapping[str, Any]], r2: Sequence[float]) -> dict[str, Any]:
    """The real arm before and after, beside a simulated twin of it; compared are reductions against raw."""
    listed = [row | judged_reduction(row) for row in rows]
    apart = max(abs(a - b) for row in rows for a, b in zip(*row["reduction_percent"].values(), strict=True))
    reason = (
        f"a simulated twin stands for the real arm, whose data are not public; reductions of position and attitude "
        f"differ by up to {apart:.1f} points; held-out R² of its network is {min(r2):.2f} to {max(r2):.2f} by axis "
        "(paper: 0.945)"
    )
    return judged(apart <= POINTS and min(r2) > 0.9, reason, listed, r2=list(r2))


def equation_10(
    paper_removed: Sequence[str], phi: Mapping[str, Mapping[str, float]], dropped: Mapping[str, Sequence[str]]
) -> dict[str, Any]:
    """Phi = |R_kk| / mean |R_kk| below 0.05 marks a parameter redundant: how many, in three systems of units."""
    names, tied = list(next(iter(phi.values()))), ties(dropped)
    rows = [
        {"parameter": name, "removed_by_paper": name in paper_removed}
        | {unit: phi[unit][name] for unit in phi}
        | {"tied_to": tied.get(name, "")}
        for name in names
    ]
    marked = {unit: [name for name in names if phi[unit][name] < 0.05] for unit in phi}
    same = [unit for unit, each in marked.items() if set(each) == set(paper_removed)]
    counted = ", ".join(f"{len(each)} in {unit}" for unit, each in marked.items())
    reason = (
        f"phi < 0.05 marks {counted}; the paper removes {len(paper_removed)}, and {len(dropped)} are redundant: "
        "what the rule marks depends on units and on the order of columns"
    )
    return judged(bool(same), reason, rows, marked=marked, removed_by_paper=list(paper_removed))


def equation_15(literal: Mapping[str, float]) -> dict[str, Any]:
    """The joint correction by J_a^-1 as printed: how far it commands, and what it leaves."""
    usable = literal["largest_step_m"] < 0.1 and literal["mean_mm"] < 2 * literal["truncated_mean_mm"]
    reason = (
        f"the task has rank 5, so J_a has no inverse; numerically it exists, with a condition number of up to "
        f"{literal['condition']:.2g}, and for errors of {literal['corrected_mm']:.2g} mm commands slides to move by up "
        f"to {literal['largest_step_m']:.2g} m, which leaves {literal['mean_mm']:.3g} mm on average; truncated to rank "
        f"5 it moves them by {1e3 * literal['truncated_largest_step_m']:.2g} mm at most and leaves "
        f"{literal['truncated_mean_mm']:.2g} mm"
    )
    return judged(usable, reason, [dict(literal)])


def figures(tables: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    """Figures 5 to 8: each shows what a table counts, and Figure 5 joint ranges that the paper does not give."""
    models = [
        {"model": row["model"], "position_mm": row["ours_mm"], "attitude_deg": row["ours_deg"]}
        for row in tables["3"]["rows"]
    ]
    shown = {
        figure: [
            {"plant": row.get("plant", "twin"), "method": row["method"]}
            | {"position_mm": row["ours"][0], "attitude_deg": row["ours"][2]}
            for row in tables[table]["rows"]
        ]
        for figure, table in (("7", "4"), ("8", "6"))
    }
    return {
        "5": judged(FITTED, "the joint ranges are ours: the paper gives none", [], files=FILES["5"]),
        "6": judged(tables["3"]["verdict"], tables["3"]["reason"], models, files=FILES["6"]),
        "7": judged(tables["4"]["verdict"], tables["4"]["reason"], shown["7"], files=FILES["7"]),
        "8": judged(tables["6"]["verdict"], tables["6"]["reason"], shown["8"], files=FILES["8"]),
    }


FILES = {
    "5": ["fig5_joint_configurations"],
    "6": ["fig6_raw_24_17_position", "fig6_raw_24_17_attitude"],
    "7": ["fig7_position_by_method", "fig7_attitude_by_method"],
    "8": ["fig8_simulated_twin_position", "fig8_simulated_twin_attitude"],
}
"""The drawings of each figure."""
