"""Tests of pictures are skipped where MuJoCo has nothing to draw with, and nowhere else."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest

from pickenv.base import InputError


@contextmanager
def where_mujoco_draws() -> Iterator[None]:
    """A context whose test is skipped if it raises the error that MuJoCo cannot draw here."""
    try:
        yield
    except InputError as error:
        if "MuJoCo cannot draw here" not in str(error):
            raise
        pytest.skip(str(error))
