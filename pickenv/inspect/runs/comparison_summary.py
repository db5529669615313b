"""Summary numbers of a comparison, the same in terminal, JSON, report, figures and recording.

First come the tables of the episodes. Their intervals are over fruit, for one arm with one calibration. Then come the
statistics, colour scales and bins of the error fields. Units: mm and degrees; picks as shares.

Whether a calibration changes picks is computed for each gripper and each error of perception. The tool misses the fruit
by the sum of the arm's error and the perception error. The perception error is normal, across the tool's axis, and
independent of the arm's error. Its standard deviation per axis is given. The gripper's curve of success against
misalignment gives the probability that the fruit is taken.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, forward
from pickenv.base import clustered_share_interval, count_of, mean_interval, paired_share_interval, share_interval
from pickenv.base.intervals import LEAST
from pickenv.calibration import Calibration
from pickenv.inspect.colours import in_words, policy_label, said, unmarked
from pickenv.inspect.runs.recorded_episodes import Comparison, RecordedEpisodes, RecordedPolicy
from pickenv.orchard import Gripper, capture_probability, load_gripper, misalignment

# What position errors mean for grippers: how the fruit lies in the tool, and whether it is taken.


GRIPPERS = ("li_cup", "compliant_hand")


def gripper_curves(names: tuple[str, ...] = GRIPPERS) -> dict[str, tuple[Array, Array]]:
    """Return, for each gripper, lateral misalignments ``(N,)``, mm, and the probability of success at each ``(N,)``."""
    lateral_mm = np.linspace(0.0, 40.0, 401)
    return {name: (lateral_mm, capture_probability(load_gripper(name), lateral_mm * 1e-3, 0.0, 0.0)) for name in names}


def gripped(comparison: Comparison) -> dict[str, tuple[Array, dict[str, Array]]]:
    """Return the lateral misalignment of each reach, and the probability that each gripper takes its fruit.

    The true arm at the policy's command gives the tool's axis. The nominal arm at the first policy's command gives the
    wanted axis.

    Returns:
        Two values for each policy, by label. The first is the distances of the fruit from the tool's axis ``(R,)``, mm.
        The second is, for each gripper by name, the probability that the gripper takes the fruit ``(R,)``.
    """
    grippers = {name: load_gripper(name) for name in GRIPPERS}
    target = forward(comparison.nominal, comparison.policies[0].ends.joint_command).rotation[..., 2]
    by_policy = {}
    for policy in comparison.policies:
        ends = policy.ends
        axis = comparison.plant.tool_pose(ends.joint_command).rotation[..., 2]
        lying = misalignment(comparison.fruit - ends.tool_position, axis, target)
        success = {name: capture_probability(gripper, *lying) for name, gripper in grippers.items()}
        by_policy[policy.label] = lying[0] * 1e3, success
    return by_policy


PERCEPTION_MM = (0.0, 1.0, 2.0, 3.0, 5.0)
"""Standard deviations per axis of the perceived fruit position, mm, for which picks are computed."""
MATTERS = 0.05
"""Smallest change in the share of picks that is reported as a change: five of a hundred picks."""
RINGS, SPOKES = 24, 24
"""Numbers of distances, equally probable, and of directions at which the perception error is sampled."""


Change: TypeAlias = Mapping[str, Any]
"""The effect of a calibration on picks, as in JSON. ``gripper`` is the gripper's name. ``perception_mm`` is the
standard deviation of the perceived fruit position, per axis. ``before`` is the share of fruit taken without
calibration, and ``after`` the share with calibration."""


def _gain(change: Change) -> float:
    """Return the gain in picks by calibration, as a share of fruit from -1 to 1."""
    return float(change["after"] - change["before"])


def pick_share(gripper: Gripper, lateral_mm: ArrayLike, perception_mm: float) -> float:
    """Return the share of fruit that a gripper takes, given the arm's errors and the perception error.

    Args:
        gripper: The gripper; the tool is assumed to point as wanted.
        lateral_mm: Distances of the fruit from the tool's axis, from the arm's own error alone ``(N,)``, mm.
        perception_mm: Standard deviation of the perceived fruit position per axis, mm.
    """
    error = np.asarray(lateral_mm, dtype=float)[:, None, None]
    ring = perception_mm * np.sqrt(-2.0 * np.log1p(-(np.arange(RINGS) + 0.5) / RINGS))[:, None]
    spoke = 2.0 * np.pi * (np.arange(SPOKES) + 0.5) / SPOKES
    lateral: Array = np.sqrt(np.maximum(error**2 + ring**2 + 2.0 * error * ring * np.cos(spoke), 0.0))
    return float(capture_probability(gripper, lateral * 1e-3, 0.0, 0.0).mean())


def pick_changes(before_mm: ArrayLike, after_mm: ArrayLike) -> list[Change]:
    """Return the effect of a calibration on picks, for each of `GRIPPERS` and of `PERCEPTION_MM`.

    Args:
        before_mm: Lateral errors without calibration ``(N,)``, mm.
        after_mm: Lateral errors with calibration ``(N,)``, mm.
    """
    sides, grippers = {"before": before_mm, "after": after_mm}, {name: load_gripper(name) for name in GRIPPERS}
    return [
        {"gripper": name, "perception_mm": perception}
        | {side: pick_share(gripper, lateral_mm, perception) for side, lateral_mm in sides.items()}
        for name, gripper in grippers.items()
        for perception in PERCEPTION_MM
    ]


def change_cells(change: Change) -> tuple[str, ...]:
    """Return a change as table cells: gripper, perception error, shares without and with calibration, and gain.

    Perception errors are in mm, shares in %, and the gain is in percentage points.
    """
    shares = (f"{100.0 * share:.1f}" for share in (change["before"], change["after"]))
    return (change["gripper"], f"{change['perception_mm']:g}", *shares, f"{100.0 * _gain(change):+.1f}")


def matters(plant: str, changes: Sequence[Change], between: tuple[str, str] = ("without", "with calibration")) -> str:
    """Return a few sentences that say for which gripper and perception error picks change on an arm.

    Args:
        plant: The arm's name.
        changes: The changes, from `pick_changes`.
        between: Words that follow the shares before and after calibration, such as "with raw" and "with LS".
    """

    def both(change: Change) -> str:
        before, after = 100.0 * change["before"], 100.0 * change["after"]
        return f"{before:.0f} % taken {between[0]}, {after:.0f} % {between[1]}"

    largest: dict[str, Change] = {}  # of each gripper
    for change in sorted(changes, key=lambda c: -abs(_gain(c))):
        largest.setdefault(change["gripper"], change)
    best = list(largest.values())
    if abs(_gain(best[0])) < MATTERS:
        most = abs(np.ceil(100.0 * abs(_gain(best[0])) - 1e-9))  # no minus before a zero
        return (
            f"On {plant} this changes no more than {most:.0f} of 100 picks, with any gripper "
            f"and however well the fruit is seen; most {_where(best[0])}: {both(best[0])}."
        )
    yes = [f"{_where(c)}: {both(c)}" for c in best if abs(_gain(c)) >= MATTERS]
    no = [f"{c['gripper']} ({both(c)})" for c in best if abs(_gain(c)) < MATTERS]
    first = f"On {plant} this changes picks {'; '.join(yes)}."
    sharp = next(c for c in changes if c["gripper"] == best[0]["gripper"] and c["perception_mm"] == PERCEPTION_MM[0])
    if abs(_gain(sharp)) < MATTERS:
        few = "none" if abs(_gain(sharp)) < 0.005 else "hardly any"  # below this, the printed shares hardly differ
        first += f" Were the fruit seen without error, it would change {few} ({both(sharp)})."
    return first + (f" Hardly a pick changes with {' and '.join(no)}." if no else "")


def _where(change: Change) -> str:
    error = change["perception_mm"]
    perception = f"seen to {error:g} mm per axis" if error else "seen without error"
    return f"with {change['gripper']} and the fruit {perception}"


HEADS = ("policy", "miss, mean (mm)", "median (mm)", "95th (mm)", "attitude, mean (deg)", "picked", "share picked (%)")
DIFFERENCES = ("from", "to", "miss (mm)", "attitude (deg)", "share picked (points of %)", "nearer")
INTERVALS = "in brackets 95 % intervals over fruit, of this one arm and calibration"
NO_INTERVAL = f"fewer than {LEAST} episodes, so no intervals of means"


def episode_misses(policy: RecordedPolicy) -> Array:
    """Return the mean miss of each episode ``(E,)``, mm.

    A miss is the distance from tool to fruit when the gripper closed. The mean is nan if the gripper never closed.
    """
    closed = np.isfinite(policy.miss_mm)
    with np.errstate(invalid="ignore"):
        return np.asarray(np.where(closed, policy.miss_mm, 0.0).sum(axis=1) / closed.sum(axis=1))


def tries_of(policy: RecordedPolicy) -> NDArray[np.int64]:
    """Return the number of times that the gripper closed in each episode ``(E,)``."""
    return np.asarray(np.isfinite(policy.miss_mm).sum(axis=1))


def policy_rows(episodes: RecordedEpisodes) -> list[dict[str, Any]]:
    """Return one dictionary of numbers per policy, such as the mean miss and its interval; None if unknown."""
    return [_policy_row(policy) for policy in episodes.policies]


def _policy_row(policy: RecordedPolicy) -> dict[str, Any]:
    misses, attitudes = _finite(episode_misses(policy)), _finite(policy.attitude_error_deg[:, -1])
    picks, tries = policy.picked[:, -1], tries_of(policy)
    tried, taken = int(tries.sum()), int(picks.sum())
    ends = None
    if tried:
        ends = share_interval(taken, tried) if tries.max() == 1 else clustered_share_interval(picks, tries)
    return {
        "policy": policy.label,
        "key": policy.key,
        "episodes": len(policy.moments),
        "mean_mm": _mean(misses),
        "ci95_mm": _ends(mean_interval(misses), 0.0),
        "median_mm": None if not len(misses) else float(np.median(misses)),
        "p95_mm": None if not len(misses) else float(np.percentile(misses, 95)),
        "attitude_deg": _mean(attitudes),
        "attitude_ci95_deg": _ends(mean_interval(attitudes), 0.0),
        "picked": taken,
        "tried": tried,
        "share_picked": taken / tried if tried else None,
        "share_ci95": _ends(ends),
        "reward": float(policy.reward.sum(axis=1).mean()),
    }


def policy_differences(episodes: RecordedEpisodes) -> list[dict[str, Any]]:
    """Return the differences over the same fruit for all pairs of policies.

    A difference is the later policy of the pair minus the earlier, in the order of ``episodes.policies``. In each
    dictionary, "from" is the label of the earlier policy, and "to" the label of the later policy.
    """
    return [_difference(before, after) for before, after in combinations(episodes.policies, 2)]


def _difference(before: RecordedPolicy, after: RecordedPolicy) -> dict[str, Any]:
    misses = _finite(episode_misses(after) - episode_misses(before))
    attitudes = _finite(after.attitude_error_deg[:, -1] - before.attitude_error_deg[:, -1])
    ends = mean_interval(misses)
    tries = np.concatenate([tries_of(before), tries_of(after)])
    shares = [_policy_row(policy)["share_picked"] for policy in (before, after)]
    picks = after.picked[:, -1] > 0, before.picked[:, -1] > 0
    return {
        "from": before.label,
        "to": after.label,
        "pairs": len(misses),
        "difference_mm": _mean(misses),
        "ci95_mm": _ends(ends),
        "significant": None if ends is None else bool(ends[0] > 0.0 or ends[1] < 0.0),
        "attitude_deg": _mean(attitudes),
        "attitude_ci95_deg": _ends(mean_interval(attitudes)),
        "share_picked": None if None in shares else shares[1] - shares[0],
        "share_ci95": _ends(paired_share_interval(*picks) if (tries == 1).all() else None),
        "nearer": int(np.sum(misses < 0.0)),
    }


def policy_cells(episodes: RecordedEpisodes) -> list[list[str]]:
    """Return the numbers of `policy_rows` as table cells, in the columns of `HEADS`."""
    return [
        [
            row["policy"],
            said(row["mean_mm"], row["ci95_mm"], 3),
            *(said(row[name], None, 3) for name in ("median_mm", "p95_mm")),
            said(row["attitude_deg"], row["attitude_ci95_deg"], 3),
            f"{row['picked']} of {row['tried']}",
            said(row["share_picked"], row["share_ci95"], 0, 100.0),
        ]
        for row in policy_rows(episodes)
    ]


def difference_cells(episodes: RecordedEpisodes) -> list[list[str]]:
    """Return the numbers of `policy_differences` as table cells, in the columns of `DIFFERENCES`."""
    return [
        [
            line["from"],
            line["to"],
            said(line["difference_mm"], line["ci95_mm"], 3, sign="+"),
            said(line["attitude_deg"], line["attitude_ci95_deg"], 3, sign="+"),
            said(line["share_picked"], line["share_ci95"], 0, 100.0, sign="+"),
            f"{line['nearer']} of {line['pairs']}",
        ]
        for line in policy_differences(episodes)
    ]


def _best(episodes: RecordedEpisodes) -> tuple[dict[str, Any] | None, dict[str, dict[str, Any]]]:
    """Return the numbers of the best policy (least mean miss), and its differences from each rival, by label.

    A miss is the distance from tool to fruit when the gripper closed. A rival is another policy that closed the gripper
    for some of the same fruit. ``lead_mm`` of a difference is the rival's miss minus the best policy's, mm. If no
    policy closed the gripper, the first result is None.
    """
    closed = [row for row in policy_rows(episodes) if row["mean_mm"] is not None]
    if not closed:
        return None, {}
    best, rivals = min(closed, key=lambda row: row["mean_mm"]), {}
    for line in policy_differences(episodes):
        before, after, difference = line["from"], line["to"], line["difference_mm"]
        if best["policy"] in (before, after) and difference is not None:
            rival, lead = (after, difference) if before == best["policy"] else (before, -difference)
            rivals[rival] = line | {"lead_mm": lead}
    return best, rivals


def outcome_sentence(episodes: RecordedEpisodes) -> str:
    """Return the verdict in a few words: which policy is best, and its mean distance from the fruit at closing."""
    best, rivals = _best(episodes)
    if best is None:
        return "No policy closed the gripper"
    name, mean = best["policy"], f"{best['mean_mm']:.3f} mm"
    if not rivals:
        return f"{name} ends {mean} from the fruit"
    level = [rival for rival, line in rivals.items() if _level(line)]
    if len(level) == len(rivals):
        return f"{' and '.join([name, *level])} end equally near to the fruit: {mean}"
    apart = {rival: line for rival, line in rivals.items() if line["significant"] and rival not in level}
    farther = [rival for rival, line in apart.items() if line["lead_mm"] > 0.0]
    if len(farther) == len(rivals):
        return f"{name} ends nearest to the fruit: {mean}"
    if nearer := [rival for rival in apart if rival not in farther]:  # over other fruit too, or over fewer
        return f"{name} has the least mean miss, {mean}, but {' and '.join(nearer)} ends nearer to the same fruit"
    if all(line["significant"] is None for line in rivals.values()):
        return f"{' and '.join([name, *level])} end{'' if level else 's'} nearest in these few episodes, {mean}"
    if not farther:
        return f"No policy is told apart from {name} with {mean}"
    alike = " and ".join(rival for rival in rivals if rival not in farther)
    return f"{name} ends nearest with {mean}, not told apart from {alike}"


def _level(difference: Mapping[str, Any]) -> bool:
    """Return whether the difference between two policies, and its whole interval, are zero to the digits shown."""
    return bool(max(map(abs, [difference["difference_mm"], *(difference["ci95_mm"] or ())])) < 0.5e-3)


def explanation(episodes: RecordedEpisodes) -> str:
    """Return the reasons for the verdict in sentences.

    The reasons are the best policy's lead over its first rival (see `policy_changes`), whether any gripper's picks
    change, and the picks in these episodes.
    """
    best, rivals = _best(episodes)
    if best is None:
        return f"In {count_of(len(episodes.seeds), 'episode')} no policy closed the gripper."
    if not rivals:  # no fruit for which two of them closed the gripper
        return f"{_picking(episodes)}."
    name, (rival, line) = best["policy"], next(iter(rivals.items()))
    ends = line["ci95_mm"]
    if ends is not None and line["difference_mm"] < 0.0:
        ends = [-ends[1], -ends[0]]
    by = said(abs(line["difference_mm"]), ends, 3)
    than = "as much as" if _level(line) else f"{by} mm {'less' if line['lead_mm'] >= 0.0 else 'more'} than"
    first = f"{name} misses by {than} {rival} for the same {line['pairs']} fruit"
    changes, between = policy_changes(episodes)["changes"], (f"with {rival}", f"with {name}")
    worth = matters(episodes.plant_name or episodes.env_id, changes, between)
    return f"{first}. {worth} {_picking(episodes)}."


def _picking(episodes: RecordedEpisodes) -> str:
    counts = ", ".join(f"{row['picked']} of {row['tried']} with {row['policy']}" for row in policy_rows(episodes))
    return f"In these episodes {episodes.gripper}, which forgives {episodes.tolerance_mm:g} mm, picks {counts}"


def policy_changes(episodes: RecordedEpisodes) -> dict[str, Any]:
    """Return the change in picks if the best policy replaces a rival, for each gripper and perception error.

    The best policy has the least mean distance from tool to fruit when the gripper closes. The rival is the first other
    policy in ``episodes.policies`` that closed the gripper for some of the same fruit; without a rival the result is
    empty. Picks are computed from the part of this distance that is across the tool's axis.
    """
    best, rivals = _best(episodes)
    if best is None or not rivals:
        return {}
    rival, name = next(iter(rivals)), best["policy"]
    misses = {policy.label: _across(policy) for policy in episodes.policies}
    return {"from": rival, "to": name, "changes": pick_changes(misses[rival], misses[name])}


def _across(policy: RecordedPolicy) -> Array:
    """Return the part of each episode's miss across the tool's axis, mm; the whole miss if the attitude is unknown."""
    axis, across = policy.tool_rotation[..., 2], policy.miss_mm.copy()
    comparable = np.isfinite(axis).all(axis=-1) & np.isclose(policy.position_error_mm, policy.miss_mm)
    apart = (policy.fruit_position - policy.tool_position)[comparable]
    across[comparable] = 1e3 * misalignment(apart, axis[comparable])[0]
    return _finite(across)


def content_of_comparison(episodes: RecordedEpisodes) -> dict[str, Any]:
    """Return all numbers of a comparison, per policy and per pair of policies, as a dictionary for JSON."""
    return {
        "environment": episodes.env_id,
        "plant": episodes.plant_name,
        "gripper": episodes.gripper,
        "tolerance_mm": episodes.tolerance_mm,
        "seed": episodes.seed,
        "simulated": True,
        "intervals": INTERVALS,
        "headline": outcome_sentence(episodes),
        "explanation": explanation(episodes),
        "rows": policy_rows(episodes),
        "differences": policy_differences(episodes),
        "matters": policy_changes(episodes),
    }


def comparison_markdown(episodes: RecordedEpisodes) -> str:
    """Return the verdict and the tables of policies and of differences, in Markdown, for the recording."""
    parts = [f"## {unmarked(outcome_sentence(episodes))}", unmarked(explanation(episodes))]
    parts.append(_table(HEADS, [list(map(unmarked, row)) for row in policy_cells(episodes)]))
    if differences := [list(map(unmarked, row)) for row in difference_cells(episodes)]:
        parts += ["Fruit by fruit, later minus earlier policy:", _table(DIFFERENCES, differences)]
    count = count_of(len(episodes.seeds), "episode")
    return "\n\n".join([*parts, f"{count} of {episodes.env_id}, simulated; {INTERVALS}."])


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = (heads, [":--"] + ["--:"] * (len(heads) - 1), *rows)
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _finite(values: Array) -> Array:
    return values[np.isfinite(values)]


def _mean(values: Array) -> float | None:
    return float(values.mean()) if len(values) else None


def _ends(ends: tuple[float, float] | None, least: float = -np.inf) -> list[float] | None:
    """Return an interval as a list for JSON; ends below ``least``, the smallest possible value, are raised to it."""
    return None if ends is None else [max(end, least) for end in ends]


def stage_label(calibration: Calibration) -> str:
    """Return a policy's label from its calibration: LS, or for example LS+BPNN if a residual model was learnt."""
    return policy_label("ls" if calibration.learnt is None else f"ls+{calibration.learnt.kind}")


GAIN = 20.0
"""Factor by which recordings draw errors longer than true. Figures use it too if the arrows then fit."""
SCALE_PERCENTILE = 99.0
"""Percentile of the shown values at which a colour scale ends, so that outliers do not flatten the scale."""


def error_spread(values: ArrayLike) -> tuple[float, float, float, float]:
    """Return mean, root mean square, 95th percentile and maximum of errors ``(...)``; nan if there are none."""
    values = np.asarray(values, dtype=float).ravel()
    if not values.size:
        return math.nan, math.nan, math.nan, math.nan
    rms = float(np.sqrt(np.mean(values**2)))
    return float(values.mean()), rms, float(np.percentile(values, 95)), float(values.max())


def field_mm(policy: RecordedPolicy) -> Array:
    """Return the lengths of a policy's position errors over the field ``(F,)``, mm."""
    return np.asarray(np.linalg.norm(policy.field_errors, axis=-1) * 1e3)


def cell_means(index: NDArray[np.int64], values: Array) -> tuple[NDArray[np.int64], Array]:
    """Return the indices of the C grid cells that contain points, sorted, and the mean of the values in each cell.

    Args:
        index: Indices, from 0 along x, y and z, of the cell of each point ``(F, 3)``.
        values: Value at each point ``(F,)``.

    Returns:
        The indices ``(C, 3)``, and the means ``(C,)``.
    """
    cells, cell = np.unique(index, axis=0, return_inverse=True)
    cell = cell.reshape(-1)
    return cells, np.bincount(cell, values, len(cells)) / np.bincount(cell, minlength=len(cells))


def colour_scale_mm(comparison: Comparison) -> float:
    """Return the upper end of the colour scale that all error fields share, mm."""
    return scale_end(field_mm(comparison.policies[0]))


def uncertainty_scale_mm(comparison: Comparison) -> float:
    """Return the upper end, mm, of the colour scale for both the predicted uncertainty and the last policy's errors."""
    assert comparison.field_uncertainty is not None
    return scale_end(np.concatenate([1e3 * comparison.field_uncertainty, field_mm(comparison.policies[-1])]))


def scale_end(values: Array) -> float:
    """Return the upper end of a colour scale for lengths ``(F,)``, in their unit."""
    top = float(np.percentile(values, SCALE_PERCENTILE)) if values.size else 0.0
    return top if top > 0.0 else 1.0


def histogram_edges_mm(comparison: Comparison) -> Array:
    """Return the edges ``(B + 1,)``, mm, of about 24 bins of round width for the reach errors of all policies."""
    largest = float(np.max([policy.ends.position_error_mm for policy in comparison.policies], initial=0.0))
    width = round_step((largest or 1.0) / 24)
    return np.asarray(width * np.arange(int(largest / width) + 2))


def round_step(at_least: float) -> float:
    """Round up to 1, 2, 2.5 or 5 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(at_least))
    return next(float(m * power) for m in (1.0, 2.0, 2.5, 5.0, 10.0) if m * power >= at_least * (1.0 - 1e-9))


def ticks(top: float) -> list[float]:
    """Return round tick values from 0 up to ``top``, about eight of them."""
    step = round_step(top / 8)
    return [i * step for i in range(int(top / step + 1e-9) + 1)]


def summary_markdown(comparison: Comparison) -> str:
    """Return errors of each policy as a Markdown table, with a short legend of what is drawn at which scale."""
    top, has_reaches = colour_scale_mm(comparison), len(comparison.fruit) > 0
    heads = ["field mean", "field RMS", "field p95", "field max"]
    if has_reaches:
        heads = ["picked", "reach mean", "RMS", "p95", "max", "attitude mean", "field mean", "field RMS"]
    cells_of = _reach_cells if has_reaches else _field_cells
    rows = [[f"**{unmarked(policy.label)}**", *cells_of(policy)] for policy in comparison.policies]
    first = unmarked(comparison.policies[0].label)
    reaches = (
        f"{count_of(len(comparison.fruit), 'reach', 'reaches')}, of this one calibration; a pick if the fruit is "
        f"inside the capture region, radius {comparison.tolerance_mm:g} mm. "
    )
    parts = [
        f"## {unmarked(in_words(comparison.plant.name))}, seed {comparison.seed}",
        _table(["policy", *heads], rows),
        f"{reaches if has_reaches else ''}{len(comparison.grid.points)} field points, cells of "
        f"{comparison.grid.step * 1e3:g} mm.{_better(comparison)}",
        f"**Arrows**: true minus wanted tool position, drawn ×{GAIN:g}. **Colour**: its length, 0 to {top:.2f} mm in "
        f"every field (p{SCALE_PERCENTILE:g} of {first}; above that the colour saturates).",
    ]
    if has_reaches:
        parts.append(
            f"**Picking**: wire arm = what the controller believes; solid arm = the true arm with the {first} "
            f"command, difference drawn ×{GAIN:g}; red ball = capture region ×{GAIN:g}: an arrow that ends inside it "
            "is a pick."
        )
    return "\n\n".join(parts)


def _better(comparison: Comparison) -> str:
    """Return a sentence on the share of field points at which the last policy errs less than the last but one.

    With fewer than two policies the text is empty.
    """
    if len(comparison.policies) < 2:
        return ""
    before, last = comparison.policies[-2:]
    share = 100.0 * float(np.mean(field_mm(last) < field_mm(before)))
    return f" {unmarked(last.label)} errs less than {unmarked(before.label)} at {share:.0f} % of them."


def _reach_cells(policy: RecordedPolicy) -> list[str]:
    ends = policy.ends
    mean, *others = error_spread(ends.position_error_mm)
    attitude, *_ = error_spread(ends.attitude_error_deg)
    return [
        f"{100.0 * float(np.mean(ends.success)):.0f} %",
        f"{mean:.2f} mm",
        *(f"{value:.2f}" for value in others),
        f"{attitude:.3f}°",
        *_field_cells(policy)[:2],
    ]


def _field_cells(policy: RecordedPolicy) -> list[str]:
    mean, *others = error_spread(field_mm(policy))
    return [f"{mean:.2f} mm", *(f"{value:.2f}" for value in others)]
