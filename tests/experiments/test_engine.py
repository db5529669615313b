"""The engine: equal rows on every backend, however often it was interrupted, and a folder that notices every damage."""

import os
import runpy
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.testing import assert_array_equal

from pickenv.base import InputError
from pickenv.experiments import Experiment, Rows, check_experiment, engine, keep, kept_rows, run

ARMS, METHODS = range(3), ("raw", "ls")


def measure(rng, arm, method):
    """Two fruit of an arm; a method halves its errors."""
    errors = rng.normal(10.0 + arm, 1.0, 2)
    return {
        "fruit": np.arange(2),
        "error_mm": errors / (2.0 if method == "ls" else 1.0),
        "pose": rng.normal(size=(2, 3)),
    }


def experiment(**changes):
    parts = {"name": "toy", "units": {"arm": ARMS}, "factors": {"method": METHODS}, "measure": measure}
    return Experiment(**{**parts, **changes})


def assert_same(one, other):
    assert list(one.columns) == list(other.columns)
    for name in one.columns:
        assert_array_equal(one[name], other[name])


def test_levels_of_a_factor_meet_the_same_draws_and_units_do_not():
    rows = run(experiment())
    raw, ls = rows.where(method="raw"), rows.where(method="ls")
    assert_array_equal(raw["error_mm"], 2.0 * ls["error_mm"])
    assert len(set(raw["error_mm"].tolist())) == len(raw)
    assert run(experiment(seed=1)).where(method="raw")["error_mm"][0] != raw["error_mm"][0]


def test_rows_say_their_levels_and_come_in_the_order_of_the_pieces():
    rows = run(experiment())
    assert rows.levels("method", "arm") == [(method, arm) for method in METHODS for arm in ARMS]
    assert rows.dicts()[0].keys() == {"method", "arm", "fruit", "error_mm", "pose"}
    assert rows.pandas().groupby("method")["error_mm"].count().to_dict() == {"raw": 6, "ls": 6}


def test_combinations_that_do_not_fit_are_left_out_and_change_no_other_number():
    some = run(experiment(fits=lambda method, arm: (method, arm) != ("raw", 0)))
    assert len(some) == 10
    assert_same(some.where(method="ls"), run(experiment()).where(method="ls"))


@pytest.mark.parametrize("workers", [pytest.param(1, marks=pytest.mark.slow), 2])
def test_no_process_and_no_folder_changes_a_number(workers, tmp_path):
    alone = run(experiment())
    assert_same(run(experiment(), backend="loky", workers=workers), alone)
    assert_same(run(experiment(), tmp_path, backend="loky", workers=workers), alone)
    assert_same(kept_rows(tmp_path), alone)


def test_what_is_kept_is_not_measured_again(tmp_path):
    asked = []

    def counting(rng, arm, method):
        asked.append((method, arm))
        return measure(rng, arm, method)

    files = keep(experiment(measure=counting), tmp_path)
    files[1].unlink()
    files[4].write_bytes(files[4].read_bytes()[:-9])
    with pytest.warns(UserWarning) as said:
        again = run(experiment(measure=counting), tmp_path)
    assert asked[6:] == [("raw", 1), ("ls", 1)]
    assert len(said) == 1 and str(files[4]) in str(said[0].message)
    assert_same(again, run(experiment()))


@pytest.mark.parametrize("change", [{"seed": 1}, {"inputs": (3.0,)}, {"name": "other"}])
def test_pieces_of_other_inputs_live_beside_one_another(change, tmp_path):
    first, second = keep(experiment(), tmp_path), keep(experiment(**change), tmp_path)
    assert not set(first) & set(second)
    assert len(check_experiment(tmp_path)) == 1 + len(first) + len(second)
    assert_same(kept_rows(tmp_path), run(experiment(**change)))


def test_another_code_makes_pieces_anew(tmp_path, monkeypatch):
    first = keep(experiment(), tmp_path)
    monkeypatch.setattr("pickenv.experiments.engine.code_fingerprint", lambda: "another")
    assert not set(first) & set(keep(experiment(), tmp_path))


def sometimes(rng, arm, method):
    """Nothing of the second arm's can be measured."""
    if arm == 1:
        raise InputError(f"arm {arm} does not move")
    return measure(rng, arm, method)


@pytest.mark.parametrize("backend", ["serial", "loky"])
@pytest.mark.parametrize("kept", [True, False])
def test_pieces_that_cannot_be_measured_have_no_rows_and_are_tried_again(backend, kept, tmp_path):
    folder, said = tmp_path if kept else None, []
    with pytest.raises(InputError, match="arm 1 does not move"):
        run(experiment(measure=sometimes), folder, backend=backend, workers=2)
    for _ in range(2):
        rows = run(
            experiment(measure=sometimes), folder, backend=backend, workers=2,
            refused=lambda levels, error: said.append((levels["method"], levels["arm"], str(error))),
        )  # fmt: skip
        assert_same(rows, run(experiment()).where(arm=(0, 2)))
    assert sorted(said[:2]) == sorted(said[2:]) == [(method, 1, "arm 1 does not move") for method in ("ls", "raw")]
    assert not kept or all(reason is None for _, reason in check_experiment(tmp_path))
    none = run(experiment(measure=sometimes, units={"arm": (1,)}), folder, refused=lambda *_: None)
    assert len(none) == len(none.where(arm=1)) == 0 and none.levels("arm") == []


def test_inputs_of_a_level_change_its_own_pieces_alone(tmp_path):
    def inputs(changed):
        return lambda arm, method: (method if method == changed else "as ever",)

    first, second = (keep(experiment(inputs=inputs(changed)), tmp_path) for changed in ("", "ls"))
    assert first[:3] == second[:3] and not set(first[3:]) & set(second[3:])


def longer(rng, arm, method):
    """As many steps as the arm's number; one method knows a word more."""
    return {"way_mm": np.full((2, arm), float(arm))} | ({"word": np.array(["some", "more"])} if method == "ls" else {})


def test_shorter_arrays_and_missing_columns_are_filled():
    rows = run(experiment(measure=longer))
    assert rows["way_mm"].shape == (12, 2)
    assert np.isfinite(rows["way_mm"]).sum(axis=1).tolist() == [0, 0, 1, 1, 2, 2] * 2
    assert rows["word"].tolist() == [""] * 6 + ["some", "more"] * 3


def damaged(path, how):
    content = path.read_bytes()
    if how == "removed":
        path.unlink()
    elif how == "cut":
        path.write_bytes(content[:-1])
    elif how == "changed":
        path.write_bytes(content[:50] + bytes([content[50] ^ 1]) + content[51:])
    elif how == "exchanged":
        others = [each for each in path.parent.glob("*.parquet") if each != path]
        path.write_bytes(others[0].read_bytes())
    else:
        (path.parent / f"stray{path.suffix}").write_bytes(content)


@pytest.mark.parametrize("how", ["removed", "cut", "changed", "exchanged", "added"])
@pytest.mark.parametrize("which", ["piece", "record"])
def test_every_damage_of_a_folder_is_noticed(which, how, tmp_path):
    files = keep(experiment(), tmp_path)
    assert all(reason is None for _, reason in check_experiment(tmp_path))
    damaged(tmp_path / engine.RECORD if which == "record" else files[2], how)
    assert any(reason is not None for _, reason in check_experiment(tmp_path))


def test_a_damaged_record_is_made_anew(tmp_path):
    keep(experiment(), tmp_path)
    damaged(tmp_path / engine.RECORD, "changed")
    with pytest.warns(UserWarning) as said:
        assert_same(run(experiment(), tmp_path), run(experiment()))
    assert [str(warning.message) for warning in said] == [f"{tmp_path / engine.RECORD} is damaged and is made anew"]
    assert all(reason is None for _, reason in check_experiment(tmp_path))


def test_what_an_interrupted_write_left_behind_is_noticed_and_disturbs_nobody(tmp_path):
    keep(experiment(), tmp_path)
    rest = tmp_path / ".toy_raw_0-abc.parquet"
    rest.write_bytes(b"PAR1")
    assert "interrupted write; delete it" in dict(check_experiment(tmp_path))[rest]
    assert_same(run(experiment(), tmp_path), run(experiment()))


KILLED = """
    import sys, time
    import numpy as np
    from pickenv.experiments import Experiment, keep

    def measure(rng, arm):
        time.sleep(0.05)
        return {"error_mm": rng.normal(size=4)}

    keep(Experiment("slow", {"arm": range(12)}, {}, measure), sys.argv[1])
"""


@pytest.mark.slow
def test_an_experiment_killed_at_any_moment_goes_on_and_ends_equal(tmp_path, monkeypatch):
    script = tmp_path / "slow_arms.py"
    script.write_text(textwrap.dedent(KILLED), encoding="utf-8")
    folder, whole = tmp_path / "killed", tmp_path / "whole"
    process = subprocess.Popen([sys.executable, str(script), str(folder)])
    while len(list(folder.glob("*.parquet"))) < 3:
        assert process.poll() is None
    process.send_signal(signal.SIGKILL)
    process.wait()
    begun = len(list(folder.glob("slow*.parquet")))
    assert begun < 12
    for place in (folder, whole):
        monkeypatch.setattr(sys, "argv", [str(script), str(place)])
        runpy.run_path(str(script), run_name="__main__")
    assert_same(kept_rows(folder), kept_rows(whole))


def dying(marks, number):
    """Its process dies once for each number."""
    mark = Path(marks) / str(number)
    if not mark.exists():
        mark.touch()
        os._exit(1)
    return number


@pytest.mark.slow
def test_pieces_of_a_process_that_dies_are_tried_again(tmp_path):
    from functools import partial

    from pickenv.experiments import spread

    done = dict(spread(partial(dying, str(tmp_path)), range(2), "loky", 2))
    assert done == {0: 0, 1: 1}


GROWN = []


def growing(rng, arm):
    """From its second piece on a process holds more, as one that has loaded torch, and takes its time."""
    if arm > 1 and not GROWN:
        GROWN.append(np.ones(45_000_000))
    time.sleep(1.2)
    return {"error_mm": rng.normal(size=2)}


@pytest.mark.slow
def test_a_process_that_grows_after_its_first_piece_is_not_ended_for_it():
    """joblib took that for a leak, ended the process and waited for it for ever."""
    grown = experiment(units={"arm": range(8)}, factors={}, measure=growing)
    assert len(run(grown, backend="loky", workers=2)) == 16


def test_an_unknown_backend_is_refused_in_a_sentence():
    with pytest.raises(InputError, match="unknown backend 'ray'; give one of serial, loky"):
        run(experiment(), backend="ray")


names = st.sampled_from(["error_mm", "arm", "label"])
shapes = st.sampled_from([(), (3,), (2, 3)])


@given(count=st.integers(1, 5), shape=shapes, seed=st.integers(0, 9))
@settings(max_examples=20, deadline=None)
def test_rows_of_arrays_survive_their_file_to_the_bit(count, shape, seed):
    rng = np.random.default_rng(seed)
    rows = Rows.of(
        {
            "number": rng.normal(size=(count, *shape)),
            "whole": rng.integers(9, size=count),
            "text": np.array([f"ü {i}" for i in range(count)]),
            "flag": rng.random(count) < 0.5,
        }
    )
    assert_same(Rows.of_arrow(rows.arrow()), rows)


def test_columns_of_different_lengths_are_refused():
    with pytest.raises(ValueError, match="differ in length"):
        Rows.of({"a": [1], "b": [1, 2]})
