from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from pickenv.arm import Array, Geometry, Plant, Pose, forward, inverse, load_plant, parameter_jacobian, pose_error
from pickenv.calibration import fit, random_joints, simulated_tracker
from pickenv.inspect import (
    Comparison,
    FieldGrid,
    Reaches,
    RecordedPolicy,
    Run,
    ended,
    record_comparison,
    recorded_run,
    save_part,
    trace_of,
)

STEP = 0.055


@pytest.fixture(autouse=True)
def strict_rerun() -> None:
    import rerun as rr

    rr.set_strict_mode(True)


def reach(plant: Plant, believed: Geometry, points: Array, rotation: Array) -> tuple[Array, Pose, np.ndarray]:
    """Joints that a controller with geometry `believed` chooses for `points`, and where they bring the true tool."""
    target = Pose(points, np.broadcast_to(rotation, (len(points), 3, 3)))
    solution = inverse(believed, target, restarts=0)
    return solution.joints, plant.tool_pose(solution.joints), solution.position_error < 1e-4


def identified_geometry(plant: Plant, rng: np.random.Generator) -> Geometry:
    """Least squares on 60 random poses: absorbs into the geometry what it can of compliance, bending and drives."""
    geometry = plant.arm.nominal
    q = rng.uniform(geometry.lower, geometry.upper, size=(60, geometry.joints))
    for _ in range(3):
        residual = pose_error(forward(geometry, q), plant.tool_pose(q)).reshape(-1)
        jacobian = parameter_jacobian(geometry, q).reshape(len(residual), -1)
        geometry = geometry.displaced(np.linalg.lstsq(jacobian, residual, rcond=1e-4)[0])
    return geometry


def synthetic_comparison(
    seed: int = 7, reaches: int = 100, tolerance_mm: float = 1.0, cells_per_axis: int = 10
) -> Comparison:
    """Raw, LS and LS + BPNN on the arm of Qiao 2026; LS fits the geometry, BPNN removes most of what is left."""
    plant = load_plant("qiao2026")
    nominal, rng = plant.arm.nominal, np.random.default_rng(seed)
    identified = identified_geometry(plant, rng)
    middle = forward(nominal, (nominal.lower + nominal.upper) / 2.0)
    origin = middle.position - (cells_per_axis - 1) / 2.0 * STEP
    index = np.stack(np.meshgrid(*[np.arange(cells_per_axis)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    points = origin + STEP * index
    fruit = origin + STEP * (cells_per_axis - 1) * rng.random((reaches, 3))
    everything = np.concatenate([points, fruit])
    joints, raw, reached = reach(plant, nominal, everything, middle.rotation)
    ls_joints, ls, ls_reached = reach(plant, identified, everything, middle.rotation)
    noise = rng.normal(scale=3e-5, size=everything.shape)
    bpnn = Pose(everything + 0.25 * (ls.position - everything) + noise, ls.rotation)
    inside = reached & ls_reached
    cells, picks = inside[: len(points)], inside[len(points) :]
    policies = []
    for key, label, q, pose in (
        ("raw", "raw", joints, raw),
        ("ls", "LS", ls_joints, ls),
        ("ls_bpnn", "LS + BPNN", ls_joints, bpnn),
    ):
        errors = pose.position - everything
        final = np.zeros((int(picks.sum()), 6))
        final[:, :3] = errors[len(points) :][picks]
        final_mm = np.linalg.norm(final, axis=-1) * 1e3
        final[:, 3] = np.radians(0.05 * final_mm)
        position, success = pose.position[len(points) :][picks], final_mm <= tolerance_mm
        ends = Reaches(tuple(range(len(final))), final, final, success, q[len(points) :][picks], position, fruit[picks])
        field = errors[: len(points)][cells]
        policies.append(
            ended(label, ends, key).with_field(np.concatenate([field, 0.4 * np.roll(field, 1, axis=-1)], axis=-1))
        )
    shape = (cells_per_axis, cells_per_axis, cells_per_axis)
    return Comparison(
        plant=plant,
        seed=seed,
        tolerance_mm=tolerance_mm,
        grid=FieldGrid(shape, origin, STEP, index[cells], points[cells], joints[: len(points)][cells]),
        policies=tuple(policies),
        field_uncertainty=1e-4 * (1.0 + rng.random(int(cells.sum()))),
    )


def cut(policy: RecordedPolicy, number: int) -> RecordedPolicy:
    """The first ``number`` episodes of a policy."""
    arrays = {name: value for name, value in vars(policy).items() if isinstance(value, np.ndarray)}
    return replace(policy, **{name: value[:number] for name, value in arrays.items() if not name.startswith("field")})


@pytest.fixture(scope="session")
def comparison() -> Comparison:
    return synthetic_comparison()


@pytest.fixture(scope="session")
def few() -> Comparison:
    """The same with five reaches and 27 cells."""
    return synthetic_comparison(reaches=5, cells_per_axis=3)


@pytest.fixture(scope="session")
def make_comparison() -> Callable[..., Comparison]:
    """`synthetic_comparison` itself, for tests that need another seed."""
    return synthetic_comparison


@pytest.fixture(scope="session")
def without_reaches(comparison: Comparison) -> Comparison:
    """The raw error field alone: one policy, no fruit, and a corner of the grid out of reach."""
    grid, raw = comparison.grid, cut(comparison.policies[0], 0)
    inside = grid.index.sum(axis=-1) > 6
    grid = replace(grid, index=grid.index[inside], points=grid.points[inside], joints=grid.joints[inside])
    policy = replace(raw, field_errors=raw.field_errors[inside], field_attitude=None)
    return replace(comparison, grid=grid, field_uncertainty=None, policies=(policy,))


@pytest.fixture(scope="session")
def cut_short() -> Callable[[RecordedPolicy, int], RecordedPolicy]:
    """`cut` itself."""
    return cut


@dataclass(frozen=True)
class Reading:
    """A recording as read back from its file."""

    path: Path
    store: Any
    blueprint: Any

    def entities(self) -> set[str]:
        return {column.entity_path for column in self.store.schema().component_columns()}

    def component(self, entity: str, name: str) -> Any:
        """All rows of one component, as an Arrow array of lists."""
        chunks = self.store.stream().filter(content=entity, components=[name])
        return pa.chunked_array([chunk.to_record_batch().column(name) for chunk in chunks]).combine_chunks()

    def values(self, entity: str, name: str) -> np.ndarray:
        """All values of one component, rows joined: ``(N,)``, or ``(N, k)`` for vectors."""
        flat, width = self.component(entity, name).flatten(), 0
        if pa.types.is_fixed_size_list(flat.type):
            flat, width = flat.flatten(), flat.type.list_size
        array = flat.to_numpy(zero_copy_only=False)
        return array.reshape(-1, width) if width else array

    def holds(self, entity: str, **wanted: Any) -> None:
        """That an entity consists of just these components: all rows joined, colours as red, green, blue (and alpha).

        What is drawn as many pixels wide on any screen has a radius below zero.
        """
        named = {column.component for column in self.store.schema().component_columns() if column.entity_path == entity}
        assert {name.split(":")[-1] for name in named} == set(wanted), entity
        for name in named:
            expected, flat = wanted[name.split(":")[-1]], self.component(entity, name)
            while pa.types.is_list(flat.type) or pa.types.is_fixed_size_list(flat.type):
                flat = flat.flatten()
            found = flat.to_numpy(zero_copy_only=False)
            if name.split(":")[-1] in ("color", "colors"):
                colours = [(*colour, 255)[:4] for colour in np.asarray(expected).tolist()]
                expected = [
                    sum(int(c) << shift for c, shift in zip(rgba, (24, 16, 8, 0), strict=True)) for rgba in colours
                ]
            expected = np.ravel(expected)
            assert found.shape == expected.shape, (entity, name)
            if found.dtype.kind == "f":
                np.testing.assert_allclose(found, expected, rtol=2e-6, atol=2e-7, err_msg=f"{entity} {name}")
            else:
                np.testing.assert_array_equal(found, expected, err_msg=f"{entity} {name}")

    def times(self, entity: str, time_line: str) -> np.ndarray:
        """All times of an entity on one time line: numbers of a sequence, or ns of a duration."""
        batches = [chunk.to_record_batch() for chunk in self.store.stream().filter(content=entity)]
        columns = [batch.column(time_line) for batch in batches if time_line in batch.schema.names]
        return pa.chunked_array(columns).combine_chunks().cast(pa.int64()).to_numpy()

    def rules(self) -> list[str]:
        """The include rules of all views of the embedded blueprint."""
        found = []
        for chunk in self.blueprint.stream():
            batch = chunk.to_record_batch()
            if "ViewContents:query" in batch.schema.names:
                found += [rule for row in batch.column("ViewContents:query").to_pylist() for rule in row or []]
        return [rule.lstrip("+ ") for rule in found if rule.startswith("+")]

    def unmatched_rules(self) -> list[str]:
        """Include rules that no logged entity matches: the viewer would show an empty view and say nothing."""
        entities = self.entities()

        def matches(rule: str) -> bool:
            if rule.endswith("/**"):
                return any(entity == rule[:-3] or entity.startswith(rule[:-2]) for entity in entities)
            return rule in entities

        return [rule for rule in self.rules() if not matches(rule)]


def read_recording(path: Path) -> Reading:
    from rerun.chunk import RrdReader

    reader = RrdReader(path)
    (blueprint,) = reader.blueprints()
    return Reading(path, reader.stream().collect(), reader.stream(store=blueprint).collect())


def await_chunks(path: Path, enough: Callable[[list[Any]], bool], seconds: float = 600.0) -> list[Any]:
    """The chunks of a recording that another process is still writing, once there are ``enough``."""
    from rerun.chunk import RrdReader

    deadline, chunks = time.monotonic() + seconds, []
    while time.monotonic() < deadline and not enough(chunks):
        time.sleep(0.2)
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="RRD file has no footer")
            try:
                chunks = RrdReader(path).stream().to_chunks()
            except (RuntimeError, ValueError, OSError):  # not there yet, or the last message is half written
                chunks = []
    assert enough(chunks)
    return chunks


@pytest.fixture(scope="session")
def awaited() -> Callable[..., list[Any]]:
    return await_chunks


@pytest.fixture(scope="session")
def reader() -> Callable[[Path], Reading]:
    return read_recording


@pytest.fixture(scope="session")
def reading(comparison: Comparison, tmp_path_factory: pytest.TempPathFactory) -> Reading:
    return read_recording(record_comparison(comparison, tmp_path_factory.mktemp("run") / "errors.rrd"))


def demo_run_folder(folder: Path, comparison: Comparison) -> Run:
    """A run folder as `pickenv demo` writes it, as far as figures and report need it, with few poses."""
    plant, rng = comparison.plant, np.random.default_rng(0)
    sets = {
        name: simulated_tracker(plant, random_joints(plant.arm.nominal, n, rng), rng)
        for name, n in {"identification": 40, "test": 12}.items()
    }
    found = fit(plant.arm, sets["identification"], known_frames=True)
    errors = {"raw": 1e-3 * rng.normal(size=(12, 6)), "LS": 1e-4 * rng.normal(size=(12, 6))}
    with recorded_run(folder, "demo", "pickenv demo --seed 7", comparison.seed) as run:
        save_part(folder, comparison, comparison.seed)
        save_part(folder, trace_of(found, sets, errors), comparison.seed)
        found.calibration.save(folder / "calibration")
    return run


@pytest.fixture(scope="session")
def write_demo_run() -> Callable[[Path, Comparison], Run]:
    """`demo_run_folder` itself, for tests that change the comparison or the folder."""
    return demo_run_folder


@pytest.fixture(scope="session")
def demo_run(comparison: Comparison, tmp_path_factory: pytest.TempPathFactory) -> Run:
    """A complete run; not to be written to."""
    return demo_run_folder(tmp_path_factory.mktemp("run"), comparison)
