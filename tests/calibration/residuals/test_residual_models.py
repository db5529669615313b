"""Residual models learn what geometry leaves, from joints and conditions, and survive saving without pickle."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pickenv.arm import Plant
from pickenv.base import InputError
from pickenv.base.registry import get, names
from pickenv.calibration import (
    Bpnn,
    BpnnSettings,
    Fitter,
    LearntResidual,
    fit_residual,
    identify,
    link_model,
    random_joints,
    simulated_tracker,
    train_bpnn,
)
from pickenv.calibration.residuals import bpnn
from pickenv.calibration.residuals.gaussian_process import GaussianProcess, Rbf, k_means
from pickenv.calibration.residuals.residual_models import joint_inputs

PRISMATIC = (False, True, False)
QUICK: dict[str, Fitter] = {name: get("residual", name).fit for name in names("residual")}
QUICK["bpnn"] = lambda x, y, rng: train_bpnn(x, y, rng, BpnnSettings(epochs=60))
BRIEF = QUICK | {"bpnn": lambda x, y, rng: train_bpnn(x, y, rng, BpnnSettings(epochs=6))}
"""Where nothing need be learnt well."""


def field(joints: np.ndarray, outputs: int = 6) -> np.ndarray:
    """A smooth residual of a few tenths of mm and mrad over one turn, a slide of 1 m, and a small swing."""
    turn, slide, swing = joints[..., 0], joints[..., 1], joints[..., 2]
    parts = [np.sin(turn), slide**2, np.cos(turn) * slide, swing, np.sin(turn + swing), np.ones_like(turn)]
    return 3e-4 * np.stack(parts, -1)[..., :outputs]


def drawn(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform([-np.pi, 0.0, -0.5], [np.pi, 1.0, 0.5], (count, 3))


@pytest.fixture(scope="module", params=[(name, outputs) for name in QUICK for outputs in (6, 3)], ids=str)
def learnt(request: pytest.FixtureRequest) -> LearntResidual:
    """Each model, learnt from poses and from positions."""
    name, outputs = request.param
    joints, rng = drawn(300), np.random.default_rng(1)
    return fit_residual(name, joints, field(joints, outputs), PRISMATIC, rng, fitter=QUICK[name])


def outputs_of(model: LearntResidual) -> int:
    return int(model.predict(drawn(1)).shape[-1])


def test_a_smooth_residual_is_learnt(learnt: LearntResidual) -> None:
    joints = drawn(500, seed=2)
    truth = field(joints, outputs_of(learnt))
    left = truth - learnt.predict(joints)
    assert np.sqrt(np.mean(left**2)) < 0.3 * np.sqrt(np.mean((truth - truth.mean(axis=0)) ** 2))


@pytest.mark.parametrize("there", [True, False], ids=["compiled", "in NumPy"])
def test_a_faster_network_is_nearly_the_same_and_other_models_are(
    learnt: LearntResidual, there: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if there:
        pytest.importorskip("llvmlite")
    monkeypatch.setattr(bpnn, "is_there", lambda name: there)
    joints = drawn(200, seed=5)
    fast = learnt.faster()
    apart = np.abs(fast.predict(joints) - learnt.predict(joints)).max()
    if isinstance(learnt.model, Bpnn):
        assert 0.0 < apart < 1e-5 * np.abs(learnt.predict(joints)).max()
    else:
        assert fast is learnt


def test_leading_dimensions_are_kept(learnt: LearntResidual) -> None:
    joints = drawn(24, seed=3)
    flat = learnt.predict(joints)
    np.testing.assert_allclose(learnt.predict(joints.reshape(2, 3, 4, 3)), flat.reshape(2, 3, 4, -1), atol=1e-12)
    np.testing.assert_allclose(learnt.predict(joints[5]), flat[5], atol=1e-12)


def test_saved_without_pickle_it_predicts_the_same(learnt: LearntResidual, tmp_path: Path) -> None:
    np.savez(tmp_path / "model.npz", allow_pickle=False, **learnt.arrays())
    with np.load(tmp_path / "model.npz", allow_pickle=False) as archive:
        again = LearntResidual.from_arrays(dict(archive))
    joints = drawn(50, seed=4)
    np.testing.assert_array_equal(again.predict(joints), learnt.predict(joints))
    assert again.kind == learnt.kind


def test_a_full_turn_later_the_residual_is_the_same(learnt: LearntResidual) -> None:
    joints = drawn(50, seed=5)
    np.testing.assert_allclose(
        learnt.predict(joints + np.array([2 * np.pi, 0.0, 0.0])), learnt.predict(joints), rtol=0.0, atol=1e-9
    )


@pytest.mark.parametrize("name", BRIEF)
def test_equal_generators_give_equal_models(name: str) -> None:
    joints = drawn(60)
    first, second = (
        fit_residual(name, joints, field(joints, 2), PRISMATIC, np.random.default_rng(7), fitter=BRIEF[name])
        for _ in range(2)
    )
    np.testing.assert_array_equal(first.predict(joints), second.predict(joints))


@pytest.mark.parametrize("name", [pytest.param(name, marks=[pytest.mark.slow] * (name == "bpnn")) for name in QUICK])
def test_a_condition_that_changes_is_learnt_only_where_it_is_given(name: str) -> None:
    """Payload scales the residual: a model of joints alone misses by its spread, one that knows it does not."""
    rng = np.random.default_rng(8)
    joints, payload = drawn(120), rng.uniform(0.0, 1.0, (120, 1))
    later, heavier = drawn(200, seed=9), np.ones((200, 1))
    truth, seen = field(later, 3) * 2.0, field(joints, 3) * 2.0 * payload
    blind = fit_residual(name, joints, seen, PRISMATIC, rng, fitter=QUICK[name])
    knowing = fit_residual(name, joints, seen, PRISMATIC, rng, conditions=payload, fitter=QUICK[name])
    missed = [np.sqrt(np.mean((truth - p) ** 2)) for p in (blind.predict(later), knowing.predict(later, heavier))]
    assert missed[1] < 0.7 * missed[0]
    with pytest.raises(InputError, match="needs 1 conditions"):
        knowing.predict(later)
    with pytest.raises(InputError, match="needs 0 conditions"):
        blind.predict(later, heavier)


@pytest.mark.parametrize("name", BRIEF)
def test_a_joint_that_never_moved_does_no_harm(name: str) -> None:
    joints = drawn(100)
    joints[:, 1] = 0.4
    model = fit_residual(name, joints, np.zeros((100, 3)), PRISMATIC, np.random.default_rng(0), fitter=BRIEF[name])
    np.testing.assert_allclose(model.predict(joints), 0.0, atol=1e-6)


def test_only_joints_that_turn_far_enter_by_sine_and_cosine() -> None:
    inputs = joint_inputs(drawn(200), PRISMATIC)
    np.testing.assert_array_equal(inputs.periodic, [True, False, False])
    values = inputs(drawn(200))
    assert values.shape == (200, 4)
    np.testing.assert_allclose(values.mean(axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(values.std(axis=0), 1.0)


@pytest.mark.parametrize("name", ["rbf", "gp"])
def test_far_from_its_data_a_smooth_model_predicts_the_mean(name: str) -> None:
    joints = drawn(60)
    seen = field(joints, 2)
    model = fit_residual(name, joints, seen, PRISMATIC, np.random.default_rng(0))
    np.testing.assert_allclose(model.predict([0.0, 1e4, 0.0]), seen.mean(axis=0), atol=1e-9)


def test_centres_are_means_of_their_points() -> None:
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.normal(m, 0.01, (50, 2)) for m in (0.0, 5.0, 10.0)])
    centres = k_means(points, 12, rng, 50)
    assert len(centres) == 12
    assert np.abs(centres[:, :1] - [0.0, 5.0, 10.0]).min(axis=1).max() < 0.05


def test_bad_input_is_refused() -> None:
    joints, rng = drawn(100), np.random.default_rng(0)
    with pytest.raises(InputError, match="there is no residual 'magic'; give one of bpnn, rbf, gp"):
        fit_residual("magic", joints, field(joints), PRISMATIC, rng)
    with pytest.raises(InputError, match="not all finite"):
        fit_residual("gp", joints, field(joints) * np.nan, PRISMATIC, rng)
    for fitter in (Rbf.fit, GaussianProcess.fit):
        with pytest.raises(InputError, match="9 poses are too few"):
            fitter(joints[:9], field(joints[:9]), rng)
    model = fit_residual("rbf", joints, field(joints), PRISMATIC, rng)
    with pytest.raises(InputError, match=r"joints have shape \(4, 6\), but the residual has 3 joints"):
        model.predict(np.zeros((4, 6)))


def test_entering_calibration_does_not_load_torch() -> None:
    code = "import sys, pickenv.calibration.residuals.residual_models; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], cwd=Path(__file__).parents[3], check=False).returncode == 0


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_an_rbf_network_on_the_papers_arm_after_least_squares(dynamic: Plant, seed: int) -> None:
    """100 poses for geometry, 200 for the residual, as in the paper; least squares alone leaves 0.5 mm mean."""
    rng, nominal = np.random.default_rng(seed), dynamic.arm.nominal
    sets = [simulated_tracker(dynamic, random_joints(nominal, n, rng), rng) for n in (100, 200, 1000)]
    geometry = identify(link_model(nominal), nominal, sets[0]).geometry
    model = fit_residual("rbf", sets[1].joints, sets[1].difference(geometry), nominal.prismatic, rng)
    left = sets[2].difference(geometry) - model.predict(sets[2].joints)
    assert np.linalg.norm(left[:, :3], axis=1).mean() * 1e3 <= 0.30
