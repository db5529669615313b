"""Two policies or more for the same seeded fruit: who ends nearer, where, by how much, and whether it picks more.

One engine for the command `pickenv compare`, for recorded runs and for the demonstration.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

import pickenv  # noqa: F401  (registers the environments)
from pickenv.agents.evaluation.contenders import Contender, Given, check_labels, contenders_of
from pickenv.agents.evaluation.reaches import Moment, episode_seeds, moments_of
from pickenv.arm import Array, Plant, Pose, displace_pose
from pickenv.base import InputError, check_limit, command_line, seed_words, stream, write_json, write_text
from pickenv.calibration import Calibration
from pickenv.inspect import Comparison, PolicyErrors, read_run
from pickenv.inspect.colours import policy_key, policy_rank
from pickenv.inspect.runs.comparison_summary import compared
from pickenv.inspect.runs.episode_summary import content_of_comparison
from pickenv.inspect.runs.field_grid import FieldGrid, field_grid
from pickenv.inspect.runs.recorded_episodes import (
    RecordedEpisodes,
    RecordedPolicy,
    believed_joints,
    last_of,
    missing_positions,
)
from pickenv.inspect.runs.run_folder import RECORD, REPORT, load_comparison, recorded_run, save_part
from pickenv.orchard import Gripper, capture_probability, load_gripper, misalignment
from pickenv.wrappers import CompensationVectorWrapper, CompensationWrapper

# A comparison of policies as a run folder: every episode, the table, one recording, one page, its figures.


SUMMARY, RECORDING = "comparison.json", "comparison.rrd"


def write_comparison(found: PolicyComparison, folder: Path) -> list[Path]:
    """Write the run folder, for `pickenv inspect`, `report`, `figures` and for further comparisons.

    Raises:
        InputError: If it cannot be written.
    """
    from pickenv.inspect import write_drawings
    from pickenv.inspect.recordings.policy_recording import record_policies
    from pickenv.inspect.reports.comparison_report import page, policy_drawings

    episodes, comparison = found.episodes, found.comparison
    with recorded_run(folder, "comparison", found.command, episodes.seed) as run:
        written = [save_part(folder, episodes, episodes.seed)]
        if comparison is not None:
            written.append(save_part(folder, comparison, episodes.seed))
        written.append(write_json(folder / SUMMARY, content_of_comparison(episodes)))
        written += write_drawings(policy_drawings(episodes, comparison), folder / "figures", ("png",))
        written.append(record_policies(episodes, comparison, folder / RECORDING))
        written.append(write_text(folder / REPORT, page(run)))
    return written


GRID_STEP = 0.1
"""Cell size of a policy's error field, m."""

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class PolicyComparison:
    """What a comparison found.

    Attributes:
        episodes: Every episode of every policy, step by step.
        comparison: Their errors over a field of goals and at the ends of the episodes; None where the environment has
            no arm that reaches for one fruit.
        command: Command line that makes the same numbers again.
    """

    episodes: RecordedEpisodes
    comparison: Comparison | None
    command: str


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
    """Run policies for the same seeded fruit.

    Args:
        policies: Kinds, shipped ones, files, objects with ``act`` and ``reset``, or folders of comparisons, of which
            every policy takes part as it was recorded.
        env: Id of the environment; `info` must give tool and fruit positions (docs/recordings.md).
        compensate: A calibration for each policy: "none", a file, a file and "#ls" for its least squares alone.
        labels: Names for people, one for each policy; made from policies and calibrations when left out.
        episodes: How many; of recorded runs as many as were recorded.
        seed: Seed of fruit and of policies that draw.
        gripper: Name or file of the gripper that says whether a reach picks.
        grid_step: Cell size of the error fields, m.
        allow: Reservations of calibrations to accept, by name.
        progress: Called with (stage, done, in all).
        arguments: Further ones of the environment.

    Raises:
        InputError: If something cannot be compared; one sentence says why.

    Example:
        >>> import pickenv
        >>> found = pickenv.compare(["scripted", "random"], episodes=2, grid_step=0.4)
        >>> [policy.label for policy in found.episodes.policies]
        ['scripted', 'random']
    """
    report = progress or (lambda stage, done, total: None)
    check_limit("episodes", episodes, "episodes")
    folders = [isinstance(each, str | Path) and (Path(each) / RECORD).is_file() for each in policies]
    runs = [_recorded(Path(str(each))) for each, recorded in zip(policies, folders, strict=True) if recorded]
    others = [each for each, recorded in zip(policies, folders, strict=True) if not recorded]
    given: dict[str, Any] = {"env": env, "episodes": episodes, "seed": seed, "gripper": gripper}
    given |= {"compensate": compensate, "grid_step": None if grid_step == GRID_STEP else grid_step}
    command = _command(policies, given, labels, arguments)
    if not others:
        if not runs:
            raise InputError("there is nothing to compare; give at least one policy")
        return _joined(runs, command)
    found = _run(others, env, compensate, labels, episodes, seed, gripper, grid_step, allow, report, arguments)
    return _joined([*runs, replace(found, command=command)], command)


def _run(
    policies: Sequence[Given],
    env_id: str,
    compensate: Sequence[str | Path | Calibration | None],
    labels: Sequence[str],
    count: int,
    seed: int,
    gripper: str,
    grid_step: float,
    allow: Collection[str],
    report: Progress,
    arguments: Mapping[str, Any],
) -> PolicyComparison:
    env = _made(env_id, arguments)
    inner: Any = env.unwrapped
    plant: Plant | None = getattr(inner, "plant", None)
    if getattr(getattr(inner, "task", None), "arms", "fixed") != "fixed":
        raise InputError("a comparison is of one arm; for a population of arms use `pickenv evaluate`")
    situation = getattr(getattr(inner, "task", None), "situation", None)
    if situation is not None and situation.period.varies:
        raise InputError("a comparison has one time line; give one control_period_s, not a range")
    noise = float(np.hypot(arguments.get("camera_noise_mm", 0.0), arguments.get("fruit_noise_mm") or 0.0))
    arm = None if plant is None else plant.arm
    contenders = contenders_of(policies, compensate, labels, arm=arm, camera_noise_mm=noise, allow=allow)
    judge, seeds = load_gripper(gripper), episode_seeds(seed, count)
    chance = np.random.default_rng(stream(seed, "grasps")).random(count)
    env.close()
    found, reaching = [], False
    for number, contender in enumerate(contenders):
        env = _made(env_id, arguments)
        if contender.compensator is not None:
            env = CompensationWrapper(env, contender.compensator, allow)
        policy = contender.make(env, seed_words(stream(seed, "policy", number), 1)[0])
        ways = []
        for done, each in enumerate(seeds, start=1):
            ways.append([(moment, believed_joints(env)) for moment in moments_of(env, policy, each)])
            if missing := missing_positions(ways[-1][0][0].info):
                raise InputError(f"{env_id} cannot be compared: {missing}")
            report(f"{contender.label}, episodes", done, count)
        reaching = "pose_error" in ways[0][0][0].info
        found.append(_recorded_policy(contender.label, ways, plant, judge, chance))
        env.close()
    episodes = RecordedEpisodes(
        env_id=env_id,
        plant="" if plant is None else plant.name,
        gripper=judge.name,
        tolerance_mm=round(1e3 * judge.tolerance, 6),
        seed=seed,
        seeds=seeds,
        period=1.0 / inner.metadata.get("render_fps", 10),
        nominal=None if plant is None else plant.arm.nominal,
        true_geometry=None if plant is None else plant.geometry,
        policies=tuple(found),
    )
    comparison = None
    if reaching and plant is not None:
        grid = field_grid(plant.arm.nominal, grid_step, seed)
        fields = []
        for number, contender in enumerate(contenders):
            fields.append(_field(contender, env_id, arguments, grid, seed, number))
            report("error fields", number + 1, len(contenders))
        comparison = _compared(episodes, plant, grid, fields, contenders[-1].calibration)
    return PolicyComparison(episodes, comparison, "")


def _made(env_id: str, arguments: Mapping[str, Any]) -> gym.Env[Any, Any]:
    try:
        return gym.make(env_id, **arguments)
    except (gym.error.Error, ModuleNotFoundError, TypeError) as error:
        raise InputError(f"cannot make the environment '{env_id}': {' '.join(str(error).split())}") from error


def _recorded_policy(
    label: str,
    ways: Sequence[Sequence[tuple[Moment, Array | None]]],
    plant: Plant | None,
    judge: Gripper,
    chance: Array,
) -> RecordedPolicy:
    """One policy's episodes as arrays; see `RecordedPolicy`."""
    longest, info = max(map(len, ways)), ways[0][0][0].info
    padded = [[*way, *[(way[-1][0]._replace(reward=0.0), way[-1][1])] * (longest - len(way))] for way in ways]

    def column(name: str, absent: Any) -> NDArray[Any]:
        return np.array([[moment.info.get(name, absent) for moment, _ in way] for way in padded])

    tool, fruit = column("tool_position", None).astype(float), column("fruit_position", None).astype(float)
    command = column("joint_command", np.zeros(0)).astype(float)
    targets = [
        [command[e, t] if target is None else target for t, (_, target) in enumerate(way)]
        for e, way in enumerate(padded)
    ]
    if plant is None:
        rotation = np.full((*tool.shape, 3), np.nan)
    else:
        rotation = plant.tool_pose(command.reshape(-1, command.shape[-1])).rotation.reshape(*tool.shape, 3)
    moments = np.array([len(way) for way in ways])
    rows, ends = np.arange(len(ways)), moments - 1
    distance = 1e3 * np.linalg.norm(tool - fruit, axis=-1)
    miss, picked = np.full(distance.shape, np.nan), np.zeros(distance.shape, dtype=np.int64)
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
        elif "is_success" in info:
            taken = success[rows, ends]
        else:
            taken = miss[rows, ends] <= 1e3 * judge.tolerance
        picked[rows, ends] = taken
        for row, end in zip(rows, ends, strict=True):
            picked[row, end:] = picked[row, end]
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
        reward=np.array([[moment.reward for moment, _ in way] for way in padded]),
    )


def _capture(judge: Gripper, tool: Pose, fruit: Array, error: Array) -> Array:
    """Probability ``(E,)`` that the gripper takes each fruit, given true against wanted pose ``(E, 6)``."""
    turn = np.concatenate([np.zeros((len(error), 3)), -error[:, 3:]], axis=1)
    wanted = displace_pose(tool, turn).rotation[..., 2]
    lying = misalignment(fruit - tool.position, tool.rotation[..., 2], wanted)
    return capture_probability(judge, lying.lateral, lying.axial, lying.angle)


def _field(
    contender: Contender, env_id: str, arguments: Mapping[str, Any], grid: FieldGrid, seed: int, number: int
) -> Array:
    """Final pose errors of a policy over a grid of goals ``(F, 6)``, m and rad: all goals at once, one arm for each."""
    spec = gym.spec(env_id)
    steps = spec.max_episode_steps or 60
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


def _compared(
    episodes: RecordedEpisodes, plant: Plant, grid: FieldGrid, fields: Sequence[Array], calibration: Calibration | None
) -> Comparison:
    """The errors over the field and at the ends, for figures and recordings."""
    policies = [
        PolicyErrors(
            key=policy.key,
            label=policy.label,
            field_errors=field[:, :3],
            reach_joints=last_of(policy, policy.joint_command),
            reach_positions=last_of(policy, policy.tool_position),
            position_error_mm=last_of(policy, policy.position_error_mm),
            attitude_error_deg=last_of(policy, policy.attitude_error_deg),
            success=last_of(policy, policy.picked) > 0,
            field_attitude=field[:, 3:],
        )
        for policy, field in zip(episodes.policies, fields, strict=True)
    ]
    return compared(
        plant,
        grid,
        policies,
        seed=episodes.seed,
        fruit=last_of(episodes.policies[0], episodes.policies[0].fruit_position),
        tolerance_mm=episodes.tolerance_mm,
        identified=None if calibration is None else calibration.identified,
    )


def _recorded(folder: Path) -> PolicyComparison:
    run = read_run(folder)
    if run.kind != "comparison":
        raise InputError(f"{folder} is a run of kind '{run.kind}'; give a folder that `pickenv compare --out` wrote")
    return PolicyComparison(*load_comparison(run), run.command)


SAME = ("env_id", "plant", "gripper", "seed", "seeds")
"""What comparisons must share to be put together."""


def _joined(runs: Sequence[PolicyComparison], command: str) -> PolicyComparison:
    """Several comparisons for the same fruit as one."""
    first = runs[0]
    for other in runs[1:]:
        for name in SAME:
            one, two = getattr(first.episodes, name), getattr(other.episodes, name)
            if one != two:
                raise InputError(f"the runs differ in {name}: {one} and {two}; compare policies for the same fruit")
    episodes = sorted((p for run in runs for p in run.episodes.policies), key=lambda p: policy_rank(p.label))
    check_labels([policy.label for policy in episodes])
    longest = max(policy.position_error_mm.shape[1] for policy in episodes)
    whole = replace(first.episodes, policies=tuple(_lengthened(policy, longest) for policy in episodes))
    fields = [run.comparison for run in runs]
    comparison = fields[0]
    if comparison is not None and len(runs) > 1:
        same = all(f is not None and np.array_equal(f.field_points, comparison.field_points) for f in fields)
        if not same:
            raise InputError("the runs have error fields over different goals; make them with the same --grid-step")
        ends = sorted((p for f in fields if f is not None for p in f.policies), key=lambda p: policy_rank(p.label))
        comparison = replace(comparison, policies=tuple(ends))
    return PolicyComparison(whole, comparison, command)


def _lengthened(policy: RecordedPolicy, moments: int) -> RecordedPolicy:
    """The same episodes with room for more moments: each stays at its last one, and nothing more is earned."""
    more = moments - policy.position_error_mm.shape[1]
    if not more:
        return policy
    parts: dict[str, Any] = {}
    for name, values in vars(policy).items():
        if isinstance(values, np.ndarray) and values.ndim > 1:
            last = np.repeat(values[:, -1:], more, axis=1)
            fill: Any = {"reward": 0.0, "miss_mm": np.nan}.get(name)
            parts[name] = np.concatenate([values, last if fill is None else np.full_like(last, fill)], axis=1)
    return replace(policy, **parts)


def _command(
    policies: Sequence[Given], given: Mapping[str, Any], labels: Sequence[str], arguments: Mapping[str, Any]
) -> str:
    """The command line that makes the same numbers; what no command line can say is named by its kind."""

    def said(value: Any) -> str:
        return str(value) if isinstance(value, str | Path | int | float) else f"<{type(value).__name__}>"

    compensate = [said("none" if each is None else each) for each in given["compensate"]]
    options = {**given, "compensate": compensate, "label": list(labels), **arguments}
    return command_line(
        "pickenv", "compare", *map(said, policies), **{n.removesuffix("_mm"): v for n, v in options.items()}
    )
