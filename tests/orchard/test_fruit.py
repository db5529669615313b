"""Fruit is clumped and bottom-heavy, as in a digitised V-trellis row; a uniform sampler is not."""

import csv
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import minimize_scalar
from scipy.stats import nbinom

from pickenv.orchard import (
    FruitMap,
    FruitSize,
    fruit_masses,
    load_canopy,
    load_fruit_map,
    load_fruit_size,
    sample_counts,
    sample_diameters,
    sample_fruit,
)

quick = settings(deadline=None, derandomize=True)

COLUMNS = slice(12, 179)  # of the mapped row: the rest is sensing margin
ROWS = slice(1, 5)
REPEATS = 2000  # sampled rows of the length of the mapped one
STATISTICS = ("density", "variance_ratio", "k", "empty_share", "bottom_share")


@pytest.fixture(scope="module")
def mapped_row(data_folder: Path) -> np.ndarray:
    """Apples per 0.3 m block, 4 rows from top to bottom, 50.1 m long."""
    return np.loadtxt(data_folder / "corobotic-fruitmap" / "fruit_dist.map")


def fit_fruit_map(matrix: np.ndarray) -> FruitMap:
    """The map of 0.3 m blocks that makes apple counts (rows, columns) likeliest, without the empty margins.

    Clusters are as large as the largest number that divides every count.
    """
    rows, columns = (np.flatnonzero(matrix.any(axis=axis)) for axis in (1, 0))
    counts = matrix[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    size = int(np.gcd.reduce(counts.astype(np.int64), axis=None))
    clusters = counts / size
    means = clusters.mean(axis=1, keepdims=True)

    def cost(log_excess: float) -> float:
        excess = np.exp(log_excess)  # variance/mean - 1
        return -float(np.sum(nbinom.logpmf(clusters, means / excess, 1.0 / (1.0 + excess))))

    best = minimize_scalar(cost, bounds=(np.log(1e-6), np.log(1e3)), method="bounded", options={"xatol": 1e-6})
    means = tuple(counts.mean(axis=1).tolist())
    return FruitMap(0.3, means, cluster_size=size, cluster_variance_ratio=1.0 + float(np.exp(best.x)))


@dataclass(frozen=True, eq=False)
class Clumping:
    """Statistics of apple counts; each has the leading shape of the counts.

    Attributes:
        density: Apples per metre of row.
        variance_ratio: Variance/mean over all blocks.
        k: Moment estimate of the negative binomial's dispersion, mean²/(variance − mean).
        empty_share: Share of blocks without an apple.
        row_shares: Share of the apples in each row of blocks, top to bottom, shape (..., rows).
    """

    density: np.ndarray
    variance_ratio: np.ndarray
    k: np.ndarray
    empty_share: np.ndarray
    row_shares: np.ndarray


def clumping(counts: np.ndarray, block: float = 0.3) -> Clumping:
    """How clumped apple counts (..., rows, columns) are."""
    mean, variance = counts.mean(axis=(-2, -1)), counts.var(axis=(-2, -1))
    return Clumping(
        density=counts.sum(axis=(-2, -1)) / (counts.shape[-1] * block),
        variance_ratio=variance / mean,
        k=mean**2 / (variance - mean),
        empty_share=(counts == 0).mean(axis=(-2, -1)),
        row_shares=counts.sum(axis=-1) / counts.sum(axis=(-2, -1))[..., None],
    )


def values(found: Clumping) -> dict[str, np.ndarray]:
    return {
        "density": found.density,
        "variance_ratio": found.variance_ratio,
        "k": found.k,
        "empty_share": found.empty_share,
        "bottom_share": found.row_shares[..., -1],
    }


def expected(fruit_map: FruitMap) -> Clumping:
    """Statistics of a map in closed form: a negative binomial of clusters in each row of blocks."""
    means = np.array(fruit_map.row_means)
    ratio = max(fruit_map.cluster_variance_ratio, 1.0 + 1e-9)
    variance_ratio = fruit_map.cluster_size * fruit_map.cluster_variance_ratio + means.var() / means.mean()
    return Clumping(
        density=np.asarray(fruit_map.density),
        variance_ratio=variance_ratio,
        k=means.mean() / (variance_ratio - 1.0),
        empty_share=np.mean(np.exp(-means / fruit_map.cluster_size * np.log(ratio) / (ratio - 1.0))),
        row_shares=means / means.sum(),
    )


def unclumped(fruit_map: FruitMap) -> FruitMap:
    """The map a uniform sampler would use: the same apples per metre, Poisson in every block of every row."""
    even = (float(np.mean(fruit_map.row_means)),) * len(fruit_map.row_means)
    return replace(fruit_map, row_means=even, cluster_size=1, cluster_variance_ratio=1.0)


def outside(fruit_map: FruitMap, observed: Clumping, columns: int) -> set[str]:
    """Statistics of the observed row that fall outside the central 95 % of rows sampled from a map."""
    sampled = values(clumping(sample_counts(fruit_map, columns, np.random.default_rng(7), (REPEATS,))))
    limits = {name: np.quantile(sampled[name], [0.025, 0.975]) for name in STATISTICS}
    return {name for name, value in values(observed).items() if not limits[name][0] <= value <= limits[name][1]}


def test_the_mapped_row_holds_867_apples_three_quarters_of_its_blocks_none(mapped_row: np.ndarray) -> None:
    counts = mapped_row[ROWS, COLUMNS]
    found = clumping(counts)
    assert counts.sum() == 867
    assert counts.sum(axis=1).tolist() == [177, 150, 198, 342]
    assert found.density == pytest.approx(17.3, abs=0.01)
    assert found.variance_ratio == pytest.approx(5.7, abs=0.02)
    assert found.k == pytest.approx(0.28, abs=0.005)
    assert found.empty_share == pytest.approx(0.74, abs=0.003)


def test_every_count_of_the_mapped_row_is_a_multiple_of_three(mapped_row: np.ndarray) -> None:
    assert set(np.unique(mapped_row)) == {0, 3, 6, 9, 12, 15, 18}
    assert fit_fruit_map(mapped_row).cluster_size == 3


def test_the_fit_knows_density_k_and_row_shares_and_cuts_the_margins(mapped_row: np.ndarray) -> None:
    fitted = fit_fruit_map(mapped_row)
    assert fitted.density == pytest.approx(867 / 50.1)
    assert expected(fitted).row_shares == pytest.approx([177 / 867, 150 / 867, 198 / 867, 342 / 867])
    assert expected(fitted).k == pytest.approx(0.28, abs=0.015)
    assert expected(fitted).empty_share == pytest.approx(0.738, abs=0.003)
    assert fitted == fit_fruit_map(mapped_row[ROWS, COLUMNS])


def test_the_shipped_v_trellis_is_the_fit(mapped_row: np.ndarray) -> None:
    fitted, shipped = fit_fruit_map(mapped_row), load_fruit_map("v_trellis")
    assert shipped.row_means == pytest.approx(fitted.row_means, abs=1e-4)
    assert shipped.cluster_variance_ratio == pytest.approx(fitted.cluster_variance_ratio, abs=1e-3)


def test_sampled_rows_reproduce_the_mapped_one_within_sampling_intervals(mapped_row: np.ndarray) -> None:
    counts = mapped_row[ROWS, COLUMNS]
    assert outside(fit_fruit_map(mapped_row), clumping(counts), counts.shape[1]) == set()


def test_a_uniform_sampler_fails_the_same_test(mapped_row: np.ndarray) -> None:
    counts = mapped_row[ROWS, COLUMNS]
    wrong = outside(unclumped(fit_fruit_map(mapped_row)), clumping(counts), counts.shape[1])
    assert wrong >= {"variance_ratio", "empty_share", "bottom_share"}


def test_single_apples_as_clumped_leave_too_few_blocks_empty(mapped_row: np.ndarray) -> None:
    """A plain negative binomial with k = 0.28 leaves 62 % empty, the field 74 %: apples come in clusters."""
    counts, fitted = mapped_row[ROWS, COLUMNS], fit_fruit_map(mapped_row)
    single = replace(fitted, cluster_size=1, cluster_variance_ratio=3 * fitted.cluster_variance_ratio)
    assert expected(single).k == pytest.approx(expected(fitted).k)
    assert expected(single).empty_share == pytest.approx(0.62, abs=0.01)
    assert outside(single, clumping(counts), counts.shape[1]) == {"empty_share"}


def test_the_fit_recovers_the_map_it_was_sampled_from() -> None:
    truth = FruitMap(0.3, (0.5, 2.0, 4.0), cluster_size=2, cluster_variance_ratio=2.5)
    fitted = fit_fruit_map(sample_counts(truth, 20_000, np.random.default_rng(3)))
    assert fitted.cluster_size == 2
    assert fitted.row_means == pytest.approx(truth.row_means, rel=0.05)
    assert fitted.cluster_variance_ratio == pytest.approx(2.5, rel=0.03)


maps = st.builds(
    FruitMap,
    block=st.just(0.3),
    row_means=st.lists(st.floats(0.1, 6.0), min_size=1, max_size=6).map(tuple),
    cluster_size=st.integers(1, 4),
    cluster_variance_ratio=st.floats(1.0, 4.0),
)


@quick
@given(maps, st.integers(1, 12))
def test_other_numbers_of_rows_keep_the_apples_per_metre(fruit_map: FruitMap, rows: int) -> None:
    assert fruit_map.with_rows(rows).density == pytest.approx(fruit_map.density)
    assert fruit_map.with_rows(len(fruit_map.row_means)).row_means == pytest.approx(fruit_map.row_means)


@quick
@given(maps, st.floats(0.5, 60.0))
def test_scaling_sets_the_density_and_keeps_the_shares(fruit_map: FruitMap, density: float) -> None:
    scaled = fruit_map.scaled(density)
    assert scaled.density == pytest.approx(density)
    assert np.divide(scaled.row_means, density) == pytest.approx(np.divide(fruit_map.row_means, fruit_map.density))


@quick
@given(maps, st.integers(0, 2**32))
def test_counts_are_whole_clusters_and_one_seed_repeats_them(fruit_map: FruitMap, seed: int) -> None:
    counts = sample_counts(fruit_map, 12, np.random.default_rng(seed))
    assert (counts % fruit_map.cluster_size == 0).all()
    np.testing.assert_array_equal(counts, sample_counts(fruit_map, 12, np.random.default_rng(seed)))


def test_sampled_statistics_are_those_in_closed_form() -> None:
    fruit_map = load_fruit_map("v_trellis")
    found = clumping(sample_counts(fruit_map, 200_000, np.random.default_rng(0)))
    assert found.density == pytest.approx(fruit_map.density, rel=0.01)
    assert found.variance_ratio == pytest.approx(expected(fruit_map).variance_ratio, rel=0.02)
    assert found.empty_share == pytest.approx(expected(fruit_map).empty_share, abs=0.002)


def test_apples_are_75_mm_wide_and_weigh_180_g() -> None:
    size = load_fruit_size("apple")
    drawn = sample_diameters(size, 20_000, np.random.default_rng(1))
    assert drawn.mean() == pytest.approx(0.0749, abs=2e-4)
    assert drawn.std() == pytest.approx(0.0047, abs=2e-4)
    assert size.smallest <= drawn.min() and drawn.max() <= size.largest
    assert fruit_masses(size, 0.0749) == pytest.approx(0.185, abs=0.001)


def test_the_shipped_apples_are_those_probed_on_a_real_tree(data_folder: Path) -> None:
    with (data_folder / "pickapp-osu" / "apple_list.csv").open(newline="", encoding="utf-8") as file:
        probed = np.array([float(row[4]) for row in csv.reader(file)])
    size = load_fruit_size("apple")
    assert len(probed) == 42
    assert size.mean == pytest.approx(probed.mean(), abs=5e-5) and size.std == pytest.approx(probed.std(), abs=5e-5)
    assert size.smallest < probed.min() and probed.max() < size.largest


@quick
@given(st.floats(0.03, 0.1), st.floats(0.0, 0.03), st.integers(0, 2**32))
def test_diameters_stay_within_their_cut(mean: float, std: float, seed: int) -> None:
    size = FruitSize(mean, std, 0.9 * mean, 1.2 * mean, 840.0)
    drawn = sample_diameters(size, 50, np.random.default_rng(seed))
    assert ((drawn >= size.smallest) & (drawn <= size.largest)).all()


@pytest.mark.parametrize("canopy", ["li2016", "v_trellis"])
def test_fruit_hangs_in_the_canopy_clustered_and_apart(canopy: str) -> None:
    volume, size = load_canopy(canopy), load_fruit_size("apple")
    for seed in range(20):
        fruit, diameters = sample_fruit(load_fruit_map("v_trellis"), size, volume, np.random.default_rng(seed))
        if not len(fruit):
            continue
        gaps = np.linalg.norm(fruit[:, None] - fruit[None], axis=-1)
        touching = (diameters[:, None] + diameters[None]) / 2
        np.fill_diagonal(gaps, np.inf)
        assert (gaps >= touching - 2e-4).all()
        assert len(fruit) % 3 == 0
        clusters = np.arange(len(fruit)) // 3
        mates = clusters[:, None] == clusters[None]
        assert np.median(np.where(mates, gaps, np.inf).min(axis=1)) < 0.1  # mates hang side by side


def test_a_canopy_gets_the_maps_apples_per_metre_more_of_them_low() -> None:
    volume, fruit_map = load_canopy("v_trellis"), load_fruit_map("v_trellis")
    rng = np.random.default_rng(5)
    heights = [sample_fruit(fruit_map, load_fruit_size("apple"), volume, rng)[0][:, 2] for _ in range(400)]
    per_metre = np.array([len(h) for h in heights]) / volume.width
    assert per_metre.mean() == pytest.approx(17.3, abs=3 * per_metre.std() / 20)
    low = np.concatenate(heights) < volume.bottom + 0.3
    assert low.mean() == pytest.approx(342 / 867, abs=0.03)


def test_one_seed_gives_one_canopy() -> None:
    a, b = (
        sample_fruit(load_fruit_map("v_trellis"), load_fruit_size("apple"), load_canopy("li2016"), rng)
        for rng in (np.random.default_rng(11), np.random.default_rng(11))
    )
    for one, other in zip(a, b, strict=True):
        np.testing.assert_array_equal(one, other)
