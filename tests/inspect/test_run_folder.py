"""A run folder gives back what was put in, to the bit, and refuses what is not whole with one sentence."""

import json
import zipfile
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from calibration import fit, random_joints, simulated_tracker
from pickenv.arm import load_plant
from pickenv.arm.plant_file import shipped_plants
from pickenv.errors import InputError
from pickenv.inspect import saved
from pickenv.inspect.calibration_trace import CalibrationTrace, trace_of
from pickenv.inspect.comparison import Comparison
from pickenv.inspect.run_folder import (
    MADE_BY,
    load_comparison,
    load_trace,
    read_run,
    recorded_run,
    save_comparison,
    save_trace,
)


def assert_same(one, other):
    """Equal to the bit, type by type."""
    assert type(one) is type(other)
    if is_dataclass(one):
        for field in fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, tuple):
        assert len(one) == len(other)
        for a, b in zip(one, other, strict=True):
            assert_same(a, b)
    elif isinstance(one, dict):
        assert list(one) == list(other)
        for key in one:
            assert_same(one[key], other[key])
    elif isinstance(one, np.ndarray):
        assert (one.dtype, one.shape) == (other.dtype, other.shape)
        np.testing.assert_array_equal(one, other)
    else:
        assert one == other


@pytest.fixture(scope="module")
def trace() -> CalibrationTrace:
    plant, rng = load_plant("qiao2026"), np.random.default_rng(0)
    sets = {
        name: simulated_tracker(plant, random_joints(plant.arm.nominal, n, rng), rng)
        for name, n in {"identification": 40, "test": 12}.items()
    }
    errors = {"raw": rng.normal(size=(12, 6)), "LS": rng.normal(size=(12, 6))}
    return trace_of(fit(plant.arm, sets["identification"], known_frames=True), sets, errors)


@pytest.fixture
def folder(tmp_path: Path, comparison: Comparison) -> Path:
    with recorded_run(tmp_path / "run", "demo", "pickenv demo --seed 7", 7) as run:
        save_comparison(run.folder, comparison)
    return run.folder


def test_a_comparison_comes_back_to_the_bit_with_its_plant(folder: Path, comparison: Comparison) -> None:
    loaded = load_comparison(folder)
    assert_same(loaded, comparison)
    joints = random_joints(comparison.nominal, 5, np.random.default_rng(1))
    np.testing.assert_array_equal(loaded.plant.tool_pose(joints).position, comparison.plant.tool_pose(joints).position)


@pytest.mark.parametrize("name", shipped_plants())
def test_a_plant_with_any_effect_comes_back(name: str, comparison: Comparison, tmp_path: Path) -> None:
    once = replace(comparison, plant=load_plant(name))
    save_comparison(tmp_path, once)
    assert_same(load_comparison(tmp_path), once)


def test_a_trace_comes_back_to_the_bit(tmp_path: Path, trace: CalibrationTrace) -> None:
    with recorded_run(tmp_path, "calibration", "pickenv calibrate", 0) as run:
        save_trace(tmp_path, trace, 0)
    assert_same(load_trace(run), trace)
    assert trace.extension.shape == (12,)
    assert trace.position_rms[0] > trace.position_rms[-1] > 0


def test_equal_runs_give_equal_bytes(tmp_path: Path, comparison: Comparison) -> None:
    first, again = (save_comparison(tmp_path / name, comparison) for name in ("a", "b"))
    assert first.read_bytes() == again.read_bytes()
    other = save_comparison(tmp_path / "c", replace(comparison, seed=8))
    assert first.read_bytes() != other.read_bytes()


def test_seed_and_versions_stand_in_the_file_and_nothing_is_pickled(folder: Path) -> None:
    with np.load(folder / "comparison.npz", allow_pickle=False) as archive:
        header = json.loads(str(archive["header"]))
        assert all(archive[name].dtype != object for name in archive.files)
    assert header["seed"] == 7
    assert set(header["versions"]) == {"pickenv", "numpy", "python"}


def test_a_run_says_what_it_is_and_how_it_was_made(folder: Path) -> None:
    run = read_run(folder)
    assert (run.kind, run.command, run.seed) == ("demo", "pickenv demo --seed 7", 7)
    assert run.made_by == f"pickenv demo --out {folder}"


def test_an_interrupted_run_is_no_run(folder: Path) -> None:
    with pytest.raises(KeyboardInterrupt), recorded_run(folder, "demo", "pickenv demo", 0):
        raise KeyboardInterrupt
    with pytest.raises(InputError, match=r"holds no run\.json, so it holds no complete run; .*`pickenv demo"):
        read_run(folder)


def test_a_study_is_known_by_its_configuration(tmp_path: Path) -> None:
    (tmp_path / "study.toml").write_text("")
    assert read_run(tmp_path).kind == "study"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda path: path.unlink(), "does not exist; `pickenv demo --out"),
        (lambda path: path.write_bytes(path.read_bytes()[:-400]), "is damaged or of another version"),
        (lambda path: path.write_bytes(b""), "is damaged or of another version"),
        (lambda path: path.write_text("no archive"), "is damaged or of another version"),
        (lambda path: with_header(path, format=99), "has format 99, this program reads up to 1; update pickenv"),
        (lambda path: with_header(path, kind="CalibrationTrace"), "holds a CalibrationTrace, not a Comparison"),
        (lambda path: with_header(path, content={"class": "Path", "fields": {}}), "is damaged or of another version"),
        (lambda path: with_header(path, content={"class": "Pose", "fields": {"x": 1}}), "is damaged or of another"),
    ],
)
def test_a_file_that_is_not_whole_is_refused_by_name(folder: Path, change, words: str) -> None:
    change(folder / "comparison.npz")
    with pytest.raises(InputError, match=words) as caught:
        load_comparison(folder)
    assert "comparison.npz" in str(caught.value)
    assert "\n" not in str(caught.value)


def with_header(path: Path, **changes: object) -> None:
    with np.load(path) as archive:
        arrays = dict(archive)
    header = json.loads(str(arrays.pop("header"))) | changes
    np.savez(path, header=np.array(json.dumps(header)), **arrays)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", r"run\.json is damaged"),
        ("[]", r"run\.json is damaged"),
        ('{"format": 1, "kind": "demo", "command": "", "seed": "x", "versions": {}}', r"run\.json is damaged"),
        ('{"format": 9, "kind": "demo", "command": "", "seed": 0, "versions": {}}', "of a newer pickenv .format 9"),
        ('{"format": 1, "kind": "moon", "command": "", "seed": 0, "versions": {}}', "kind 'moon'.; update pickenv"),
    ],
)
def test_a_record_that_cannot_be_read_is_refused(folder: Path, text: str, words: str) -> None:
    (folder / "run.json").write_text(text)
    with pytest.raises(InputError, match=words):
        read_run(folder)


def test_a_path_that_is_no_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere is no folder; make a run folder with one of"):
        read_run(tmp_path / "nowhere")
    assert all(command.split()[-1] == "RUN" for command in MADE_BY.values())


def test_what_holds_code_cannot_be_saved(tmp_path: Path, comparison: Comparison) -> None:
    with pytest.raises(TypeError, match="function cannot be saved"):
        saved.save(tmp_path / "x.npz", replace(comparison, plant=replace(comparison.plant, place=lambda x: x)))
    assert list(tmp_path.iterdir()) == []


def test_the_archive_is_a_plain_zip_of_arrays(folder: Path) -> None:
    with zipfile.ZipFile(folder / "comparison.npz") as archive:
        assert all(name.endswith(".npy") for name in archive.namelist())
