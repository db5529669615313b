"""pickenv: closed-loop picking accuracy as a Gymnasium environment, and the calibration that makes an arm accurate.

    result = pickenv.calibrate("ur5", "tracker.csv", columns="my_tracker.toml")    # measurements in, judged result out
    plant = pickenv.load_plant("qiao2026")                                         # a simulated true arm
    env = gymnasium.make("pickenv/Reach-v0", plant="qiao2026")                     # and an environment around it
    env = pickenv.wrappers.CompensationWrapper(env, result.compensator())          # corrected between policy and arm

Importing pickenv registers the environments. Everything else, such as torch, stable-baselines3 and rerun, is loaded at
its first use.
"""

from importlib import metadata as _metadata

import gymnasium as _gymnasium

from pickenv.base import InputError as InputError
from pickenv.base.extras import offered as _offered

__getattr__, __dir__, __all__ = _offered("pickenv", __file__)


_REACH, _VECTOR = "pickenv.envs.reaching.reach:", "pickenv.envs.reaching.vector:"
_SCALED = "pickenv.envs.reaching.scaled:"
_HARVEST = "pickenv.envs.harvesting.harvest_env:"
_ENVIRONMENTS: dict[str, tuple[str, str | None, int]] = {
    "Reach": (f"{_REACH}ReachEnv", f"{_VECTOR}ReachVectorEnv", 60),
    "ReachGoal": (f"{_REACH}ReachGoalEnv", f"{_VECTOR}ReachGoalVectorEnv", 60),
    "ReachIdeal": (f"{_REACH}ReachIdealEnv", f"{_VECTOR}ReachIdealVectorEnv", 60),
    "ReachScaled": (f"{_SCALED}ReachScaledEnv", f"{_SCALED}ReachScaledVectorEnv", 60),
    "ReachTool": (f"{_SCALED}ReachToolEnv", f"{_SCALED}ReachToolVectorEnv", 60),
    "Harvest": (f"{_HARVEST}HarvestEnv", f"{_HARVEST}HarvestVectorEnv", 600),
    "PickScene": ("pickenv.envs.scene.pick_scene_env:PickSceneEnv", None, 300),
    "Pick": ("pickenv.envs.picking.pick:PickEnv", "pickenv.envs.picking.pick_vector:PickVectorEnv", 400),
}
"""Environments to register with Gymnasium, by name: class of one environment, class of a vector environment or None,
and largest number of steps of an episode. A class is given as text, so that its module is loaded only when an
environment is made."""

for _name, (_one, _many, _steps) in _ENVIRONMENTS.items():
    _gymnasium.register(f"pickenv/{_name}-v0", _one, vector_entry_point=_many, max_episode_steps=_steps)

try:
    __version__ = _metadata.version("pickenv")
except _metadata.PackageNotFoundError:  # a checkout that was never installed
    __version__ = "0.0.0"
