"""One thread for small matrices: a pool of threads costs more than it saves, most of all on a busy machine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache

from threadpoolctl import ThreadpoolController  # type: ignore[import-untyped]


@lru_cache(maxsize=1)
def _controller() -> ThreadpoolController:
    return ThreadpoolController()  # looking the libraries up takes milliseconds, so once


@contextmanager
def single_threaded() -> Iterator[None]:
    """A context, or a decorator of functions, in which NumPy's linear algebra runs on one thread."""
    with _controller().limit(limits=1, user_api="blas"):
        yield


@contextmanager
def torch_on_one_thread() -> Iterator[None]:
    """Torch on one thread: small networks and blocks lose time to more, and one adds in one order."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
