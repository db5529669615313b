"""The ladder: a list of named difficulties of Reach and Pick, which makes results comparable.

Each difficulty (rung) fixes some arguments of an environment. Most also fix two populations of arms, one to train on
and one to test on. Fixed arguments never change within a version of the ladder. The user may choose all other
arguments.

From the easiest to the hardest: "ideal" has no error. "fine" has arms with small manufacturing errors, "coarse" arms
with large ones. "orchard" has medium errors, and adds compliance, backlash, heat and soft ground, with delayed and
noisy readings. "day" is "orchard" at any hour of a working day. "own_eyes" is "day" with the errors of the machine's
own cameras.

The arguments that "own_eyes" adds come from detecting fruit in rendered pictures of trees
(`pickenv/orchard/presets/sight.toml`). Pick draws detections and errors from the tables in that file. Reach has one
standard deviation for all axes, the root mean square over the axes. The fruit noise of Reach comes from fruit among
leaves that Li's detector located from 1.0 to 1.4 m away (table li2016-li2016; 4.4 mm across, 4.0 up, 9.2 in depth).
The camera noise of Reach is for a camera on the tool, from which no leaf hides the fruit. So it comes from fruit
without leaves that the circle detector located (table li2016_bare-circles; 0.4, 0.4 and 2.7 mm). All these numbers are
simulated; a real camera had an RMSE of 6 mm and a bias of 17 mm (Neupane et al. 2021).
"""

from __future__ import annotations

from typing import Any

from pickenv.base import InputError, seed_words, stream
from pickenv.envs.shared.task import check_choice

_ARMS: dict[str, Any] = {"plant": "qiao2026", "arms": "per_episode"}
_ORCHARD: dict[str, Any] = {
    **_ARMS,
    "plant": "orchard",
    "tolerances": "medium",
    "joint_noise": 0.05,
    "latency": [0, 1],
    "action_delay": [0, 1],
    "start_spread": 0.5,
}
_DAY: dict[str, Any] = {**_ORCHARD, "hours_on": [0.0, 8.0]}

LADDER_VERSION = 2
"""Version of the ladder, to be stated with results. In version 1 the noise of "own_eyes" in Reach had no source."""

LADDER: dict[str, dict[str, Any]] = {
    "ideal": {"plant": "ideal"},
    "fine": {**_ARMS, "tolerances": "fine"},
    "coarse": {**_ARMS, "tolerances": "coarse"},
    "orchard": _ORCHARD,
    "day": _DAY,
    "own_eyes": _DAY,
}
"""Arguments that each difficulty fixes."""

EYES: dict[str, dict[str, Any]] = {
    "Reach": {"feedback": "camera", "camera_noise_mm": 1.6, "fruit_noise_mm": 6.3},
    "Pick": {"vision": "measured_errors"},
}
"""Arguments that "own_eyes" adds, by task. They come from detecting fruit in rendered pictures of trees
(`pickenv/orchard/presets/sight.toml`).

Pick draws detections and errors from the tables in that file. Reach has one standard deviation for all axes, the root
mean square over the axes. The fruit noise of Reach comes from fruit among leaves that Li's detector located from 1.0 to
1.4 m away (table li2016-li2016; 4.4 mm across, 4.0 up, 9.2 in depth). The camera noise of Reach is for a camera on the
tool, from which no leaf hides the fruit. So it comes from fruit without leaves that the circle detector located (table
li2016_bare-circles; 0.4, 0.4 and 2.7 mm). All these numbers are simulated; a real camera had an RMSE of 6 mm and a bias
of 17 mm (Neupane et al. 2021)."""

SPLITS = ("train", "test")
"""Names of a difficulty's two populations of arms: one to train on, another to test on."""

POPULATION = {"train": 256, "test": 64}


def on_ladder(task: str, *, difficulty: str | None = None, split: str = "train", **arguments: Any) -> dict[str, Any]:
    """Return an environment's arguments together with the arguments that a difficulty fixes.

    Args:
        task: "Reach" or "Pick".
        difficulty: A key of `LADDER`, or None for the arguments alone.
        split: One of `SPLITS`.
        arguments: The arguments that the user gave.

    Raises:
        InputError: If there is no such difficulty or split, or the user gave an argument that the difficulty fixes.
    """
    check_choice("split", split, SPLITS)
    if difficulty is None:
        if split != SPLITS[0]:
            raise InputError(f"split '{split}' needs a difficulty; give one of {', '.join(LADDER)}")
        return arguments
    check_choice("difficulty", difficulty, tuple(LADDER))
    fixed = LADDER[difficulty] | (EYES[task] if difficulty == "own_eyes" else {})
    if "arms" in fixed:
        seed = seed_words(stream(0, "arms", SPLITS.index(split)), 1)[0]
        fixed = fixed | {"population": POPULATION[split], "population_seed": seed}
    both = sorted(set(fixed) & set(arguments))
    if both:
        them = "it" if len(both) == 1 else "them"
        raise InputError(f"difficulty '{difficulty}' fixes {', '.join(both)}; leave {them} out")
    return fixed | arguments
