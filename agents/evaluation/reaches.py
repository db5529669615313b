"""Runs of policies on seeded fruit, and the final distance between the tool's true position and the fruit."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import pickenv  # noqa: F401  (registers the environments)
from pickenv.agents.policies.policy import Policy, attitude_after, read_observation
from pickenv.arm import Array, Pose, displace_pose, forward
from pickenv.base import InputError, seed_words, stream
from pickenv.envs import PickVectorEnv, ReachVectorEnv
from pickenv.inspect.runs.recorded_episodes import Reaches as Reaches, believed_joints, reaches_of
from pickenv.orchard import Gripper, capture_probability, misalignment
from pickenv.wrappers import Compensate

FRUIT = ("collected", "damaged", "attempted", "reachable")
"""Names of the counts of fruit that `pick_canopies` returns for each canopy."""


def pick_canopies(
    policy: Any, envs: PickVectorEnv, seed: int | Sequence[int], options: dict[str, Any] | None = None
) -> dict[str, Array]:
    """Run a policy on one canopy in each of N environments, and sum up the outcomes.

    Args:
        policy: Policy that acts on observations ``(N, k)``.
        envs: The environments, which reset themselves after an episode.
        seed: Seed or seeds, passed to `reset`.
        options: Options, passed to `reset`.

    Returns:
        Arrays ``(N,)`` by name, one entry per canopy. The names in `FRUIT` hold numbers of fruit. "duration_s" and
        "steps" are duration and number of steps, and "reward" is the sum of the rewards. "error_sum_mm" sums the
        distance between the fruit and the tool's true position over all grasps. "tilt_sum_deg" sums the angle between
        the tool's true axis and the vertical over all grasps.
    """
    policy.reset()
    observation, _ = envs.reset(seed=seed, options=options)
    over, steps = np.zeros(envs.num_envs, dtype=np.bool_), 0
    sums = ("reward", "error_sum_mm", "tilt_sum_deg")
    totals = {name: np.zeros(envs.num_envs) for name in (*FRUIT, "duration_s", "steps", *sums)}
    grasps = np.zeros(envs.num_envs)
    while not over.all():
        fresh, rewards, terminated, truncated, infos = envs.step(policy.act(observation))
        steps += 1
        totals["reward"] += np.where(over, 0.0, rewards)
        grasped, grasps = ~over & (infos["attempted"] > grasps), np.where(over, grasps, infos["attempted"])
        totals["error_sum_mm"] += np.where(grasped, np.hypot(infos["grasp_lateral_mm"], infos["grasp_axial_mm"]), 0.0)
        totals["tilt_sum_deg"] += np.where(grasped, infos["tilt_deg"], 0.0)
        ended = (terminated | truncated) & ~over
        totals["steps"][ended] = steps
        for name in (*FRUIT, "duration_s"):
            totals[name][ended] = infos[name][ended]
        over |= ended
        observation = np.where(over[:, None], observation, fresh)  # canopies that are done ask for no thought
    return totals


LONGEST_EPISODE = 10_000
"""Number of steps after which an environment counts as having no time limit."""


def episode_seeds(seed: int, count: int) -> tuple[int, ...]:
    """Return seeds for ``count`` evaluation episodes; no other ``seed`` and no training uses them."""
    return tuple(seed_words(stream(seed, "fruit"), count))


class Moment(NamedTuple):
    """Reward and info of an episode after its reset or after one of its steps.

    Attributes:
        reward: Reward of the step; 0 after the reset.
        info: The environment's info.
        target: Joint values ``(n,)``, rad or m, to which the controller has sent the arm, and where it believes the arm
            to be. None if the environment does not report them.
    """

    reward: float
    info: Mapping[str, Any]
    target: Array | None = None


def run_episodes(
    env: gym.Env[Any, Any], policy: Policy, seeds: Sequence[int], progress: Callable[[int], None] | None = None
) -> list[list[Moment]]:
    """Run one episode per seed, and return the moments of each episode as a list.

    Args:
        env: An environment with a time limit.
        policy: Policy to run.
        seeds: One seed per episode.
        progress: Called after each episode with the number of episodes done.

    Raises:
        InputError: If there are no seeds, or an episode does not end within `LONGEST_EPISODE` steps.
    """
    if not seeds:
        raise InputError("there are no episodes to run; give at least one seed")
    episodes = []
    for done, seed in enumerate(seeds, start=1):
        observation, info = env.reset(seed=seed)
        policy.reset()
        moments = [Moment(0.0, info, believed_joints(env))]
        for _ in range(LONGEST_EPISODE):
            observation, reward, terminated, truncated, info = env.step(policy.act(observation))
            moments.append(Moment(float(reward), info, believed_joints(env)))
            if terminated or truncated:
                break
        else:
            raise InputError(
                f"an episode did not end within {LONGEST_EPISODE} steps; give the environment a time limit"
            )
        episodes.append(moments)
        if progress is not None:
            progress(done)
    return episodes


def run_reaches(
    env: gym.Env[Any, Any], policy: Policy, seeds: Sequence[int], progress: Callable[[int], None] | None = None
) -> Reaches:
    """Run one episode per seed, and return the final states of the episodes.

    Args:
        env: A reach environment with a time limit.
        policy: Policy to run.
        seeds: One seed per episode; the same seeds give the same fruit to every policy.
        progress: Called after each episode with the number of episodes done.

    Raises:
        InputError: If there are no seeds, or an episode does not end.
    """
    infos = [episode[-1].info for episode in run_episodes(env, policy, seeds, progress)]
    inner: Any = env.unwrapped
    return reaches_of(inner.plant.geometry, seeds, {key: np.array([info[key] for info in infos]) for key in infos[0]})


# Reaches of many arms at once in pickenv's vector environment: one environment for each pair of arm and fruit.


MOST_ROWS = 2048
"""Largest number of environments whose joints a compensator gets in one call, as many as in
`pickenv.envs.shared.arm_batch.NumpyArms.block`."""

PolicyMaker = Callable[[Any, int], Policy]
"""Function ``(env, seed)`` that makes a policy for an environment."""


@dataclass(frozen=True, eq=False)
class Rollout:
    """Final steps of R episodes on many arms, and the position error after each step.

    Attributes:
        reaches: Last step of each episode.
        arm: Index of each episode's arm among the arms that were run ``(R,)``, from 0.
        wanted_rotation: Wanted tool attitude of each episode ``(R, 3, 3)``, as a rotation matrix.
        error_mm: Distance between the tool's true position and the fruit after each step ``(steps, R)``.
    """

    reaches: Reaches
    arm: NDArray[np.int64]
    wanted_rotation: Array
    error_mm: Array

    def capture(self, gripper: Gripper) -> Array:
        """Return the probability ``(R,)`` that the gripper captures the fruit at the end of each episode."""
        target = Pose(np.zeros((len(self.arm), 3)), self.wanted_rotation)
        axis = displace_pose(target, self.reaches.pose_error).rotation[..., 2]
        offset = self.reaches.fruit_position - self.reaches.tool_position
        return capture_probability(gripper, *misalignment(offset, axis, self.wanted_rotation[..., 2]))

    def cycle_steps(self, tolerance_mm: float) -> Array:
        """Return the number of steps ``(R,)`` until the error stays within ``tolerance_mm``; NaN if it never does."""
        inside = np.flip(np.logical_and.accumulate(np.flip(self.error_mm <= tolerance_mm, axis=0), axis=0), axis=0)
        return np.where(inside.any(axis=0), inside.argmax(axis=0) + 1.0, np.nan)


def roll_out(
    make: PolicyMaker,
    arms: int,
    episodes: int,
    seed: int,
    *,
    compensators: Sequence[Compensate] | None = None,
    sequential: bool = False,
    steps: int = 60,
    first: int = 0,
    **arguments: Any,
) -> Rollout:
    """Run a policy on ``episodes`` fruit with each of ``arms`` arms.

    Args:
        make: Function ``(env, seed)`` that makes the policy; its attribute ``envs``, if it has one, makes the
            environments.
        arms: Number of arms to run. The population from which they are taken has ``first + arms`` arms.
        episodes: Number of fruit per arm. Fruit, arms and camera noise depend on ``seed`` alone, so that runs can be
            compared pair by pair.
        seed: Seed of the episodes and of the policy's own random draws.
        compensators: One compensator per arm, or None for raw arms.
        sequential: Whether each arm reaches for its fruit one after the other, for policies that learn from episode to
            episode.
        steps: Number of steps in an episode.
        first: Index (from 0) of the first arm to run in the population; the arms after it have the next indices.
        arguments: Further keyword arguments of `pickenv/Reach-v0`.

    Raises:
        InputError: If there are no arms or no episodes.
    """
    if arms < 1 or episodes < 1:
        raise InputError(f"there are {arms} arms and {episodes} episodes; give at least one of each")
    arguments |= {"arms": "per_episode", "population": first + arms}
    numbers = np.arange(arms)
    seeds = np.array(episode_seeds(seed, arms * episodes)).reshape(episodes, arms)
    # One round holds every arm once; rows of several rounds run side by side where nothing is learnt in between.
    rounds = 1 if sequential else max(1, min(episodes, MOST_ROWS // arms))
    parts: list[Rollout] = []
    policy: Policy | None = None
    env: ReachVectorEnv | None = None
    for begin in range(0, episodes, rounds):
        block = seeds[begin : begin + rounds]
        rows = np.tile(numbers, len(block))
        if env is None or env.num_envs != len(rows):
            envs: Callable[..., ReachVectorEnv] = getattr(make, "envs", ReachVectorEnv)
            env = envs(len(rows), max_episode_steps=None, autoreset_mode="Disabled", **arguments)
            if compensators is not None:
                env.compensator = [compensators[row] for row in rows.tolist()]
            policy = make(env, seed_words(stream(seed, "policy", begin), 1)[0])
        assert policy is not None
        parts.append(_run(env, policy, rows, block.ravel(), steps, first))
    return _joined(parts)


def _run(
    env: ReachVectorEnv, policy: Policy, rows: NDArray[np.int64], seeds: NDArray[np.int64], steps: int, first: int
) -> Rollout:
    observation, infos = env.reset(seed=seeds.tolist(), options={"arm": first + rows})
    geometry = env.task.plant.arm.nominal
    reading = read_observation(geometry, getattr(env, "raw", observation))
    target = attitude_after(forward(geometry, reading.joints), reading.turn)
    policy.reset()
    errors = []
    for _ in range(steps):
        observation, _, _, _, infos = env.step(policy.act(observation))
        errors.append(infos["position_error_mm"].copy())
    reaches = reaches_of(env.plant.geometry, seeds.tolist(), infos)
    return Rollout(reaches, rows.astype(np.int64), target, np.array(errors))


def _joined(parts: Sequence[Rollout]) -> Rollout:
    arrays = [field.name for field in fields(Reaches) if field.name != "seeds"]
    reaches = Reaches(
        seeds=tuple(seed for part in parts for seed in part.reaches.seeds),
        **{name: np.concatenate([getattr(part.reaches, name) for part in parts]) for name in arrays},
    )
    arm, target = (np.concatenate([getattr(part, name) for part in parts]) for name in ("arm", "wanted_rotation"))
    return Rollout(reaches, arm, target, np.concatenate([part.error_mm for part in parts], axis=1))
