"""Experiments as files: what a user writes is what is measured, and a slip is told with file, line and what to give."""

import json
import re
from pathlib import Path

import numpy as np
import pytest

from pickenv.base import InputError
from pickenv.cli import app
from pickenv.experiments import experiment_file, load_experiment, run

ROOT = Path(__file__).parents[2]
STUDIES = sorted(path for path in (ROOT / "scripts/studies").glob("*.toml"))

FILE = """
title = "What least squares leave"
measure = "toy_gains.py:left"
seed = 3
quick = { arm = 10, noise = 0.0 }
fits = "toy_gains.py:fits"
figures = { spread = "toy_gains.py:drawn" }

[units]
arm = 12

[factors]
method = ["raw", "ls", "none"]

[settings]
noise = 0.1

[[estimate]]
title = "Mean error (mm)"
value = "error_mm"
by = ["method"]
over = ["arm"]
spread = true

[[estimate]]
title = "Change (mm)"
value = "error_mm"
by = ["method"]
over = ["arm"]
against = { method = "raw" }

[[estimate]]
title = "Taken (%)"
value = ["taken", "tried"]
by = ["method"]
over = ["arm"]
of = "share"
across = "method"
scale = 100.0
digits = 0
"""
MEASURE = '''
import numpy as np

def left(rng, arm, method, noise):
    """Two fruit of an arm."""
    errors = rng.normal(2.0 + 0.1 * arm, noise, 2) / (1.0 if method == "raw" else 2.0)
    return {"error_mm": errors, "taken": errors < 1.6, "tried": np.ones(2)}

def fits(arm, method):
    return method != "none"

def drawn(rows):
    from pickenv.inspect import new_figure

    with new_figure(3.0, 2.0) as figure:
        figure.add_subplot().plot(rows["error_mm"])
    return figure
'''


@pytest.fixture
def file(tmp_path):
    (tmp_path / "toy_gains.py").write_text(MEASURE, encoding="utf-8")
    path = tmp_path / "gains.toml"
    path.write_text(FILE, encoding="utf-8")
    yield path
    import sys

    sys.modules.pop("toy_gains", None)
    sys.path[:] = [entry for entry in sys.path if entry != str(tmp_path)]


def test_a_file_is_measured_as_it_says(file):
    found = load_experiment(file)
    rows = run(found.experiment)
    assert rows.levels("method") == [("raw",), ("ls",)] and len(rows) == 48
    means, changes, shares = found.estimates(rows)
    raw = rows.where(method="raw")["error_mm"].mean()
    assert [row["estimate"].value for row in means["rows"]] == pytest.approx([raw, raw / 2.0])
    assert [row["method"] for row in changes["rows"]] == ["ls"]
    assert (
        changes["rows"][0]["estimate"].value == pytest.approx(-raw / 2.0) and changes["rows"][0]["estimate"].significant
    )
    low, high = shares["rows"][0]["estimate"].ci95
    assert 0.0 <= low <= high <= 1.0


def test_quick_and_changes_take_the_places_of_what_the_file_says(file):
    quick = load_experiment(file, quick=True, seed=9, changes={"method": ["raw"]})
    assert (quick.experiment.seed, len(quick.experiment.pieces())) == (9, 10)
    assert np.ptp(run(quick.experiment).where(arm=4)["error_mm"]) == 0.0


DRAWS = """
[units]
arm = 12
draw = 40

[factors]
ground = ["guessed", "measured"]

[[estimate]]
title = "Mean error (mm)"
value = "error_mm"
by = ["ground"]
over = ["arm"]
draws = "draw"
"""
DRAWN = """
def left(rng, arm, draw, ground):
    return {"error_mm": 2.0 + (draw - 20) * 0.1 * (draw > 0) + 0.01 * rng.normal()}

def fits(arm, draw, ground):
    return draw == 0 or ground == "guessed"
"""


def test_an_interval_over_draws_of_constants_holds_all_of_them_and_keeps_the_one_over_arms_beside(file):
    file.write_text(
        'title = "Ground"\nmeasure = "toy_draws.py:left"\nfits = "toy_draws.py:fits"\n' + DRAWS, encoding="utf-8"
    )
    file.with_name("toy_draws.py").write_text(DRAWN, encoding="utf-8")
    found = load_experiment(file)
    (table,) = experiment_file.plain_estimates(found.estimates(run(found.experiment)))
    guessed, measured = table["rows"]
    assert guessed["value"] == pytest.approx(2.0, abs=0.02)
    np.testing.assert_allclose(guessed["ci95"], [2.0 - 1.9, 2.0 + 1.9], atol=0.02)
    assert guessed["sampled95"][0] < guessed["value"] < guessed["sampled95"][1] < guessed["ci95"][1]
    assert "sampled95" not in measured and np.ptp(measured["ci95"]) < 0.05
    fewer = load_experiment(file, changes={"draw": 39})
    (table,) = experiment_file.plain_estimates(fewer.estimates(run(fewer.experiment)))
    assert table["rows"][0]["ci95"] is None and "38 draws" in table["rows"][0]["no_interval"]


def test_screens_and_json_say_the_same_numbers(file):
    found = load_experiment(file)
    tables = found.estimates(run(found.experiment))
    for number, table, plain in zip(found.numbers, tables, experiment_file.plain_estimates(tables), strict=True):
        heads, cells = experiment_file.number_table(number, table["rows"])
        shown = [
            float(re.match(r"[+-]?[\d.]+", cell)[0]) for line in cells for cell in line if re.match(r"[+-]?\d", cell)
        ]
        said = [round(number.scale * row["value"], number.digits) for row in plain["rows"]]
        assert set(said) <= set(shown)
        assert all(len(line) == len(heads) for line in cells)


def test_the_mean_of_each_run_stands_in_the_json(file):
    several = FILE.replace("[units]", "[units]\ntraining = 3").replace('["arm"]', '["arm", "training"]', 1)
    file.write_text(several.replace("toy_gains", "toy_trained"), encoding="utf-8")
    trained = MEASURE.replace("arm, method, noise", "training, arm, method, noise").replace("(arm, method)", "(**_)")
    trained = trained.replace("2.0 + 0.1 * arm", "2.0 + 0.1 * arm + training").replace('method != "none"', "True")
    file.with_name("toy_trained.py").write_text(trained, encoding="utf-8")
    found = load_experiment(file)
    table, *_ = experiment_file.plain_estimates(found.estimates(run(found.experiment)))
    for row in table["rows"]:
        assert np.mean(row["runs"]) == pytest.approx(row["value"])
        np.testing.assert_allclose(np.diff(row["runs"]), 1.0 if row["method"] == "raw" else 0.5, atol=0.1)


def test_the_command_prints_writes_and_goes_on(file, tmp_path, capsys):
    words = ["experiment", str(file), "--out", str(tmp_path / "out"), "--json", str(tmp_path / "found.json")]
    words += ["--table", str(tmp_path / "rows.csv"), "--figures", str(tmp_path), "--executor", "serial"]
    app(words, standalone_mode=False)
    said = capsys.readouterr().out
    assert "What least squares leave" in said and "Change (mm)" in said and "standard deviation" in said
    found = json.loads((tmp_path / "found.json").read_text(encoding="utf-8"))
    assert found["rows"] == 48 and (tmp_path / "spread.png").is_file()
    assert len((tmp_path / "rows.csv").read_text(encoding="utf-8").splitlines()) == 49
    stamps = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").glob("*.parquet")}
    app([*words, "--set", "arm=13"], standalone_mode=False)
    assert stamps == {path: path.stat().st_mtime_ns for path in stamps}
    assert len(list((tmp_path / "out").glob("*.parquet"))) == len(stamps) + 2


def test_workers_of_one_process_are_refused(file, tmp_path):
    words = ["experiment", str(file), "--out", str(tmp_path / "out"), "--executor", "serial", "--workers", "2"]
    with pytest.raises(InputError, match="give --executor loky with it"):
        app(words, standalone_mode=False)


SLIPS = {
    ('value = "error_mm"', 'value = "eror_mm"'): "no column 'eror_mm' for 'Mean error",
    ("arm = 12", 'arm = "12"'): "units",
    ('"toy_gains.py:left"', '"toy_gains.py:lefft"'): "names 'toy_gains.py:lefft', which cannot be loaded",
    ('"toy_gains.py:left"', '"left"'): 'give "file.py:function"',
    ("noise = 0.1", "noise = 0.1\nnois = 0.1"): "takes no argument 'nois'",
    ('of = "share"', 'of = "shares"'): "give one of mean, share",
    ("seed = 3", "sed = 3"): "perhaps seed is meant",
    ('over = ["arm"]', 'over = "arm"'): "a list of names of columns",
    ("quick = { arm = 10", "quick = { arms = 10"): "no unit, factor or setting 'arms'",
    ("quick = { arm = 10", 'quick = { arm = "ten"'): "arm is 'ten'; give a list of texts, numbers",
    ("arm = 12", "arm = 0"): "at least one",
    ('["raw", "ls", "none"]', "[]"): "at least one",
    ("noise = 0.1", "noise = 0.1\narm = 3"): "'arm' is a unit and something else as well",
    ('across = "method"', 'across = "arm"'): "across of 'Taken (%)' is 'arm'; give one of its by: method",
    ('against = { method = "raw" }', "against = { arm = 3 }"): "against names arm",
    ('against = { method = "raw" }', 'where = { methods = "raw" }'): "no column 'methods' for 'Change",
    ('of = "share"', 'of = "mean"'): "'mean' is of one column",
    ('by = ["method"]', 'by = ["method", "runs"]'): "'runs' in by of 'Mean error (mm)' is what results are called",
    ('["raw", "ls", "none"]', "3"): "factors is {'method': 3}; give a table of names, each with a list of texts",
    ("noise = 0.0 }", "method = 2 }"): "method is 2; give a list of texts, numbers or truth values, at least one",
    ("spread = true", 'spread = true\nacross = "method"'): "spread of 'Mean error (mm)' is of one column's means",
    ("digits = 0", "digits = 0\nspread = true"): "spread of 'Taken (%)' is of one column's means",
    ("spread = true", 'x = "method"'): "x of 'Mean error (mm)' is of its figure; give figure a name with it",
    ("spread = true", "log = true"): "log of 'Mean error (mm)' is of its figure; give figure a name with it",
    ('by = ["method"]', 'by = ["method", "range"]'): "'range' in by of 'Mean error (mm)' is what results are called",
}


@pytest.mark.parametrize("slip", SLIPS, ids=lambda slip: slip[1])
def test_a_slip_is_told_in_a_sentence_that_names_the_file(slip, file):
    file.write_text(FILE.replace(*slip, 1), encoding="utf-8")
    with pytest.raises(InputError, match=re.escape(SLIPS[slip])) as caught:
        found = load_experiment(file, quick=True)
        found.estimates(run(found.experiment))
    assert str(file) in str(caught.value) and "\n" not in str(caught.value)


FAULTS = {
    ("errors = rng", "errors = rgn"): ("line 6: NameError", "leave out method='raw', arm=0"),
    ('"tried": np.ones(2)', '"tried": np.ones(3)'): ("toy_gains.py", "columns error_mm, taken, tried differ in length"),
    ("/ (1.0 if", "/ (0.0 if"): ("error_mm", "no numbers"),
    ("def fits(arm, method):", "def fits(arm, method)"): ("line 9: SyntaxError", "mend the file"),
}


@pytest.mark.filterwarnings("ignore:divide by zero:RuntimeWarning")
@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault[1])
def test_a_fault_of_the_measure_is_told_with_its_line_or_its_column(fault, file, tmp_path):
    (tmp_path / "toy_gains.py").write_text(MEASURE.replace(*fault, 1), encoding="utf-8")
    with pytest.raises(InputError) as caught:
        found = load_experiment(file)
        found.estimates(run(found.experiment))
    assert all(part in str(caught.value) for part in FAULTS[fault]) and "\n" not in str(caught.value)


def test_a_changed_measure_is_measured_anew(file, tmp_path):
    before = load_experiment(file).experiment
    (tmp_path / "toy_gains.py").write_text(MEASURE.replace("2.0 +", "3.0 +"), encoding="utf-8")
    after = load_experiment(file).experiment
    assert before.key(before.pieces()[0]) != after.key(after.pieces()[0])


@pytest.mark.parametrize("path", STUDIES, ids=lambda path: path.stem)
def test_every_study_that_comes_along_can_be_begun(path):
    """Its functions are there and take what the file gives; quick sizes are smaller."""
    pytest.importorskip("stable_baselines3")
    whole, quick = load_experiment(path), load_experiment(path, quick=True)
    assert 0 < len(quick.experiment.pieces()) <= len(whole.experiment.pieces())
    assert whole.numbers
