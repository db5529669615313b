"""Run the command line `pickenv COMMAND`. Commands read options and print; other modules do the work."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer
from typer import Option

import pickenv
from pickenv.base import absent_extras, command_for, command_line, folded, locked, screen_width
from pickenv.commands import check, comparing, corrections, experiments, learning, plants, showing
from pickenv.commands.guard import INTERRUPTED, guarded

app = typer.Typer(
    name="pickenv",
    help="Closed-loop picking accuracy: simulate, calibrate, compensate and inspect picking arms.",
    epilog=f"Pages: {showing.pages_address()}/quickstart.md",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"pickenv {pickenv.__version__}")
        raise typer.Exit


@app.callback()
def _front(
    version: Annotated[
        bool, Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
) -> None:
    """Closed-loop picking accuracy: simulate, calibrate, compensate and inspect picking arms."""


def demo(
    out: Path = Path("runs/demo"),
    seed: Annotated[int, Option(min=0)] = 0,
    quick: Annotated[bool, Option("--quick")] = False,
    no_network: Annotated[bool, Option("--no-network")] = False,
    details: Annotated[bool, Option("--details")] = False,
) -> None:
    """Calibrate the simulated picking arm, and pick with it raw and calibrated; write figures and a recording.

    Args:
        out: Run folder to write.
        seed: Seed of all random numbers.
        quick: Fewer reaches and training epochs: sooner, with worse results.
        no_network: Calibrate by least squares alone, as is done without torch.
        details: Print RMS, 95th percentiles, floors (errors that no joint motion removes), and networks' gains as well.

    Examples:
        pickenv demo --quick
        pickenv inspect runs/demo

    More: quickstart.md
    """
    from pickenv.demo import DemoSettings, run_demo, summarise, write_run

    settings = DemoSettings.quick(seed) if quick else DemoSettings(seed=seed)
    absent = absent_extras("learn", "inspect")
    with locked(out), showing.progress_bars() as report:
        result = run_demo(replace(settings, network=not no_network and "learn" not in absent), report)
        written = write_run(result, out, report)
    summary = summarise(result)
    more = "" if details else "95th percentiles, floors, and what a network gains on other arms"
    see = f"look at it: {command_line('pickenv', 'inspect' if 'inspect' not in absent else 'check', out)}"
    showing.deliver([(out, lambda _: written)], lambda: _print_demo(summary, details=details), see, more)
    if absent:
        brings = " and ".join({"learn": "the network", "inspect": "figures, page and recording"}[e] for e in absent)
        print(f"this was made without {brings}; get them with: {command_for(*absent)}")


DETAILS = ("RMS (mm)", "p95 (mm)", "floor (deg)")
"""Columns of the demonstration's table that are printed only with `--details`."""


def _print_demo(summary: dict[str, Any], *, details: bool = True) -> None:
    from pickenv.calibration.assessment.screen import LEAST_ROWS
    from pickenv.inspect.colours import between, percent, policy_label

    identifiability = summary["identifiability"]
    table = []
    for key, row in summary["policies"].items():
        position, interval = row["position_mm"], row["position_mm"]["mean_ci95"]
        cells = {
            "policy": policy_label(key),
            "position, mean (mm)": f"{position['mean']:.3f}",
            "95 % interval (mm)": "none" if interval is None else between(interval[0], interval[1], 3),
            "RMS (mm)": f"{position['rms']:.3f}",
            "p95 (mm)": f"{position['p95']:.3f}",
            "attitude, mean (deg)": f"{row['attitude_deg']['mean']:.3f}",
            "floor (deg)": f"{row['noncompensable_deg']:.3f}",
            "success (%)": percent(row["success_rate"], *row["success_ci95"]).replace(" %", ""),
        }
        table.append({head: cell for head, cell in cells.items() if details or head not in DETAILS})
    means = ", ".join(f"{row['position, mean (mm)']} mm ({row['policy']})" for row in table)
    showing.print_verdict(f"The same policy at the same {summary['reaches']} fruit misses on average by {means}")
    title = f"{summary['reaches']} reaches on the simulated arm {summary['plant']}, seed {summary['seed']}"
    title += "; a quick run, worse than the paper's protocol" if summary["quick"] else ""
    floor = "floor: attitude error that no joint motion removes; " if details else ""
    caption = (
        f"success: within {summary['tolerance_mm']:g} mm and {summary['attitude_tolerance_deg']:g} deg; {floor}"
        "all of this one calibration: intervals are over fruit"
        + ("" if summary["reaches"] >= LEAST_ROWS else f", and means have none with fewer than {LEAST_ROWS}")
    )
    showing.print_table(title, table[0], (row.values() for row in table), words=("policy",), caption=caption)
    for sentence in summary["matters"]:
        print(*folded(sentence, screen_width(showing.WIDTH)), sep="\n")
    if not details:
        return
    if summary["blocked"]["simulated"]:
        _print_gains(summary["blocked"])
    dropped, rank = ", ".join(identifiability["dropped"]), identifiability["rank"]
    print(f"identifiable: {rank} of {identifiability['parameters']} parameters; dropped as redundant: {dropped}")


def _print_gains(blocked: dict[str, Any]) -> None:
    from pickenv.inspect.colours import between

    rows = []
    for kind in ("simulated", "measured"):
        for row in blocked[kind]:
            ends = (row["lowest"], row["highest"])
            interval = "" if ends[0] is None else f" ({between(100 * ends[0], 100 * ends[1], 0)})"
            rows.append([f"{row['arm']}, {kind}", f"{row['ls_mm']:.2f}", f"{100 * row['removed']:.0f}{interval}"])
    caption = (
        "rows in blocks held out of all fitting: two tenths of the file, of measured arms each fifth in turn; in"
        " brackets the range over drawn arms, or 95 % over ten blocks of a measured one. qiao2026 is smooth; what is"
        " left of field is made as that of measured arms is. Measured rows: pickenv bench calibration"
    )
    heads = ("arms", "LS leaves (mm RMS)", "the network removes of it (%)")
    showing.print_table(
        "What LS+BPNN gains on rows far from those it learnt", heads, rows, words=("arms",), caption=caption
    )


COMMANDS: dict[str, tuple[Callable[..., None], ...]] = {
    "Measure and correct a robot": (
        corrections.calibrate,
        corrections.verify,
        corrections.plan_poses,
        corrections.board,
        corrections.apply,
        corrections.export,
        check.check,
        plants.arms,
        check.schema,
    ),
    "Simulate, learn and judge": (
        demo,
        corrections.twin,
        plants.effects,
        plants.iso9283,
        plants.conditions,
        learning.train,
        learning.evaluate,
        learning.datasets,
        comparing.compare,
        experiments.study,
        experiments.experiment,
    ),
    "Look at what came out": (comparing.inspect, comparing.film, comparing.figures, comparing.report),
}
"""Commands by their purpose, in the order in which `pickenv --help` shows them."""

for _purpose, _commands in COMMANDS.items():
    for _command in _commands:
        cls = comparing.SeveralValues if _command is comparing.compare else showing.CommandOfNames
        app.command(rich_help_panel=_purpose, cls=cls)(_command)
app.add_typer(experiments.bench, rich_help_panel="Simulate, learn and judge")


def main() -> None:
    """Run the command line; `pickenv.commands.guard` lists the exit codes."""
    sys.exit(guarded(_run))


def _run() -> Any:
    """Run the command that was typed, and return its exit code."""
    try:
        code = app(standalone_mode=False)
    except typer.Abort as error:
        raise KeyboardInterrupt from error
    except Exception as error:  # typer carries its own copy of click, so usage errors are known by what they offer
        if not hasattr(error, "exit_code") or not hasattr(error, "show"):
            raise
        if type(error).__name__ == "NoArgsIsHelpError":
            error.show()
        else:
            usage: Any = error
            message = " ".join(str(usage.format_message()).replace("Value error, ", "").split())
            print(f"error: {message} See `pickenv --help`.", file=sys.stderr)
        return error.exit_code
    if code == INTERRUPTED:  # typer turns Ctrl-C into this return value
        raise KeyboardInterrupt
    return code


if __name__ == "__main__":
    main()
