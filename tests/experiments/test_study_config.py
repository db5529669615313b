"""A study's file says what is varied; its hash covers everything that the rows depend on, and nothing else."""

import shutil
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import pytest

from pickenv.arm import PLANTS, TOLERANCES
from pickenv.base import InputError
from pickenv.experiments import load_study

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("name", ["tolerance_study", "tolerance_grades"])
def test_an_example_study_loads_and_a_quick_one_keeps_its_settings(name):
    config = load_study(ROOT / "scripts" / f"{name}.toml")
    quick = config.quick()
    assert quick.arms <= 40 and quick.fruit <= 20
    assert quick.settings() == config.settings()
    assert len({setting.it_grade for setting in config.settings()}) >= 4


def test_settings_are_the_product_and_an_arm_without_calibration_has_no_poses(study_file):
    settings = load_study(study_file()).settings()
    assert [setting.number for setting in settings] == list(range(len(settings)))
    assert len(settings) == 2 * (1 + 2) * 2  # grades x (raw, LS with 12 and with 20 poses) x payloads
    raw = [setting for setting in settings if setting.method == "raw"]
    assert {(setting.poses, setting.noise_mm, setting.noise_deg) for setting in raw} == {(0, 0.0, 0.0)} and len(
        raw
    ) == 4
    assert {setting.poses for setting in settings if setting.method == "ls"} == {12, 20}


def test_without_grades_the_class_has_its_own(study_file):
    settings = load_study(study_file(("it_grades = [8, 14]\n", ""))).settings()
    assert {setting.it_grade for setting in settings} == {12}


@pytest.mark.parametrize(("arms", "chunk"), [(12, 5), (12, 12), (12, 50), (1, 1), (13, 4)])
def test_chunks_hold_every_arm_once(study_file, arms, chunk):
    config = replace(load_study(study_file()), arms=arms, chunk=chunk)
    ranges = [config.arms_of(number) for number in config.chunks()]
    assert [arm for numbers in ranges for arm in numbers] == list(range(arms))
    assert all(one.stop == other.start for one, other in pairwise(ranges))


def test_what_is_written_is_read_back(study_file, tmp_path):
    for changes in (
        (),
        (("it_grades = [8, 14]\n", ""),),
        (('"medium"', '"fine", "coarse"'), ('"ls"', '"ls", "ls+rbf"')),
    ):
        config = load_study(study_file(*changes))
        path = tmp_path / "again.toml"
        path.write_text(config.toml(), encoding="utf-8")
        again = load_study(path)
        assert again == config and again.sha256() == config.sha256()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("seed = 3", "seed = 4"),
        ("arms = 12", "arms = 13"),
        ("chunk = 5", "chunk = 6"),
        ("fruit = 8", "fruit = 9"),
        ("[0.0, 0.5]", "[0.0, 0.4]"),
        ("radius_mm = 1.0", "radius_mm = 1.1"),
        ("share = 0.75", "share = 0.5"),
        ('"medium"', '"fine"'),
        ("[8, 14]", "[8, 13]"),
        ('["raw", "ls"]', '["ls"]'),
        ("[12, 20]", "[12, 21]"),
        ("0.015", "0.016"),
        ('"qiao2026"', '"orchard"'),
    ],
)
def test_the_hash_covers_every_entry(study_file, old, new):
    assert load_study(study_file()).sha256() != load_study(study_file((old, new))).sha256()


@pytest.mark.parametrize(("folder", "name", "old", "new"), [
    (PLANTS, "qiao2026", "flexural_rigidity_N_m2 = 1.2e4", "flexural_rigidity_N_m2 = 1.3e4"),
    (TOLERANCES, "medium", "half_width_deg = 0.03", "half_width_deg = 0.04"),
])  # fmt: skip
def test_the_hash_covers_the_numbers_of_plant_and_tolerance_class(study_file, tmp_path, folder, name, old, new):
    file = Path(shutil.copy(folder / f"{name}.toml", tmp_path / "own.toml"))
    config = load_study(study_file((f'"{name}"', f'"{file}"')))
    before = config.sha256()
    assert old in file.read_text(encoding="utf-8")
    file.write_text(file.read_text(encoding="utf-8").replace(old, new), encoding="utf-8")
    assert load_study(tmp_path / "study.toml").sha256() != before


MISTAKES = {
    "no plant": ('plant = "qiao2026"', "", ["plant", "preset"]),
    "unknown plant": ('"qiao2026"', '"qiao"', ["unknown plant 'qiao'", "orchard"]),
    "no arms": ("arms = 12", "arms = 0", ["arms", "from 1 to"]),
    "half an arm": ("arms = 12", "arms = 1.5", ["arms", "whole number"]),
    "misspelt": ("chunk = 5", "chunks = 5", ["'chunks'", "chunk"]),
    "negative seed": ("seed = 3", "seed = -1", ["seed"]),
    "negative payload": ("[0.0, 0.5]", "[-0.5]", ["payload_kg", "from 0 to 300 kg"]),
    "payload for a plant without masses": ('"qiao2026"', '"geometry_only"', ["no [load]", "payload_kg"]),
    "no radius": ("radius_mm = 1.0", "", ["radius_mm", "[specification]"]),
    "share in percent": ("share = 0.75", "share = 95", ["share", "at most 1"]),
    "unknown class": ('"medium"', '"middling"', ["unknown tolerance class 'middling'"]),
    "no class": ('["medium"]', "[]", ["classes", "list"]),
    "grade out of range": ("[8, 14]", "[8, 18]", ["it_grades", "5 to 17"]),
    "grade twice": ("[8, 14]", "[8, 8]", ["it_grades", "once"]),
    "unknown method": ('"raw", "ls"', '"raw", "kalman"', ["methods", "ls+bpnn"]),
    "no poses": ("[12, 20]", "[0]", ["poses", "from 1 to"]),
    "noise without attitude": (", attitude_deg = 0.012", "", ["attitude_deg", "noise"]),
    "negative noise": ("0.015", "-0.015", ["position_mm", "noise"]),
    "noise as a number": ("[{ position_mm = 0.015, attitude_deg = 0.012 }]", "0.015", ["noise", "list of tables"]),
}


@pytest.mark.parametrize(("old", "new", "named"), MISTAKES.values(), ids=MISTAKES)
def test_a_mistake_is_named(study_file, old, new, named):
    with pytest.raises(InputError) as caught:
        load_study(study_file((old, new)))
    for word in named:
        assert word in str(caught.value)
    assert str(caught.value).count("\n") == 0


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.toml does not exist"):
        load_study(tmp_path / "nowhere.toml")


@pytest.mark.parametrize(
    ("old", "new", "named"),
    [
        ("stiffness = [1.4e4", "stiffness = [-1.4e4", "stiffness"),
        ("flexural_rigidity_N_m2 = 1.2e4", "flexural_rigidity_N_m2 = 0", "flexural_rigidity_N_m2"),
    ],
)
def test_an_impossible_arm_is_refused(study_file, tmp_path, old, new, named):
    text = (PLANTS / "qiao2026.toml").read_text(encoding="utf-8")
    assert old in text
    plant = tmp_path / "impossible.toml"
    plant.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=rf"impossible\.toml.*{named}"):
        load_study(study_file(('"qiao2026"', f'"{plant}"')))


def test_reversed_joint_limits_are_refused(study_file, tmp_path):
    from pickenv.arm import ARMS

    arm, plant = tmp_path / "arm.toml", tmp_path / "plant.toml"
    text = (ARMS / "qiao2026.toml").read_text(encoding="utf-8")
    arm.write_text(text.replace("lower_deg = -30.0", "lower_deg = 60.0"), encoding="utf-8")
    plant.write_text(
        (PLANTS / "qiao2026.toml").read_text(encoding="utf-8").replace('arm = "qiao2026"', f'arm = "{arm}"'),
        encoding="utf-8",
    )
    with pytest.raises(InputError, match="joint 1 has a lower limit"):
        load_study(study_file(('"qiao2026"', f'"{plant}"')))
