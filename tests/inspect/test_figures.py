from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from pickenv.errors import InputError
from pickenv.inspect import figures
from pickenv.inspect.colours import policy_colours, viridis
from pickenv.inspect.comparison import Comparison
from pickenv.inspect.field_figure import error_fields
from pickenv.inspect.figures import save_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RNG = np.random.default_rng(5)
ERRORS = {"raw": RNG.gamma(4, 1.5, 50), "LS": RNG.gamma(4, 0.15, 50), "LS + BPNN": RNG.gamma(4, 0.1, 50)}
NAMES = [f"theta{i}" for i in range(12)]
MAGNITUDES = np.geomspace(1.0, 1e-4, 12)
KEPT = np.arange(12) < 10

PLOTS: dict[str, tuple[Callable[[], Figure], tuple[str, ...]]] = {
    "per pose": (lambda: figures.error_per_pose(ERRORS, tolerance_mm=5.0), ("(number)", "(mm)")),
    "box": (lambda: figures.error_by_method(ERRORS), ("(mm)",)),
    "box, attitude": (
        lambda: figures.error_by_method(ERRORS, quantity="attitude error", unit="deg", logarithmic=True),
        ("(deg)",),
    ),
    "least squares": (
        lambda: figures.least_squares_convergence([6.8, 0.9, 0.5], [0.3, 0.02, 0.02]),
        ("(number)", "(mm)", "(deg)"),
    ),
    "network": (lambda: figures.network_convergence([1.0, 0.3], [1.1, 0.4], best_epoch=1), ("(number)", "(–)")),
    "diagonal of R": (
        lambda: figures.parameter_spectrum(MAGNITUDES, KEPT, names=NAMES, threshold=2e-4),
        ("(scaled, –)",),
    ),
    "singular values": (lambda: figures.parameter_spectrum(np.append(MAGNITUDES[:-1], 0.0), KEPT), ("(scaled, –)",)),
}


def texts(figure: Figure) -> str:
    labels = [text for axes in figure.axes for text in (axes.get_xlabel(), axes.get_ylabel(), axes.get_title("left"))]
    labels += [t.get_text() for axes in figure.axes for t in [*axes.texts, *axes.get_xticklabels(), axes.title]]
    return "\n".join([*labels, figure.get_suptitle()])


@pytest.mark.parametrize("name", PLOTS)
def test_axes_name_their_units_and_the_file_is_written(name: str, tmp_path: Path) -> None:
    make, units = PLOTS[name]
    figure = make()
    for unit in units:
        assert unit in texts(figure)
    for axes in figure.axes:
        assert axes.get_ylabel()
    path = save_figure(figure, tmp_path / "figure.png")
    assert path.read_bytes()[:4] == b"\x89PNG"


def test_dropped_parameters_are_named_in_red() -> None:
    figure = figures.parameter_spectrum(MAGNITUDES, KEPT, names=NAMES)
    labels = figure.axes[0].get_xticklabels()
    assert [label.get_text() for label in labels] == NAMES
    assert [label.get_color() == "black" for label in labels] == list(KEPT)


def test_each_method_keeps_its_colour() -> None:
    expected = policy_colours(["raw", "ls", "ls_bpnn"])
    assert policy_colours(list(ERRORS)) == expected
    lines = figures.error_per_pose(ERRORS).axes[0].get_lines()
    drawn = [tuple(round(255 * float(c)) for c in line.get_color()) for line in lines]  # type: ignore[arg-type]
    assert drawn == expected
    assert len(set(policy_colours(["raw", "servo", "rl", "ls"]))) == 4


def test_joint_coverage_is_framed_by_the_joint_limits_in_degrees_and_millimetres(
    comparison: Comparison, tmp_path: Path
) -> None:
    geometry = comparison.nominal
    q = RNG.uniform(geometry.lower, geometry.upper, size=(40, geometry.joints))
    figure = figures.joint_coverage(geometry, {"identification": q, "training": q[:20], "test": q[:10]})
    bottom = figure.axes[-geometry.joints :]
    units = ["mm" if slides else "deg" for slides in geometry.prismatic]
    assert [axes.get_xlabel() for axes in bottom] == [f"q{i + 1} ({unit})" for i, unit in enumerate(units)]
    np.testing.assert_allclose(bottom[0].get_xlim(), np.degrees([geometry.lower[0], geometry.upper[0]]))
    np.testing.assert_allclose(bottom[1].get_xlim(), 1e3 * np.array([geometry.lower[1], geometry.upper[1]]))
    assert save_figure(figure, tmp_path / "coverage.png").stat().st_size > 0


def test_error_fields_share_view_scale_and_gain(comparison: Comparison, tmp_path: Path) -> None:
    from matplotlib.collections import PolyCollection
    from matplotlib.image import imread

    figure = error_fields(comparison, gain=30.0)
    *panels, bar = figure.axes
    assert len(panels) == 3
    assert {panel.get_xlim() for panel in panels} == {panels[0].get_xlim()}
    assert {panel.get_ylim() for panel in panels} == {panels[0].get_ylim()}
    assert "(mm)" in bar.get_xlabel()
    assert "×30" in figure.get_suptitle()
    for unit in ("x (m)", "y (m)", "z (m)"):
        assert all(unit in [text.get_text() for text in panel.texts] for panel in panels)
    arrows = [next(c for c in panel.collections if isinstance(c, PolyCollection)) for panel in panels]
    lengths = [np.mean([np.ptp(path.vertices, axis=0).max() for path in arrow.get_paths()]) for arrow in arrows]
    raw, ls, bpnn = (1e3 * np.linalg.norm(policy.field_errors, axis=-1).mean() for policy in comparison.policies)
    assert lengths[0] > lengths[1] > lengths[2]
    assert raw > ls > bpnn
    pixels = imread(save_figure(figure, tmp_path / "fields.png"))
    assert pixels.shape[1] == 1600


def test_error_fields_of_one_policy_and_a_gappy_grid(without_reaches: Comparison, tmp_path: Path) -> None:
    figure = error_fields(without_reaches)
    assert save_figure(figure, tmp_path / "fields.png").stat().st_size > 0


def test_viridis_is_the_one_that_matplotlib_has() -> None:
    import matplotlib

    t = np.linspace(0.0, 1.0, 101)
    theirs = matplotlib.colormaps["viridis"](t)[:, :3] * 255
    assert np.abs(viridis(t).astype(float) - theirs).max() < 6
    np.testing.assert_array_equal(viridis([-1.0, 2.0]), viridis([0.0, 1.0]))


def test_drawing_leaves_the_settings_of_matplotlib_alone() -> None:
    import matplotlib

    before = dict(matplotlib.rcParams)
    figures.error_per_pose(ERRORS)
    assert dict(matplotlib.rcParams) == before


@pytest.mark.parametrize("values", [[], [1.0, np.nan]])
def test_a_series_that_cannot_be_drawn_is_named(values: list[float]) -> None:
    with pytest.raises(InputError, match="'LS'"):
        figures.error_per_pose({"raw": [1.0], "LS": values})


def test_an_unknown_format_and_a_folder_that_cannot_be_written_are_refused(tmp_path: Path) -> None:
    figure = figures.error_per_pose(ERRORS)
    with pytest.raises(InputError, match="png"):
        save_figure(figure, tmp_path / "figure.docx")
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(InputError, match="cannot write"):
        save_figure(figure, tmp_path / "file" / "figure.png")
    assert [path.name for path in tmp_path.iterdir()] == ["file"]
