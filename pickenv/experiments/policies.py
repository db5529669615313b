"""Compare policies on the same arms and fruit: one row per episode, for each compensation, feedback and plant.

Arms are drawn from a population on which no policy was trained. Fruit, arms, pictures and calibrations depend on the
seed alone, so any two policies on one plant can be compared pair by pair. Another seed has other fruit, arms, pictures
and calibrations. `pickenv evaluate` uses one seed, `pickenv bench policies` several. Each arm is calibrated once per
method, before the episodes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, field, fields, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np

from pickenv import agents
from pickenv.agents import Policy
from pickenv.agents.evaluation.contenders import Kind, kind_of, load_any, maker_of, pick_canopies, policy_name
from pickenv.agents.policies.learned import BASELINES
from pickenv.agents.policies.scripted import HASTY
from pickenv.arm import Plant, plant_at
from pickenv.arm.plant.plant import plants_on
from pickenv.arm.plant.plant_file import class_of, draw_arms
from pickenv.base import InputError, check_limit, count_of, file_sha256, seed_words, stream
from pickenv.base.registry import names, origin
from pickenv.envs import PickVectorEnv, ReachVectorEnv
from pickenv.envs.shared.difficulty import on_ladder
from pickenv.envs.shared.task import FEEDBACK, check_choice, check_number
from pickenv.experiments import methods
from pickenv.experiments.engine import Columns, Experiment, Progress, Rows, run
from pickenv.inspect.runs.recorded_episodes import Reaches
from pickenv.inspect.runs.run_folder import listed_files
from pickenv.orchard import load_gripper

RUNG = "rung:"
"""Prefix of the name of a rung (a difficulty of `pickenv.envs.shared.difficulty`), which may replace a plant's name."""

CYCLE_MM = 2.0
"""Distance to the fruit within which a cycle counts as finished, mm, for the cycle time."""

PICKERS: Mapping[str, Callable[[Any], Policy]] = {
    "scripted": agents.ScriptedPick,
    "hasty": partial(agents.ScriptedPick, **HASTY),
    "oracle": agents.OraclePick,
    "adaptive": lambda env: agents.FeelingPick(env, agents.AdaptiveReach(env, camera_std=2e-3, prior=2.0)),
}
"""Functions that make the picking policies, by name. "scripted" is gentle and waits for the arm to settle; "hasty" does
neither. "oracle" and "adaptive" wait too. "oracle" aims by the true arm. "adaptive" aims by what the gripper felt at
earlier fruit."""

RAW_PICKERS = ("oracle", "adaptive")
"""Picking policies that run on raw arms only: they correct the arm's errors themselves, so a compensator would disturb
them."""


@dataclass(frozen=True)
class PolicySettings:
    """Settings of a comparison of policies; a plant is a simulated true arm with its errors.

    Attributes:
        policies: Names of registered policies or of shipped baselines, policy files, or folders of one training with
            several seeds.
        compensations: Methods as for `calibrate_arm`, and "raw".
        feedback: Kinds of feedback: "encoders" (open loop) and "camera".
        plants: Plant presets, or rungs such as "rung:orchard". A rung is a difficulty of the ladder of environments,
            with a population of arms for judging. Each seed takes other arms from this population.
        grippers: Names of grippers.
        arms: Number of arms drawn for each plant and seed.
        episodes: Number of fruit per arm.
        seeds: Seeds of arms, fruit, pictures and calibrations.
        tolerances: Tolerance class of the arms, unless the plant's name begins with a class.
        camera_noise_mm: Standard deviation, mm per axis, of the vector from tool to fruit as the camera measures it.
        fruit_noise_mm: Standard deviation, mm per axis, of the fruit's position in the observation.
        plan: How arms are calibrated; each seed in ``seeds`` replaces the seed of the plan.
        canopies: Number of canopies that each picking policy clears with each arm and gripper, one after the other.
        split: Arms that are taken from a rung: "test", on which policies are judged, or "train"; "test" if left out.
    """

    policies: tuple[str, ...] = ("scripted", "oracle", "servo", "adaptive")
    compensations: tuple[str, ...] = methods.METHODS
    feedback: tuple[str, ...] = FEEDBACK
    plants: tuple[str, ...] = ("qiao2026", "orchard")
    grippers: tuple[str, ...] = ("li_cup", "compliant_hand")
    arms: int = 64
    episodes: int = 32
    seeds: tuple[int, ...] = (0,)
    tolerances: str = "coarse"
    camera_noise_mm: float = 1.0
    fruit_noise_mm: float = 0.0
    plan: methods.CalibrationPlan = field(default_factory=methods.CalibrationPlan)
    canopies: int = 0
    split: str | None = None

    def __post_init__(self) -> None:
        for compensation in self.compensations:
            methods.check_method(compensation)
        for feedback in self.feedback:
            check_choice("feedback", feedback, FEEDBACK)
        for gripper in self.grippers:
            load_gripper(gripper)
        for name in ("camera_noise_mm", "fruit_noise_mm"):
            check_number(name, getattr(self, name))
        check_limit("arms", self.arms, "compared arms")
        check_limit("episodes", self.episodes, "episodes")
        check_limit("epochs", self.plan.epochs, "epochs")
        if self.split is not None:
            check_choice("split", self.split, ("test", "train"))
        if self.split and self.plants and not any(plant.startswith(RUNG) for plant in self.plants):
            raise InputError(f"`split={self.split!r}` chooses among a rung's arms; name a rung, or leave `split` out")

    def world(self, plant: str, seed: int, feedback: str = "encoders", task: str = "Reach") -> dict[str, Any]:
        """Return the arguments of the environment for a plant (the true arms with their errors) or a rung.

        A rung is a difficulty of the ladder; it may fix the noise of camera and fruit. With feedback "encoders" the
        rung's fruit noise applies, but not its camera noise.

        Args:
            plant: Plant preset, whose arms are drawn with the seed; or name of a rung.
            seed: Seed of the comparison.
            feedback: "encoders" or "camera".
            task: "Reach" or "Pick".

        Raises:
            InputError: If there is no such rung, or the rung has fewer arms than all seeds together need.
        """
        sight = {"feedback": feedback, "camera_noise_mm": self.camera_noise_mm if feedback == "camera" else 0.0}
        own = {**sight, "fruit_noise_mm": self.fruit_noise_mm} if task == "Reach" else {}
        if not plant.startswith(RUNG):
            own_class = class_of(plant)
            tolerances = self.tolerances if own_class is None else own_class.name
            return own | {"plant": plant, "tolerances": tolerances, "population_seed": population_seed(seed)}
        fixed = on_ladder(task, difficulty=plant.removeprefix(RUNG), split=self.split or "test")
        if (asked := self.arms * len(self.levels("seeds"))) > (most := fixed.get("population", 1)):
            raise InputError(f"{plant} has {count_of(most, 'arm')} to be judged on; {asked} were asked for")
        arms = {name: value for name, value in fixed.items() if name not in ("arms", "population")}
        return own | arms | (sight if own and feedback == "encoders" else {})

    def first_arm(self, plant: str, seed: int) -> int:
        """Return the index (from 0) of the first arm that a seed uses, within the population of arms.

        All seeds share the population of a rung, and each seed uses other arms from it. A plant preset has a population
        for each seed, so the index is 0.
        """
        return self.levels("seeds").index(seed) * self.arms if plant.startswith(RUNG) else 0

    def population(self, plant: str, seed: int) -> Plant:
        """Return the arms on which a seed judges policies, as one plant whose parameters are arrays over arms.

        The environments draw the same arms.

        Args:
            plant: Plant preset, or name of a rung of the ladder.
            seed: Seed of the comparison.
        """
        world, first = self.world(plant, seed), self.first_arm(plant, seed)
        draws = np.random.default_rng(world["population_seed"])
        drawn = draw_arms(world["plant"], world["tolerances"], first + self.arms, draws)
        return plants_on(drawn, lambda values: values[first:])

    def levels(self, name: str) -> tuple[Any, ...]:
        """Return the distinct values of the field ``name``, in order of first appearance."""
        return tuple(dict.fromkeys(getattr(self, name)))


def population_seed(seed: int) -> int:
    """Return the seed from which the arms of a comparison are drawn, given the comparison's seed."""
    return seed_words(stream(seed, "arms"), 1)[0]


def run_policies(
    settings: PolicySettings,
    folder: str | Path | None = None,
    *,
    task: Literal["reaching", "picking"] = "reaching",
    cache: str | Path | None = None,
    backend: str = "serial",
    workers: int | None = None,
    progress: Progress | None = None,
    fits: Callable[..., bool] = lambda **levels: True,
) -> Rows:
    """Run policies that reach for fruit, or pick it, and return the rows; arms and fruit are the same for all policies.

    Args:
        settings: The policies, compensations, plants and sizes of the comparison.
        folder: Folder in which rows are stored for later runs, or None.
        task: "reaching" runs every policy with every kind of feedback that it can use. "picking" runs each of
            `PICKERS`, and every learned policy that picks or has a memory, on the canopies of `pickenv/Pick-v0`. All
            these policies have the same plants and canopies. A policy with several trainings runs one of them per seed,
            in turn.
        cache: Folder in which calibrations are stored for later runs. If None, it is the folder "calibrations" in
            ``folder``; if ``folder`` is None too, no calibration is stored.
        backend: Backend that computes the pieces, as for `pickenv.experiments.run`.
        workers: Number of processes.
        progress: Called with (name of the present experiment, pieces done, total number of pieces).
        fits: Function that returns whether a combination is measured, called with plant, compensation, policy, seed and
            so on by name.

    Returns:
        For reaching, one row per episode. A row has plant, compensation, feedback, policy, seed, and training (the
        index of the training, from 0). ``learned`` says whether the policy was learned. ``arm`` is the index of the arm
        among the arms of all seeds, and ``episode`` the index of the episode with this arm, both from 0. ``error_mm``
        and ``attitude_deg`` are the errors at the end. ``way_mm`` is an array, the position error after each step (NaN
        after the end of the episode). ``cycle_steps`` is the number of steps until the tool stays within `CYCLE_MM` of
        the fruit (NaN if it never does). ``chance_NAME`` is the probability that gripper NAME takes the fruit. The
        fields of `pickenv.agents.Reaches` are columns, too.

        For picking, one row per arm, gripper and training, over all canopies. ``attempted`` is the number of grasps,
        ``collected`` the number of fruit collected undamaged, and ``duration_s`` the time, s. Two columns are sums over
        grasps. ``error_sum_mm`` is the sum of the distances between the fruit and the tool's true position.
        ``tilt_sum_deg`` is the sum of the angles between tool and vertical.

    Raises:
        InputError: If a name is unknown, no policy can run with these settings, or a stored file is damaged.
    """
    kept = cache if folder is None or cache is not None else Path(folder) / "calibrations"
    make = _reaching if task == "reaching" else _picking
    how: dict[str, Any] = {"backend": backend, "workers": workers, "progress": progress}
    with TemporaryDirectory() if kept is None else nullcontext(kept) as place:
        kept = Path(place).resolve()
        experiment = make(settings, kept, fits)
        calibrations = _calibrations(settings, kept, experiment)
        if calibrations.pieces():
            with listed_files(kept):
                run(calibrations, **how)
        return run(experiment, None if folder is None else Path(folder) / task, **how)


def _calibrations(settings: PolicySettings, kept: Path, experiment: Experiment) -> Experiment:
    """Return an experiment that calibrates the arms of ``experiment``; the folder ``kept`` gets the calibrations."""
    populations = {tuple(levels[name] for name in BEHIND) for levels, _ in experiment.pieces()}
    return Experiment(
        f"calibrations, {experiment.name}",
        {"seed": settings.levels("seeds"), "arm": range(settings.arms)},
        {name: tuple(dict.fromkeys(experiment.factors[name])) for name in BEHIND[:2]},
        partial(_calibrated, settings, kept),
        fits=lambda arm, **levels: levels["compensation"] != "raw" and tuple(map(levels.get, BEHIND)) in populations,
    )


BEHIND = ("plant", "compensation", "seed")
"""Columns whose levels identify a population of calibrated arms."""


def _calibrated(settings: PolicySettings, kept: Path, *, plant: str, seed: int, arm: int, **levels: Any) -> Columns:
    plan, design = replace(settings.plan, seed=seed), plant_at(settings.population(plant, seed), arm)
    calibration = methods.kept_calibration(kept, design, levels["compensation"], plan, arm)
    return {"key": np.array([calibration.record[methods.ORIGIN]])}


def _inputs(
    settings: PolicySettings, kinds: Mapping[str, Kind], *, plant: str, policy: str, seed: int, **levels: Any
) -> tuple[Any, ...]:
    """Return everything that the rows of one piece depend on, except the piece's levels of units and factors.

    Other policies and seeds of the comparison are left out. ``kinds`` has the properties of each policy by name. All
    arguments after ``kinds`` are the piece's levels.
    """
    learned = kinds[policy].files if policy in kinds else ()
    files = [path for name in learned for path in (Path(name), BASELINES / f"{name}.npz") if path.is_file()]
    return (
        replace(settings, policies=(), compensations=(), feedback=(), plants=(), seeds=()),
        settings.population(plant, seed),
        [load_gripper(name) for name in settings.grippers],
        [file_sha256(path) for path in files],
        str(origin("policy", policy)) if policy in names("policy") else None,
        methods.sources_of(levels["compensation"], settings.plan),
    )


# Reaching.


def _reaching(settings: PolicySettings, kept: Path, fits: Callable[..., bool]) -> Experiment:
    kinds = {name: _entrant(name) for name in settings.policies}
    labels = [policy_name(name) for name in kinds]
    for label in labels:
        if labels.count(label) > 1:
            raise InputError(f"two policies are called '{label}'; give one of them another name")
    if len({kind.moves_tool for kind in kinds.values()}) > 1:
        raise InputError("policies of pickenv/ReachTool-v0 reach for other fruit; compare them by themselves")

    def able(**levels: Any) -> bool:
        kind = kinds[levels["policy"]]
        behind = levels["compensation"] == "raw" or not kind.raw_only
        has_file = levels["feedback"] in kind.feedback and levels["training"] < (len(kind.files) or 1)
        return behind and has_file and fits(**levels)

    experiment = Experiment(
        "reaching",
        {"seed": settings.levels("seeds"), "training": _trainings(kinds)},
        {"plant": settings.levels("plants"), "compensation": settings.levels("compensations")}
        | {"feedback": settings.levels("feedback"), "policy": tuple(kinds)},
        partial(_reaches, settings, kinds, kept),
        inputs=partial(_inputs, replace(settings, canopies=0), kinds),
        fits=able,
    )
    if not experiment.pieces():
        needs = (
            f"{name} needs feedback {' or '.join(kind.feedback)}{' and compensation raw' if kind.raw_only else ''}"
            for name, kind in kinds.items()
        )
        raise InputError(
            f"no policy can be run with feedback {' or '.join(settings.feedback)} and compensation "
            f"{' or '.join(settings.compensations)}: {', '.join(needs)}; change one of them"
        )
    return experiment


def _trainings(kinds: Mapping[str, Kind]) -> range:
    return range(max((len(kind.files) or 1 for kind in kinds.values()), default=1))


def _entrant(name: str) -> Kind:
    """Return the properties of the policy ``name``, with the kinds of feedback that it can use in the comparison.

    If a policy declares several kinds of feedback, one step with each kind is tried. Kinds that the policy refuses are
    left out.

    Raises:
        InputError: If the policy is unknown, or refuses every kind of feedback.
    """
    kind, able, refusal = kind_of(name), [], ""
    if kind.picks:
        maker_of(name)  # refuses it
    if len(kind.feedback) == 1:
        return kind
    for feedback in kind.feedback:
        env = ReachVectorEnv(1, feedback=feedback)
        try:
            maker_of(name)(env, 0).act(env.reset(seed=0)[0])
            able.append(feedback)
        except InputError as error:
            refusal = str(error)
    if not able:
        raise InputError(refusal)
    return replace(kind, feedback=tuple(able))


def _reaches(
    settings: PolicySettings, kinds: Mapping[str, Kind], kept: Path, *, rng: np.random.Generator, plant: str,
    compensation: str, feedback: str, policy: str, seed: int, training: int,
) -> Columns:  # fmt: skip
    """Run the episodes of one policy, and return their columns.

    Args:
        settings: Settings of the comparison.
        kinds: Properties of each policy, by name.
        kept: Folder of calibrations.
        rng: Not used.
        plant: Plant preset, or name of a rung.
        compensation: "raw", or a method of calibration.
        feedback: "encoders" or "camera".
        policy: Name of the policy.
        seed: Seed of the comparison.
        training: Index of the policy's training, from 0.
    """
    kind, population = kinds[policy], settings.population(plant, seed)
    world = settings.world(plant, seed, feedback)
    noise = float(np.hypot(world["camera_noise_mm"] or settings.camera_noise_mm, world["fruit_noise_mm"]))
    make = maker_of((kind.files or (policy,))[training], noise, compensation)
    correct = methods.compensators(population, compensation, replace(settings.plan, seed=seed), kept)
    how: dict[str, Any] = {"compensators": correct, "sequential": kind.sequential, "steps": kind.steps}
    how |= {"first": settings.first_arm(plant, seed), **world}
    rollout = agents.roll_out(make, settings.arms, settings.episodes, seed, **how)
    reaches, count = rollout.reaches, len(rollout.arm)
    return {
        "policy": np.full(count, policy_name(policy)),
        "learned": np.full(count, bool(kind.files)),
        "arm": settings.levels("seeds").index(seed) * settings.arms + rollout.arm,
        "episode": np.arange(count) // settings.arms,
        "error_mm": reaches.position_error_mm,
        "attitude_deg": reaches.attitude_error_deg,
        "cycle_steps": rollout.cycle_steps(CYCLE_MM),
        "way_mm": rollout.error_mm.T,
        **{f"chance_{name}": rollout.capture(load_gripper(name)) for name in settings.grippers},
        **{attribute.name: np.asarray(getattr(reaches, attribute.name)) for attribute in fields(Reaches)},
    }


def reaches_in(rows: Rows) -> Reaches:
    """Return the final states of the episodes on one plant, from the rows of `run_policies` for reaching.

    A joint is left out if its command is not finite in some row.
    """
    columns: dict[str, Any] = {attribute.name: rows[attribute.name] for attribute in fields(Reaches)}
    commands = rows["joint_command"]
    return Reaches(**columns | {"joint_command": commands[:, np.isfinite(commands).all(axis=0)]})


# Picking.


def _picking(settings: PolicySettings, kept: Path, fits: Callable[..., bool]) -> Experiment:
    every = {name: kind_of(name) for name in settings.policies if name not in PICKERS}
    kinds = {name: kind for name, kind in every.items() if kind.picks or (kind.sequential and kind.files)}
    seeds = settings.levels("seeds")

    def able(**levels: Any) -> bool:
        kind = kinds.get(name := levels["policy"], Kind(raw_only=name in RAW_PICKERS))
        behind = levels["compensation"] == "raw" or not (kind.raw_only or kind.sequential)
        own = seeds.index(levels["seed"]) % (len(kind.files) or 1)  # each seed's arms meet one of several trainings
        return behind and levels["training"] == own and fits(**levels)

    return Experiment(
        "picking",
        {"seed": seeds, "training": _trainings(kinds)},
        {"plant": settings.levels("plants"), "gripper": settings.levels("grippers")}
        | {"policy": (*PICKERS, *kinds), "compensation": settings.levels("compensations")},
        partial(_picks, settings, kinds, kept),
        inputs=partial(_inputs, settings, kinds),
        fits=able,
    )


def _picker(policy: str, kinds: Mapping[str, Kind], training: int) -> tuple[Callable[[Any], Policy], str]:
    """Return a function that makes a picking policy for an environment, and the feedback "gripper" or "encoders".

    The environment must give this feedback. ``kinds`` has the properties of each policy by name. ``training`` is the
    index, from 0, of the training of a learned policy.
    """
    if policy in PICKERS:
        return PICKERS[policy], "gripper" if policy == "adaptive" else "encoders"
    learned = load_any(kinds[policy].files[training])
    if isinstance(learned, agents.RememberingPolicy):
        return lambda env: agents.FeelingPick(env, agents.RememberingReach(env, learned)), "gripper"
    return lambda env: learned, "encoders"


def _picks(
    settings: PolicySettings, kinds: Mapping[str, Kind], kept: Path, *, rng: np.random.Generator, plant: str,
    gripper: str, policy: str, compensation: str, seed: int, training: int,
) -> Columns:  # fmt: skip
    """Return the results of one picking policy with each arm of a seed, over all canopies of the arm.

    A policy that learns from the fruit in its gripper meets an arm's canopies one after the other. Any other policy
    meets all canopies of all arms at once. ``gripper`` is the name of a gripper. All other arguments are as for
    `_reaches`.
    """
    first, arms = settings.first_arm(plant, seed), np.arange(settings.arms)
    world = settings.world(plant, seed, task="Pick") | {"arms": "per_episode", "population": first + settings.arms}
    population, plan = settings.population(plant, seed), replace(settings.plan, seed=seed)
    correct = methods.compensators(population, compensation, plan, kept)
    make, feedback = _picker(policy, kinds, training)
    fruit = np.array([seed_words(stream(seed, "picks", arm), settings.canopies) for arm in arms.tolist()]).T
    rounds = fruit if feedback == "gripper" else fruit.reshape(1, -1)
    rows = np.tile(arms, rounds.shape[1] // len(arms))
    envs = PickVectorEnv(len(rows), gripper=gripper, feedback=feedback, **world)
    envs.compensator = None if correct is None else [correct[row] for row in rows.tolist()]
    picker = make(envs)
    parts = [pick_canopies(picker, envs, seeds.tolist(), {"arm": first + rows}) for seeds in rounds]
    sums = ("attempted", "collected", "duration_s", "error_sum_mm", "tilt_sum_deg")
    of_arms = {name: np.stack([part[name] for part in parts]).reshape(-1, len(arms)).sum(axis=0) for name in sums}
    arms += settings.levels("seeds").index(seed) * settings.arms
    return {"policy": np.full(len(arms), policy_name(policy)), "arm": arms, **of_arms}
