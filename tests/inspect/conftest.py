from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import Geometry, Plant, Pose, forward, inverse, load_plant, parameter_jacobian, pose_error
from pickenv.arm.geometry import Array
from pickenv.inspect.comparison import Comparison, PolicyErrors

CELLS, STEP = 10, 0.055


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


def synthetic_comparison(seed: int = 7, reaches: int = 100, tolerance_mm: float = 1.0) -> Comparison:
    """Raw, LS and LS + BPNN on the arm of Qiao 2026; LS fits the geometry, BPNN removes most of what is left."""
    plant = load_plant("qiao2026")
    nominal, rng = plant.arm.nominal, np.random.default_rng(seed)
    identified = identified_geometry(plant, rng)
    middle = forward(nominal, (nominal.lower + nominal.upper) / 2.0)
    origin = middle.position - (CELLS - 1) / 2.0 * STEP
    index = np.stack(np.meshgrid(*[np.arange(CELLS)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    points = origin + STEP * index
    fruit = origin + STEP * (CELLS - 1) * rng.random((reaches, 3))
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
        final_mm = np.linalg.norm(errors[len(points) :][picks], axis=-1) * 1e3
        policies.append(
            PolicyErrors(
                key=key,
                label=label,
                field_errors=errors[: len(points)][cells],
                reach_joints=q[len(points) :][picks],
                reach_positions=pose.position[len(points) :][picks],
                position_error_mm=final_mm,
                attitude_error_deg=0.05 * final_mm,
                success=final_mm <= tolerance_mm,
            )
        )
    return Comparison(
        plant=plant,
        nominal=nominal,
        identified=identified,
        seed=seed,
        tolerance_mm=tolerance_mm,
        grid_shape=(CELLS, CELLS, CELLS),
        grid_origin=origin,
        grid_step=STEP,
        field_index=index[cells],
        field_points=points[cells],
        fruit=fruit[picks],
        policies=tuple(policies),
    )


@pytest.fixture(scope="session")
def comparison() -> Comparison:
    return synthetic_comparison()


def without_policies(comparison: Comparison, count: int) -> Comparison:
    """The same comparison with its first `count` policies only."""
    return replace(comparison, policies=comparison.policies[:count])
