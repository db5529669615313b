"""A container gives back what was put in, to the bit, and refuses whatever is not exactly that with one sentence."""

import io
import json
import re
import struct
import time
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra import numpy as hnp

from pickenv.base import (
    InputError,
    check_sealed_parquet,
    code_fingerprint,
    container,
    container as module,
    parquet_is_sealed,
    read_container,
    seal,
    sealed_parquet,
    write_container,
)

ARRAYS = {
    "poses/position": np.random.default_rng(0).normal(size=(40, 3)),
    "weights": np.asfortranarray(np.random.default_rng(1).normal(size=(7, 5))),
    "flags": np.array([True, False]),
    "kind": np.array("bpnn"),
    "none": np.zeros((0, 6)),
    "counts": np.arange(5, dtype=">i2"),
}
KINDS_OF_NUMBERS = st.one_of(
    hnp.floating_dtypes(),
    hnp.integer_dtypes(),
    hnp.boolean_dtypes(),
    hnp.complex_number_dtypes(),
    hnp.unicode_string_dtypes(max_len=4),
)


def read(path: Path, kind: str | None = "robot", **further) -> container.Container:
    return read_container(path, kind, remake="make it anew", **further)


def refused(path: Path, kind: str | None = "robot", **further) -> str:
    """The sentence that refuses the file, within five seconds of computing."""
    start = time.process_time()
    with pytest.raises(InputError) as caught:
        read(path, kind, **further)
    assert time.process_time() - start < 5
    sentence = str(caught.value)
    assert "\n" not in sentence
    assert "pickle" not in sentence
    assert len(sentence) < 500 + len(str(path))
    return sentence


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return write_container(tmp_path / "x.npz", "robot", {"name": "α", "numbers": [1, 0.1]}, ARRAYS, {"raw": b"\0\1"})


def forge(
    path: Path, change: Callable[[dict], None] = lambda header: None, members: Callable[[dict], dict] = dict, **write
) -> None:
    """The file again with another header or other members, under a seal that holds."""
    with zipfile.ZipFile(path) as archive:
        parts = {name: archive.read(name) for name in archive.namelist()}
    header = json.loads(parts[container.HEADER])
    change(header)
    parts[container.HEADER] = json.dumps(header).encode()
    resealed(path, members(parts), **write)


def resealed(
    path: Path,
    parts: dict[str, bytes],
    method: int = zipfile.ZIP_STORED,
    damage: Callable[[bytearray], None] = lambda content: None,
) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", method) as archive:
        for name, content in parts.items():
            archive.writestr(name, content)
        archive.comment = bytes(len(seal()))
    content = bytearray(buffer.getvalue()[: -len(seal())])
    damage(content)
    path.write_bytes(bytes(content) + seal(content))


def test_what_was_put_in_comes_back_to_the_bit(path: Path) -> None:
    found = read(path)
    assert (found.kind, found.version, found.header) == ("robot", 1, {"name": "α", "numbers": [1, 0.1]})
    assert found.blobs == {"raw": b"\0\1"}
    assert list(found.arrays) == list(ARRAYS)
    for name, array in ARRAYS.items():
        back = found.arrays[name]
        assert (back.dtype, back.shape, back.strides) == (array.dtype, array.shape, array.strides)
        assert back.flags.writeable
        np.testing.assert_array_equal(back, array)


@settings(max_examples=60, deadline=None)
@given(
    array=hnp.arrays(KINDS_OF_NUMBERS, hnp.array_shapes(min_dims=0, min_side=0, max_side=4)), compressed=st.booleans()
)
def test_any_array_comes_back_and_numpy_reads_it_too(tmp_path_factory, array, compressed) -> None:
    path = tmp_path_factory.mktemp("any") / "x.npz"
    write_container(path, "robot", {}, {"x": array, "turned": array.T}, compressed=compressed)
    with np.load(path, allow_pickle=False) as archive:
        for name, value in (("x", array), ("turned", array.T)):
            back = read(path).arrays[name]
            assert (back.dtype, back.shape) == (value.dtype, value.shape)
            assert back.tobytes() == value.tobytes() == archive[name].tobytes()


def test_equal_content_gives_equal_bytes_and_other_content_others(path: Path, tmp_path: Path) -> None:
    header = {"name": "α", "numbers": [1, 0.1]}
    assert (
        write_container(tmp_path / "y.npz", "robot", header, ARRAYS, {"raw": b"\0\1"}).read_bytes() == path.read_bytes()
    )
    assert (
        write_container(tmp_path / "z.npz", "robot", header, ARRAYS, {"raw": b"\0\2"}).read_bytes() != path.read_bytes()
    )


def test_the_file_names_what_made_it(path: Path) -> None:
    assert set(read(path).made_with) == {"pickenv", "numpy", "python", "code"}
    assert read(path).made_with["code"] == code_fingerprint()


@pytest.mark.parametrize("number", range(40))
def test_one_flipped_bit_anywhere_is_refused(path: Path, number: int) -> None:
    flip(path, np.random.default_rng(number))
    refused(path)


@pytest.mark.slow
def test_one_flipped_bit_anywhere_is_refused_500_times(path: Path) -> None:
    whole = path.read_bytes()
    for number in range(500):
        path.write_bytes(whole)
        flip(path, np.random.default_rng([1, number]))
        refused(path)


def flip(path: Path, rng: np.random.Generator) -> None:
    content = bytearray(path.read_bytes())
    content[rng.integers(len(content))] ^= 1 << rng.integers(8)
    path.write_bytes(content)


def test_every_bit_of_the_last_kilobyte_is_sealed(path: Path) -> None:
    """Where the zip's directory, its end and the seal itself stand."""
    whole = path.read_bytes()
    for place in range(len(whole) - 1000, len(whole)):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << place % 8]) + whole[place + 1 :])
        refused(path)


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.9, 0.999])
def test_a_file_cut_short_or_with_more_behind_it_is_refused(path: Path, share: float) -> None:
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    refused(path)
    path.write_bytes(whole + b"\0")
    refused(path)


def bits(content: bytearray, signature: bytes, offset: int, value: int) -> None:
    """Write a 16-bit number into every record of a zip archive that begins with ``signature``."""
    place = content.find(signature)
    while place >= 0:
        struct.pack_into("<H", content, place + offset, value)
        place = content.find(signature, place + 4)


def encrypted(content: bytearray) -> None:
    bits(content, b"PK\x01\x02", 8, 1)
    bits(content, b"PK\x03\x04", 6, 1)


def compression_99(content: bytearray) -> None:
    bits(content, b"PK\x01\x02", 10, 99)
    bits(content, b"PK\x03\x04", 8, 99)


def described(**changes) -> Callable[[dict], None]:
    return lambda header: header["arrays"]["flags"].update(changes)


OBJECTS = io.BytesIO()
np.save(OBJECTS, np.array([{"a": 1}], dtype=object), allow_pickle=True)


@pytest.mark.parametrize(
    ("forgery", "words"),
    [
        (lambda p: forge(p, members=lambda m: m | {"more": b""}), "members are not those"),
        (lambda p: forge(p, members=lambda m: {k: v for k, v in m.items() if k != "raw"}), "members are not those"),
        (lambda p: forge(p, members=lambda m: {k.replace("flags", "fl"): v for k, v in m.items()}), "members are not"),
        (lambda p: forge(p, members=lambda m: dict(reversed(m.items()))), "its header is missing"),
        (lambda p: forge(p, members=lambda m: m | {"raw": b"\0\2"}), "'raw' has changed"),
        (lambda p: forge(p, members=lambda m: m | {"raw": b"\0\2\3"}), "other sizes"),
        (lambda p: forge(p, members=lambda m: m | {"flags.npy": m["flags.npy"][:-1] + b"\1"}), "'flags' has changed"),
        (lambda p: forge(p, members=lambda m: m | {"flags.npy": OBJECTS.getvalue()}), "other sizes"),
        (lambda p: forge(p, described(dtype="|O")), "is not one of numbers or text"),
        (lambda p: forge(p, described(dtype="|O8")), "is not one of numbers or text"),
        (lambda p: forge(p, described(dtype="|u1")), "of another type or shape"),
        (lambda p: forge(p, described(dtype="<f99")), "is not a robot file or is damaged"),
        (lambda p: forge(p, described(shape=[2**62, 2**62])), "other sizes"),
        (lambda p: forge(p, described(shape=[10**4000] * 30)), "is damaged"),
        (lambda p: forge(p, described(shape=[1] * 100000)), "is not one of numbers or text"),
        (lambda p: forge(p, described(shape=[-2])), "is not one of numbers or text"),
        (lambda p: forge(p, described(shape=[2.0])), "is not one of numbers or text"),
        (lambda p: forge(p, described(shape=[1, 2])), "other|of another type or shape"),
        (lambda p: forge(p, described(fortran=True)), "of another type or shape"),
        (lambda p: forge(p, described(sha256="0")), "'flags' has changed"),
        (lambda p: forge(p, lambda h: h["arrays"].pop("flags")), "members are not those"),
        (lambda p: forge(p, lambda h: h.pop("arrays")), "'arrays' is missing"),
        (lambda p: forge(p, lambda h: h.update(schema="zip")), "its schema is 'zip'"),
        (lambda p: forge(p, lambda h: h.update(version=float("inf"))), "is damaged"),
        (lambda p: forge(p, lambda h: h.update(header=None)), "is damaged"),
        (lambda p: forge(p, lambda h: h.update(arrays=[])), "is damaged"),
        (lambda p: forge(p, members=lambda m: m | {container.HEADER: b"[" * 1_000_000}), "is damaged"),
        (lambda p: forge(p, members=lambda m: m | {container.HEADER: b'{"schema":' * 1_000_00}), "is damaged"),
        (lambda p: forge(p, members=lambda m: m | {container.HEADER: b"9" * 5000}), "is damaged"),
        (lambda p: forge(p, members=lambda m: m | {container.HEADER: b"\xff{}"}), "is damaged"),
        (lambda p: forge(p, members=lambda m: m | {container.HEADER: b" " * (module.HEADER_LIMIT + 1)}), "too long"),
        (lambda p: forge(p, damage=encrypted), "encrypted or packed in an unknown way"),
        (lambda p: forge(p, damage=compression_99), "encrypted or packed in an unknown way"),
        (lambda p: forge(p, method=zipfile.ZIP_LZMA), "encrypted or packed in an unknown way"),
        (lambda p: resealed(p, {}), "its header is missing"),
        (lambda p: p.write_bytes(b"no archive"), "its seal does not hold"),
        (lambda p: p.write_bytes(b"no archive" + seal(b"no archive")), "not a zip file"),
        (lambda p: np.savez(p, **ARRAYS), "was written by an earlier version, or by another program, without a seal"),
        (lambda p: (p.unlink(), p.mkdir()), "it is a folder"),
        (lambda p: p.unlink(), "does not exist; make it anew"),
    ],
)  # fmt: skip
def test_a_forgery_under_a_seal_that_holds_is_refused_by_name(path: Path, forgery, words: str) -> None:
    forgery(path)
    assert re.search(words, refused(path))


def test_a_forgery_that_changes_nothing_is_read(path: Path) -> None:
    """Else the forgeries above could be refused for another reason."""
    before = read(path)
    forge(path)
    assert read(path).header == before.header
    forge(path, method=zipfile.ZIP_DEFLATED)
    np.testing.assert_array_equal(read(path).arrays["weights"], ARRAYS["weights"])


def test_a_zip_bomb_is_refused_before_it_is_unpacked(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bomb = bytes(module.LIMIT + 1)
    forge(path, members=lambda members: members | {"raw": bomb}, method=zipfile.ZIP_DEFLATED)
    assert path.stat().st_size < module.LIMIT / 100
    monkeypatch.setattr(zipfile.ZipFile, "read", lambda *given: pytest.fail("it was unpacked"))
    assert "over the limit" in refused(path)


def test_a_member_that_unpacks_to_more_than_it_says_is_cut_off(path: Path) -> None:
    def understated(content: bytearray) -> None:
        place = content.rfind(b"PK\x01\x02")
        struct.pack_into("<I", content, place + 24, 2)

    forge(path, members=lambda m: m | {"raw": bytes(10**6)}, method=zipfile.ZIP_DEFLATED, damage=understated)
    refused(path)


def test_a_file_over_the_limit_is_not_even_read(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "read_bytes", lambda *given: pytest.fail("it was read"))
    assert "over the limit of 1000" in refused(path, limit=1000)


def test_other_kinds_and_other_versions_are_refused_by_name(path: Path) -> None:
    assert "holds a robot, not a policy; make it anew" in refused(path, "policy")
    assert "has the earlier format 1, this program reads 2; make it anew" in refused(path, version=2)
    assert "has format 1, this program reads up to 0; update pickenv" in refused(path, version=0)
    assert read(path, None).kind == "robot"


def test_what_could_hold_code_is_not_written(tmp_path: Path) -> None:
    for value in (np.array([object()]), np.zeros(2, "f8,i4"), np.array(["2026-01-01"], "M8[D]")):
        with pytest.raises(TypeError, match="only numbers and text can be saved"):
            write_container(tmp_path / "x.npz", "robot", {}, {"x": value})
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def chunk() -> bytes:
    buffer = io.BytesIO()
    table = pa.table({"error": np.random.default_rng(0).normal(size=500), "robot": ["a", "b"] * 250})
    pq.write_table(table, buffer, compression="zstd", write_page_checksum=True, write_page_index=True)
    return buffer.getvalue()


def test_a_sealed_parquet_file_is_a_parquet_file(chunk: bytes) -> None:
    sealed = sealed_parquet(chunk)
    check_sealed_parquet(sealed, "c.parquet", "run the study again")
    assert pq.read_table(pa.BufferReader(sealed), page_checksum_verification=True) == pq.read_table(
        pa.BufferReader(chunk)
    )
    assert len(sealed) == len(chunk) + len(seal())


def test_every_byte_of_a_sealed_parquet_file_counts(chunk: bytes) -> None:
    sealed = sealed_parquet(chunk)
    for place in range(len(sealed)):
        changed = sealed[:place] + bytes([sealed[place] ^ 1 << place % 8]) + sealed[place + 1 :]
        assert not parquet_is_sealed(changed), place


@pytest.mark.parametrize("content", [b"", b"PAR1", b"PAR1PAR1", b"x" * 500, b"PAR1" + b"\xff" * 500 + b"PAR1"])
def test_what_is_no_sealed_parquet_file_is_refused(content: bytes, chunk: bytes) -> None:
    for bad in (content, chunk, sealed_parquet(chunk)[:-1], sealed_parquet(chunk) + b"\0"):
        with pytest.raises(InputError, match=r"c\.parquet is damaged .*; run the study again"):
            check_sealed_parquet(bad, "c.parquet", "run the study again")
