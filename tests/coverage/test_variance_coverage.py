"""Shares of variance and Sobol indices hold the truth as often as they say; a cause without effect may have none.

Rows like a study's, but of known truth: even deviations, errors that are skewed and unequally scattered. One draw takes
a tenth of a second, so that a thousand tell the coverage to within 1.4 points: so much is allowed on either side.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
import pytest

from pickenv.experiments import sensitivities_of, study_variance

DEVIATIONS = 24
SLOPES = {0: (1.0, 0.5), 1: (0.5, 0.8), 2: (0.3, 0.0), 3: (0.1, 0.2), 12: (0.2, 0.0)}
"""Slopes of x and x^2 of the deviations that have an effect; the first twelve are lengths, the others angles."""
NAMES = [f"delta_a{i}_mm" if i < 12 else f"delta_alpha{i}_deg" for i in range(DEVIATIONS)]
EXPLAINED = {i: b**2 / 3 + c**2 * 4 / 45 for i, (b, c) in SLOPES.items()}
WHOLE = 2.0 * sum(EXPLAINED.values())  # half of it is scatter
ARMS = {"default": 1000, "smallest": study_variance.ARMS_PER_TERM * (2 * DEVIATIONS + 1)}


def shares(rng: np.random.Generator, arms: int) -> dict[str, dict[str, Any]]:
    """What the regression says of one such population, by parameter."""
    x = rng.uniform(-1, 1, (arms, DEVIATIONS))
    unequal = 0.5 + 1.5 * x[:, 1] ** 2
    scatter = (rng.gamma(2.0, 1.0, arms) - 2.0) / np.sqrt(2.0) * unequal / np.sqrt(1.2)
    squared = 6.0 + np.sqrt(WHOLE / 2.0) * scatter
    for i, (b, c) in SLOPES.items():
        squared = squared + b * x[:, i] + c * x[:, i] ** 2
    columns = {"setting": np.zeros(arms, np.int32), "arm": np.arange(arms), "status": ["ok"] * arms}
    columns |= {"error_rms_mm": np.sqrt(np.maximum(squared, 0.0))}
    table = pa.table(columns | dict(zip(NAMES, x.T, strict=True)))
    return {row["parameter"]: row for row in sensitivities_of(ds.dataset(table)).to_pylist()}


@pytest.mark.parametrize("arms", ARMS.values(), ids=ARMS)
def test_shares(repeats: Any, arms: int) -> None:
    """Every share, large and small, of a parameter and of a kind; one population tells of them all."""
    truth = {NAMES[i]: part / WHOLE for i, part in EXPLAINED.items()}
    truth |= {"lengths": sum(EXPLAINED[i] for i in range(4)) / WHOLE, "angles": EXPLAINED[12] / WHOLE}
    times, rng = (1000 if repeats.full else 40), np.random.default_rng(20261123)
    held = dict.fromkeys(truth, 0)
    null, spared, estimates = 0, 0, []
    for _ in range(times):
        found = shares(rng, arms)
        for name, share in truth.items():
            held[name] += found[name]["share_low"] <= share <= found[name]["share_high"]
        for name in set(NAMES) - set(truth):
            null += 1
            spared += found[name]["share_low"] <= 0.0 <= found[name]["share_high"]
            estimates.append(found[name]["share"])
    chance = (2.0 if repeats.full else 3.0) * np.sqrt(0.05 * 0.95 / times)
    assert spared / null >= 0.93, f"holds zero in {spared} of {null}"
    assert abs(np.mean(estimates)) < 4.0 * np.std(estimates) / np.sqrt(null / 4)
    for name, count in held.items():
        assert 0.93 - chance <= count / times <= 0.97 + chance, f"{name}: {count} of {times}"


ISHIGAMI = {"first_order": (0.3139, 0.4424, 0.0), "total": (0.5576, 0.4424, 0.2437)}


@pytest.mark.parametrize("samples", [study_variance.LEAST_SAMPLES, study_variance.SAMPLES])
def test_sobol_indices(repeats: Any, samples: int) -> None:
    def model(even: np.ndarray, _rows: np.ndarray) -> np.ndarray:
        x = np.pi * (2 * even - 1)
        return np.asarray(np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0]))

    times, rng = (2000 if repeats.full else 60), np.random.default_rng(20261124)
    held = {key: np.zeros(3) for key in ISHIGAMI}
    for _ in range(times):
        rows = study_variance.sobol_indices(model, {"x1": [0], "x2": [1], "x3": [2]}, samples, rng)
        for key, truth in ISHIGAMI.items():
            held[key] += [r[f"{key}_low"] <= t <= r[f"{key}_high"] for r, t in zip(rows, truth, strict=True)]
    chance = (2.0 if repeats.full else 3.0) * np.sqrt(0.05 * 0.95 / times)
    for key, counts in held.items():
        assert (counts / times >= 0.93 - chance).all() and (counts / times <= 0.97 + chance).all(), (key, counts)


@pytest.mark.parametrize("arms", [study_variance.LEAST_ARMS, study_variance.MOST_ARMS])
def test_components(repeats: Any, arms: int) -> None:
    """Arms half, fruit a quarter alone and three eighths in all."""
    times, rng = (4000 if repeats.full else 100), np.random.default_rng(20261125)
    held = np.zeros(2)
    for _ in range(times):
        a, f, p = rng.normal(size=(3, 2, arms, 1))
        value = lambda i, j, k, a=a, f=f, p=p: 2 * a[i] + np.sqrt(2) * f[j] + p[k] + f[j] * p[k]  # noqa: E731
        mixed = np.stack([value(1, 0, 0), value(0, 1, 0)])
        one, other = study_variance.variance_indices(value(0, 0, 0), value(1, 1, 1), mixed, ["arms", "fruit"])
        held += [
            one["first_order_low"] <= 0.5 <= one["first_order_high"],
            other["total_low"] <= 0.375 <= other["total_high"],
        ]
    chance = (2.0 if repeats.full else 3.0) * np.sqrt(0.05 * 0.95 / times)
    assert (held / times >= 0.93 - chance).all() and (held / times <= 0.97 + chance).all(), held / times
