"""Every cell of the benchmark's tables and every key of its JSON, recomputed from figures that are made up here."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
from pickenv.bench import spread_rows
from pickenv.bench.bench_tables import agreement_words, bench_json, bench_page
from pickenv.bench.gains import BEFORE, Gain
from pickenv.bench.real_sets import RealSet
from pickenv.bench.run_bench import Bench, BenchSettings
from pickenv.bench.spread_rows import NOTE, SpreadRow, spread_figures

from pickenv.calibration import error_statistics


def made_gains(rng, refused):
    found = []
    for model in BEFORE:
        before, measured, predicted = rng.uniform(0.2, 3.0), *rng.uniform(-0.1, 0.9, 2)
        found.append(
            Gain(
                model=model,
                nominal_mm=2.0 * before,
                before_mm=before,
                held_out_mm=before * (1.0 - measured),
                measured=measured,
                measured_ci95=(measured - 0.0512, measured + 0.0398),
                predicted=predicted,
                predicted_ci95=None if model == "LS" else (predicted - 0.25, predicted + 0.125),
                predicted_mm=before * (1.0 - predicted),
                refused=refused,
            )
        )
    return found


@pytest.fixture
def found():
    rng = np.random.default_rng(1)
    gains = {("UR5", "random"): made_gains(rng, 1), ("UR5", "blocks"): made_gains(rng, 2)}
    gains["UR10, series A", "blocks"] = made_gains(rng, 4)
    models = {"nominal": [4.0, 3.5, 4.5], "geometry": [0.8, 0.7, 0.9], "best": [0.6, 0.5, 0.7]}
    plain = {"models": models, "used": ["geometry"] * 2, "rows": 321}
    best = {"models": models, "used": ["geometry+gravity", "geometry+gravity+bpnn"], "rows": 20}
    peers = {
        name: {
            "held_out_rms_mm": 0.25 * k,
            "random_poses_mean_mm": 0.125 * k,
            "nominal": {"held_out_rms_mm": 2.0, "random_poses_mean_mm": 1.5},
            "note": f"way {k}",
        }
        for k, name in enumerate(("pickenv", "figaroh"), start=1)
    }
    return Bench(
        settings=BenchSettings(rows=90, folds=3, draws=4),
        gains=gains,
        used={"UR5": (200, 90), "UR10, series A": (80, 80)},
        spread={"ur5_random": plain, "wam_poses": best},
        peers=peers,
        skipped={"peer_robotics": "it is not installed"},
    )


def test_a_gains_row_holds_its_figures_and_what_they_are_shares_of(found):
    rows = [row for row in bench_json(found)["rows"] if row["table"] == "gains"]
    every = [(robot, split, gain) for (robot, split), gains in found.gains.items() for gain in gains]
    assert len(rows) == len(every) == 12
    for row, (robot, split, gain) in zip(rows, every, strict=True):
        assert (row["robot"], row["split"], row["model"]) == (robot, split, gain.model)
        assert row["before"] == ("nominal" if gain.model == "LS" else "LS")
        assert [row["nominal_mm"], row["before_mm"], row["held_out_mm"]] == [
            gain.nominal_mm,
            gain.before_mm,
            gain.held_out_mm,
        ]
        assert (row["measured_reduction"], row["ci95"]) == (gain.measured, gain.measured_ci95)
        assert (row["predicted_reduction"], row["predicted_ci95"]) == (gain.predicted, gain.predicted_ci95)
        assert (row["predicted_mm"], row["refused_draws"], row["statistic"]) == (gain.predicted_mm, gain.refused, "rms")
        assert (row["rows_in_file"], row["rows"]) == found.used[robot] and row["published_mm"] is None
    assert bench_json(found)["settings"]["folds"] == 3
    assert bench_json(found)["skipped"] == {"peer_robotics": "it is not installed"}


def test_a_row_of_the_readme_is_its_geometry_against_the_nominal_and_its_best_against_the_geometry(found):
    plain, geometry, best = (row for row in bench_json(found)["rows"] if row["table"] == "best")
    for row, before, left in ((plain, 4.0, 0.8), (geometry, 4.0, 0.8), (best, 0.8, 0.6)):
        assert (row["nominal_mm"], row["before_mm"], row["held_out_mm"]) == (4.0, before, left)
        assert row["measured_reduction"] == pytest.approx(1.0 - left / before)
        assert row["held_out_spread_mm"] == pytest.approx([left - 0.1, left + 0.1])
        assert row["before"] == ("nominal" if row["model"] == "LS" else "LS")
    assert [row["model"] for row in (plain, geometry, best)] == ["LS", "LS", "best: gravity; gravity, bpnn"]
    assert (plain["robot"], plain["split"], plain["statistic"], plain["rows"]) == ("UR5", "random", "rms", 321)
    assert (best["robot"], best["split"], best["statistic"], best["rows"]) == ("WAM", "poses", "mean", 20)
    assert (plain["published_mm"], best["published_mm"]) == (None, 2.92)


def test_a_peer_is_judged_on_rows_and_on_poses_of_the_ur5(found):
    rows = [row for row in bench_json(found)["rows"] if row["table"] == "peers"]
    assert [row["model"] for row in rows] == ["pickenv: LS"] * 2 + ["figaroh"] * 2
    for k, (held, poses) in enumerate((rows[:2], rows[2:]), start=1):
        for row, split, statistic, before, left, others in (
            (held, "random", "rms", 2.0, 0.25 * k, None),
            (poses, "poses", "mean", 1.5, 0.125 * k, 0.1549),
        ):
            assert (row["robot"], row["split"], row["statistic"], row["before"]) == ("UR5", split, statistic, "nominal")
            assert row["nominal_mm"] == row["before_mm"] == before and row["held_out_mm"] == left
            assert row["measured_reduction"] == 1.0 - left / before
            assert (row["published_mm"], row["note"]) == (others, f"way {k}")


def test_every_cell_of_the_page_is_its_figure(found):
    page = bench_page(found)
    cells = [[cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines() if line[:2] == "| "]
    split = {"random": "random fifths", "blocks": "blocks"}
    told = [row for row in cells if row[1] in split.values()]
    every = [(robot, held, gain) for (robot, held), gains in found.gains.items() for gain in gains]
    for row, (robot, held, gain) in zip(told, every, strict=True):
        assert row[:5] == [robot, split[held], gain.model, f"{gain.before_mm:.3f}", f"{gain.held_out_mm:.3f}"]
        for cell, value, ends in (
            (row[5], gain.predicted, gain.predicted_ci95),
            (row[6], gain.measured, gain.measured_ci95),
        ):
            shown = [float(number) for number in re.findall(r"-?[\d.]+", cell)]
            assert shown == pytest.approx([100 * value, *(100 * end for end in ends or ())], abs=0.0501)
            assert re.fullmatch(r"\S+ %( \(\S+ to \S+\))?", cell)
        assert float(row[7]) == pytest.approx(100 * (gain.predicted - gain.measured), abs=0.0501) and row[7][0] in "+-"
    assert ["pickenv", "0.2500", "0.1250", "way 1"] in cells and ["figaroh", "0.5000", "0.2500", "way 2"] in cells
    assert "- peer_robotics: it is not installed" in page and NOTE in page
    assert len(re.findall("^## ", page, re.M)) == 4


def test_the_sentence_under_the_gains_counts_them(found):
    said, gains = agreement_words(found), [gain for each in found.gains.values() for gain in each]
    apart = [100 * abs(gain.predicted - gain.measured) for gain in gains]
    median, worst = (f"{np.quantile(apart, q):.1f}" for q in (0.5, 0.9))
    learnt = [gain for (_, split), each in found.gains.items() for gain in each[2:] if split == "blocks"]
    right = np.mean([(gain.predicted > 0) == (gain.measured > 0) for gain in learnt])
    assert said.startswith(f"12 gains on 2 sets of rows: predicted and measured are {median} percentage points apart")
    assert f"{worst} in the worst tenth" in said and f"on blocks is right in {100 * right:.0f} %." in said
    assert "3 folds, 4 arms drawn for each (7 could not be calibrated" in said
    assert said.endswith("equally spaced in the file: UR5 90 of 200, UR10, series A 80.")
    alone = {("UR5", "random"): made_gains(np.random.default_rng(0), 0)}
    one = Bench(found.settings, alone, {"UR5": (90, 90)}, {}, {}, {})
    assert "4 gains on 1 set of rows" in agreement_words(one) and "The sign" not in agreement_words(one)
    assert "(" not in agreement_words(one) and agreement_words(Bench(found.settings, {}, {}, {}, {}, {})) == ""


@pytest.mark.parametrize("how", ["random", "blocks", "poses"])
@pytest.mark.parametrize("statistic", ["rms", "mean"])
def test_a_row_states_each_model_with_its_interval_or_over_splits_with_its_range(how, statistic, monkeypatch):
    """Calibrations whose errors are made up: of n splits n errors, or one judgement with its interval."""
    asked, blocks = [], np.arange(60) // 6

    def calibrate(arm, rows, *, test=None, split=None, choices):
        errors = np.random.default_rng(len(asked)).gamma(3.0, 0.1, 60)
        asked.append((test, split, choices))
        position = {
            name: error_statistics(k * errors, blocks) for name, k in (("nominal", 4), ("geometric", 2), ("last", 1))
        }
        return SimpleNamespace(
            position=position, best_model=f"geometry+{len(asked)}", held_out=SimpleNamespace(used=["geometry"] * 10)
        )

    def load(self, data):
        return "arm", SimpleNamespace(joints=np.zeros((77, 6))), "poses"

    monkeypatch.setattr(spread_rows, "calibrate", calibrate)
    monkeypatch.setattr(RealSet, "load", load)
    found = spread_figures(SpreadRow("ur5", how, "auto", "gp", statistic), None, 4, 9)
    assert found["rows"] == 77
    every = [np.random.default_rng(i).gamma(3.0, 0.1, 60) for i in range(4)]
    size = {"rms": lambda errors: np.sqrt(np.mean(errors**2)), "mean": np.mean}[statistic]
    for name, k in (("nominal", 4), ("geometry", 2), ("best", 1)):
        if how == "random":
            sizes = [size(k * errors) for errors in every]
            expected = [np.mean(sizes), min(sizes), max(sizes)]
        else:
            ends = getattr(error_statistics(k * every[0], blocks), f"{statistic}_ci95")
            expected = [size(k * every[0]), *ends]
        assert found["models"][name] == pytest.approx(expected)
    choices = [each[2] for each in asked]
    assert {(c.terms, c.residual) for c in choices} == {("auto", "gp")}
    if how == "random":
        assert [c.seed for c in choices] == np.random.SeedSequence(9).generate_state(4).tolist()
        assert found["used"] == [f"geometry+{k}" for k in range(1, 5)]
    else:
        assert [each[:2] for each in asked] == [("poses" if how == "poses" else None, "blocked")]
        assert found["used"] == ["geometry"] * 10
