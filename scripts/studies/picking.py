"""When does learning beat scripted picking? The script, in haste, with learnt numbers, and PPO, on the same canopies.

Policy search (`policy_search`, beside this) learns the script's nine numbers; PPO learns to pick with steps
of the tool. No canopy that judges was seen by a search or a training. Simulated.
"""

import json
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from findings import train_once
from policy_search import KNOBS, Searches, arguments_of, search

from pickenv.agents import HASTY, HELD_OUT, ScriptedPick, Training, load_policy, pick_canopies
from pickenv.arm import Array
from pickenv.base import run_seed, seed_words, stream
from pickenv.envs import PickVectorEnv
from pickenv.experiments import Rows, joined
from pickenv.inspect.colours import policy_colours
from pickenv.inspect.figures.style import WIDTH, headline, new_figure, rgb

SEARCHES = 5
"""Of each condition, with seeds of their own."""
CLUMPS = {"fruit_map": "v_trellis", "fruit": 25.0}
CONDITIONS: dict[str, dict[str, Any]] = {
    "as in Pick-v0": {},
    "late: readings and actions up to a period late": {"difficulty": "orchard"},
    "haste: 10 s a canopy": {"max_episode_steps": 100},
    "sway: clumps, fruit pushes fruit": CLUMPS,
    "occlusion: what pictures of trees left unseen": {"vision": "measured_errors"},
}
"""What one thing rules, and the environment's arguments."""

AIM = ("aim_x", "aim_y", "aim_z")
PARTS = {"learnt": tuple(KNOBS), "learnt aim alone": AIM, "all but the aim": tuple(set(KNOBS) - set(AIM))}
"""Which of the learnt numbers are used."""

PLACES: dict[str, dict[str, Any]] = {
    "as trained": {},
    "rung orchard, arms for judging": {"difficulty": "orchard", "split": "test"},
}
CURVE = 16
"""Canopies after every second generation, as many as `pickenv train` judges by."""


def canopy_rows(policy: str, found: dict[str, Array], canopies: int) -> dict[str, Any]:
    """One row a canopy, of one policy or of several trainings one after the other."""
    training, canopy = np.divmod(np.arange(len(found["duration_s"])), canopies)
    columns = {name: found[name] for name in ("collected", "damaged", "attempted", "reward")}
    hours = found["duration_s"] / 3600.0
    return {"policy": np.full(len(canopy), policy), "training": training, "canopy": canopy, **columns, "hours": hours}


def picked(arguments: dict[str, Any], numbers: dict[str, Any], seeds: list[int]) -> dict[str, Array]:
    """What becomes of canopies under the script with these numbers; of several sets of numbers, of each in turn."""
    count = max((len(np.atleast_1d(each)) for key, each in numbers.items() if key != "aim"), default=1)
    split = {"split": "test"} if "difficulty" in arguments else {}
    envs = PickVectorEnv(len(seeds) * count, **arguments, **split)
    each = {key: np.repeat(value, len(seeds), axis=0) if count > 1 else value for key, value in numbers.items()}
    return pick_canopies(ScriptedPick(envs, **each), envs, seeds * count)


@cache
def searched(condition: str, generations: int, seed: int) -> Searches:
    """The searches of a condition."""
    return search(CONDITIONS[condition], range(seed * SEARCHES, (seed + 1) * SEARCHES), generations)


def conditions(
    rng: np.random.Generator, condition: str, policy: str, canopies: int, generations: int, seed: int
) -> Any:
    """The script, in haste, or with what searches learnt, all of it or parts; and what it was on the way."""
    judged, arguments = seed_words(stream(seed, "fruit"), canopies), CONDITIONS[condition]
    if policy != "learnt":
        return canopy_rows(policy, picked(arguments, HASTY if policy == "scripted, hasty" else {}, judged), canopies)
    found, on_the_way = searched(condition, generations, seed), [HELD_OUT + i for i in range(CURVE)]
    tried = [(name, found.learnt * [knob in knobs for knob in KNOBS], judged) for name, knobs in PARTS.items()]
    for at in range(0, generations + 1, 2):
        tried.append((f"after {found.steps[at].mean():.0f} steps", found.means[at], on_the_way))
    parts = [canopy_rows(name, picked(arguments, arguments_of(x), fruit), len(fruit)) for name, x, fruit in tried]
    return joined(list(map(Rows, parts)))


def orders(rng: np.random.Generator, place: str, order: str, canopies: int, seed: int) -> Any:
    """The script where fruit is named in another order."""
    arguments = {**(CLUMPS if place == "clumps" else {}), "order": order}
    return canopy_rows("scripted", picked(arguments, {}, seed_words(stream(seed, "fruit"), canopies)), canopies)


def learning(
    rng: np.random.Generator, training: int, policy: str, place: list[str], canopies: int, steps: int, folder: str,
    seed: int,
) -> Any:  # fmt: skip
    """PPO with steps of the tool beside the script, where it was trained and on a harder rung.

    One piece has all places: two processes never train in one folder.
    """
    parts = [Rows.of(learnt_at(where, training, policy, canopies, steps, folder, seed)) for where in place]
    return joined([Rows({"place": np.full(len(p), at)} | p.columns) for p, at in zip(parts, place, strict=True)])


def learnt_at(place: str, training: int, policy: str, canopies: int, steps: int, folder: str, seed: int) -> Any:
    """Rows of one place."""
    arguments, judged = PLACES[place], seed_words(stream(seed, "fruit"), canopies)
    if policy == "scripted":
        given = {key: value for key, value in arguments.items() if key != "split"}
        return canopy_rows(policy, picked(given, {}, judged), canopies)
    own = run_seed(seed % 2**16) + training
    out, every = Path(folder) / f"seed{own}", max(steps // 6, 1)
    train_once(Training("ppo", "pickenv/Pick-v0", steps, own, checkpoint_every=every, evaluate_every=every), out)
    envs = PickVectorEnv(canopies, **arguments)
    rows = canopy_rows(policy, pick_canopies(load_policy(out / "policy.npz"), envs, judged), canopies)
    parts = [rows | {"training": np.full(canopies, training)}]
    for row in json.loads((out / "evaluations.json").read_text(encoding="utf-8")) if place == "as trained" else ():
        found = {name: np.array([row.get(name, np.nan)]) for name in ("collected", "damaged", "attempted", "reward")}
        on_the_way = canopy_rows(f"after {row['steps']:.0f} steps", found | {"duration_s": np.array([np.nan])}, 1)
        parts.append(on_the_way | {"training": np.array([training])})
    return joined(list(map(Rows, parts)))


def once(training: int, policy: str) -> bool:
    """The script is judged once."""
    return policy != "scripted" or training == 0


def curves(rows: Rows) -> Any:
    """Fruit per held-out canopy on the way, a panel for each place that has a way, beside the script."""
    (place, *_) = rows.columns
    on_the_way = Rows({n: v[np.char.startswith(rows["policy"], "after ")] for n, v in rows.columns.items()})
    with new_figure(WIDTH, 3.0) as figure:
        learnt, script = rgb(policy_colours(["ppo", "scripted"]))
        levels = on_the_way.levels(place)[:2]
        axes: Any = figure.subplots(1, len(levels), squeeze=False)[0]
        for axis, (level,) in zip(axes, levels, strict=True):
            some = on_the_way.where(**{place: level})
            names = sorted((name for (name,) in some.levels("policy")), key=lambda name: float(name.split()[1]))
            count = len(some.levels("training"))
            values = np.array([some.where(policy=n)["collected"].reshape(count, -1).mean(axis=1) for n in names])
            steps = np.array([float(name.split()[1]) for name in names]) / 1e3
            scripted = rows.where(**{place: level, "policy": "scripted"})["collected"].mean()
            before = values[0].mean() if steps[0] == 0.0 else scripted
            axis.plot(steps, values, color=learnt, linewidth=0.8, alpha=0.5)
            line = axis.plot(steps, values.mean(axis=1), color=learnt)
            base = axis.axhline(before, color=script, linestyle="--")
            axis.set(xlabel="learning (thousands of steps)", ylabel="collected (fruit per canopy)")
            headline(axis, f"{level.split(':')[0]}: {before:.1f}, learnt {values[-1].mean():.1f}")
        figure.legend([*line, base], [f"learnt, mean of {count}", "scripted"], loc="outside lower center", ncols=2)
    return figure
