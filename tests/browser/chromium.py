"""Debian's Chromium, driven by playwright, drawing with Mesa on the processor."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

SIZE = {"width": 1600, "height": 900}
PHONE = {"width": 390, "height": 844}
FLAGS = (
    "--use-gl=angle",
    "--use-angle=gl-egl",
    "--ignore-gpu-blocklist",
    "--enable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
)


@contextmanager
def chromium() -> Iterator[Any]:
    """A playwright Browser.

    Raises:
        RuntimeError: If Chromium or playwright is missing.
    """
    executable = shutil.which("chromium")
    if executable is None:
        raise RuntimeError("no chromium on the path; `make test-browser` installs it")
    try:
        from playwright.sync_api import sync_playwright
    except ModuleNotFoundError as error:
        raise RuntimeError("playwright is not installed; `make test-browser` installs it") from error
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=executable, args=list(FLAGS))
        try:
            yield browser
        finally:
            browser.close()
