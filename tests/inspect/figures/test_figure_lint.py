"""No figure leaves with writing that collides, a series that hides another, or an axis without a unit."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from pickenv.calibration import Choices, calibrate
from pickenv.commands.corrections import write_run
from pickenv.experiments import SETS, PolicySettings, load_study, run_policies, run_study, write_outputs
from pickenv.experiments.policy_tables import evaluation_drawings
from pickenv.experiments.robots import learnable
from pickenv.inspect import Run, drawings_of, read_run
from pickenv.inspect.figures import plot_calibration, style
from pickenv.inspect.figures.run_drawings import Drawings
from pickenv.inspect.reports import report_page
from tests.experiments.conftest import SMALL
from tests.experiments.synthetic import FRUIT, rows_of
from tests.inspect.figures.figure_lint import DARK, contrast_of, figure_faults, heading_of, linting

CSS = Path(report_page.__file__).parent / "templates/report.css"
RAW, LS, GREY = "#e69f00", "#0072b2", "#96969e"


def lines(**curves: tuple[str, Any]) -> Figure:
    """A sound figure of named curves; each has a colour."""
    with style.new_figure(4.0, 3.0) as figure:
        axes = figure.add_subplot(xlabel="time (s)", ylabel="error (mm)", title="Raw errs 2 mm")
        for name, (colour, values) in curves.items():
            axes.plot(np.arange(len(values)), values, color=colour, label=name)
        figure.legend(loc="outside lower center")
    return figure


def sound() -> Figure:
    return lines(raw=(RAW, [2.0, 3.0, 1.0]), LS=(LS, [0.5, 0.1, 0.2]))


def faults(drawings: Drawings | Mapping[str, Callable[[], Figure]]) -> list[str]:
    """What is found wrong with figures that belong together."""
    draws = drawings if isinstance(drawings, Mapping) else {d.name: d.draw for d in drawings if d.draw is not None}
    assert draws
    figures = {name: draw() for name, draw in draws.items()}
    faults = [f"{name}: {fault}" for name, figure in figures.items() for fault in figure_faults(figure)]
    names: dict[str, str] = {}
    for name, figure in figures.items():
        first = names.setdefault(heading_of(figure), name)
        if first != name:
            faults.append(f"{name}: has the title of {first}, '{heading_of(figure)}'")
    return faults


def test_what_is_written_or_set_into_a_page_is_judged(tmp_path: Path) -> None:
    with linting() as faults:
        style.save_figure(sound(), tmp_path / "one.svg")
        report_page.inline_svg(sound(), "two")
        assert faults == []
        style.save_figure(lines(raw=(LS, [1.0, 2.0])), tmp_path / "three.svg")
        report_page.inline_svg(lines(raw=(LS, [1.0, 2.0])), "four")
    assert faults == ["Raw errs 2 mm: 'raw' has the colour #0072b2, not its own"] * 2
    style.save_figure(lines(raw=(LS, [1.0, 2.0])), tmp_path / "five.svg")
    assert len(faults) == 2


def without_unit(figure: Figure) -> None:
    figure.axes[0].set_ylabel("error")


def without_number(figure: Figure) -> None:
    figure.axes[0].set_title("Errors", loc="left")
    figure.axes[0].set_title("")


def colliding(figure: Figure) -> None:
    figure.axes[0].text(0.5, 2.5, "the mean of all")
    figure.axes[0].text(0.52, 2.52, "the median")


def turned_and_colliding(figure: Figure) -> None:
    figure.axes[0].text(0.5, 2.0, "the mean of all of them", rotation=45.0)
    figure.axes[0].text(1.0, 2.5, "the median of all", rotation=45.0, ha="center", va="center")
    figure.axes[0].text(1.0, 2.5, "another", rotation=-45.0, ha="center", va="center")


def cut_off(figure: Figure) -> None:
    figure.text(0.95, 0.5, "this does not fit at all")


def named_but_not_drawn(figure: Figure) -> None:
    figure.axes[0].plot([], [], color="#cc79a7", label="GP")
    figure.legend(loc="upper left")


def faint_writing(figure: Figure) -> None:
    figure.axes[0].text(0.5, 2.5, "hardly seen", color="#c0c0c0")


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (without_unit, "the y axis of panel 1 has numbers and no unit: 'error'"),
        (without_number, "no number: 'Errors'"),
        (colliding, "'the mean of all' and 'the median' overlap"),
        (turned_and_colliding, "'the median of all' and 'another' overlap"),
        (cut_off, "'this does not fit at all' reaches beyond the picture"),
        (named_but_not_drawn, "the legend names 'GP', and no series has its colour"),
        (faint_writing, "writing in #c0c0c0 has a contrast of 1.82 on light paper, below 4.5"),
    ],
)
def test_a_fault_is_found(spoil: Callable[[Figure], None], said: str) -> None:
    assert figure_faults(sound()) == []
    figure = sound()
    spoil(figure)
    assert any(said in fault for fault in figure_faults(figure)), figure_faults(figure)


def test_series_must_be_told_apart() -> None:
    (said,) = figure_faults(lines(raw=(RAW, [2.0, 3.0, 1.0]), LS=(LS, [2.0, 3.0, 1.0])))
    assert said == "the lines 'raw' and 'LS' lie on one another"
    (said,) = figure_faults(lines(one=(GREY, [2.0, 3.0, 1.0]), two=(GREY, [0.5, 0.1, 0.2])))
    assert said == "two entries of the legend look alike, one is 'two'"
    (said,) = figure_faults(lines(raw=(LS, [2.0, 3.0, 1.0])))
    assert said == "'raw' has the colour #0072b2, not its own"
    (said,) = figure_faults(lines(other=("#f0e442", [2.0, 3.0, 1.0])))
    assert said.startswith("a series of the legend in #f0e442 has a contrast of 1.3")


def test_two_figures_of_a_run_may_not_have_one_title() -> None:
    assert faults({"first": sound, "second": sound}) == ["second: has the title of first, 'Raw errs 2 mm'"]


def test_contrast_is_that_of_wcag() -> None:
    assert contrast_of("#ffffff", "#000000") == pytest.approx(21.0)
    assert contrast_of("#777777", "#ffffff") == pytest.approx(4.48, abs=0.005)  # the grey that just fails, as is known


def test_the_dark_colours_are_those_of_pages() -> None:
    dark = re.search(r"prefers-color-scheme: dark\) \{ :root \{(.*?)\}", CSS.read_text(encoding="utf-8"), flags=re.S)
    assert dark is not None
    variables = dict(re.findall(r"--(\w+):\s*(#\w+)", dark[1]))
    assert {style.THEME[colour]: shown for colour, shown in DARK.items()} == {
        name: variables[name] for name in style.THEME.values()
    }


@pytest.mark.slow
def test_the_figures_of_a_demonstration_are_sound(demo_run: Run) -> None:
    assert faults(drawings_of(demo_run)) == []


def test_names_that_do_not_fit_are_thinned(monkeypatch: pytest.MonkeyPatch) -> None:
    """138 parameters, as the first measured robot had."""
    names, values = [f"gravity{i}_2m" for i in range(138)], np.geomspace(1.0, 1e-4, 138)

    def draw() -> Figure:
        return plot_calibration.parameter_spectrum(values, values > 1e-3, names=names)

    assert figure_faults(draw()) == []
    monkeypatch.setattr(style, "spaced", lambda labels, *_: list(labels))
    assert "'gravity3_2m' and 'gravity4_2m' overlap" in figure_faults(draw())


def test_the_figures_of_an_evaluation_are_sound() -> None:
    arms = np.linspace(1.0, 3.0, 12)[:, None, None] * np.ones((1, 1, len(FRUIT))) * FRUIT
    assert faults(evaluation_drawings(rows_of(arms, 0.3 * arms, 0.1 * arms))) == []


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ur5", "wam", "ur10_a"])
def test_figures_and_page_of_a_measured_robot_are_sound(name: str, data_folder: Path, tmp_path: Path) -> None:
    arm, rows, _ = SETS[name].load(data_folder)
    result = calibrate(arm, learnable(arm, rows, 300), choices=Choices(residual="none"))
    with linting() as found:
        write_run(tmp_path / name, f"pickenv calibrate {name}.csv", 0, result, {"seed": 0})
    assert found == []
    assert faults(drawings_of(read_run(tmp_path / name))) == []


@pytest.mark.slow
def test_figures_of_a_small_study_are_sound(tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(SMALL, encoding="utf-8")
    run_study(load_study(tmp_path / "small.toml"), tmp_path / "study", executor="serial")
    with linting() as found:
        write_outputs(tmp_path / "study")
    assert found == []


@pytest.mark.slow
def test_figures_of_compared_policies_are_sound() -> None:
    settings = PolicySettings(("scripted", "servo"), ("raw", "ls"), plants=("qiao2026", "orchard"), arms=10, episodes=4)
    assert faults(evaluation_drawings(run_policies(settings))) == []
