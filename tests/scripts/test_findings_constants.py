"""What findings depend on: the constants that are changed are those that are named, and no others."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import draw_plants, load_plant, load_tolerances

STUDIES = Path(__file__).parents[2] / "scripts/studies"


@pytest.fixture
def study(monkeypatch):
    monkeypatch.syspath_prepend(STUDIES)
    return importlib.import_module("findings_constants")


@pytest.mark.parametrize("plant", ["orchard", "field"])
def test_a_group_changes_its_own_effects_alone_and_once_is_as_shipped(study, plant):
    own, q = load_plant(plant), np.array([0.2, 0.3, 0.4, 0.3, 0.1, 0.5])
    found = [name for name in study.CONSTANTS if study.fits(plant, name, 0.5)]
    assert len(found) > 3
    for name in found:
        half = study.changed(own, name, 0.5)
        apart = {effect.name for effect in own.effects if effect != half.effect(effect.name)}
        assert apart and apart <= set(study.CONSTANTS[name])
        np.testing.assert_array_equal(study.changed(own, name, 1.0).tool_pose(q).position, own.tool_pose(q).position)
    np.testing.assert_array_equal(
        study.changed(own, study.AS_SHIPPED, 1.0).tool_pose(q).position, own.tool_pose(q).position
    )


@pytest.mark.parametrize("plant", ["orchard", "field"])
def test_drawn_arms_have_the_changed_constants_too(study, plant):
    def ends(constant, times):
        arms = draw_plants(study.changed(load_plant(plant), constant, times), coarse, 5, np.random.default_rng(2))
        return arms.tool_pose(np.tile([0.2, 0.3, 0.4, 0.3, 0.1, 0.5], (5, 1))).position

    coarse = load_tolerances("coarse")
    for constant in study.CONSTANTS:
        if study.fits(plant, constant, 0.5) and constant not in ("play and friction", "warming up"):  # seen in motion
            assert np.linalg.norm(ends(constant, 0.5) - ends(constant, 1.5), axis=1).min() > 1e-6


def test_a_softer_ground_moves_the_tool_farther(study):
    own, q = load_plant("orchard"), np.array([0.2, 0.3, 0.4, 0.3, 0.1, 0.5])
    firm = own.without("base_tilt").tool_pose(q).position
    moved = [
        np.linalg.norm(study.changed(own, "ground stiffness", t).tool_pose(q).position - firm) for t in (0.5, 1, 1.5)
    ]
    assert moved[0] > 1.8 * moved[1] > 1.8 * moved[2]
