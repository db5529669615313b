"""docs/recordings.md: its programs run in order, its commands exist, its tabs are those of the blueprint."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from pickenv.arm import load_plant

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "recordings.md").read_text(encoding="utf-8")


def test_its_programs_run_and_write_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from numpy.random import default_rng

    from pickenv.calibration import fit, random_joints, simulated_tracker

    plant, rng = load_plant("qiao2026"), default_rng(0)
    measured = simulated_tracker(plant, random_joints(plant.arm.nominal, 60, rng), rng)
    fit(plant.arm, measured, known_frames=True).calibration.save(tmp_path / "runs" / "demo" / "calibration")
    program = "\n".join(re.findall(r"```python\n(.*?)```", TEXT, re.DOTALL))
    monkeypatch.chdir(tmp_path)
    exec(program, {"__name__": "__main__"})
    written = sorted(path.name for path in (tmp_path / "runs" / "recordings").iterdir())
    assert written == ["calibration.rrd", "episodes-scripted.rrd"]


@pytest.mark.parametrize("option", re.findall(r"pickenv inspect runs/demo (--\w+)", TEXT))
def test_its_options_exist(option: str) -> None:
    import inspect

    from pickenv.commands.comparing import inspect as command

    assert option.removeprefix("--") in inspect.signature(command).parameters


def test_its_tabs_are_those_of_the_blueprint(reading: Any) -> None:
    batches = [chunk.to_record_batch() for chunk in reading.blueprint.stream()]
    names = [
        row[0]
        for batch in batches
        for column in ("ContainerBlueprint:display_name", "ViewBlueprint:display_name")
        if column in batch.schema.names
        for row in batch.column(column).to_pylist()
        if row
    ]
    table = TEXT[TEXT.index("| tab |") : TEXT.index("A click on an arrow")]
    tabs = [cell for cells in re.findall(r"^\| ([^|]+) \|", table, re.MULTILINE)[1:] for cell in cells.split(", ")]
    assert len(tabs) == 10
    for tab in tabs:
        assert any(name.startswith(tab) for name in names), tab
