"""All benchmarks in one run: ratios first, every part told apart, what was not measured is marked."""

import json
from pathlib import Path

import pytest

SCRIPTS = Path(__file__).parents[2] / "scripts"


@pytest.fixture
def script(monkeypatch):
    """The script as a module."""
    monkeypatch.syspath_prepend(SCRIPTS)
    import benchmark_all

    return benchmark_all


def row(method, executor, arms, cost, **more):
    whole = {"workers": 1, "seconds": 1e-3 * cost * arms, "cpu_seconds": 1.0, "peak_mib": 100.0}
    return {"method": method, "executor": executor, "arms": arms, "ms_per_arm": cost} | whole | more


STUDY = [row("ls", "serial", 100, 20.0), row("ls", "joblib", 100, 12.5), row("ls", "batched", 100, 4.0)]
STUDY += [row("ls", "batched", 1000, 2.0), row("raw", "batched", 1000, 0.5)]
ENVIRONMENTS = {
    "envs": {
        "Reach single": {"num_envs": 1, "steps_per_s": 15_000.0, "backend": "floats", "note": "plant qiao2026"},
        "PPO 64": {"num_envs": 64, "steps_per_s": 20_000.0, "backend": "sb3", "note": "step + training"},
        "absent": {"num_envs": 1, "steps_per_s": None, "backend": "engine", "note": "cannot be run"},
    },
    "ratios": {"single_vs_fetchreach": 9.0, "single_vs_pandareach": None},
}
CALIBRATION = {"note": "no figures: no data", "ratios": {}}


def test_ratios_come_first_and_parts_are_told_apart(script):
    result = script.gathered(ENVIRONMENTS, CALIBRATION, STUDY, script.machine())
    assert list(result) == ["ratios", "machine", "environments", "training", "calibration", "study"]
    assert result["ratios"] == {
        "single_vs_fetchreach": 9.0,
        "study_serial_vs_joblib": 1.6,
        "study_serial_vs_batched": 10.0,
    }
    assert list(result["training"]) == ["PPO 64"] and list(result["environments"]["envs"]) == ["Reach single", "absent"]
    assert json.loads(json.dumps(result, allow_nan=False)) == result


def test_the_table_of_studies_says_what_was_not_measured(script):
    unmeasured = {"seconds": 2000.0, "cpu_seconds": None, "peak_mib": None}
    text = script.study_table([*STUDY, row("ls", "batched", 1_000_000, 2.0, **unmeasured)])
    assert "| method | executor | processes | arms | seconds | cpu seconds | ms per arm | peak mib |" in text
    assert "| ls | serial | 1 | 100 | 2.0 | 1 | 20.000 | 100 |" in text
    assert "| ls | batched | 1 | 1000000 | 2000.0 | - | 2.000 | - |" in text


def test_a_benchmark_prints_its_tables_and_one_that_fails_leaves_a_note(script, monkeypatch, tmp_path, capfd):
    (tmp_path / "broken.py").write_text("raise SystemExit('error: no such data')", encoding="utf-8")
    code = "import sys; print('its table'); open(sys.argv[2], 'w').write('{}')"
    (tmp_path / "sound.py").write_text(code, encoding="utf-8")
    monkeypatch.setattr(script, "SCRIPTS", tmp_path)
    assert script.run_script("broken.py") == {"note": "no figures: error: no such data", "ratios": {}}
    assert "broken.py: no figures: error: no such data" in capfd.readouterr().out
    assert script.run_script("sound.py") == {} and capfd.readouterr().out == "its table\n"


def test_every_executor_works_on_the_same_population(script):
    for quick in (True, False):
        compared = [(executor, arms) for _, executor, arms, _ in script.cases(quick) if executor != "batched"]
        executors, arms = map(set, zip(*compared, strict=True))
        assert executors >= {"serial", "joblib"} and len(arms) == 1
    assert max(arms for _, _, arms, _ in script.cases(False)) == 1_000_000


def test_a_study_is_timed(script):
    timed = script.time_case("raw", "serial", 8, 1)
    assert timed["ms_per_arm"] == pytest.approx(1e3 * timed["seconds"] / 8)
    assert timed["cpu_seconds"] > 0.0 and timed["seconds"] > 0.0
