from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pickenv.arm import forward
from pickenv.base import InputError
from pickenv.inspect import Comparison, record_comparison
from pickenv.inspect.colours import lane, viridis
from pickenv.inspect.recordings import comparison_recording as recording
from pickenv.inspect.recordings.scribe import Scribe, f32, recording_bytes
from pickenv.inspect.runs.comparison_summary import colour_scale_mm
from pickenv.inspect.runs.run_folder import cut_away

RERUN = Path(sys.executable).with_name("rerun")
KEYS = ("raw", "ls", "ls_bpnn")
EFFECTS = ("geometry", "joint_compliance", "boom_bending", "transmission_error")


def compare(first: Path, second: Path) -> int:
    return subprocess.run(
        [RERUN, "rrd", "compare", "--unordered", first, second], capture_output=True, check=False
    ).returncode


def test_every_entity_is_in_the_file(reading: Any) -> None:
    wanted = {
        "/summary",
        "/about_the_day",
        "/metrics/tolerance_mm",
        "/__properties/pickenv",
        "/world/field/removed/vectors",
    }
    wanted |= {f"/legend/{key}/{part}" for key in ("position", "attitude", "uncertainty") for part in ("bar", "ticks")}
    wanted |= {f"/world/effect/{name}" for name in EFFECTS}
    wanted |= {f"/world/attitude/{name}" for name in ("raw", "ls_bpnn", "floor")}
    wanted |= {f"/world/uncertainty/{name}" for name in ("predicted", "actual")}
    wanted |= {f"/day/{name}_mm/{key}" for name in ("mean", "p95") for key in (*KEYS, "adapted")}
    wanted |= {f"/world/{name}" for name in ("axes", "workspace", "fruit", "capture")}
    wanted |= {f"/world/arm/{name}" for name in ("nominal", "true", "exaggerated")}
    wanted |= {"/target/capture", "/target/axes"}
    for key in KEYS:
        wanted |= {f"/world/field/{key}/vectors", f"/world/field/{key}/voxels", f"/field/{key}/magnitude_mm"}
        wanted |= {f"/world/miss/{key}", f"/metrics/error_mm/{lane(key)}", f"/metrics/attitude_deg/{lane(key)}"}
        wanted |= {f"/outcome/{lane(key)}", f"/hist/{lane(key)}", f"/target/{key}"}
    arms = {entity for entity in reading.entities() if entity.startswith("/urdf_")}
    for name in ("urdf_nominal", "urdf_true"):
        assert {f"/{name}/base", f"/{name}/tf_static", *(f"/{name}/joint{i}" for i in range(1, 7))} <= arms
    assert reading.entities() - arms == wanted


def test_arrows_are_the_errors_times_the_gain(reading: Any, comparison: Comparison) -> None:
    for policy in comparison.policies:
        entity = f"/world/field/{policy.key}/vectors"
        vectors = reading.values(entity, "Arrows3D:vectors")
        np.testing.assert_allclose(vectors, 20.0 * policy.field_errors, rtol=1e-6, atol=1e-9)
        np.testing.assert_allclose(reading.values(entity, "Arrows3D:origins"), comparison.grid.points, rtol=1e-6)


def test_a_click_on_an_arrow_reads_out_the_error(reading: Any, comparison: Comparison) -> None:
    for policy in comparison.policies:
        entity = f"/world/field/{policy.key}/vectors"
        xyz, norm = (reading.values(entity, f"PickError:{name}") for name in ("xyz_mm", "norm_mm"))
        np.testing.assert_allclose(xyz, 1e3 * policy.field_errors, rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(norm, np.linalg.norm(1e3 * policy.field_errors, axis=-1), rtol=1e-6)
        norm = reading.values(f"/world/miss/{policy.key}", "PickError:norm_mm")
        np.testing.assert_allclose(norm, policy.ends.position_error_mm, rtol=1e-5)


def test_all_fields_share_one_colour_scale(reading: Any, comparison: Comparison) -> None:
    top = colour_scale_mm(comparison)
    assert top == np.percentile(1e3 * np.linalg.norm(comparison.policies[0].field_errors, axis=-1), 99)
    for policy in comparison.policies:
        magnitude = 1e3 * np.linalg.norm(policy.field_errors, axis=-1)
        packed = reading.values(f"/world/field/{policy.key}/vectors", "Arrows3D:colors")
        rgb = np.stack([packed >> shift & 0xFF for shift in (24, 16, 8)], axis=-1)
        np.testing.assert_array_equal(rgb, viridis(magnitude / top))
        for entity, name in (
            (f"world/field/{policy.key}/voxels", "VoxelGridMap"),
            (f"field/{policy.key}/magnitude_mm", "Tensor"),
        ):
            np.testing.assert_allclose(reading.values(f"/{entity}", f"{name}:value_range"), [[0.0, top]], rtol=1e-6)


def test_voxels_and_slices_are_the_error_magnitude(reading: Any, comparison: Comparison) -> None:
    kept = ~cut_away(comparison)
    assert 0.8 < kept.mean() < 0.95
    for policy in comparison.policies:
        magnitude = 1e3 * np.linalg.norm(policy.field_errors, axis=-1)
        entity = f"/world/field/{policy.key}/voxels"
        np.testing.assert_allclose(reading.values(entity, "VoxelGridMap:values"), magnitude[kept], rtol=1e-6)
        corner = reading.values(entity, "VoxelGridMap:translation")[0]
        index = reading.values(entity, "VoxelGridMap:voxel_indices")
        centres = corner + (index + 0.5) * comparison.grid.step
        np.testing.assert_allclose(centres, comparison.grid.points[kept], atol=1e-6)
        (tensor,) = reading.component(f"/field/{policy.key}/magnitude_mm", "Tensor:data").flatten().to_pylist()
        values = np.asarray(tensor["buffer"]).reshape(tensor["shape"])
        for place, said, axis in zip("zyx", tensor["names"], (2, 1, 0), strict=True):
            start, step = map(float, re.fullmatch(rf"{place} = (\S+) m \+ (\S+) m ×", said).groups())  # type: ignore[union-attr]
            metres = start + step * comparison.grid.index[:, axis]
            np.testing.assert_allclose(metres, comparison.grid.points[:, axis], atol=6e-4)
        x, y, z = comparison.grid.index.T
        np.testing.assert_allclose(values[z, y, x], magnitude, rtol=1e-6)


def test_each_reach_has_its_errors_and_its_outcome(reading: Any, comparison: Comparison) -> None:
    assert {column.name for column in reading.store.schema().index_columns()} == {"reach", "hours"}
    for policy in comparison.policies:
        for name, values in (
            ("error_mm", policy.ends.position_error_mm),
            ("attitude_deg", policy.ends.attitude_error_deg),
        ):
            shown = reading.values(f"/metrics/{name}/{lane(policy.key)}", "Scalars:scalars")
            np.testing.assert_allclose(shown, values, rtol=5.0001e-4)
            assert all(len(repr(float(value)).replace(".", "").strip("0")) <= 4 for value in shown)
        states = reading.values(f"/outcome/{lane(policy.key)}", "StateChange:state")
        np.testing.assert_array_equal(states == "pick", policy.ends.success)
        counts = reading.component(f"/hist/{lane(policy.key)}", "BarChart:values").flatten().to_pylist()[0]["buffer"]
        assert sum(counts) == len(comparison.fruit)
    assert set(reading.values("/metrics/tolerance_mm", "Scalars:scalars")) == {comparison.tolerance_mm}


def last_rod_ends(reading: Any, entity: str, reaches: int) -> np.ndarray:
    """Where the arm's last rod ends at each reach: its start plus its length along the turned z axis."""
    start, (x, y, z, w), length = (
        reading.values(entity, "Capsules3D:translations"),
        reading.values(entity, "Capsules3D:quaternions").T,
        reading.values(entity, "Capsules3D:lengths"),
    )
    direction = np.stack([2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)], axis=-1)
    return (start + length[:, None] * direction).reshape(reaches, -1, 3)[:, -1]


def test_the_arms_end_where_the_tool_is(reading: Any, comparison: Comparison) -> None:
    first, reaches = comparison.policies[0], len(comparison.fruit)
    believed, true = forward(comparison.nominal, first.ends.joint_command).position, first.ends.tool_position
    drawn = believed + 20.0 * (true - believed)
    for name, position in (("nominal", believed), ("true", true), ("exaggerated", drawn)):
        ends = last_rod_ends(reading, f"/world/arm/{name}", reaches)
        np.testing.assert_allclose(ends, position, atol=2e-3 if name == "exaggerated" else 2e-6)


def test_the_file_says_what_it_is(reading: Any, comparison: Comparison) -> None:
    from rerun.chunk import RrdReader

    (entry,) = RrdReader(reading.path).recordings()
    assert (entry.application_id, entry.recording_id) == ("pickenv", "qiao2026:seed7")
    stated = {
        name: reading.values("/__properties/pickenv", name).tolist() for name in ("seed", "plant", "gain", "policies")
    }
    assert stated == {"seed": [7], "plant": ["qiao2026"], "gain": [20.0], "policies": list(KEYS)}
    assert reading.values("/__properties/pickenv", "rerun_version")[0].startswith("0.41")
    (text,) = reading.values("/summary", "TextDocument:text")
    assert "| **least squares + neural network** | 100 % |" in text
    assert "radius 1 mm" in text


def test_equal_seeds_give_equal_files_and_other_seeds_others(
    make_comparison: Callable[..., Comparison], tmp_path: Path
) -> None:
    again = [
        record_comparison(make_comparison(seed=3, reaches=5, cells_per_axis=3), tmp_path / f"{i}" / "errors.rrd")
        for i in (1, 2)
    ]
    other = record_comparison(make_comparison(seed=4, reaches=5, cells_per_axis=3), tmp_path / "other.rrd")
    assert compare(again[0], again[1]) == 0
    assert compare(again[0], other) == 1


def test_a_thousand_cells_and_a_hundred_reaches_stay_small(comparison: Comparison, reading: Any) -> None:
    assert len(comparison.grid.points) == 1000
    assert len(comparison.fruit) == 100
    assert reading.path.stat().st_size < 2e6


@pytest.mark.parametrize(("read_out", "most"), [(False, 3.0e6), (True, 4.5e6)])
def test_a_hundred_thousand_arrows(read_out: bool, most: float, benchmark: Any) -> None:
    """Arrows as such, and with the millimetres that a click reads out; `make benchmark` times both."""
    import rerun as rr
    import rerun.blueprint as rrb

    rng = np.random.default_rng(0)
    points, errors = rng.uniform(-1.0, 1.0, (100_000, 3)), rng.normal(scale=1e-3, size=(100_000, 3))
    blueprint = rrb.Blueprint(rrb.Spatial3DView(origin="/"))

    def send(stream: Any) -> None:
        if read_out:
            Scribe(stream).arrows("field", points, 20.0 * errors, 1e3 * errors, 3.0)
        else:
            colours = viridis(np.linalg.norm(1e3 * errors, axis=-1) / 3.0)
            arrows = rr.Arrows3D(origins=f32(points), vectors=f32(20.0 * errors), colors=colours)
            Scribe(stream).still("field", arrows)

    content = benchmark(recording_bytes, "arrows", blueprint, send)
    assert len(content) < most


def test_one_policy_without_reaches_is_enough(
    without_reaches: Comparison, reader: Callable[[Path], Any], tmp_path: Path
) -> None:
    reading = reader(record_comparison(without_reaches, tmp_path / "errors.rrd"))
    assert "/world/field/raw/vectors" in reading.entities()
    absent = ("/metrics", "/outcome", "/target", "/day", "/urdf", "/world/attitude", "/world/uncertainty")
    assert not any(entity.startswith(absent) for entity in reading.entities())
    assert "/world/field/removed/vectors" not in reading.entities()
    (text,) = reading.values("/summary", "TextDocument:text")
    mean = np.linalg.norm(1e3 * without_reaches.policies[0].field_errors, axis=-1).mean()
    assert f"| **raw** | {mean:.2f} mm |" in text
    assert "nan" not in text
    assert "pick" not in text
    assert reading.unmatched_rules() == []


def test_an_interrupt_leaves_the_old_file_and_no_half_one(
    few: Comparison, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "errors.rrd"
    path.write_text("an older recording")

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(recording, "_send_histograms", interrupt)
    with pytest.raises(KeyboardInterrupt):
        record_comparison(few, path)
    assert path.read_text() == "an older recording"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.slow
def test_a_killed_writer_leaves_no_recording(tmp_path: Path) -> None:
    script = """
import os, runpy, sys
from pickenv.inspect.recordings import comparison_recording
module = runpy.run_path(sys.argv[1])
comparison_recording._send_histograms = lambda *_: os._exit(9)
comparison_recording.record_comparison(module["synthetic_comparison"](reaches=5, cells_per_axis=3), sys.argv[2])
"""
    conftest, path = Path(__file__).with_name("conftest.py"), tmp_path / "errors.rrd"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, "-c", script, str(conftest), str(path)]
    assert subprocess.run(command, env=environment, check=False).returncode == 9
    assert not path.exists()


def test_a_folder_that_cannot_be_written_is_named(few: Comparison, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("not a folder")
    with pytest.raises(InputError, match=r"file/errors\.rrd"):
        record_comparison(few, tmp_path / "file" / "errors.rrd")


@pytest.mark.slow
@pytest.mark.parametrize("room", [20_000, pytest.param(60_000, marks=pytest.mark.slow)])
def test_a_full_disk_is_one_sentence_and_leaves_nothing(room: int, tmp_path: Path) -> None:
    script = f"""
import resource, runpy, sys
from pickenv.base import InputError
from pickenv.inspect import record_comparison
comparison = runpy.run_path(sys.argv[1])["synthetic_comparison"](reaches=5, cells_per_axis=3)
resource.setrlimit(resource.RLIMIT_FSIZE, ({room}, {room}))
try:
    record_comparison(comparison, sys.argv[2])
except InputError as error:
    sys.exit(f"error: {{error}}")
"""
    conftest, path = Path(__file__).with_name("conftest.py"), tmp_path / "errors.rrd"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    command = [sys.executable, "-c", script, str(conftest), str(path)]
    done = subprocess.run(command, env=environment, check=False, capture_output=True, text=True, timeout=600)
    assert done.stderr == f"error: cannot write {path}: File too large\n"
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_a_recording_that_rerun_did_not_write_is_not_passed_off_as_one(tmp_path: Path) -> None:
    script = """
import runpy, sys
from pickenv.base import InputError
from pickenv.inspect import record_comparison
try:
    record_comparison(runpy.run_path(sys.argv[1])["synthetic_comparison"](reaches=5, cells_per_axis=3), sys.argv[2])
except InputError as error:
    sys.exit("RERUN" not in str(error))
sys.exit(2)
"""
    conftest, path = Path(__file__).with_name("conftest.py"), tmp_path / "errors.rrd"
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2]), "RERUN": "off"}
    command = [sys.executable, "-c", script, str(conftest), str(path)]
    assert subprocess.run(command, env=environment, check=False).returncode == 0
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        (lambda c: replace(c, policies=()), "no policy"),
        (lambda c: replace(c, policies=c.policies + c.policies[:1]), "'raw' is given twice"),
        (lambda c: replace(c, policies=(replace(c.policies[0], key="LS/raw"),)), "'LS/raw' cannot name an entity"),
    ],
)
def test_bad_policies_are_refused(
    change: Callable[[Comparison], Comparison], complaint: str, comparison: Comparison, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=complaint):
        record_comparison(change(comparison), tmp_path / "errors.rrd")


def test_importing_the_room_loads_neither_rerun_nor_matplotlib() -> None:
    script = """
import sys
import pickenv.inspect
from pickenv.inspect import Comparison, RecordedPolicy, read_run
sys.exit(bool({"rerun", "matplotlib"} & set(sys.modules)))
"""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    assert subprocess.run([sys.executable, "-c", script], env=environment, check=False).returncode == 0
