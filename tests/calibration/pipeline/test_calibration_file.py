"""A calibration is one file: whole or absent, bit for bit, of one arm, and free of code."""

import io
import json
import pickle
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import forward, load_arm
from pickenv.arm.files.arm import geometry_arrays
from pickenv.base import InputError, read_container, seal, write_container
from pickenv.calibration import BpnnSettings, Calibration, Measurements, fit
from pickenv.calibration.pipeline.calibration import FORMAT


@pytest.fixture(scope="module")
def learnt(request) -> Calibration:
    """With a network; its numbers need not be good."""
    plant, exact = request.getfixturevalue("table_1"), request.getfixturevalue("exact")
    data = exact(plant.geometry, 60)
    settings = BpnnSettings(hidden=(16, 8), epochs=2)
    return fit(plant.arm, data, data, known_frames=True, rng=np.random.default_rng(0), settings=settings).calibration


@pytest.fixture
def path(learnt, tmp_path):
    return learnt.save(tmp_path / "calibration")


def identical(one: dict, other: dict) -> bool:
    return one.keys() == other.keys() and all(np.array_equal(one[k], other[k]) for k in one)


def test_a_trip_through_a_file_is_exact_to_the_bit(learnt, path, qiao):
    back = Calibration.load(path, qiao)
    assert path.name == "calibration.npz"
    for key in ("nominal", "identified"):
        assert identical(geometry_arrays(getattr(back, key)), geometry_arrays(getattr(learnt, key)))
        assert getattr(back, key).joint_names == getattr(learnt, key).joint_names
        assert getattr(back, key).prismatic == getattr(learnt, key).prismatic
    assert identical(back.learnt.arrays(), learnt.learnt.arrays())
    assert (back.arm_name, back.arm_fingerprint) == (learnt.arm_name, learnt.arm_fingerprint)
    assert back.record == json.loads(json.dumps(learnt.record))
    joints = np.random.default_rng(0).uniform(qiao.nominal.lower, qiao.nominal.upper, (50, 6))
    assert np.array_equal(back.compensate(joints), learnt.compensate(joints))
    assert np.array_equal(back.predict(joints).position, learnt.predict(joints).position)


def test_a_calibration_without_network_stays_without(learnt, tmp_path, qiao):
    back = Calibration.load(learnt.without_residual().save(tmp_path / "ls.npz"), qiao)
    assert back.learnt is None
    assert np.array_equal(back.compensate(np.zeros(6)), learnt.compensator(with_residual=False)(np.zeros(6)))
    assert not np.array_equal(back.compensate(np.zeros(6)), learnt.compensate(np.zeros(6)))


def test_the_suffix_is_added_once_and_dots_in_names_survive(learnt, tmp_path):
    assert learnt.save(tmp_path / "2026.11.run").name == "2026.11.run.npz"
    assert Calibration.load(tmp_path / "2026.11.run").arm_name == "qiao2026"
    assert Calibration.load(tmp_path / "2026.11.run.npz").arm_name == "qiao2026"


def test_another_arm_is_refused(path, qiao):
    with pytest.raises(
        InputError, match=r"calibration\.npz belongs to arm 'qiao2026' with another geometry than 'ur5'"
    ):
        Calibration.load(path, load_arm("ur5"))
    longer = replace(qiao, nominal=replace(qiao.nominal, a=qiao.nominal.a + 1e-6 * np.eye(6)[1]))
    with pytest.raises(InputError, match="than 'qiao2026'; give the file that it was made with"):
        Calibration.load(path, longer)  # of the same name, as a maker's file of a shipped arm


def rewritten(path, header=None, version=FORMAT, **changes):
    """The file under a seal that holds, with some of its header and arrays replaced, or left out where None."""
    found = read_container(path, "calibration", remake="fit it again")
    arrays = {**found.arrays, **changes}
    kept = {key: value for key, value in arrays.items() if value is not None}
    return write_container(path, "calibration", {**found.header, **(header or {})}, kept, version=version)


def refused(path, arm=None, unit=None):
    with pytest.raises(InputError) as caught:
        Calibration.load(path, arm, unit)
    assert "\n" not in str(caught.value)
    assert "allow_pickle" not in str(caught.value)
    return str(caught.value)


def test_other_formats_are_refused(path):
    rewritten(path, version=FORMAT + 1)
    assert f"has format {FORMAT + 1}, this program reads up to {FORMAT}; update pickenv" in refused(path)
    rewritten(path, version=1)
    assert f"has the earlier format 1, this program reads {FORMAT}; run `pickenv calibrate`" in refused(path)


def test_a_file_of_the_first_edition_is_to_be_made_anew(path):
    np.savez(path, header=np.array('{"format": 1}'), coefficients=np.zeros(0))
    assert "was written by an earlier version, or by another program, without a seal; run `pickenv" in refused(path)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
def test_a_truncated_file_is_refused(path, share):
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    assert "calibration.npz is not a calibration file or is damaged" in refused(path)


def flip(path, rng):
    content = bytearray(path.read_bytes())
    content[rng.integers(len(content))] ^= 1 << rng.integers(8)
    path.write_bytes(content)


@pytest.mark.parametrize("number", range(20))
def test_one_flipped_bit_anywhere_is_refused(path, number):
    flip(path, np.random.default_rng(number))
    refused(path)


@pytest.mark.slow
def test_one_flipped_bit_anywhere_is_refused_500_times(path):
    whole = path.read_bytes()
    for number in range(500):
        path.write_bytes(whole)
        flip(path, np.random.default_rng([2, number]))
        start = time.process_time()
        refused(path)
        assert time.process_time() - start < 5


def npy_of(array):
    buffer = io.BytesIO()
    np.save(buffer, array)
    return buffer.getvalue()


@pytest.mark.parametrize(
    "write",
    [
        lambda path: path.write_bytes(b"not a zip archive at all"),
        lambda path: path.write_bytes(np.random.default_rng(0).bytes(4096)),
        lambda path: path.write_bytes(pickle.dumps({"header": "{}"})),
        lambda path: path.write_bytes(npy_of(np.zeros(3))),
        lambda path: write_container(path, "calibration", {}, {}, version=FORMAT),
        lambda path: rewritten(path, {"joint_names": None}),
    ],
    ids=["text", "noise", "pickle", "npy", "empty", "no names"],
)
def test_garbage_is_refused(path, write):
    write(path)
    assert "calibration.npz is not a calibration file or is damaged" in refused(path)


def changed(path, name, change):
    """The file with one array changed, under a seal that holds."""
    array = read_container(path, "calibration", remake="").arrays[name].copy()
    return rewritten(path, **{name: change(array)})


def put(value, place=2):
    def change(array):
        array.flat[place] = value
        return array

    return change


MIRROR = np.diag([1.0, 1.0, -1.0])


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        ("arm/a", put(0.5), "its arm's geometry is not the one of fingerprint"),
        ("nominal/a", lambda a: a + 0.1, "its nominal geometry differs from its arm's by more than base and tool"),
        ("nominal/a", put(np.nan), "nominal/a holds nan at place (3,)"),
        ("identified/theta", put(np.inf), "identified/theta holds inf at place (3,)"),
        (
            "identified/theta",
            lambda a: a[:5],
            "identified/theta holds float64 of shape (5,), not numbers of shape (6,)",
        ),
        ("identified/d", lambda a: a + 1j, "identified/d holds complex128"),
        ("identified/d", lambda a: a.astype(str), "identified/d holds <U"),
        ("identified/d", lambda a: a.astype(np.float32), "identified/d holds float32"),
        ("identified/d", lambda a: None, "'d' is missing"),
        ("nominal/base_rotation", lambda r: 2 * r, "nominal/base_rotation is not a rotation"),
        ("nominal/base_rotation", lambda r: r @ MIRROR, "nominal/base_rotation is not a rotation"),
        ("identified/tool_position", put(np.nan), "identified/tool_position holds nan at place (3,)"),
        ("identified/upper", put(-99.0), "the lower limit of joint"),
        ("coefficients", lambda a: np.zeros(1), "terms/coefficients holds float64 of shape (1,)"),
        ("learnt/kind", lambda a: np.array("gp"), "its learnt residual"),
        ("learnt/model_input_mean", lambda a: None, "'input_mean' is missing"),
        ("learnt/mean", put(np.nan), "learnt/mean holds nan at place (3,)"),
        ("learnt/mean", lambda a: a[:5], "is damaged"),
    ],
)
def test_numbers_that_must_not_move_an_arm_are_refused_under_a_seal_that_holds(path, name, change, words):
    changed(path, name, change)
    assert words in refused(path)


def test_a_network_without_its_last_layer_is_refused(path):
    names = [key for key in read_container(path, "calibration", remake="").arrays if key.startswith("learnt/model_")]
    for name in names:
        before = path.read_bytes()
        changed(path, name, lambda a: None)
        refused(path)
        path.write_bytes(before)


@pytest.mark.parametrize(
    ("header", "words"),
    [
        ({"arm_fingerprint": "0" * 16}, "its arm's geometry is not the one of fingerprint 0000"),
        ({"residual": None}, "it holds a learnt residual that its header does not name"),
        ({"residual": "gp"}, "its learnt residual is 'bpnn', but its header names 'gp'"),
        ({"residual": "trees"}, "residual 'trees' comes from the package pickenv "),
        ({"prismatic": [False] * 5}, "6 joint names are given for 5 joints"),
        ({"prismatic": ["no"] * 6}, "joint types are true (slides) or false (turns)"),
        ({"joint_names": list(range(6))}, "joint names are text"),
        ({"terms": [{"kind": "moon"}]}, "'moon' is missing"),
        ({"terms": [{"kind": "compliance", "joints": [17], "load": None}]}, "is damaged"),
        ({"terms": [{"kind": "compliance", "joints": [1], "load": {"masses": [1.0]}}]}, "has link masses of its own"),
        ({"record": None}, "is damaged"),
        ({"record": [1]}, "is damaged"),
        (
            {"record": {"uncertainty": {"parameters": ["a2"], "covariance": [[float("nan")]]}}},
            "record/covariance holds",
        ),
        ({"record": {"uncertainty": {"parameters": ["a2"], "covariance": [1.0]}}}, "record/covariance holds"),
        ({"record": {"uncertainty": {"parameters": ["moon"], "covariance": [[1.0]]}}}, "parameters that its arm does"),
    ],
)
def test_a_header_that_says_otherwise_is_refused_under_a_seal_that_holds(path, header, words):
    rewritten(path, header)
    assert words in refused(path)


def test_a_file_that_loses_its_residual_is_refused(path):
    found = read_container(path, "calibration", remake="")
    rewritten(path, **{key: None for key in found.arrays if key.startswith("learnt/")})
    assert "'kind' is missing" in refused(path)


def test_what_would_be_refused_is_not_saved(learnt, tmp_path):
    broken = replace(learnt, nominal=replace(learnt.nominal, a=learnt.nominal.a * np.nan))
    with pytest.raises(InputError, match=r"nominal/a holds nan"):
        broken.save(tmp_path / "calibration")
    assert list(tmp_path.iterdir()) == []


def test_two_robots_of_one_model_are_told_apart_by_their_serial_numbers(learnt, tmp_path, qiao):
    mine = replace(learnt, record={**learnt.record, "unit": "SN-17"}).save(tmp_path / "mine")
    anyone = learnt.save(tmp_path / "anyone")
    assert Calibration.load(mine, qiao, unit="SN-17").unit == "SN-17"
    assert Calibration.load(mine, qiao).unit == "SN-17"
    assert "mine.npz belongs to unit 'SN-17', but unit 'SN-18' is asked for" in refused(mine, qiao, "SN-18")
    assert "anyone.npz names no unit, but unit 'SN-17' is asked for" in refused(anyone, qiao, "SN-17")


def test_the_arm_is_known_after_its_base_and_tool_were_fitted(table_1, exact, tmp_path):
    data = exact(table_1.geometry, 60)
    fitted = fit(table_1.arm, data, known_frames=False).calibration
    assert not np.array_equal(fitted.nominal.base.position, fitted.arm.base.position)
    back = Calibration.load(fitted.save(tmp_path / "fitted"), table_1.arm)
    assert back.arm_fingerprint == table_1.arm.fingerprint()
    assert identical(geometry_arrays(back.nominal), geometry_arrays(fitted.nominal))


class Trap:
    """Pickles to code that runs when it is read."""

    def __reduce__(self):
        return (exec, ("raise SystemExit('code was executed')",))


def test_code_in_a_file_is_not_executed(path):
    np.savez(path, trap=np.array([Trap()], dtype=object))
    refused(path)
    content = path.read_bytes()
    for end in (b"", b"PK"):
        path.write_bytes(content + end + seal(content + end))
        refused(path)


def test_the_file_is_read_by_numpy_and_holds_plain_numbers_only(path, learnt):
    with np.load(path, allow_pickle=False) as archive:
        assert np.array_equal(archive["identified/alpha"], learnt.identified.alpha)
        assert json.loads(archive["header.json"])["header"]["arm"] == "qiao2026"
        assert {archive[name].dtype.kind for name in archive.files if name != "header.json"} <= set("biufU")


def test_a_missing_file_says_how_to_make_one(tmp_path):
    with pytest.raises(InputError, match=r"nothing\.npz does not exist; run `pickenv"):
        Calibration.load(tmp_path / "nothing")


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_an_interruption_leaves_the_old_file_or_nothing(learnt, tmp_path, monkeypatch, interruption):
    def half(path, content):
        with path.open("wb") as file:
            file.write(b"PK\x03\x04 half an archive")
        raise interruption

    for old in (None, learnt.without_residual().save(tmp_path / "calibration").read_bytes()):
        for leftover in tmp_path.iterdir() if old is None else ():
            leftover.unlink()
        if old is not None:
            (tmp_path / "calibration.npz").write_bytes(old)
        with monkeypatch.context() as patch:
            patch.setattr(Path, "write_bytes", half)
            with pytest.raises((KeyboardInterrupt, InputError)):
                learnt.save(tmp_path / "calibration")
        assert [p.read_bytes() for p in tmp_path.iterdir()] == ([] if old is None else [old])


def test_fitting_twice_gives_the_same_file(learnt, table_1, exact, tmp_path):
    data: Measurements = exact(table_1.geometry, 60)
    settings = BpnnSettings(hidden=(16, 8), epochs=2)
    again = fit(table_1.arm, data, data, known_frames=True, rng=np.random.default_rng(0), settings=settings).calibration
    assert identical(again.learnt.arrays(), learnt.learnt.arrays())
    assert again.record == learnt.record
    other = fit(table_1.arm, data, data, known_frames=True, rng=np.random.default_rng(1), settings=settings).calibration
    assert other.record["residual"]["generator"] != learnt.record["residual"]["generator"]


def test_the_record_reproduces_the_network(learnt, table_1, exact):
    """The generator's state on record trains the same network again."""
    state = json.loads(json.dumps(learnt.record["residual"]["generator"]))
    rng = np.random.Generator(getattr(np.random, state["bit_generator"])(0))
    rng.bit_generator.state = state
    data = exact(table_1.geometry, 60)
    stated = learnt.record["residual"]["settings"]
    settings = BpnnSettings(**{**stated, "hidden": tuple(stated["hidden"])})
    again = fit(table_1.arm, data, data, known_frames=True, rng=rng, settings=settings).calibration
    assert identical(again.learnt.arrays(), learnt.learnt.arrays())


def test_a_residual_learnt_from_positions_turns_nothing(table_1, exact):
    data, settings = exact(table_1.geometry, 60), BpnnSettings(hidden=(16, 8), epochs=2)
    rng = np.random.default_rng(0)
    learnt = fit(table_1.arm, data, data.positions_only(), known_frames=True, rng=rng, settings=settings).calibration
    turned = learnt.predict(data.joints).rotation - learnt.without_residual().predict(data.joints).rotation
    assert np.array_equal(turned, np.zeros_like(turned))


def test_a_residual_needs_a_generator(table_1, exact):
    data = exact(table_1.geometry, 60)
    with pytest.raises(ValueError, match="rng"):
        fit(table_1.arm, data, data, known_frames=True)


def test_prediction_is_the_identified_arm(learnt, qiao):
    joints = np.random.default_rng(1).uniform(qiao.nominal.lower, qiao.nominal.upper, (20, 6))
    predicted = learnt.without_residual().predict(joints)
    np.testing.assert_array_equal(predicted.position, forward(learnt.identified, joints).position)
