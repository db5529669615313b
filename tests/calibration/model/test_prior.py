"""What is expected before measuring: widths from a tolerance class, and the words that stand for them."""

import numpy as np
import pytest

from pickenv.arm import draw_plants, load_arm, load_plant, load_tolerances, standard_deviations
from pickenv.base import InputError
from pickenv.calibration import prior_model
from pickenv.calibration.model.noise_and_priors import ANGLES, FRAMES, LENGTHS, ZEROS

UR5 = load_arm("ur5").nominal


def test_arms_of_a_class_differ_as_their_prior_says():
    """Drawn arms' parameters have the standard deviations that a fit expects of them."""
    for kind in ("cobot", "printed"):
        arms = draw_plants(load_plant("ideal:ur5"), load_tolerances(kind), 400, np.random.default_rng(0)).geometry
        std = dict(zip(UR5.parameter_names, standard_deviations(load_tolerances(kind), UR5), strict=True))
        for i in range(6):
            assert arms.a[:, i].std() == pytest.approx(std[f"a{i}"], rel=0.15)
            assert arms.theta[:, i].std() == pytest.approx(std[f"theta{i + 1}"], rel=0.15)


def test_words_are_widths():
    full, auto, offsets = (prior_model("ur5", UR5, known=False, fit=fit) for fit in ("full", "auto", "offsets"))
    assert np.isinf(full.std).all() and auto.proper and offsets.proper
    assert set(offsets.group) == {FRAMES, ZEROS} and set(auto.group) == {FRAMES, ZEROS, LENGTHS, ANGLES}
    assert (auto.std[auto.group == FRAMES] >= 10.0).all()  # anywhere
    assert (auto.std[auto.group != FRAMES] < 0.01).all()  # millimetres, milliradians


def test_known_frames_say_nothing_of_how_joint_1_and_the_flange_are_made():
    known = prior_model("ur5", UR5, known=True)
    assert FRAMES not in known.group and known.proper
    seats = np.array([name.startswith(("base_", "tool_")) for name in known.parameters.names])
    assert seats.sum() == 12 and (known.std[seats] < 0.01).all() and set(known.group[seats]) == {LENGTHS, ANGLES}


def test_a_scale_that_is_given_is_not_sought():
    twice = prior_model("ur5", UR5, known=True, tolerances="medium", scale=2.0)
    once = prior_model("ur5", UR5, known=True, tolerances="medium")
    assert np.allclose(twice.width, 2.0 * once.width) and twice.scales == dict.fromkeys((ZEROS, LENGTHS, ANGLES), 2.0)
    assert once.scales == {} and "medium" in once.source


def test_an_unknown_class_is_named():
    with pytest.raises(InputError, match=r"unknown tolerance class 'cobt'; give one of .*cobot"):
        prior_model("ur5", UR5, known=True, tolerances="cobt")
