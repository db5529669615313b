"""The ledger: what pages print stands in it, what is drawn is made again, and about as many hold as are due."""

import importlib
import json
import re
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.main import get_command
from typer.testing import CliRunner

from pickenv.cli import app

ROOT = Path(__file__).parents[2]


@pytest.fixture
def claims(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "scripts")
    return importlib.import_module("claims")


def number(rng, units):
    """A mean of so many units, with its interval."""
    half = 1.96 / np.sqrt(units)
    value = float(rng.normal() / np.sqrt(units))
    return {"value": value, "ci95": [-9.0, 9.0], "sampled95": [value - half, value + half]}


@pytest.mark.parametrize("cheap", [64, 16, 4])
def test_as_many_hold_as_are_due_whatever_the_sizes(claims, cheap):
    rng = np.random.default_rng(3)
    held = np.mean([claims.holds(number(rng, 64), number(rng, cheap)) for _ in range(4000)])
    assert held == pytest.approx(claims.DUE, abs=0.02)


def test_pages_print_the_ledger(claims):
    """Every table and every number between marks."""
    rows, tables, numbers = claims.record()["rows"], 0, 0
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        text = path.read_text(encoding="utf-8")
        for mark, asked, end in claims.MARK.findall(text):
            start = text.index(mark) + len(mark)
            assert text[start : text.index(end, start)] == claims.table_of(rows, json.loads(asked))
            tables += 1
        for found in claims.INLINE.finditer(text):
            said = found[0].removeprefix(found[1]).removesuffix(found[3])
            assert said == claims.number_of(rows, json.loads(found[2]))
            numbers += 1
    assert tables > 10 and numbers > 20


INTERVAL = re.compile(r"\d[^\s(|]*(?: [^\s(|\d]{1,4})? \([-+]?\d[\d.]* to [-+]?\d")
WHOLE = {"docs/claims.md", "docs/leaderboard.md", "docs/mutants.md"}
"""Pages that the command writes which makes their numbers."""


@pytest.mark.parametrize("unit", ["", " %", " mm", "%"])
def test_an_interval_is_seen_whatever_the_unit_before_it(unit):
    assert INTERVAL.search(f"| a | -1.23{unit} (-2 to +0.5) |")
    assert not INTERVAL.search(f"12{unit} of the arms (2 to 5 of an arm with six), 12{unit} (as drawn)")


def test_no_other_number_on_a_page_has_an_interval(claims):
    counts = {}
    docs = (path for path in (ROOT / "docs").rglob("*.md") if not {"_build", "_generated"} & set(path.parts))
    for path in [ROOT / "README.md", *docs]:
        text = claims.INLINE.sub("", claims.MARK.sub("", path.read_text(encoding="utf-8")))
        counts[path.relative_to(ROOT).as_posix()] = len(INTERVAL.findall(text))
    assert {name: count for name, count in counts.items() if count and name not in WHOLE} == {}


def test_a_negative_scale_shows_the_difference_the_other_way_round(claims):
    rng = np.random.default_rng(5)
    for _ in range(50):
        low, value, high = np.sort(rng.normal(scale=3.0, size=3)).tolist()
        row, turned = {"value": value, "ci95": [low, high]}, {"value": -value, "ci95": [-high, -low]}
        scale, digits = float(rng.uniform(0.1, 100.0)), int(rng.integers(0, 4))
        assert claims.shown(row, digits, -scale, "+") == claims.shown(turned, digits, scale, "+")
        assert claims.shown(row | {"ci95": None}, digits, -scale) == claims.shown(
            turned | {"ci95": None}, digits, scale
        )


def test_every_policy_of_the_leaderboard_stands_in_the_ledger_once_with_the_boards_numbers(claims):
    """Learned or not: one row for each of a policy's lines on the board, for Li's cup."""
    board = json.loads((ROOT / "docs/_static/leaderboard.json").read_text(encoding="utf-8"))
    known, ledger = claims.entries(), claims.record()["rows"]
    for task in ("reach", "pick"):
        names = [name for name, entry in known.items() if entry.get("rows") == task]
        rows = [row for row in ledger if row["experiment"] in names]
        lines = [line for line in board[task] if line["gripper"] == "li_cup"]
        titles = known[names[0]]["numbers"]
        assert len(rows) == len(lines) * len(titles)
        for title, (value, interval) in titles.items():
            for line in lines:
                levels = {name: line[name] for name in ("plant", "policy", "compensation")}
                (row,) = (row for row in rows if row["title"] == title and levels.items() <= row["levels"].items())
                assert [row["value"], row["ci95"]] == [line[value], line[interval]]


def programs(claims):
    """Each entry of a command with its program, as the command line sees it."""
    for entry in (entry for entry in claims.entries().values() if "command" in entry):
        first, *words = entry["command"].split()
        if first == "pickenv":
            program = get_command(app)
            while words and hasattr(program, "commands"):  # words behind the last command are files
                program = program.commands[words.pop(0)]
        else:
            main, program = typer.Typer(), words[-1]
            path = program.removeprefix("scripts/").removesuffix(".py").replace("/", ".")
            name = path if program.endswith(".py") else f"{program}.__main__"
            main.command()(importlib.import_module(name).main)
            program = get_command(main)
        yield entry, {word: option for option in program.params for word in (*option.opts, *option.secondary_opts)}


def test_every_command_takes_the_options_of_its_cheap_size_and_a_seed(claims):
    """No option is misspelt, and each of a row's levels is named or is made with the others."""
    for entry, options in programs(claims):
        if "cheap" not in entry:
            continue  # is not made again by itself
        asked = re.findall(r"--[a-z-]+", entry["cheap"])
        assert bool(asked) == bool(entry["cheap"])
        written = {"--out"} if "writes" in entry else {"--out", "--json"}
        assert {*asked, "--seed"} | written <= set(options), entry["name"]
        assert {level.split("[")[0] for level in re.findall(r"{([^}]+)}", entry["cheap"])} <= set(entry["by"])


class Begun(Exception):
    """A command has taken its options, and would begin its work."""


@pytest.mark.parametrize(
    ("command", "place"),
    [
        ("pickenv bench policies", "pickenv.experiments.policy_tables.run_leaderboard"),
        ("pickenv evaluate", "pickenv.experiments.run_policies"),
    ],
)
def test_no_row_of_a_comparison_is_refused_at_its_cheap_size(command, place, claims, tmp_path, monkeypatch):
    def begin(*args, **options):
        raise Begun

    monkeypatch.setattr(place, begin)
    known = {name: entry for name, entry in claims.entries().items() if entry.get("command") == command}
    asked = {
        entry["cheap"].format(**row["levels"])
        for row in claims.record()["rows"]
        if (entry := known.get(row["experiment"])) is not None
    }
    for options in sorted(asked):
        words = f"{command.removeprefix('pickenv ')} {options} --seed 5 --out {tmp_path / 'out'}".split()
        done = CliRunner().invoke(app, words)
        assert isinstance(done.exception, Begun), f"{command} {options}: {done.output}"
    assert asked


@pytest.mark.parametrize("depth", [0, 1, 3])
def test_rows_lie_at_the_end_of_a_way_in_their_order(claims, depth):
    """A star is every key there; without one the way leads to a single list."""
    rng = np.random.default_rng(depth)
    count = iter(range(1000))
    rows = []

    def tree(levels):
        if levels:
            return {
                f"{i}. key"[-3:] + str(i): {"skipped": [], "next": tree(levels - 1)} for i in range(rng.integers(1, 4))
            }
        made = [{"row": next(count)} for _ in range(rng.integers(0, 4))]
        rows.extend(made)
        return made

    result = {"first": tree(depth), "second": [{"row": -1}]}
    assert claims.rows_at(result, "first" + ".*.next" * depth) == rows


def test_a_number_that_is_not_meant_alone_is_refused(claims):
    row = {"experiment": "toy", "title": "Error (mm)", "levels": {"method": "ls"}, "value": 0.123, "ci95": [0.1, 0.2]}
    other = row | {"levels": {"method": "raw"}}
    asked = {"of": "toy", "title": "Err", "digits": 1, "scale": 100, "sign": "+", "unit": " %"}
    assert claims.number_of([row, other], asked | {"method": "ls"}) == "+12.3 % (+10.0 to +20.0)"
    for wrong in ({}, {"method": "best"}):
        with pytest.raises(claims.InputError, match="rows of the ledger are what"):
            claims.number_of([row, other], asked | wrong)


def test_the_page_says_what_the_record_holds(claims):
    kept, known = claims.record(), claims.entries()
    assert (ROOT / "docs/claims.md").read_text(encoding="utf-8") == claims.page_of(kept, known)
    keys = [claims.key_of(row) for row in kept["rows"]]
    assert len(keys) == len(set(keys)) and {row["claim"] for row in kept["again"]} <= set(keys)
    assert {row["experiment"] for row in kept["rows"]} == set(known)
    assert all(row["seconds"] < 300.0 for row in kept["again"])
    now = {claims.key_of(row): row["ci95"] or [row["value"]] * 2 for row in kept["rows"]}
    for again in kept["again"]:
        (low, high), ends = now[again["claim"]], again["ci95"] or [again["value"]] * 2
        assert not again["held"] or (low <= ends[1] and ends[0] <= high), again["claim"]


def test_every_row_can_be_made_again(claims):
    """Its experiment makes the table that it is of, and takes the cheap size."""
    for name, entry in claims.entries().items():
        rows = [row for row in claims.record()["rows"] if row["experiment"] == name]
        if "command" in entry:
            titles, options = set(entry["numbers"]), [entry.get("cheap", "").format(**row["levels"]) for row in rows]
            assert all("{" not in each for each in options)
        else:
            file = claims.load_experiment(ROOT / entry["file"], changes=entry["cheap"])
            titles = {number.title for number in file.numbers}
        assert rows and {row["title"] for row in rows} <= titles
        assert (ROOT / "docs" / entry["page"]).is_file()


def test_a_new_number_forgets_what_was_made_again_of_the_old_one(claims, tmp_path, monkeypatch):
    """A verdict is of the number that the page prints; one that comes out the same keeps its own."""

    def result(*values):
        rows = [{"method": name, "value": value, "ci95": [0.1, 9.0]} for name, value in zip("ab", values, strict=True)]
        return {"experiment": "toy", "tables": [{"title": "Error (mm)", "rows": rows}]}

    monkeypatch.setattr(claims, "entries", lambda: {"toy": {"page": "toy.md", "titles": ["Error (mm)"]}})
    monkeypatch.setattr(claims, "RECORD", tmp_path / "claims.json")
    monkeypatch.setattr(claims, "PAGE", tmp_path / "claims.md")
    (tmp_path / "toy.json").write_text(json.dumps(result(1.0, 2.0)), encoding="utf-8")
    claims.keep([tmp_path / "toy.json"])
    kept = claims.record()
    kept["again"] = [{"claim": claims.key_of(row), "held": True} for row in kept["rows"]]
    claims.RECORD.write_text(json.dumps(kept), encoding="utf-8")
    (tmp_path / "toy.json").write_text(json.dumps(result(1.0 + 1e-12, 3.0)), encoding="utf-8")
    claims.keep([tmp_path / "toy.json"])
    assert [row["claim"] for row in claims.record()["again"]] == ["toy: Error (mm): method a"]
    assert "1 of 1 numbers held" in claims.PAGE.read_text(encoding="utf-8")


MADE = """
title = "toy"
measure = "claimed_toy.py:measure"
[units]
arm = 40
[factors]
method = ["raw", "ls"]
[settings]
load = [0.0, 1.0]
[[estimate]]
title = "Error (mm)"
value = "error_mm"
by = ["method", "load"]
over = ["arm"]
"""
CODE = """
def measure(rng, arm, method, load):
    return [{"load": each, "error_mm": rng.normal(3.0 if method == "raw" else 1.0)} for each in load]
"""


def test_a_row_is_made_again_from_its_levels_alone_at_another_seed(claims, tmp_path, monkeypatch):
    (tmp_path / "claimed_toy.toml").write_text(MADE, encoding="utf-8")
    (tmp_path / "claimed_toy.py").write_text(CODE, encoding="utf-8")
    monkeypatch.setattr(claims, "ROOT", tmp_path)
    row = {"experiment": "claimed_toy", "title": "Error (mm)", "levels": {"method": "ls", "load": 1.0}}
    again = claims.made_again(row, {"file": "claimed_toy.toml", "cheap": {"arm": 20}}, 5)
    other = claims.made_again(row, {"file": "claimed_toy.toml", "cheap": {"arm": 20}}, 6)
    assert again["levels"] == row["levels"] and 0.0 < again["value"] < 2.0 and again["value"] != other["value"]
    assert again["ci95"][0] < again["value"] < again["ci95"][1]


def test_equal_units_end_where_they_begin_and_too_few_are_refused(claims, tmp_path, monkeypatch):
    """With too few units any difference would be a miss; least squares err alike here."""
    (tmp_path / "few_toy.toml").write_text(MADE.replace("claimed", "few"), encoding="utf-8")
    (tmp_path / "few_toy.py").write_text(CODE.replace("else 1.0)", "else 1.0, 1.0 if method == 'raw' else 0.0)"))
    monkeypatch.setattr(claims, "ROOT", tmp_path)
    row = {"experiment": "few_toy", "title": "Error (mm)", "levels": {"method": "ls", "load": 1.0}}
    equal = claims.made_again(row, {"file": "few_toy.toml", "cheap": {"arm": 10}}, 5)
    assert equal["value"] == 1.0 and equal["sampled95"] == [1.0, 1.0]
    for method in ("ls", "raw"):
        few = row | {"levels": {"method": method, "load": 1.0}}
        with pytest.raises(claims.InputError, match=f"makes no row '.*method {method}, load 1.0' .*give more units"):
            claims.made_again(few, {"file": "few_toy.toml", "cheap": {"arm": 9}}, 5)


def test_a_number_of_equal_units_holds_within_the_other_ones_interval(claims):
    equal, varied = {"value": 1.0, "sampled95": None}, {"value": 0.9, "sampled95": [0.7, 1.1]}
    for pair in ((equal, varied), (varied, equal)):
        assert claims.holds(*pair)  # 0.1 apart; the reach is 0.2 over the root of two
        assert not claims.holds(*pair[:1], *({**row, "value": row["value"] + 5.0} for row in pair[1:]))
    assert claims.holds(equal, equal) and not claims.holds(equal, equal | {"value": 1.01})


@pytest.fixture
def toy_ledger(claims, tmp_path, monkeypatch):
    """Six rows of an experiment that takes no time, and one of another without a cheap size."""
    levels = [{"experiment": "toy", "levels": {"case": case}} for case in range(6)]
    levels.append({"experiment": "timed", "levels": {"case": 0}})
    rows = [row | {"title": "Time", "value": 1.0, "ci95": None, "sampled95": None} for row in levels]
    monkeypatch.setattr(
        claims, "entries", lambda: {"toy": {"page": "toy.md", "cheap": ""}, "timed": {"page": "toy.md"}}
    )
    monkeypatch.setattr(claims, "RECORD", tmp_path / "claims.json")
    monkeypatch.setattr(claims, "PAGE", tmp_path / "claims.md")
    claims.RECORD.write_text(json.dumps({"rows": rows, "again": []}), encoding="utf-8")
    calls = []

    def made_again(row, entry, seed):
        calls.append(row["levels"]["case"])
        if len(calls) == 3:
            raise KeyboardInterrupt
        return row | {"value": seed / 1e9, "seconds": 0.1}

    monkeypatch.setattr(claims, "made_again", made_again)
    return calls


def test_an_interrupted_drawing_goes_on_where_it_stopped(claims, toy_ledger, capsys):
    with pytest.raises(KeyboardInterrupt):
        claims.check(count=5, seed=4)
    assert "--seed 4 goes on from there" in capsys.readouterr().err
    first = claims.record()["again"]
    assert len(first) == 2 and claims.page_of(claims.record(), claims.entries()) == claims.PAGE.read_text()
    claims.PAGE.write_text("of a run that was killed")
    claims.check(count=5, seed=4)
    again = claims.record()["again"]
    assert again[:2] == first and len({row["claim"] for row in again}) == len(again) == 5
    assert len(toy_ledger) == 6  # the interrupted one twice
    claims.check(count=5, seed=4)
    assert claims.record()["again"] == again and len(toy_ledger) == 6
    assert claims.page_of(claims.record(), claims.entries()) == claims.PAGE.read_text()


def test_a_row_that_cannot_be_made_ends_in_one_sentence_that_names_it(claims, toy_ledger, monkeypatch, capsys):
    before = claims.record()["again"]

    def refused(row, entry, seed):
        raise claims.InputError("this needs mujoco, which is not installed")

    monkeypatch.setattr(claims, "made_again", refused)
    with pytest.raises(claims.typer.Exit) as ended:
        claims.check(count=1, seed=4)
    assert ended.value.exit_code == 2 and claims.record()["again"] == before
    said = capsys.readouterr().err
    assert said.startswith("t") and said.endswith(": this needs mujoco, which is not installed\n")


def test_only_rows_that_are_asked_for_and_have_a_cheap_size_are_drawn(claims, toy_ledger):
    toy_ledger.extend([None] * 3)  # is not interrupted
    claims.check(count=50, seed=4)
    assert sorted(toy_ledger[3:]) == [0, 1, 2, 3, 4, 5]
    claims.check(count=50, seed=5, only=["timed"])
    assert len(toy_ledger) == 9
    with pytest.raises(claims.InputError, match="has no experiment tamed; it has"):
        claims.check(only=["tamed"])


PROGRAM = """
import argparse, json, random
parser = argparse.ArgumentParser()
for name in ("pair", "load", "seed", "out", "json"):
    parser.add_argument(f"--{name}", action="append" if name == "pair" else "store")
asked = parser.parse_args()
value = random.Random(asked.seed + asked.load).random()
rows = [{"pair": asked.pair, "load": float(asked.load), "mm": value, "low": value - 1.0, "high": value + 1.0}]
open(asked.json, "w").write(json.dumps({"parts": {"a part": {"rows": rows}}}))
"""


def test_a_row_of_a_command_is_made_again_from_its_levels_alone_at_another_seed(claims, tmp_path, monkeypatch):
    """A level may be a pair, each half of which the command asks for."""
    (tmp_path / "toy.py").write_text(PROGRAM, encoding="utf-8")
    monkeypatch.setattr(claims, "ROOT", tmp_path)
    entry = {"command": "python toy.py", "rows": "parts.*.rows", "by": ["pair", "load"]}
    entry |= {"numbers": {"Error (mm)": ["mm", "low", "high"]}}
    entry |= {"cheap": "--pair {pair[0]} --pair {pair[1]} --load {load}"}
    values = set()
    for pair in (["a", "b"], ["b", "a"]):
        for load, seed in ((1.0, 5), (2.0, 5), (2.0, 6)):
            row = {"experiment": "toy", "title": "Error (mm)", "levels": {"pair": pair, "load": load}}
            again = claims.made_again(row, entry, seed)
            assert claims.key_of(again) == claims.key_of(row) and again == again | row
            assert again["sampled95"] == again["ci95"] == [again["value"] - 1.0, again["value"] + 1.0]
            values.add(again["value"])
    assert len(values) == 3
    with pytest.raises(claims.InputError, match=r"toy\.py: .*unrecognized arguments: --lod"):
        claims.made_again(row, entry | {"cheap": "--lod 3"}, 5)


def test_a_row_of_a_file_in_a_commands_folder_is_made_again(claims, tmp_path, monkeypatch):
    """Rows there may have keys, and a number may lie deeper in its row."""
    program = PROGRAM.replace('open(asked.json, "w")', 'os.mkdir(asked.out); open(f"{asked.out}/summary.json", "w")')
    program = program.replace("json.dumps(", 'json.dumps({"by key": {"a": {"mm": rows[0]}}} or ').replace(
        "json,", "json, os,"
    )
    (tmp_path / "toy.py").write_text(program, encoding="utf-8")
    monkeypatch.setattr(claims, "ROOT", tmp_path)
    entry = {"command": "python toy.py", "writes": "summary.json", "rows": "by key", "by": ["key"], "cheap": "--load 2"}
    entry |= {"numbers": {"Error (mm)": ["mm.mm", "mm.low", "mm.high"]}}
    row = {"experiment": "toy", "title": "Error (mm)", "levels": {"key": "a"}}
    first, other = (claims.made_again(row, entry, seed) for seed in (5, 6))
    assert first == first | row and first["ci95"] == [first["value"] - 1.0, first["value"] + 1.0]
    assert first["value"] != other["value"]
    with pytest.raises(claims.InputError, match=r"makes no row 'toy: Error .*: key b'"):
        claims.made_again(row | {"levels": {"key": "b"}}, entry, 5)


def test_a_level_that_a_measurement_adds_is_made_again(claims, tmp_path, monkeypatch):
    """Such as a part of what was learnt: no factor has it, so all levels are measured."""
    (tmp_path / "added_toy.toml").write_text(MADE.replace("claimed", "added"), encoding="utf-8")
    part = CODE.replace('"load": each,', '"load": each, "method": method if method == "raw" else "half of ls",')
    (tmp_path / "added_toy.py").write_text(part, encoding="utf-8")
    monkeypatch.setattr(claims, "ROOT", tmp_path)
    row = {"experiment": "added_toy", "title": "Error (mm)", "levels": {"method": "half of ls", "load": 1.0}}
    again = claims.made_again(row, {"file": "added_toy.toml", "cheap": {"arm": 20}}, 5)
    assert again["levels"] == row["levels"] and 0.0 < again["value"] < 2.0
