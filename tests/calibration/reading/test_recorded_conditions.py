"""Payload, temperature and torques of a file: absurd ones are refused with their line, unused ones are named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from typer.testing import CliRunner

from pickenv.arm import Arm, Plant
from pickenv.base import InputError
from pickenv.calibration import (
    Calibration,
    Choices,
    Conditions,
    calibrate,
    fit,
    random_joints,
    read_measurements,
    simulated_tracker,
)
from pickenv.cli import app

PLAIN = Choices(terms="none", residual="none")


@pytest.fixture(scope="module")
def rows(dynamic: Plant, tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Lines of a file of ours: a header and 60 poses."""
    rng = np.random.default_rng(0)
    data = simulated_tracker(dynamic, random_joints(dynamic.arm.nominal, 60, rng), rng)
    return data.write_csv(tmp_path_factory.mktemp("rows") / "rows.csv").read_text().splitlines()


def with_column(rows: list[str], name: str, values: list[str], folder: Path) -> Path:
    path = folder / "conditions.csv"
    path.write_text("\n".join(f"{row},{cell}" for row, cell in zip(rows, [name, *values], strict=True)) + "\n")
    return path


@given(
    st.sampled_from([("temperature_degC", 21.0), ("payload_kg", 0.5)]),
    st.integers(0, 59),
    st.sampled_from(["nan", "inf", "-inf", "", "1e9", "-1e9", "1e308", "-301", "x"]),
)
def test_one_absurd_condition_is_refused_with_its_line(
    rows: list[str],
    qiao: Arm,
    tmp_path_factory: pytest.TempPathFactory,
    column: tuple[str, float],
    row: int,
    value: str,
) -> None:
    name, usual = column
    values = [str(usual)] * 60
    values[row] = value
    path = with_column(rows, name, values, tmp_path_factory.getbasetemp())
    with pytest.raises(InputError, match=rf"conditions\.csv: row {row + 2}, column '{name}'") as caught:
        read_measurements(path, qiao.nominal)
    assert len(str(caught.value).splitlines()) == 1


@pytest.mark.parametrize("name", ["payload", "Temperature_K", "torque1_Nm", "temp"])
def test_a_condition_that_is_not_of_our_format_is_not_passed_over(
    name: str, rows: list[str], qiao: Arm, tmp_path: Path
) -> None:
    path = with_column(rows, name, ["nan"] * 60, tmp_path)
    with pytest.raises(
        InputError, match=f"column '{name}' is none of our format's, which records temperature_degC and"
    ):
        read_measurements(path, qiao.nominal)


@pytest.mark.parametrize(("name", "what"), [("payload_kg", "payload"), ("temperature_degC", "temperature")])
def test_conditions_that_nothing_depends_on_are_named(
    name: str, what: str, rows: list[str], qiao: Arm, tmp_path: Path
) -> None:
    path = with_column(rows, name, [str(0.1 * i) for i in range(60)], tmp_path)
    said = f"nothing that was fitted depends on what was recorded of {what} (see `terms`)"
    plain = calibrate(qiao, path, choices=PLAIN)
    assert [item for item in plain.quality.findings if "recorded" in item[1]] == [("note", said)]
    term = {"payload": "gravity", "temperature": "thermal"}[what]
    used = calibrate(qiao, path, choices=Choices(terms=term, residual="none"))
    assert not any("recorded" in text for _, text in used.quality.findings)


@pytest.mark.parametrize(
    ("option", "value", "limits"),
    [
        ("--temperature-k", "1e9", "-200 to 200"),
        ("--temperature-k", "nan", "-200 to 200"),
        ("--payload-kg", "-1", "0 to 300"),
        ("--payload-kg", "inf", "0 to 300"),
    ],
)
def test_absurd_conditions_are_not_applied(option: str, value: str, limits: str, tmp_path: Path) -> None:
    words = [
        "apply",
        "calibration.npz",
        "targets.csv",
        "--arm",
        "ur5",
        "--out",
        str(tmp_path / "out.csv"),
        option,
        value,
    ]
    ended = CliRunner().invoke(app, words)
    assert isinstance(ended.exception, InputError)
    assert str(ended.exception).startswith(f"{option} is ") and f"; give {limits}: " in str(ended.exception)


def test_a_temperature_is_no_payload(dynamic: Plant, tmp_path: Path) -> None:
    """Of a residual that was learnt with payloads, from a file."""
    rng = np.random.default_rng(0)
    load = rng.uniform(0.0, 3.0, 90)
    data = simulated_tracker(dynamic, random_joints(dynamic.arm.nominal, 90, rng), rng)
    data = replace(data, conditions=Conditions(payload=load))
    found = fit(dynamic.arm, data.select(np.arange(50)), data, known_frames=True, residual="rbf", rng=rng).calibration
    found = Calibration.load(found.save(tmp_path / "loaded"))
    found.predict(data.joints[:2], Conditions(payload=np.array(2.0)))
    with pytest.raises(InputError, match="depends on payload, but temperature is given"):
        found.predict(data.joints[:2], Conditions(temperature=np.array(2.0)))
    with pytest.raises(InputError, match="depends on payload, but temperature is given"):
        found.errors(replace(data, conditions=Conditions(temperature=load)))
