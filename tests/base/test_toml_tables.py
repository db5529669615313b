"""What TOML files hold is read by their classes' annotations; every fault is one sentence with its line."""

import json
import tomllib
from pathlib import Path
from typing import Annotated, Any

import jsonschema
import pytest
from typer.testing import CliRunner

from pickenv.arm import ARMS, PLANTS, TOLERANCES
from pickenv.base import DEG, MM, NUMBER, WHOLE, InputError, Key, Unit, json_schema, read_toml, toml_table, toml_tables
from pickenv.base.toml_tables import line_of
from pickenv.calibration.camera import boards
from pickenv.calibration.reading.description import DESCRIPTIONS
from pickenv.cli import app
from pickenv.commands.check import FILES, class_of_file
from pickenv.harvester import machine, pick_points
from pickenv.orchard import preset_files

ROOT = Path(__file__).parents[2]
WHOLE_FILES = {
    "arm": sorted(ARMS.glob("*.toml")),
    "plant": sorted(PLANTS.glob("*.toml")),
    "tolerances": sorted(TOLERANCES.glob("*.toml")),
    "board": sorted(boards.SHIPPED.glob("*.toml")),
    "description": sorted(DESCRIPTIONS.glob("*.toml")),
    "study": [ROOT / "scripts" / "tolerance_study.toml", ROOT / "scripts" / "tolerance_grades.toml"],
    "machine": [machine.SHIPPED],
    "strategy": [pick_points.STRATEGY_FILE],
    "picking": [pick_points.PICKING_FILE],
}
SHIPPED = [path for paths in WHOLE_FILES.values() for path in paths]


@toml_table
class Part:
    """A part for tests."""

    length: Annotated[float, MM.positive]
    angles: Annotated[tuple[float, float], DEG] = (0.0, 0.0)


@toml_table
class Sample:
    """A file for tests, with a section that its fields share."""

    count: Annotated[int, WHOLE.within(1, 9)]
    mass: Annotated[float, Unit("g", 1e-3), Key("weight_g", "heavy")]
    parts: tuple[Part, ...] = ()
    share: Annotated[float, NUMBER.within(0, 1), Key(section="heavy")] = 0.5


SOUND = """# count = 0
count = 3

[heavy]
weight_g = 250

[[parts]]
length_mm = 10
angles_deg = [
  90,
  180.0, # a comment
]

[[parts]]
length_mm = 20
"""


def reading(tmp_path: Path, text: str) -> Sample:
    (tmp_path / "sample.toml").write_text(text, encoding="utf-8")
    return read_toml(Sample, tmp_path / "sample.toml")


def test_values_are_kept_in_si(tmp_path: Path) -> None:
    sample = reading(tmp_path, SOUND)
    assert (sample.count, sample.mass, sample.share) == (3, 0.25, 0.5)
    assert [part.length for part in sample.parts] == [0.01, 0.02]
    assert sample.parts[0].angles == pytest.approx((1.5707963267948966, 3.141592653589793))


MISTAKES = {
    "sign": ("length_mm = 20", "length_mm = -2", 15, "length_mm of entry 2 of [parts] is -2; give a number above"),
    "unit": ("length_mm = 20", "length_mm = 2e9", 15, "is 2e+09; give a number above zero, at most 100000 mm"),
    "in a list": ("180.0", "'180'", 11, "angles_deg[1] of entry 1 of [parts] is '180'; give a finite number"),
    "a short list": ("  90,\n", "", 9, "angles_deg of entry 1 of [parts] is [180.0]; give 2 numbers"),
    "infinite": ("  90,", "  inf,", 10, "angles_deg[0] of entry 1 of [parts] is inf; give a finite number"),
    "truth": ("count = 3", "count = true", 2, "count is True; give a whole number from 1 to 9"),
    "text": ("count = 3", "count = '3'", 2, "count is '3'; give a whole number from 1 to 9"),
    "a half": ("count = 3", "count = 3.5", 2, "count is 3.5; give a whole number from 1 to 9"),
    "missing": ("length_mm = 20", "", 14, "length_mm of entry 2 of [parts] is missing; give a number above zero"),
    "missing section": ("[heavy]\nweight_g = 250", "", None, "heavy is missing; give this table"),
    "misspelt": ("weight_g", "wieght_g", 5, "unknown key 'wieght_g' in [heavy]; perhaps weight_g is meant: known are"),
    "unlike any": ("count = 3", "count = 3\nx = 1", 3, "unknown key 'x'; known are count, heavy, parts, source"),
    "no table": ("[heavy]\nweight_g = 250", "heavy = 4", 4, "[heavy] must be a table"),
}


@pytest.mark.parametrize("case", MISTAKES)
def test_a_fault_is_one_sentence_with_its_line(tmp_path: Path, case: str) -> None:
    old, new, line, said = MISTAKES[case]
    assert old in SOUND
    with pytest.raises(InputError) as caught:
        reading(tmp_path, SOUND.replace(old, new, 1))
    where = f"{tmp_path / 'sample.toml'}{f', line {line}' if line else ''}: "
    assert str(caught.value).startswith(where) and said in str(caught.value) and "\n" not in str(caught.value)


def places(content: Any, place: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    """Where every value of a parsed file stands that is no table and no list."""
    parts = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else None
    return [place] if parts is None else [found for key, part in parts for found in places(part, (*place, key))]


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_the_line_of_every_value_names_it(path: Path) -> None:
    """In shipped files each key stands in one line with its value, or with the rest of a list below it."""
    text = path.read_text(encoding="utf-8")
    lines = text.split("\n")
    every = places(tomllib.loads(text))
    for place in every[:: max(len(every) // 40, 1)]:
        line = line_of(text, list(place))
        key = next(str(part) for part in reversed(place) if isinstance(part, str))
        assert line is not None and (key in lines[line - 1] or isinstance(place[-1], int)), place


@pytest.mark.parametrize(("kind", "path"), [(kind, path) for kind in WHOLE_FILES for path in WHOLE_FILES[kind]])
def test_a_shipped_file_fits_the_schema_of_its_kind(kind: str, path: Path) -> None:
    jsonschema.validate(tomllib.loads(path.read_text(encoding="utf-8")), json_schema(class_of_file(kind)))


@pytest.mark.parametrize("kind", [kind for kind in FILES if kind not in WHOLE_FILES])
def test_shipped_presets_fit_the_schema_of_their_kind(kind: str) -> None:
    content = tomllib.loads((preset_files.FOLDER / f"{kind}.toml").read_text(encoding="utf-8"))
    for preset in content.values():
        jsonschema.validate(preset, json_schema(class_of_file(kind)))


def test_the_schema_refuses_what_the_reader_refuses() -> None:
    schema = json_schema(Sample)
    jsonschema.validate(tomllib.loads(SOUND), schema)
    for case in ("sign", "unit", "truth", "text", "a half", "missing", "missing section", "misspelt", "no table"):
        old, new, _, _ = MISTAKES[case]
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(tomllib.loads(SOUND.replace("# count = 0\n", "").replace(old, new, 1)), schema)


def test_the_command_prints_a_schema_and_names_the_kinds() -> None:
    printed = CliRunner().invoke(app, ["schema", "plant"])
    assert "overlap_mm" in json.dumps(json.loads(printed.output))
    unknown = CliRunner().invoke(app, ["schema", "robot"])
    assert isinstance(unknown.exception, InputError) and "give one of arm, plant" in str(unknown.exception)


def test_a_fault_behind_very_much_text_is_named_without_much_reading(monkeypatch: pytest.MonkeyPatch) -> None:
    """Comments are no keys; a file that names the key again and again is given up, and loses the line alone."""
    read: list[int] = []
    whole = toml_tables._parsed
    monkeypatch.setattr(toml_tables, "_parsed", lambda text: read.append(len(text)) or whole(text))
    text = "# length_mm\n" * 5000 + "length_mm = 1"
    assert line_of(text, ["length_mm"]) == 5001 and len(read) == 1
    read.clear()
    text = "\n".join(f"x{i} = 'length_mm'" for i in range(5000)) + "\nlength_mm = 1"
    assert line_of(text, ["length_mm"]) is None
    assert sum(read) <= toml_tables.MOST_READ
