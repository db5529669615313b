"""Figures and page of an accuracy test according to ISO 9283."""

from __future__ import annotations

from typing import Any

from pickenv.inspect.colours import in_words, said
from pickenv.inspect.figures import plot_policies
from pickenv.inspect.figures.run_drawings import Drawings, captioned
from pickenv.inspect.reports.report_page import PageTable, PageVerdict, plain_report
from pickenv.inspect.runs.run_folder import ISO9283, Run, TakePicture, load_result

CONTROLLERS = ("raw", "calibrated")


def _result(run: Run) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the whole result of a test, and the part of the result for each of `CONTROLLERS`, by name."""
    result = load_result(run, ISO9283)
    return result, {name: result[name] for name in CONTROLLERS if name in result}


def drawings(run: Run) -> Drawings:
    """Return the figures of an ISO 9283 test's run."""
    result, controllers = _result(run)
    accuracy, repeatability = (
        {name: [pose[key] for pose in test["poses"]] for name, test in controllers.items()}
        for key in ("accuracy_mm", "repeatability_mm")
    )
    drift = {name: test["drift_accuracy_mm"] for name, test in controllers.items()}
    return [
        captioned("pose_accuracy", plot_policies.accuracy_by_pose, accuracy, repeatability),
        captioned("drift", plot_policies.accuracy_drift, result["raw"]["drift_hours"], drift),
    ]


def page(run: Run, picture: TakePicture | None = None) -> str:
    """Return the page of an ISO 9283 test's run as HTML; ``picture`` is not used."""
    result, controllers = _result(run)
    worst = "; ".join(
        f"{name}: AP {test['worst_accuracy_mm']:.3f} mm, RP {test['worst_repeatability_mm']:.3f} mm, drift dAP "
        f"{test['drift_mm']:.3f} mm"
        for name, test in controllers.items()
    )
    best = list(controllers.values())[-1]
    verdict = PageVerdict(
        "note",
        f"Accuracy AP {best['worst_accuracy_mm']:.2f} mm, repeatability RP {best['worst_repeatability_mm']:.2f} mm",
        f"Worst of five test poses, {worst}. The standard sets no limit: compare with what the task needs.",
    )
    rows = [
        (
            f"{name} {pose['name']}",
            f"{pose['accuracy_mm']:.3f}",
            said(pose["repeatability_mm"], pose["repeatability_ci95_mm"], 3),
            f"{pose['accuracy_deg']:.4f}",
            f"{max(pose['repeatability_deg']):.4f}",
            f"{test['variation_mm'][pose['name']]:.3f}" if pose["name"] in test["variation_mm"] else "–",
        )
        for name, test in controllers.items()
        for pose in test["poses"]
    ]
    heads = ("test pose", "AP (mm)", "RP (mm), 95 % interval over cycles", "AP (deg)", "RP (deg)", "vAP (mm)")
    settings = result["settings"]
    subtitle = (
        f"Simulated arm {in_words(result['plant'])}; {result['standard']}, {settings['cycles']} cycles at "
        f"{100 * settings['speed_share']:.0f} % speed, measured {settings['dwell_s']:g} s after arrival"
    )
    table = PageTable("Accuracy and repeatability of this one arm at each test pose", heads, rows)
    return plain_report(run, "Accuracy by ISO 9283", subtitle, verdict, (table,), drawings(run))
