"""Without a tip an arm ends at its flange: never at a finger, a wheel or a head."""

import re
from pathlib import Path

import pytest

from pickenv.arm import load_arm
from pickenv.arm.files.joint_chain import Carried, flange
from pickenv.base import InputError

PUBLISHED = {
    "so101/so101_new_calib.urdf": "gripper_link",
    "so101/so101_new_calib.xml": "gripper",
    "mukca_sockets/urdf/panda.urdf": "panda_hand",
    "mukca_sockets/urdf/iiwa14.urdf": "tool0",
    "mukca_sockets/urdf/vx300s.urdf": "ee_arm_link",
    "mukca_sockets/urdf/gen3lite.urdf": "dummy_link",
}
"""Files as their makers or the data sets' authors publish them, and where a tool is bolted."""


@pytest.mark.parametrize(("file", "tip"), PUBLISHED.items())
def test_published_arms_end_at_their_flange_and_say_so(data_folder: Path, file: str, tip: str) -> None:
    path = data_folder / file
    if not path.is_file():
        pytest.skip(f"no {path}")
    arm = load_arm(path)
    assert arm.source.endswith(f", by default its flange, tip {tip}")
    assert not [name for name in arm.nominal.joint_names if re.search("finger|gripper|jaw", name)]
    named = load_arm(f"{path}#{tip}")
    assert named.fingerprint() == arm.fingerprint() and "default" not in named.source


def tree(*ways: str) -> dict[str, list[Carried]]:
    """``a-j>b``: link b on link a, moved by joint j; ``a>b``: fixed."""
    found: dict[str, list[Carried]] = {}
    for way in ways:
        before, link = way.split(">")
        parent, *joints = before.split("-")
        found.setdefault(parent, []).append(Carried(link, tuple(joints)))
    return found


ARM = ("base-j1>l1", "l1-j2>l2", "l2-j3>l3", "l3-j4>l4")

TREES = {
    "a bare chain": ((), "l4"),
    "what is bolted on, while there is one way": (("l4>adapter", "adapter>ball"), "ball"),
    "two things bolted on": (("l4>adapter", "adapter>ball", "adapter>camera"), "adapter"),
    "a flange by name among others": (("l4>ft_frame", "l4>arm_flange", "arm_flange>arm_tool0"), "arm_tool0"),
    "two fingers": (("l4>hand", "hand-a>left", "hand-b>right"), "hand"),
    "a jaw beside a mark": (("l4>frame", "l4-gripper>jaw"), "l4"),
    "a jaw alone": (("l4-gripper>jaw",), "l4"),
    "a hand of deep fingers": (
        ("l4-a1>x1", "x1-a2>x2", "x2-a3>x3", "l4-b1>y1", "y1-b2>y2"),
        "l4",
    ),
    "a knuckle that carries a finger": (("l4-knuckle>k", "k-finger>f", "k>pad"), "l4"),
    "wheels and a camera's pan beside": (("base-w1>w1", "base-w2>w2", "l1-pan>h1"), "l4"),
    "a pinion beside": (("l1-pinion>gear",), "l4"),
    "a camera on the base": (("base>camera",), "l4"),
}


@pytest.mark.parametrize("case", TREES)
def test_where_a_tool_is_bolted(case: str) -> None:
    extra, wanted = TREES[case]
    assert flange(tree(*ARM, *extra), "base") == wanted


def test_a_head_of_nearly_as_many_joints_is_not_guessed_at() -> None:
    """Three joints of the arm against two of the head."""
    with pytest.raises(InputError, match=r"branches at link 'l1' towards 'l2' and 'h1'; name the arm's last link"):
        flange(tree(*ARM, "l1-pan>h1", "h1-tilt>h2"), "base")


def test_an_arm_whose_every_joint_is_named_after_its_gripper_is_an_arm() -> None:
    ways = ("base-gripper_bot_1>l1", "l1-gripper_bot_2>l2", "l2-gripper_bot_3>l3")
    assert flange(tree(*ways), "base") == "l3"


def test_two_arms_on_one_base_are_not_guessed_at() -> None:
    ways = [f"{'base' if i == 0 else f'{side}{i}'}-{side}j{i}>{side}{i + 1}" for side in "ab" for i in range(5)]
    with pytest.raises(InputError, match=r"branches at link 'base' towards 'a1' and 'b1'"):
        flange(tree(*ways), "base")
