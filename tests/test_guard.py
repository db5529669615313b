"""However a command ends, it ends with one sentence and its own exit code, never with a traceback on the screen."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from pickenv.cli import app
from pickenv.commands import guard

ROOT = Path(__file__).parents[1]
PLAIN = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}


def ended(code: str, stdout: int | None = None, **environment: str) -> "subprocess.CompletedProcess[str]":
    """The front door, with ``code`` as the command behind it."""
    program = f"import sys\nimport pickenv.cli as cli\ndef app(**_):\n {code}\ncli.app = app\ncli.main()"
    given = os.environ | {"PYTHONPATH": str(ROOT)} | environment
    out = subprocess.PIPE if stdout is None else stdout
    command = [sys.executable, "-c", program]
    return subprocess.run(command, stdout=out, stderr=subprocess.PIPE, encoding="latin-1", env=given)


FAULTS = ["1 / 0", "f = lambda: f(); f()", "raise MemoryError", "raise Exception('x' * 10**6)", "raise OSError('odd')"]


@pytest.mark.parametrize("code", FAULTS)
def test_an_unexpected_error_is_one_sentence_and_its_traceback_a_file(code: str, tmp_path: Path) -> None:
    done = ended(code, TMPDIR=str(tmp_path))
    (file,) = tmp_path.iterdir()
    assert done.returncode == 70
    assert done.stderr.count("\n") == 1 and len(done.stderr) < 600
    assert str(file) in done.stderr
    assert "Traceback (most recent call last)" in file.read_text(encoding="utf-8")


def test_without_a_folder_for_temporary_files_the_traceback_is_written_where_we_are(tmp_path: Path) -> None:
    code = "import tempfile, os; tempfile.gettempdir = lambda: '/no/such/folder'; os.chdir(sys.argv[-1]); 1 / 0"
    done = ended(code.replace("sys.argv[-1]", repr(str(tmp_path))))
    (file,) = tmp_path.iterdir()
    assert done.returncode == 70 and str(file) in done.stderr and "Traceback" not in done.stderr


def test_the_package_runs_as_a_module() -> None:
    command = [sys.executable, "-m", "pickenv", "apply", "no.npz", "no.csv", "--arm", "ur5e"]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)})
    assert done.returncode == 2 and done.stderr.startswith("error: ") and "no.npz" in done.stderr


def test_without_any_folder_the_traceback_is_shown() -> None:
    code = "import tempfile, os; tempfile.gettempdir = os.getcwd = lambda: '/no/such/folder'; 1 / 0"
    done = ended(code)
    assert done.returncode == 70
    assert "Traceback" in done.stderr and "ZeroDivisionError" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    ("code", "exit_code", "said"),
    [
        ("from pickenv.base.errors import InputError; raise InputError('row 3 is bad')", 2, "error: row 3 is bad"),
        ("open('n' * 300)", 2, "error: cannot use n{300}: File name too long"),
        ("open('/no/such')", 2, "error: cannot use /no/such: No such file or directory"),
        ("raise KeyboardInterrupt", 130, "interrupted; .* nothing is left half-written"),
        ("import typer; raise typer.Abort", 130, "interrupted; .* nothing is left half-written"),
        ("return 3", 3, ""),
        ("return None", 0, ""),
    ],
)
def test_each_end_has_its_exit_code_and_its_sentence(code: str, exit_code: int, said: str) -> None:
    done = ended(code)
    assert done.returncode == exit_code
    assert re.fullmatch(said, done.stderr.strip()), done.stderr


LONG = "n" * 300
COMMANDS = [
    f"effects --plant {LONG}",
    f"effects --plant {LONG}.toml",
    f"effects --reaches 2 --json {LONG}",
    f"effects --plant {LONG}.npz",
    f"iso9283 --calibration {LONG}",
    f"iso9283 --plant geometry_only --cycles 2 --out {LONG}",
    f"calibrate {LONG} --arm ur5",
    f"calibrate new.csv --arm {LONG}",
    f"calibrate new.csv --arm {LONG}.urdf",
    f"plan-poses --arm {LONG}.toml",
    f"plan-poses --arm ur5 --at {LONG}",
    f"apply {LONG} targets.csv --arm ur5",
    f"export {LONG} --arm ur5 --out arm.xml",
    f"twin {LONG}",
    f"train --compensate {LONG}",
    f"train --plant {LONG}",
    f"train --steps 1 --out {LONG}",
    f"evaluate --policy {LONG}",
    f"evaluate --json {LONG}",
    f"figures {LONG}",
    f"report {LONG}",
    f"inspect {LONG}",
    f"study {LONG}",
    f"demo --out {LONG}",
]


@pytest.mark.parametrize("command", COMMANDS, ids=lambda command: command.replace(LONG, "LONG"))
def test_a_name_longer_than_any_file_s_is_bad_input(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert guard.guarded(lambda: app(command.split(), standalone_mode=False)) == 2
    said = capsys.readouterr().err.strip().splitlines()[-1]
    assert said.startswith("error: ")
    assert "File name too long" in said or "unknown" in said or "does not exist" in said or "no folder" in said
    assert list(tmp_path.iterdir()) == []


@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="no /dev/full here")
@pytest.mark.parametrize("code", ["print('x' * 10)", "print('x' * 10**6)", "import rich; rich.print('x')"])
def test_a_full_disk_behind_standard_output_is_one_sentence(code: str) -> None:
    handle = os.open("/dev/full", os.O_WRONLY)
    try:
        done = ended(code, handle)
    finally:
        os.close(handle)
    assert done.returncode == 74
    assert re.fullmatch("error: cannot print: No space left on device; the files .*\n", done.stderr), done.stderr


@pytest.mark.skipif(os.name == "nt", reason="POSIX pipes")
@pytest.mark.parametrize("code", ["print('x' * 10)", "print('x' * 10**6)", "import rich; rich.print('x')"])
def test_a_reader_that_is_gone_is_one_sentence(code: str) -> None:
    read, write = os.pipe()
    os.close(read)
    try:
        done = ended(code, write)
    finally:
        os.close(write)
    assert done.returncode == 74
    assert re.fullmatch("error: cannot print: Broken pipe; the files .*\n", done.stderr), done.stderr


@pytest.mark.skipif(os.name == "nt", reason="POSIX locales")
@pytest.mark.parametrize("environment", [PLAIN, {"PYTHONIOENCODING": "ascii"}, {"PYTHONIOENCODING": "latin-1"}])
def test_a_terminal_without_a_character_shows_its_number_and_nothing_fails(environment: dict[str, str]) -> None:
    code = r"print('0.5 \u00b1 0.1 mm, \u03b1'); print('\u03b1', file=sys.stderr)"
    done = ended(code, **environment)
    assert done.returncode == 0
    assert "\\u03b1" in done.stdout and "\\u03b1" in done.stderr


def test_a_closed_standard_output_is_no_fault() -> None:
    done = ended("sys.stdout = None; print('unheard')")
    assert (done.returncode, done.stderr) == (0, "")
