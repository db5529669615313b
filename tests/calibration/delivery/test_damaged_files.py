"""A robot's own file, damaged anywhere, is patched or refused in one sentence; it never raises anything else."""

import contextlib
import json

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from pickenv.arm import load_arm
from pickenv.base import InputError
from pickenv.calibration import export

SNIPPETS = ["", "<", ">", '"', "&amp;", "1e400", "nan", "-", "{", "}", ":", "\n", "true", "[]", "\x0c", "é", "<a/>"]
MJCF = """<mujoco><compiler angle="radian"/><worldbody><body name="a" pos="0 0 1"><joint name="J1 base"/>
<body name="b" quat="1 0 0 1"><joint name="J2 shoulder" axis="0 1 0" ref="0.1"/></body></body></worldbody></mujoco>"""
YAML = "kinematics:\n" + "".join(
    f"  {link}:\n" + "".join(f"    {key}: 0.1\n" for key in ("x", "y", "z", "roll", "pitch", "yaw"))
    for link in ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
)
CONTROL = '<robot><ros2_control><joint name="J1 base"><param name="offset">0.5</param></joint></ros2_control></robot>'


@pytest.fixture(scope="module")
def texts(tmp_path_factory, made):
    """A good file of each kind, how it is asked for, and a calibration of its arm."""
    folder, rng = tmp_path_factory.mktemp("good"), np.random.default_rng(0)
    ur5 = load_arm("ur5")
    motor = {"id": 1, "drive_mode": 0, "homing_offset": 5, "range_min": 100, "range_max": 3000}
    motors = dict.fromkeys(ur5.nominal.joint_names, motor)
    urdf = export(made(ur5, rng), folder / "ur5.urdf").path.read_text()
    good = {"urdf": (urdf, "#tool"), "xml": (MJCF, "#b"), "yaml": (YAML, "")}
    found = {
        "json": (json.dumps(motors), "", None, made(ur5, rng)),
        "xacro": (CONTROL, "", "ros2-control", made(ur5, rng)),
    }
    for ending, (text, tip) in good.items():
        path = folder / f"own.{ending}"
        path.write_text(text)
        found[ending] = text, tip, None, made(load_arm(f"{path}{tip}"), rng)
    return found


@given(data=st.data(), ending=st.sampled_from(["urdf", "xml", "yaml", "json", "xacro"]))
@settings(max_examples=120)
def test_damage_is_refused_in_one_sentence(tmp_path_factory, texts, data, ending):
    folder = tmp_path_factory.mktemp("damaged")
    text, tip, kind, calibration = texts[ending]
    for _ in range(data.draw(st.integers(1, 3))):
        start = data.draw(st.integers(0, len(text)))
        stop = data.draw(st.integers(start, min(len(text), start + 12)))
        text = text[:start] + data.draw(st.sampled_from(SNIPPETS)) + text[stop:]
    own = folder / f"own.{ending}"
    own.write_text(text, encoding="utf-8")
    with contextlib.suppress(InputError):
        done = export(calibration, folder / "out", kind=kind, onto=f"{own}{tip}")
        assert done.path.stat().st_size > 0
