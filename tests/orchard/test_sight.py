"""What eyes see: pictures that are read as by hand, tables that are drawn from as they say, or everything."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.base import InputError
from pickenv.orchard import (
    DETECTORS,
    VISIONS,
    Leaves,
    StereoPair,
    camera_frame,
    draw_chances,
    foliage,
    left_eye,
    load_canopy,
    load_eyes,
    load_sight_errors,
    locate,
    match_detections,
    next_picture,
    render_stereo,
    see,
    shipped,
    sighted,
)
from pickenv.orchard.sight import located_fruit, picture
from scripts.studies.measure_sight import share_of, sightings, tabulated, together

LEAFY = load_canopy("li2016")
VIEW = MIDDLE, LOOKING = np.array([0.1, -1.0, 1.6]), np.array([0.0, 1.0, 0.0])
FRUIT = np.array([[0.1, 0.05, 1.6], [-0.2, 0.2, 1.75], [0.35, 0.3, 1.5], [0.3, 0.1, 1.75], [-0.1, 0.39, 1.45]])
LISTED = ("tree", "depth", "visible", "found", "error", "again")
TABLES = [load_sight_errors(name) for name in shipped("sight")]


def test_a_picture_shows_every_leaf_that_hangs_before_either_eye():
    """As where all leaves of the row are drawn; most hang beside the picture, and some reach into its right one."""
    eyes = load_eyes("rendered", LEAFY)
    leaves = foliage(eyes, np.random.default_rng(0))
    found = picture(eyes, VIEW, FRUIT, np.full(5, 0.06), leaves, np.random.default_rng(1))
    eye = left_eye(eyes.camera, VIEW)
    every = Leaves(camera_frame(leaves.places, eye, LOOKING), leaves.shapes, leaves.colours)
    places = camera_frame(FRUIT, eye, LOOKING)
    whole = render_stereo(eyes.camera, places, np.full(5, 0.06), every, eyes.look, np.random.default_rng(1))
    for name in ("left", "right", "visible"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name))


def test_pictures_that_are_averaged_have_less_noise_by_the_root_of_their_number():
    eyes = load_eyes("rendered", load_canopy("li2016_bare"))
    eyes = replace(eyes, look=replace(eyes.look, pixel_noise=12.0))

    def noise(looks):
        pairs = [picture(eyes, VIEW, FRUIT[:0], np.zeros(0), None, np.random.default_rng(k), looks) for k in (0, 1)]
        return np.var(pairs[0].left.astype(float) - pairs[1].left)  # with that of the background

    assert noise(1) - noise(4) == pytest.approx(2 * 12.0**2 * (1 - 1 / 4), rel=0.05)


def test_false_detections_lie_anywhere_in_the_picture_as_deep_as_the_canopy():
    eyes = load_eyes("measured_errors", LEAFY)
    eyes = replace(eyes, errors=replace(eyes.errors, false_per_picture=3000.0))
    found = see(eyes, VIEW, FRUIT, np.full(5, 0.06), np.random.default_rng(3)).false
    assert abs(len(found) - 3000) < 4 * np.sqrt(3000)
    local = camera_frame(found, left_eye(eyes.camera, VIEW), LOOKING)
    half = np.array(eyes.camera.image) / 2 / eyes.camera.focal_length
    numbers = np.column_stack([local[:, :2] / local[:, 2:] / half, local[:, 2]])
    ends = [(-1.0, 1.0), (-1.0, 1.0), (LEAFY.standoff, LEAFY.standoff + LEAFY.depth)]
    for values, (low, high) in zip(numbers.T, ends, strict=True):
        width = high - low
        assert low - 1e-9 <= values.min() < low + 0.01 * width and high - 0.01 * width < values.max() <= high + 1e-9
        assert abs(values.mean() - (low + high) / 2) < 4 * width / np.sqrt(12 * len(found))


@pytest.mark.parametrize("vision", VISIONS)
def test_eyes_say_where_fruit_is_in_the_frame_in_which_it_was_given(vision):
    """The same fruit in the orchard and in a machine's base frame, half a turn about z away and somewhere else."""
    eyes = load_eyes(vision, load_canopy("li2016_bare"), "circles")
    there = FRUIT * [-1.0, -1.0, 1.0] + [3.0, 2.0, -0.4]
    turned = MIDDLE * [-1.0, -1.0, 1.0] + [3.0, 2.0, -0.4], -LOOKING
    one = see(eyes, VIEW, FRUIT, np.full(5, 0.06), np.random.default_rng(4))
    other = see(eyes, turned, there, np.full(5, 0.06), np.random.default_rng(4))
    assert one.located.sum() >= 4 and np.array_equal(one.located, other.located)
    seen = one.located
    assert one.believed[seen] == pytest.approx(FRUIT[seen], abs=0.0 if vision == "ideal" else 0.02)
    assert (one.believed - FRUIT)[seen] * [-1, -1, 1] == pytest.approx((other.believed - there)[seen], abs=1e-9)


def test_a_rendered_sight_is_its_picture_read():
    eyes, rng = load_eyes("rendered", LEAFY), np.random.default_rng(0)
    leaves = foliage(eyes, rng)
    found = see(eyes, VIEW, FRUIT, np.full(5, 0.06), np.random.default_rng(1), leaves=leaves)
    pair = picture(eyes, VIEW, FRUIT, np.full(5, 0.06), leaves, np.random.default_rng(1))
    places = camera_frame(FRUIT, MIDDLE - [0.06, 0.0, 0.0], LOOKING)  # the left eye, half a base line aside
    seen, _ = locate(eyes.camera, pair.left, pair.right)
    read = match_detections(seen, places, 0.06)
    assert set(np.flatnonzero(found.located)) == set(read[read >= 0].tolist())
    for position, number in zip(seen, read, strict=True):
        if number >= 0:
            miss = found.believed[number] - FRUIT[number]
            wanted = position - places[number]  # x right, y down, z ahead: x, -z and y of the orchard
            assert miss == pytest.approx([wanted[0], wanted[2], -wanted[1]], abs=1e-9)
    assert len(found.false) == int((read < 0).sum())
    assert np.array_equal(found.in_sight, pair.visible > 0)


def test_leaves_hang_in_the_canopy_as_dense_as_it_says_and_only_pictures_need_them():
    eyes = load_eyes("rendered", LEAFY)
    leaves = foliage(eyes, np.random.default_rng(0))
    x, y, z = leaves.places.T
    assert y.min() >= 0 and y.max() <= LEAFY.depth and z.min() >= LEAFY.bottom and z.max() <= LEAFY.top
    beside = np.abs(x) <= LEAFY.width / 2
    area = beside.sum() * np.pi / 4 * eyes.look.leaf_length * eyes.look.leaf_width
    volume = LEAFY.width * LEAFY.depth * (LEAFY.top - LEAFY.bottom)
    assert area / volume == pytest.approx(LEAFY.leaf_area_per_volume, rel=0.1)
    assert foliage(load_eyes("ideal", LEAFY), np.random.default_rng(0)) is None
    assert foliage(load_eyes("measured_errors", LEAFY), np.random.default_rng(0)) is None


def test_leaves_hang_behind_a_leaning_face_as_far_aside_as_the_picture_reaches():
    """The picture's half width at the back of the canopy, on either side of half its own width."""
    canopy = replace(load_canopy("v_trellis"), lean=-0.3)
    eyes = load_eyes("rendered", canopy)
    x, y, z = foliage(eyes, np.random.default_rng(0)).places.T
    reach = canopy.standoff + canopy.depth
    aside = canopy.width / 2 + reach * (eyes.camera.image[0] / 2) / eyes.camera.focal_length
    behind = y + np.tan(0.3) * (z - canopy.bottom)
    for values, low, high in ((x, -aside, aside), (behind, 0.0, canopy.depth), (z, canopy.bottom, canopy.top)):
        slack = 0.01 * (high - low)
        assert low - 1e-9 <= values.min() < low + slack and high - slack < values.max() <= high + 1e-9


def test_a_picture_without_leaves_is_one_of_no_leaves():
    eyes = load_eyes("rendered", load_canopy("li2016_bare"))
    found = picture(eyes, VIEW, FRUIT, np.full(5, 0.06), None, np.random.default_rng(1))
    rng = np.random.default_rng(1)
    places = camera_frame(FRUIT, left_eye(eyes.camera, VIEW), LOOKING)
    whole = render_stereo(eyes.camera, places, np.full(5, 0.06), np.zeros((0, 3)), eyes.look, rng)
    assert np.array_equal(found.left, whole.left) and np.array_equal(found.right, whole.right)


def test_one_picture_is_taken_unless_more_are_asked_for():
    rendered, drawn = load_eyes("rendered", load_canopy("li2016_bare")), load_eyes("measured_errors", LEAFY)
    drawn = replace(drawn, errors=replace(drawn.errors, lasting=0.2))
    given = VIEW, FRUIT, np.full(5, 0.06)
    for looks, alike in (({"looks": 1}, True), ({"looks": 2}, False)):
        one, other = (picture(rendered, *given, None, np.random.default_rng(0), **n) for n in ({}, looks))
        assert np.array_equal(one.left, other.left) == alike
        one, other = (see(drawn, *given, np.random.default_rng(0), **n) for n in ({}, looks))
        assert np.array_equal(one.believed, other.believed) == alike
        chances = draw_chances(np.random.default_rng(0), 5)
        one, other = (sighted(drawn.errors, np.full(5, 1.2), chances, **n)[2] for n in ({}, looks))
        assert np.array_equal(one, other) == alike


def test_given_chances_decide():
    eyes = load_eyes("measured_errors", LEAFY)
    chances = draw_chances(np.random.default_rng(7), 5)
    found = see(eyes, VIEW, FRUIT, np.full(5, 0.06), np.random.default_rng(0), chances=chances)
    depth = camera_frame(FRUIT, left_eye(eyes.camera, VIEW), LOOKING)[:, 2]
    in_sight, located, error = sighted(eyes.errors, depth, chances)
    assert np.array_equal(found.in_sight, in_sight) and np.array_equal(found.located, located)
    miss = found.believed - FRUIT
    assert miss == pytest.approx(np.stack([error[:, 0], error[:, 2], -error[:, 1]], axis=-1), abs=1e-12)


def test_ideal_eyes_take_nothing_for_fruit_that_is_none():
    found = see(load_eyes("ideal", LEAFY), VIEW, FRUIT, np.full(5, 0.06), np.random.default_rng(0))
    assert found.false.shape == (0, 3) and found.in_sight.dtype == found.located.dtype == bool
    assert found.in_sight.all() and found.located.all() and np.array_equal(found.believed, FRUIT)


def test_a_detection_is_of_fruit_in_sight_within_a_diameter_of_it():
    """The first fruit is hidden; by the third the detection is a diameter away, by the fourth a little more."""
    places = np.array([[-0.3, 0.0, 1.0], [-0.3, 0.02, 1.0], [0.0, 0.0, 1.0], [0.3, 0.0, 1.0]])
    visible = np.array([0.0, 0.4, 1.0, 0.01])
    black = np.zeros((2, 2, 3), dtype=np.uint8)
    pair = StereoPair(black, black, np.zeros((2, 2), dtype=np.int64), visible)
    seen = places[[3, 2, 0]] + [[0.0, 0.0601, 0.0], [0.0, 0.0599, 0.0], [0.0, 0.0, 0.0]]
    sizes = [0.02, 0.06, 0.05, 0.03]
    located, where, false = located_fruit(pair, seen, places, sizes)
    assert located.dtype == bool and located.tolist() == [False, True, True, False]
    np.testing.assert_array_equal(where, [places[0], seen[2], seen[1], places[3]])
    np.testing.assert_array_equal(false, seen[:1])
    hidden = replace(pair, visible=np.zeros(4))
    located, where, false = located_fruit(hidden, seen, places, sizes)
    assert not located.any() and np.array_equal(where, places) and np.array_equal(false, seen)
    located, where, false = located_fruit(pair, seen[:0], places, sizes)
    assert not located.any() and np.array_equal(where, places) and len(false) == 0


def test_fruit_behind_leaves_is_not_in_sight():
    """A wall of leaves before all fruit but the first, and far to its left."""
    eyes = load_eyes("rendered", LEAFY)
    x, z = np.meshgrid(np.arange(-0.3, 0.5, 0.02), np.arange(1.3, 1.9, 0.02))
    wall = np.column_stack([x.ravel(), np.full(x.size, -0.1), z.ravel()])
    wall = wall[np.hypot(x.ravel() - FRUIT[0, 0], z.ravel() - FRUIT[0, 2]) > 0.12]
    leaves = Leaves(wall, np.broadcast_to(np.eye(2), (len(wall), 2, 2)).copy(), np.full((len(wall), 3), 90.0))
    found = see(eyes, VIEW, FRUIT, np.full(5, 0.06), np.random.default_rng(1), leaves=leaves)
    assert found.in_sight.tolist() == [True, False, False, False, False]


@pytest.mark.parametrize("errors", TABLES, ids=[table.name for table in TABLES])
def test_fruit_is_missed_and_misplaced_as_the_table_says(errors):
    """Recall, bias and covariance of many draws in each part, recomputed with NumPy."""
    rng, n, parts = np.random.default_rng(0), 20_000, len(errors.part_bias[0])
    edges = [0.9, *errors.edges, 1.6]
    for r, p in ((r, p) for r in range(len(edges) - 1) for p in range(parts)):
        chances = np.column_stack([np.full(n, (p + 0.5) / parts), rng.normal(size=(n, 4))])
        in_sight, located, error = sighted(errors, np.full(n, (edges[r] + edges[r + 1]) / 2), chances)
        recall, bias, spread = errors.recall[r], np.array(errors.part_bias[r][p]), np.array(errors.part_spread[r][p])
        assert located.mean() == pytest.approx(recall, abs=4.5 * np.sqrt(recall * (1 - recall) / n) + 1e-9)
        assert (in_sight | ~located).all()
        assert np.abs(error.mean(axis=0) - bias).max() < 4.5 * (spread / np.sqrt(n)).max() + 1e-12
        assert error.std(axis=0) == pytest.approx(spread, rel=0.04, abs=1e-9)
        found = np.corrcoef(error.T)[[0, 0, 1], [1, 2, 2]]
        assert found == pytest.approx(errors.part_correlation[r][p], abs=0.05)


@pytest.mark.parametrize("errors", TABLES, ids=[table.name for table in TABLES])
def test_the_parts_together_have_the_bias_and_spread_of_their_range(errors):
    """Within rounding, and parts that differ by one fruit in size."""
    for r in range(len(errors.recall)):
        bias, spread = np.array(errors.part_bias[r]), np.array(errors.part_spread[r])
        assert bias.mean(axis=0) == pytest.approx(errors.bias[r], abs=2e-4)
        whole = np.sqrt((bias**2 + spread**2).mean(axis=0) - bias.mean(axis=0) ** 2)
        assert whole == pytest.approx(errors.spread[r], rel=0.05, abs=1e-5)


def test_the_far_is_found_less_often_in_leaves_and_intervals_hold_their_numbers():
    for errors in TABLES:
        if errors.leaf_area_per_volume:
            assert (np.diff(errors.recall) < 0).all() and (np.diff(errors.visible) < 0).all()
        for name in ("recall", "bias", "spread"):
            low, value, high = (np.array(getattr(errors, name + end)) for end in ("_low", "", "_high"))
            assert (low <= value).all() and (value <= high).all() and (low < high).all()


def test_two_pictures_of_the_same_fruit_miss_alike():
    errors = replace(TABLES[0], lasting=0.7)
    one = draw_chances(np.random.default_rng(0), 40_000)
    other = next_picture(errors, one, np.random.default_rng(1))
    assert np.array_equal(one[:, 0], other[:, 0])
    assert other[:, 1:].std(axis=0) == pytest.approx(np.ones(4), abs=0.02)
    for i in range(1, 5):
        assert np.corrcoef(one[:, i], other[:, i])[0, 1] == pytest.approx(0.7, abs=0.02)


def test_averaging_pictures_removes_what_does_not_last():
    errors = replace(TABLES[0], lasting=0.36)
    chances = draw_chances(np.random.default_rng(0), 1000)
    depth = np.full(1000, 1.2)
    once, often = (sighted(errors, depth, chances, looks)[2] for looks in (1, 10**9))
    bias = sighted(errors, depth, chances * [1, 0, 0, 0, 0])[2]
    assert often - bias == pytest.approx(0.6 * (once - bias), rel=1e-6, abs=1e-12)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("eagle", LEAFY), "unknown vision 'eagle'"),
        (("ideal", LEAFY, "guess"), "unknown detector 'guess'"),
        (("measured_errors", load_canopy("v_trellis")), "no errors were measured in canopy 'v_trellis'"),
        (("measured_errors", replace(LEAFY, leaf_area_per_volume=3.0)), "with 3 m2/m3 of leaves"),
    ],
)
def test_eyes_that_do_not_exist_are_refused(given, said):
    with pytest.raises(InputError, match=said):
        load_eyes(*given)


def test_every_canopy_that_has_errors_has_them_for_every_detector():
    assert shipped("sight") == sorted(f"{canopy}-{name}" for canopy in ("li2016", "li2016_bare") for name in DETECTORS)
    for errors in TABLES:
        assert errors.name == f"{errors.canopy}-{errors.detector}"
        assert errors.leaf_area_per_volume == load_canopy(errors.canopy).leaf_area_per_volume
        assert "measure_sight.py" in errors.source and errors.fruit > 1000 and errors.trees >= 100


def some_sightings(count=3):
    rng, parts = np.random.default_rng(0), []
    eyes = [load_eyes("rendered", load_canopy("li2016_bare"), name) for name in DETECTORS]
    for tree in range(count):
        fruit = FRUIT + rng.uniform(-0.03, 0.03, FRUIT.shape)
        parts.append(sightings(eyes, VIEW, fruit, np.full(5, 0.06), np.arange(5) > 0, None, rng, tree))
    return [together([part[i] for part in parts]) for i in range(len(eyes))]


def test_a_single_detector_reads_both_pictures():
    eyes = [load_eyes("rendered", load_canopy("li2016_bare"), "circles")]
    rng = np.random.default_rng(0)
    (seen,) = sightings(eyes, VIEW, FRUIT, np.full(5, 0.06), np.arange(5) != 2, None, rng, 8)
    depth = camera_frame(FRUIT, left_eye(eyes[0].camera, VIEW), LOOKING)[:, 2]
    assert seen.tree.tolist() == [8] * 4 and np.array_equal(seen.depth, depth[[0, 1, 3, 4]])
    assert seen.pictures == 1 and seen.found.any() and np.abs(seen.error[seen.found]).max() < 0.06


@pytest.mark.slow
def test_sightings_count_the_fruit_that_is_wanted_and_a_table_is_made_of_them():
    for seen in some_sightings():
        assert seen.tree.tolist() == [0] * 4 + [1] * 4 + [2] * 4 and seen.pictures == 3
        assert np.array_equal(np.isfinite(seen.error).all(axis=1), seen.found)
        table = tabulated(seen, 1, 2)
        error = 1e3 * seen.error[seen.found]
        assert table["recall"] == pytest.approx([seen.found.mean()], abs=1e-4)
        assert table["bias_mm"][0] == pytest.approx(error.mean(axis=0), abs=0.006)
        parts = np.array_split(error[np.argsort(np.linalg.norm(error, axis=1), kind="stable")], 2)
        for part, rows in enumerate(parts):
            assert table["part_bias_mm"][0][part] == pytest.approx(rows.mean(axis=0), abs=0.006)
            assert table["part_spread_mm"][0][part] == pytest.approx(rows.std(axis=0), abs=0.006)
        assert table["fruit"] == 12 and table["trees"] == 3 and 0 <= table["lasting"] <= 1


@pytest.mark.slow
@pytest.mark.parametrize("detector", DETECTORS)
def test_the_shipped_table_holds_for_trees_it_was_not_made_from(detector):
    """Fresh rendered pictures of the leafy canopy: recall and lateral errors as drawn from the table."""
    eyes, errors = load_eyes("rendered", LEAFY, detector), load_sight_errors(f"li2016-{detector}")
    rng, parts = np.random.default_rng(77), []
    for tree in range(40):
        fruit = np.column_stack([rng.uniform(-0.3, 0.5, 6), rng.uniform(0, 0.4, 6), rng.uniform(1.35, 1.85, 6)])
        leaves = foliage(eyes, rng)
        parts += sightings([eyes], VIEW, fruit, np.full(6, 0.06), np.ones(6, dtype=bool), leaves, rng, tree)
    seen = together(parts)
    _, located, error = sighted(errors, np.tile(seen.depth, 50), draw_chances(rng, 50 * len(seen.depth)))
    low, high = share_of(seen.tree, seen.found)[1]
    wide = 0.05  # the table's own interval
    assert low - wide <= located.mean() <= high + wide
    near = {name: (np.hypot(e[:, 0], e[:, 2]) < 5e-3).mean() for name, e in
            (("rendered", seen.error[seen.found]), ("table", error[located]))}  # fmt: skip
    assert near["table"] == pytest.approx(near["rendered"], abs=0.1)
