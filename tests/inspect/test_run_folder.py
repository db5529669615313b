"""A run folder gives back what was put in, to the bit, and refuses what is not whole with one sentence."""

import json
import zipfile
from dataclasses import fields, is_dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import load_plant, shipped_plants
from pickenv.base import InputError, read_container, registry, write_container, write_text
from pickenv.calibration import fit, random_joints, simulated_tracker
from pickenv.inspect import (
    CalibrationTrace,
    Comparison,
    Run,
    load_part,
    page_of,
    read_run,
    recorded_run,
    run_kind,
    save_part,
    trace_of,
)
from pickenv.inspect.runs import run_folder
from pickenv.inspect.runs.run_folder import added_to, faults_of, load_numbers, load_result, save_numbers


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
        save_part(run.folder, comparison, comparison.seed)
    return run.folder


def test_a_comparison_comes_back_to_the_bit_with_its_plant(folder: Path, comparison: Comparison) -> None:
    loaded = load_part(read_run(folder), Comparison)
    assert_same(loaded, comparison)
    joints = random_joints(comparison.nominal, 5, np.random.default_rng(1))
    np.testing.assert_array_equal(loaded.plant.tool_pose(joints).position, comparison.plant.tool_pose(joints).position)


@pytest.mark.parametrize("name", shipped_plants())
def test_a_plant_with_any_effect_comes_back(name: str, comparison: Comparison, tmp_path: Path) -> None:
    once = replace(comparison, plant=load_plant(name))
    save_part(tmp_path, once, once.seed)
    assert_same(load_part(Run(tmp_path, "demo", "", 7, {}), Comparison), once)


def test_a_trace_comes_back_to_the_bit(tmp_path: Path, trace: CalibrationTrace) -> None:
    with recorded_run(tmp_path, "calibration", "pickenv calibrate", 0) as run:
        save_part(tmp_path, trace, 0)
    assert_same(load_part(run, CalibrationTrace), trace)
    assert trace.extension.shape == (12,)
    assert trace.position_rms[0] > trace.position_rms[-1] > 0


def test_equal_runs_give_equal_bytes(tmp_path: Path, comparison: Comparison) -> None:
    first, again = (save_part(tmp_path / name, comparison, comparison.seed) for name in ("a", "b"))
    assert first.read_bytes() == again.read_bytes()
    other = save_part(tmp_path / "c", replace(comparison, seed=8), 8)
    assert first.read_bytes() != other.read_bytes()


def test_seed_and_versions_stand_in_the_file_and_nothing_is_pickled(folder: Path) -> None:
    found = read_container(folder / "comparison.npz", "Comparison", remake="")
    assert found.header["seed"] == 7
    assert set(found.made_with) == {"pickenv", "numpy", "python", "code"}
    with np.load(folder / "comparison.npz", allow_pickle=False) as archive:
        assert all(archive[name].dtype != object for name in archive.files if name.startswith("array"))


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
        (lambda path: path.write_bytes(path.read_bytes()[:-400]), "is not a Comparison file or is damaged"),
        (lambda path: path.write_bytes(b""), "is not a Comparison file or is damaged"),
        (lambda path: path.write_text("no archive"), "is not a Comparison file or is damaged"),
        (lambda path: rewritten(path, version=99), "has format 99, this program reads up to 4; update pickenv"),
        (
            lambda path: rewritten(path, version=1),
            "has the earlier format 1, this program reads 4; `pickenv demo --out",
        ),
        (lambda path: rewritten(path, kind="CalibrationTrace"), "holds a CalibrationTrace, not a Comparison"),
        (
            lambda path: rewritten(path, content={"class": "Path", "fields": {}}),
            "is not a Comparison file or is damaged",
        ),
        (lambda path: rewritten(path, content={"class": "Pose", "fields": {"x": 1}}), "is not a Comparison file"),
    ],
)
def test_a_file_that_is_not_whole_is_refused_by_name(folder: Path, change, words: str) -> None:
    change(folder / "comparison.npz")
    with pytest.raises(InputError, match=words) as caught:
        load_part(Run(folder, "demo", "", 7, {}), Comparison)
    assert "comparison.npz" in str(caught.value)
    assert "\n" not in str(caught.value)


def rewritten(
    path: Path, kind: str = "Comparison", version: int = run_folder.DATA_FORMATS["Comparison"], **header: object
) -> None:
    """The file under a seal that holds, with another kind, version or header."""
    found = read_container(path, None, remake="")
    write_container(path, kind, {**found.header, **header}, found.arrays, version=version)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", r"run\.json is not a run's record or is damaged"),
        ("[]", r"run\.json is not a run's record or is damaged"),
        ("[" * 100_000, r"run\.json is not a run's record or is damaged"),
        ('{"format": Infinity}', r"run\.json is not a run's record or is damaged"),
        ("9" * 5000, r"run\.json is not a run's record or is damaged"),
        ('{"format": 2, "kind": "demo", "command": "", "seed": "x", "versions": {}}', "a run's record or is damaged"),
        (
            '{"format": 1, "kind": "demo", "command": "", "seed": 0, "versions": {}}',
            "by an earlier version, without hashes",
        ),
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
    assert all(run_kind(name).made_by.split()[-1] == "RUN" for name in registry.names("report"))


def test_what_holds_code_cannot_be_saved(tmp_path: Path, comparison: Comparison) -> None:
    with pytest.raises(TypeError, match="function cannot be saved"):
        run_folder.save_numbers(
            tmp_path / "x.npz", replace(comparison, plant=replace(comparison.plant, ready=lambda x: x))
        )
    assert list(tmp_path.iterdir()) == []


def test_the_archive_is_a_plain_zip_of_arrays(folder: Path) -> None:
    with zipfile.ZipFile(folder / "comparison.npz") as archive:
        assert all(name.endswith(".npy") for name in archive.namelist() if name != "header.json")


def faults(folder: Path) -> dict[str, str]:
    return {path.name: reason for path, reason in faults_of(read_run(folder)) if reason is not None}


def test_a_run_lists_what_it_wrote_and_names_what_changed_since(folder: Path) -> None:
    assert faults(folder) == {}
    (folder / "notes.txt").write_text("mine")
    assert faults(folder) == {"notes.txt": "is stray: this run did not write it"}
    (folder / "notes.txt").unlink()
    (folder / "comparison.npz").write_bytes(b"another")
    assert faults(folder) == {"comparison.npz": "was edited since the run wrote it"}
    (folder / "comparison.npz").unlink()
    assert faults(folder) == {"comparison.npz": "is missing; the run wrote it"}


def test_what_an_earlier_run_left_in_the_folder_is_not_of_this_run(folder: Path, comparison: Comparison) -> None:
    (folder / "figures").mkdir()
    (folder / "figures" / "old.svg").write_text("<svg/>")
    with recorded_run(folder, "demo", "pickenv demo --seed 7", 7):
        save_part(folder, comparison, comparison.seed)
    assert faults(folder) == {"old.svg": "is stray: this run did not write it"}


def test_figures_that_are_drawn_later_join_the_list(folder: Path) -> None:
    before = read_run(folder)
    with added_to(before):
        (folder / "figures").mkdir()
        (folder / "figures" / "new.svg").write_text("<svg/>")
    assert faults(folder) == {}
    assert set(read_run(folder).files) == {"comparison.npz", "figures/new.svg"}
    assert before.files == {"comparison.npz": read_run(folder).files["comparison.npz"]}


def test_no_byte_of_a_record_can_change(folder: Path) -> None:
    whole = (folder / "run.json").read_bytes()
    assert read_run(folder).files.keys() == {"comparison.npz"}
    for place in range(len(whole)):
        (folder / "run.json").write_bytes(whole[:place] + bytes([whole[place] ^ 1 << place % 8]) + whole[place + 1 :])
        with pytest.raises(InputError, match=r"run\.json"):
            read_run(folder)


def test_a_result_from_another_run_is_refused(tmp_path: Path) -> None:
    for name, count in (("a", 30), ("b", 3)):
        with recorded_run(tmp_path / name, "iso9283", "pickenv iso9283", 0) as run:
            result = {"raw": {"poses": count}, "settings": {}, "plant": "", "standard": ""}
            write_text(run.folder / "iso9283.json", json.dumps(result))
    assert load_result(read_run(tmp_path / "a"), "iso9283.json")["raw"]["poses"] == 30
    (tmp_path / "a" / "iso9283.json").write_bytes((tmp_path / "b" / "iso9283.json").read_bytes())
    with pytest.raises(
        InputError, match=r"iso9283\.json is not what the run wrote, it was edited or exchanged; `pickenv"
    ):
        load_result(read_run(tmp_path / "a"), "iso9283.json")


def test_a_comparison_from_another_run_is_refused(folder: Path, comparison: Comparison) -> None:
    save_part(folder, replace(comparison, seed=8), 8)
    with pytest.raises(InputError, match=r"comparison\.npz is not what the run wrote, it was edited or exchanged"):
        load_part(read_run(folder), Comparison)


def flipped(whole: bytes, rng: np.random.Generator) -> bytes:
    content = bytearray(whole)
    content[rng.integers(len(content))] ^= 1 << rng.integers(8)
    return bytes(content)


@pytest.mark.parametrize("count", [20, pytest.param(500, marks=pytest.mark.slow)])
def test_one_flipped_bit_anywhere_in_a_trace_is_refused(tmp_path: Path, trace: CalibrationTrace, count: int) -> None:
    path = save_part(tmp_path, trace, 0)
    whole, run = path.read_bytes(), Run(tmp_path, "calibration", "", 0, {})
    for number in range(count):
        path.write_bytes(flipped(whole, np.random.default_rng([3, number])))
        with pytest.raises(InputError, match=r"calibration_trace\.npz"):
            load_part(run, CalibrationTrace)


def test_a_page_that_was_written_with_its_run_is_shown_as_it_was_written(tmp_path):
    """A calibration's page holds more than the folder keeps; without one, or edited, it is refused."""
    with recorded_run(tmp_path / "run", "calibration", "pickenv calibrate rows.csv", 3) as run:
        write_text(run.folder / "report.html", "<p>0.12 mm</p>")
    assert page_of(read_run(tmp_path / "run")) == "<p>0.12 mm</p>"
    (tmp_path / "run/report.html").write_text("<p>0.02 mm</p>", encoding="utf-8")
    with pytest.raises(InputError, match=r"was edited or exchanged; `pickenv calibrate .* makes it anew"):
        page_of(read_run(tmp_path / "run"))
    with recorded_run(tmp_path / "bare", "calibration", "pickenv calibrate rows.csv", 3):
        pass
    with pytest.raises(InputError, match=r"report\.html does not exist: measurements of this kind have no report page"):
        page_of(read_run(tmp_path / "bare"))


def test_many_episodes_are_read_back(comparison: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = save_numbers(tmp_path / "many.npz", comparison)
    monkeypatch.setattr(read_container, "__kwdefaults__", read_container.__kwdefaults__ | {"limit": 1000})
    assert load_numbers(path, Comparison, "x").seed == comparison.seed
