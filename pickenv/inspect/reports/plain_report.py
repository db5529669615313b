"""Reports of runs that are tables and figures: harvester, ISO 9283, and what other rooms build with `plain_report`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from pickenv.inspect.figures.run_drawings import Drawing, Drawings, harvest_drawings, iso9283_drawings
from pickenv.inspect.reports import report_page as page
from pickenv.inspect.reports.report_page import Verdict
from pickenv.inspect.runs.harvest_trace import HarvestTrace
from pickenv.inspect.runs.run_folder import Run


def plain_report(
    run: Run, title: str, subtitle: str, verdict: Verdict, tables: Sequence[str], drawings: Drawings
) -> str:
    """A page of a verdict, tables, figures and the run's origin.

    Args:
        run: The run.
        title: Heading.
        subtitle: What was run, in a line.
        verdict: Goes first.
        tables: From `report_page.table`.
        drawings: Figures; those left out are named with their reason.
    """
    left_out = [f"{d.name}: {d.reason}" for d in drawings if not isinstance(d, Drawing)]
    versions = ", ".join(f"{name} {version}" for name, version in run.versions.items())
    return page.page(
        title,
        (
            f"<h1>{escape(title)}</h1>",
            f'<p class="soft">{escape(subtitle)}</p>',
            page.verdict_box(verdict),
            page.section("Numbers", "tables", *tables),
            page.section("Figures", "figures", *(page.drawn(d) for d in drawings if isinstance(d, Drawing))),
            page.section("Left out", "left-out", f"<p>{escape('; '.join(left_out))}</p>") if left_out else "",
            page.section(
                "Origin",
                "origin",
                page.facts({"Reproduce": run.command, "Seed": str(run.seed), "Versions": versions}),
            ),
        ),
    )


def harvest_report(run: Run, trace: HarvestTrace) -> str:
    """The page of a comparison of harvesting strategies."""
    first, last = next(iter(trace.measures)), list(trace.measures)[-1]
    shares = [trace.measures[name]["harvested"] for name in (first, last)]
    rates = [trace.measures[name]["picks_per_hour"] for name in (first, last)]
    verdict = Verdict(
        "note",
        f"From {first} to {last}: {100 * shares[0].value:.0f} to {100 * shares[1].value:.0f} % of the fruit",
        f"On {trace.tree_count} simulated trees, {first} collects {_share(shares[0])} of the fruit present at "
        f"{_rate(rates[0])} picks per hour, {last} {_share(shares[1])} at {_rate(rates[1])}. In brackets: 95 % "
        "intervals over trees.",
    )
    measures = page.table(
        "Measures of each strategy with 95 % intervals over trees; times in s, distances in m",
        ["measure", *trace.measures],
        [[key, *(str(found[key]) for found in trace.measures.values())] for key in trace.measures[first]],
    )
    funnel = page.table(
        "Fruit at each stage, over all trees",
        ["stage", *trace.funnels],
        [[stage, *(str(counts[stage]) for counts in trace.funnels.values())] for stage in trace.funnels[first]],
    )
    arms = trace.cloud.shape[1]
    subtitle = f"Simulated; {arms} picking arms, {len(trace.measures)} strategies on the same trees"
    return plain_report(run, "Harvesting", subtitle, verdict, [measures, funnel], harvest_drawings(trace))


def iso9283_report(run: Run, result: Mapping[str, Any]) -> str:
    """The page of a test by ISO 9283.

    Args:
        run: The run.
        result: As `pickenv.arm.plant.iso9283.Iso9283Result.as_dict` gives it.
    """
    controllers = {name: result[name] for name in ("raw", "calibrated") if name in result}
    worst = "; ".join(
        f"{name}: AP {found['worst_accuracy_mm']:.3f} mm, RP {found['worst_repeatability_mm']:.3f} mm, drift dAP "
        f"{found['drift_mm']:.3f} mm"
        for name, found in controllers.items()
    )
    best = list(controllers.values())[-1]
    verdict = Verdict(
        "note",
        f"Accuracy AP {best['worst_accuracy_mm']:.2f} mm, repeatability RP {best['worst_repeatability_mm']:.2f} mm",
        f"Worst of five test poses, {worst}. The standard sets no limit: compare with what the task needs.",
    )
    rows = []
    for name, found in controllers.items():
        for pose in found["poses"]:
            variation = found["variation_mm"].get(pose["name"])
            rows.append(
                [
                    f"{name} {pose['name']}",
                    f"{pose['accuracy_mm']:.3f}",
                    f"{pose['repeatability_mm']:.3f}",
                    f"{pose['accuracy_deg']:.4f}",
                    f"{max(pose['repeatability_deg']):.4f}",
                    "–" if variation is None else f"{variation:.3f}",
                ]
            )
    heads = ["test pose", "AP (mm)", "RP (mm)", "AP (deg)", "RP (deg)", "vAP (mm)"]
    settings = result["settings"]
    subtitle = (
        f"Simulated arm {result['plant']}; {result['standard']}, {settings['cycles']} cycles at "
        f"{100 * settings['speed_share']:.0f} % speed, measured {settings['dwell_s']:g} s after arrival"
    )
    table = page.table("Accuracy and repeatability at each test pose", heads, rows)
    return plain_report(run, "Accuracy by ISO 9283", subtitle, verdict, [table], iso9283_drawings(result))


def _share(measure: Any) -> str:
    return f"{100 * measure.value:.1f} % ({100 * measure.low:.1f} to {100 * measure.high:.1f})"


def _rate(measure: Any) -> str:
    return f"{measure.value:.0f} ({measure.low:.0f} to {measure.high:.0f})"
