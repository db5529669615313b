"""Each effect of a real arm against the closed form that a textbook gives."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from pickenv.arm import Load, Passage, attach, chain_of, frames, gravity_torques, load_plant, rotation_matrix
from pickenv.arm.effects.structure import (
    BoomBending,
    Harmonic,
    JointCompliance,
    TransmissionError,
    turn_horizontally,
)
from pickenv.base import GRAVITY

BOOM = BoomBending(joint=2, length=0.4, flexural_rigidity=1.2e4, end_mass=2.0, mass_per_length=1.8)


def bent(boom, payload, q, rotation, position=(0.0, 0.0, 0.0)):
    """Axes (rows x, y, z) and origin of the boom's tip frame after bending."""
    frame = (*(float(v) for v in rotation.T.ravel()), *position)
    at = SimpleNamespace(joints=q, load=Load((), (), payload))
    result = np.array(boom.flexure(at)(boom.joint, frame))
    return result[:9].reshape(3, 3), result[9:]


def driven_by(m, effect, q):
    """Where an effect's drives hold the joints of a command."""
    at = Passage(m, None, None, q)
    effect.act(at, ())
    return at.driven


def upright_to(z):
    """A rotation whose third axis is ``z``."""
    z = np.asarray(z, dtype=float) / np.linalg.norm(z)
    x = np.cross([0.3, 1.0, 0.2], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=-1)


@pytest.mark.parametrize("extension", [0.0, 0.3, 0.8])
@pytest.mark.parametrize("payload", [0.0, 0.25])
def test_a_level_boom_is_the_cantilever_of_the_textbook(extension, payload):
    axes, tip = bent(BOOM, payload, [0, 0, extension], upright_to([1, 0, 0]))
    length, rigidity = 0.4 + extension, 1.2e4
    force, weight = (2.0 + payload) * GRAVITY, 1.8 * GRAVITY
    sag = force * length**3 / (3 * rigidity) + weight * length**4 / (8 * rigidity)
    slope = force * length**2 / (2 * rigidity) + weight * length**3 / (6 * rigidity)
    np.testing.assert_allclose(tip, [0, 0, -sag], rtol=1e-12, atol=1e-18)
    np.testing.assert_allclose(axes[2], [math.cos(slope), 0, -math.sin(slope)], rtol=0, atol=1e-15)


def test_an_aluminium_boom_of_1200_mm_sags_by_tenths_of_a_millimetre():
    """60 x 60 x 3 mm tube, EI = 25.6e3 N m2, with 2 kg at its end."""
    tube = BoomBending(joint=2, length=1.2, flexural_rigidity=25.6e3, end_mass=2.0, mass_per_length=1.8)
    axes, tip = bent(tube, 0.0, [0, 0, 0.0], upright_to([0, 1, 0]))
    assert tip[2] * 1e3 == pytest.approx(-0.620, abs=2e-3)
    assert -axes[2][2] * 1e3 == pytest.approx(0.750, abs=2e-3)


def test_only_gravity_across_the_boom_bends_it():
    level = bent(BOOM, 0.0, [0, 0, 0.5], upright_to([1, 0, 0]))[1]
    raised = bent(BOOM, 0.0, [0, 0, 0.5], upright_to([math.cos(0.7), 0, math.sin(0.7)]))[1]
    np.testing.assert_allclose(
        raised, -level[2] * math.cos(0.7) * np.array([math.sin(0.7), 0, -math.cos(0.7)]), rtol=0, atol=1e-15
    )
    for end in (1, -1):
        assert not bent(BOOM, 0.0, [0, 0, 0.5], upright_to([0, 0, end]))[1].any()


def test_bending_only_turns_frames(draw):
    rng = np.random.default_rng(5)
    for z in rng.normal(size=(20, 3)):
        axes, _ = bent(BOOM, 0.25, [0, 0, 0.8], upright_to(z))
        np.testing.assert_allclose(axes @ axes.T, np.eye(3), rtol=0, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-6, 1e-3, 0.03])
def test_small_turns_are_rodrigues(angle):
    wx, wy = angle * math.cos(1.1), angle * math.sin(1.1)
    turned = np.array(turn_horizontally(tuple(np.eye(3).ravel()), wx, wy)).reshape(3, 3)
    np.testing.assert_allclose(turned.T, rotation_matrix([wx, wy, 0]), rtol=0, atol=1e-14)


def test_a_joint_yields_by_torque_over_stiffness():
    at = SimpleNamespace(pull=([], [50.0, -80.0]), joints=[0.1, 0.2])
    JointCompliance((1e4, 4e5)).act(at, ())
    yielded = at.joints
    np.testing.assert_allclose(yielded, [0.1 + 5e-3, 0.2 - 2e-4])


def test_gravity_torques_are_the_slope_of_the_potential_energy(draw):
    plant = load_plant("qiao2026")
    chain = chain_of(plant.geometry)
    load = Load(plant.load.mass, plant.load.centre, payload=0.25)

    def energy(q):
        found = frames(np, chain, q)
        total = load.payload * attach(found[-1], chain.tool)[11]
        for mass, (x, y, z), frame in zip(load.mass, load.centre, found[1:], strict=True):
            total += mass * (frame[11] + x * frame[2] + y * frame[5] + z * frame[8])
        return GRAVITY * total

    for q in draw(plant.geometry, 20):
        slope = [(energy(q + h) - energy(q - h)) / 2e-5 for h in 1e-5 * np.eye(6)]
        np.testing.assert_allclose(
            gravity_torques(chain, frames(np, chain, q), load), -np.array(slope), rtol=0, atol=1e-7
        )


def test_a_lead_error_grows_with_travel_and_a_harmonic_returns_after_its_period():
    error = TransmissionError(lead=(0.0, 1e-4), harmonics=(Harmonic(0, 3e-4, 1.5, 0.4), Harmonic(1, 5e-5, 0.4, -1.0)))
    at_zero = driven_by(math, error, [0.0, 0.0])
    np.testing.assert_allclose(at_zero, [3e-4 * math.sin(0.4), -5e-5 * math.sin(1.0)])
    after = driven_by(math, error, [1.5, 0.4])
    np.testing.assert_allclose(np.subtract(after, at_zero), [1.5, 0.4 * (1 + 1e-4)], rtol=1e-14)
    quarter = driven_by(math, error, [1.5 * (0.25 - 0.4 / (2 * math.pi)), 0.0])
    assert quarter[0] - 1.5 * (0.25 - 0.4 / (2 * math.pi)) == pytest.approx(3e-4)


def test_harmonics_of_one_joint_add_up():
    error = TransmissionError(lead=(0.0,), harmonics=(Harmonic(0, 1e-3, 1.0, 0.3), Harmonic(0, 2e-3, 0.5, 0.1)))
    expected = 0.2 + 1e-3 * math.sin(0.4 * math.pi + 0.3) + 2e-3 * math.sin(0.8 * math.pi + 0.1)
    assert driven_by(math, error, [0.2])[0] == pytest.approx(expected, abs=1e-15)
