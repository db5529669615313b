"""Commands about policies: `pickenv train`, `pickenv evaluate` and `pickenv datasets`."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from typer import Option

import pickenv
from pickenv.base import InputError, command_line, count_of, require, separate
from pickenv.commands.showing import MOST, PARAMETERS, arguments_for, deliver, print_table, print_verdict, progress_bars

NO_CAMERA = "--camera-noise changes nothing without a camera; give --feedback camera and a policy that uses it"


def train(
    context: typer.Context,
    algo: Literal["ppo", "sac", "tqc", "ppo_lstm", "ppo_history"] = "ppo",
    env: str = "pickenv/Reach-v0",
    compensate: Path | None = None,
    allow: list[str] | None = None,
    plant: list[str] | None = None,
    feedback: Literal["encoders", "camera"] = "encoders",
    camera_noise: float = 0.0,
    fruit_noise: float = 0.0,
    randomise: str | None = None,
    steps: Annotated[int | None, Option(min=1)] = None,
    seed: Annotated[int, Option(min=0)] = 0,
    checkpoint_every: Annotated[int, Option(min=1)] = 50_000,
    evaluate_every: Annotated[int, Option(min=1)] = 50_000,
    out: Path = Path("runs/train"),
    resume: Annotated[bool, Option("--resume")] = False,
) -> None:
    """Train a policy; write its file, checkpoints, evaluations and TensorBoard logs to a folder.

    Args:
        context: The command line as it was typed.
        algo: Algorithm; ppo_lstm and ppo_history remember past picks and learn on many fruit of one arm.
        env: Id of the environment; a policy of pickenv/ReachTool-v0 fits any arm.
        compensate: Calibration file (.npz) that corrects the arm in training.
        allow: Use the calibration in spite of this reservation: fitted-frames, do-not-use.
        plant: Plant preset or plant file; the environment's if left out. May be repeated with ppo_lstm, ppo_history.
        feedback: What the policy sees besides its joints.
        camera_noise: Standard deviation of the gap between tool and fruit as the camera sees it, mm per axis.
        fruit_noise: Standard deviation of the fruit's position, mm per axis.
        randomise: Tolerance class from which each episode draws a new arm (domain randomisation).
        steps: Number of environment steps; the tuned number if left out.
        seed: Seed of all random numbers.
        checkpoint_every: Number of steps between checkpoints.
        evaluate_every: Number of steps between evaluations.
        out: Run folder to write.
        resume: Continue from the folder's checkpoint, with the options of its start.

    Examples:
        pickenv train --steps 100000 --compensate my_arm.npz --out runs/policy

    More: commands.md
    """
    typed = dict(locals())
    from pickenv.agents.training.training import resumed
    from pickenv.agents.training.training_setup import arguments_of, words_of

    written = [out / name for name in ("policy.npz", "checkpoint.pt", "evaluations.json")]
    separate({"--compensate": compensate, "--plant": plant}, {"--out": written})
    if resume:
        training = resumed(out)
        _refuse_changes(context, training, out)
    else:
        if (out / "checkpoint.pt").exists():
            raise InputError(f"{out} holds a training already; go on with --resume, or give another --out")
        if allow and compensate is None:
            raise InputError("--allow is of a calibration; give --compensate with it, or leave --allow out")
        if randomise is not None:
            _refuse_class("randomise", plant or [])
        arguments: dict[str, Any] = {
            "plant": plant[0] if plant and len(plant) == 1 else plant or None,
            "feedback": feedback if _was_given(context, "feedback") else None,  # else the algorithm's own
            "camera_noise_mm": camera_noise if _was_given(context, "camera_noise") else None,
            "fruit_noise_mm": fruit_noise if camera_noise or fruit_noise else None,
            "arms": None if randomise is None else "per_episode",
            "tolerances": randomise,
        }
        given: dict[str, Any] = {name: value for name, value in arguments.items() if value is not None}
        behind = {} if compensate is None else {"compensate": str(compensate)}
        training = pickenv.agents.Training(**arguments_for(pickenv.agents.Training, typed) | behind, arguments=given)
        if _was_given(context, "camera_noise") and arguments_of(training)[0].get("feedback") != "camera":
            raise InputError(NO_CAMERA)
    try:
        done = pickenv.agents.train(training, out, resume=resume, progress=sys.stderr.isatty())
    except KeyboardInterrupt:
        print(
            f"interrupted; `pickenv train --resume --out {shlex.quote(str(out))}` goes on from its last checkpoint",
            file=sys.stderr,
        )
        raise
    last = done.evaluations[-1]
    headline = f"{training.algorithm} on {training.env_id}: {words_of(last)} after {last['steps']:.0f} steps"
    deliver([(out, lambda _: written)], f"{headline}, {done.steps_per_second:.0f} steps/s")


def _refuse_changes(context: typer.Context, begun: pickenv.agents.Training, out: Path) -> None:
    """Raise an `InputError` if an option on the command line differs from the training that is to be resumed.

    ``begun`` has the settings of this training, and ``out`` is its folder.
    """
    usual = {"plant": None, "feedback": "encoders", "camera_noise_mm": 0.0, "fruit_noise_mm": 0.0, "tolerances": None}
    said = usual | begun.chosen.get("env_kwargs", {}) | vars(begun) | begun.arguments | {"steps": begun.total}
    said = {PARAMETERS.get(name, name): value for name, value in said.items()} | {"randomise": said["tolerances"]}
    if isinstance(said["plant"], str):
        said["plant"] = [said["plant"]]
    changed = []
    for name in (str(param.name) for param in context.command.params):
        value = str(context.params[name]) if isinstance(context.params[name], Path) else context.params[name]
        if name in said and _was_given(context, name) and value != said[name]:
            word = name.replace("_", "-")
            typed = [f" --{word} ".join(each) if isinstance(each, list) else each for each in (said[name], value)]
            changed.append(f"without --{word}" if said[name] is None else f"with --{word} {typed[0]}, not {typed[1]}")
    if changed:
        raise InputError(
            f"the training in {out} was begun {', '.join(changed)}; leave out what was not said then, or give "
            "another --out"
        )


def _refuse_class(option: str, plants: Sequence[str]) -> None:
    """Raise an `InputError` if every plant has a tolerance class in its name, such as "coarse:ur5e".

    Then the class that the option named ``option`` gives would have no effect.
    """
    if plants and all(pickenv.arm.class_of(name) is not None for name in plants):
        raise InputError(f"`{option}` changes nothing: plant '{plants[0]}' names its class itself; leave it out")


def _was_given(context: typer.Context, name: str) -> bool:
    """Return whether the option with the parameter ``name`` was given on the command line.

    Click says where an option's value came from. The name of this source is compared, since Typer may bring its own
    copy of click.
    """
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def evaluate(
    context: typer.Context,
    policy: list[str] | None = None,
    compensation: list[str] | None = None,
    feedback: list[str] | None = None,
    plant: list[str] | None = None,
    gripper: list[str] | None = None,
    arms: Annotated[int, Option(min=1)] = 64,
    episodes: Annotated[int, Option(min=1)] = 32,
    tolerances: str = "coarse",
    camera_noise: float = 1.0,
    fruit_noise: float = 0.0,
    epochs: Annotated[int, Option(min=1)] = 100,
    seed: Annotated[int, Option(min=0)] = 0,
    json_file: Annotated[Path | None, Option("--json")] = None,
    cache: Path | None = None,
    workers: Annotated[int | None, Option(min=1)] = None,
    details: Annotated[bool, Option("--details")] = False,
    out: Path | None = None,
) -> None:
    """Compare policies, raw and calibrated, open loop and with a camera, on the same arms and fruit.

    With all defaults it takes about ten minutes on two cores. On each of 64 arms, least squares take 0.1 s of processor
    time, a Gaussian process 3 s and a network 3 s. Fewer --arms or --compensation take less; --cache keeps
    calibrations.

    Args:
        context: The command line as it was typed.
        policy: {policy}, a baseline, a policy file, or the folder of a training or of several seeds; may be repeated.
        compensation: raw, ls, ls_bpnn, best, or ls+ and any residual model; may be repeated.
        feedback: encoders, camera; may be repeated.
        plant: Plant preset; may be repeated.
        gripper: Gripper, by name or as a file of kind {gripper}; may be repeated.
        arms: Number of arms drawn for each plant.
        episodes: Number of fruit per arm.
        tolerances: Tolerance class of the arms; a class that a plant's name begins with takes precedence.
        camera_noise: Standard deviation of the gap between tool and fruit as the camera sees it, mm per axis.
        fruit_noise: Standard deviation of the fruit's position, mm per axis.
        epochs: Training epochs of each arm's network.
        seed: Seed of arms, fruit, pictures and calibrations.
        json_file: Write the rows to this file.
        cache: Folder that keeps the arms' calibrations.
        workers: Number of processes; one per core if left out.
        details: Print medians, success by gripper, cycle times, and what each compensation changes as well.
        out: Run folder for `pickenv figures` and `pickenv report`.

    Examples:
        pickenv evaluate --policy runs/policy --out runs/comparison

    More: findings.md
    """
    typed = dict(locals())
    from pickenv.agents.evaluation.contenders import kind_of
    from pickenv.experiments import policy_tables as tables
    from pickenv.experiments.methods import residual_of
    from pickenv.experiments.policies import RUNG
    from pickenv.inspect.runs.run_folder import RECORD

    written = [] if out is None else [out / name for name in (RECORD, tables.EPISODES, tables.ROWS)]
    separate(
        {"--policy": policy, "--plant": plant, "--gripper": gripper, "--tolerances": tolerances},
        {"--out": written, "--json": json_file},
    )
    fields = arguments_for(pickenv.experiments.PolicySettings, typed)
    lists = {name: tuple(value) for name, value in fields.items() if isinstance(value, list)}
    plan = pickenv.experiments.CalibrationPlan(epochs=epochs)
    settings = pickenv.experiments.PolicySettings(**fields | lists, seeds=(seed,), plan=plan)
    models = {residual_of(name) for name in settings.compensations}
    if _was_given(context, "epochs") and "bpnn" not in models:
        raise InputError("--epochs is of networks, and no --compensation has one; leave it out, or add ls_bpnn")
    if cache is not None and set(settings.compensations) == {"raw"}:
        raise InputError("--cache keeps calibrations, and --compensation raw has none; leave --cache out")
    if _was_given(context, "tolerances"):
        plants = [name for name in settings.plants if not name.startswith(RUNG)]
        _refuse_class("tolerances", plants)
        twins = (pickenv.load_plant(name).posterior for name in plants)
        if plants and all(twin is not None and not len(twin.unseen) for twin in twins):
            raise InputError(
                f"`tolerances` changes nothing: the calibration behind twin '{plants[0]}' tells all of its parameters, "
                "with priors of its own class; leave it out"
            )
    kinds = [kind_of(name) for name in settings.policies]
    has_camera = "camera" in settings.feedback and any("camera" in kind.feedback for kind in kinds)
    if _was_given(context, "camera_noise") and not has_camera:
        raise InputError(NO_CAMERA)
    require(*([] if out is None else ["pyarrow"]))
    long = workers is not None or any(models)  # else processes take longer to start than to work
    backend = "loky" if workers != 1 and long else "serial"
    with progress_bars() as bars:
        rows = pickenv.experiments.run_policies(settings, cache=cache, backend=backend, workers=workers, progress=bars)
    content = tables.evaluation_content(settings, rows)
    deliver(
        [(json_file, content), (out, lambda folder: tables.write_evaluation(settings, rows, folder))],
        lambda: _print(**content, details=details),
        "see the arms one by one: the same command with --out RUN, then pickenv report RUN"
        if out is None
        else f"see the arms one by one: {command_line('pickenv', 'report', out)}",
        "" if details else "medians, success by gripper, and what each compensation is worth",
    )


def _print(rows: Sequence[dict[str, Any]], comparisons: Sequence[dict[str, Any]], details: bool) -> None:
    """Print which policy ends nearest on each plant, and a table of the errors, or of all numbers with ``details``.

    ``rows`` has the results of each policy on each plant, and ``comparisons`` the differences between policies.
    """
    from pickenv.experiments.policy_tables import HEADS, KEYS, cells_of, gain_words, nearest_words, pivoted

    print_verdict("\n".join(nearest_words(rows, comparisons)))
    episodes = rows[0]["episodes"] // (rows[0]["trainings"] or 1)
    reaches, arms = count_of(episodes, "reach", "reaches"), count_of(rows[0]["arms"], "arm")
    title = f"{reaches} per cell on {arms}, seed {rows[0]['seeds'][0]}"
    if not details:
        heads, cells = pivoted(rows)
        missing = rows[0]["no_interval"]
        caption = "means over arms" + (f" (no intervals: {missing})" if missing else ", 95 % intervals in brackets")
        print_table(f"Error (mm): {title}", heads, cells, words=KEYS, caption=caption, most=MOST)
        heads, taken = pivoted(rows, shares=True)
        if len(cells) + len(taken) <= MOST:
            print_table("Fruit taken (%)", heads, taken, words=KEYS)
        return
    caption = "mean, median and 95th percentile are over arms; 95 % intervals over arms, and over trainings if several"
    print_table(title, (*KEYS, *HEADS), map(cells_of, rows), words=KEYS, caption=caption)
    for line in comparisons:
        difference, ends, significant = gain_words(line)
        print(
            f"{line['policy']}, {line['feedback']}, {line['plant']}: {line['from']} to {line['to']} "
            f"{difference} mm ({ends}), significant: {significant}"
        )


def datasets(
    task: list[str] | None = None,
    quality: list[str] | None = None,
    episodes: Annotated[int | None, Option(min=1)] = None,
    seed: Annotated[int, Option(min=0)] = 0,
    json_file: Annotated[Path | None, Option("--json")] = None,
    out: Path = Path("runs/datasets"),
) -> None:
    """Record Minari data sets of expert, medium and random policies; existing data sets are kept.

    Args:
        task: reach, pick, scene, sight; may be repeated. Reach if left out.
        quality: expert, medium, random; may be repeated. All if left out.
        episodes: Episodes of each; 256 reaches, 32 canopies, 64 scenes or 150 sights if left out.
        seed: Seed of all random numbers.
        json_file: Write the data sets' cards (summaries) to this file.
        out: Folder to write, in Minari's layout.

    Examples:
        pickenv datasets --out runs/datasets
        pickenv datasets --task pick --quality expert

    More: clients.md
    """
    from pickenv.agents.demonstrations.data_sets import QUALITIES

    separate({}, {"--json": json_file})
    with progress_bars() as report:
        cards = pickenv.agents.datasets(
            out, task or ("reach",), quality or QUALITIES, episodes=episodes, seed=seed, progress=report
        )
    deliver([(json_file, cards)], lambda: _print_cards(cards, out))


def _print_cards(cards: Sequence[dict[str, Any]], out: Path) -> None:
    """Print the name and size of each data set recorded in the folder ``out``, and how to read one of them.

    ``cards`` are the data sets' summaries.
    """
    columns = {
        "final_error_mm": ("error at the end, mean (mm)", 1.0),
        "success": ("success (%)", 100.0),
        "collected": ("fruit collected", 1.0),
    }
    columns = {key: column for key, column in columns.items() if any(key in card for card in cards)}
    rows = []
    for card in cards:
        cells = ["" if card.get(key) is None else f"{by * card[key]:.2f}" for key, (_, by) in columns.items()]
        rows.append([card["name"], str(card["episodes"]), str(card["steps"]), f"{card['mean_return']:.2f}", *cells])
    heads = ("data set", "episodes", "steps", "return, mean", *(head for head, _ in columns.values()))
    caption = f"simulated; MINARI_DATASETS_PATH={out.resolve()} lets Minari find them by name"
    print_table(f"Recorded with seed {cards[0]['seed']}", heads, rows, words=("data set",), caption=caption)
