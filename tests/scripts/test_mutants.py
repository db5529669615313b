"""Changes to the lines that make numbers: which there are, and that each is one change to a file that can be read."""

import ast
from pathlib import Path

import pytest

pytest.importorskip("mutmut", reason="the extra pickenv[mutants] is not installed")
SCRIPTS = Path(__file__).parents[2] / "scripts"

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
