"""Steps per second of the peers' environments, measured inside their own environment of packages; prints JSON.

Random fresh actions, resets, rewards and observations included. Run by `benchmark_envs.py`; needs no pickenv.
"""

import json
import sys
import time
import warnings

import gymnasium as gym

PEERS = {"FetchReach-v4": "gymnasium_robotics", "PandaReach-v3": "panda_gym"}


def steps_per_second(name: str, seconds: float) -> float:
    """Steps per second of a single environment with Gymnasium's standard wrappers."""
    env = gym.make(name)
    env.reset(seed=0)
    env.action_space.seed(0)
    steps, begin = 0, time.perf_counter()
    while time.perf_counter() - begin < seconds:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        steps += 1
        if terminated or truncated:
            env.reset()
    rate = steps / (time.perf_counter() - begin)
    env.close()
    return rate


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    seconds, found = float(sys.argv[1]), {}
    for name, package in PEERS.items():
        try:
            gym.register_envs(__import__(package))
            found[name] = {"steps_per_s": steps_per_second(name, seconds), "note": ""}
        except Exception as error:  # a broken peer is reported, not hidden
            found[name] = {"steps_per_s": None, "note": f"{type(error).__name__}: {str(error)[:200]}"}
    print(json.dumps(found))
