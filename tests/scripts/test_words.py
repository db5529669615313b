"""The measure of prose sees a fault of each kind at its line, and nothing in code, tables and folded parts."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def words() -> ModuleType:
    spec = importlib.util.spec_from_file_location("words", ROOT / "scripts/words.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


LONG = "Word " + "word " * 25 + "end."
FAULTS = {
    "has 27 words": LONG,
    "has 4 numbers": "It has 1 mm, 2 mm, 3 mm and 4 mm.",
    "'is told'": "The arm is told where to go.",
    "'even'": "This holds even there.",
    "'Whether it is good.'": "Whether it is good.",
}


@pytest.mark.parametrize("why", FAULTS)
def test_a_planted_fault_is_found_at_its_line_and_alone(words: ModuleType, why: str) -> None:
    text = f"# A page\n\nA short sentence. Another one.\n\nThen this. {FAULTS[why]}\n"
    (fault,) = words.faults(text)
    assert fault[0] == 5 and why in fault[2]


@pytest.mark.parametrize("why", FAULTS)
@pytest.mark.parametrize("around", ["```sh\n{}\n```", "| {} | b |", "<details>\n\n{}\n\n</details>", "<!-- {} -->"])
def test_code_tables_folded_parts_and_marks_are_no_prose(words: ModuleType, why: str, around: str) -> None:
    assert list(words.faults(f"# A page\n\nShort.\n\n{around.format(FAULTS[why])}\n\nShort.\n")) == []


def test_intervals_ranges_and_names_do_not_count_as_numbers(words: ModuleType) -> None:
    text = "Table 2 says 1.5 (1.2 to 1.8) mm, 3 to 4 mm and 5 of 6 arms in 2026, as `x = 7, 8, 9` does (#134).\n"
    assert list(words.faults(text)) == []


def test_sentences_end_at_stops_before_code_and_at_items_of_lists(words: ModuleType) -> None:
    text = "One here. `code` begins the second.\n\n- An item\n- another item\n\nThe last (with a stop. Inside).\n"
    assert [line for line, _ in words.sentences(text)] == [1, 1, 3, 4, 6, 6]


def test_a_name_is_spelled_out_where_it_first_stands(words: ModuleType) -> None:
    assert list(words.unexplained("Behind LS it is better.\n")) == [
        (1, "LS", "stands without '[Ll]east squares' before or beside it")
    ]
    assert list(words.unexplained("Least squares (LS) help. LS does.\n")) == []
    assert list(words.unexplained("```sh\npickenv film --policy LS\n```\n")) == []


def test_every_page_is_clean(words: ModuleType, capsys: pytest.CaptureFixture[str]) -> None:
    assert words.main() == 0, capsys.readouterr().out
    assert {ROOT / "README.md", ROOT / "docs/index.md", ROOT / "docs/findings.md"} <= set(words.pages())
