"""What a calibration leaves for its figures, recomputed from its fit and its measurements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import forward, load_plant
from pickenv.calibration import BpnnSettings, Conditions, fit, random_joints, simulated_tracker
from pickenv.inspect import trace_of


def rms(errors: np.ndarray) -> float:
    return float(np.sqrt(np.sum(errors * errors) / len(errors)))


@pytest.mark.parametrize("residual", [None, "bpnn", "rbf"])
def test_a_trace_tells_every_step_and_every_pose(residual: str | None) -> None:
    plant, rng = load_plant("qiao2026"), np.random.default_rng(0)
    train, more, test = (simulated_tracker(plant, random_joints(plant.arm.nominal, n, rng), rng) for n in (40, 36, 12))
    test = replace(test, conditions=Conditions(payload=rng.random(12), temperature=rng.random(12)))
    if residual is None:
        train = train.positions_only()
    found = fit(
        plant.arm,
        train,
        None if residual is None else more,
        known_frames=True,
        residual=residual or "bpnn",
        rng=rng,
        settings=BpnnSettings(epochs=5),
    )
    errors = {"raw": rng.normal(size=(12, 6)), "LS": rng.normal(size=(12, 6))}
    sets = {"identification": train, "network": more, "test": test}
    trace = trace_of(found, sets, errors)
    assert trace.nominal is found.calibration.nominal
    assert list(trace.sets) == list(sets) == list(trace.fingerprints)
    for name, data in sets.items():
        np.testing.assert_array_equal(trace.sets[name], data.joints)
        assert trace.fingerprints[name] == data.fingerprint()
    assert trace.errors == errors and trace.views == ()
    np.testing.assert_array_equal(trace.payload, test.conditions.payload)
    np.testing.assert_array_equal(trace.temperature, test.conditions.temperature)
    steps = found.identification.iterates
    assert len(trace.position_rms) == len(steps) > 2
    for k, (model, _) in enumerate(steps):
        difference = train.difference(model)
        assert trace.position_rms[k] == pytest.approx(rms(difference[:, :3]))
        if residual is not None:
            assert trace.attitude_rms[k] == pytest.approx(rms(difference[:, 3:]))
    assert (trace.attitude_rms is None) == (residual is None)
    assert trace.position_rms[-1] < 0.5 * trace.position_rms[0]
    if residual == "bpnn":
        np.testing.assert_array_equal(trace.loss, found.calibration.learnt.model.loss)
    else:
        assert trace.loss is None
    seen = found.identification.identifiability
    assert trace.names == seen.names
    assert np.flatnonzero(trace.kept).tolist() == sorted(seen.kept) and len(trace.kept) == len(seen.names)
    np.testing.assert_array_equal(trace.r_diagonal, seen.r_diagonal)
    np.testing.assert_array_equal(trace.singular_values, seen.singular_values)
    reach = forward(trace.nominal, test.joints).position - trace.nominal.base.position
    np.testing.assert_allclose(trace.extension, np.sqrt((reach**2).sum(axis=1)))
