"""Traced formulas do, compiled, what NumPy does with arrays: to the bit, for any number of poses."""

import numpy as np
import pytest

from pickenv.arm.kinematics.tracing import DOUBLE, FLAG, SINGLE, SYMBOLS, WORD, Outputs, Trace, Untraceable, outside

pytest.importorskip("llvmlite")
from pickenv.arm.kinematics.machine_code import THOROUGH, Compiled

FORMULAS = {
    "arithmetic": lambda m, a, b, c: a + b * c - a / b + 0.1 - (2.0 - c) / 3.0 + (-a) * 1e-30,
    "never contracted": lambda m, a, b, c: (a * b + c) * (a * b - c) + a * b,
    "functions": lambda m, a, b, c: m.sin(a) + m.cos(a) * m.exp(-b * b) + m.atan2(a, b) + m.log10(1.0 + c * c),
    "functions of functions": lambda m, a, b, c: m.cos(m.sin(a) * 3.0) + m.log(2.0 + m.sin(m.cos(b) * c)),
    "roots and rounding": lambda m, a, b, c: m.sqrt(a * a) + m.round(7.0 * b) + m.abs(c),
    "held": lambda m, a, b, c: m.minimum(m.maximum(a, -0.5), 0.5) if m is np else m.clip(a, -0.5, 0.5),
    "chosen": lambda m, a, b, c: m.where((a < b) & (b <= c) | ~(a > 0.0), a, m.where(c >= 0.2, b, 7.0)),
}


def compiled(formula, count):
    trace = Trace()
    found = formula(SYMBOLS, *trace.inputs("given", 3))
    code = Compiled(trace, [Outputs("found", [found]), Outputs("rounded", [trace.single(found)], SINGLE)], count)

    def run(given):
        out, rounded = np.empty((1, given.shape[1])), np.empty((1, given.shape[1]), np.float32)
        code.run({"given": given, "found": out, "rounded": rounded}, given.shape[1])
        return out[0], rounded[0]

    return run


@pytest.mark.parametrize("name", FORMULAS)
@pytest.mark.parametrize("most", [1, THOROUGH], ids=["quickly made", "thoroughly made"])
def test_compiled_formulas_have_the_bits_of_numpy(name, most):
    run = compiled(FORMULAS[name], most)
    for count in (1, 3, 4, 70, 5001):
        given = np.random.default_rng(count).normal(size=(3, count)) * [[1.0], [3.0], [0.1]]
        expected = FORMULAS[name](np, *given)
        found, rounded = run(given)
        np.testing.assert_array_equal(found.view(np.uint64), expected.view(np.uint64))
        np.testing.assert_array_equal(rounded, expected.astype(np.float32))


def test_words_wrap_and_flags_are_kept():
    trace = Trace()
    (word,), (number,) = trace.inputs("words", 1, WORD), trace.inputs("numbers", 1)
    mixed = (word ^ (word >> 30)) * 0xBF58476D1CE4E5B9 + 0x9E3779B97F4A7C15
    share, below = (mixed >> 11).as_double() * 2.0**-53, number < 0.5
    late = SYMBOLS.where(below, SYMBOLS.sin(share), share)  # the flag waits for a function
    outputs = [Outputs("share", [share], DOUBLE), Outputs("below", [below], FLAG), Outputs("late", [late])]
    words, numbers = np.random.default_rng(0).integers(2**64, size=33, dtype=np.uint64), np.linspace(0, 1, 33)
    found = {"share": np.empty(33), "below": np.empty(33, bool), "late": np.empty(33)}
    Compiled(trace, outputs, 33).run({"words": words, "numbers": numbers} | found, 33)
    with np.errstate(over="ignore"):
        mixed = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9) + np.uint64(0x9E3779B97F4A7C15)
    expected = (mixed >> np.uint64(11)).astype(float) * 2.0**-53
    np.testing.assert_array_equal(found["share"], expected)
    np.testing.assert_array_equal(found["below"], numbers < 0.5)
    np.testing.assert_array_equal(found["late"], np.where(numbers < 0.5, np.sin(expected), expected))


def test_functions_of_whole_arrays_are_called_for_the_poses_at_hand():
    trace, own = Trace(), np.arange(3000.0)

    def fill(values, found, part):
        found[:] = values.sum(axis=0) * own[part], values[0]

    total, first = outside(fill, [2.0 * value for value in trace.inputs("given", 2)], 2)
    given, found = np.random.default_rng(0).normal(size=(2, 3000)), np.empty((1, 3000))
    Compiled(trace, [Outputs("found", [total + first])], 3000).run({"given": given, "found": found}, 3000)
    np.testing.assert_array_equal(found[0], (2.0 * given).sum(axis=0) * own + 2.0 * given[0])
    assert outside(fill, [1.0, np.ones(3)], 2) is None


def test_what_is_computed_twice_is_written_down_once():
    trace = Trace()
    a, b = trace.inputs("given", 2)
    one, other = SYMBOLS.sin(a + b) * 2.0, 2.0 * SYMBOLS.sin(b + a)
    assert one.number == other.number and (a - b).number != (b - a).number


@pytest.mark.parametrize("way", [bool, np.asarray, lambda value: value + "1" if value else 0])
def test_a_formula_that_asks_for_numbers_cannot_be_written_down(way):
    with pytest.raises(Untraceable):
        way(Trace().inputs("given", 1)[0])
