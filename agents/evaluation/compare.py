"""Comparison of policies on the same seeded fruit: final errors, error fields, and fruit picked.

`write_comparison` writes a run folder: every episode, a summary, a recording, a report and its drawings.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import pickenv  # noqa: F401  (registers the environments)
from pickenv.agents.evaluation.contenders import Contender, Given, Moment, contenders_of, episode_seeds, run_episodes
from pickenv.agents.policies.policy import attitude_after
from pickenv.arm import Array, Plant, Pose
from pickenv.base import InputError, Progress, check_limit, command_line, seed_words, stream, write_json, write_text
from pickenv.calibration import Calibration
from pickenv.inspect import Comparison, RecordedEpisodes, RecordedPolicy
from pickenv.inspect.colours import policy_key
from pickenv.inspect.runs.comparison_summary import content_of_comparison
from pickenv.inspect.runs.recorded_episodes import FieldGrid, field_grid, missing_positions
from pickenv.inspect.runs.run_folder import REPORT, recorded_run, save_part
from pickenv.orchard import Gripper, capture_probability, load_gripper, misalignment
from pickenv.wrappers import CompensationVectorWrapper, CompensationWrapper

SUMMARY, RECORDING = "comparison.json", "comparison.rrd"
GRID_STEP = 0.1
Arguments = Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class PolicyComparison:
    """Result of `compare`.

    Attributes:
        episodes: Every episode of every policy, step by step. If the environment has an arm that reaches for one fruit,
            this is a `Comparison`, which also holds error fields over a grid of goals.
        command: Command line that reproduces the numbers.
    """

    episodes: RecordedEpisodes
    command: str


def write_comparison(result: PolicyComparison, folder: Path) -> list[Path]:
    """Write the run folder that `pickenv inspect`, `report` and `figures` read, and return the paths of its files.

    Args:
        result: Result of `compare`.
        folder: Folder to write.

    Raises:
        InputError: If the folder cannot be written.
    """
    from pickenv.inspect import write_drawings
    from pickenv.inspect.recordings.policy_recording import record_policies
    from pickenv.inspect.reports.comparison_report import page, policy_drawings

    episodes = result.episodes
    with recorded_run(folder, "comparison", result.command, episodes.seed) as run:
        return [
            save_part(folder, episodes, episodes.seed, RecordedEpisodes),
            write_json(folder / SUMMARY, content_of_comparison(episodes)),
            *write_drawings(policy_drawings(episodes), folder / "figures", ("png",)),
            record_policies(episodes, folder / RECORDING),
            write_text(folder / REPORT, page(run)),
        ]


def compare(
    policies: Sequence[Given],
    env: str = "pickenv/Reach-v0",
    *,
    compensate: Sequence[str | Path | Calibration | None] = (),
    labels: Sequence[str] = (),
    episodes: int = 20,
    seed: int = 0,
    gripper: str = "li_cup",
    grid_step: float = GRID_STEP,
    allow: Collection[str] = (),
    progress: Progress | None = None,
    **arguments: Any,
) -> PolicyComparison:
    """Run several policies on the same seeded fruit and compare them.

    Args:
        policies: Each policy is a registered name, a shipped baseline, a file, or an object with ``act`` and ``reset``.
        env: Id of the environment; its `info` must give tool and fruit positions (docs/recordings.md).
        compensate: Calibration of each policy: "none" or None, a `Calibration`, a file, or a file name followed by
            "#ls" for its least-squares part alone.
        labels: Display names, one for each policy; made from policies and calibrations by default.
        episodes: Number of episodes of each policy.
        seed: Seed of the fruit and of the policies' own random draws.
        gripper: Name or file of the gripper model that decides whether a reach picks its fruit. In `pickenv/Pick-v0` it
            is also the arm's gripper.
        grid_step: Cell size of the error fields, m.
        allow: Reservations of the calibrations to accept, by name: "fitted-frames", "do-not-use" (`pickenv.base.obey`).
        progress: Called with (stage, number done, total).
        arguments: Further keyword arguments of the environment.

    Raises:
        InputError: If a policy, calibration or environment cannot be compared; the message gives the reason.

    Example:
        >>> import pickenv
        >>> found = pickenv.compare(["scripted", "random"], episodes=2, grid_step=0.4)
        >>> [policy.label for policy in found.episodes.policies]
        ['scripted', 'random']
    """
    check_limit("episodes", episodes, "episodes")
    if not policies:
        raise InputError("there is nothing to compare; give at least one policy")
    report = progress or (lambda stage, done, total: None)
    plant, period, features, missing = _arm_and_period(env, arguments)
    if "gripper" in features:
        arguments = {**arguments, "gripper": gripper}
    if grid_step != GRID_STEP and "field" not in features:
        raise InputError(f"{env} is no reach of an arm for one fruit, so it has no error field; leave `grid_step` out")
    if missing:
        raise InputError(f"{env} cannot be compared: {missing}")
    noise = float(np.hypot(arguments.get("camera_noise_mm", 0.0), arguments.get("fruit_noise_mm") or 0.0))
    arm = None if plant is None else plant.arm
    contenders = contenders_of(policies, compensate, labels, arm=arm, camera_noise_mm=noise, allow=allow)
    judge, seeds = load_gripper(gripper), episode_seeds(seed, episodes)
    chance = np.random.default_rng(stream(seed, "grasps")).random(episodes)
    runs = []
    for number, contender in enumerate(contenders):

        def ran(done: int, stage: str = f"{contender.label}, episodes") -> None:
            report(stage, done, episodes)

        world = _made(env, arguments)
        if contender.compensator is not None:
            world = CompensationWrapper(world, contender.compensator, allow)
        policy = contender.make(world, seed_words(stream(seed, "policy", number), 1)[0])  # for its own random draws
        runs.append(run_episodes(world, policy, seeds, ran))
        world.close()
    longest = max(len(episode) for run in runs for episode in run)
    recorded = [
        _recorded_policy(contender.label, run, longest, plant, judge, chance)
        for contender, run in zip(contenders, runs, strict=True)
    ]
    facts: dict[str, Any] = {"plant": plant, "env_id": env, "seed": seed, "seeds": seeds, "period": period}
    facts |= {"gripper": judge.name, "tolerance_mm": round(1e3 * judge.tolerance, 6)}
    options = {"env": env, "episodes": episodes, "seed": seed, "gripper": gripper, "compensate": compensate}
    options |= {"allow": sorted(allow), "grid_step": None if grid_step == GRID_STEP else grid_step}
    command = _command(policies, options, labels, arguments)
    if plant is None or "field" not in features:
        return PolicyComparison(RecordedEpisodes(policies=tuple(recorded), **facts), command)
    grid = field_grid(plant.arm.nominal, grid_step, seed)
    for number, contender in enumerate(contenders):
        recorded[number] = recorded[number].with_field(_field(contender, env, arguments, grid, seed, number))
        report("error fields", number + 1, len(contenders))
    return PolicyComparison(Comparison(policies=tuple(recorded), grid=grid, **facts), command)


def _arm_and_period(env_id: str, arguments: Arguments) -> tuple[Plant | None, float, set[str], str]:
    """Return the properties of an environment that a comparison needs.

    Returns:
        Four values. The first is the plant (true arm), or None. The second is the control period, s. The third holds
        "gripper" if the environment judges grasps by its own gripper, and "field" if errors can be mapped over a grid
        of goals. The fourth is a sentence that says which positions `info` lacks (`missing_positions`). It is empty if
        `info` has all.

    Raises:
        InputError: If the environment cannot be made, has many arms, or has a control period that varies.
    """
    env = _made(env_id, arguments)
    inner: Any = env.unwrapped
    task = getattr(inner, "task", None)
    if getattr(task, "arms", "fixed") != "fixed":
        raise InputError("a comparison is of one arm; for a population of arms use `pickenv evaluate`")
    situation = getattr(task, "situation", None)
    if situation is not None and situation.period.varies:
        raise InputError("a comparison has one time line; give one control_period_s, not a range")
    plant, (_, info) = getattr(inner, "plant", None), env.reset(seed=0)
    env.close()
    features = {"gripper"} if hasattr(getattr(inner, "orchard", None), "gripper") else set()
    features |= {"field"} if plant is not None and "pose_error" in info else set()
    return plant, 1.0 / inner.metadata.get("render_fps", 10), features, missing_positions(info)


def _made(env_id: str, arguments: Arguments) -> gym.Env[Any, Any]:
    try:
        return gym.make(env_id, **arguments)
    except (gym.error.Error, ModuleNotFoundError, TypeError) as error:
        raise InputError(f"cannot make the environment '{env_id}': {' '.join(str(error).split())}") from error


def _recorded_policy(
    label: str, episodes: Sequence[Sequence[Moment]], longest: int, plant: Plant | None, judge: Gripper, chance: Array
) -> RecordedPolicy:
    """Return one policy's E episodes as arrays, each padded to ``longest`` moments.

    Padding repeats the last moment, with reward 0.

    Args:
        label: Display name of the policy.
        episodes: The moments of each episode.
        longest: Number of moments to which episodes are padded.
        plant: The true arm, or None.
        judge: The gripper.
        chance: One uniform random number per episode ``(E,)``. If the final pose error is known, a reach picks its
            fruit if this number is below the probability that the gripper captures the fruit.
    """
    info = episodes[0][0].info
    padded = [[*episode, *[episode[-1]._replace(reward=0.0)] * (longest - len(episode))] for episode in episodes]

    def column(name: str, absent: Any) -> NDArray[Any]:
        return np.array([[moment.info.get(name, absent) for moment in episode] for episode in padded])

    tool, fruit = column("tool_position", None).astype(float), column("fruit_position", None).astype(float)
    command = column("joint_command", np.zeros(0)).astype(float)
    targets = [
        [command[e, t] if moment.target is None else moment.target for t, moment in enumerate(episode)]
        for e, episode in enumerate(padded)
    ]
    rotation = np.full((*tool.shape, 3), np.nan)
    if plant is not None:
        rotation = plant.tool_pose(command.reshape(-1, command.shape[-1])).rotation.reshape(*tool.shape, 3)
    moments = np.array([len(episode) for episode in episodes])
    rows, ends = np.arange(len(episodes)), moments - 1
    distance = 1e3 * np.linalg.norm(tool - fruit, axis=-1)
    miss = np.full(distance.shape, np.nan)
    success = column("is_success", False).astype(bool)
    if "attempted" in info:  # fruit after fruit: the gripper closes where the environment says so
        closes = np.diff(column("attempted", 0), axis=1, prepend=0) > 0
        closes[:, 0] = False
        across = np.hypot(column("grasp_lateral_mm", np.nan), column("grasp_axial_mm", np.nan))
        miss[closes], picked = across[closes], column("collected", 0).astype(np.int64)
    else:
        miss[rows, ends] = distance[rows, ends]
        if "pose_error" in info and plant is not None:
            error = column("pose_error", None).astype(float)[rows, ends]
            taken = chance < _capture(judge, Pose(tool[rows, ends], rotation[rows, ends]), fruit[rows, ends], error)
        else:
            taken = success[rows, ends] if "is_success" in info else distance[rows, ends] <= 1e3 * judge.tolerance
        picked = np.where(np.arange(longest) >= ends[:, None], taken[:, None], 0)
    return RecordedPolicy(
        label=label,
        key=policy_key(label),
        moments=moments,
        joint_target=np.array(targets, dtype=float),
        joint_command=command,
        tool_position=tool,
        tool_rotation=rotation,
        fruit_position=fruit,
        position_error_mm=distance,
        attitude_error_deg=column("attitude_error_deg", np.nan).astype(float),
        success=success,
        picked=picked,
        miss_mm=miss,
        reward=np.array([[moment.reward for moment in episode] for episode in padded]),
    )


def _capture(judge: Gripper, tool: Pose, fruit: Array, error: Array) -> Array:
    """Return the probability ``(E,)`` that the gripper ``judge`` captures each fruit.

    Args:
        judge: Tolerances of the gripper.
        tool: True poses of the tool ``(E,)``.
        fruit: True positions of the fruit ``(E, 3)``, m.
        error: True minus wanted poses of the tool ``(E, 6)``, m and rad.
    """
    aim = attitude_after(tool, -error[:, 3:])[..., 2]
    return capture_probability(judge, *misalignment(fruit - tool.position, tool.rotation[..., 2], aim))


def _field(contender: Contender, env_id: str, arguments: Arguments, grid: FieldGrid, seed: int, number: int) -> Array:
    """Return a policy's final pose errors ``(F, 6)``, m and rad, at the F goals of a grid.

    Args:
        contender: The policy and its compensator.
        env_id: Id of the environment.
        arguments: Keyword arguments of the environment.
        grid: The grid of goals.
        seed: Seed of the environment and of the policy's own random draws.
        number: Index of the policy in the comparison, from 0, on which its random draws depend too.
    """
    steps = gym.spec(env_id).max_episode_steps or 60
    envs: gym.vector.VectorEnv[Any, Any, Any] = gym.make_vec(
        env_id, num_envs=len(grid.joints), autoreset_mode="Disabled", **arguments
    )
    if contender.compensator is not None:
        compensation: Any = contender.compensator
        envs = CompensationVectorWrapper(envs, compensation, getattr(compensation, "reservations", {}))
    policy = contender.make(envs, seed_words(stream(seed, "policy", number, 1), 1)[0])
    words = seed_words(stream(seed, "fruit", 1), len(grid.joints))
    observation, infos = envs.reset(seed=words, options={"goal_joints": grid.joints})  # type: ignore[arg-type]
    policy.reset()
    for _ in range(steps):
        observation, _, _, _, infos = envs.step(policy.act(observation))
    errors = np.array(infos["pose_error"], dtype=float)
    envs.close()
    return errors


def _command(policies: Sequence[Given], options: Arguments, labels: Sequence[str], arguments: Arguments) -> str:
    """Return the command line that reproduces a comparison; a policy object appears by the name of its type.

    Args:
        policies: The policies, as in `compare`.
        options: The named arguments of `compare`.
        labels: Display names of the policies.
        arguments: Keyword arguments of the environment.
    """

    def word(value: Any) -> str:
        return str(value) if isinstance(value, str | Path | int | float) else f"<{type(value).__name__}>"

    compensate = [word("none" if value is None else value) for value in options["compensate"]]
    options = {**options, "compensate": compensate, "label": list(labels), **arguments}
    return command_line(
        "pickenv", "compare", *map(word, policies), **{n.removesuffix("_mm"): v for n, v in options.items()}
    )
