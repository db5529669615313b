"""MJCF in: any chain of hinges and slides of a MuJoCo model moves as MuJoCo itself moves it."""

import math
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import Pose, forward, load_arm, pose_error
from pickenv.base import InputError

mujoco = pytest.importorskip("mujoco")


def referee(path: Path, tip: str, names: tuple[str, ...], q: np.ndarray, ties: dict[str, tuple] | None = None) -> Pose:
    """Poses of a body or site by MuJoCo; a tied joint is set as its equality constraint says."""
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, tip)
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, tip)
    positions, rotations = [], []
    for row in q:
        data.qpos[:] = model.qpos0
        value = dict(zip(names, row, strict=True))
        for name, (leader, shift, factor) in (ties or {}).items():
            own, other = (model.qpos0[model.joint(each).qposadr[0]] for each in (name, leader))
            value[name] = own + shift + factor * (value[leader] - other)
        for name, number in value.items():
            data.qpos[model.joint(name).qposadr[0]] = number
        mujoco.mj_kinematics(model, data)
        positions.append((data.xpos[body] if body >= 0 else data.site_xpos[site]).copy())
        rotations.append((data.xmat[body] if body >= 0 else data.site_xmat[site]).reshape(3, 3).copy())
    return Pose(np.array(positions), np.array(rotations))


def moves_as_in_mujoco(path: Path, tip: str, ties: dict[str, tuple] | None = None) -> None:
    arm = load_arm(f"{path}#{tip}")
    geometry = arm.nominal
    q = np.random.default_rng(0).uniform(geometry.lower, geometry.upper, (60, geometry.joints))
    expected = referee(path, tip, geometry.joint_names, q, ties)
    np.testing.assert_allclose(pose_error(forward(geometry, q), expected), 0, atol=1e-9)


def so101(data_folder: Path, name: str = "so101_new_calib.xml") -> Path:
    path = data_folder / "so101" / name
    if not path.is_file():
        pytest.skip(f"no {path}")
    return path


@pytest.mark.parametrize("tip", ["gripperframe", "gripper", "moving_jaw_so101_v1"])
def test_so101_as_its_makers_publish_it_moves_as_in_mujoco(data_folder: Path, tip: str) -> None:
    moves_as_in_mujoco(so101(data_folder), tip)


def test_a_scene_is_read_through_what_it_includes(data_folder: Path) -> None:
    scene, own = (load_arm(so101(data_folder, name)).nominal for name in ("scene.xml", "so101_new_calib.xml"))
    q = np.random.default_rng(1).uniform(own.lower, own.upper, (20, 5))
    np.testing.assert_array_equal(pose_error(forward(own, q), forward(scene, q)), 0)


def test_so101_ends_at_its_flange_and_says_so(data_folder: Path) -> None:
    arm = load_arm(so101(data_folder))
    assert arm.nominal.joint_names == ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
    assert arm.source.endswith("by default its flange, tip gripper")


def orientation(rng: np.random.Generator, degrees: bool) -> str:
    """One of MJCF's five ways to tell an orientation, or none."""
    unit = 180 / np.pi if degrees else 1.0
    numbers = rng.normal(size=6)
    ways = {
        "quat": numbers[:4],
        "axisangle": [*numbers[:3], numbers[3] * unit],
        "euler": numbers[:3] * unit,
        "xyaxes": numbers,
        "zaxis": numbers[:3] if rng.random() < 0.8 else [0, 0, -1],
    }
    way = rng.choice([*ways, ""])
    return f'{way}="{text(ways[way])}"' if way else ""


def text(numbers: object) -> str:
    return " ".join(repr(float(number)) for number in np.asarray(numbers))


def model(seed: int) -> tuple[str, dict[str, tuple]]:
    """A model with everything that places a joint, and the ties between its joints."""
    rng = np.random.default_rng(seed)
    degrees = rng.random() < 0.5
    unit = 180 / np.pi if degrees else 1.0
    sequence = "".join(rng.choice(list("xyzXYZ"), 3))
    angle = "" if degrees and rng.random() < 0.5 else f'angle="{"degree" if degrees else "radian"}"'
    body, end, count = "", "", 0
    for i in range(rng.integers(1, 5)):
        frame = rng.random() < 0.3
        if frame:
            childclass = 'childclass="odd"' if rng.random() < 0.5 else ""
            body += f'<frame pos="{text(rng.normal(size=3))}" {orientation(rng, degrees)} {childclass}>'
        childclass = 'childclass="odd"' if rng.random() < 0.3 else ""
        body += f'<body name="b{i}" pos="{text(rng.normal(size=3))}" {orientation(rng, degrees)} {childclass}>'
        body += '<geom size="0.1"/>'
        inner = rng.random() < 0.3
        if inner:
            body += f'<frame pos="{text(rng.normal(size=3))}" {orientation(rng, degrees)}>'
        for _ in range(rng.integers(0 if i else 1, 3)):
            kind = rng.choice(["hinge", "slide", ""])
            turns = kind != "slide"
            low = rng.normal(size=1) - 1.0
            span = np.append(low, low + rng.uniform(0.2, 2.0, 1)) * (unit if turns else 1.0)
            own = f'type="{kind}"' if kind else ""
            limits = "" if turns and rng.random() < 0.3 else f'range="{text(span)}" limited="true"'
            ref = f'ref="{float(rng.normal()) * (unit if turns else 1.0)!r}"' if rng.random() < 0.5 else ""
            axis = f'axis="{text(rng.normal(size=3))}"' if rng.random() < 0.7 else ""
            place = f'pos="{text(rng.normal(size=3))}"' if rng.random() < 0.6 else ""
            name = 'class="odd"' if rng.random() < 0.3 and not axis else ""
            body += f'<joint name="j{count}" {own} {limits} {ref} {axis} {place} {name}/>'
            count += 1
        if inner:
            body += "</frame>"
        end = "</body>" + ("</frame>" if frame else "") + end
    body += f'<site name="tip" pos="{text(rng.normal(size=3))}" {orientation(rng, degrees)}/>'
    ties: dict[str, tuple] = {}
    equality = ""
    if count > 1 and rng.random() < 0.6:
        leader, follower = (f"j{i}" for i in rng.permutation(count)[:2])
        shift, factor = rng.normal(size=2) * [0.3, 1.0]
        ties[follower] = leader, shift, factor
        polynomial = text([shift, factor, 0, 0, 0])
        equality = f'<equality><joint joint1="{follower}" joint2="{leader}" polycoef="{polynomial}"/></equality>'
    default = (
        f'<default><joint pos="{text(rng.normal(size=3))}"/><site {orientation(rng, degrees)}/>'
        f'<default class="odd"><joint axis="{text(rng.normal(size=3))}"/></default></default>'
    )
    world = f'<worldbody><site name="mark"/>{body}{end}</worldbody>'
    return f'<mujoco model="made"><compiler {angle} eulerseq="{sequence}"/>{default}{world}{equality}</mujoco>', ties


@pytest.mark.parametrize("seed", range(60))
def test_generated_models_move_as_in_mujoco(tmp_path: Path, seed: int) -> None:
    """All ways to place a body and a joint, several joints on a body, frames, defaults, references and ties."""
    path = tmp_path / "made.xml"
    written, ties = model(seed)
    path.write_text(written, encoding="utf-8")
    try:
        moves_as_in_mujoco(path, "tip", ties)
    except InputError as error:  # a tie's range and its leader's may not meet
        assert ties and "leave no motion" in str(error)


ARM = """<mujoco model="small"><compiler angle="radian"/><worldbody>
<body name="stand"><body name="one" pos="0 0 1"><joint name="a" axis="0 1 0" range="-1 1"/>
<body name="two" pos="1 0 0"><joint name="b" axis="0 1 0" range="-2 2"/>
<body name="three" pos="1 0 0"><joint name="c" axis="0 0 1"/>
<body name="left" pos="0 1 0"><joint name="finger_l" type="slide" range="0 0.1"/></body>
<body name="right" pos="0 -1 0"><joint name="finger_r" type="slide" range="0 0.1"/></body>
</body></body></body></body></worldbody></mujoco>"""


def written(folder: Path, what: str) -> Path:
    path = folder / "arm.xml"
    path.write_text(what, encoding="utf-8")
    return path


def with_equality(tie: str) -> str:
    return ARM.replace("</mujoco>", f"<equality>{tie}</equality></mujoco>")


def test_limits_speeds_and_the_flange(tmp_path: Path) -> None:
    arm = load_arm(written(tmp_path, ARM))
    assert arm.name == "small" and arm.source == "MJCF arm.xml, by default its flange, tip three"
    np.testing.assert_array_equal(arm.nominal.lower, [-1, -2, -math.pi])
    np.testing.assert_array_equal(arm.nominal.upper, [1, 2, math.pi])
    np.testing.assert_array_equal(arm.speed, 1.0)


@pytest.mark.parametrize(
    "tie",
    [
        '<connect body1="left" body2="right" anchor="0 0 0"/>',
        '<weld body1="three" body2="one" active="false"/>',
        '<joint joint1="finger_l" joint2="finger_r"/>',
    ],
)
def test_what_ties_only_the_gripper_is_no_loop_of_the_arm(tmp_path: Path, tie: str) -> None:
    assert load_arm(written(tmp_path, with_equality(tie))).nominal.joints == 3


def test_a_joint_tied_to_the_world_does_not_move(tmp_path: Path) -> None:
    arm = load_arm(written(tmp_path, with_equality('<joint joint1="b" polycoef="0.3 0 0 0 0"/>'))).nominal
    assert arm.joint_names == ("a", "c")
    free = load_arm(written(tmp_path, ARM)).nominal
    q = np.random.default_rng(0).uniform(-1, 1, (20, 2))
    all_three = np.column_stack([q[:, 0], np.full(20, 0.3), q[:, 1]])
    np.testing.assert_allclose(pose_error(forward(free, all_three), forward(arm, q)), 0, atol=1e-12)


def test_a_slide_that_follows_needs_no_range(tmp_path: Path) -> None:
    stages = ARM.replace('name="b" axis="0 1 0"', 'name="b" type="slide" axis="0 1 0"')
    stages = stages.replace('name="c" axis="0 0 1"', 'name="c" type="slide" axis="0 0 1"')
    stages = stages.replace('"radian"', '"radian" boundmass="1" boundinertia="1"')
    for leader in (' joint2="b"', ""):  # the latter is tied to the world
        tie = f'<equality><joint joint1="c"{leader} polycoef="0.1 0.5"/></equality></mujoco>'
        path = written(tmp_path, stages.replace("</mujoco>", tie))
        assert load_arm(f"{path}#three").nominal.joint_names == ("a", "b")
        if leader:
            moves_as_in_mujoco(path, "three", {"c": ("b", 0.1, 0.5)})


BAD = {
    "a loop": (with_equality('<weld body1="three" body2="stand"/>'), "a weld constraint closes a loop through body"),
    "a loop to the world": (with_equality('<connect body1="two" anchor="0 0 0"/>'), "a connect constraint closes"),
    "a curve": (with_equality('<joint joint1="b" joint2="a" polycoef="0 1 2 0 0"/>'), "'b' follows 'a' by a curve"),
    "a ring": (
        with_equality('<joint joint1="b" joint2="a"/><joint joint1="a" joint2="b"/>'),
        "joint 'a' mimics itself",
    ),
    "two leaders": (
        with_equality('<joint joint1="b" joint2="a"/><joint joint1="b" joint2="c"/>'),
        "two equality constraints tie joint 'b'",
    ),
    "no such joint": (with_equality('<joint joint1="b" joint2="z"/>'), "is no joint of the file"),
    "no such tip": (ARM, "there is no body or site 'nowhere'"),
    "a ball": (ARM.replace('name="b" axis="0 1 0" range="-2 2"', 'name="b" type="ball"'), "is of type ball"),
    "a free base": (ARM.replace('<body name="stand">', '<body name="stand"><freejoint/>'), "is of type free"),
    "a slide without range": (ARM.replace('name="c" axis="0 0 1"', 'name="c" type="slide"'), "'c' has no range"),
    "a range backwards": (
        ARM.replace('range="-1 1"', 'range="1 -1" limited="true"'),
        "lower end is not below its upper end",
    ),
    "an axis without direction": (ARM.replace('axis="0 0 1"', 'axis="0 0 0"'), "axis of joint 'c' has no direction"),
    "words": (ARM.replace('pos="0 0 1"', 'pos="0 up 1"'), "'0 up 1' is not three numbers"),
    "two orientations": (
        ARM.replace('pos="0 0 1"', 'quat="1 0 0 0" euler="1 0 0"'),
        "is given by both quat and euler",
    ),
    "a body twice": (ARM.replace('name="right"', 'name="left"'), "body 'left' is given twice"),
    "a joint twice": (ARM.replace('name="c"', 'name="a"'), "joint 'a' is given twice"),
    "an unknown class": (ARM.replace('name="c"', 'name="c" class="x"'), "there is no default class 'x'"),
    "an unknown unit": (ARM.replace('"radian"', '"grad"'), "angle of <compiler> is 'grad'"),
    "an odd sequence": (ARM.replace('"radian"', '"radian" eulerseq="xyq"'), "eulerseq of <compiler> is 'xyq'"),
    "itself": (ARM.replace("<worldbody>", '<include file="arm.xml"/><worldbody>'), "arm.xml is included twice"),
    "nothing there": (ARM.replace("<worldbody>", '<include file="x.xml"/><worldbody>'), "x.xml, which does not exist"),
    "a URDF": ("<robot/>", "is no MJCF: its first element is <robot>; name it .urdf"),
    "an empty model": ("<mujoco/>", "has no moving joint"),
    "not XML": ("<mujoco", "is not valid XML"),
}


@pytest.mark.parametrize("case", BAD)
def test_unusable_models_get_one_sentence(tmp_path: Path, case: str) -> None:
    what, said = BAD[case]
    tip = {"no such tip": "#nowhere", "a body twice": "", "an empty model": ""}.get(case, "#three")
    with pytest.raises(InputError, match=said) as caught:
        load_arm(f"{written(tmp_path, what)}{tip}")
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400 + len(str(tmp_path))


def test_a_model_of_ten_thousand_bodies_is_read(tmp_path: Path) -> None:
    count = 10_000
    row = "".join(f'<body name="x{i}" pos="0 0 0.001">' for i in range(count)) + "</body>" * count
    what = ARM.replace('<body name="left"', row + '<body name="left"').replace("finger_", "f")
    assert load_arm(f"{written(tmp_path, what)}#x{count - 1}").nominal.joints == 3
