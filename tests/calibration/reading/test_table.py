"""A measurement file is named as what it is: its separator, its encoding, the cell at fault, in one line."""

import ast
import os
import sys
import threading

import numpy as np
import pytest

from pickenv.base import InputError
from pickenv.calibration.planning.plan import move_seconds, short_tour, travel_seconds
from pickenv.calibration.reading.table_files import expression_tree, read_table, refuse_repeated

ROWS = "a,b,c\n1.5,2.5,3.5\n4.5,5.5,6.5\n"


@pytest.fixture
def file(tmp_path):
    """``file(content)``: the path of a CSV file with that text or those bytes."""

    def write(content, name="tracker.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def complaint(path, name="a", **options):
    with pytest.raises(InputError) as caught:
        read_table(path, **options).column(name)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize(
    ("separator", "said"),
    [(";", "separated by ';'"), ("\t", "separated by a tab"), ("|", "separated by '|'"), (" ", "separated by a space")],
)
def test_another_separator_is_named_with_its_remedy_and_the_remedy_works(file, separator, said):
    path = file(ROWS.replace(",", separator))
    message = complaint(path)
    assert said in message and "not by ','" in message
    key = message.partition("separator = ")[2].partition(",")[0]
    assert key == {"\t": '"\\t"'}.get(separator, f'"{separator}"')
    np.testing.assert_array_equal(read_table(path, separator=separator).column("c"), [3.5, 6.5])


def test_a_comma_file_read_with_a_semicolon_is_named_too(file):
    assert "separated by ',', not by ';'" in complaint(file(ROWS), separator=";")


def test_decimal_commas_are_named_together_with_the_separator(file):
    message = complaint(file(ROWS.replace(",", ";").replace(".", ",")))
    assert 'separator = ";" and decimal = ","' in message
    assert 'decimal = ","' not in complaint(file(ROWS.replace(",", ";")))


def test_a_byte_order_mark_of_utf_8_is_left_out(file):
    np.testing.assert_array_equal(read_table(file(b"\xef\xbb\xbf" + ROWS.encode())).column("a"), [1.5, 4.5])


@pytest.mark.parametrize("encoding", ["utf-16", "utf-16-be", "utf-32", "utf-32-le", "latin-1", "cp1252"])
def test_other_encodings_are_named(file, encoding):
    text = ("höhe," + ROWS).encode(encoding)
    marks = {"utf-16-be": b"\xfe\xff", "utf-32-le": b"\xff\xfe\x00\x00"}
    message = complaint(file(marks.get(encoding, b"") + text))
    assert ("Latin-1" if encoding in ("latin-1", "cp1252") else encoding[:6].upper()) in message
    assert ("UTF-8" in message and "line 1" in message) or encoding.startswith("utf")


def test_utf_16_without_a_mark_is_told_by_its_zero_bytes(file):
    assert "UTF-16 or no text" in complaint(file(ROWS.encode("utf-16-le")))


def test_a_spreadsheet_is_named(file):
    assert "zip archive, such as a spreadsheet" in complaint(file(b"PK\x03\x04rest"))


def test_a_folder_a_device_and_a_missing_file_are_named(tmp_path):
    assert "is a folder" in complaint(tmp_path)
    assert "does not exist" in complaint(tmp_path / "nowhere.csv")
    assert "is a device" in complaint("/dev/zero")


@pytest.mark.parametrize("name", ["x" * 300 + ".csv", "a\0b.csv", "/".join(["long"] * 2000)])
def test_a_path_that_no_file_can_have_is_refused(tmp_path, name):
    assert len(complaint(f"{tmp_path}/{name}")) < 600


@pytest.mark.skipif(sys.platform == "win32", reason="pipes are files on Unix")
def test_a_pipe_is_read_like_a_file(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_text, args=(ROWS,))
    writer.start()
    np.testing.assert_array_equal(read_table(pipe).column("b"), [2.5, 5.5])
    writer.join()


@pytest.mark.parametrize(
    "cell",
    [
        "x" * 100_000,
        "\u0663\u066b\u0665",
        "\u0661\u0662",
        "\uff11\uff12",
        "1_0",
        "²",
        "1\u00a02",
        "0x10",
        "1e5000",
        "nan",
    ],
)
def test_what_is_no_number_is_named_in_sixty_characters(file, cell):
    message = complaint(file(f"a,b\n1,2\n{cell},3\n"))
    assert "row 3, column 'a'" in message
    assert len(message) < 300 and (cell in message or "…" in message or not cell.isprintable())


def test_a_quote_that_is_never_closed_is_named_by_the_line_that_opens_it(file):
    message = complaint(file('a,b\n1,2\n3,"4\n' + "5,6\n" * 20_000))
    assert "line 3 opens a quote that is never closed" in message and len(message) < 300


def test_a_quote_over_a_hundred_thousand_lines_is_named_too(file):
    message = complaint(file('a,b\n1,2\n3,"4\n' + "5,6\n" * 50_000))
    assert "line 3: field larger than field limit" in message and len(message) < 300


def test_long_headers_are_listed_in_short(file):
    message = complaint(file(",".join(f"column{i}" for i in range(5000)) + "\n1\n"))
    assert "column 'a' is missing; the file has column0, column1" in message and len(message) < 900


@pytest.mark.parametrize("again", ["same", "link", "hard link", "another path"])
def test_a_file_given_twice_is_named(file, tmp_path, again):
    path, other = file(ROWS), file(ROWS, "other.csv")
    refuse_repeated([path, other])
    second = {"same": path, "another path": tmp_path / "." / "x" / ".." / "tracker.csv"}.get(again, tmp_path / "again")
    (tmp_path / "x").mkdir()
    if again == "link":
        second.symlink_to(path)
    elif again == "hard link":
        second.hardlink_to(path)
    with pytest.raises(InputError, match="is given twice; name each file once"):
        refuse_repeated([path, other, second])


YAML = {
    "a date that is none": ("- {a: 2024-13-45}", "month must be in 1..12"),
    "a mapping in itself": ("&x a: {b: *x}", "alias"),
    "a list in itself": ("- &x {a: [*x]}", "alias"),
    "depth": ("- {a: " + "[" * 5000 + "]" * 5000 + "}", "nested too deeply"),
    "5000 digits": ("- {a: " + "7" * 5000 + "}", "digits"),
    "5000 digits in base 16": ("- {a: 0x" + "7" * 5000 + "}", "digits"),
    "laughs": ("".join(f"x{i}: &x{i} [{', '.join([f'*x{i - 1}'] * 9)}]\n" for i in range(1, 9)), "alias"),
    "a key that is a list": ("- {[1, 2]: 3}", "unhashable"),
    "an object": ("- {a: !!python/object:os.system 1}", "could not determine a constructor"),
    "no list": ("7", "holds no list of entries"),
    "400 digits": ("- {a: " + "7" * 400 + "}", "row 1, column 'a' is 7777"),
}


@pytest.mark.parametrize("case", YAML)
def test_faults_of_yaml_are_one_sentence(file, case):
    text, said = YAML[case]
    message = complaint(file(text, "data.yaml"))
    assert said in message and len(message) < 400


def test_names_in_backticks_are_those_of_columns_and_broken_expressions_have_no_tree(file):
    assert expression_tree("a +") is None and expression_tree("a\0") is None
    assert [node.id for node in ast.walk(expression_tree("`x [mm]` / 2")) if isinstance(node, ast.Name)] == ["x [mm]"]
    table = read_table(file("x [mm],a\n2,3\n"))
    assert table.value("`x [mm]` / 2 + a * `x [mm]`").tolist() == [7.0]
    with pytest.raises(InputError, match="column '__quoted_0' is missing"):
        table.value("__quoted_0 + a")


@pytest.mark.parametrize("speed", [0.0, -1.0, np.nan, np.inf])
def test_a_joint_that_stands_still_is_refused_before_any_travel_is_planned(speed):
    joints, speeds = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]), np.array([1.0, speed])
    for travel in (move_seconds, travel_seconds, short_tour):
        with pytest.raises(InputError, match=f"speed of joint 2 is {speed:g}"):
            travel(joints, speeds)
