"""Traced formulas do, compiled, what NumPy does with arrays: up to roundings, for any number of poses."""

import math

import numpy as np
import pytest

from pickenv.arm.kinematics.forward import outside
from pickenv.arm.kinematics.machine_code import (
    DOUBLE,
    FLAG,
    SINGLE,
    SYMBOLS,
    THOROUGH,
    WORD,
    Compiled,
    Trace,
    Untraceable,
    cosine,
    sine,
)

pytest.importorskip("llvmlite")

EXACT = {
    "arithmetic": lambda m, a, b, c: a + b * c - a / b + 0.1 - (2.0 - c) / 3.0 + (-a) * 1e-30,
    "never contracted": lambda m, a, b, c: (a * b + c) * (a * b - c) + a * b,
    "roots and rounding": lambda m, a, b, c: m.sqrt(a * a) + m.round(7.0 * b) + m.abs(c),
    "held": lambda m, a, b, c: m.minimum(m.maximum(a, -0.5), 0.5) if m is np else m.clip(a, -0.5, 0.5),
    "chosen": lambda m, a, b, c: m.where((a < b) & (b <= c) | ~(a > 0.0), a, m.where(c >= 0.2, b, 7.0)),
}
ROUNDED = {
    "functions": lambda m, a, b, c: m.sin(a) + m.cos(a) * m.exp(-b * b) + m.atan2(a, b) + m.log10(1.0 + c * c),
    "functions of functions": lambda m, a, b, c: m.cos(m.sin(a) * 3.0) + m.log(2.0 + m.sin(m.cos(b) * c)),
    "functions of plain numbers": lambda m, a, b, c: a * m.sin(0.3) + b * m.cos(0.3) + c * m.exp(-0.3),
}


def compiled(formula, count):
    trace = Trace()
    found = formula(SYMBOLS, *trace.inputs("given", 3))
    code = Compiled(
        trace, trace.outputs("found", [found]) + trace.outputs("rounded", [trace.single(found)], SINGLE), count
    )

    def run(given):
        out, rounded = np.empty((1, given.shape[1])), np.empty((1, given.shape[1]), np.float32)
        code.bound({"given": given, "found": out, "rounded": rounded}, given.shape[1])()
        return out[0], rounded[0]

    return run


def given_to(count):
    return np.random.default_rng(count).normal(size=(3, count)) * [[1.0], [3.0], [0.1]]


@pytest.mark.parametrize("name", EXACT)
@pytest.mark.parametrize("most", [1, THOROUGH], ids=["quickly made", "thoroughly made"])
def test_compiled_operations_have_the_bits_of_numpy(name, most):
    run = compiled(EXACT[name], most)
    for count in (1, 3, 8, 70, 5001):
        given = given_to(count)
        expected = EXACT[name](np, *given)
        found, rounded = run(given)
        np.testing.assert_array_equal(found.view(np.uint64), expected.view(np.uint64))
        np.testing.assert_array_equal(rounded, expected.astype(np.float32))


@pytest.mark.parametrize("name", ROUNDED)
@pytest.mark.parametrize("most", [1, THOROUGH], ids=["quickly made", "thoroughly made"])
def test_compiled_functions_are_numpys_up_to_roundings(name, most):
    run = compiled(ROUNDED[name], most)
    for count in (1, 3, 8, 70, 5001):
        given = given_to(count)
        np.testing.assert_allclose(run(given)[0], ROUNDED[name](np, *given), rtol=0, atol=4e-15)


@pytest.mark.parametrize("most", [1e-8, 0.8, 7.0, 1000.0])
def test_sines_and_cosines_are_right_to_roundings(most):
    angles = np.random.default_rng(0).uniform(-most, most, 20_000)
    angles[:9] = np.arange(-4, 5) * math.pi / 2
    wide = angles.astype(np.longdouble)
    for found, expected in ((sine(np, angles), np.sin(wide)), (cosine(np, angles), np.cos(wide))):
        assert np.abs(found - expected).max() < 4.5e-16
    small = angles[np.abs(angles) < 1e-3]
    np.testing.assert_allclose(sine(np, small), np.sin(small), rtol=1e-15, atol=1e-19)


def test_words_wrap_and_flags_are_kept():
    trace = Trace()
    (word,), (number,) = trace.inputs("words", 1, WORD), trace.inputs("numbers", 1)
    mixed = (word ^ (word >> 30)) * 0xBF58476D1CE4E5B9 + 0x9E3779B97F4A7C15
    share, below = (mixed >> 11).as_double() * 2.0**-53, number < 0.5
    outputs = trace.outputs("share", [share], DOUBLE) + trace.outputs("below", [below], FLAG)
    words, numbers = np.random.default_rng(0).integers(2**64, size=33, dtype=np.uint64), np.linspace(0, 1, 33)
    found = {"share": np.empty(33), "below": np.empty(33, bool)}
    Compiled(trace, outputs, 33).bound({"words": words, "numbers": numbers} | found, 33)()
    with np.errstate(over="ignore"):
        mixed = (words ^ (words >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9) + np.uint64(0x9E3779B97F4A7C15)
    np.testing.assert_array_equal(found["share"], (mixed >> np.uint64(11)).astype(float) * 2.0**-53)
    np.testing.assert_array_equal(found["below"], numbers < 0.5)


def test_functions_of_whole_arrays_are_called_one_after_the_other():
    trace = Trace()

    def fill(values, found):
        found[:] = values.sum(axis=0), values[0]

    total, first = outside(SYMBOLS, fill, [2.0 * value for value in trace.inputs("given", 2)], 2)
    again, _ = outside(SYMBOLS, fill, [total + first, 1.0], 2)
    code = Compiled(trace, trace.outputs("found", [again * total]), 3000)
    for count in (3000, 7):
        given, found = np.random.default_rng(0).normal(size=(2, count)), np.empty((1, count))
        code.bound({"given": given, "found": found}, count)()
        doubled = 2.0 * given
        expected = (doubled.sum(axis=0) + doubled[0] + 1.0) * doubled.sum(axis=0)
        np.testing.assert_allclose(found[0], expected, rtol=1e-14, atol=1e-14)
    assert outside(SYMBOLS, fill, [1.0, np.ones(3)], 2) is None and outside(np, fill, [1.0], 2) is None


def test_what_is_computed_twice_is_written_down_once():
    trace = Trace()
    a, b = trace.inputs("given", 2)
    one, other = SYMBOLS.sin(a + b) * 2.0, 2.0 * SYMBOLS.sin(b + a)
    assert one.number == other.number and (a - b).number != (b - a).number


@pytest.mark.parametrize("way", [bool, np.asarray, lambda value: value + "1" if value else 0])
def test_a_formula_that_asks_for_numbers_cannot_be_written_down(way):
    with pytest.raises(Untraceable):
        way(Trace().inputs("given", 1)[0])
