"""Arrows on pictures are the held-out errors of the result: at each corner, in length, direction and colour."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.quiver import Quiver
from PIL import Image

from pickenv.arm import Pose, rotation_matrix
from pickenv.base import InputError
from pickenv.calibration import ArmModel, Board, Lens, PixelObservations, Result, calibrate, pose_carrier, projected
from pickenv.calibration.model.arm_model import joints_of_finished_poses
from pickenv.inspect import (
    CalibrationTrace,
    calibration_page,
    corner_errors,
    trace_drawings,
    trace_of,
    view_errors,
)
from pickenv.inspect.colours import viridis
from pickenv.inspect.figures.plot_errors import MOST_VIEWS, faint_picture
from pickenv.inspect.runs.run_folder import load_numbers, save_numbers
from pickenv.inspect.runs.traces import views_of

VIEWS, SIZE = 11, (640, 480)


@pytest.fixture(scope="module")
def pictures(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A picture per view; the first is no picture, and the second does not exist."""
    folder = tmp_path_factory.mktemp("pictures")
    grey = np.tile(np.linspace(0, 255, SIZE[0]), (SIZE[1], 1)).astype(np.uint8)
    for k in range(2, VIEWS):
        Image.fromarray(grey).save(folder / f"{k}.png")
    (folder / "0.png").write_text("no picture")
    return [folder / f"{k}.png" for k in range(VIEWS)]


@pytest.fixture(scope="module")
def result(pictures: list[Path]) -> Result:
    """A calibration of finished poses from views of a board with noise of 0.3 px, on its hand."""
    board = Board(kind="chessboard", columns=6, rows=5, square=0.03).corners
    rng = np.random.default_rng(4)
    turn = rotation_matrix(rng.normal(0, 0.35, (VIEWS, 3)))
    place = np.array([0.0, 0.0, 0.4]) + rng.normal(0, 0.03, (VIEWS, 3)) - turn @ board.mean(axis=0)
    back = np.swapaxes(turn, 1, 2)
    joints = joints_of_finished_poses(Pose(-(back @ place[..., None])[..., 0], back))
    seen = rng.random((VIEWS, len(board))) < 0.8
    data = PixelObservations(
        joints=joints,
        corners=np.zeros((*seen.shape, 2)),
        seen=seen,
        board=board,
        camera=Lens(np.array([620.0, 622.0, 323.0, 238.0, 0, 0, 0, 0, 0]), SIZE),
        lens_std=np.zeros(9),
        std=np.full(seen.shape, 0.3),
        pictures=np.array([str(path) for path in pictures]),
    )
    exact = projected(data.camera.values, data.in_camera(ArmModel.of(pose_carrier().nominal)))
    return calibrate(pose_carrier(), replace(data, corners=exact + rng.normal(0, 0.3, exact.shape)))


def quiver_of(axes: Axes) -> Quiver:
    (found,) = [artist for artist in axes.collections if isinstance(artist, Quiver)]
    return found


def gain_of(text: str) -> float:
    return float(re.search(r"×([\d.]+)", text)[1])  # type: ignore[index]


def check(axes: Axes, found: np.ndarray, errors: np.ndarray, top: float, gain: float) -> None:
    """Arrows start where corners are predicted; their length is the error's times the gain, in the axes' px."""
    arrows = quiver_of(axes)
    np.testing.assert_allclose(arrows.XY, found - errors, atol=1e-9)
    assert arrows.angles == arrows.scale_units == "xy"
    drawn = np.stack([arrows.U, arrows.V], axis=1) / arrows.scale
    np.testing.assert_allclose(drawn, errors * gain, atol=1e-9)
    lengths = np.hypot(*errors.T)
    np.testing.assert_allclose(arrows.get_array(), lengths)
    colours = arrows.cmap(arrows.norm(lengths))[:, :3] * 255
    assert np.abs(colours - viridis(lengths / top)).max() < 3.0
    assert axes.get_ylim()[0] > axes.get_ylim()[1]  # v grows downwards


def panels(figure: Figure) -> list[Axes]:
    return [axes for axes in figure.axes if any(isinstance(artist, Quiver) for artist in axes.collections)]


def test_all_corners_in_one_plane(result: Result) -> None:
    test = result.test
    assert isinstance(test, PixelObservations)
    errors = np.concatenate(result.held_out.pixels)
    (axes,) = panels(corner_errors(views_of(result)))
    title = axes.get_title(loc="left")
    assert f"over {int(test.seen.sum())} corners of {VIEWS} views" in title
    top = np.hypot(*errors.T).max()
    check(axes, test.corners[test.seen], errors, top, gain_of(title))
    assert gain_of(title) * top <= 0.1 * SIZE[0] < 2.0 * gain_of(title) * top


def test_views_are_drawn_the_worst_first(result: Result) -> None:
    test, left = result.test, result.held_out.pixels
    assert isinstance(test, PixelObservations) and result.pixels is not None and test.pictures is not None
    figure = view_errors(views_of(result))
    gain = gain_of(figure.get_suptitle())
    top = np.hypot(*np.concatenate(left).T).max()
    order = np.argsort([-np.sqrt((errors**2).sum(axis=1).mean()) for errors in left])
    drawn = panels(figure)
    assert len(drawn) == MOST_VIEWS < VIEWS
    for axes, view in zip(drawn, order, strict=False):
        check(axes, test.corners[view][test.seen[view]], left[view], top, gain)
        name, rms = axes.get_title(loc="left").split(": ")
        assert name == Path(test.pictures[view]).name
        assert rms == f"{result.pixels['leave_one_out_view_rms_px'][view]:.3g} px"
        assert len(axes.images) == (name not in ("0.png", "1.png"))  # what cannot be read is left out
        if axes.images:
            values = np.asarray(axes.images[0].get_array())
            assert (np.diff(values.astype(float)[0]) >= 0).all() and values.max() > 250  # not mirrored
            assert axes.images[0].get_extent() == [-0.5, SIZE[0] - 0.5, SIZE[1] - 0.5, -0.5]


def test_errors_belong_to_the_rows_of_the_test(result: Result) -> None:
    """Held out one by one: with all other views the fit predicts each view's corners to the same error."""
    test = result.test
    assert isinstance(test, PixelObservations)
    for view in (0, 7):
        rest = calibrate(pose_carrier(), test.select(np.delete(np.arange(VIEWS), view)))
        one = test.select(np.array([view]))
        again = one.pixel_errors(rest.geometric.identification.arm_model, np.zeros(0))
        np.testing.assert_allclose(again, result.held_out.pixels[view], atol=1e-4)


def test_the_page_shows_them_and_speaks_of_views(result: Result) -> None:
    page = calibration_page(result)
    assert "corner_errors-" in page and "view_errors-" in page and "data:image/png" in page
    words = re.sub(r"<[^>]*>", " ", page)
    errors = words.split("Errors on held-out views")[1].split("Reprojection errors")[0]
    assert f"On {VIEWS} views" in words and f"{VIEWS} views, each judged" in errors
    assert "nominal" not in errors and "nominal →" not in words and "With the nominal" not in words


def test_views_without_pictures_have_their_corners(result: Result) -> None:
    bare = [replace(view, picture=None) for view in views_of(result)[:2]]
    drawn = panels(view_errors(bare))
    assert len(drawn) == 2 and not any(axes.images for axes in drawn)


def test_nothing_to_draw_is_refused() -> None:
    for draw in (corner_errors, view_errors):
        with pytest.raises(InputError, match="no corner to draw"):
            draw([])


def test_a_picture_is_made_small_and_turned_as_its_camera_says(tmp_path: Path) -> None:
    assert faint_picture(tmp_path / "none.png") is None
    marked = np.zeros((600, 800), dtype=np.uint8)
    marked[:300] = 255
    turned = Image.fromarray(marked)
    exif = turned.getexif()
    exif[0x0112] = 3  # taken upside down
    turned.save(tmp_path / "a.jpg", exif=exif)
    small = faint_picture(tmp_path / "a.jpg")
    assert small is not None and small.shape == (240, 320)
    assert small[:100].max() < 10 and small[-100:].min() > 245


def test_a_run_folder_keeps_what_they_are_drawn_from(result: Result, tmp_path: Path) -> None:
    sets = {"identification": result.train, "test": result.test}
    trace = trace_of(result.fit, sets, dict(result.errors), views_of(result))
    kept = load_numbers(save_numbers(tmp_path / "trace.npz", trace), CalibrationTrace, "pickenv calibrate --run")
    drawings = {item.name: item for item in trace_drawings(kept) if item.draw is not None}
    for name, errors in zip(("corner_errors", "view_errors"), (result.held_out.pixels, None), strict=True):
        first = quiver_of(panels(drawings[name].draw())[0])
        again = quiver_of(
            panels({"corner_errors": corner_errors, "view_errors": view_errors}[name](views_of(result)))[0]
        )
        np.testing.assert_array_equal(first.get_array(), again.get_array())
        if errors is not None:
            np.testing.assert_allclose(first.get_array(), np.hypot(*np.concatenate(errors).T))
    bare = trace_drawings(replace(kept, views=()))
    assert not {"corner_errors", "view_errors"} & {item.name for item in bare}
