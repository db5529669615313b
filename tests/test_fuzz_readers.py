"""Damaged text files of every kind: a result that can be used, or one clear sentence; no other error, and no hang."""

import itertools
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings, strategies as st

from pickenv.arm import ARMS, PLANTS, forward, load_arm, load_plant, urdf_text
from pickenv.arm.files.arm_file import UR_KEYS, UR_LINKS
from pickenv.base import InputError
from pickenv.calibration import Measurements, load_description, random_joints, read_observations, read_targets
from pickenv.calibration.reading.description import DESCRIPTIONS

SECONDS = 5
"""Nothing may hang for longer; only the slow tests look at a clock."""

UR5 = load_arm("ur5")
DRAWN = random_joints(UR5.nominal, 12, np.random.default_rng(0))
MEASURED = Measurements(DRAWN, *forward(UR5.nominal, DRAWN), prismatic=UR5.nominal.prismatic)
DESCRIBED = (
    'joints.columns = ["joints.0", "joints.1", "joints.2", "joints.3", "joints.4", "joints.5"]\njoints.unit = "rad"\n'
    'position.columns = ["tool.x", "`tool.y` - 0", "tool.z"]\nposition.unit = "m"\nposition.std_mm = 0.02\n'
)
MIMIC = '<mimic joint="{}" multiplier="0.5" offset="0.1"/></joint>'


def csv_text() -> str:
    names, values = MEASURED.table()
    return "\n".join([",".join(names), *(",".join(map(repr, row)) for row in values.tolist())]) + "\n"


def yaml_text() -> str:
    rows = zip(DRAWN.tolist(), MEASURED.position.tolist(), strict=True)
    return "".join(f"- joints: {q}\n  tool: {{x: {p[0]}, y: {p[1]}, z: {p[2]}}}\n" for q, p in rows)


def coupled_urdf() -> str:
    """An arm whose last joint follows its first."""
    head, _, tail = urdf_text(UR5.nominal, "ur5", UR5.speed).rpartition('type="revolute"')
    return head + 'type="revolute"' + tail.replace("</joint>", MIMIC.format(UR5.nominal.joint_names[0]), 1)


def used(arm) -> None:
    """An arm that was read can be used: its tool stands somewhere."""
    pose = forward(arm.nominal, random_joints(arm.nominal, 3, np.random.default_rng(0)))
    assert np.isfinite(pose.position).all() and (arm.speed > 0).all() and (arm.nominal.lower < arm.nominal.upper).all()


def read_csv(path: Path) -> None:
    measured = read_observations([path], UR5.nominal)
    assert np.isfinite(measured.joints).all() and np.isfinite(measured.position).all()


def read_yaml(path: Path) -> None:
    described = path.with_name("described.toml")
    described.write_text(DESCRIBED, encoding="utf-8")
    assert np.isfinite(read_observations([path], UR5.nominal, described).position).all()


def read_described(path: Path) -> None:
    """A damaged description, read and used on a sound file."""
    load_description(path)
    sound = path.with_name("sound.yaml")
    sound.write_text(yaml_text(), encoding="utf-8")
    assert np.isfinite(read_observations([sound], UR5.nominal, path).joints).all()


MODEL = """<mujoco model="small"><compiler angle="radian" eulerseq="XYZ"/>
<default><joint axis="0 1 0"/><default class="odd"><joint ref="0.1" range="-2 2"/></default></default><worldbody>
<body name="one" pos="0 0 1" euler="0.1 0 0"><joint name="a" range="-1 1"/>
<body name="two" pos="1 0 0" childclass="odd"><joint name="b"/><body name="three" xyaxes="0 1 0 0 0 1">
<joint name="c" type="slide" pos="1 2 3" range="0 1"/>
<site name="tool0" zaxis="1 0 0"/></body></body></body></worldbody>
<equality><joint joint1="c" joint2="b" polycoef="0.1 0.2 0 0 0"/></equality></mujoco>"""


def ur_kinematics() -> str:
    numbers = ", ".join(f"{key}: 0.{i + 1}" for i, key in enumerate(UR_KEYS))
    return "kinematics:\n" + "".join(f"  {link}: {{{numbers}}}\n" for link in UR_LINKS) + "  hash: calib_1\n"


# kind: a sound text, the ending of its name, and what reads it
KINDS: dict[str, tuple[str, str, Callable[[Path], object]]] = {
    "csv": (csv_text(), ".csv", read_csv),
    "yaml": (yaml_text(), ".yaml", read_yaml),
    "targets": (csv_text(), ".csv", lambda path: read_targets(path, UR5.nominal)),
    "description": (DESCRIBED, ".toml", read_described),
    "shipped description": (
        (DESCRIPTIONS / "ur5_jacobi2025.toml").read_text(encoding="utf-8"),
        ".toml",
        load_description,
    ),
    "arm": ((ARMS / "qiao2026.toml").read_text(encoding="utf-8"), ".toml", lambda path: used(load_arm(path))),
    "plant": ((PLANTS / "orchard.toml").read_text(encoding="utf-8"), ".toml", load_plant),
    "urdf": (coupled_urdf(), ".urdf", lambda path: used(load_arm(path))),
    "mjcf": (MODEL, ".xml", lambda path: used(load_arm(path))),
    "ur kinematics": (ur_kinematics(), ".yaml", lambda path: used(load_arm(path))),
}

TOKENS = [
    b"0", b"-1", b"1e999", b"nan", b"inf", b"9" * 400, b"9" * 5000, b"0x" + b"f" * 5000, b"2024-13-45",
    b"\xef\xbb\xbf", b"\xff\xfe", b"\0", b"\n", b"\r", b'"', b"'", b'"""', b"[" * 2000, b"]" * 2000, b"{", b"}",
    b"- " * 500, b"&a ", b"*a", b"!!python/object:a ", b": ", b"#", b",", b";", b"\t", b"|", b"-" * 2000, b"`",
    b"(" * 300, b"**", b"\xd9\xa3", b"<", b">", b"</", b"<!ENTITY a '&b;'>", b"mimic", b"link1", b"link2", b"base",
    b"joint", b"true", b"false", b"null", b"\\u0000", b"lower", b"upper", b"velocity", b"<!--", b"<![CDATA[",
    b"\xe2\x80\xa8", b"follows = 1\n", b"ratio = 1e-9\n", b"name = 3\n",
]  # fmt: skip
"""What breaks parsers: numbers without end, depth, quotes, marks of other encodings and other formats."""

edit = st.tuples(
    st.sampled_from(["insert", "replace", "delete", "repeat", "move", "byte"]),
    st.floats(0.0, 1.0),
    st.integers(1, 60),
    st.one_of(st.sampled_from(TOKENS), st.binary(min_size=1, max_size=4)),
)


def damaged(content: bytes, edits) -> bytes:
    """``content`` after edits at places given as shares of its length."""
    for kind, place, length, token in edits:
        start = int(place * len(content))
        end = start + length
        match kind:
            case "insert":
                content = content[:start] + token + content[start:]
            case "replace":
                content = content[:start] + token + content[end:]
            case "delete":
                content = content[:start] + content[end:]
            case "repeat":
                content = content[:end] + content[start:]
            case "move":
                content = content[:start] + content[end:] + content[start:end]
            case "byte":
                content = content[:start] + token[:1] + content[start + 1 :]
    return content


numbers = itertools.count()


def survives(kind: str, folder: Path, edits) -> None:
    """Reading a damaged file gives a result or one sentence."""
    text, ending, read = KINDS[kind]
    path = folder / f"damaged{next(numbers)}{ending}"  # a new name each: arms are remembered by name and time
    path.write_bytes(damaged(text.encode(), edits))
    try:
        read(path)
    except InputError as error:
        assert 10 < len(str(error)) < 3000
    finally:
        path.unlink()


@contextmanager
def at_most(seconds: int) -> Iterator[None]:
    def late(*_: object) -> None:
        raise TimeoutError(f"reading took longer than {seconds} s")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize("kind", KINDS)
def test_a_sound_file_is_read(tmp_path, kind):
    text, ending, read = KINDS[kind]
    (tmp_path / f"sound{ending}").write_text(text, encoding="utf-8")
    read(tmp_path / f"sound{ending}")


@pytest.mark.parametrize("kind", KINDS)
@given(edits=st.lists(edit, min_size=1, max_size=4))
@example(edits=[("insert", 0.0, 1, b"\xef\xbb\xbf")])
@example(edits=[("insert", 0.5, 1, b"[" * 5000)])
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_damaged_file_gives_a_result_or_one_sentence(tmp_path, kind, edits):
    survives(kind, tmp_path, edits)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
@given(edits=st.lists(edit, min_size=1, max_size=6))
@settings(max_examples=500, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_five_hundred_damaged_files_neither_fail_otherwise_nor_hang(tmp_path, kind, edits):
    with at_most(SECONDS):
        survives(kind, tmp_path, edits)
