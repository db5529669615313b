"""Reproduce Qiao 2026, section 2: Tables 2-6 and Figs 5-8, printed as paper | ours | why they differ | verdict.

Everything here is simulated. The paper's dynamic error, joint ranges and noise are not recoverable, so absolute numbers
differ by design (docs of the plant `qiao2026`); ratios and orderings are what can be compared. Tables 5-6 come from the
paper's real arm: ours is a simulated twin and is called so.

Each table, equation (9)-(10) and (15), figure and conclusion has a verdict (reproduced, not reproduced, fitted) with
its reason; `--json` holds {"tables": {"2": {"verdict", "reason", "rows"}, …}, "equations", "claims", "figures": {…}}.

Table 4 is run on the arm of Table 1, once for each of `--runs` seeds, and on `--arms` arms drawn from a tolerance
class, each with `--seeds` seeds of its own; differences of methods have intervals over those arms. It is run on every
plant of `PLANTS`. Seeds come from one SeedSequence. In full it takes about a quarter of an hour a plant.

`--method` and `--plant` make some rows of Table 4 alone, on drawn arms, and write them to `--json`; all methods but raw
make the rank correlation of their order with the paper's too.

Run: python -m papers.qiao2026 [--out runs/qiao2026] [--json FILE] [--quick] [--runs 5] [--arms 10] [--method LS]
"""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from rich.progress import Progress

from papers.pages import headline, print_tables, table, write_page
from papers.qiao2026 import verdicts
from papers.qiao2026.equations import (
    PAPER,
    RANK_AWARE_17,
    REMOVED_BY_PAPER,
    literal_correction,
    paper_phi,
    solutions,
)
from papers.qiao2026.methods import (
    CLAIMS,
    METHODS,
    TOLERANCES,
    beside_paper,
    campaign,
    correlations,
    difference,
    protocol,
    some_methods,
    table_4_rows,
    table_4_run,
    twin,
)
from papers.qiao2026.page import NOTES, drawings, sections
from pickenv.arm import load_plant, noncompensable_error, shipped_plants
from pickenv.base import InputError, write_text
from pickenv.base.intervals import LEAST
from pickenv.calibration import BpnnSettings, identify, link_model
from pickenv.envs.shared.task import check_choice
from pickenv.inspect import write_drawings
from pickenv.inspect.reports.report_page import Section

PLANTS = tuple(name for name in ("qiao2026", "field") if name in shipped_plants())
"""Where Table 4 is run: a smooth plant, and one as hard as measured arms."""
SEED = 0
IN_TABLE_6 = ("raw", "LS", "LS+BPNN")


def main(
    out: Annotated[Path, typer.Option(help="Folder for figures, page and JSON.")] = Path("runs/qiao2026"),
    json_file: Annotated[Path | None, typer.Option("--json", help="Also write the figures to this file.")] = None,
    runs: Annotated[int, typer.Option(help="Runs of Table 4 on the arm of Table 1.", min=1)] = 5,
    arms: Annotated[int, typer.Option(help="Drawn arms; fewer than 10 have no intervals.", min=2)] = 10,
    seeds: Annotated[int, typer.Option(help="Runs of each drawn arm.", min=1)] = 2,
    seed: Annotated[int, typer.Option(help="Seed of everything random.", min=0)] = SEED,
    quick: Annotated[
        bool, typer.Option("--quick", help="One run, two arms, 60 epochs: worse figures, sooner, and no intervals.")
    ] = False,
    method: Annotated[
        list[str] | None,
        typer.Option(help="Method of Table 4; make no other row, and nothing else."),
    ] = None,
    plant: Annotated[
        list[str] | None,
        typer.Option(help="Plant of those rows; all if left out."),
    ] = None,
) -> None:
    """Run the reproduction and print it."""
    settings, counts = BpnnSettings(), (runs, arms, seeds)
    options = f" --runs {runs} --arms {arms} --seeds {seeds}"
    if quick:
        settings, counts, options = BpnnSettings(epochs=60), (1, 2, 1), " --quick"
    options += "" if seed == SEED else f" --seed {seed}"
    of_plants, twin_arm, twin_run, of_tables, of_phi = np.random.SeedSequence(seed).spawn(5)
    campaigns, methods = {}, METHODS
    if plant and not method:
        raise InputError("--plant chooses rows of --method; give both, or leave --plant out")
    for name in method or ():
        check_choice("method", name, METHODS)
    for name in plant or ():
        check_choice("plant", name, PLANTS)
    if method:
        methods, counts = tuple(name for name in METHODS if name in method), (0, *counts[1:])
    with Progress() as bars:
        for name, own in zip(PLANTS, of_plants.spawn(len(PLANTS)), strict=True):
            if plant and name not in plant:
                continue
            task = bars.add_task(f"Table 4, plant {name}", total=counts[0] + counts[1] * counts[2])
            advance = partial(bars.advance, task)
            campaigns[name] = campaign(load_plant(name), own, settings, counts, advance, methods)
    if method:
        some = some_methods(campaigns, methods)
        print_tables([table("Table 4 on drawn arms", some["tables"]["4"]["rows"])])
        write_text(json_file or out / "table_4.json", json.dumps({"seed": seed} | some, indent=2) + "\n")
        return
    solved = {}
    for name, own in zip(("geometry_only", "qiao2026"), of_tables.spawn(2), strict=True):
        run = protocol(load_plant(name), own)
        nominal = run.plant.arm.nominal
        solved[name], errors = solutions(nominal, run.plant.geometry, run.identification, run.test)
    twin_left = table_4_run(protocol(twin(twin_arm), twin_run), settings, IN_TABLE_6)
    floor = noncompensable_error(run.plant.geometry, run.test.joints, errors["raw"])
    eta = {name: [left.eta[name] for left in campaigns["qiao2026"].runs] for name in ("LS", "EKF")}
    paper, raw_errors = PAPER["table6"], twin_left.errors["raw"]
    tables = {
        "2": verdicts.table_2(PAPER, solved["geometry_only"]),
        "3": verdicts.table_3(PAPER, solved["qiao2026"]),
        "4": verdicts.table_4(
            {name: table_4_rows(name, each) for name, each in campaigns.items()},
            rank_correlation_of_arms=correlations(campaigns),
            attitude_floor_deg=float(np.degrees(np.linalg.norm(floor[:, 3:], axis=1)).mean()),
            eta_percent={
                name: {"paper": PAPER["table4"]["eta_mean_percent"][name], "ours": float(np.mean(values))}
                for name, values in eta.items()
            },
        ),
        "5": verdicts.table_5(PAPER, solved["qiao2026"]["rows"][RANK_AWARE_17]["parameters"]),
        "6": verdicts.table_6(
            [
                {"method": name} | beside_paper(paper[name], paper["raw"], twin_left.errors[name], raw_errors)
                for name in IN_TABLE_6
            ],
            twin_left.r2["LS+BPNN"].tolist(),
        ),
    }
    phi = paper_phi(nominal, PAPER["protocol"]["qr_poses"], np.random.default_rng(of_phi))
    base = identify(link_model(nominal), nominal, run.identification).geometry
    claims = verdicts.claims(
        {claim: {name: difference(each, *pair) for name, each in campaigns.items()} for claim, pair in CLAIMS.items()}
    )
    result = {
        "simulated": True,
        "seed": seed,
        "counts": dict(zip(("runs", "arms", "seeds"), counts, strict=True)),
        "tolerance_class": TOLERANCES,
        "plants": list(PLANTS),
        "no_interval": "" if counts[1] >= LEAST else f"none: {counts[1]} of at least {LEAST} arms",
        "tables": tables,
        "equations": {
            "10": verdicts.equation_10(REMOVED_BY_PAPER, phi, solved["geometry_only"]["dropped"]),
            "15": verdicts.equation_15(literal_correction(nominal, base, run.test.joints)),
        },
        "claims": claims,
        "figures": verdicts.figures(tables),
        "conclusion": verdicts.conclusion(claims, tables["4"]),
        "solvers": solved,
    }
    shown = sections(result)
    print_tables([part for section in shown for part in section.parts])
    print(headline(result), result["conclusion"], sep="\n")
    for path in {out / "reproduction.json", *([json_file] if json_file else [])}:
        write_text(path, json.dumps(result, indent=2) + "\n")
    by_method = {name: {m: each.errors(m) for m in METHODS} for name, each in campaigns.items()}
    drawn = drawings(result, run, errors, by_method, twin_left)
    write_drawings(drawn, out, ("png",))
    page = write_page(
        out / "reproduction.html",
        "Qiao 2026, section 2, reproduced in simulation",
        "The paper's tables beside ours, why they differ, and a verdict each",
        result,
        (verdicts.conclusion(claims, tables["4"]), *NOTES),
        [*shown, Section("Figures", drawn)],
        {"Reproduce": f"python -m papers.qiao2026{options}", "Seed": str(seed)},
    )
    print(f"wrote {out / 'reproduction.json'} and {page}")


if __name__ == "__main__":
    typer.run(main)
