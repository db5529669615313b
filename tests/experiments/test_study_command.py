"""`pickenv study`: one command from a configuration to a summary that people and programs read."""

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from pickenv.cli import app


def test_a_study_prints_writes_and_sums_up(study_file, tmp_path, typed, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    ran = typed(
        "study",
        study_file(("arms = 12", "arms = 4"), ("chunk = 5", "chunk = 3")),
        "--details",
        "--executor",
        "serial",
        "--no-report",
        "--out",
        "run",
        "--json",
        "summary.json",
    )
    assert ran.returncode == 0, ran.stderr
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert summary == json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))
    assert summary["arms"] == 4 and summary["executor"] == "serial" and summary["simulated"] is True
    assert re.fullmatch("[0-9a-f]{64}", summary["table_sha256"]) and summary["seconds"] > 0
    assert len(summary["yield"]) == 12
    for row in summary["yield"]:
        assert row["arms"] == 4 and 0 <= row["yield_low"] <= row["yield"] <= row["yield_high"] <= 1
    assert {row["quantity"] for row in summary["quantiles_mm"]} >= {"error_mean_mm", "error_p95_mm"}
    for word in ("yield", "IT", "(mm)", "(kg)", "Wilson 95 % interval", "within 1 mm", "simulated", "all class medium"):
        assert word in ran.stdout
    assert "4 arms can tell a yield to within about ±" in " ".join(ran.stdout.split())
    assert "4 arms are too few to divide their variance" in ran.stdout
    assert max(len(line) for line in ran.stdout.splitlines() if line[:5] not in ("wrote", "seria")) <= 80
    assert summary["table_sha256"] in ran.stdout


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["nowhere.toml"], r"nowhere\.toml does not exist"),
        (["study.toml", "--executor", "ray"], r"--executor.*'ray' is not one of 'serial', 'joblib', 'batched'"),
        (["study.toml", "--executor", "batched", "--device", "tpu"], r"--device.*'tpu' is not one of 'cpu', 'cuda'"),
        (["study.toml", "--out", "study.toml/run"], r"cannot write"),
    ],
)
def test_bad_input_ends_with_one_sentence(study_file, tmp_path, arguments, sentence, typed, monkeypatch):
    study_file()
    monkeypatch.chdir(tmp_path)
    ran = typed("study", *arguments)
    assert ran.returncode == 2
    (said,) = [line for line in ran.stderr.splitlines() if line.strip()]
    assert said.startswith("error: ") and re.search(sentence, said)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--sobol --no-report", "--no-report"),
        ("--samples 512", "--sobol"),
        ("--device cuda", "batched"),
        ("--executor serial --workers 2", "--executor joblib"),
        ("--executor batched --device cuda --workers 2", "--workers"),
    ],
)
def test_what_would_have_no_effect_on_a_study_is_refused(words, said, tmp_path):
    study = Path(__file__).parents[2] / "scripts/tolerance_study.toml"
    ran = CliRunner().invoke(app, ["study", str(study), *words.split(), "--quick", "--out", str(tmp_path / "out")])
    assert ran.exit_code and said in str(ran.exception) + ran.output
