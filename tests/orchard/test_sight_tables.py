"""Tables of what eyes miss: how they are made of sightings, what they must hold, and figures over fruit."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.base import InputError, clustered_share_interval, statistic_interval
from pickenv.orchard import load_sight_errors, shipped, sighted
from scripts.studies.measure_sight import (
    Sightings,
    _deviation,
    _ends,
    error_measure,
    mean_error,
    root_mean_square,
    share_of,
    tabulated,
)

TABLES = [load_sight_errors(name) for name in shipped("sight")]
LISTED = ("tree", "depth", "visible", "found", "error", "again")


@pytest.mark.parametrize(
    "wrong",
    [
        {"part_bias": ()},
        {"part_bias": ((), (), ()), "part_spread": ((), (), ()), "part_correlation": ((), (), ())},
        {"recall": (0.5, 0.5)},
        {"part_spread": TABLES[0].part_spread[1:]},
        {"part_spread": (*TABLES[0].part_spread[:-1], TABLES[0].part_spread[-1][1:])},
    ],
    ids=["no parts", "empty parts", "a range less", "a range of parts less", "a part less"],
)
def test_a_table_has_one_entry_for_each_range_and_part(wrong):
    with pytest.raises(InputError, match="have not one entry for each of"):
        replace(TABLES[0], **wrong)


def test_fruit_is_found_below_its_recall_and_the_last_part_holds_the_end():
    """Of four normals the last says how sure a fruit is to be found: 0 is a share of a half."""
    errors = TABLES[0]
    ranges, parts = len(errors.recall), len(errors.part_bias[0])
    errors = replace(errors, recall=(0.5,) * ranges, in_sight=(0.6,) * ranges)
    normal = np.zeros((4, 4))
    normal[:, 3] = [-1e-6, 0.0, 0.2533, 0.2534]  # the share of 0.6 lies between the last two
    in_sight, located, error = sighted(errors, np.full(4, 0.9), np.column_stack([[1.0, 1.0, 0.0, 0.0], normal]))
    assert located.tolist() == [True, False, False, False] and in_sight.tolist() == [True, True, True, False]
    assert error == pytest.approx(np.array(errors.part_bias[0])[[parts - 1, parts - 1, 0, 0]])
    half = replace(errors, in_sight=(0.2,) * ranges)
    in_sight, *_ = sighted(half, np.full(4, 0.9), np.column_stack([np.zeros(4), normal]))
    assert in_sight.tolist() == [
        True,
        False,
        False,
        False,
    ]


def made_sightings(n=701, trees=15):
    """Fruit by chance; what is missed has no error, and a second picture misses other fruit."""
    rng = np.random.default_rng(5)
    visible = np.clip(rng.uniform(-0.2, 1.0, n), 0.0, 1.0)
    found = (visible > 0) & (rng.random(n) < 0.8)
    error = 1e-3 * (rng.normal(size=(n, 3)) @ [[1.0, 0.3, 0.2], [0.0, 2.0, -0.6], [0.0, 0.0, 4.0]] + [0.5, -1.0, 2.0])
    again = 0.6 * error + 1e-3 * rng.normal(size=(n, 3))
    error[~found], again[rng.random(n) < 0.3] = np.nan, np.nan
    return Sightings(rng.integers(0, trees, n), rng.uniform(0.9, 1.6, n), visible, found, error, again, 70, 9)


def by_tree(seen, rows, measure):
    """95 % interval over trees, from sums that are made here."""
    sums = [[np.sum(rows & (seen.tree == t)), *measure(rows & (seen.tree == t))] for t in range(15)]
    return np.array([each for each in sums if each[0]])


def test_a_tables_numbers_are_those_of_numpy_in_every_range_and_part():
    seen = made_sightings()
    table = tabulated(seen, 3, 4)
    edges = np.quantile(seen.depth, [1 / 3, 2 / 3])
    both = np.isfinite(seen.error + seen.again).all(axis=1)
    lasting = np.mean([np.corrcoef(seen.error[both, i], seen.again[both, i])[0, 1] for i in range(3)])
    assert table["edges_mm"] == np.round(1e3 * edges, 1).tolist() and table["lasting"] == np.round(lasting, 3)
    assert [table[name] for name in ("trees", "pictures", "fruit")] == [15, 70, 701]
    assert table["false_per_picture"] == np.round(9 / 70, 4)
    assert tabulated(replace(seen, pictures=0), 3, 4)["false_per_picture"] == 9.0
    for r in range(3):
        rows = np.digitize(seen.depth, edges) == r
        error = 1e3 * seen.error[rows & seen.found]
        told = {name: values[r] for name, values in table.items() if isinstance(values, list) and len(values) == 3}
        assert told["visible"] == np.round(seen.visible[rows].mean(), 3)
        assert told["in_sight"] == np.round((seen.visible[rows] > 0).mean(), 4)
        ends = clustered_share_interval(*by_tree(seen, rows, lambda some: [np.sum(seen.found[some])]).T[::-1])
        expected = [np.round(x, 4) for x in (seen.found[rows].mean(), *ends)]
        assert [told[f"recall{end}"] for end in ("", "_low", "_high")] == expected
        for i in range(3):
            sums = by_tree(
                seen,
                rows & seen.found,
                lambda some, i=i: [np.sum(1e3 * seen.error[some, i]), np.sum((1e3 * seen.error[some, i]) ** 2)],
            )
            measures = {
                "bias": lambda s: s[:, 1].sum() / s[:, 0].sum(),
                "spread": lambda s: np.sqrt(s[:, 2].sum() / s[:, 0].sum() - (s[:, 1].sum() / s[:, 0].sum()) ** 2),
            }
            values = {"bias": error[:, i].mean(), "spread": error[:, i].std()}
            for name, measure in measures.items():
                expected = [values[name], *statistic_interval(sums, measure)]
                got = [told[f"{name}{end}_mm"][i] for end in ("", "_low", "_high")]
                assert got == pytest.approx(expected, abs=0.0051)
                assert got == np.round(got, 2).tolist()
        assert told["correlation"] == np.round(np.corrcoef(error.T)[[0, 0, 1], [1, 2, 2]], 3).tolist()
        ordered = error[np.argsort(np.linalg.norm(error, axis=1))]
        for part, some in enumerate(np.array_split(ordered, 4)):
            assert told["part_bias_mm"][part] == np.round(some.mean(axis=0), 2).tolist()
            assert told["part_spread_mm"][part] == np.round(some.std(axis=0), 2).tolist()
            pairs = np.round(np.corrcoef(some.T)[[0, 0, 1], [1, 2, 2]], 3).tolist()
            assert told["part_correlation"][part] == pairs


def test_a_part_of_a_table_needs_three_fruit():
    seen = made_sightings()
    found = np.flatnonzero(seen.found)[:12]
    few = Sightings(*(np.asarray(getattr(seen, name))[found] for name in LISTED), 70, 9)
    assert len(tabulated(few, 1, 4)["part_bias_mm"][0]) == 4
    with pytest.raises(InputError, match="only 12 fruit were located in one range"):
        tabulated(few, 1, 5)


def test_figures_over_fruit_are_those_of_numpy():
    rng = np.random.default_rng(0)
    tree, error = rng.integers(0, 12, 200), rng.normal(2.0, 3.0, 200)
    assert error_measure(tree, error, mean_error)[0] == pytest.approx(error.mean())
    value, (low, high) = error_measure(tree, error, root_mean_square)
    assert value == pytest.approx(np.sqrt((error**2).mean())) and low < value < high
    assert share_of(tree, error > 2)[0] == pytest.approx((error > 2).mean())
    assert share_of(tree[:1], np.array([True])) == (1.0, None) and share_of(tree[:0], error[:0] > 2)[0] == 0.0
    assert error_measure(tree, 0.1 * error, _deviation)[0] == pytest.approx(0.1 * error.std())
    assert error_measure(tree[:3], np.full(3, 0.1), _deviation)[0] == pytest.approx(0.0, abs=1e-8)
    assert _ends((2.0, None)) == (2.0, 2.0, 2.0) and _ends((2.0, (1.5, 3.0))) == (2.0, 1.5, 3.0)
