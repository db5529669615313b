"""A calibration is one file: whole or absent, bit for bit, of one arm, and free of code."""

import io
import json
import pickle
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from calibration import BpnnSettings, Calibration, Measurements, fit
from calibration.calibration import FORMAT, geometry_arrays
from pickenv.arm import forward, load_arm
from pickenv.errors import InputError


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
    with pytest.raises(InputError, match="another geometry"):
        Calibration.load(path, longer)


def rewritten(path, **changes):
    """The file with some of its arrays replaced, or left out where None."""
    with np.load(path) as archive:
        arrays = {key: archive[key] for key in archive.files}
    arrays |= changes
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    return path


def header_of(path):
    with np.load(path) as archive:
        return json.loads(str(archive["header"]))


def test_a_newer_format_is_refused(path):
    header = header_of(path) | {"format": FORMAT + 1}
    rewritten(path, header=np.array(json.dumps(header)))
    with pytest.raises(
        InputError, match=rf"has format {FORMAT + 1}, this program reads up to {FORMAT}; update pickenv"
    ):
        Calibration.load(path)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.5, 0.99])
def test_a_truncated_file_is_refused(path, share):
    content = path.read_bytes()
    path.write_bytes(content[: int(share * len(content))])
    with pytest.raises(InputError, match=r"calibration\.npz is not a calibration file or is damaged"):
        Calibration.load(path)


def test_a_flipped_bit_is_refused(path):
    content = bytearray(path.read_bytes())
    content[content.index(b"NUMPY", 200) + 400] ^= 1
    path.write_bytes(content)
    with pytest.raises(InputError, match="damaged"):
        Calibration.load(path)


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
        lambda path: np.savez(path, numbers=np.zeros(3)),
        lambda path: np.savez(path, header=np.array("[]")),
        lambda path: np.savez(path, header=np.array("{")),
        lambda path: np.savez(path, header=np.array('{"format": 1}')),
        lambda path: np.savez(path, header=np.array([{"format": 1}], dtype=object)),
        lambda path: rewritten(path, **{"learnt/model_input_mean": None}),
        lambda path: rewritten(path, **{"identified/alpha": None}),
    ],
    ids=["text", "noise", "pickle", "npy", "no header", "list", "half json", "bare", "object", "network", "geometry"],
)
def test_garbage_is_refused(path, write):
    write(path)
    with pytest.raises(InputError, match=r"calibration\.npz is not a calibration file or is damaged") as caught:
        Calibration.load(path)
    assert "\n" not in str(caught.value)


class Trap:
    """Pickles to code that runs when it is read."""

    def __reduce__(self):
        return (exec, ("raise SystemExit('code was executed')",))


def test_code_in_a_file_is_not_executed(path):
    rewritten(path, **{"network/trap": np.array([Trap()], dtype=object)})
    with pytest.raises(InputError, match="damaged"):
        Calibration.load(path)


def test_the_file_holds_plain_numbers_only(path):
    with zipfile.ZipFile(path) as archive:
        assert archive.namelist() and all(name.endswith(".npy") for name in archive.namelist())
        for name in archive.namelist():
            with archive.open(name) as file:
                np.lib.format.read_magic(file)
                assert not np.lib.format.read_array_header_1_0(file)[2].hasobject


def test_a_missing_file_says_how_to_make_one(tmp_path):
    with pytest.raises(InputError, match=r"nothing\.npz does not exist; run `pickenv"):
        Calibration.load(tmp_path / "nothing")


@pytest.mark.parametrize("interruption", [KeyboardInterrupt, OSError(28, "No space left on device")])
def test_an_interruption_leaves_the_old_file_or_nothing(learnt, tmp_path, monkeypatch, interruption):
    def half(file, **arrays):
        file.write(b"PK\x03\x04 half an archive")
        raise interruption

    for old in (None, learnt.without_residual().save(tmp_path / "calibration").read_bytes()):
        for leftover in tmp_path.iterdir() if old is None else ():
            leftover.unlink()
        if old is not None:
            (tmp_path / "calibration.npz").write_bytes(old)
        with monkeypatch.context() as patch:
            patch.setattr(np, "savez", half)
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
