"""Changes to the lines that make numbers: which there are, and that each is one change to a file that can be read."""

import ast
import json
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


def test_a_larger_sample_holds_a_smaller_one_and_every_room_has_files_and_tests(script):
    for name, room in script.ROOMS.items():
        assert all((script.ROOT / path).is_file() for path in (*room.sources, *room.tests)), name
    keys = [[mutant.key for mutant in script.shuffled("yields", seed, {})] for seed in (0, 0, 1)]
    assert keys[0] == keys[1] != keys[2] and sorted(keys[0]) == sorted(keys[2])
    assert len(set(keys[0])) == len(keys[0])


def test_the_copy_holds_every_module_and_nothing_that_was_made(script, tmp_path):
    """Also a package that is called as a folder of results is."""
    copy = script.copied_project(tmp_path)
    for package in ("pickenv", "calibration", "agents"):
        here, there = ({p.relative_to(root) for p in (root / package).rglob("*.py")} for root in (script.ROOT, copy))
        assert here == there
    assert not (copy / "runs").exists() and not (copy / ".git").exists()


def statements_with(path, texts):
    """The statements of a file, functions and classes whole, that hold one of some lines: the rest takes its time."""
    code = path.read_text(encoding="utf-8")
    lines = code.splitlines()
    starts = [(min([n.lineno, *(d.lineno for d in getattr(n, "decorator_list", []))]), n) for n in ast.parse(code).body]
    parts = [lines[start - 1 : node.end_lineno] for start, node in starts]
    return "\n".join(line for part in parts if texts & {line.strip() for line in part} for line in part) + "\n"


def test_what_makes_no_difference_is_a_change_of_todays_lines_and_has_a_reason(script):
    """A line that was written anew is judged anew."""
    known = script.read_equivalents()
    named = {path: {text for other, text, _ in known if other == path} for path, _, _ in known}
    found = {path: script.mutants_of(path, statements_with(script.ROOT / path, texts)) for path, texts in named.items()}
    today = {(m.path, m.text, m.change) for mutants in found.values() for m in mutants}
    assert set(known) <= today, set(known) - today
    assert all(len(reason) > 20 for reason in known.values())
    for name in ("gate", "kalman"):
        drawn = script.shuffled(name, 0, known)
        assert not {(m.path, m.text, m.change) for m in drawn} & set(known)
    some = script.shuffled("kalman", 0, {})
    left = script.shuffled("kalman", 0, {(some[3].path, some[3].text, some[3].change): "it makes no difference at all"})
    assert [m.key for m in left[:3]] == [m.key for m in some[:3]] and len(left) < len(some)


def test_verdicts_hold_while_the_file_does_and_those_of_survivors_while_the_tests_do(script):
    room = script.ROOMS["gate"]
    (path,) = room.sources
    file, tests = (script.fingerprint(script.ROOT / each for each in part) for part in (room.sources, room.tests))
    told = {"room": "gate", "verdict": "failed", "file": file, "tests": "any", "seconds": 1.0}
    verdicts = {
        f"{path}:1 a -> b": told,
        f"{path}:2 a -> b": told | {"verdict": "passed", "tests": tests},
        f"{path}:3 a -> b": told | {"file": "another"},
        f"{path}:4 a -> b": told | {"verdict": "passed", "tests": "another"},
        "gone.py:5 a -> b": told,
    }
    assert [key.split(":")[1][0] for key in script.still_true(verdicts)] == ["1", "2"]
    assert [key.split(":")[1][0] for key in script.of_todays_files(verdicts)] == ["1", "2", "4"]


def test_the_summary_gives_each_rooms_rate_with_its_interval_and_what_was_left_out(script):
    now = script.score_of("plant", 120, ["failed"] * 17 + ["passed"] * 2 + ["took too long"])
    assert (now.tried, now.killed, now.late) == (20, 18, 1)
    equivalents = {("a.py", "x = y | z", "1 -> 2"): "the second is never read"}
    summary = script.summary_of([now], [], ["a.py:4 1 -> 2"], equivalents)
    figures = {"mutants": 120, "tried": 20, "killed": 18, "late": 1, "seed": None}
    assert summary["rooms"]["plant"]["now"] == figures | {"score": "90.0 % (70 to 97)"}  # Wilson 1927
    assert summary["survivors"] == ["a.py:4 1 -> 2"]
    reason = {"file": "a.py", "line": "x = y | z", "change": "1 -> 2", "reason": "the second is never read"}
    assert summary["make_no_difference"] == [reason]
    assert script.table([now]).splitlines()[1].endswith(" 120     20      18              1  90.0 % (70 to 97)")


def test_beside_what_stands_now_stand_the_first_sample_and_every_fresh_one(script):
    drawn = [("plant", 1, 77), ("plant", 3, 78), ("plant", 4, 79), ("gate", 4, 77)]
    samples = [script.score_of(r, 90, ["failed"] * n + ["passed"] * (4 - n), seed) for r, n, seed in drawn]
    summary = script.summary_of([script.score_of("plant", 90, ["failed"] * 4)], samples, ["a.py:4 1 -> 2"], {})
    plant, gate = summary["rooms"]["plant"], summary["rooms"]["gate"]
    assert (plant["first"]["seed"], plant["first"]["score"]) == (77, "25.0 % (5 to 70)")
    assert [(one["seed"], one["score"]) for one in plant["fresh"]] == [
        (78, "75.0 % (30 to 95)"),
        (79, "100.0 % (51 to 100)"),
    ]
    assert gate["now"] is None and gate["first"]["killed"] == 4 and gate["fresh"] == []
    page = script.page_of(summary)
    assert "| 8 | 5 | 62.5 % |" in page and "| 8 | 7 | 87.5 % |" in page and "| 4 | 4 | 100.0 % |" in page
    assert "2 rooms" in page and "1 change survives" in page


def test_the_page_is_what_its_numbers_say(script):
    docs = script.ROOT / "docs"
    summary = json.loads((docs / "_static/mutants.json").read_text(encoding="utf-8"))
    assert script.page_of(summary) == (docs / "mutants.md").read_text(encoding="utf-8")
    assert set(summary["rooms"]) <= set(script.ROOMS)


def test_of_what_files_hold_a_samples_first_score_stands_and_a_mutants_last_verdict(script, tmp_path):
    files = [tmp_path / name for name in ("a.json", "b.json")]
    scores = [script.score_of("gate", 9, verdicts, 7) for verdicts in (["passed"], ["failed"])]
    for file, score, verdict in zip(files, scores, ("passed", "failed"), strict=True):
        file.write_text(script.as_lines([score], {"g.py:2 0 -> 1": {"verdict": verdict}, file.name: {}}))
    assert script.kept_in(files) == (scores[:1], {"g.py:2 0 -> 1": {"verdict": "failed"}, "a.json": {}, "b.json": {}})
    kept = script.kept_in([script.KEPT])
    assert script.as_lines(*kept) == script.KEPT.read_text() and {one.room for one in kept[0]} <= set(script.ROOMS)
