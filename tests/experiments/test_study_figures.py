"""Figures of a study show its numbers: every curve's points are the table's, axes have units, files are written."""

from itertools import product

import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
import pytest

from pickenv.experiments import quantiles_of, sensitivities_of, study_findings as figures, yields_of
from pickenv.inspect import save_figure

ARMS = 60
REQUIRED = 0.95


def cells(tolerances):
    calibrations = [("raw", 0, 0.0), *product(["ls"], [15, 30], [0.015, 0.1])]
    return product(tolerances, (6, 10, 14), calibrations, (0.0, 0.25))


def population(*tolerances):
    rng, parts = np.random.default_rng(0), []
    for number, (name, grade, (method, poses, noise), payload) in enumerate(cells(tolerances or ("medium",))):
        deviation = rng.uniform(-1, 1, (ARMS, 2))
        mean = 0.1 * grade * (1.0 + deviation[:, 0] ** 2) if method == "raw" else 0.5 + noise + 0.1 * rng.random(ARMS)
        mean = mean + payload
        columns = {"setting": number, "tolerances": name, "it_grade": grade, "poses": poses, "noise_mm": noise}
        columns |= {"noise_deg": noise, "payload_kg": payload, "method": method, "status": "ok"}
        part = {key: [value] * ARMS for key, value in columns.items()} | {"arm": np.arange(ARMS)}
        for quantity, times in (("mean", 1.0), ("rms", 1.1), ("p50", 0.9), ("p95", 1.8), ("max", 2.5)):
            part[f"error_{quantity}_mm"] = times * mean
        part |= {"attitude_mean_deg": 0.1 * mean, "share_within": np.clip(1.95 - mean, 0, 1)}
        parts.append(pa.table(part | {"delta_a0_mm": deviation[:, 0], "delta_alpha1_deg": deviation[:, 1]}))
    return ds.dataset(pa.concat_tables(parts))


@pytest.fixture(scope="module")
def rows():
    return population()


def drawn(figure):
    """Label and points of every curve of the first panel."""
    axes = figure.axes[0]
    return {line.get_label(): np.asarray(line.get_xydata()) for line in axes.get_lines()}


@pytest.mark.parametrize("along", ["it_grade", "poses", "noise_mm", "payload_kg"])
def test_yield_curves_are_the_yields(rows, along):
    table = yields_of(rows, REQUIRED).to_pylist()
    figure = figures.yield_curves(table, along, "95 % of fruit within 1 mm")
    assert figure.axes[0].get_xlabel() == figures.AXES[along][1] and "(%)" in figure.axes[0].get_ylabel()
    numbers = {100 * row["yield"] for row in table}
    for points in drawn(figure).values():
        assert len(points) > 1 and set(points[:, 1]) <= numbers
        assert (np.diff(points[:, 0]) > 0).all()


def test_a_curve_holds_what_it_does_not_show_at_its_middle_value(rows):
    table = yields_of(rows, REQUIRED).to_pylist()
    found = drawn(figures.yield_curves(table, "it_grade", ""))
    assert list(found) == ["raw", "LS, 15 poses to 30 poses (alike)"]  # made up alike, so drawn once
    expected = [
        100 * row["yield"]
        for row in table
        if (row["method"], row["payload_kg"], row["poses"], row["noise_mm"]) == ("ls", 0.0, 30, 0.015)
    ]
    assert found["LS, 15 poses to 30 poses (alike)"][:, 1].tolist() == expected


def test_error_curves_are_medians(rows):
    quantiles = quantiles_of(rows).to_pylist()
    found = drawn(figures.error_curves(quantiles, "payload_kg"))
    medians = [r["value"] for r in quantiles if r["probability"] == 0.5 and r["quantity"] == "error_mean_mm"]
    for points in found.values():
        assert set(points[:, 1]) <= set(medians)
        assert points[:, 0].tolist() == [0.0, 0.25] and points[1, 1] > points[0, 1]


def test_classes_have_a_panel_each():
    both = yields_of(population("fine", "medium"), REQUIRED).to_pylist()
    figure = figures.yield_curves(both, "it_grade", "")
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["Tolerance class fine", "Tolerance class medium"]


def test_a_setting_without_a_result_is_not_drawn(rows):
    table = rows.to_table()
    status = ["did not converge" if grade == 14 else "ok" for grade in table["it_grade"].to_pylist()]
    failed = ds.dataset(table.set_column(table.column_names.index("status"), "status", pa.array(status)))
    quantiles = quantiles_of(failed, ["error_mean_mm"]).to_pylist()
    curves = drawn(figures.error_curves(quantiles, "it_grade")).values()
    assert curves and all(points[:, 0].tolist() == [6, 10] for points in curves)
    assert not any("IT14" in name for name in drawn(figures.distributions(quantiles, radius_mm=1.0)))


def test_distributions_rise_to_one_hundred_percent(rows):
    quantiles = quantiles_of(rows, ["error_mean_mm"], np.linspace(0.02, 0.98, 25)).to_pylist()
    figure = figures.distributions(quantiles, radius_mm=1.0)
    curves = [points for points in drawn(figure).values() if len(points) == 25]
    assert len(curves) == 6  # three grades, raw and calibrated
    for points in curves:
        assert (np.diff(points[:, 1]) > 0).all() and (np.diff(points[:, 0]) >= 0).all()


def test_the_tornados_longest_bar_is_what_matters(rows):
    figure = figures.tornado(sensitivities_of(rows, 0).to_pylist(), "medium, IT6, raw")
    left, right = figure.axes
    widths = [bar.get_width() for bar in left.patches]
    assert left.get_yticklabels()[0].get_text() == "a0"
    assert widths == sorted(widths, reverse=True) and widths[0] > 80.0
    assert "(%)" in left.get_xlabel() and [t.get_text() for t in right.get_yticklabels()] == ["lengths", "angles"]


def test_labels_say_what_a_setting_is(rows):
    labels = [figures.setting_label(row) for row in yields_of(rows, REQUIRED).to_pylist()]
    assert labels[0] == "medium, IT6, raw" and labels[3] == "medium, IT6, LS, 15 poses, noise 0.015 mm, payload 0.25 kg"
    assert len(set(labels)) == len(labels)


def test_figures_are_written_in_both_formats(rows, tmp_path):
    figure = figures.yield_curves(yields_of(rows, REQUIRED).to_pylist(), "it_grade", "95 % of fruit within 1 mm")
    png, svg = (save_figure(figure, tmp_path / f"yield.{kind}") for kind in ("png", "svg"))
    assert png.read_bytes().startswith(b"\x89PNG") and "<svg" in svg.read_text(encoding="utf-8")
