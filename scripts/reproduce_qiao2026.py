"""Reproduce Qiao 2026, section 2: Tables 2-6 and Figs 5-8, printed as paper | ours | why they differ | verdict.

Everything here is simulated. The paper's dynamic error, joint ranges and noise are not recoverable, so absolute numbers
differ by design (docs of the plant `qiao2026`); ratios and orderings are what can be compared. Tables 5-6 come from the
paper's real arm: ours is a simulated twin and is called so.

Each table, equation (9)-(10) and (15), figure and conclusion has a verdict (reproduced, not reproduced, fitted) with
its reason; `--json` holds {"tables": {"2": {"verdict", "reason", "rows"}, …}, "equations", "claims", "figures": {…}}.

Table 4 is run on the arm of Table 1, once for each of `--runs` seeds, and on `--arms` arms drawn from a tolerance
class, each with `--seeds` seeds of its own; differences of methods have intervals over those arms. It is run on every
plant of `PLANTS`. Seeds come from one SeedSequence. In full it takes about a quarter of an hour a plant.

Run: python scripts/reproduce_qiao2026.py [--out runs/qiao2026] [--json FILE] [--quick] [--runs 5] [--arms 10]
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from papers import qiao2026_verdicts as verdicts
from papers.qiao2026_equations import (
    PAPER,
    RANK_AWARE_17,
    REMOVED_BY_PAPER,
    literal_correction,
    paper_phi,
    solutions,
)
from papers.qiao2026_methods import (
    METHODS,
    TOLERANCES,
    Left,
    beside_paper,
    campaign,
    difference,
    protocol,
    table_4_rows,
    table_4_run,
    twin,
)
from papers.qiao2026_page import Shown, print_tables, write_page
from scipy.stats import spearmanr

from pickenv.arm import load_plant, noncompensable_error, shipped_plants
from pickenv.calibration import BpnnSettings, identify, link_model
from pickenv.files import write_text
from pickenv.intervals import LEAST, mean_interval

PLANTS = tuple(name for name in ("qiao2026", "field") if name in shipped_plants())
"""Where Table 4 is run: a smooth plant, and one as hard as measured arms."""
SEED = 0
IN_TABLE_6 = ("raw", "LS", "LS+BPNN")


def correlation(left: Left) -> float:
    """Rank correlation of one run's order of methods with the paper's."""
    methods = METHODS[1:]
    return float(spearmanr(*zip(*((PAPER["table4"][m][0], left.mean_mm(m)) for m in methods), strict=True)).statistic)


def main(
    out: Annotated[Path, typer.Option(help="Folder for figures, page and JSON.")] = Path("runs/qiao2026"),
    json_file: Annotated[Path | None, typer.Option("--json", help="Also write the figures to this file.")] = None,
    runs: Annotated[int, typer.Option(help="Runs of Table 4 on the arm of Table 1.", min=1)] = 5,
    arms: Annotated[int, typer.Option(help="Drawn arms; fewer than 10 have no intervals.", min=2)] = 10,
    seeds: Annotated[int, typer.Option(help="Runs of each drawn arm.", min=1)] = 2,
    quick: Annotated[
        bool, typer.Option("--quick", help="One run, two arms, 60 epochs: worse figures, sooner, and no intervals.")
    ] = False,
) -> None:
    """Run the reproduction and print it."""
    from rich.progress import Progress

    settings, counts = BpnnSettings(), (runs, arms, seeds)
    if quick:
        settings, counts = BpnnSettings(epochs=60), (1, 2, 1)
    of_plants, twin_arm, twin_run, of_tables, of_phi = np.random.SeedSequence(SEED).spawn(5)
    done = {}
    with Progress() as bars:
        for name, seed in zip(PLANTS, of_plants.spawn(len(PLANTS)), strict=True):
            task = bars.add_task(f"Table 4, plant {name}", total=counts[0] + counts[1] * counts[2])
            done[name] = campaign(load_plant(name), seed, settings, counts, lambda task=task: bars.advance(task))
    found, solved_errors, fields = {}, {}, of_tables.spawn(2)
    for name, seed in zip(("geometry_only", "qiao2026"), fields, strict=True):
        run = protocol(load_plant(name), seed)
        found[name], solved_errors = solutions(run.plant.arm.nominal, run.plant.geometry, run.identification, run.test)
    nominal = run.plant.arm.nominal
    on_twin = protocol(twin(twin_arm), twin_run)
    twin_left = table_4_run(on_twin, settings, IN_TABLE_6)
    paper, first = PAPER["table6"], done["qiao2026"]
    floor = noncompensable_error(run.plant.geometry, run.test.joints, solved_errors["raw"])
    differences = {
        claim: {name: difference(each, *pair) for name, each in done.items()} for claim, pair in verdicts.CLAIMS.items()
    }
    by_arm = {name: each.by_arm(correlation) for name, each in done.items()}
    phi = paper_phi(nominal, PAPER["protocol"]["qr_poses"], np.random.default_rng(of_phi))
    tables = {
        "2": verdicts.table_2(PAPER, found["geometry_only"]),
        "3": verdicts.table_3(PAPER, found["qiao2026"]),
        "4": verdicts.table_4(
            {name: table_4_rows(name, each) for name, each in done.items()},
            rank_correlation_of_arms={
                name: {"mean": float(values.mean()), "ci95": mean_interval(values)} for name, values in by_arm.items()
            },
            attitude_floor_deg=float(np.degrees(np.linalg.norm(floor[:, 3:], axis=1)).mean()),
            eta_percent={
                name: {
                    "paper": PAPER["table4"]["eta_mean_percent"][name],
                    "ours": float(np.mean([left.eta[name] for left in first.runs])),
                }
                for name in ("LS", "EKF")
            },
        ),
        "5": verdicts.table_5(PAPER, found["qiao2026"]["rows"][RANK_AWARE_17]["parameters"]),
        "6": verdicts.table_6(
            [
                {"method": name}
                | beside_paper(paper[name], paper["raw"], twin_left.errors[name], twin_left.errors["raw"])
                for name in IN_TABLE_6
            ],
            twin_left.r2["LS+BPNN"].tolist(),
        ),
    }
    base = identify(link_model(nominal), nominal, run.identification).geometry
    claims = verdicts.claims(differences)
    result = {
        "simulated": True,
        "seed": SEED,
        "counts": dict(zip(("runs", "arms", "seeds"), counts, strict=True)),
        "tolerance_class": TOLERANCES,
        "plants": list(PLANTS),
        "no_interval": "" if counts[1] >= LEAST else f"none: {counts[1]} of at least {LEAST} arms",
        "tables": tables,
        "equations": {
            "10": verdicts.equation_10(REMOVED_BY_PAPER, phi, found["geometry_only"]["dropped"]),
            "15": verdicts.equation_15(literal_correction(nominal, base, run.test.joints)),
        },
        "claims": claims,
        "figures": verdicts.figures(tables),
        "conclusion": verdicts.conclusion(claims, tables["4"]),
        "solvers": found,
    }
    print_tables(result)
    for path in {out / "reproduction.json", *([json_file] if json_file else [])}:
        write_text(path, json.dumps(result, indent=2) + "\n")
    shown = Shown(
        run, solved_errors, {name: {m: each.errors(m) for m in METHODS} for name, each in done.items()}, twin_left
    )
    page = write_page(result, shown, out, quick)
    print(f"wrote {out / 'reproduction.json'} and {page}")


if __name__ == "__main__":
    typer.run(main)
