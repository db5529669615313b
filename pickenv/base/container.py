"""Read and write containers: NumPy archives (.npz) that describe and hash their content and never run code.

`header.json` names the kind of file, its version, the versions of the packages that wrote it, and each array's type,
shape and SHA-256. The archive's comment is a seal. The seal, the list of members and their sizes are checked before
anything is unpacked. Arrays are rebuilt from the types in the header, never from text that NumPy would evaluate.

A seal is the SHA-256 of all other bytes of a file, kept inside the file. It detects every changed bit. It protects
against damage and careless edits, not against deceit, because anybody can seal a changed file again. Other programs can
still read a sealed file. In a zip archive the seal is the archive's comment, at the end of the file. In a Parquet file
the seal is between the last page and the footer. Readers find the footer from the end of the file, and offsets count
from the beginning.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import re
import struct
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.base.errors import InputError
from pickenv.base.files import reason_of, write_whole
from pickenv.base.reproducibility import made_with

SCHEMA = "pickenv container 1"
HEADER = "header.json"

LIMIT = 1 << 28
"""Largest size of a file, and of its unpacked content, unless the caller allows more (256 MiB), bytes."""
HEADER_LIMIT = 1 << 24
"""Largest size of a header (16 MiB), bytes."""

MOST_AXES = 32
"""Largest number of axes of an array."""

PLAIN = re.compile(r"[<>|][biufcU][0-9]{1,9}")
"""Pattern of NumPy's dtype strings for numbers and text. Dtypes that can hold Python objects do not match."""
UTF8_NAME = 0x800
"""Zip flag bit of a member whose name is UTF-8. Members with any other flag, such as encryption, are refused."""
BARE_END = b"PK\x05\x06"
"""Signature of the record of 22 bytes that ends a zip archive without a comment."""


@dataclass(frozen=True, eq=False)
class Container:
    """The content of a container file.

    Attributes:
        kind: Kind of the file, such as "calibration" or "policy".
        version: Format version of the content, counted separately for each kind of file.
        made_with: Versions of pickenv, NumPy and Python, and the fingerprint of the code that wrote the file ("code").
        header: Numbers and text by name, as JSON represents them.
        arrays: Arrays by name.
        blobs: Further bytes by name, such as another program's file.
    """

    kind: str
    version: int
    made_with: Mapping[str, str]
    header: Mapping[str, Any]
    arrays: Mapping[str, NDArray[Any]]
    blobs: Mapping[str, bytes]


@contextmanager
def refusing_damage(path: str | Path, what: str, remake: str) -> Iterator[None]:
    """Return a context that turns every exception into an `InputError`, since a damaged file can raise any exception.

    Args:
        path: The file that is read in the context.
        what: What the file should be, for the message: "a calibration file".
        remake: What the user should do about a damaged file, as the end of the message: "fit it again".

    Raises:
        InputError: For every exception in the context, except an interrupt.
    """
    try:
        yield
    except Exception as error:  # the one place where all of them are caught; none of them is lost
        why = f"{str(error)[:60]} is missing" if isinstance(error, KeyError) and error.args else reason_of(error)
        raise InputError(f"{path} is not {what} or is damaged ({why}); {remake}") from error


def sealed_json(content: Mapping[str, Any]) -> str:
    """Return the JSON text of a record, with the SHA-256 of its content under the key "sha256".

    `read_sealed_json` accepts exactly this text.
    """
    digest = hashlib.sha256(json.dumps(content, allow_nan=False).encode()).hexdigest()
    return json.dumps({**content, "sha256": digest}, indent=2) + "\n"


def read_sealed_json(path: Path, what: str, remake: str, *keys: str) -> dict[str, Any]:
    """Read a JSON record that `sealed_json` made, check its hash, and return its content without the hash.

    Args:
        path: The file.
        what: What the file should be, for the message: "a list of files".
        remake: What the user should do about a damaged file, as the end of the message: "make it again".
        keys: Keys that the record must have.

    Raises:
        InputError: If the file is missing, damaged or edited, or lacks one of ``keys``.
    """
    if not path.is_file():
        raise InputError(f"{path} is missing; {remake}")
    with refusing_damage(path, what, remake):
        text = path.read_text(encoding="utf-8")
        content: dict[str, Any] = json.loads(text)
        del content["sha256"]
        if text != sealed_json(content):
            raise ValueError("it was edited: its own hash is another")
        for key in keys:
            content[key]  # raises an error that names it
    return content


def named_part(prefix: str, arrays: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the arrays with ``prefix`` before their names, so that they can be saved beside other arrays."""
    return {f"{prefix}{name}": np.asarray(value) for name, value in arrays.items()}


def part_of(arrays: Mapping[str, NDArray[Any]], prefix: str) -> dict[str, NDArray[Any]]:
    """Return the arrays whose names begin with ``prefix``, named without it: the inverse of `named_part`."""
    return {name.removeprefix(prefix): value for name, value in arrays.items() if name.startswith(prefix)}


def npz_path(path: str | Path) -> Path:
    """Return the path, with ``.npz`` appended if it is missing; a path without a file name ("/", "..") is unchanged."""
    path = Path(path)
    return path if path.suffix == ".npz" or path.name in ("", "..") else path.with_name(path.name + ".npz")


def write_container(
    path: str | Path,
    kind: str,
    header: Mapping[str, Any],
    arrays: Mapping[str, NDArray[Any]],
    blobs: Mapping[str, bytes] | None = None,
    *,
    version: int = 1,
    compressed: bool = False,
) -> Path:
    """Write a container file atomically: either the whole file is written, or nothing.

    Equal content, code and package versions give equal bytes.

    Args:
        path: The file (.npz).
        kind: Kind of the file, in a word or two: "calibration".
        header: Numbers and text by name (JSON).
        arrays: Arrays of numbers or text by name.
        blobs: Further bytes by name, such as another program's file.
        version: Format version of the content of this kind of file.
        compressed: Whether the archive's members are deflated.

    Returns:
        The path written.

    Raises:
        InputError: If the file cannot be written.
        TypeError: If an array holds anything but numbers or text.
        ValueError: If a blob is named `header.json`, or its name ends in .npy.
    """
    # As they lie, so that sums repeat to the bit.
    numbers = {name: value.tobytes("A") for name, value in arrays.items()}
    described = {name: _description(name, value, numbers[name]) for name, value in arrays.items()}
    blobs = blobs or {}
    if any(name.endswith(".npy") or name == HEADER for name in blobs):
        raise ValueError(f"blobs may be called neither {HEADER} nor .npy")
    head = {"schema": SCHEMA, "kind": kind, "version": version, "made_with": made_with(), "arrays": described}
    hashes = {name: {"bytes": len(value), "sha256": _sha256(value)} for name, value in blobs.items()}
    members = {HEADER: json.dumps({**head, "blobs": hashes, "header": dict(header)}).encode()}
    members |= {f"{name}.npy": _preamble(described[name]) + content for name, content in numbers.items()}
    buffer = io.BytesIO()
    method = zipfile.ZIP_DEFLATED if compressed else zipfile.ZIP_STORED
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, content in {**members, **blobs}.items():
            archive.writestr(zipfile.ZipInfo(name), content, method)  # dated 1980, so that bytes repeat
        archive.comment = bytes(len(seal()))
    content = buffer.getvalue()[: -len(seal())]
    return write_whole(path, lambda temporary: temporary.write_bytes(content + seal(content)))


def read_container(
    path: str | Path, kind: str | None, *, remake: str, version: int | None = None, limit: int = LIMIT
) -> Container:
    """Read and verify a file that `write_container` wrote, without executing anything in it.

    Args:
        path: The file.
        kind: Kind that the file must have; None accepts any.
        remake: What the user should do about a file that is refused, as the end of the message: "fit it again".
        version: Format version that the caller reads; None accepts any.
        limit: Largest size of the file, and of its unpacked content, bytes.

    Raises:
        InputError: If the file is missing, damaged in any byte, too large, of another kind, or of another version.
    """
    with refusing_damage(path, f"a {kind} file" if kind else "a file of pickenv", remake):
        missing = not Path(path).exists()
        content = b"" if missing else _bounded(Path(path), limit)
        container = None if missing or content[-22:-18] == BARE_END else _verified(content, limit)
    if missing:
        raise InputError(f"{path} does not exist; {remake}")
    if container is None:
        raise InputError(f"{path} was written by an earlier version, or by another program, without a seal; {remake}")
    if kind is not None and container.kind != kind:
        raise InputError(f"{path} holds a {container.kind}, not a {kind}; {remake}")
    if version is not None and container.version > version:
        raise InputError(f"{path} has format {container.version}, this program reads up to {version}; update pickenv")
    if version is not None and container.version < version:
        raise InputError(f"{path} has the earlier format {container.version}, this program reads {version}; {remake}")
    return container


def _bounded(path: Path, limit: int) -> bytes:
    if not path.is_file():
        raise ValueError("it is a folder, a device or a pipe")
    if (size := path.stat().st_size) > limit:
        raise ValueError(f"it has {size} bytes, over the limit of {limit}")
    return path.read_bytes()


def _verified(content: bytes, limit: int) -> Container:
    """Return the container in the bytes of a file; raise an exception of any type if they are not a container.

    ``limit`` is the largest size of the unpacked content, bytes.
    """
    if content[-LENGTH:] != seal(memoryview(content)[:-LENGTH]):
        raise ValueError("its seal does not hold: a byte was changed or lost")
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members = archive.infolist()
        for member in members:
            if member.flag_bits & ~UTF8_NAME or member.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ValueError(f"member {member.filename!r} is encrypted or packed in an unknown way")
        if (total := sum(member.file_size for member in members)) > limit:
            raise ValueError(f"it unpacks to {total} bytes, over the limit of {limit}")
        if not members or members[0].filename != HEADER or members[0].file_size > HEADER_LIMIT:
            raise ValueError("its header is missing or too long")
        header = json.loads(archive.read(members[0]))
        if header["schema"] != SCHEMA:
            raise ValueError(f"its schema is {str(header['schema'])[:40]!r}, not {SCHEMA!r}")
        arrays, blobs = header["arrays"], header["blobs"]
        preambles = {name: _preamble(entry) for name, entry in arrays.items()}
        if [member.filename for member in members[1:]] != [*(f"{name}.npy" for name in arrays), *blobs]:
            raise ValueError("its members are not those that its header lists")
        sizes = [len(preambles[name]) + _size(entry) for name, entry in arrays.items()]
        sizes += [entry["bytes"] for entry in blobs.values()]
        if [member.file_size for member in members[1:]] != sizes:
            raise ValueError("its members have other sizes than its header says")
        parts = {member.filename: archive.read(member) for member in members[1:]}
    return Container(
        kind=str(header["kind"]),
        version=int(header["version"]),
        made_with={str(name): str(value) for name, value in header["made_with"].items()},
        header=dict(header["header"]),
        arrays={name: _array(name, parts[f"{name}.npy"], preambles[name], entry) for name, entry in arrays.items()},
        blobs={name: _same(name, parts[name], entry) for name, entry in blobs.items()},
    )


def _description(name: str, value: NDArray[Any], numbers: bytes) -> dict[str, Any]:
    """Return the entry for an array in the header: its type, shape, memory order and SHA-256.

    Args:
        name: Name of the array, for error messages.
        value: The array.
        numbers: The bytes that hold the array's numbers in the file.
    """
    if not PLAIN.fullmatch(value.dtype.str):
        raise TypeError(f"array {name!r} holds {value.dtype}; only numbers and text can be saved")
    fortran = value.flags.f_contiguous and not value.flags.c_contiguous
    return {"dtype": value.dtype.str, "shape": list(value.shape), "fortran": bool(fortran), "sha256": _sha256(numbers)}


def _preamble(entry: Mapping[str, Any]) -> bytes:
    """Return the bytes before the numbers in a .npy file (version 1.0); raise an error if type or shape is invalid.

    ``entry`` is the array's entry in the header, as from `_description`.
    """
    dtype, shape = str(entry["dtype"]), entry["shape"]
    lengths_fit = len(shape) <= MOST_AXES and all(type(length) is int and length >= 0 for length in shape)
    if not PLAIN.fullmatch(dtype) or not lengths_fit:
        raise ValueError("an array's type or shape is not one of numbers or text")
    text = f"{{'descr': '{dtype}', 'fortran_order': {bool(entry['fortran'])}, 'shape': {tuple(shape)}, }}"
    padding = " " * (-(10 + len(text) + 1) % 64)
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text) + len(padding) + 1) + f"{text}{padding}\n".encode()


def _size(entry: Mapping[str, Any]) -> int:
    """Return the number of bytes that an array's numbers take, from the array's entry in the header."""
    return int(math.prod(entry["shape"]) * np.dtype(entry["dtype"]).itemsize)


def _array(name: str, content: bytes, preamble: bytes, entry: Mapping[str, Any]) -> NDArray[Any]:
    if not content.startswith(preamble):
        raise ValueError(f"array {name!r} is of another type or shape than its header says")
    numbers = _same(name, content[len(preamble) :], entry)
    return np.ndarray(entry["shape"], entry["dtype"], numbers, order="F" if entry["fortran"] else "C").copy("K")


def _same(name: str, content: bytes, entry: Mapping[str, Any]) -> bytes:
    if _sha256(content) != entry["sha256"]:
        raise ValueError(f"{name!r} has changed since it was written")
    return content


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


# Seals.

MARK = b"pickenv sha256 "
"""The bytes of a seal before its hash."""
LENGTH = len(MARK) + 64
"""Length of a seal, bytes."""

PARQUET = b"PAR1"


def seal(*parts: bytes | memoryview) -> bytes:
    """Return the seal of a file: `MARK`, then the SHA-256 of all other bytes of the file, in hexadecimal.

    Args:
        parts: All bytes of the file except the seal, in their order, in one or more pieces.
    """
    total = hashlib.sha256()
    for part in parts:
        total.update(part)
    return MARK + total.hexdigest().encode()


def sealed_parquet(content: bytes) -> bytes:
    """Return a Parquet file's bytes with a seal inserted between the last page and the footer.

    The result is still a valid Parquet file.
    """
    footer = _footer(content)
    return content[:footer] + seal(content[:footer], content[footer:]) + content[footer:]


def parquet_is_sealed(content: bytes) -> bool:
    """Return whether ``content`` is a Parquet file whose seal matches its other bytes."""
    footer = _footer(content)
    start = footer - LENGTH
    view = memoryview(content)
    return start >= len(PARQUET) and content[start:footer] == seal(view[:start], view[footer:])


def check_sealed_parquet(content: bytes, path: object, remake: str) -> None:
    """Raise an error unless ``content`` is a Parquet file with a valid seal (`sealed_parquet`).

    Args:
        content: The file's bytes.
        path: The file's name, for the message.
        remake: What the user should do about a refused file, as the end of the message: "record it again".

    Raises:
        InputError: If there is no seal, or the seal does not match the other bytes.
    """
    if not parquet_is_sealed(content):
        raise InputError(f"{path} is damaged or was written by something else (its seal does not hold); {remake}")


def _footer(content: bytes) -> int:
    """Return the offset at which a Parquet file's footer begins, bytes; 0 if ``content`` is no Parquet file."""
    length = int.from_bytes(content[-8:-4], "little")
    is_one = content[:4] == content[-4:] == PARQUET and len(content) >= length + 12
    return len(content) - 8 - length if is_one else 0
