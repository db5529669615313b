"""Harmonics of the drives: planted ones are found within their uncertainty, and none where there are none."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.arm import forward, load_arm
from pickenv.base import InputError
from pickenv.calibration import (
    ArmModel,
    Calibration,
    Choices,
    Conditions,
    GravityTerm,
    Measurements,
    PeriodicTerm,
    calibrate,
    complete_model,
    contiguous_folds,
    harmonics_of,
    identify,
    identify_terms,
    plain_term,
    same_poses,
)
from pickenv.calibration.identification import term_choice
from pickenv.calibration.identification.term_choice import (
    HIGHEST,
    MOST,
    ROWS_EACH,
    WITHIN,
    Linearised,
    choose_terms,
    chosen_orders,
    every_order,
    left_of,
    pursued,
    refined,
    solved,
    terms_of,
)
from pickenv.calibration.model.terms import OrderTerm, ThermalTerm, kind_of_term

ARM = load_arm("ur5")
NOISE = 2e-5
PLANTED = PeriodicTerm((0, 1, 2), (13.37, 26.1, 4.72))
"""Orders off the grid."""


def tracked(rng, rows=240, coefficients=(2e-4, 1e-4, -1e-4, 5e-5, 3e-4, 0.0), wave=PLANTED):
    """Positions of a UR5 that differs from its nominal geometry, in joint ranges of 100 degrees."""
    true = ARM.nominal.displaced(rng.normal(size=len(ARM.nominal.parameter_names)) * 3e-4)
    model = ArmModel(true, (wave,), np.array(coefficients, dtype=float))
    joints = rng.uniform(-0.9, 0.9, (rows, 6)) + np.array([0.3, -1.2, 1.3, -0.8, 1.2, 0.2])
    place = model.pose(joints).position + rng.normal(size=(rows, 3)) * NOISE
    return Measurements(joints, place, None, ARM.nominal.prismatic, position_std=NOISE)


def bare_of(data):
    return identify(complete_model(ARM.nominal), ARM.nominal, data, max_iterations=60)


@pytest.fixture(scope="module")
def planted():
    data = tracked(np.random.default_rng(0))
    return data, bare_of(data)


@pytest.fixture(scope="module")
def chosen(planted):
    return choose_terms(ARM, planted[1], planted[0])


def test_planted_harmonics_are_found_with_orders_and_amplitudes_within_their_uncertainty(planted, chosen):
    data, bare = planted
    assert chosen[0] == "periodic" and [kind_of_term(term) for term in chosen[2]] == ["periodic"]
    found = identify_terms(chosen[2], bare, data)
    harmonics = harmonics_of(found)
    sizes = [amplitude for _, _, _, amplitude, _ in harmonics]
    assert sizes == sorted(sizes, reverse=True) and found.converged
    assert {(joint, round(order)) for joint, order, *_ in harmonics} == {(0, 13), (1, 26), (2, 5)}
    for joint, order, amplitude in ((0, 13.37, np.hypot(2e-4, 1e-4)), (1, 26.1, np.hypot(1e-4, 5e-5)), (2, 4.72, 3e-4)):
        ((at, at_std, size, size_std),) = (rest for moved, *rest in harmonics if moved == joint)
        assert 0.0 < at_std < 0.1 and abs(at - order) < 4 * at_std
        assert size_std < 0.1 * amplitude and abs(size - amplitude) < 4 * size_std
    left = data.difference(found.arm_model)
    assert np.sqrt(np.mean(left**2)) < 1.1 * NOISE < np.sqrt(np.mean(data.difference(bare.arm_model) ** 2)) / 2


@pytest.mark.slow
def test_uncertainties_of_orders_and_amplitudes_are_their_scatter():
    """Over thirty measurements of one arm; that of sixty values in all is known to 10 %."""
    off = []
    for seed in range(30):
        data = tracked(np.random.default_rng(seed), coefficients=(2e-4, 1e-4), wave=PeriodicTerm((0,), (13.37,)))
        ((_, order, order_std, amplitude, amplitude_std),) = harmonics_of(
            identify_terms(terms_of("periodic", ARM, bare_of(data), data), bare_of(data), data)
        )
        off.append([(order - 13.37) / order_std, (amplitude - 5**0.5 * 1e-4) / amplitude_std])
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(off), axis=0)), 1.0, atol=0.4)


@pytest.mark.parametrize("seeds", [range(2), pytest.param(range(2, 22), marks=pytest.mark.slow)], ids=["two", "twenty"])
def test_an_arm_without_harmonics_gets_none(seeds):
    found = [tracked(np.random.default_rng(seed), rows=160, coefficients=[0.0] * 6) for seed in seeds]
    taken = [choose_terms(ARM, bare_of(data), data)[0] for data in found]
    assert taken.count("none") >= 0.9 * len(taken)
    assert terms_of("periodic", ARM, bare_of(found[0]), found[0]) == ()


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize("seed", range(4))
def test_the_pursuit_takes_what_explains_most_each_time(seed, size):
    """As a search by least squares of every candidate in turn finds; sines and cosines may be much alike."""
    rng = np.random.default_rng(seed)
    base, pairs = rng.normal(size=(300, 5)), rng.normal(size=(300, 12, 2))
    pairs += 0.7 * pairs[:, [3]] + base[:, [1], None]
    pairs[..., 1] += rng.uniform(-2, 2, 12) * pairs[..., 0]
    pairs *= 10.0 ** rng.uniform(-1, 1, (12, 2))
    base[:, 4] = base[:, 2] - base[:, 3]  # one that says nothing new
    right = base @ rng.normal(size=5) + pairs.reshape(300, -1) @ (rng.normal(size=24) * rng.integers(0, 2, 24))
    right = size * (right + 0.3 * rng.normal(size=300))
    columns = np.concatenate([base, pairs.reshape(300, -1)], axis=1)
    candidates = 5 + np.arange(24).reshape(12, 2)
    taken = pursued(columns.T @ columns, columns.T @ right, np.arange(5), candidates, 6)
    slow = []
    for _ in range(6):
        left = {}
        for number in set(range(12)) - set(slow):
            chosen = columns[:, np.r_[:5, candidates[[*slow, number]].ravel()]]
            left[number] = np.linalg.norm(right - chosen @ np.linalg.lstsq(chosen, right, rcond=None)[0])
        slow.append(min(left, key=left.get))
    assert taken == slow


@pytest.fixture(scope="module")
def equations(planted):
    data, bare = planted
    blocks = [data.select(held) for _, held in contiguous_folds(data.groups, same_poses(data.joints), 5)]
    return Linearised.of(bare, (PLANTED, every_order(ARM.nominal)), blocks)


def test_equations_without_a_block_are_those_of_the_other_rows_with_the_prior(planted, equations):
    data, bare = planted
    model = equations
    others = np.concatenate([np.arange(240)[:48], np.arange(240)[96:]])
    columns, left = model.equations(data.select(others))
    prior = np.diag(np.r_[np.zeros(len(model.fitted)), np.full(len(model.names) - len(model.fitted), bare.scatter)])
    places = np.r_[model.fitted, model.coefficients_of(0)]
    by_hand = np.linalg.lstsq(np.vstack([columns, prior])[:, places], np.r_[left, np.zeros(len(prior))], rcond=None)[0]
    found = solved(*equations.without(1), places)
    np.testing.assert_allclose(found[places], by_hand, rtol=1e-6, atol=1e-9)
    assert not np.delete(found, places).any()
    there, remains = model.equations(data.select(np.arange(48, 96)))
    assert left_of(equations.normal, 1, found) == pytest.approx(np.sum((remains - there @ found) ** 2), rel=1e-6)


def test_what_a_solution_misses_is_what_the_arm_misses_that_it_stands_for(planted, equations):
    data, _ = planted
    places = np.r_[equations.fitted, equations.coefficients_of(0)]
    found = solved(*equations.without(None), places)
    columns, left = equations.equations(data)
    linear = (left - columns @ found).reshape(-1, 3) * NOISE
    np.testing.assert_allclose(equations.misses(data, found), linear, atol=1e-6)


@pytest.mark.slow
def test_the_fewest_harmonics_within_three_per_cent_of_the_best_are_taken(equations):
    """Judged by hand, count by count."""
    model = equations
    candidates = model.coefficients_of(1).reshape(-1, 2)
    paths, whole = chosen_orders(equations, model.fitted, candidates)
    errors = []
    for count in range(31):
        assert 240 // ROWS_EACH == 30 < MOST
        left = 0.0
        for block in range(5):
            matrix, right = equations.without(block)
            path = candidates[pursued(matrix, right, model.fitted, candidates, count)].ravel()
            left += left_of(equations.normal, block, solved(matrix, right, np.r_[model.fitted, path]))
        errors.append(np.sqrt(left))
    wanted = min(count for count in range(31) if errors[count] <= (1 + WITHIN) * min(errors))
    assert len(whole) == 2 * wanted and all(len(path) == 2 * wanted for path in paths)


def test_harmonics_are_chosen_again_among_finer_orders_two_tenths_around_those_chosen(planted, monkeypatch):
    """By joint and order, as each choice is made here of its own equations."""
    data, bare = planted
    monkeypatch.setattr(term_choice, "refined", lambda wave, *_: wave)
    (found,) = terms_of("periodic", ARM, bare, data)
    blocks = [data.select(held) for _, held in contiguous_folds(data.groups, same_poses(data.joints), 5)]

    def taken(wave):
        model = Linearised.of(bare, (wave,), blocks)
        places = model.coefficients_of(0)
        _, whole = chosen_orders(model, model.fitted, places.reshape(-1, 2))
        return {(wave.joints[i], wave.orders[i]) for i in range(len(wave.orders)) if places[2 * i] in whole}

    coarse = taken(every_order(ARM.nominal))
    near = sorted({(joint, round(order + k / 10, 6)) for joint, order in coarse for k in range(-2, 3)})
    again = taken(PeriodicTerm(tuple(joint for joint, _ in near), tuple(order for _, order in near)))
    assert set(zip(found.joints, found.orders, strict=True)) == again and len(again) == len(found.orders) >= 3


def test_candidates_are_all_revolute_joints_and_half_orders_up_to_thirty(qiao):
    term = every_order(qiao.nominal)
    turning = [i for i, slides in enumerate(qiao.nominal.prismatic) if not slides]
    wanted = {(i, order / 2) for i in turning for order in range(2, int(2 * HIGHEST) + 1)}
    assert set(zip(term.joints, term.orders, strict=True)) == wanted and len(term.orders) == len(wanted)


SCORES = {"none": 1.0, "gravity": 0.8, "gravity+periodic": 0.6, "periodic": 0.61, "thermal": 0.5}


@pytest.mark.parametrize(
    ("changed", "wanted"),
    [
        ({}, "periodic"),
        ({"periodic": 0.63}, "gravity+periodic"),
        ({"gravity+periodic": 0.78}, "gravity"),
        ({"gravity": 0.98, "periodic": 0.96}, "periodic"),
        ({"gravity": 0.98, "periodic": 0.98}, "none"),
    ],
    ids=["weight no longer wins", "weight still wins", "no harmonics", "harmonics alone", "nothing"],
)
def test_each_term_stays_only_if_it_wins_by_three_per_cent(planted, monkeypatch, changed, wanted):
    class Trial:
        names = ("gravity", "periodic")

        def score(self, names):
            return (SCORES | changed)["+".join(names) or "none"]

        def terms(self, names):
            return names

    monkeypatch.setattr(term_choice._Trial, "of", staticmethod(lambda *_: Trial()))
    found = choose_terms(ARM, planted[1], planted[0])
    assert found[0] == wanted and found[2] == tuple(wanted.replace("none", "").split("+") if found[2] else ())
    assert all((SCORES | changed)[name] == value for name, value in found[1].items())


def test_candidates_are_scored_on_blocks_as_by_a_fit_to_the_other_rows():
    """An arm whose third joint yields under the weight behind it; fits of geometry and weight, block by block."""
    up = (0.0, 0.0, 1.0)
    yielding = GravityTerm((2,), up)
    count = len(yielding.names(ARM.nominal))
    data = tracked(np.random.default_rng(3), coefficients=[2e-4] * count, wave=yielding)
    bare = bare_of(data)
    found = choose_terms(ARM, bare, data)
    weight = (GravityTerm(tuple(range(6)), up),)
    missed = {"none": [], "gravity": []}
    for train, held in contiguous_folds(data.groups, same_poses(data.joints), 5):
        rows, block = data.select(train), data.select(held)
        missed["none"].append(block.difference(bare_of(rows).geometry))
        fitted = identify_terms(weight, bare, rows).arm_model
        missed["gravity"].append(block.position - fitted.pose(block.joints).position)
    rms = {name: np.sqrt(np.mean(np.sum(np.vstack(parts) ** 2, axis=1))) for name, parts in missed.items()}
    assert rms["gravity"] < 0.5 * rms["none"]
    assert found[1]["none"] == pytest.approx(rms["none"], rel=0.02)
    # The fit leaves out what it can hardly tell of the weight; the score does not, and comes nearer to the noise.
    assert 0.9 * np.sqrt(3.0) * NOISE < found[1]["gravity"] < rms["gravity"]


def test_unknown_terms_are_refused(planted):
    with pytest.raises(InputError, match="unknown terms 'magic'; give auto, none, or some of compliance"):
        terms_of("gravity+magic", ARM, planted[1], planted[0])
    with pytest.raises(InputError, match=r"terms 'periodic\+periodic' name periodic more than once; name each"):
        terms_of("periodic+periodic", ARM, planted[1], planted[0])


def test_weight_and_harmonics_are_named_together(planted):
    data, bare = planted
    terms = terms_of("gravity+periodic", ARM, bare, data)
    assert [kind_of_term(term) for term in terms] == ["gravity", "periodic"]


def test_a_saved_calibration_holds_its_harmonics_and_corrects_them(planted, tmp_path):
    """What it commands reaches the nominal pose by its own prediction, one target at a time or many."""
    data, _ = planted
    result = calibrate(ARM, data, choices=Choices(residual="none"))
    again = Calibration.load(result.save(tmp_path / "ur5"), ARM)
    (term,) = again.model.terms
    assert again.record["harmonics"] == result.as_dict()["harmonics"]
    shown = {(row["joint"] - 1, row["order"], row["order_std"]) for row in again.record["harmonics"]["found"]}
    assert shown == set(zip(term.joints, term.orders, term.order_std, strict=True))
    for i, (joint, order) in enumerate(zip(term.joints, term.orders, strict=True)):
        rows = again.record["harmonics"]["found"]
        (row,) = (row for row in rows if (row["joint"] - 1, row["order"]) == (joint, order))
        assert np.radians(row["amplitude"]) == pytest.approx(np.hypot(*again.model.coefficients[2 * i : 2 * i + 2]))
    compensator = again.compensator()
    commands = compensator(data.joints)
    np.testing.assert_allclose([compensator(target) for target in data.joints[:5]], commands[:5], atol=1e-9)
    wanted = forward(again.nominal, data.joints).position
    bare = replace(again, model=ArmModel(again.identified))
    left, without = (np.linalg.norm(each.predict(commands).position - wanted, axis=1) for each in (again, bare))
    assert np.quantile(left, 0.95) < 5e-6 and np.median(without) > 1e-4  # some poses are near a singular one


def test_an_orders_column_is_the_difference_of_what_its_harmonic_does():
    joints = np.random.default_rng(0).uniform(-2, 2, (20, 6))
    sines, cosines, step = (2e-4, -1e-4), (1e-4, 3e-4), 1e-5
    amplitudes = np.ravel(np.column_stack([sines, cosines]))
    columns = OrderTerm(PeriodicTerm((0, 2), (13.4, 4.7)), sines, cosines).columns(ARM.nominal, joints, Conditions())
    for k in range(2):
        up, down = (
            PeriodicTerm((0, 2), tuple(np.array([13.4, 4.7]) + side * step * (np.arange(2) == k))).columns(
                ARM.nominal, joints, Conditions()
            )
            @ amplitudes
            for side in (1, -1)
        )
        np.testing.assert_allclose(columns[..., k], (up - down) / (2 * step), atol=1e-9)


def test_terms_are_chosen_on_fifteen_hundred_rows_of_the_whole_at_most(monkeypatch):
    data, seen = tracked(np.random.default_rng(0), rows=1502), []
    bare = bare_of(data.select(np.arange(60)))
    monkeypatch.setattr(term_choice.Linearised, "of", staticmethod(lambda bare, terms, blocks: seen.extend(blocks)))
    term_choice._Trial.of(ARM, bare, data, ())
    joints = np.concatenate([block.joints for block in seen])
    assert len(joints) == 1500 and (joints[[0, -1]] == data.joints[[0, -1]]).all()


@pytest.mark.parametrize(("payload", "varied"), [(None, False), ([0.5] * 40, False), ([0.0, 0.5] * 20, True)])
def test_a_payload_takes_part_in_the_weight_where_it_varies(payload, varied):
    data = tracked(np.random.default_rng(0), rows=40)
    data = replace(data, conditions=Conditions(payload=None if payload is None else np.array(payload)))
    assert plain_term("gravity", ARM, data).payload == varied


def test_of_a_pair_that_says_one_thing_twice_no_more_is_expected_than_that():
    """A sine and a cosine that are one column explain what it explains, and what says more is taken first."""
    rng = np.random.default_rng(0)
    one, other = rng.normal(size=(200, 2)).T
    pairs = np.stack([np.stack([one, one], 1), np.stack([other, rng.normal(size=200)], 1)], 1)
    columns = np.concatenate([np.ones((200, 1)), pairs.reshape(200, -1)], axis=1)
    right = columns.T @ (0.5 * one + other)
    prior = np.diag([0.0, 1e-6, 1e-6, 1e-6, 1e-6])
    candidates = 1 + np.arange(4).reshape(2, 2)
    assert pursued(columns.T @ columns + prior, right, np.arange(1), candidates, 2) == [1, 0]


@pytest.mark.parametrize(("grid", "ended"), [(13.3, 13.348), (13.45, 13.402), (13.4, None)])
def test_orders_are_refined_to_their_optimum_but_not_beyond_their_place_on_the_grid(planted, grid, ended):
    """With uncertainties as those of least squares, from the Jacobian written out and priors as further rows."""
    data, bare = planted
    others = (PeriodicTerm((1, 2), (26.1, 4.72)),)
    found = refined(PeriodicTerm((0,), (grid,)), others, bare, data)
    assert found.orders[0] == pytest.approx(ended) if ended else abs(found.orders[0] - 13.37) < 4 * found.order_std[0]

    def stacked(*more):
        linear = Linearised.of(bare, (*others, found, *more))
        columns, left = linear.equations(data)
        rows = np.vstack([columns, np.diag(np.sqrt(linear.ridge))])
        solution = np.linalg.lstsq(rows, np.r_[left, np.zeros(len(linear.ridge))], rcond=None)[0]
        return linear, rows, solution, left - columns @ solution

    linear, _, solution, _ = stacked()
    sine, cosine = (solution * linear.scale)[linear.coefficients_of(1)]
    linear, rows, solution, remains = stacked(OrderTerm(found, (sine,), (cosine,)))
    (place,) = linear.coefficients_of(2)
    if ended is None:
        assert abs(solution[place] * linear.scale[place]) < 0.02 * found.order_std[0]
    variance = np.linalg.inv(rows.T @ rows)[place, place] * (remains @ remains) / (len(remains) - rows.shape[1])
    assert found.order_std[0] == pytest.approx(np.sqrt(variance) * linear.scale[place], rel=0.02)


@pytest.mark.parametrize("other", ["gravity", "thermal"])
def test_terms_are_the_same_in_whatever_order_they_are_named(planted, other):
    """Automatic choice too tries thermal expansion after the harmonics."""
    warm = replace(planted[0], conditions=Conditions(temperature=np.linspace(0.0, 20.0, len(planted[0]))))
    first, second = (terms_of(names, ARM, planted[1], warm) for names in (f"{other}+periodic", f"periodic+{other}"))
    assert [kind_of_term(term) for term in second] == ["periodic", other]
    assert second[0].joints == first[1].joints
    np.testing.assert_allclose(second[0].orders, first[1].orders, atol=1e-6)


def test_harmonics_and_expansion_are_chosen_together(planted):
    rng, rows = np.random.default_rng(1), planted[0]
    rows = replace(rows, conditions=Conditions(temperature=rng.uniform(0.0, 20.0, len(rows))))
    grown = ArmModel(planted[1].geometry, (ThermalTerm(),), np.array([3e-5]))
    rows = replace(rows, position=rows.position + grown.displacement(rows.joints, rows.conditions)[:, :3])
    name, _, terms = choose_terms(ARM, bare_of(rows), rows)
    assert name == "periodic+thermal" and [kind_of_term(term) for term in terms] == ["periodic", "thermal"]
