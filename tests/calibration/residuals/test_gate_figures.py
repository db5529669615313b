"""The figures of a gate's verdict against root mean squares of their own rows, and its margins from both sides."""

import numpy as np
import pytest

from pickenv.arm import Geometry, Pose, displace_pose, forward
from pickenv.base import InputError
from pickenv.calibration import Conditions, GateVerdict, Measurements, blocked_split, gate_residuals
from pickenv.calibration.residuals.residual_models import selected, verdicts_record

ROWS = 100


class Constant:
    """A model that says the same everywhere."""

    def __init__(self, value) -> None:
        self.value = np.asarray(value, dtype=float)

    def predict(self, inputs: np.ndarray) -> np.ndarray:
        return np.broadcast_to(self.value, (len(inputs), len(self.value)))

    def arrays(self) -> dict[str, np.ndarray]:
        return {}


def saying(value):
    return lambda *_: Constant(value)


def measured(nominal: Geometry, error: np.ndarray, **more) -> Measurements:
    """The nominal arm with these errors ``(N, 6)`` or ``(N, 3)``, at poses so far apart that each is a fact."""
    joints = 5.0 * np.random.default_rng(1).uniform(nominal.lower, nominal.upper, (len(error), nominal.joints))
    pose: Pose = forward(nominal, joints)
    if error.shape[1] == 3:
        return Measurements(joints, pose.position + error, None, nominal.prismatic, **more)
    return Measurements(joints, *displace_pose(pose, error), nominal.prismatic, **more)


def judged(qiao, error, fitters, seed=0, **more) -> tuple[GateVerdict, ...]:
    return gate_residuals(
        measured(qiao.nominal, error),
        lambda _: qiao.nominal,
        np.random.default_rng(seed),
        models=tuple(fitters),
        fitters=fitters,
        **more,
    )


def rms(vectors):
    return np.sqrt(np.mean(vectors[:, 0] ** 2 + vectors[:, 1] ** 2 + vectors[:, 2] ** 2))


@pytest.mark.parametrize("columns", [6, 3])
def test_every_figure_of_a_verdict_is_the_root_mean_square_of_its_own_rows(qiao, columns):
    """Errors of another size on every row, so that no two sets of rows have the same figure."""
    rng = np.random.default_rng(7)
    error = np.linspace(1.0, 3.0, ROWS)[:, None] * rng.normal([1e-3] * 3 + [4e-4] * 3, 2e-4, (ROWS, 6))[:, :columns]
    said = np.array([1e-3, 2e-3, 1.5e-3, 2e-4, 3e-4, 4e-4])[:columns]
    found = judged(qiao, error, {"rbf": saying(said), "gp": saying(0.5 * said)}, seed=5)
    train, held = blocked_split(np.arange(ROWS), 20)
    for verdict, value in zip(found, (said, 0.5 * said), strict=True):
        assert verdict.geometric_blocked_rms == pytest.approx(rms(error[held]))
        assert verdict.blocked_rms == pytest.approx(rms(error[held] - value))
        assert verdict.geometric_inner_rms == pytest.approx(rms(error[train]))
        assert verdict.inner_rms == pytest.approx(rms(error[train] - value))
        if columns == 6:
            assert verdict.geometric_blocked_attitude_rms == pytest.approx(rms(error[held][:, 3:]))
            assert verdict.blocked_attitude_rms == pytest.approx(rms((error[held] - value)[:, 3:]))
        else:
            assert verdict.blocked_attitude_rms is verdict.geometric_blocked_attitude_rms is None
        assert verdict.accepted
        gain = 1 - verdict.blocked_rms / verdict.geometric_blocked_rms
        assert verdict.reason == f"cuts the blocked RMS by {gain:.0%}"
    best = min(found, key=lambda verdict: verdict.inner_rms)
    assert selected(found) == best.model


def test_a_model_that_could_not_be_fitted_has_no_figures_and_geometry_keeps_its_own(qiao):
    error = np.linspace(1e-3, 3e-3, ROWS)[:, None] * np.ones(6)

    def refusing(*_):
        raise InputError("too few")

    found = judged(qiao, error[:25], {"rbf": refusing}, seed=5)
    (verdict,) = found
    held = blocked_split(np.arange(25), 5)[1]
    assert verdict.blocked_rms is verdict.blocked_attitude_rms is None
    assert verdict.geometric_blocked_rms == pytest.approx(rms(error[held]))
    assert verdict.geometric_blocked_attitude_rms == pytest.approx(rms(error[held][:, 3:]), rel=1e-6)
    assert verdict.reason == "not fitted: too few"
    assert verdict.inner_rms is verdict.geometric_inner_rms is None and not verdict.accepted
    assert selected(found) is None


@pytest.mark.parametrize(("gain", "accepted"), [(0.0199, False), (0.0201, True), (-0.05, False)])
def test_a_gain_must_be_more_than_2_percent(qiao, gain, accepted):
    error = np.repeat([[1e-3, 0.0, 0.0, 0.0, 0.0, 0.0]], ROWS, axis=0)
    (verdict,) = judged(qiao, error, {"rbf": saying(gain * error[0])})
    assert verdict.accepted == accepted
    assert ("no gain" in verdict.reason) == (not accepted)
    assert f"{'cuts' if gain > 0 else 'raises'} the blocked RMS by {abs(gain):.0%}" in verdict.reason


@pytest.mark.parametrize(("gain", "accepted"), [(0.0199, False), (0.0201, True)])
def test_and_as_much_within_the_training_rows(qiao, gain, accepted):
    """The held-out blocks are four times as large, and half of them is explained."""
    error = np.repeat([[1e-3, 0.0, 0.0, 0.0, 0.0, 0.0]], ROWS, axis=0)
    error[blocked_split(np.arange(ROWS))[1], 0] = gain * 2e-3
    (verdict,) = judged(qiao, error, {"rbf": saying(gain * 1e-3 * np.eye(6)[0])})
    assert verdict.blocked_rms == pytest.approx(0.5 * verdict.geometric_blocked_rms)
    assert verdict.accepted == accepted and verdict.inner_rms == pytest.approx((1 - gain) * 1e-3)
    if not accepted:
        assert verdict.reason == (
            "no gain: cuts the blocked RMS by 2% cross-validated over the other blocks (cuts the blocked RMS by 50%)"
        )


@pytest.mark.parametrize(("loss", "accepted"), [(0.0199, True), (0.0201, False)])
def test_attitudes_may_lose_2_percent_and_no_more(qiao, loss, accepted):
    error = np.repeat([[1e-3, 0.0, 0.0, 0.0, 1e-4, 0.0]], ROWS, axis=0)
    (verdict,) = judged(qiao, error, {"rbf": saying([5e-4, 0, 0, 0, -loss * 1e-4, 0])})
    assert verdict.accepted == accepted
    if not accepted:
        assert verdict.reason == "no gain: positions gain 50%, but attitudes lose 2%"


def test_payload_and_temperature_reach_the_model_when_it_learns_and_when_it_is_asked(qiao):
    asked = []

    class Listening(Constant):
        def predict(self, inputs):
            asked.append(inputs.shape)
            return super().predict(inputs)

    data = measured(
        qiao.nominal, np.full((ROWS, 6), 1e-4), conditions=Conditions(np.linspace(0, 1, ROWS), np.linspace(2, 5, ROWS))
    )
    learnt = []

    def fitter(inputs, *_):
        learnt.append(inputs.shape)
        return Listening(np.full(6, 1e-4))

    gate_residuals(data, lambda _: qiao.nominal, np.random.default_rng(0), models=("rbf",), fitters={"rbf": fitter})
    width = learnt[0][1]
    assert 8 <= width < 14  # six joints, some of which count twice, and two conditions
    assert learnt == [(80, width)] + [(64, width)] * 5 and sorted(asked) == [(16, width)] * 5 + [(20, width)]


def test_every_model_draws_for_itself(qiao):
    """Its numbers are the same whichever models are judged after it, and on every split."""
    drawn = {}

    def fitter(name):
        def fit(_, targets, rng):
            drawn.setdefault(name, []).append(rng.random())
            return Constant(np.zeros(6))

        return fit

    error = np.full((ROWS, 6), 1e-4)
    judged(qiao, error, {"rbf": fitter("rbf"), "gp": fitter("gp")})
    assert len(set(drawn["rbf"])) == len(set(drawn["gp"])) == 1 and drawn["rbf"] != drawn["gp"]


def test_reports_are_in_mm_and_degrees():
    verdict = GateVerdict("gp", 2e-3, 4e-3, np.radians(0.5), np.radians(0.7), 5e-3, 6e-3, True, "why")
    assert selected((verdict,)) == "gp"
    assert verdicts_record((verdict,))["gp"] == {
        "accepted": True,
        "reason": "why",
        "blocked_rms_mm": pytest.approx(2.0),
        "geometric_blocked_rms_mm": pytest.approx(4.0),
        "blocked_attitude_rms_deg": pytest.approx(0.5),
        "geometric_blocked_attitude_rms_deg": pytest.approx(0.7),
        "inner_rms_mm": pytest.approx(5.0),
        "geometric_inner_rms_mm": pytest.approx(6.0),
    }
    bare = GateVerdict("gp", 2e-3, 4e-3, None, None)
    assert verdicts_record((bare,))["gp"]["inner_rms_mm"] is None
