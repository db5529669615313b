"""What several seeds of a study say of one another, on yields that are made up here."""

import importlib

import numpy as np
import pytest

from pickenv.base import mean_interval, share_interval


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend("scripts/studies")
    return importlib.import_module("study_seeds")


def made(rng, truth, seeds, arms, apart=0.0):
    """Yields and arms of some seeds whose settings share the luck of their arms; each seed may be shifted besides."""
    yields, within = [], []
    for _ in range(seeds):
        luck, shift = rng.random(arms), apart * rng.normal()
        good = np.array([luck < share + shift for share in truth])
        within.append(good)
        rows = []
        for grade, each in zip((6, 8, 10), good, strict=False):
            low, high = share_interval(int(each.sum()), arms)
            key = {"tolerances": "fine", "it_grade": grade, "method": "raw", "poses": 0, "noise_mm": 0, "payload_kg": 0}
            rows.append(key | {"yield": each.mean(), "yield_low": low, "yield_high": high})
        yields.append(rows)
    return yields, within


def test_intervals_pairs_and_orders_are_counted(script):
    """Three seeds whose yields are 50, 60 and 70 of 100, then 52, 60 and 50, then the first once more."""
    luck = np.arange(100)
    shares = ([50, 60, 70], [52, 60, 50], [50, 60, 70])
    within = [np.array([luck < share for share in each]) for each in shares]
    yields = []
    for each in shares:
        rows = made(np.random.default_rng(0), [0.5] * 3, 1, 10)[0][0]
        ends = [share_interval(share, 100) for share in each]
        told = zip(rows, each, ends, strict=True)
        yields.append([r | {"yield": s / 100, "yield_low": e[0], "yield_high": e[1]} for r, s, e in told])
    found = script.seeds_agree(yields, within)
    held = 0
    for seed in range(3):
        for setting in range(3):
            low, high = share_interval(shares[seed][setting], 100)
            others = np.mean([shares[k][setting] for k in range(3) if k != seed]) / 100
            held += low <= others <= high
    assert (found.held, found.intervals, found.pairs) == (held, 9, 3) and 0 < held < 9
    assert (found.reordered, found.contradicted) == (2, 1)  # 52 of 100 against 50: one seed is not sure
    expected = [np.var([s[k] / 100 for s in shares], ddof=1) / (m * (1 - m) / 100) for k, m in
                enumerate(np.mean(shares, axis=0) / 100)]  # fmt: skip
    assert found.dispersion == pytest.approx(np.mean(expected))


def test_yields_of_independent_arms_vary_as_by_chance_and_those_of_seeds_that_differ_vary_more(script):
    rng, inside = np.random.default_rng(2), 0
    low, high = script.dispersion_by_chance(6)
    for _ in range(300):
        inside += low <= script.seeds_agree(*made(rng, [0.5], 6, 200)).dispersion <= high
    assert 0.91 < inside / 300 < 0.985
    assert script.seeds_agree(*made(rng, [0.5, 0.4], 30, 1000, apart=0.05)).dispersion > 3.0
    assert script.seeds_agree(*made(rng, [0.0, 1.0], 3, 20)).dispersion is None


def test_groups_of_seeds_are_compared_each_within_itself(script, monkeypatch):
    asked = []
    monkeypatch.setattr(script, "agreement", lambda config, seeds, out: asked.append(list(seeds)) or seeds[0])
    assert script.in_groups(None, range(6), 3, None) == [0, 3] and asked == [[0, 1, 2], [3, 4, 5]]
    found = [script.Agreement(held, 20, 0, apart, 9, 1.0) for held, apart in ((12, 0), (16, 2), (17, 1))]
    said = script.sentence_of_groups("grades", 3, found)
    assert said.startswith("grades, 3 groups of 3 seeds: 75 % of yield intervals (least 60, most 85) hold")  # too few
    assert "of 27 pairs of grades or numbers of poses 3 change" in said
    shares = [60, 80, 85, 100, 100, 95, 90, 90, 75, 85]
    low, high = mean_interval(shares)
    said = script.sentence_of_groups("grades", 3, [script.Agreement(share // 5, 20, 0, 0, 9, 1.0) for share in shares])
    assert f"86 % of yield intervals (95 % interval over groups {low:.0f} to {high:.0f}; least 60, most 100)" in said


def test_the_words_hold_the_counts(script):
    found = script.Agreement(82, 108, 3, 1, 9, 1.9)
    said = script.sentence("grades", range(6), found)
    assert "82 of 108 yield intervals (76 %)" in said and "of 9 pairs of" in said and "1 of them" in said
    assert said.endswith("yields vary 1.90 times as much as of independent arms (0.17 to 2.57 by chance)")
