"""What findings depend on: the constants that are changed are those that are named, and no others."""

import importlib
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import draw_plants, load_plant, load_tolerances
from pickenv.base import toml_of

STUDIES = Path(__file__).parents[2] / "scripts/studies"


@pytest.fixture
def study(monkeypatch):
    monkeypatch.syspath_prepend(STUDIES)
    return importlib.import_module("findings_constants")


@pytest.mark.parametrize("plant", ["orchard", "field"])
def test_a_group_changes_its_own_effects_alone_and_once_is_as_shipped(study, plant):
    own, q = load_plant(plant), np.array([0.2, 0.3, 0.4, 0.3, 0.1, 0.5])
    groups = {group.name: {name.partition(".")[0] for name in group.constants} for group in own.unmeasured}
    asked = toml_of(STUDIES / "findings_constants.toml")[0]["factors"]["constant"]
    assert len(groups) > 3 and set(groups) == {name for name in asked if study.fits(plant, name, 0.5)}
    for name, effects in groups.items():
        half = study.changed(own, name, 0.5)
        assert {effect.name for effect in own.effects if effect != half.effect(effect.name)} == effects
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
    for constant in (group.name for group in load_plant(plant).unmeasured):
        if constant not in ("play and friction", "warming up"):  # seen in motion
            assert np.linalg.norm(ends(constant, 0.5) - ends(constant, 1.5), axis=1).min() > 1e-6


def test_a_softer_ground_moves_the_tool_farther(study):
    own, q = load_plant("orchard"), np.array([0.2, 0.3, 0.4, 0.3, 0.1, 0.5])
    firm = own.without("base_tilt").tool_pose(q).position
    moved = [
        np.linalg.norm(study.changed(own, "ground stiffness", t).tool_pose(q).position - firm) for t in (0.5, 1, 1.5)
    ]
    assert moved[0] > 1.8 * moved[1] > 1.8 * moved[2]
