"""Contenders of a comparison (a policy, and the compensator between it and the arm), and their runs on seeded fruit.

A name on the command line is a registered policy, a shipped baseline, a policy file, or a folder of trainings. The
result of a run is the final distance between the tool's true position and the fruit.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from inspect import signature
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import pickenv  # noqa: F401  (registers the environments)
from pickenv.agents.policies import foreign
from pickenv.agents.policies.adaptive import RememberingPolicy, RememberingReach, load_remembering, remembers
from pickenv.agents.policies.learned import LearnedPolicy, LearnedReach, load_policy
from pickenv.agents.policies.policy import Policy, attitude_after, read_observation
from pickenv.arm import Arm, Array, Pose, displace_pose, forward
from pickenv.base import InputError, count_of, obey, read_container, seed_words, stream
from pickenv.base.registry import get, names
from pickenv.calibration import Calibration
from pickenv.envs import FEEDBACK, PickVectorEnv, ReachToolVectorEnv, ReachVectorEnv
from pickenv.envs.shared.task import make_tool_task
from pickenv.inspect.colours import policy_key, policy_rank
from pickenv.inspect.runs.comparison_summary import stage_label
from pickenv.inspect.runs.recorded_episodes import Reaches as Reaches, believed_joints, reaches_of
from pickenv.orchard import Gripper, capture_probability, misalignment
from pickenv.wrappers import Compensate, ToolSteps

FRUIT = ("collected", "damaged", "attempted", "reachable")


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


def episode_seeds(seed: int, count: int) -> tuple[int, ...]:
    """Return seeds for ``count`` evaluation episodes; no other ``seed`` and no training uses them."""
    return tuple(seed_words(stream(seed, "fruit"), count))


class Moment(NamedTuple):
    """Reward and info of an episode after its reset or after one of its steps.

    Attributes:
        reward: Reward of the step; 0 after the reset.
        info: The environment's info.
        target: Joint values ``(n,)``, rad or m, to which the controller has sent the arm. The controller believes that
            the arm is there. None if the environment does not report them.
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
        InputError: If there are no seeds, or an episode does not end within `LONGEST_EPISODE` steps, after which the
            environment counts as having no time limit.
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
PolicyMaker = Callable[[Any, int], Policy]


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
        raise InputError(f"{count_of(arms, 'arm')} and {count_of(episodes, 'episode')} are too few; give one of each")
    arguments |= {"arms": "per_episode", "population": first + arms}
    numbers = np.arange(arms)
    seeds = np.array(episode_seeds(seed, arms * episodes)).reshape(episodes, arms)
    # One round holds every arm once; rows of several rounds run side by side where nothing is learnt in between. A
    # compensator gets the joints of at most `MOST_ROWS` of them in one call, as many as in `NumpyArms.block`.
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


@dataclass(frozen=True)
class Kind:
    """Properties of a policy that an evaluation needs to know.

    Attributes:
        feedback: Feedback that the policy can use: "encoders", "camera".
        sequential: Whether the policy learns from episode to episode. The registered function that makes it then also
            takes ``camera_noise_mm``, mm per axis, and ``compensation``, the compensation between policy and arm.
        raw_only: Whether the policy is evaluated only without a compensator, because it corrects the arm's errors
            itself.
        files: Policy files, one per training seed; empty for a registered policy.
        moves_tool: Whether the policy acts in `pickenv/ReachTool-v0`, where fruit hangs at other places than in
            `pickenv/Reach-v0`.
        picks: Whether the policy acts in `pickenv/Pick-v0`; such a policy cannot act in reach environments.
    """

    feedback: tuple[str, ...] = FEEDBACK
    sequential: bool = False
    raw_only: bool = False
    files: tuple[str, ...] = ()
    moves_tool: bool = False
    picks: bool = False

    @property
    def steps(self) -> int:
        """Number of steps of each episode in which the policy is evaluated.

        It is smaller for a policy that learns from pick to pick. The longest move takes 20 steps.
        """
        return 30 if self.sequential else 60


def kind_of(name: str) -> Kind:
    """Return the properties of a policy, given its name.

    Args:
        name: Registered policy, shipped baseline, policy file, or folder of a training with one or several
            seeds.

    Raises:
        InputError: If ``name`` is none of these.
    """
    if name in names("policy"):
        maker, traits = get("policy", name), ("feedback", "sequential", "raw_only")
        return Kind(**{trait: getattr(maker, trait) for trait in traits if hasattr(maker, trait)})
    if Path(name).suffix in foreign.SUFFIXES:
        return Kind(files=(name,))
    if Path(name).is_dir():
        policy_file = Path(name) / "policy.npz"  # of one training
        files = tuple(map(str, [policy_file] if policy_file.is_file() else sorted(Path(name).glob("*/policy.npz"))))
        return replace(_kind_of_files(name, files), files=files)
    try:
        policy = load_any(name)
    except InputError as error:
        if name.endswith(".npz"):
            raise
        raise InputError(
            f"unknown policy '{name}'; give {', '.join(names('policy'))}, a shipped baseline, a file or a folder of "
            "trainings"
        ) from error
    return replace(_kind_of_policy(policy), files=(name,))


def load_any(name: str, arm: Arm | None = None) -> LearnedPolicy | RememberingPolicy:
    """Load a shipped baseline or a policy file, with or without a memory.

    Args:
        name: Name of a shipped baseline, or path of a policy file (.npz).
        arm: Arm for which the policy must have been trained; None to skip this check.

    Raises:
        InputError: If the file is missing, damaged, newer than this program, or of another arm.
    """
    return load_remembering(name, arm) if remembers(name) else load_policy(name, arm)


def maker_of(name: str, camera_noise_mm: float = 0.0, compensation: str = "raw") -> PolicyMaker:
    """Return a function ``(env, seed)`` that makes a policy for an environment.

    The function's attribute ``envs`` makes the environments in which `roll_out` evaluates the policy.

    Args:
        name: Name of a registered or shipped policy, or a policy file (.npz, or as `foreign_policy` takes it).
        camera_noise_mm: Standard deviation of the camera noise that an adaptive policy assumes, mm per axis.
        compensation: Name of the compensation between the policy and the arm, such as "ls"; "raw" for none.

    Raises:
        InputError: If the policy acts in `pickenv/Pick-v0` and cannot reach, or ``name`` names no policy.
    """

    def make(env: Any, seed: int) -> Policy:
        if name in names("policy"):
            options = {"camera_noise_mm": camera_noise_mm, "compensation": compensation}
            return foreign.registered_policy(name, env, seed, options if kind_of(name).sequential else {})
        if Path(name).suffix in foreign.SUFFIXES:
            return foreign.foreign_policy(name, env, seed)
        policy = load_any(name, env.unwrapped.task.plant.arm)
        if isinstance(policy, RememberingPolicy):
            return RememberingReach(env, policy)
        plain = isinstance(policy.scaling, ToolSteps) or policy.moves_tool  # whose observations have another layout
        return policy if plain else LearnedReach(env, policy)

    vars(make).update(envs=_envs_of(name))
    return make


def policy_name(name: str) -> str:
    """Return a policy's name for tables; the name of a file or folder is the end of its path."""
    path = Path(name)
    if path.suffix in foreign.SUFFIXES:
        return path.stem
    if name.endswith(".npz"):
        return "/".join(path.with_suffix("").parts[-3:])
    return path.name if len(path.parts) > 1 else name


def _kind_of_files(folder: str, files: tuple[str, ...]) -> Kind:
    """Return the properties of the policies in a folder of trainings, which must differ in their seeds alone.

    ``files`` has the path of one policy file per training.
    """
    if not files:
        raise InputError(
            f"{folder} holds no trainings; give the folder of a training, or one whose folders hold a policy.npz each, "
            "one a seed"
        )
    policies = [load_any(file) for file in files]
    trainings = [dict(policy.record.get("training", {})) for policy in policies]
    seeds = [training.pop("seed", None) for training in trainings]
    if len(set(seeds)) < len(seeds) or any(training != trainings[0] for training in trainings):
        raise InputError(
            f"{folder} holds trainings that differ in more than their seeds, or two of one seed; give one training "
            "with several seeds, each in a folder of its own"
        )
    return _kind_of_policy(policies[0])


def _kind_of_policy(policy: LearnedPolicy | RememberingPolicy) -> Kind:
    if isinstance(policy, RememberingPolicy):
        return Kind(("camera",), sequential=True)
    if isinstance(policy.scaling, ToolSteps):
        return Kind(("encoders",), picks=True)
    return Kind(("camera",) if policy.scaling.camera else ("encoders",), moves_tool=policy.moves_tool)


def _envs_of(name: str) -> Callable[..., ReachVectorEnv]:
    """Return the constructor of the environments in which `pickenv.agents.roll_out` evaluates the policy ``name``."""
    kind = kind_of(name)
    if kind.picks:
        raise InputError(f"{policy_name(name)} picks, and cannot be compared on reaches; judge it in pickenv/Pick-v0")
    if not kind.moves_tool:
        return ReachVectorEnv
    trained = load_policy(name).record["training"]["arguments"]
    known = signature(make_tool_task).parameters
    return partial(ReachToolVectorEnv, **{key: value for key, value in trained.items() if key in known})


NONE = "none"
LEAST_SQUARES = "ls"

Given: TypeAlias = str | Path | Policy


@dataclass(frozen=True, eq=False)
class Contender:
    """One policy of a comparison.

    Attributes:
        label: Display name.
        make: Function ``(env, seed)`` that makes the policy for an environment.
        compensator: Compensator between the policy and the arm; None for a raw arm.
    """

    label: str
    make: PolicyMaker
    compensator: Compensate | None = None


def contenders_of(
    policies: Sequence[Given],
    compensate: Sequence[str | Path | Calibration | None] = (),
    labels: Sequence[str] = (),
    *,
    arm: Any = None,
    camera_noise_mm: float = 0.0,
    allow: Collection[str] = (),
) -> list[Contender]:
    """Return the contenders of a comparison; contenders labelled raw, LS and LS+BPNN come first.

    Args:
        policies: One or more policies, each a registered name, a shipped baseline, a file, or an object with ``act``
            and ``reset``. A calibration file among them stands for the scripted policy with this calibration.
        compensate: Calibration of each policy, in the same order: "none" or None, a `Calibration`, a file, or a file
            name followed by "#ls" for its least-squares part without its learnt residual. One policy is combined with
            each of several calibrations, and one calibration with each of several policies.
        labels: Display names, one for each policy; made from policies and calibrations by default.
        arm: Arm to which the calibrations must belong; None if the environment has no arm.
        camera_noise_mm: Standard deviation of the camera noise that an adaptive policy assumes, mm per axis.
        allow: Reservations of the calibrations to accept, by name: "fitted-frames", "do-not-use" (`pickenv.base.obey`).

    Raises:
        InputError: If the numbers of policies, calibrations and labels do not match, a name is unknown, or two labels
            are alike. Also if a calibration has a reservation that ``allow`` does not name.
    """
    pairs = [_pair(policy) for policy in policies]
    calibrations = [None if calibration in (None, NONE) else calibration for calibration in compensate]
    if len(pairs) == 1 and len(calibrations) > 1 and pairs[0][1] is None:
        pairs = pairs * len(calibrations)
    if len(calibrations) == 1:
        calibrations = calibrations * len(pairs)
    if calibrations and len(calibrations) != len(pairs):
        raise InputError(
            f"there are {len(pairs)} policies and {len(calibrations)} calibrations; give one for each ({NONE} for a "
            "raw arm), one for all, or one policy"
        )
    stages = []
    for (policy, built_in), calibration in zip(pairs, calibrations or [None] * len(pairs), strict=True):
        if built_in is not None and calibration is not None:
            raise InputError(f"'{built_in}' is a calibration already; give `compensate` {NONE} for it")
        stages.append(_calibrated(built_in or calibration, arm, allow))
        if stages[-1][1] is not None and isinstance(policy, str | Path) and kind_of(str(policy)).raw_only:
            raise InputError(f"policy '{policy}' corrects the arm itself; give `compensate` {NONE} for it")
    if allow and not any(compensator for _, compensator in stages):
        raise InputError("`allow` is of calibrations, and none is compared; leave it out, or give `compensate`")
    names = list(labels) or _labels([_name(policy) for policy, _ in pairs], [stage for stage, _ in stages])
    if len(names) != len(pairs):
        raise InputError(f"there are {len(pairs)} policies and {len(names)} labels; give each one label")
    contenders = [
        Contender(label, _maker(policy, camera_noise_mm, stage), compensator)
        for (policy, _), (stage, compensator), label in zip(pairs, stages, names, strict=True)
    ]
    check_labels(names)
    return sorted(contenders, key=lambda contender: policy_rank(contender.label))


def load_compensator(path: str | Path, arm: Arm, allow: Collection[str] = ()) -> Compensate:
    """Load a calibration file and return its compensator.

    Use the compensator in environments that give fruit positions in the arm's own base frame.

    Args:
        path: Calibration file.
        arm: Arm to which the calibration must belong.
        allow: Reservations of the calibration to accept, by name: "fitted-frames", "do-not-use" (`pickenv.base.obey`).

    Raises:
        InputError: If the file is missing, damaged or of another arm, or has a reservation that ``allow`` does not
            name.
    """
    calibration = Calibration.load(path, arm)
    obey(calibration.reservations(), allow)
    return calibration.compensator()


def check_labels(labels: Sequence[str]) -> None:
    """Raise an error if two labels have the same letters and digits. Viewers identify a policy by these.

    Raises:
        InputError: If a label has no letter or digit, or two labels differ in punctuation and capitals only.
    """
    keys = [policy_key(label) for label in labels]
    for key, label in zip(keys, labels, strict=True):
        if not key:
            raise InputError(f"the label '{label}' has no letter or digit; give another")
        if keys.count(key) > 1:
            raise InputError(f"two policies are called '{label}'; give each its own `label`")


def _maker(policy: Given, camera_noise_mm: float, stage: str) -> PolicyMaker:
    """Return the function that makes a contender's policy.

    Args:
        policy: The policy, as in `contenders_of`.
        camera_noise_mm: Standard deviation of the camera noise that an adaptive policy assumes, mm per axis.
        stage: Name of the contender's calibration; "raw" without one.
    """
    if not isinstance(policy, str | Path):
        return lambda env, seed: policy
    return maker_of(str(policy), camera_noise_mm, "raw" if stage == "raw" else LEAST_SQUARES)


def _pair(policy: Given) -> tuple[Given, str | Path | Calibration | None]:
    """Return a policy and its calibration; for a calibration file, return the scripted policy and this calibration."""
    if not isinstance(policy, str | Path):
        return policy, None
    path, training = Path(str(policy).partition("#")[0]), Path(policy) / "policy.npz"
    is_container = path.suffix == ".npz" and path.is_file()
    if is_container and read_container(path, None, remake="make it anew").kind == "calibration":
        return "scripted", policy
    return (training if training.is_file() else policy), None  # the folder of one training


def _calibrated(
    given: str | Path | Calibration | None, arm: Any, allow: Collection[str]
) -> tuple[str, Compensate | None]:
    """Return a calibration's name for labels and its compensator; "raw" and None without a calibration.

    Args:
        given: One entry of ``compensate`` of `contenders_of`.
        arm: The arm, as in `contenders_of`.
        allow: Reservations to accept, as in `contenders_of`.
    """
    if given is None:
        return "raw", None
    calibration, part = given, ""
    if not isinstance(calibration, Calibration):
        path, _, part = str(given).partition("#")
        if part not in ("", LEAST_SQUARES):
            raise InputError(f"'{given}' ends in #{part}; a calibration is whole, or #{LEAST_SQUARES}")
        calibration = Calibration.load(path, arm)
    obey(calibration.reservations(), allow)
    if part:
        calibration = calibration.without_residual()
    return stage_label(calibration), calibration.compensator()


def _name(policy: Given) -> str:
    return policy_name(str(policy)) if isinstance(policy, str | Path) else type(policy).__name__


def _labels(policies: Sequence[str], stages: Sequence[str]) -> list[str]:
    """Return one label per contender: its calibration, its policy, or both, whichever differ between contenders.

    Args:
        policies: Name of each contender's policy.
        stages: Name of each contender's calibration; "raw" for a contender without one.
    """
    if len(set(policies)) == 1 and (len(policies) > 1 or stages[0] != "raw"):
        return list(stages)
    if len(set(stages)) == 1:
        return list(policies)
    return [f"{policy}, {stage}" for policy, stage in zip(policies, stages, strict=True)]
