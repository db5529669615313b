"""The recording's picture is the viewer's own, or there is none; no viewer is left behind."""

import io
import os
from pathlib import Path

import numpy as np
import pytest

from pickenv.inspect import Comparison, record_comparison
from pickenv.inspect.recordings.viewing import WINDOW, viewer_picture

pytestmark = pytest.mark.browser


@pytest.fixture(scope="module")
def recording(comparison: Comparison, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return record_comparison(comparison, tmp_path_factory.mktemp("run") / "errors.rrd")


@pytest.fixture(autouse=True)
def mark(monkeypatch: pytest.MonkeyPatch) -> None:
    """Viewers inherit the mark, which tells them from those that other tests open at the same time."""
    monkeypatch.setenv("VIEWERS_OF", str(os.getpid()))


def viewers() -> set[str]:
    """Process numbers of viewers without a window that these tests opened."""
    found: set[str] = set()
    token = f"VIEWERS_OF={os.getpid()}".encode()
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            words = path.read_bytes().split(b"\0")
            marked = token in path.with_name("environ").read_bytes().split(b"\0")
        except OSError:  # it ended
            continue
        if marked and b"--headless" in words and any(b"rerun" in word for word in words):
            found.add(path.parent.name)
    return found


def test_the_picture_has_the_windows_size_and_more_than_a_background(recording: Path) -> None:
    from PIL import Image

    before = viewers()
    picture = viewer_picture(recording)
    assert viewers() <= before
    assert picture is not None
    image = Image.open(io.BytesIO(picture))
    assert (image.format, image.size) == ("WEBP", tuple(map(int, WINDOW.split("x"))))
    assert len(np.unique(np.asarray(image.convert("RGB"))[::10, ::10].reshape(-1, 3), axis=0)) > 100


def test_without_a_graphics_adapter_there_is_none(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES"):
        monkeypatch.setenv(name, "/nonexistent")
    before = viewers()
    assert viewer_picture(recording) is None
    assert viewers() <= before
