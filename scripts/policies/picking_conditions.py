"""When does learning beat scripted picking? The script, in haste, and with learnt numbers, where one thing rules each.

Policy search (`pickenv.agents.training.policy_search`) learns the script's nine numbers with five seeds in each
condition. All then pick the same 60 canopies, which no search saw; differences are paired by canopy, and 95 % intervals
cross searches and canopies. What is done is kept in the folder, so that a run that was cut off goes on.

Run: python scripts/policies/picking_conditions.py [--generations 8] [--canopies 60] [--out runs/picking_conditions]
"""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from pickenv.agents.evaluation.reaches import pick_canopies
from pickenv.agents.policies.pick_policy import HASTY, ScriptedPick
from pickenv.agents.training.policy_search import KNOBS, Searches, arguments_of, search
from pickenv.agents.training.training_setup import HELD_OUT
from pickenv.arm import Array
from pickenv.envs.picking.pick_scene import ORDERS
from pickenv.envs.picking.pick_vector import PickVectorEnv
from pickenv.envs.shared.situation import CONTROL_PERIOD
from pickenv.files import write_json
from pickenv.inspect.colours import policy_colours
from pickenv.inspect.figures.style import WIDTH, headline, new_figure, rgb, save_figure
from pickenv.intervals import crossed_interval, mean_interval
from pickenv.seeds import seed_words, stream

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SEEDS = range(5)
"""Of the searches."""

CLUMPS = {"fruit_map": "v_trellis", "fruit": 25.0}
CONDITIONS: dict[str, dict[str, Any]] = {
    "as in Pick-v0": {},
    "late: readings and actions up to a period late": {"difficulty": "orchard"},
    "haste: 10 s a canopy": {"max_episode_steps": 100},
    "sway: clumps, fruit pushes fruit": CLUMPS,
    "occlusion: what pictures of trees left unseen": {"vision": "measured_errors"},
}
"""What one thing rules, and the environment's arguments."""

TAKEN_APART = tuple(CONDITIONS)[:2]
"""Conditions in which the learnt numbers are taken apart, and the curve is drawn."""

PLACES = {"as in Pick-v0": {}, "clumps": CLUMPS}
"""Where the order in which fruit is named is tried."""

AIM = ("aim_x", "aim_y", "aim_z")
PARTS = {"learnt aim alone": AIM, "all but the aim": tuple(name for name in KNOBS if name not in AIM)}
"""What of the learnt numbers is tried without the others."""

SCRIPTS: dict[str, dict[str, Any]] = {"scripted": {}, "scripted, hasty": HASTY}
LEARNT = "learnt"
HEADS = ("policy", "collected", "of scripted", "damaged", "attempts", "picks/h")
SHOWN = (("damaged", ".2f"), ("picks_per_hour", ".0f"))
"""Of script, haste and learnt."""

UNITS = {"tool_speed": ("m/s", 1.0), "settle": ("s", 1.0), "patience": ("s", 1.0), "gain": ("", 1.0)}
"""Of the learnt numbers; all others are shown in mm (or mrad)."""

CURVE = 16
"""Canopies after every few generations, as many as `pickenv train` judges by."""


def kept(path: Path, make: Callable[[], Any]) -> Any:
    """What a file holds, or what is made and written there."""
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        write_json(path, make())
    return json.loads(path.read_text(encoding="utf-8"))


def searched(out: Path, name: str, generations: int) -> Searches:
    """The searches of a condition."""

    def run() -> dict[str, Any]:
        found = search(CONDITIONS[name], SEEDS, generations)
        return {key: getattr(found, key).tolist() for key in ("steps", "means", "rewards")}

    return Searches(**{key: np.array(value) for key, value in kept(out / _file(name, "search"), run).items()})


def picked(
    arguments: dict[str, Any], canopies: int, policy: dict[str, Any], seeds: list[int] | None = None
) -> dict[str, Any]:
    """What becomes of each of the canopies to judge by; of several policies, of each one's ``(policies, canopies)``."""
    count = max((len(np.atleast_1d(each)) for key, each in policy.items() if key != "aim"), default=1)
    split = {"split": "test"} if "difficulty" in arguments else {}
    envs = PickVectorEnv(canopies * count, **arguments, **split)
    each = {key: np.repeat(value, canopies, axis=0) if count > 1 else value for key, value in policy.items()}
    seeds = seeds or seed_words(stream(0, "fruit"), canopies)
    found = pick_canopies(ScriptedPick(envs, **each), envs, seeds * count)
    return {key: value.reshape(count, canopies).tolist() for key, value in found.items()}


def row_of(place: str, policy: str, values: dict[str, Any], reference: dict[str, Any]) -> dict[str, Any]:
    """One row of a table, from `picked`; differences to the reference are paired by canopy."""
    values = {key: np.array(each) for key, each in values.items()}
    apart = values["collected"] - np.array(reference["collected"])
    return {
        "place": place,
        "policy": policy,
        "trainings": len(apart) if len(apart) > 1 else 0,
        "canopies": apart.shape[1],
        **{key: float(each.mean()) for key, each in values.items()},
        "collected_ci95": ends_of(values["collected"]),
        "difference": float(apart.mean()),
        "difference_ci95": ends_of(apart),
        "picks_per_hour": 3600.0 * float(values["collected"].sum() / (CONTROL_PERIOD * values["steps"].sum())),
    }


def ends_of(values: Array) -> list[float] | None:
    """95 % interval of the mean of values (trainings, canopies), over both where there are several trainings."""
    ends = mean_interval(values[0]) if len(values) == 1 else crossed_interval(values.T)
    return None if ends is None else list(ends)


def lines_of(rows: list[dict[str, Any]], heads: tuple[str, ...] = HEADS) -> list[str]:
    """The tables in Markdown, a place at a time; the first row of each is what others are compared with."""
    lines = []
    for place in dict.fromkeys(row["place"] for row in rows):
        lines += [f"**{place}**", "", f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
        for number, row in enumerate(row for row in rows if row["place"] == place):
            apart = "" if not number else _with(row["difference"], row["difference_ci95"], "+.2f")
            cells = (row["policy"], _with(row["collected"], row["collected_ci95"], ".2f"), apart)
            rest = (f"{row['damaged']:.2f}", f"{row['attempted']:.2f}", f"{row['picks_per_hour']:.0f}")
            lines.append(f"| {' | '.join((*cells, *rest))} |")
        lines.append("")
    return lines


def beside(rows: list[dict[str, Any]]) -> list[str]:
    """One line a condition in Markdown: script, haste and learnt beside each other."""
    heads = ("condition", "scripted", "hasty, of scripted", "learnt, of scripted", "damaged", "picks/h")
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    for place in CONDITIONS:
        script, hasty, learnt = (row for row in rows if row["place"] == place)
        apart = (_with(row["difference"], row["difference_ci95"], "+.2f") for row in (hasty, learnt))
        cells = (place, _with(script["collected"], script["collected_ci95"], ".2f"), *apart)
        rest = (", ".join(f"{row[key]:{form}}" for row in (script, hasty, learnt)) for key, form in SHOWN)
        lines.append(f"| {' | '.join((*cells, *rest))} |")
    return [*lines, ""]


def condition_rows(out: Path, name: str, generations: int, canopies: int) -> list[dict[str, Any]]:
    """The script, in haste, and learnt."""
    found = arguments_of(searched(out, name, generations).learnt)
    each = {}
    for policy, arguments in {**SCRIPTS, LEARNT: found}.items():
        path = out / _file(name, policy.replace(", ", "_") + f"_{canopies}")
        each[policy] = kept(path, partial(picked, CONDITIONS[name], canopies, arguments))
    return [row_of(name, policy, values, each["scripted"]) for policy, values in each.items()]


def part_rows(out: Path, name: str, generations: int, canopies: int) -> list[dict[str, Any]]:
    """The script with a part of what was learnt."""
    each = {
        "scripted": kept(out / _file(name, f"scripted_{canopies}"), partial(picked, CONDITIONS[name], canopies, {}))
    }
    for part, knobs in PARTS.items():
        points = searched(out, name, generations).learnt * [knob in knobs for knob in KNOBS]
        path = out / _file(name, f"{part.replace(' ', '_')}_{canopies}")
        each[part] = kept(path, partial(picked, CONDITIONS[name], canopies, arguments_of(points)))
    return [row_of(name, policy, values, each["scripted"]) for policy, values in each.items()]


def order_rows(out: Path, canopies: int) -> list[dict[str, Any]]:
    """The script where fruit is named in another order, and where each seed chooses one by canopies of its own."""
    rows = []
    own = [word for seed in SEEDS for word in seed_words(stream(seed, "training"), CURVE)]
    for place, arguments in PLACES.items():
        each, rewards = {}, []
        for order in ORDERS:
            given, folder = {**arguments, "order": order}, f"order {place}"
            each[order] = kept(out / _file(folder, f"{order}_{canopies}"), partial(picked, given, canopies, {}))
            tried = kept(out / _file(folder, f"{order}_tried"), partial(picked, given, len(own), {}, own))
            rewards.append(np.reshape(tried["reward"], (len(SEEDS), CURVE)).mean(axis=1))
        chosen = [tuple(ORDERS)[best] for best in np.argmax(rewards, axis=0)]
        each[f"chosen ({', '.join(sorted(set(chosen)))})"] = {
            key: [each[order][key][0] for order in chosen] for key in each["nearest"]
        }
        rows += [row_of(place, order, values, each["nearest"]) for order, values in each.items()]
    return rows


def curve(out: Path, name: str, generations: int) -> dict[str, Any]:
    """Fruit per held-out canopy after every other generation, ``(points, seeds)``; `pickenv train` has the same."""
    found = searched(out, name, generations)
    at = list(range(0, generations + 1, 2))
    held_out = [HELD_OUT + i for i in range(CURVE)]
    points = arguments_of(found.means[at].reshape(-1, len(KNOBS)))
    run = kept(out / _file(name, "curve"), partial(picked, CONDITIONS[name], CURVE, points, held_out))
    collected = np.mean(run["collected"], axis=1).reshape(len(at), len(SEEDS))
    return {"steps": found.steps[at].tolist(), "collected": collected.tolist()}


def drawn(curves: dict[str, dict[str, Any]]) -> Figure:
    """Fruit per held-out canopy during the searches, a panel for each condition; each begins as the script."""
    with new_figure(WIDTH, 3.0) as figure:
        learnt, script = rgb(policy_colours(["ppo", "scripted"]))
        axes: Any = figure.subplots(1, len(curves))
        for axis, (name, found) in zip(axes, curves.items(), strict=True):
            steps, values = (np.array(found[key]) for key in ("steps", "collected"))
            axis.plot(steps / 1e3, values, color=learnt, linewidth=0.8, alpha=0.5)
            line = axis.plot(steps.mean(axis=1) / 1e3, values.mean(axis=1), color=learnt)
            base = axis.axhline(values[0].mean(), color=script, linestyle="--")
            axis.set_xlabel("learning (thousands of steps)")
            axis.set_ylabel("collected (fruit per canopy)")
            axis.set_ylim(np.floor(values.min()) - 0.5, np.ceil(values.max()))
            headline(axis, f"{_short(name)}: {values[0].mean():.1f} to {values[-1].mean():.1f}")
        figure.legend([*line, base], [f"learnt, mean of {len(SEEDS)}", "scripted"], loc="outside lower center", ncols=2)
    return figure


def learnt_lines(out: Path, generations: int) -> list[str]:
    """What the searches ended with: means over the seeds, least and largest, in Markdown."""
    names = [name for name in arguments_of(np.zeros(len(KNOBS))) if name != "aim"]
    heads = ["condition", *(f"{name}{_unit(name)}" for name in names), *(f"aim {axis} (mm)" for axis in "xyz")]
    lines = [f"| {' | '.join(heads)} |", "|" + "---|" * len(heads)]
    for condition in CONDITIONS:
        found = arguments_of(searched(out, condition, generations).learnt)
        columns = [found[name] * UNITS.get(name, ("", 1e3))[1] for name in names] + list(1e3 * found["aim"].T)
        lines.append(f"| {condition} | {' | '.join(_range(each) for each in columns)} |")
    return lines


def _range(values: Array) -> str:
    form = ".0f" if values.mean() > 10.0 else ".2f"
    return f"{values.mean():{form}} ({values.min():{form}} to {values.max():{form}})"


def _unit(name: str) -> str:
    unit = UNITS.get(name, ("mm", 1e3))[0]
    return f" ({unit})" if unit else ""


def _short(condition: str) -> str:
    return condition.split(":")[0]


def _file(condition: str, what: str) -> Path:
    return Path(_short(condition).replace(" ", "_")) / f"{what}.json"


def _with(value: float, ends: list[float] | None, form: str) -> str:
    return f"{value:{form}}" + ("" if ends is None else f" ({ends[0]:{form}} to {ends[1]:{form}})")


def main(
    generations: Annotated[int, typer.Option(help="Generations of each search.", min=4)] = 8,
    canopies: Annotated[int, typer.Option(help="Canopies to judge by.", min=8)] = 60,
    out: Annotated[Path, typer.Option(help="Folder for searches, canopies and tables.")] = Path(
        "runs/picking_conditions"
    ),
    figure: Annotated[Path | None, typer.Option(help="Learning curves, in place of some in the folder.")] = None,
) -> None:
    """Search, judge, print; with tables, learnt numbers and the curve in conditions.json."""
    curves = {name: curve(out, name, generations) for name in TAKEN_APART}
    rows = [row for name in CONDITIONS for row in condition_rows(out, name, generations, canopies)]
    orders = order_rows(out, canopies)
    parts = [row for name in TAKEN_APART for row in part_rows(out, name, generations, canopies)]
    print(
        "\n".join(
            [
                *beside(rows),
                *lines_of(parts),
                *lines_of(orders, ("order", "collected", "of nearest", *HEADS[3:])),
                *learnt_lines(out, generations),
            ]
        )
    )
    numbers = {
        name: {key: value.tolist() for key, value in arguments_of(searched(out, name, generations).learnt).items()}
        for name in CONDITIONS
    }
    found = {"rows": rows, "parts": parts, "orders": orders, "learnt": numbers, "curves": curves}
    write_json(out / "conditions.json", {"generations": generations, "simulated": True, **found})
    path = save_figure(drawn(curves), figure or out / "conditions-curve.png")
    print(f"wrote {out / 'conditions.json'} and {path}")


if __name__ == "__main__":
    typer.run(main)
