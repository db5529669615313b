"""What a command writes goes over nothing that it reads, and is saved before it is printed."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pickenv.arm import PLANTS
from pickenv.base import InputError, write_container, write_text
from pickenv.cli import app
from pickenv.commands import comparing, plants
from pickenv.commands.showing import deliver
from pickenv.inspect import read_run, recorded_run

ROOT = Path(__file__).parents[1]


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with a file of each kind that commands read; none is touched, so each may hold anything."""
    monkeypatch.chdir(tmp_path)
    for name in ("cal.npz", "policy.npz", "tolerances.toml"):
        Path(name).write_text("kept")
    Path("plant.toml").write_text((PLANTS / "orchard.toml").read_text())
    text = (ROOT / "scripts" / "tolerance_study.toml").read_text()
    Path("study.toml").write_text(re.sub('plant = ".*"', 'plant = "plant.toml"', text))
    with recorded_run(Path("run"), "iso9283", "pickenv iso9283", 0):
        write_text("run/iso9283.json", "kept")
    return {path: path.read_bytes() for path in sorted(tmp_path.rglob("*")) if path.is_file()}


OVERWRITING = {
    "effects": "effects --plant plant.toml --json plant.toml",
    "iso9283 --json": "iso9283 --calibration cal.npz --json cal.npz",
    "iso9283, suffix left out": "iso9283 --calibration cal --json cal.npz",
    "iso9283 --out": "iso9283 --out run --json run/run.json",
    "train --compensate": "train --compensate policy.npz --out .",
    "evaluate --policy": "evaluate --policy policy.npz --json policy.npz",
    "experiment --table": "experiment new.toml --json new.csv --table run/../new.csv",
    "evaluate --out": "evaluate --out new --json new/rows.json",
    "study --json": "study study.toml --json study.toml",
    "study, its plant": "study study.toml --json plant.toml",
    "study --out": "study study.toml --out new --json new/summary.json",
    "report": "report run --out run/iso9283.json",
    "check": "check cal.npz --json cal.npz",
    "check, a run": "check run --json run/iso9283.json",
}


@pytest.mark.parametrize("command", OVERWRITING)
def test_no_command_writes_over_what_it_reads_or_into_one_file_twice(command, here, tmp_path):
    ended = CliRunner().invoke(app, OVERWRITING[command].split())
    assert isinstance(ended.exception, InputError)
    assert re.search("would write over .*; give --[a-z]+ another file", str(ended.exception))
    assert {path: path.read_bytes() for path in sorted(tmp_path.rglob("*")) if path.is_file()} == here


def test_a_figure_that_is_a_link_to_the_numbers_is_not_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr("pickenv.inspect.drawings_of", lambda run: [reports_drawing("accuracy")])
    with recorded_run(tmp_path, "iso9283", "pickenv iso9283", 0):
        numbers = write_text(tmp_path / "iso9283.json", "kept")
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "accuracy.svg").symlink_to(numbers)
    with pytest.raises(InputError, match=r"--out would write over .*accuracy\.svg, which RUN reads"):
        comparing.figures(tmp_path, formats="svg")
    assert numbers.read_text() == "kept"


def reports_drawing(name):
    from pickenv.inspect import Drawing

    return Drawing(name, "", lambda: pytest.fail("drawn"))


def test_results_are_saved_before_they_are_shown(tmp_path):
    def show():
        assert (tmp_path / "a.txt").read_text() == "a"
        raise OSError(28, "No space left on device")

    with pytest.raises(OSError, match="No space left"):
        deliver([(tmp_path / "a.txt", lambda path: write_text(path, "a"))], show)


def test_results_that_cannot_be_saved_are_shown(tmp_path, capsys):
    (tmp_path / "taken").touch()
    places = (tmp_path / "a.txt", None, tmp_path / "taken" / "b.txt")
    save = [(place, lambda path: write_text(path, "a")) for place in places]
    with pytest.raises(InputError, match=r"cannot write .*b\.txt"):
        deliver(save, lambda: print("0.5 mm"))
    assert capsys.readouterr().out == f"0.5 mm\nwrote {tmp_path / 'a.txt'}\n"


COMMANDS = {
    "effects": ["effects", "--plant", "geometry_only", "--reaches", "2", "--json", "out.json"],
    "iso9283": ["iso9283", "--plant", "geometry_only", "--cycles", "2", "--json", "out.json", "--out", "run"],
}


@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="no /dev/full here")
@pytest.mark.parametrize("command", ["effects", pytest.param("iso9283", marks=pytest.mark.slow)])
def test_a_full_standard_output_costs_no_result(command, tmp_path):
    handle = os.open("/dev/full", os.O_WRONLY)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "pickenv.cli", *COMMANDS[command]],
            cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, stdout=handle, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
    finally:
        os.close(handle)
    assert done.returncode == 74 and "Traceback" not in done.stderr
    assert json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    assert command != "iso9283" or read_run(tmp_path / "run").kind == "iso9283"


def test_the_command_in_a_run_can_be_typed_as_it_stands(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    name = "my plant; touch owned.toml"
    Path(name).write_text((PLANTS / "geometry_only.toml").read_text())
    plants.iso9283(plant=name, cycles=2, out=Path("run"))
    words = shlex.split(read_run("run").command)
    assert words[:4] == ["pickenv", "iso9283", "--plant", name]
    assert read_run("run").made_by == "pickenv iso9283 --out run"


def writing_options() -> list[tuple[str, str]]:
    """Every command with an option that names a file to write, as its help says: the command's words and the option."""
    from typer.main import get_command

    commands = dict(get_command(app).commands)
    commands |= {f"bench {name}": command for name, command in commands.pop("bench").commands.items()}
    return [
        (name, option.opts[0])
        for name, command in commands.items()
        for option in command.params
        if re.match("Write the (?!column)|File to write|Write (a|the|what)", getattr(option, "help", None) or "")
    ]


NEEDED = {
    "calibrate": "nothing.csv",
    "board": "charuco_a4",
    "verify": "nothing.npz nothing.csv",
    "plan-poses": "--arm ur5",
    "apply": "nothing.npz nothing.csv --arm ur5",
    "export": "nothing.npz --out new.toml",
    "check": "nothing.npz",
    "twin": "nothing.npz",
    "conditions": "orchard",
    "compare": "scripted oracle",
    "study": "study.toml",
    "experiment": "nothing.toml",
    "film": "run",
    "report": "run",
}
"""What commands want besides; none of it is read before it is known where results go."""


@pytest.mark.parametrize(("command", "option"), writing_options())
@pytest.mark.parametrize("place", ["/", ".", "..", "run", "/dev", "link"])
def test_a_folder_in_place_of_a_file_is_refused_before_anything_is_computed(command, option, place, here, tmp_path):
    Path("link").symlink_to("run")
    if (command, option) in {("calibrate", "--out"), ("twin", "--out")} and place not in ("/", ".", ".."):
        Path(place).with_name(f"{place}.npz").mkdir() if place != "/dev" else pytest.skip("/dev.npz is no folder")
    words = [*command.split(), *NEEDED.get(command, "").split(), option, place]
    ended = CliRunner().invoke(app, words)
    assert isinstance(ended.exception, InputError), (ended.exception, ended.output)
    assert re.fullmatch(r"cannot write \S+: it is a folder; give the name of a file", str(ended.exception))
    assert {path: path.read_bytes() for path in sorted(tmp_path.rglob("*")) if path.is_file()} == here


@pytest.mark.parametrize("place", ["/", ".", ".."])
@pytest.mark.parametrize("kind", ["mjcf", "urdf", "table", "onnx"])
def test_nothing_is_exported_in_place_of_a_folder(kind, place):
    ended = CliRunner().invoke(app, ["export", "nothing.npz", "--as", kind, "--out", place])
    assert isinstance(ended.exception, InputError)
    assert str(ended.exception) == f"cannot write {place}: it is a folder; give the name of a file"


def test_every_command_that_writes_files_is_asked():
    named = {option for _, option in writing_options()}
    assert named >= {"--json", "--out", "--report", "--lens-out", "--table"} and len(writing_options()) >= 25


@pytest.mark.parametrize("place", ["/", ".", "run"])
@pytest.mark.parametrize("write", [lambda path: write_text(path, "a"), lambda path: write_container(path, "a", {}, {})])
def test_no_writer_puts_a_file_in_place_of_a_folder(write, place, here, tmp_path):
    with pytest.raises(InputError, match=r"cannot write \S+: Is a directory; choose a folder that can be written"):
        write(place)
    assert {path: path.read_bytes() for path in sorted(tmp_path.rglob("*")) if path.is_file()} == here
