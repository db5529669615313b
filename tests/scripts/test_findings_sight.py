"""The study of one look and many: what the eye says wrongly stays, and what the arm does wrongly cancels from near."""

from pathlib import Path

import numpy as np
import pytest

from pickenv.experiments import Rows, load_experiment

STUDY = Path(__file__).parents[2] / "scripts/studies/findings_sight.toml"


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Rows:
    """Four raw and calibrated arms, six fruit each, with a perfect eye, a scattering one and a biased one."""
    word = "findings.py:sight"
    measure = load_experiment(STUDY).functions[word]
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(measure.__globals__, "SEEING", ("raw", "ls"))
        folder = str(tmp_path_factory.mktemp("findings"))
        return Rows.of(measure(np.random.default_rng(5), "qiao2026", 4, 6, 1, [0.0, 2.0], [0.0, 3.0], folder, 5, 0))


def left(rows: Rows, use: str, scatter: float = 0.0, bias: float = 0.0) -> float:
    return float(rows.where(use=use, scatter_mm=scatter, bias_mm=bias)["error_mm"].mean())


def test_with_a_perfect_eye_only_the_arm_errs_and_from_near_its_error_cancels(rows: Rows) -> None:
    assert left(rows, "in every period, raw") < 0.05
    assert left(rows, "once from near, raw") < 0.3 * left(rows, "once from afar, raw")
    assert left(rows, "once from afar, LS") < 0.8 * left(rows, "once from afar, raw")


def test_a_bias_stays_however_often_an_arm_looks_and_scatter_averages(rows: Rows) -> None:
    always, near = "in every period, raw", "once from near, LS"
    assert left(rows, always, bias=3.0) == pytest.approx(left(rows, near, bias=3.0), rel=0.1)
    assert left(rows, always, scatter=2.0) < 0.4 * left(rows, near, scatter=2.0)


def test_from_afar_the_eye_scatters_more(rows: Rows) -> None:
    assert left(rows, "once from afar, LS", scatter=2.0) > 1.5 * left(rows, "once from near, LS", scatter=2.0)
