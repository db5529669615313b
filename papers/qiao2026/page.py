"""Tables and figures of the page: paper | ours | why they differ | verdict."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from papers.pages import Columns, said, table, titled
from papers.qiao2026.methods import Left, Protocol
from pickenv.arm import Array
from pickenv.base import count_of
from pickenv.inspect.colours import between, estimated
from pickenv.inspect.figures import plot_calibration, plot_errors
from pickenv.inspect.figures.run_drawings import Drawing
from pickenv.inspect.reports.report_page import PageTable, Section

AXES = ("x", "y", "z", "rx", "ry", "rz")
NOTES = (
    "All of it is simulated. The paper's joint ranges, noise and dynamic error are not recoverable; ours are stated in "
    "the plant file qiao2026.toml.",
    "Table 1 cannot give the paper's raw errors: the deviations' angles add up to 0.309 deg, which bounds the attitude "
    "error of any pose, against 3.752 deg printed.",
    "The paper's RMSE lies below its mean, which is impossible for the same norm; ours is the RMS of the norm.",
    "Its 17 parameters have rank 15: d3 and theta2 are both dropped though only one is redundant, and the collinear "
    "pairs (d1, d2) and (theta5, theta6) stay. The normal equations of eq (11) are then singular; '17 beats 24' is an "
    "artefact of the solver.",
    "R² = 0.950 contradicts Tables 3-4: 0.416 to 0.311 mm implies 0.44. Ours is held out, per axis.",
    "Every method has the same 300 poses and every network the same six joints: alone a method takes all poses, "
    "combined 100 go to the geometry and 200 to the network.",
)
"""What the page says beside its numbers; a test computes each anew."""
WHY: Columns = {"why": "why", "verdict": "verdict"}
QUANTITIES = (("position", "mm", slice(0, 3), 1e3), ("attitude", "deg", slice(3, 6), float(np.degrees(1.0))))
"""What errors have, the unit it is shown in, where it stands among six, and the unit's size."""


def sections(result: Mapping[str, Any]) -> list[Section]:
    """The page's sections, each with its tables."""
    return [
        Section("Parameters: Tables 2, 3 and 5", parameter_tables(result)),
        Section("Methods: Tables 4 and 6", method_tables(result)),
        Section("Equations", equation_tables(result)),
    ]


def parameter_tables(result: Mapping[str, Any]) -> list[PageTable]:
    """Tables 2, 3 and 5, and what each solver makes of them."""
    named = result["tables"]
    figures: Columns = {key.replace("_", " "): key for key in ("true", "paper_24", "ours_24", "paper_17", "ours_17")}
    models: Columns = {"model": lambda row: row["model"].replace("model_", "") + " parameters"}
    models |= {
        f"{who} {label}": f"{who}_{key}"
        for label, key in (("η (%)", "eta_percent"), ("(mm)", "mm"), ("(deg)", "deg"))
        for who in ("paper", "ours")
    }
    arms: Columns = {"paper, real arm": "paper_real", "paper, simulated arm": "paper_simulated"}
    columns = {
        "2": {"parameter": "parameter", **figures, **WHY},
        "3": {**models, **WHY},
        "5": {"parameter": "parameter", **arms, "ours, simulated arm": "ours", **WHY},
    }
    titles = {
        "2": "Table 2, identified parameters without noise (deg, mm)",
        "3": "Table 3, 24 and 17 parameters",
        "5": "Table 5, the real arm's 17 parameters (deg, mm)",
    }
    two, three, five = (
        table(said(title, named[number]), named[number]["rows"], columns[number], ".3f")
        for number, title in titles.items()
    )
    return [two, three, *(solver_table(plant, solved) for plant, solved in result["solvers"].items()), five]


def solver_table(plant: str, solved: Mapping[str, Any]) -> PageTable:
    """What every model leaves by every solver."""
    figures: Mapping[str, Callable[[Any], str]] = {
        "position mean (mm)": lambda row: f"{row['position_mm']['mean']:.4g}",
        "attitude mean (deg)": lambda row: f"{row['attitude_deg']['mean']:.4g}",
        "largest change of a d (mm)": lambda row: f"{row['largest_change_mm']:.3g}",
        "η (%)": lambda row: f"{row['eta_percent']:.4g}",
    }
    rows = [
        [name, *(figure(row) if row else "singular: no solution" for figure in figures.values())]
        for name, row in solved["rows"].items()
    ]
    return PageTable(f"Every solver, plant {plant} (rank {solved['rank']} of 24)", ["model, solver", *figures], rows)


def method_tables(result: Mapping[str, Any]) -> list[PageTable]:
    """Tables 4 and 6, and what follows from them."""
    four, six, counts = result["tables"]["4"], result["tables"]["6"], result["counts"]
    tables = []
    for i, plant in enumerate(result["plants"]):
        title = f"Table 4 on plant {plant}, Table 1's arm ({count_of(counts['runs'], 'run')}); in brackets 95 %"
        rows = [row for row in four["rows"] if row["plant"] == plant]
        tables.append(table(title if i else said(title, four), rows, {**paired("ours"), **WHY}))
    reductions: Columns = {
        f"{who} {what} (%)": lambda row, who=who, k=k: f"{row['reduction_percent'][who][k]:.1f}"
        for k, what in enumerate(("position", "attitude"))
        for who in ("paper", "ours")
    }
    drawn: Columns = {
        f"mean error of {counts['arms']} drawn arms (mm)": lambda row: _estimate(row["arms_mm"], row["arms_ci95_mm"])
    }
    title = "Reduction of the mean error against raw, and what drawn arms are left with"
    tables.append(table(title, four["rows"], {"plant": "plant", "method": "method", **reductions, **drawn}))

    def interval(ends: Sequence[float] | None, sign: str = "") -> str:
        return result["no_interval"] if ends is None else between(ends[0], ends[1], 3, sign)

    over_arms = four["rank_correlation_of_arms"]
    orders: Columns = {
        "plant": "plant",
        "order, best first": lambda row: " < ".join(row["order"]),
        "rank correlation with the paper's": "rank_correlation",
        "mean over arms": lambda row: f"{over_arms[row['plant']]['mean']:.2f}",
        "95 % between arms": lambda row: interval(over_arms[row["plant"]]["ci95"]),
    }
    rows = [{"plant": plant} | ranking for plant, ranking in four["plants"].items()]
    title = f"Order of the methods; in the paper {' < '.join(rows[0]['paper_order'])}"
    tables.append(table(title, rows, orders, ".2f"))
    differences: Columns = {
        "conclusion": "claim",
        "plant": "plant",
        "paper (mm)": "paper_mm",
        "ours (mm)": "ours_mm",
        "95 % between arms (mm)": lambda row: interval(row["ci95_mm"], "+"),
        "verdict": "verdict",
    }
    rows = [{"claim": claim} | row for claim, part in result["claims"].items() for row in part["rows"]]
    title = (
        f"What the paper concludes: differences of mean errors over {counts['arms']} arms of tolerance class "
        f"{result['tolerance_class']}, {count_of(counts['seeds'], 'seed')} each; an arm counts once"
    )
    tables.append(table(title, rows, differences, "+.3f"))
    rows = [{"method": name} | eta for name, eta in four["eta_percent"].items()]
    heads: Columns = {"method": "method", "paper (%)": "paper", "ours (%)": "ours"}
    tables.append(table("The paper's η of all 24 parameters", rows, heads, ".1f"))
    r2 = {f"{row['method']}, {row['plant']}": row["r2"] for row in four["rows"] if row["r2"]}
    rows = [{"network": name} | dict(zip(AXES, values, strict=True)) for name, values in r2.items()]
    rows.append({"network": "LS+BPNN, twin"} | dict(zip(AXES, six["r2"], strict=True)))
    title = "Held-out R² of every network, per axis (paper: BPNN 0.950, RBF 0.878, real arm 0.945)"
    tables.append(table(title, rows, form=".3f"))
    whole: Columns = {
        "reductions of position and attitude, paper | twin (%)": lambda row: " | ".join(
            part(row) for part in reductions.values() if not isinstance(part, str)
        )
    }
    title = said("Table 6, the real arm against our SIMULATED twin", six)
    return [*tables, table(title, six["rows"], {**paired("twin"), **whole, **WHY})]


def _estimate(mean: float, ends: Sequence[float] | None) -> str:
    return estimated(mean, *(ends or (None, None)), 3)


def paired(whose: str) -> Columns:
    """A method and its errors, paper beside ours, the mean of ours with its interval between runs."""
    columns: dict[str, str | Callable[[Any], str]] = {"method": "method"}
    for k, (what, unit, *_) in zip((0, 2), QUANTITIES, strict=True):
        head = f"{what}, mean / RMS ({unit})"
        columns[f"paper, {head}"] = lambda row, k=k: f"{row['paper'][k]:.3f} / {row['paper'][k + 1]:.3f}"
        columns[f"{whose}, {head}"] = lambda row, k=k: (
            f"{_estimate(row['ours'][k], None if k else row.get('ci95_mm'))} / {row['ours'][k + 1]:.3f}"
        )
    return columns


def equation_tables(result: Mapping[str, Any]) -> list[PageTable]:
    """Equations (9)-(10) with the lists of redundant parameters, and (13)-(15) to the letter."""
    ten, fifteen = result["equations"]["10"], result["equations"]["15"]
    columns: Columns = {
        "parameter": "parameter",
        "removed in the paper": lambda row: "yes" if row["removed_by_paper"] else "no",
        **{f"φ in {unit}": unit for unit in ten["marked"]},
        "cannot be told from": lambda row: row["tied_to"] or "–",
    }
    lists = {"the paper removes": ten["removed_by_paper"]}
    lists |= {f"φ < 0.05 in {unit}": marked for unit, marked in ten["marked"].items()}
    lists["redundant, by rank"] = list(result["solvers"]["geometry_only"]["dropped"])
    redundant = [{"list": name, "count": len(names), "parameters": ", ".join(names)} for name, names in lists.items()]
    literal = [{"figure": name.replace("_", " "), "value": value} for name, value in fifteen["rows"][0].items()]
    return [
        table(said("Equations (9)-(10), φ of every parameter", ten), ten["rows"], columns, ".3g"),
        table("Redundant parameters", redundant),
        table(said("Equations (13)-(15), the literal inverse of J_a", fifteen), literal, form=".4g"),
    ]


def boxes(sizes: Mapping[str, Array], **words: str) -> Figure:
    """Errors by method on a logarithmic axis."""
    return plot_errors.error_by_method(sizes, logarithmic=True, **words)


def drawings(
    result: Mapping[str, Any],
    run: Protocol,
    solved: Mapping[str, Array],
    methods: Mapping[str, Mapping[str, Array]],
    twin: Left,
) -> list[Drawing]:
    """Figures 5 to 8, positions and attitudes.

    Args:
        result: What was found.
        run: Poses of one run.
        solved: Pose errors ``(N, 6)`` of raw and of every solver, m and rad.
        methods: Pose errors by method, for each plant.
        twin: What is left on the simulated twin.
    """

    def both(
        number: str, name: str, text: str, draw: Callable[..., Figure], errors: Mapping[str, Array]
    ) -> list[Drawing]:
        """The same figure of positions and of attitudes."""
        pair = []
        for what, unit, axes, scale in QUANTITIES:
            sizes = {label: np.linalg.norm(e[:, axes], axis=1) * scale for label, e in errors.items()}
            words = {"quantity": f"{what} error", "unit": unit}
            caption = titled(result, number, f"{what} error {text}")
            pair.append(Drawing(name.format(what), caption, lambda sizes=sizes, words=words: draw(sizes, **words)))
        return pair

    sets = {"identification": run.identification.joints, "network": run.network.joints, "test": run.test.joints}
    labels = {"raw": "raw", "24, rank-aware": "24", "17 of the paper, rank-aware (rank 15)": "17"}
    models = {label: solved[name] for name, label in labels.items()}
    each, per_pose = "at each test pose", plot_errors.error_per_pose
    drawn = [
        Drawing(
            "fig5_joint_configurations",
            titled(result, "5", "joint configurations of identification, network and test."),
            lambda: plot_calibration.joint_coverage(run.plant.arm.nominal, sets),
        ),
        *both("6", "fig6_raw_24_17_{}", f"{each}, raw and by models of 24 and 17 parameters.", per_pose, models),
    ]
    for i, (plant, errors) in enumerate(methods.items()):
        name = "fig7_{}_by_method" + (f"_{plant}" if i else "")
        drawn += both("7", name, f"by method, plant {plant}.", boxes, errors)
    return drawn + both("8", "fig8_simulated_twin_{}", f"{each} of our simulated twin.", per_pose, twin.errors)
