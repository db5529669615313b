"""What nobody measured about a plant: ranges of constants, of which a name's number is one draw."""

from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import draw_arms, load_plant
from pickenv.arm.plant.plant_file import PLANTS, plant_times
from pickenv.base import InputError

Q = np.array([0.2, 0.3, 0.4, 0.3, 0.1, 0.5])
DRAWN = ["orchard", "field", "qiao2026"]


def test_a_number_is_one_draw_whoever_asks_and_draws_fill_the_range() -> None:
    plants, again = ([load_plant(f"orchard#{draw}") for draw in range(count)] for count in (60, 10))
    times = [plant.effect("joint_compliance").stiffness[0] for plant in plants]
    times = np.divide(times, load_plant("orchard").effect("joint_compliance").stiffness[0]).tolist()
    assert [plant.effects for plant in again] == [plant.effects for plant in plants[:10]]
    assert 0.5 <= min(times) < 0.55 and 1.45 < max(times) <= 1.5
    tilts = [plant.effect("base_tilt").stiffness[0] for plant in plants]
    assert abs(np.corrcoef(times, tilts)[0, 1]) < 0.3, "groups are drawn one by one"


@pytest.mark.parametrize("plant", DRAWN)
def test_a_draw_changes_the_design_and_leaves_its_arms_deviations(plant: str) -> None:
    shipped, drawn = (draw_arms(name, "coarse", 4, np.random.default_rng(1)) for name in (plant, f"{plant}#5"))
    np.testing.assert_array_equal(shipped.geometry.d, drawn.geometry.d)
    assert np.linalg.norm(shipped.tool_pose(Q).position - drawn.tool_pose(Q).position, axis=1).min() > 1e-6
    assert drawn.name == f"{plant}#5" and drawn.names == shipped.names


def test_a_class_takes_a_draw_and_what_is_off_stays_off() -> None:
    assert load_plant("coarse:orchard#5").effects == load_plant("orchard#5").effects
    assert load_plant("orchard#5", without=("base_tilt",)).effect("base_tilt") is None


def test_multiples_are_of_the_group_that_is_named() -> None:
    plant = load_plant("orchard")
    softer = plant_times(plant, {"ground stiffness": 0.5})
    assert softer.effect("base_tilt").stiffness == (1.5e4, 1.5e4)
    assert softer.without("base_tilt").effects == plant.without("base_tilt").effects
    with pytest.raises(ValueError, match="no unmeasured constants 'springs'; it has ground stiffness"):
        plant_times(plant, {"springs": 2.0})


@pytest.mark.parametrize("name", ["so101#1", "ideal:qiao2026#1", "orchard#", "orchard#-1", "nowhere#2", "orchard#3#4"])
def test_what_has_nothing_to_draw_refuses(name: str) -> None:
    with pytest.raises(InputError):
        load_plant(name)


SLIPS = {
    'constants = ["base_tilt.rigidity"]': "has no attribute 'rigidity'|rigidity",
    'constants = ["springs.stiffness"]': "there is no effect 'springs'",
    'constants = ["stiffness"]': "EFFECT.NUMBER",
    "times = [1.5, 0.5]": "the lower number first",
    "times = [0.0, 1.5]": "above zero|positive|> 0",
}


@pytest.mark.parametrize("slip", SLIPS)
def test_a_slip_in_a_file_is_told_with_the_file(slip: str, tmp_path: Path) -> None:
    text = (PLANTS / "orchard.toml").read_text(encoding="utf-8")
    right = 'constants = ["base_tilt.stiffness"]\n' if slip.startswith("constants") else "times = [0.5, 1.5]\n"
    path = tmp_path / "mine.toml"
    path.write_text(text.replace(right, slip + "\n", 1), encoding="utf-8")
    with pytest.raises(InputError, match=f"mine.toml.*({SLIPS[slip]})"):
        load_plant(path)


NUMBER = '"transmission_error.harmonics.amplitude"'


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('name = "waves of the drives"', 'name = "stiffness of joints, slides and boom"'),
        (NUMBER, '"joint_compliance.stiffness"'),
        (NUMBER, '"boom_bending.joint"'),
        (NUMBER, '"joint_compliance.place"'),
        (NUMBER, '"transmission_error.harmonics"'),
    ],
)
def test_what_is_given_twice_or_is_no_size_is_refused(old: str, new: str, tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text((PLANTS / "qiao2026.toml").read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=r"mine.toml.*unmeasured"):
        load_plant(path)
