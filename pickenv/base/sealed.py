"""A seal is the SHA-256 of all other bytes of a file, kept inside it: one bit changed anywhere, and it does not hold.

It finds damage and carelessness; whoever wants to deceive can seal a file anew. Two places keep it out of a reader's
way: the end of a file (a zip archive's comment), and, in Parquet, the gap between the last page and the footer, which
readers find from the end of the file and whose offsets count from its beginning.
"""

from __future__ import annotations

import hashlib

from pickenv.base.errors import InputError

MARK = b"pickenv sha256 "
"""What stands before the hash."""
LENGTH = len(MARK) + 64
"""Bytes of a seal."""

PARQUET = b"PAR1"


def seal(*parts: bytes | memoryview) -> bytes:
    """The seal of a file whose other bytes are ``parts``, one after the other."""
    total = hashlib.sha256()
    for part in parts:
        total.update(part)
    return MARK + total.hexdigest().encode()


def ends_sealed(content: bytes) -> bool:
    """Whether ``content`` ends with the seal of all that stands before it."""
    return content[-LENGTH:] == seal(memoryview(content)[:-LENGTH])


def sealed_parquet(content: bytes) -> bytes:
    """A Parquet file's bytes with the seal between its last page and its footer; still a valid Parquet file."""
    footer = _footer(content)
    return content[:footer] + seal(content[:footer], content[footer:]) + content[footer:]


def parquet_is_sealed(content: bytes) -> bool:
    """Whether these are the bytes of a Parquet file whose seal holds."""
    footer = _footer(content)
    start = footer - LENGTH
    whole = memoryview(content)
    return start >= len(PARQUET) and content[start:footer] == seal(whole[:start], whole[footer:])


def check_sealed_parquet(content: bytes, path: object, remake: str) -> None:
    """Refuse the bytes of a Parquet file that `sealed_parquet` did not make, or that have changed since.

    Args:
        content: The file's bytes.
        path: Its name, for the message.
        remake: What to do about it, as the end of a sentence.

    Raises:
        InputError: If there is no seal, or it does not hold.
    """
    if not parquet_is_sealed(content):
        raise InputError(f"{path} is damaged or was written by something else (its seal does not hold); {remake}")


def _footer(content: bytes) -> int:
    """Where the footer of a Parquet file begins; 0 where there is none."""
    length = int.from_bytes(content[-8:-4], "little")
    is_one = content[:4] == content[-4:] == PARQUET and len(content) >= length + 12
    return len(content) - 8 - length if is_one else 0
