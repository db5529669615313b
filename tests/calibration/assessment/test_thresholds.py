"""Each sentence, caution and failure of a verdict, from both sides of the threshold that its docstring names."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from pickenv.arm import forward, parameter_jacobian
from pickenv.calibration import (
    Measurements,
    ThermalTerm,
    frames_model,
    identify,
    link_model,
    prior_model,
    random_joints,
)
from pickenv.calibration.assessment.instrument import base_frame_error, said_against
from pickenv.calibration.assessment.quality import (
    Completeness,
    RegionError,
    Workspace,
    grade_quality,
)
from pickenv.calibration.assessment.screen import Block, figure, is_number, unit_of
from pickenv.calibration.identification.solve import solve
from pickenv.calibration.model.noise_and_priors import FRAMES, MADE, ZEROS

JUST = 1e-9


@pytest.fixture(scope="module")
def found(qiao, exact):
    """An identification with spare equations, from measurements without noise."""
    return identify(link_model(qiao.nominal), qiao.nominal, exact(qiao.true, 40))


@pytest.fixture(scope="module")
def expected(qiao):
    """A fit of the drawing's own rows with priors, whose parameters then lie where a test wants them.

    ``expected(known=True, std=1e-9, **moved)``: some parameters moved by so many standard deviations of their class,
    each known to ``std`` of these, and the frames known or fitted.
    """
    joints = random_joints(qiao.nominal, 40, np.random.default_rng(5))
    rows = Measurements(joints, *forward(qiao.nominal, joints), prismatic=qiao.nominal.prismatic)
    fits = {known: solve(prior_model(qiao.name, qiao.nominal, known=known, scale=1.0), rows) for known in (True, False)}

    def place(known=True, std=1e-9, **moved):
        solution = fits[known]
        prior = solution.prior
        width = dict(zip(prior.parameters.names, prior.std, strict=True))
        names = prior.start.parameter_names
        change = np.array([moved.get(name, 0.0) * width.get(name, 0.0) for name in names])
        spread = np.array([std * width[name] for name in solution.identifiability.kept_names])
        model = prior.start.displaced(change)
        return replace(solution, arm_model=model, covariance=np.diag(spread**2))

    return place


def errors(size, count=40, seed=0):
    """Position errors ``(count, 3)`` in all directions whose root mean square is ``size``, m."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return size * vectors / np.sqrt(np.mean(np.sum(vectors**2, axis=1)))


def cautions(found, trained=1e-4, after=1e-4, **more):
    """What is said by way of caution of an arm whose error falls from 2 mm to ``after``."""
    quality = grade_quality(found, errors(trained), errors(2e-3), errors(after), **more)
    assert quality.grade == ("with care" if quality.findings[0][0] == "caution" else "good")
    return [text for weight, text in quality.findings if weight == "caution"]


@pytest.mark.parametrize(("ratio", "noise"), [(2.0, "stated noise"), (0.5, "assumed noise"), (7.0, "stated noise")])
def test_the_ratio_in_the_sentence_is_of_sizes_and_not_of_squares(ratio, noise):
    freedom = 100
    test = Completeness(ratio**2 * freedom, freedom, 1e-9, 1.0, noise)
    assert (
        f"what remains is {ratio:.2g} times the {noise} (reduced chi^2 {ratio**2:.3g}, 100 degrees" in test.sentence()
    )


def test_the_chi_square_test_rejects_below_5_percent_and_warns_below_two_and_a_half():
    def said(p_value, p_small=1.0, freedom=10):
        return Completeness(10.0, freedom, p_value, p_small).sentence()

    assert "is complete for it" in said(0.05) and "p = 0.05)" in said(0.05)
    assert "effects beyond the model" in said(0.05 - JUST)
    assert "is complete for it" in said(0.9, 0.025)
    assert "probably too large" in said(0.9, 0.025 - JUST)
    assert said(0.9, freedom=0) == "there are no spare equations, so the model cannot be tested"
    assert "1 degrees of freedom" in said(0.9, freedom=1)
    assert np.isnan(Completeness(10.0, 0, 1.0, 0.0).reduced) and Completeness(10.0, 1, 1.0, 0.0).reduced == 10.0


def test_held_out_errors_above_one_and_a_half_times_the_training_errors_are_cautioned(found):
    assert cautions(found, 1e-4, 1.49e-4) == []
    (said,) = cautions(found, 1e-4, 1.51e-4)
    assert "held-out errors (0.1510 mm RMS) are 1.5 times as large as on the training rows" in said
    assert cautions(found, 1e-4, 9e-4, parametric=errors(1e-4)) == []
    assert len(cautions(found, 1e-4, 1e-4, parametric=errors(9e-4))) == 1


def test_fewer_spare_equations_than_parameters_are_cautioned(found):
    """Without priors: a prior is a statement as good as a row."""
    rank = found.identifiability.rank
    assert cautions(replace(found, degrees_of_freedom=rank)) == []
    (said,) = cautions(replace(found, degrees_of_freedom=rank - 1))
    assert f"{rank - 1} spare equations for {rank} parameters are few" in said


def test_priors_need_no_spare_equations(expected):
    assert cautions(replace(expected(), degrees_of_freedom=1)) == []


def failures(found, before, after):
    return [text for weight, text in grade_quality(found, errors(1e-4), before, after).findings if weight == "fail"]


def test_two_held_out_rows_judge_nothing_and_three_do(found):
    assert ["only 2 rows were held out" in text for text in failures(found, errors(1e-3, 2), errors(1e-4, 2))] == [True]
    assert ["only 1 row was held out" in text for text in failures(found, errors(1e-3, 1), errors(1e-4, 1))] == [True]
    same = np.repeat([[1e-3, 0.0, 0.0]], 3, axis=0)
    assert failures(found, same, 0.1 * same) == []


def test_rows_that_judge_nothing_are_not_asked_whether_the_arm_is_better(found):
    """Nor are rows of which nobody knows how the nominal arm misses them."""
    same = np.repeat([[1e-3, 0.0, 0.0]], 40, axis=0)
    assert len(failures(found, same[:2], same[:2])) == len(failures(found, None, same[:2])) == 1
    assert failures(found, None, same) == []


def test_an_arm_that_is_no_better_is_not_to_be_used(found):
    same = np.repeat([[1e-3, 0.0, 0.0]], 40, axis=0)
    (said,) = failures(found, same, same)
    assert "the calibrated arm (1.000 mm RMS) is no better than the nominal one (1.000 mm RMS)" in said
    assert failures(found, same, 0.999 * same) == []  # each pose gains equally: no chance


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("blocks", [None, np.repeat(np.arange(5), 8)])
@pytest.mark.parametrize("factor", [0.0, 0.5, 0.999])
def test_gains_that_differ_by_roundings_are_no_chance(found, factor, blocks):
    """All errors are equally long, in directions of their own."""
    directions = np.random.default_rng(0).standard_normal((40, 3))
    before = np.zeros((40, 6))
    before[:, :3] = 1e-3 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    assert np.ptp(np.linalg.norm(before[:, :3], axis=1)) > 0
    told = grade_quality(found, errors(1e-4), before, factor * before, blocks=blocks)
    assert [text for weight, text in told.findings if weight == "fail"] == []


def test_a_gain_counts_where_a_paired_t_test_says_so(found):
    """SciPy's referee on the sizes of the errors; gains on both sides of its threshold of 5 %."""
    told = []
    for seed in range(20):
        before, after = errors(1e-3, 30, seed), errors(0.85e-3, 30, seed + 50)
        p = stats.ttest_rel(*[np.linalg.norm(part, axis=1) for part in (before, after)], alternative="greater").pvalue
        told.append(failures(found, before, after) == [])
        assert told[-1] == (p <= 0.05)
    assert 3 < sum(told) < 17


def test_a_good_verdict_states_the_root_mean_squares_of_positions_in_mm(found):
    before = np.hstack([np.repeat([[1e-3, 0, 0], [0, 3e-3, 0]], 20, axis=0), np.full((40, 3), 9.0)])
    quality = grade_quality(found, errors(1e-4), before, errors(1e-4))
    rms = np.sqrt((1.0 + 9.0) / 2)
    assert quality.reason == f"on 40 held-out rows the error falls from {rms:#.4g} to 0.1000 mm RMS"


def cause(found, before, after, parametric=None):
    """Why an arm whose errors are ``before`` mm and ``after`` mm is not to be used."""
    more = {} if parametric is None else {"parametric": errors(parametric)}
    quality = grade_quality(found, errors(1e-4), errors(before), errors(after), **more)
    assert quality.grade == "do not use" and quality.reason == quality.findings[0][1]
    return quality.reason


@pytest.mark.parametrize(
    ("after", "said"), [(1.19e-3, "as good as this instrument can tell"), (1.21e-3, "another arm")]
)
def test_errors_that_grow_by_a_fifth_are_of_another_arm_and_smaller_ones_of_a_good_one(found, after, said):
    """The remedies differ: to keep the drawing, or to look after the rows."""
    text = cause(found, 1e-3, after)
    assert said in text and ("check which rows belong together" in text) == (said == "another arm")
    assert "units" not in text


def test_rows_are_too_few_below_two_spare_equations_for_each_parameter_told(found):
    spent = found.spent
    assert spent == pytest.approx(found.identifiability.rank)  # without priors the rows tell every one
    enough, few = (replace(found, degrees_of_freedom=int(np.ceil(2 * spent)) - less) for less in (0, 1))
    assert "measure more" in cause(few, 1e-3, 2e-3) and "another arm" in cause(enough, 1e-3, 2e-3)


def test_what_was_learnt_is_named_where_the_arm_without_it_is_better_than_the_drawing(found):
    assert "give `residual='none'`" in cause(found, 1e-3, 1.001e-3, parametric=0.999e-3)
    assert "give `residual='none'`" not in cause(found, 1e-3, 1.001e-3, parametric=1.001e-3)


def test_terms_are_named_where_the_arm_with_them_is_worse_than_the_drawing(found):
    with_term = replace(found, arm_model=replace(found.arm_model, terms=(ThermalTerm(),), coefficients=np.zeros(1)))
    assert "give `terms='none'`" in cause(with_term, 1e-3, 1.5e-3)
    assert "give `terms='none'`" not in cause(found, 1e-3, 1.5e-3)
    assert "give `residual='none'`" in cause(with_term, 1e-3, 1.5e-3, parametric=0.5e-3)


def against(solution):
    """What stands against a solution, whose rows leave nothing of their own."""
    nothing = SimpleNamespace(joints=np.zeros((0, 6)))
    return [text for weight, text in said_against(solution, nothing) if weight == "caution"]


@pytest.mark.parametrize("name", ["a1", "alpha3", "d4"])
def test_a_link_farther_off_than_eight_deviations_of_its_class_is_of_another_arm(expected, name):
    """Two of its own standard deviations are taken off first: what is hardly known contradicts nothing."""
    assert against(expected(known=False, **{name: 7.99})) == []
    (said,) = against(expected(known=False, **{name: -8.01}))
    assert said.startswith(f"{name} lies -") and (" deg from" if name.startswith("alpha") else " mm from") in said
    assert "8 times what parts of tolerance class cobot differ by" in said and "`tolerances`" in said
    assert against(expected(known=False, std=1.0, **{name: 9.99})) == []
    assert len(against(expected(known=False, std=1.0, **{name: 10.01}))) == 1


@pytest.mark.parametrize("frame", ["base", "tool"])
def test_a_known_frame_that_parts_of_the_class_do_not_reach_is_not_known(expected, frame):
    """It is named before the links, which take part of it; a frame that is fitted may lie anywhere."""
    assert against(expected(**{f"{frame}_x": 3.0})) == []
    said = against(expected(**{f"{frame}_x": 300.0, "a1": 20.0}))
    assert any(text.startswith(f"the {frame} is said to be known, but by these rows it is off by ") for text in said)
    assert all("`frames='fitted'`" in text for text in said)
    assert against(expected(known=False, **{f"{frame}_x": 50.0})) == []


def test_zeros_of_joints_may_lie_far_off(expected):
    """A joint is zeroed by hand: its zero says nothing of which arm it is."""
    solution = expected(known=False)
    zeros = [n for n, g in zip(solution.prior.parameters.names, solution.prior.group, strict=True) if g == ZEROS]
    assert len(zeros) == 6 and set(solution.prior.group) == {FRAMES, *MADE}
    assert against(expected(known=False, **dict.fromkeys(zeros, 100.0))) == []


def test_fits_without_priors_contradict_none(qiao, found, expected):
    free = replace(expected(a1=50.0), prior=prior_model(qiao.name, qiao.nominal, known=True, fit="full"))
    assert against(found) == against(free) == []


def region(narrowed=0.9, better=1.0):
    """Errors over a region whose drawing is off by 2 mm, as was expected."""
    left = 2e-3 * (1.0 - narrowed)
    return RegionError("the joint limits", left, (0.9 * left, 1.1 * left), 2e-3, (1e-3, 3e-3), 2e-3, better)


def test_a_workspace_that_the_rows_tell_by_less_than_a_fifth_is_cautioned(found):
    here = region()
    assert Workspace(here, region(0.2001)).reservation is None
    (said,) = cautions(found, workspace=Workspace(here, region(0.1999)))
    assert (
        "over the joint limits the rows tell hardly more than the drawing (1.600 mm expected, 2.000 mm before" in said
    )
    assert "`pickenv plan-poses`" in said and said == Workspace(here, region(0.1999)).reservation
    assert "move J2, J5 further, or" in Workspace(here, region(0.1999), ("J2", "J5")).reservation
    assert cautions(found, workspace=Workspace(region(0.0, 0.0), here)) == []  # where rows are is no matter


def test_a_gain_that_nineteen_of_twenty_arms_do_not_have_is_cautioned(found):
    assert Workspace(region(), region(0.5, 0.95)).reservation is None
    (said,) = cautions(found, workspace=Workspace(region(), region(0.5, 0.9475)))
    assert "(1.000 mm expected) is better than the drawing (2.000 mm) for 95 % of the arms that the rows allow" in said


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (None, "unknown"),
        (np.nan, "unknown"),
        (0.0, "0.000"),
        (1e-3, "0.001000"),
        (9.99e-4, "9.990e-04"),
        (-0.12345, "-0.1235"),
        (9999.4, "9999"),
        (1e4, "10000"),
        (12345.6, "12346"),
        (9.99e8, "999000000"),
        (1e9, "1.000e+09"),
    ],
)
def test_screens_show_four_significant_digits(value, shown):
    assert figure(value) == shown


def test_numbers_stand_to_the_right_and_words_to_the_left():
    block = Block("Errors", ("axis", "mm"), (("x", "1.5"), ("yaw", "-12.25")), "of rows")
    assert block.text().splitlines() == ["Errors: of rows", "  axis      mm", "  x        1.5", "  yaw   -12.25"]
    plain = Block("Facts", (), (("1", "one"), ("20", "twenty")))
    assert plain.text().splitlines() == ["Facts", "  1   one", "  20  twenty"]
    assert [is_number(cell) for cell in ("+1", "-2", "3", "9 mm", "x1", "")] == [True, True, True, True, False, False]


def test_units_of_screens():
    geometric = ("theta1", "a1", "base_rx", "tool_x")
    assert [unit_of(name, geometric) for name in geometric] == [
        ("deg", pytest.approx(180 / np.pi)),
        ("mm", 1e3),
        ("deg", pytest.approx(180 / np.pi)),
        ("mm", 1e3),
    ]
    assert [unit_of(n, geometric) for n in ("reflector_x", "anchor_y", "socket_z", "gravity_2")] == [
        ("mm", 1e3)
    ] * 3 + [("SI", 1.0)]


def test_the_interval_of_the_base_frame_is_that_of_drawn_bases_and_tools(qiao):
    """Anew with other draws: sizes even in their logarithm from 0.2 to 1 mm and mrad per axis."""
    nominal, joints = qiao.nominal, random_joints(qiao.nominal, 12, np.random.default_rng(3))
    fitted = nominal.displaced(1e-4 * np.ones(len(nominal.parameter_names)))
    left = np.full((12, 6), 3e-4)
    found = base_frame_error(nominal, fitted, joints, left)
    rng, model = np.random.default_rng(77), frames_model(nominal)
    size = 10 ** rng.uniform(np.log10(0.2e-3), np.log10(1e-3), (6000, 1))
    shift = np.einsum(
        "nip,dp->dni", parameter_jacobian(nominal, joints)[:, :3, model.columns], size * rng.normal(size=(6000, 12))
    )
    means = np.linalg.norm(shift + left[:, :3], axis=2).mean(axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    assert found.low == pytest.approx(low, rel=0.1) and found.high == pytest.approx(high, rel=0.12)
    apart = forward(nominal, joints).position - forward(fitted, joints).position
    assert found.moved == pytest.approx(np.mean(np.linalg.norm(apart, axis=1)))
    assert found.as_dict() == {
        "mean_ci95_mm": [found.low * 1e3, found.high * 1e3],
        "assumed_std_mm": [0.2, 1.0],
        "assumed_std_mrad": [0.2, 1.0],
        "frames_moved_mm": found.moved * 1e3,
    }


@pytest.mark.parametrize(("moved", "near"), [(0.0499, True), (0.05, False)])
def test_frames_that_hardly_moved_suggest_a_registered_instrument(qiao, moved, near):
    joints = random_joints(qiao.nominal, 5, np.random.default_rng(0))
    told = replace(
        base_frame_error(qiao.nominal, qiao.nominal, joints, np.zeros((5, 3))), moved=moved, low=1e-3, high=2e-3
    )
    assert "is 1.00 to 2.00 mm (95 % interval, if base and tool lie 0.2 to 1 mm and mrad" in told.sentences()
    assert ("the fitted frames move the tool by 49.9 mm" in told.sentences()) == near
