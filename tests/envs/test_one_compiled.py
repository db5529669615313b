"""One environment as machine code: what it returns is what floats give, up to roundings."""

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import pickenv  # noqa: F401
from pickenv.base import InputError

pytest.importorskip("llvmlite")

LATE: dict[str, Any] = {"latency": [0, 1], "action_delay": [0, 1], "joint_noise": 0.05, "hours_on": [0.0, 8.0]}
WORLDS = [
    ("pickenv/Reach-v0", {"plant": "qiao2026"}),
    ("pickenv/Reach-v0", {"plant": "orchard", "feedback": "camera", "camera_noise_mm": 1.0, **LATE}),
    ("pickenv/Reach-v0", {"plant": "field"}),
    ("pickenv/Pick-v0", {"plant": "orchard", **LATE}),
    ("pickenv/Harvest-v0", {}),
]


@pytest.mark.parametrize(("name", "world"), WORLDS)
def test_steps_as_machine_code_are_those_on_floats(name: str, world: dict[str, Any]) -> None:
    plain = "numpy" if "Harvest" in name else "floats"
    fast, exact = (gym.make(name, executor=executor, **world) for executor in ("auto", plain))
    for seed in (0, 1):
        np.testing.assert_array_equal(fast.reset(seed=seed)[0], exact.reset(seed=seed)[0])
        rng = np.random.default_rng(seed)
        for _ in range(25):
            action = rng.uniform(-1.0, 1.0, exact.action_space.shape)
            seen, reward, *_, info = fast.step(action)
            other, paid, *_, told = exact.step(action)
            np.testing.assert_allclose(seen, other, atol=2e-6)
            assert reward == pytest.approx(paid, abs=1e-9)
            if "position_error_mm" in told:
                assert info["position_error_mm"] == pytest.approx(told["position_error_mm"], abs=1e-8)


def test_a_population_stays_on_floats_and_says_so_where_code_is_asked_for() -> None:
    world = {"plant": "field", "arms": "per_episode", "population": 3}
    auto, exact = gym.make("pickenv/Reach-v0", **world), gym.make("pickenv/Reach-v0", executor="floats", **world)
    auto.reset(seed=3), exact.reset(seed=3)
    np.testing.assert_array_equal(auto.step(np.ones(6))[0], exact.step(np.ones(6))[0])
    with pytest.raises(InputError, match="a population of arms is not compiled; give executor='floats'"):
        gym.make("pickenv/Reach-v0", executor="compiled", **world)
