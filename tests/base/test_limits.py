"""A number that no machine and no instrument has, or that would compute for ever, is refused with its limits."""

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pickenv.base import LIMITS, InputError, check_limit
from pickenv.cli import app
from pickenv.experiments import load_study

ROOT = Path(__file__).parents[2]
STUDY = ROOT / "scripts" / "tolerance_study.toml"


@pytest.mark.parametrize("quantity", LIMITS)
def test_both_limits_are_allowed_and_nothing_beyond(quantity):
    least, most, why = LIMITS[quantity]
    check_limit("it", least, quantity)
    check_limit("it", most, quantity)
    for value in (least - 1, most + 1, most * 10, float("nan"), float("inf"), 10**5000, True, "1", None):
        with pytest.raises(InputError, match=rf"^it is .{{1,45}}; give .* to .*: {why}$"):
            check_limit("it", value, quantity)


COMMANDS = {
    "effects --hours inf": "--hours is inf; give 0 to 10 000",
    "effects --hours 1e300": r"--hours is 1e\+300; give 0 to 10 000",
    "effects --dwell inf": "--dwell is inf; give 0 to 86 400",
    "effects --reaches 1000000000": "--reaches is 1000000000; give 2 to 100 000",
    "iso9283 --dwell inf": "--dwell is inf; give 0 to 86 400",
    "iso9283 --cycles 1000000000": "--cycles is 1000000000; give 2 to 10 000",
    "plan-poses --arm ur5 --noise-mm 5e-324": "--noise-mm is 5e-324; give 1e-06 to 100",
    "plan-poses --arm ur5 --noise-mm inf": "--noise-mm is inf; give 1e-06 to 100",
    "plan-poses --arm ur5 --candidates 100000000": "candidates is 100000000; give 10 to 100 000",
    "evaluate --arms 1000000000": "arms is 1000000000; give 1 to 10 000",
    "evaluate --episodes 1000000000": "episodes is 1000000000; give 1 to 100 000",
    "evaluate --epochs 1000000000": "epochs is 1000000000; give 1 to 100 000",
    "train --seed 4294967296": "seed is 4294967296; give 0 to 4 294 967 295",
    f"study {STUDY} --sobol --samples 1000000000": "--samples is 1000000000; give 256 to 1 048 576",
}


@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_refuses_it_and_says_the_limits(command, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ended = CliRunner().invoke(app, command.split())
    assert isinstance(ended.exception, InputError), ended.output
    assert re.match(COMMANDS[command], str(ended.exception)), ended.exception
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("key", "value", "said"),
    [
        ("arms", "1" + 18 * "0", "arms is .*give a whole number from 1 to 10000000"),
        ("chunk", "100001", "chunk is .*give a whole number from 1 to 100000"),
        ("fruit", "1000000000", "fruit of .*give a whole number from 1 to 100000"),
        ("payload_kg", "[1e300]", r"payload_kg\[0\] of .*give a number from 0 to 300 kg"),
        ("payload_kg", "[500.0]", r"payload_kg\[0\] of .*give a number from 0 to 300 kg"),
        ("radius_mm", "1e6", "radius_mm of .*"),
        ("poses", "[1000000]", r"poses\[0\] of .*give a whole number from 1 to 10000"),
        ("noise", "[{ position_mm = 1e6, attitude_deg = 0.01 }]", "position_mm of .*"),
        (
            "noise",
            "[{ position_mm = 0.05, attitude_deg = 90.0 }]",
            "attitude_deg of .* is 90; give a number from 0 to 10",
        ),
        ("poses", "[15]\nresidual_poses = 1000000000", "residual_poses of .*give a whole number from 1 to 10000"),
    ],
)
def test_a_study_refuses_it_and_names_file_and_key(key, value, said, tmp_path):
    text, count = re.subn(rf"(?m)^{key} = .*$", f"{key} = {value}", STUDY.read_text(encoding="utf-8"))
    assert count == 1
    path = tmp_path / "study.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=rf"study.toml, line \d+: {said}"):
        load_study(path)
