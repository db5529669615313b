"""What calibration buys a policy: the measures of the studies behind docs/findings.md.

Simulated arms of tolerance class coarse that nothing was trained on, each with its own calibration, which is kept and
shared by the studies of one seed. Policies that learnt have trainings of their own; what is missing is trained.
"""

from pathlib import Path
from typing import Any

import numpy as np
from train_baselines import calibration_file

from pickenv.agents import Training, load_policy, train
from pickenv.arm import TRACKER, Array, Pose, forward, joint_jacobian, plant_at, pose_of
from pickenv.base import InputError, mean_interval, run_seed, seed_words, stream
from pickenv.calibration import complete_model, random_joints, start_filter
from pickenv.calibration.compensation.compensator import aimed, taught
from pickenv.experiments import CalibrationPlan, PolicySettings, Rows, calibrate_arm, joined, run_policies
from pickenv.experiments.methods import compensators
from pickenv.inspect.colours import in_words, policy_label
from pickenv.inspect.figures.style import INK, WIDTH, new_figure
from pickenv.inspect.recordings.details import CAMERA_STD, DAY_HOURS, DRIFTS, LOOK, PRIOR, WALK, joints_at
from pickenv.orchard import capture_probability, load_gripper, misalignment

TRAINED_ON: dict[str, dict[str, Any]] = {
    "calibrated arms": {"compensate": "calibration.npz"},
    "raw arms": {},
    "randomised arms": {"arguments": {"arms": "per_episode", "tolerances": "coarse"}},
}
WHERE_LS_IS_ENOUGH = "orchard"
"""There drift is what is left, and residual models are left out."""

SEEING = ("raw", "ls", "best")
ALWAYS = "in every period, raw"
NEAR, BEHIND = 0.1, 0.1
"""m; from how far before a fruit an arm looks at it from near, and how far behind the tool its eye sits."""

GAIN, PERIODS, PERIOD = 0.3, 40, 0.1
"""Of the servo: share of the gap it goes at once, how often it looks, and how long a command is held, s."""

ROOM = 0.02
"""Share of a joint's range that a look from near keeps from its limits."""

GRIPPER = "li_cup"


def settings_of(
    arms: int, episodes: int, epochs: int, seed: int, instrument: str = TRACKER, **changes: Any
) -> PolicySettings:
    """A comparison at one seed."""
    plan = CalibrationPlan(epochs=epochs, seed=seed, instrument=instrument)
    return PolicySettings(arms=arms, episodes=episodes, seeds=(seed,), plan=plan, **changes)


FEWER = 4
"""A draw of constants has so many times fewer arms than the design as shipped."""


def fits(plant: str, compensation: str, policy: str, draw: int, **levels: Any) -> bool:
    """Residual models are for plants whose arms come to rest; with a camera a policy needs none of them."""
    enough = ("raw",) if policy == "oracle" else ("raw", "ls") if plant == WHERE_LS_IS_ENOUGH else (compensation,)
    learnt = plant == WHERE_LS_IS_ENOUGH and policy not in ("scripted", "servo")
    return compensation in enough and not learnt and drawn_on(plant, draw)


def fits_adaptive(plant: str, compensation: str, draw: int, **levels: Any) -> bool:
    """Behind least squares the filter has little to learn but on arms that drift."""
    return (compensation == "raw" or plant == WHERE_LS_IS_ENOUGH) and drawn_on(plant, draw)


def fits_ladder(plant: str, policy: str, feedback: str, **levels: Any) -> bool:
    """The script needs no camera, and is left out on the rung that fixes one."""
    blind = policy == "scripted"
    return feedback == ("encoders" if blind else "camera") and not (blind and plant == "rung:own_eyes")


def drawn_on(plant: str, draw: int, **levels: Any) -> bool:
    """Constants are drawn where they decide: of the ground."""
    return draw == 0 or plant == "orchard"


def world(plant: str, draw: int, arms: int, seed: int) -> tuple[str, int, int]:
    """Name of the plant, number of arms and seed: those asked for, or of a draw of the plant's constants."""
    if not draw:
        return plant, arms, seed
    own = seed_words(stream(seed, "constants", draw), 1)[0] % 10**9
    return f"{plant}#{own}", max(arms // FEWER, 1), own


def reaching(
    rng: np.random.Generator, plant: str, compensation: str, policy: str, arms: int, episodes: int, epochs: int,
    folder: str, seed: int, feedback: str = "encoders", instrument: str = TRACKER, draw: int = 0,
) -> Any:  # fmt: skip
    """Reaches of one policy: a row for each arm and fruit, in the order in which it met them."""
    name, arms, seed = world(plant, draw, arms, seed)
    chosen: dict[str, Any] = {"plants": (name,), "compensations": (compensation,), "feedback": (feedback,)}
    settings = settings_of(arms, episodes, epochs, seed, policies=(policy,), instrument=instrument, **chosen)
    rows = run_policies(settings, cache=Path(folder) / "calibrations").columns
    pick, half = rows["episode"] + 1, episodes // 2
    when = np.where(pick == 1, "first pick", np.where(pick <= 8, "picks 2 to 8", "later"))
    columns = ("arm", "training", "error_mm", *(column for column in rows if column.startswith("chance_")))
    when = np.where(pick > half, "second half", when)
    return {column: rows[column] for column in columns} | {"pick": pick, "when": when}


def train_once(training: Training, place: Path) -> None:
    """Train a policy where it is missing.

    Raises:
        InputError: If the one that is there was trained with another number of steps.
    """
    kept = place / "policy.npz"
    if not kept.is_file():
        train(training, place, resume=(place / "checkpoint.pt").is_file())
    elif (steps := load_policy(kept).record["training"]["steps"]) != training.steps:
        raise InputError(f"{kept} was trained for {steps} steps, not for {training.steps}; give another `folder`")


def carried(
    rng: np.random.Generator, trained_on: str, compensation: list[str], arms: int, episodes: int, epochs: int,
    steps: int, trainings: int, folder: str, seed: int,
) -> Any:  # fmt: skip
    """Reaches of several trainings of PPO without a camera, on new arms of qiao2026.

    One piece has all compensations: two processes never train in one folder. Each seed has trainings of its own.
    """
    out = Path(folder) / "transfer" / (trained_on.split()[0] + f"-{seed}" * (seed > 0))
    for number in range(trainings):
        what, place = dict(TRAINED_ON[trained_on]), out / str(number)
        if "compensate" in what:
            what["compensate"] = str(calibration_file(Path(folder)))
        train_once(Training("ppo", seed=run_seed(seed % 2**16) + number, steps=steps, **what), place)
    parts = []
    for behind in compensation:
        rows = reaching(rng, "qiao2026", behind, str(out), arms, episodes, epochs, folder, seed)
        parts.append(Rows({"compensation": np.full(len(rows["arm"]), behind)} | rows))
    return joined(parts)


def judged(end: Pose, wanted: Pose) -> tuple[Array, Array]:
    """How far ends are from where they should be, mm, and the chance that Li's cup takes the fruit there ``(...)``."""
    offset, axis = wanted.position - end.position, end.rotation[..., 2]
    lying = misalignment(offset, axis, np.broadcast_to(wanted.rotation[..., 2], axis.shape))
    taken = capture_probability(load_gripper(GRIPPER), *lying)
    return 1e3 * np.linalg.norm(offset, axis=-1), taken


def sight(
    rng: np.random.Generator, plant: str, arms: int, episodes: int, epochs: int, scatter_mm: list[float],
    bias_mm: list[float], folder: str, seed: int, draw: int,
) -> Any:  # fmt: skip
    """What the same eye at the tool is worth, by how it is used: a row for each arm, use, scatter and bias.

    The eye looks once from home, once from near, or in every period; what it says of the fruit is the believed arm's
    pose at the look and the fruit as seen from there. Once seen, a blind arm goes there. Seen in every period, the raw
    arm is led by a servo. The eye's bias, of the hand-eye calibration, is one vector of each arm, and its scatter
    grows with the distance.
    """
    name, arms, seed = world(plant, draw, arms, seed)
    settings = settings_of(arms, episodes, epochs, seed)
    plants, kept = settings.population(name, seed), Path(folder) / "calibrations"
    nominal = plants.arm.nominal
    goals = random_joints(nominal, episodes * arms, rng).reshape(episodes, arms, -1)
    cells = np.stack(np.meshgrid(scatter_mm, bias_mm, indexing="ij"), -1).reshape(-1, 1, 2) * 1e-3 / np.sqrt(3.0)
    scatter, bias = cells[..., :1] / (NEAR + BEHIND), cells[..., 1:] * rng.standard_normal((arms, 3))
    room = ROOM * (nominal.upper - nominal.lower)
    low, high = nominal.lower + room, nominal.upper - room
    home = np.broadcast_to((nominal.lower + nominal.upper) / 2, (len(cells), arms, nominal.joints))
    behind = {"raw": None} | {name: compensators(plants, name, settings.plan, kept) for name in SEEING if name != "raw"}

    def moved(state: Any, q: Array, by: Any, time: float = PERIODS * PERIOD) -> tuple[Any, Pose]:
        """The arms after a command that was corrected where they are calibrated; a blind one may come to rest.

        Without a state they begin at the command.
        """
        if state is None:
            state = plants.initial_state(np, list(np.moveaxis(q, -1, 0)))
        if by is not None:
            q = np.stack([correct(q[:, i]) for i, correct in enumerate(by)], axis=1)
        state, frame = plants.advance(np, state, list(np.moveaxis(q, -1, 0)), time)
        return state, pose_of(frame)

    def seen(true: Pose, q: Array, fruit: Array, noise: Array) -> Array:
        """Where the fruit is for an arm that believes to stand where its nominal twin does."""
        gap = fruit - true.position
        away = np.linalg.norm(gap, axis=-1, keepdims=True) + BEHIND
        there = np.einsum("...ji,...j->...i", true.rotation, gap) + bias + scatter * away * noise
        thought = forward(nominal, q)
        return thought.position + np.einsum("...ij,...j->...i", thought.rotation, there)

    ends: dict[str, list[Pose]] = {}
    targets = forward(nominal, goals)
    for k, goal in enumerate(goals):
        fruit, aim = targets.position[k], targets.rotation[k]
        at = np.broadcast_to(goal, home.shape)
        near = goal
        for _ in range(4):  # as near to there as the joints let it come, with room for a correction
            near = np.clip(joints_at(nominal, near, fruit - NEAR * aim[..., 2]), low, high)
        noise = rng.standard_normal((2, *home.shape[:2], 3))
        for name, by in behind.items():
            for where, q, eye in (("afar", home, noise[0]), ("near", np.broadcast_to(near, home.shape), noise[1])):
                state, true = moved(None, q, by)
                place = seen(true, q, fruit, eye)
                there = joints_at(nominal, at.reshape(-1, nominal.joints), place.reshape(-1, 3)).reshape(at.shape)
                ends.setdefault(f"once from {where}, {policy_label(name)}", []).append(moved(state, there, by)[1])
        q = np.broadcast_to(near, home.shape)
        state, true = moved(None, q, None)
        for _ in range(PERIODS):
            step = seen(true, q, fruit, rng.standard_normal(true.position.shape)) - forward(nominal, q).position
            inverse = np.linalg.pinv(joint_jacobian(nominal, q)[..., :3, :])
            q = np.clip(q + GAIN * np.einsum("...ij,...j->...i", inverse, step), nominal.lower, nominal.upper)
            state, true = moved(state, q, None, PERIOD)
        ends.setdefault(ALWAYS, []).append(true)
    parts, wanted = [], Pose(targets.position[:, None], targets.rotation[:, None])
    levels = {"scatter_mm": cells[..., 0] * 1e3 * np.sqrt(3.0), "bias_mm": cells[..., 1] * 1e3 * np.sqrt(3.0)}
    for use, poses in ends.items():
        end = Pose(*(np.stack([getattr(pose, part) for pose in poses]) for part in ("position", "rotation")))
        error, taken = (values.mean(axis=0) for values in judged(end, wanted))
        columns = {name: np.round(values, 9) for name, values in levels.items()} | {"arm": np.arange(arms)}
        columns |= {"use": np.full(error.shape, use), "error_mm": error, "taken": taken}
        parts.append(Rows({name: np.broadcast_to(column, error.shape).ravel() for name, column in columns.items()}))
    return joined(parts)


def sight_map(rows: Rows) -> Any:
    """What an arm that looks once leaves more than one that looks always: a panel for each plant and calibration."""
    rows = rows.where(draw=0)
    plants = [plant for (plant,) in rows.levels("plant")]
    uses = [f"once from {where}, {policy_label(name)}" for where in ("afar", "near") for name in SEEING[1:]]
    x, y = (sorted({value for (value,) in rows.levels(name)}) for name in ("scatter_mm", "bias_mm"))
    with new_figure(WIDTH, 2.2 * len(plants) + 0.6) as figure:
        panels: Any = figure.subplots(len(plants), len(uses), sharex=True, sharey=True, squeeze=False)
        for line, plant in zip(panels, plants, strict=True):
            for axis, use in zip(line, uses, strict=True):
                shown = np.empty((len(y), len(x)))
                for j, i in np.ndindex(shown.shape):
                    both = [rows.where(plant=plant, use=u, scatter_mm=x[i], bias_mm=y[j]) for u in (use, ALWAYS)]
                    more = both[0]["error_mm"] - both[1]["error_mm"]
                    shown[j, i] = more.mean()
                    low, high = mean_interval(more) or (-np.inf, np.inf)
                    words = f"{shown[j, i]:.1f}" if low > 0.0 or high < 0.0 else "0"
                    dark = "white" if shown[j, i] > 1.8 else INK
                    axis.text(i, j, words, ha="center", va="center", fontsize=7, color=dark)
                picture = axis.imshow(shown, origin="lower", aspect="auto", cmap="Oranges", vmin=0.0, vmax=3.0)
                axis.grid(visible=False)
                axis.set_xticks(range(len(x)), [f"{value:g}" for value in x])
                axis.set_yticks(range(len(y)), [f"{value:g}" for value in y])
            line[0].set_ylabel(f"{in_words(plant)}\nbias (mm)")
        for axis, use in zip(panels[0], uses, strict=True):
            axis.set_title(in_words(use).replace(", ", "\n").replace(" + ", "\n+ "), fontsize=8)
        for axis in panels[-1]:
            axis.set_xlabel("scatter (mm)")
        figure.colorbar(picture, ax=panels, label="more than looking in every period (mm)", shrink=0.6, extend="max")
    return figure


def day(rng: np.random.Generator, draw: int, arms: int, picks: int, epochs: int, seed: int) -> Any:
    """A day in the orchard: the arm warms up and the machine sinks; a row for each method, arm and pick."""
    name, arms, seed = world("orchard", draw, arms, seed)
    settings = settings_of(arms, 1, epochs, seed)
    plants = settings.population(name, seed)
    nominal, dt = plants.arm.nominal, DAY_HOURS * 3600.0 / picks
    draws = np.random.default_rng(stream(seed, "picks"))
    goals = random_joints(nominal, picks * arms, draws).reshape(picks, arms, -1)
    looks = draws.normal(size=(picks, arms, 3)) * CAMERA_STD
    workshop = plants.without(DRIFTS)  # firm ground, and the temperature at which the arm was built
    fitted = [calibrate_arm(plant_at(workshop, i), "ls", settings.plan, i).compensator() for i in range(arms)]
    seen = goals.reshape(-1, nominal.joints)[:300]
    first = start_filter(complete_model(nominal), nominal, seen, full_pose=False, prior=PRIOR)
    parts = []
    for method in ("raw", "calibrated in the workshop", "and adapted online"):
        state, filters = plants.initial_state(np, list(goals[0].T)), [first] * arms
        for k, target in enumerate(goals):
            wanted = forward(nominal, target).position
            if method == "and adapted online":
                target = aimed(nominal, filters, target)
            command = target if method == "raw" else np.stack([f(q) for f, q in zip(fitted, target, strict=True)])
            state, frame = plants.advance(np, state, list(command.T), dt)
            tool = np.stack(np.broadcast_arrays(*frame[9:12]), axis=-1)
            if method == "and adapted online":
                filters = taught(filters, target, tool + looks[k], LOOK, WALK, dt)
            error = np.linalg.norm(tool - wanted, axis=-1) * 1e3
            columns = {"method": np.full(arms, method), "arm": np.arange(arms), "error_mm": error}
            parts.append(Rows(columns | {"time_h": np.full(arms, (k + 1.0) * dt / 3600.0)}))
    rows = joined(parts).columns
    part = np.where(rows["time_h"] <= DAY_HOURS / 8, "first hour", "between")
    return {**rows, "part": np.where(rows["time_h"] > DAY_HOURS * 3 / 4, "last two hours", part)}
