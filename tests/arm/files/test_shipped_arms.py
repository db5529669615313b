"""The arms that come with pickenv: the same as their makers' own files, where these are at hand."""

from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import forward, load_arm, pose_error, shipped_arms

PUBLISHED = [
    ("so101", "so101/so101_new_calib.urdf#gripper_frame_link", 2e-5),  # its file rounds right angles to 1.5708
    ("panda", "mukca_sockets/urdf/panda.urdf#panda_link8", 1e-9),
]


@pytest.mark.parametrize(("name", "file", "within"), PUBLISHED)
def test_a_shipped_arm_moves_as_its_makers_file(data_folder: Path, name: str, file: str, within: float) -> None:
    if not (data_folder / file.partition("#")[0]).is_file():
        pytest.skip(f"no {file}")
    shipped, published = load_arm(name).nominal, load_arm(data_folder / file).nominal
    q = np.random.default_rng(0).uniform(shipped.lower, shipped.upper, (200, shipped.joints))
    np.testing.assert_allclose(pose_error(forward(published, q), forward(shipped, q)), 0, atol=within)
    np.testing.assert_allclose(shipped.lower, published.lower, atol=1e-5)
    np.testing.assert_allclose(shipped.upper, published.upper, atol=1e-5)


def test_so101_is_its_makers_mujoco_model_but_for_rounding(data_folder: Path) -> None:
    """The two files turn the last frame differently; its place and the axis of the last joint are the same."""
    file = data_folder / "so101/so101_new_calib.xml"
    if not file.is_file():
        pytest.skip(f"no {file}")
    shipped, published = load_arm("so101").nominal, load_arm(f"{file}#gripperframe").nominal
    q = np.random.default_rng(0).uniform(shipped.lower, shipped.upper, (200, 5))
    np.testing.assert_allclose(forward(shipped, q).position, forward(published, q).position, atol=1e-7)


@pytest.mark.parametrize("name", shipped_arms())
def test_every_shipped_arm_says_where_its_numbers_come_from(name: str) -> None:
    arm = load_arm(name)
    assert arm.name == name and len(arm.source) > 40
    assert (arm.speed > 0).all() and (arm.nominal.lower < arm.nominal.upper).all()
