"""Every word and number that a report is built of, recomputed before it becomes HTML."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import replace
from inspect import signature
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from pickenv.arm import load_plant, noncompensable_error
from pickenv.base import mean_interval, share_interval
from pickenv.calibration import (
    GEOMETRIC,
    NOMINAL,
    Choices,
    Result,
    assess,
    calibrate,
    fit,
    random_joints,
    simulated_tracker,
)
from pickenv.calibration.assessment.quality import axis_errors
from pickenv.calibration.assessment.screen import figure
from pickenv.inspect import (
    CalibrationTrace,
    Comparison,
    RecordedPolicy,
    Run,
    Section,
    between,
    estimated,
    gripped,
    html_of,
    in_words,
    load_part,
    matters,
    percent,
    pick_changes,
)
from pickenv.inspect.colours import parameter_words
from pickenv.inspect.reports import calibration_report, demo_report, report_page
from pickenv.inspect.runs.run_folder import MATTERS_FILE


def change(gripper: str, perception_mm: float, before: float, after: float) -> dict[str, Any]:
    return {"gripper": gripper, "perception_mm": perception_mm, "before": before, "after": after}


def built(make: Callable[[], object]) -> SimpleNamespace:
    """What ``make`` would have written as HTML: the arguments of `html_of` by name."""
    pages: list[SimpleNamespace] = []

    def keep(*given: Any, **named: Any) -> str:
        bound = signature(html_of).bind(*given, **named)
        bound.apply_defaults()
        pages.append(SimpleNamespace(**bound.arguments))
        return ""

    with pytest.MonkeyPatch.context() as patch:
        for module in (report_page, calibration_report, demo_report):
            patch.setattr(module, "html_of", keep)
        make()
    return pages[0]


def parts_of(page: SimpleNamespace, title: str) -> list[Any]:
    (section,) = [section for section in page.sections if section.title == title]
    return [part for part in section.parts if part]


def whole(values: Iterable[float], digits: int) -> str:
    """Mean and its 95 % interval."""
    ends = mean_interval(list(values), 20)
    mean = f"{np.mean(list(values)):.{digits}f}"
    return mean if ends is None else f"{mean} ({ends[0]:.{digits}f} to {ends[1]:.{digits}f})"


def share(taken: float, count: int) -> str:
    low, high = share_interval(taken, count)
    return f"{100 * taken / count:.0f} ({100 * low:.0f} to {100 * high:.0f})"


CHANGES = [change("li_cup", 0.0, 0.512, 0.987), change("compliant_hand", 2.0, 0.9, 0.8)]


@pytest.mark.parametrize("few", [False, True])
def test_a_demonstrations_page_cell_by_cell(
    few: bool,
    comparison: Comparison,
    cut_short: Callable[..., RecordedPolicy],
    write_demo_run: Callable[[Path, Comparison], Run],
    tmp_path: Path,
) -> None:
    policies = [cut_short(policy, 19 if few else 20) for policy in comparison.policies]
    exact = policies[1].position_error_mm.copy()
    exact[0] = 1.0  # on the tolerance itself, which is within it
    policies[1] = replace(policies[1], position_error_mm=exact)
    shown = replace(comparison, policies=tuple(policies))
    run = write_demo_run(tmp_path / "run", shown)
    (run.folder / MATTERS_FILE).write_text(json.dumps({"orchard": CHANGES}))
    if few:
        run = replace(run, command="pickenv demo --quick")
    trace, count = load_part(run, CalibrationTrace), len(shown.fruit)
    page = built(lambda: demo_report.page(run))
    assert page.title == "Calibration and picking: qiao2026 (smooth arm)" and page.contents
    quick = "; a quick run, worse than the paper's protocol" if few else ""
    assert page.subtitle == (
        f"Simulated arm; the same scripted policy reaches for {count} fruit, raw and calibrated; seed 7{quick}"
    )
    raw, last = (p.ends.position_error_mm for p in (policies[0], policies[-1]))
    held = [1e3 * np.linalg.norm(errors[:, :3], axis=1) for errors in trace.errors.values()]
    assert page.tiles == {
        "mean position error of the reaches, raw → calibrated": f"{raw.mean():.2f} → {last.mean():.2f} mm",
        "95 of 100 reaches are better than this": f"{np.percentile(last, 95):.2f} mm",
        "mean error at held-out poses, raw → calibrated": f"{held[0].mean():.2f} → {held[-1].mean():.2f} mm",
        "parameters could be identified": f"{np.count_nonzero(trace.kept)} of {len(trace.kept)}",
    }
    table, pair, forgiven = parts_of(page, "Reaches, by policy")
    assert table.heads == [
        "policy", "within 1 mm (%)", "taken by suction cup (%)", "taken by compliant hand (%)", "position, mean (mm)",
        "RMS (mm)", "p95 (mm)", "max (mm)", "attitude, mean (deg)",
    ]  # fmt: skip
    grips = gripped(shown)
    assert table.rows == [
        [
            in_words(p.label),
            share(np.count_nonzero(p.ends.position_error_mm <= 1.0), count),
            *(share(float(grips[p.label][1][name].sum()), count) for name in ("li_cup", "compliant_hand")),
            whole(p.ends.position_error_mm, 3),
            f"{np.sqrt(np.mean(p.position_error_mm**2)):.3f}",
            f"{np.percentile(p.position_error_mm, 95):.3f}",
            f"{p.position_error_mm.max():.3f}",
            whole(p.ends.attitude_error_deg, 3),
        ]
        for p in policies
    ]
    nothing = "no interval: fewer than 20 reaches, or all alike"
    some = nothing if few else "in brackets 95 % intervals over fruit"
    assert table.caption == f"Final errors of the reaches; {some}. {demo_report.OF_ONE}"
    assert [drawing.name for drawing in (*pair, forgiven)] == [
        "position_error_by_policy", "reach_errors_cumulative", "success_against_misalignment",
    ]  # fmt: skip
    (cases,) = parts_of(page, "Does it matter?")
    assert cases.parts[0].rows == [
        ["orchard (drifting arm), suction cup", "0", "51.2", "98.7", "+47.5"],
        ["orchard (drifting arm), compliant hand", "2", "90.0", "80.0", "-10.0"],
    ]
    axes, floors, per_pose, _ = parts_of(page, "Held-out poses")
    wanted = [
        f"{in_words(name)} {np.degrees(np.linalg.norm(e[:, 3:], axis=1)).mean():.3f}°, of which "
        f"{np.degrees(np.linalg.norm(part[:, 3:], axis=1)).mean():.3f}°"
        for name, e in trace.errors.items()
        for part in [noncompensable_error(shown.plant.geometry, trace.sets["test"], e)]
    ]
    assert floors.endswith(f"the part that no motion of 6 joints removes on this arm: {'; '.join(wanted)}.")
    assert len(axes.rows) == 6 and per_pose.spec
    (field,) = parts_of(page, "Where the tool misses")
    assert field.name == "error_fields" and "Drag to turn" in field.hint
    dropped = [name for name, kept in zip(trace.names, trace.kept, strict=True) if not kept]
    text, *_, coverage = parts_of(page, "How the calibration was found")
    condition = trace.singular_values.max() / trace.singular_values.min()
    assert text == (
        f"Least squares on 40 poses. {np.count_nonzero(trace.kept)} of {len(trace.kept)} parameters can be told apart "
        f"(condition number {condition:.1f}). These stay at their nominal values, because others absorb them: "
        f"{', '.join(dropped) or 'none'}."
    )
    assert coverage.name == "joint_coverage"
    assert parts_of(page, "The recording") == []
    effects = "joint compliance, boom bending, transmission error"
    assert page.origin["Simulated true arm"].startswith("qiao2026: ")
    assert set(page.origin["Simulated true arm"].removeprefix("qiao2026: ").split(", ")) >= set(effects.split(", "))
    assert "roller play" not in page.origin["Simulated true arm"] and page.origin["Reproduce"] == run.command
    text = page.verdict.text
    gain = raw - last
    ends = mean_interval(gain, 20)
    said = nothing if ends is None else f"95 % interval {ends[0]:.2f} to {ends[1]:.2f}"
    assert text.startswith(
        f"This one calibration removes {gain.mean():.2f} mm ({said}) of a mean position error of {raw.mean():.2f} mm: "
        f"{100 * gain.mean() / raw.mean():.0f} %."
    )
    assert in_words(matters("orchard (drifting arm)", CHANGES)) in text
    assert f"{np.count_nonzero(raw <= 1.0)} without calibration." in text
    assert f"What remains is {whole(last, 2)} mm in the mean and at most {last.max():.2f} mm." in text
    lateral = [lateral_mm for lateral_mm, _ in grips.values()]
    own = demo_report.demo_verdict(shown)
    assert (
        in_words(matters("qiao2026 (smooth arm)", pick_changes(lateral[0], lateral[-1]))) in own.text
        and own.headline == page.verdict.headline
    )
    worse = replace(policies[-1], position_error_mm=(raw + np.linspace(0.2, 0.4, count))[:, None])
    lost = demo_report.demo_verdict(replace(shown, policies=(policies[0], worse))).text
    low, high = mean_interval(np.linspace(0.2, 0.4, count), 20) or (0.0, 0.0)
    said = nothing if few else f"95 % interval {low:+.2f} to {high:+.2f}"
    assert f"of {raw.mean():.2f} mm: it changes by +0.30 mm ({said})." in lost


@pytest.mark.parametrize(("gain", "lowers"), [(0.0, False), (0.4, True), (-0.4, False)])
def test_a_gain_alike_everywhere_has_no_interval(gain: float, lowers: bool, comparison: Comparison) -> None:
    raw, last = comparison.policies[0], comparison.policies[-1]
    errors = np.full((len(raw.moments), 1), 2.0)
    policies = (replace(raw, position_error_mm=errors), replace(last, position_error_mm=errors - gain))
    text = demo_report.demo_verdict(replace(comparison, policies=policies)).text
    assert ("removes" in text.split(".")[0]) == lowers and "(no interval: fewer than 20 reaches, or all alike)" in text


def test_a_demonstration_of_positions_with_a_network_and_a_picture(
    comparison: Comparison, demo_run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    trace = load_part(demo_run, CalibrationTrace)
    positions = replace(trace, errors={"raw": trace.errors["raw"][:, :3], "LS": trace.errors["LS"][:, :3]})
    monkeypatch.setattr(
        demo_report, "load_part", lambda run, kind: positions if kind is CalibrationTrace else comparison
    )
    record = {"source": "data.csv"}
    learnt = SimpleNamespace(load=lambda *_: SimpleNamespace(learnt=SimpleNamespace(kind="bpnn"), record=record))
    monkeypatch.setattr(demo_report, "Calibration", learnt)
    page = built(lambda: demo_report.page(demo_run, lambda recording: b"picture"))
    assert parts_of(page, "How the calibration was found")[0].startswith(
        "Least squares on 40 poses, then neural network on what"
    )
    assert not any("no motion of" in part for part in parts_of(page, "Held-out poses") if isinstance(part, str))
    assert parts_of(page, "The recording") == []  # the run has none
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "errors.rrd").touch()
    (picture,) = parts_of(
        built(lambda: demo_report.page(replace(demo_run, folder=folder), lambda recording: recording.name.encode())),
        "The recording",
    )
    assert picture == b"errors.rrd"
    assert parts_of(built(lambda: demo_report.page(replace(demo_run, folder=folder))), "The recording") == []


@pytest.fixture(scope="module")
def results() -> dict[str, Result]:
    plant, rng = load_plant("qiao2026"), np.random.default_rng(0)
    train, test, more = (simulated_tracker(plant, random_joints(plant.arm.nominal, n, rng), rng) for n in (60, 40, 150))
    bare, held = train.positions_only(), test.positions_only()
    return {
        "poses": calibrate(
            plant.arm,
            replace(train, source="folder/data.csv"),
            test=test,
            choices=Choices(terms="none", residual="none", frames="fitted"),
        ),
        "positions": assess(plant.arm, fit(plant.arm, bare), bare, held),
        "residual": assess(plant.arm, fit(plant.arm, train, more, residual="rbf", rng=rng), train, test),
    }


@pytest.mark.parametrize("kind", ["poses", "positions", "residual"])
def test_a_calibrations_page_cell_by_cell(kind: str, results: dict[str, Result]) -> None:
    r = results[kind]
    page = built(lambda: calibration_report.calibration_page(r, {"seed": 5}))
    mm = {name: 1e3 * np.linalg.norm(errors[:, :3], axis=1) for name, errors in r.errors.items()}
    names = {"nominal": NOMINAL, "calibrated geometry": GEOMETRIC}
    if kind == "residual":
        names["model used"] = list(r.errors)[-1]
    last, test = list(mm.values())[-1], r.test.joints
    if kind == "poses":
        assert page.subtitle == "60 pose measurements from data.csv; 40 held out"
    assert page.subtitle.startswith(f"60 {r.train.kind} measurements from") and "40 held out" in page.subtitle
    ends = mean_interval(last, 20)
    interval = f"95 % interval {figure(ends[0])} to {figure(ends[1])}"
    sentence = (
        f"On {len(test)} measured poses that the fit never saw, the tool stood {figure(last.mean())} mm (mean; "
        f"{interval}) from where the calibrated model says it stands. With the nominal model it is "
        f"{figure(mm[NOMINAL].mean())} mm."
    )
    if kind != "positions":
        turned = [np.degrees(np.linalg.norm(e[:, 3:], axis=1)).mean() for e in r.errors.values() if e.shape[1] == 6]
        sentence += f" The attitude error falls from {figure(turned[0])} to {figure(turned[-1])} deg."
    first, middle, frames = page.verdict.text.split("\n")
    assert middle == sentence and frames[:1].isupper() and frames.endswith(".")
    changes = pick_changes(mm[NOMINAL], last)
    assert first.endswith(in_words(matters(f"an arm with these errors ({r.arm.name})", changes)))
    seen = r.geometric.identification
    noise = r.quality.completeness
    assert list(page.tiles.items())[:3] == [
        ("mean position error, nominal → calibrated", f"{figure(mm[NOMINAL].mean())} → {figure(last.mean())} mm"),
        ("95 of 100 poses are better than this", f"{figure(np.percentile(last, 95))} mm"),
        ("parameters that the rows tell", f"{seen.spent:.1f} of {len(seen.identifiability.names)}"),
    ]
    assert list(page.tiles.values())[3] == f"{np.sqrt(noise.reduced):.2g} ×"
    _, drawing, axes = parts_of(page, "Errors on held-out rows")
    assert drawing.name == "error_cumulative"
    lines = {line.get_label(): len(line.get_xdata()) for line in drawing.draw().axes[0].get_lines()}
    assert lines == dict.fromkeys(names, len(test) + 1)
    by_stage = [axis_errors(r.errors[n]) for n in names.values()]
    for row, axis in zip(axes.rows, by_stage[0], strict=True):
        said = [figure(value) for stage in by_stage for value in stage[axis]]
        signed = [("+" if i % 4 == 0 and not text.startswith("-") else "") + text for i, text in enumerate(said)]
        assert row == [axis, *signed]
    repeat = figure(1e3 * r.uncertainty.position_repeat)
    assert page.origin["Scatter of one reach"] == f"{repeat} mm per coordinate, beside the parameters'"
    assert page.origin["Reproduce"] == "seed 5" and page.origin["Unit"] == "not named"
    assert built(lambda: calibration_report.calibration_page(r)).origin["Reproduce"] == "no random choice was made"
    assert ("Stated noise" in page.origin) == r.train.std_stated


def test_what_moved_is_told_with_its_bar(results: dict[str, Result]) -> None:
    r = results["poses"]
    expected, *rest = parts_of(built(lambda: calibration_report.calibration_page(r)), "What moved")
    tables = [part.parts[0] if isinstance(part, Section) else part for part in rest]
    rows = {row["name"]: row for row in r.parameters()}
    limits: dict[str, float] = {}
    for name, row in rows.items():
        if not name.startswith("base_"):
            limits[row["unit"]] = max(limits.get(row["unit"], 0.0), abs(row["change"]) + 2 * row["std"])
    moved = [name for name, row in rows.items() if abs(row["change"]) > 2 * row["std"]]
    stayed = [name for name in rows if name not in moved]
    groups = [(f"{len(moved)} of {len(rows)} parameters moved by more than 2 sigma", moved)]
    groups += [(f"{len(stayed)} within 2 sigma of the nominal value", stayed)]
    groups = [(caption, names) for caption, names in groups if names]
    assert [(table.caption, [row[0] for row in table.rows]) for table in tables] == groups
    for table in tables:
        assert table.heads == ("parameter", "meaning", "change ± uncertainty", "drawn", "told by the rows")
        for name, _, said, bar, told in table.rows:
            row = rows[name]
            assert said == f"{figure(row['change'])} ± {figure(row['std'])} {row['unit']}"
            assert bar == (row["change"], row["std"], pytest.approx(limits[row["unit"]]))
            assert told == f"{100 * row['narrowed']:.0f} %"
    assert expected == f"{r.prior_text[:1].upper()}{r.prior_text[1:]}."


def test_bars_have_a_scale_of_their_unit_or_of_their_own(
    results: dict[str, Result], monkeypatch: pytest.MonkeyPatch
) -> None:
    r = results["poses"]
    told = [
        ("base_x", "mm", 0.0, 0.25, 0.9),
        ("base_y", "mm", -3.0, 0.25, 0.9),
        ("d2", "deg", 0.0, 0.5, 0.0),
        ("a1", "SI", 0.5, np.nan, None),
        ("a2", "SI", -0.25, 0.5, 0.996),
    ]
    rows = [dict(zip(("name", "unit", "change", "std", "narrowed"), row, strict=True)) for row in told]
    monkeypatch.setattr(Result, "parameters", lambda self: rows)
    _, *parts = parts_of(built(lambda: calibration_report.calibration_page(r)), "What moved")
    tables = [part.parts[0] if isinstance(part, Section) else part for part in parts]
    assert {row[0]: row[3] for table in tables for row in table.rows} == {
        "base_x": (0.0, 0.25, 1.0), "base_y": (-3.0, 0.25, 3.0), "d2": (0.0, 0.5, 1.0),
        "a1": (0.5, 0.0, 1.25), "a2": (-0.25, 0.5, 1.25),
    }  # fmt: skip
    assert [len(table.rows) for table in tables] == [1, 4]
    cells = {row[0]: row[4] for table in tables for row in table.rows}
    assert cells == {"base_x": "90 %", "base_y": "90 %", "d2": "0 %", "a1": "", "a2": "100 %"}


def test_other_rows_blocks_and_arms_are_named_as_what_they_are(results: dict[str, Result]) -> None:
    r = results["poses"]
    few = r.test.conditions.select(np.arange(7))
    other = SimpleNamespace(
        joints=r.test.joints[:7], conditions=few, source="x.csv", poses=None, fingerprint=lambda: "f"
    )
    page = built(lambda: calibration_report.calibration_page(replace(r, test=other)))
    assert "On 7 rows that the fit never saw, what was read lay" in page.verdict.text
    assert "from where the calibrated model says. With the nominal model" in page.verdict.text
    blocks = np.arange(40) // 5
    page = built(lambda: calibration_report.calibration_page(replace(r, held_out=replace(r.held_out, blocks=blocks))))
    assert "of which no fit saw the block that it is judged on, the tool stood" in page.verdict.text
    assert page.subtitle.endswith("each judged without its block of the rows")
    unknown = replace(r, quality=replace(r.quality, completeness=replace(r.quality.completeness, chi_square=np.nan)))
    assert list(built(lambda: calibration_report.calibration_page(unknown)).tiles.values())[3] == "not known"


def test_poses_are_judged_and_mapped(results: dict[str, Result], monkeypatch: pytest.MonkeyPatch) -> None:
    r, given = results["poses"], list[Any]()
    monkeypatch.setattr(calibration_report, "uncertainty_map", lambda *arrays: given.extend(arrays))
    regions, coverage, drawn, indices = parts_of(
        built(lambda: calibration_report.calibration_page(r)), "Were the poses good?"
    )
    assert regions.rows == r.quality.workspace.block().rows and len(regions.rows) == 2
    seen = r.quality.observability
    told = [seen[name] for name in ("condition", "o1", "o2", "o3", "o4", "o5")]
    assert [row[1] for row in indices.rows] == [figure(value) for value in told]
    none = replace(r, quality=replace(r.quality, workspace=None))
    first, *_ = parts_of(built(lambda: calibration_report.calibration_page(none)), "Were the poses good?")
    assert first.name == "joint_coverage"
    assert coverage.name == "joint_coverage" and "How the 60 fitted poses fill" in coverage.caption
    drawn.draw()
    away, height, spread = given
    model, geometry = r.fit.calibration.model, r.fit.identification.geometry
    joints = random_joints(geometry, 6000, np.random.default_rng(0))
    place = 1e3 * (model.pose(joints).position - geometry.base.position)
    np.testing.assert_allclose(away, np.sqrt(place[:, 0] ** 2 + place[:, 1] ** 2))
    np.testing.assert_allclose(height, place[:, 2])
    known = replace(r.uncertainty, position_repeat=0.0, attitude_repeat=None)
    np.testing.assert_allclose(spread, 1e3 * known.standard(model, joints)[0])
    whole_error = 1e3 * r.uncertainty.standard(model, joints)[0]
    assert np.all(spread < whole_error)
    unknown = replace(r, uncertainty=replace(r.uncertainty, covariance=np.full_like(r.uncertainty.covariance, np.nan)))
    parts = parts_of(built(lambda: calibration_report.calibration_page(unknown)), "Were the poses good?")
    assert "uncertainty_map" not in [getattr(part, "name", "") for part in parts]


def test_intervals_may_be_open_or_missing() -> None:
    assert between(0.123, 0.345, 2) == "0.12 to 0.34" and between(0.1, -0.2, 1, "+") == "+0.1 to -0.2"
    assert (between(0.5, None, 1), between(None, 0.5, 1)) == ("0.5 or more", "up to 0.5")
    assert between(None, None, 1) == "no interval"
    assert estimated(0.2345, None, None, 2, " mm") == "0.23 mm" and estimated(1.0, 0.5, None, 1) == "1.0 (0.5 or more)"
    assert estimated(1.0, None, 2.0, 1) == "1.0 (up to 2.0)" and estimated(-0.001, -0.004, 0.2, 1) == "0.0 (0.0 to 0.2)"
    assert percent(0.934, 0.881, 0.9712) == "93 % (88 to 97)" and percent(0.5, None, None, 1) == "50.0 %"
    assert percent(0.25, 0.125, None, 1) == "25.0 % (12.5 or more)" and percent(1.0, None, 1.0) == "100 % (up to 100)"


@pytest.mark.parametrize(
    ("name", "meaning"),
    [
        ("alpha0", "twist between the axes of the base and L1"),
        ("alpha2", "twist between the axes of L2 and L3"),
        ("a3", "distance between the axes of L3 and L4"),
        ("a4", ""),
        ("beta1", "second twist between the parallel axes of L1 and L2"),
        ("theta1", "angle offset of L1"),
        ("theta4", "angle offset of L4"),
        ("theta0", ""),
        ("d2", "offset along the axis of L2"),
        ("base2_y", "base of the arm in the instrument's frame, station 2: position along y"),
        ("tool_rz", "target on the last link: turn about z"),
        ("compliance1", "yielding of J1 under load"),
        ("compliance3", "yielding of J3 under load"),
        ("compliance4", "yielding of  under load"),
        ("periodic2_sin1", "periodic error of the drive of J2"),
        ("reflector_x", "reflector on the tool"),
        ("bending2_xy", "yielding across the axis of J2 under load"),
        ("zeta1", ""),
        ("7", ""),
    ],
)
def test_what_a_name_means_where_joints_move_several_links(name: str, meaning: str) -> None:
    assert parameter_words(name, ("J1", "J2", "J3"), ("L1", "L2", "L3", "L4")) == meaning
