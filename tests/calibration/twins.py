"""Calibrations written by hand, for tests of the plants made of them."""

from dataclasses import replace
from typing import Any

import numpy as np

from pickenv.arm import Arm, Geometry, Pose, rotation_matrix
from pickenv.calibration import ArmModel, Calibration, LearntResidual
from pickenv.calibration.model.arm_model import Term
from pickenv.calibration.residuals.gaussian_process import GaussianProcess
from pickenv.calibration.residuals.residual_models import JointInputs


def seen_from(geometry: Geometry, rng: np.random.Generator) -> Geometry:
    """An arm as an instrument beside it sees it: the base is turned about the vertical, base and tool are moved."""
    turn = rotation_matrix(np.array([0.0, 0.0, rng.uniform(0.5, 2.0)]))
    base = Pose(turn @ geometry.base.position + rng.uniform(-1, 1, 3), turn @ geometry.base.rotation)
    twist = rotation_matrix(rng.uniform(-0.3, 0.3, 3))
    tool = Pose(geometry.tool.position + rng.uniform(-0.02, 0.02, 3), geometry.tool.rotation @ twist)
    return replace(geometry, base=base, tool=tool)


def found_by_hand(
    arm: Arm,
    rng: np.random.Generator,
    *,
    terms: tuple[Term, ...] = (),
    size: float = 0.1,
    fitted: bool = True,
    learnt: LearntResidual | None = None,
    parameters: tuple[str, ...] = ("a2",),
    covariance: np.ndarray | None = None,
    dropped: dict[str, dict[str, float]] | None = None,
) -> Calibration:
    """A calibration whose links, and fitted frames, deviate by 0.1 mm and mrad; terms have ``size`` tolerances."""
    nominal = seen_from(arm.nominal, rng) if fitted else arm.nominal
    delta = np.zeros(len(nominal.parameter_names))
    delta[: 4 * nominal.links] = rng.uniform(-1e-4, 1e-4, 4 * nominal.links)
    if fitted:
        delta[-12:] = rng.uniform(-1e-4, 1e-4, 12)
    model = ArmModel.of(nominal.displaced(delta), terms)
    model = ArmModel(
        model.geometry, terms, size * rng.uniform(-1.0, 1.0, len(model.coefficients)) * model.term_tolerances
    )
    uncertainty: dict[str, Any] = {
        "parameters": list(parameters),
        "covariance": np.zeros((len(parameters),) * 2).tolist() if covariance is None else covariance.tolist(),
        "position_repeat_m": 3e-5,
        "attitude_repeat_rad": 1e-4,
    }
    record = {"uncertainty": uncertainty, "dropped": dropped or {}, "frames": "fitted" if fitted else "known"}
    return Calibration(arm.name, arm.nominal, nominal, model, learnt, record)


def process_by_hand(inputs: np.ndarray, rng: np.random.Generator, outputs: int = 3) -> GaussianProcess:
    """A process of known hyper-parameters on targets of its own kind: smooth functions and scatter."""
    lengths = rng.uniform(1.0, 2.5, (outputs, inputs.shape[1]))
    amplitude, noise = rng.uniform(0.8, 1.2, outputs), rng.uniform(0.2, 0.4, outputs)
    weights = []
    for j in range(outputs):
        smooth = kernel(inputs, inputs, lengths[j], amplitude[j])
        matrix = smooth + noise[j] ** 2 * np.eye(len(inputs))
        target = np.linalg.cholesky(matrix) @ rng.standard_normal(len(inputs))
        weights.append(np.linalg.solve(matrix, target))
    scale = np.repeat([1e-4, 2e-4], 3)[:outputs]
    return GaussianProcess(inputs, lengths, amplitude, noise, np.array(weights), np.full(outputs, 2e-5), scale)


def kernel(left: np.ndarray, right: np.ndarray, length: np.ndarray, amplitude: float) -> np.ndarray:
    """Squared exponential kernel, by the book."""
    apart = (left[:, None] - right[None]) / length
    return amplitude**2 * np.exp(-0.5 * np.sum(apart**2, axis=-1))


def learnt_by_hand(arm: Arm, rng: np.random.Generator, outputs: int = 3, periodic: bool = False) -> LearntResidual:
    """A Gaussian process on joints drawn evenly, the first one by sine and cosine if asked."""
    nominal = arm.nominal
    joints = rng.uniform(nominal.lower, nominal.upper, (60, nominal.joints))
    far = np.zeros(nominal.joints, dtype=bool)
    far[0] = periodic
    raw = np.concatenate([joints[:, ~far], np.sin(joints[:, far]), np.cos(joints[:, far])], axis=1)
    inputs = JointInputs(0, far, raw.mean(axis=0), raw.std(axis=0))
    return LearntResidual("gp", inputs, process_by_hand(inputs(joints), rng, outputs))
