"""Changes to the lines that make numbers: which there are, and that each is one change to a file that can be read."""

import ast
import json
from itertools import islice
from pathlib import Path

import pytest

pytest.importorskip("mutmut", reason="the extra pickenv[mutants] is not installed")
SCRIPTS = Path(__file__).parents[2] / ".ci/mutation"

CODE = '''
def mean(values: list[float] | None, scale: float = 2.0) -> float:
    """The mean."""
    if not values:
        raise ValueError(f"no values, give {1 + 1}")
    total = 0.0
    for value, _ in zip(values, values, strict=True):
        total += value * scale
    return round(total / len(values), ndigits=3)
'''
CHANGES = {
    "2.0 -> 3.0",
    "not values -> values",
    "0.0 -> 1.0",
    "total += value * scale -> total = value * scale",
    "total += value * scale -> total -= value * scale",
    "value * scale -> value / scale",
    "total / len(values) -> total * len(values)",
    "3 -> 4",
    "round(total / len(values), ndigits=3) -> round(total / len(values), )",
}


@pytest.fixture
def script(monkeypatch):
    """The script as a module."""
    monkeypatch.syspath_prepend(SCRIPTS)
    import mutants

    return mutants


def test_numbers_operators_conditions_and_options_are_changed_and_nothing_else(script):
    found = script.mutants_of("mean.py", CODE)
    assert {mutant.change for mutant in found} == CHANGES and len(found) == len(CHANGES)
    for mutant in found:
        ast.parse(mutant.code)
        assert mutant.code != CODE
        assert mutant.key.startswith(f"mean.py:{mutant.line} ")


def test_how_a_drawing_looks_is_left_and_what_it_shows_is_not(script):
    code = "axes.plot(1e3 * errors, linewidth=2.0, label=said(p=95))\n"
    drawn, other = (
        {m.change for m in script.mutants_of(path, code)} for path in (f"{script.DRAWINGS}a.py", "pickenv/a.py")
    )
    assert "1e3 * errors -> 1e3 / errors" in drawn and "95 -> 96" in drawn
    assert {change for change in other - drawn if "->" in change} == {
        "2.0 -> 3.0",
        "axes.plot(1e3 * errors, linewidth=2.0, label=said(p=95)) -> axes.plot(1e3 * errors, label=said(p=95))",
    }


@pytest.mark.slow
def test_every_function_is_as_likely_as_any_other_and_a_larger_sample_holds_a_smaller_one(script):
    fewer, more = (list(islice(script.sample(5), count)) for count in (2, 4))
    assert fewer == more[:2] and len({mutant.key for _, mutant in more}) == 4
    found = script.functions()
    assert len(set(found)) == len(found) > 3000 and {path.split("/")[0] for path, _, _ in found} == set(script.PACKAGES)
    places = {(path, name): lines for path, name, lines in found}
    for name, mutant in more:
        assert mutant.line in places[mutant.path, name]


def test_files_that_name_the_function_come_first_and_those_of_its_room_are_among_them(script):
    tests = script.files_near("pickenv/base/intervals.py", "clustered_share_interval")
    assert "clustered_share_interval" in (script.ROOT / tests[0]).read_text(encoding="utf-8")
    assert any(test.startswith("tests/base/") for test in tests) and len(set(tests)) == len(tests)


def test_tests_that_run_the_line_are_tried_nearest_and_quickest_first_until_the_time_is_used_up(script):
    seconds = {
        "tests/a.py::far": 1.0,
        "tests/base/test_intervals.py::slow": 90.0,
        "tests/base/test_intervals.py::x": 9.0,
    }
    place = ("pickenv/base/intervals.py", 7)
    mutant = script.Mutant(*place, "", "", None, None, None)
    near = ["tests/base/test_intervals.py::x", "tests/base/test_intervals.py::slow"]
    notes = script.Notes(seconds, {place: set(seconds)})
    assert script.tests_for("share_interval", mutant, notes) == [*near, "tests/a.py::far"]
    assert script.tests_for("share_interval", mutant, script.Notes(seconds, {})) == near  # no test runs it: the files
    slower = script.Notes(seconds | {near[0]: script.BUDGET}, {place: set(seconds)})
    assert script.tests_for("share_interval", mutant, slower) == near[1:]


def test_the_copy_holds_every_module_and_nothing_that_was_made(script, tmp_path):
    """Also a package that is called as a folder of results is."""
    copy = script.copied_project(tmp_path)
    for package in ("pickenv", "calibration", "agents"):
        here, there = ({p.relative_to(root) for p in (root / package).rglob("*.py")} for root in (script.ROOT, copy))
        assert here == there
    assert not (copy / "runs").exists() and not (copy / ".git").exists()


def test_the_page_says_the_share_without_what_makes_no_difference(script):
    verdicts = ["tests/test_a.py"] * 17 + [""] * 3
    tried = [
        {"function": f"f{i}", "file": "a.py", "change": "a | b -> b", "noticed_by": v} for i, v in enumerate(verdicts)
    ]
    earlier = [{"seed": 6, "tried": 9, "noticed": 5, "counted": 8}]
    page = script.page_of(
        {
            "seed": 7,
            "earlier": earlier,
            "mutants": [*tried[:-1], tried[-1] | {"makes_no_difference": "it is never read"}],
        }
    )
    assert "20 functions were drawn with seed 7, and never again. 1 changes make no difference" in page
    assert "They are drawn in this order until 120 are tried." in page
    assert "of the other 19 the tests notice 17" in page and "89 % (69 to 97)" in page  # Wilson 1927
    assert "An earlier sample, with seed 6, ended after 9: 5 of 8 noticed." in page
    assert "| `f17` | a.py | `a \\| b -> b` |" in page and "`f19`" not in page


def test_the_page_is_what_its_numbers_say(script):
    record = json.loads(script.RECORD.read_text(encoding="utf-8"))
    assert script.page_of(record) == script.PAGE.read_text(encoding="utf-8")
    assert len(record["mutants"]) == len({(one["file"], one["function"]) for one in record["mutants"]}) <= 120
