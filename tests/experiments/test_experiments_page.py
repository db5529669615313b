"""The page on experiments: its file, its function and its Python run as they stand, and say what they promise."""

import json
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs/experiments.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```$", PAGE, re.MULTILINE | re.DOTALL)


def test_the_file_and_the_function_of_the_page_give_numbers_with_intervals(tmp_path, typed, monkeypatch):
    (file,), (function, _), (command,) = blocks("toml"), blocks("python"), blocks("sh")
    (tmp_path / "noise_cost.toml").write_text(file, encoding="utf-8")
    (tmp_path / "noise_cost.py").write_text(function, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    done = typed(*command.split()[1:], "--executor", "serial")
    assert done.returncode == 0, done.stderr
    means, more = json.loads((tmp_path / "noise_cost.json").read_text(encoding="utf-8"))["tables"]
    values = [row["value"] for row in means["rows"]]
    assert values == sorted(values) and values[0] < 0.02 < 0.1 < values[-1]
    assert all(row["ci95"][0] > 0.0 for row in more["rows"])
    assert means["title"] in done.stdout


def test_the_page_in_python_prints_a_paired_change(tmp_path):
    _, code = blocks("python")
    done = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=True, capture_output=True, text=True)
    assert re.fullmatch(r"ls: -0\.\d{3} mm\n", done.stdout)


def test_every_key_of_a_file_stands_on_the_page():
    from dataclasses import fields

    from pickenv.experiments import experiment_file

    known = {field.name for field in fields(experiment_file.Number)} - {"title"}
    assert all(f"`{name}`" in PAGE for name in known | {"measure", "quick", "fits", "figures"})
