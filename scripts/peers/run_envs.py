"""Steps and frames per second of the peers' environments, in an environment of packages of their own; prints JSON.

Random fresh actions, resets, rewards and observations included; of frames render() alone is timed. Run by
`benchmark_envs.py` and, with the word frames behind the seconds, by `benchmark_pictures.py`; needs no pickenv.
"""

import json
import sys
import time
import warnings
from collections.abc import Callable

import gymnasium as gym

SIZE = {"width": 480, "height": 360}
PEERS = {"FetchReach-v4": "gymnasium_robotics", "PandaReach-v3": "panda_gym"}
TOUCHING = {"FetchPickAndPlace-v4": "gymnasium_robotics"}  # of which no frames are timed


def stepper(env: gym.Env) -> Callable[[], int]:
    """A function that takes a random step, and begins again where an episode ends."""
    env.reset(seed=0)
    env.action_space.seed(0)

    def step() -> int:
        _, _, terminated, truncated, _ = env.step(env.action_space.sample())
        if terminated or truncated:
            env.reset()
        return 1

    return step


def steps_per_second(name: str, seconds: float) -> float:
    """Steps per second of the processor's time of a single environment with Gymnasium's standard wrappers."""
    step = stepper(gym.make(name))
    steps, begin = 0, time.process_time()
    while time.process_time() - begin < seconds:
        steps += step()
    return steps / (time.process_time() - begin)


def frames_per_second(name: str, seconds: float) -> list[float]:
    """Frames that render() draws per second of processor time, and per second; steps between them are left out."""
    size = SIZE if name.startswith("Fetch") else {f"render_{side}": length for side, length in SIZE.items()}
    return drawn_per_second(gym.make(name, render_mode="rgb_array", **size), seconds)


def drawn_per_second(env: gym.Env, seconds: float) -> list[float]:
    """The same of an environment, the first frame left out; it is closed."""
    step = stepper(env)
    env.render()
    frames, processor, wall = 0, 0.0, 0.0
    while wall < seconds:
        step()
        begin, began = time.process_time(), time.perf_counter()
        env.render()
        processor, wall = processor + time.process_time() - begin, wall + time.perf_counter() - began
        frames += 1
    env.close()
    return [frames / processor, frames / wall]


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    seconds, found = float(sys.argv[1]), {}
    key, measure = ("frames_per_s", frames_per_second) if "frames" in sys.argv else ("steps_per_s", steps_per_second)
    for name, package in (PEERS | ({} if "frames" in sys.argv else TOUCHING)).items():
        try:
            gym.register_envs(__import__(package))
            found[name] = {key: measure(name, seconds), "note": ""}
        except Exception as error:  # a broken peer is reported, not hidden
            found[name] = {key: None, "note": f"{type(error).__name__}: {str(error)[:200]}"}
    print(json.dumps(found))
