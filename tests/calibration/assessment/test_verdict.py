"""The verdict is part of the result: first on the screen, in JSON, page, file and exit code, and obeyed."""

import json
import re
from dataclasses import replace
from html.parser import HTMLParser

import gymnasium as gym
import numpy as np
import pytest
from typer.testing import CliRunner

import pickenv  # noqa: F401 - registers the environments
from pickenv.agents.evaluation.contenders import load_compensator
from pickenv.arm import draw_plants, forward, load_arm, load_tolerances, plant_at
from pickenv.base import InputError
from pickenv.calibration import (
    Calibration,
    Choices,
    Measurements,
    assess,
    calibrate,
    fit,
    random_joints,
    read_measurements,
    simulated_tracker,
)
from pickenv.calibration.assessment.screen import figure
from pickenv.calibration.model.observations import choose
from pickenv.cli import app
from pickenv.inspect import calibration_page
from pickenv.wrappers import CompensationVectorWrapper, CompensationWrapper

PLAIN = ("--arm", "qiao2026", "--terms", "none", "--residual", "none")


def call(*words):
    done = CliRunner().invoke(app, [str(word) for word in words])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    return done


@pytest.fixture(scope="module")
def noisy(dynamic, tmp_path_factory):
    """A file whose noise of 20 mm drowns the arm's own error."""
    rng = np.random.default_rng(5)
    data = simulated_tracker(dynamic, random_joints(dynamic.geometry, 100, rng), rng)
    data = replace(data, position=data.position + rng.normal(size=(100, 3)) * 20e-3)
    return data.write_csv(tmp_path_factory.mktemp("noisy") / "noisy.csv")


@pytest.fixture(scope="module")
def refused(noisy, unwritten):
    """The calibration of that file, with its terminal and its JSON."""
    out, told, page = (noisy.with_name(name) for name in ("bad.npz", "bad.json", "bad.html"))
    with unwritten():
        done = call("calibrate", noisy, *PLAIN, "--out", out, "--json", told, "--report", page)
    return done, out, json.loads(told.read_text()), page.read_text()


def test_noise_of_20_mm_is_not_to_be_used_and_everything_says_so(refused):
    done, out, told, page = refused
    assert done.exit_code == 3 and done.stdout.startswith("verdict: DO NOT USE: ")
    reason = told["verdict"]["reason"]
    assert told["verdict"]["grade"] == "do not use" and "nominal one" in reason
    assert done.output.splitlines()[0] == f"verdict: DO NOT USE: {reason}"
    assert "Do not use this calibration" in page and reason[1:] in page
    kept = Calibration.load(out).record["verdict"]
    assert kept == told["verdict"]


@pytest.mark.parametrize(
    ("count", "frames", "said"),
    [
        (2, "known", "DO NOT USE: only 2 rows were held out, which judges nothing; measure more"),
        (4, "known", "DO NOT USE: "),
        (4, "fitted", "WITH CARE: held-out errors"),
        (7, "known", "WITH CARE: held-out errors"),
        (7, "fitted", "WITH CARE: held-out errors"),
    ],
)
def test_few_rows_are_judged_one_by_one(dynamic, tmp_path, count, frames, said):
    """Four may tell a gain or none: each is judged by a fit to the three others, whose priors say the rest."""
    rng = np.random.default_rng(0)
    data = simulated_tracker(dynamic, random_joints(dynamic.geometry, count, rng), rng)
    done = call("calibrate", data.write_csv(tmp_path / "few.csv"), *PLAIN, "--frames", frames)
    assert done.exit_code == (3 if "DO NOT" in said else 0) and done.stdout.startswith(f"verdict: {said}")


def test_cautions_are_repeated_where_the_calibration_is_used(dynamic, tmp_path):
    """Whatever the caution is about: here that held-out errors are larger than those of the fit."""
    rng = np.random.default_rng(0)
    data = simulated_tracker(dynamic, random_joints(dynamic.geometry, 7, rng), rng).write_csv(tmp_path / "few.csv")
    out = tmp_path / "few.npz"
    reason = call("calibrate", data, *PLAIN, "--out", out).stdout.splitlines()[0].partition("CARE: ")[2]
    assert reason.startswith("held-out errors")
    applied = call("apply", out, data, "--arm", "qiao2026", "--out", tmp_path / "commands.csv")
    exported = call("export", out, "--out", tmp_path / "arm.toml")
    assert all(f"caution: {reason}" in done.output.replace("\n    ", " ") for done in (applied, exported))


@pytest.mark.parametrize(("frames", "said"), [("known", "holds one row, and none to judge by"), ("fitted", "too few")])
def test_one_row_is_refused_in_a_sentence(dynamic, tmp_path, frames, said):
    rng = np.random.default_rng(0)
    data = simulated_tracker(dynamic, random_joints(dynamic.geometry, 1, rng), rng)
    with pytest.raises(InputError, match=said):
        call("calibrate", data.write_csv(tmp_path / "one.csv"), *PLAIN, "--frames", frames)


def test_the_verdict_is_obeyed_unless_overridden_by_name(refused, noisy, tmp_path):
    _, out, _, _ = refused
    targets = tmp_path / "targets.csv"
    targets.write_text("q1_deg,q2_mm,q3_mm,q4_deg,q5_mm,q6_deg\n10,200,200,10,50,10\n")
    exported = tmp_path / "arm.toml"
    commands = (
        ("apply", out, targets, "--arm", "qiao2026", "--out", tmp_path / "c.csv"),
        ("export", out, "--out", exported),
    )
    for words in commands:
        with pytest.raises(InputError, match=r"do not use \(.*\); measure again; allow 'do-not-use' by name"):
            call(*words)
        assert (not (tmp_path / "c.csv").exists() and not exported.exists()) or words[0] == "export"
        assert call(*words, "--allow", "do-not-use").exit_code == 0
        with pytest.raises(InputError, match="unknown reservation 'all'"):
            call(*words, "--allow", "all")
    compensator = Calibration.load(out).compensator()
    with pytest.raises(InputError, match="do not use"):
        CompensationWrapper(gym.make("pickenv/Reach-v0"), compensator)
    cautious = replace(compensator, caution="the rows tell 5 % of the joint limits; declare `workspace`")
    with pytest.warns(UserWarning, match="the rows tell 5 % of the joint limits; declare `workspace`"):
        CompensationWrapper(gym.make("pickenv/Reach-v0"), cautious, allow=["do-not-use"]).close()
    with pytest.raises(InputError, match="do not use"):
        load_compensator(out, load_arm("qiao2026"))


def test_fitted_frames_are_refused_where_fruit_stand_in_the_base_frame(dynamic):
    rng = np.random.default_rng(0)
    train, test = (simulated_tracker(dynamic, random_joints(dynamic.geometry, n, rng), rng) for n in (40, 20))
    result = assess(dynamic.arm, fit(dynamic.arm, train), train, test)
    compensator = result.calibration.compensator()
    low, high = result.base_frame.low * 1e3, result.base_frame.high * 1e3
    for make in (
        lambda **more: CompensationWrapper(gym.make("pickenv/Reach-v0"), compensator, **more),
        lambda **more: CompensationVectorWrapper(gym.make_vec("pickenv/Reach-v0", num_envs=2), compensator, **more),
    ):
        with pytest.raises(InputError, match="base frame, where the fruit stand, is not known") as caught:
            make()
        assert f"({low:.3g} to {high:.3g} mm" in str(caught.value) and "`frames='known'`" in str(caught.value)
        make(allow=["fitted-frames"]).close()


def test_what_the_report_says_of_the_base_frame_holds_on_most_arms(qiao, dynamic):
    """Arms of a tolerance class, measured in the base frame but with base and tool fitted: the true error there."""
    plants = draw_plants(dynamic, load_tolerances("coarse"), 24, np.random.default_rng(3))
    held = []
    for number in range(24):
        plant, rng = plant_at(plants, number), np.random.default_rng(100 + number)
        train, test = (simulated_tracker(plant, random_joints(qiao.nominal, n, rng), rng) for n in (60, 40))
        result = assess(qiao, fit(qiao, train), train, test)
        command = result.calibration.compensate(test.joints)
        missed = plant.tool_pose(command).position - forward(qiao.nominal, test.joints).position
        held.append(result.base_frame.low <= np.linalg.norm(missed, axis=1).mean() <= result.base_frame.high)
    assert np.mean(held) >= 0.9


class Words(HTMLParser):
    """Numbers and text of a page, without its pictures and styles."""

    def __init__(self, page):
        super().__init__()
        self.hidden, self.text = 0, []
        self.feed(page)

    def handle_starttag(self, tag, attributes):
        self.hidden += tag in ("svg", "style")

    def handle_endtag(self, tag):
        self.hidden -= tag in ("svg", "style")

    def handle_data(self, data):
        if not self.hidden:
            self.text.append(data)


NUMBER = re.compile(r"(?<![\w.^])[-+]?\d+(?:\.\d+)?(?:e[-+]\d+)?(?![\w])")


def numbers(text: str) -> set[str]:
    return set(NUMBER.findall(text))


def flat(value):
    """All numbers of a JSON value."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        return [number for part in value for number in flat(part)]
    return [value] if isinstance(value, int | float) and not isinstance(value, bool) else []


def shared(result, unwritten):
    """Terminal and page of a result; every number of the terminal stands in the page, outside its figures."""
    with unwritten():
        terminal, page = result.report(), " ".join(Words(calibration_page(result)).text)
    assert numbers(terminal) - numbers(page) == set()
    return terminal, page


@pytest.mark.parametrize("terms", ["none", pytest.param("gravity+periodic", marks=pytest.mark.slow)])
def test_every_number_that_terminal_and_page_share_is_equal_on_the_ur5(measured_ur5, terms, unwritten):
    data = measured_ur5[1]
    rows = choose(data, None, np.random.default_rng(0))
    train, test = (data.select(np.sort(part)) for part in rows)
    result = calibrate(load_arm("ur5"), train, test=test, choices=Choices(terms=terms, residual="none"))
    terminal, page = shared(result, unwritten)
    assert len(numbers(terminal)) > 60
    told = result.as_dict()
    for text in (terminal, page):
        assert f"{told['held_out']['best_rms_mm']:#.4g}" in text
        for row in told["changes"]:  # those that moved, on the terminal; all, on the page
            moved = abs(row["change"]) > 2 * row["std"]
            plain = "periodic" not in row["name"] and 1e-3 <= abs(row["change"]) < 1e4
            if plain and (moved or text is page):
                assert f"{row['change']:#.4g}" in text and f"{100 * row['narrowed']:.0f} %" in text
        for region in (told["workspace"][name] for name in ("measured", "declared")):
            assert all(figure(region[f"{name}_rms_mm"]) in text for name in ("nominal", "calibrated"))
    values = result.geometric.identification.identifiability.singular_values
    assert result.quality.observability["condition"] == pytest.approx(values[0] / values[-1])
    if terms != "none":
        harmonics = told["harmonics"]["found"]
        assert all(f"{item['amplitude']:.5f}" in terminal and f"{item['order']:.2f}" in page for item in harmonics)
        assert len(harmonics) > 4 and told["harmonics"]["note"] in terminal
        assert told["harmonics"]["note"][1:] in page  # there it begins a sentence
        gravity = [row["narrowed"] for row in told["changes"] if row["name"].startswith("gravity")]
        assert max(gravity) > 0.5 > np.median(gravity)  # most of a gravity model stands where it was expected
        assert result.position["geometry+gravity+periodic"].rms < 0.1


def test_what_the_rows_told_of_a_coefficient_is_how_much_narrower_it_is_known_than_expected(dynamic, unwritten):
    """A term's coefficient is expected within its own tolerance: 1 mm or 1 mrad at the tool."""
    rng = np.random.default_rng(2)
    train, test = (simulated_tracker(dynamic, random_joints(dynamic.geometry, n, rng), rng) for n in (80, 30))
    result = calibrate(dynamic.arm, train, test=test, choices=Choices(terms="gravity", residual="none"))
    model = result.fit.identification.arm_model
    names = model.parameter_names[-len(model.term_tolerances) :]
    rows = {row["name"]: row for row in result.parameters()}
    for name, tolerance in zip(names, model.term_tolerances, strict=True):
        row = rows[name]
        assert row["prior_std"] == pytest.approx(tolerance)
        assert row["narrowed"] == pytest.approx(max(0.0, 1.0 - row["std"] / tolerance))
    told = [rows[name]["narrowed"] for name in names]
    assert min(told) < 0.2 and max(told) > 0.8
    shared(result, unwritten)


def test_a_model_that_does_not_converge_is_never_chosen(dynamic, monkeypatch):
    from pickenv.calibration.pipeline import stages

    rng = np.random.default_rng(2)
    train, test = (simulated_tracker(dynamic, random_joints(dynamic.geometry, n, rng), rng) for n in (80, 30))
    whole = stages.identify_terms
    monkeypatch.setattr(stages, "identify_terms", lambda *a: replace(whole(*a), converged=False))
    choices = Choices(terms="gravity", residual="none")
    result = calibrate(dynamic.arm, train, test=test, choices=choices)
    assert result.best_model == "geometry" and result.fit.identification.converged


def test_a_foreign_option_is_refused(qiao, exact):
    from pickenv.calibration import DistanceObservations

    joints = exact(qiao.nominal).joints
    wire = DistanceObservations(joints, np.ones(len(joints)), 1e-4)
    for choices in (Choices(residual="bpnn"), Choices(frames="known")):
        with pytest.raises(InputError, match="is for poses and positions"):
            calibrate(qiao, wire.select(np.arange(40)), test=wire.select(np.arange(40, 60)), choices=choices)


def test_the_result_is_saved_before_it_is_printed(dynamic, tmp_path, monkeypatch):
    rng = np.random.default_rng(0)
    data = simulated_tracker(dynamic, random_joints(dynamic.geometry, 60, rng), rng)
    file = data.write_csv(tmp_path / "m.csv")

    def full(*words, **more):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("builtins.print", full)
    done = CliRunner().invoke(app, ["calibrate", str(file), *PLAIN, "--out", str(tmp_path / "c.npz")])
    assert isinstance(done.exception, OSError)
    assert Calibration.load(tmp_path / "c.npz").record["frames"] == "known"


def test_outputs_stand_over_no_input_and_no_other_output(dynamic, tmp_path):
    rng = np.random.default_rng(0)
    data = simulated_tracker(dynamic, random_joints(dynamic.geometry, 30, rng), rng)
    file = data.write_csv(tmp_path / "m.csv")
    before = file.read_bytes()
    for words in (("--json", file), ("--out", tmp_path / "x", "--json", tmp_path / "x.npz")):
        with pytest.raises(InputError, match="write"):
            call("calibrate", file, *PLAIN, *words)
    assert file.read_bytes() == before


def test_units_are_kept_and_asked_for(dynamic, tmp_path):
    rng = np.random.default_rng(0)
    data = simulated_tracker(dynamic, random_joints(dynamic.geometry, 60, rng), rng)
    file, out = data.write_csv(tmp_path / "m.csv"), tmp_path / "c.npz"
    assert call("calibrate", file, *PLAIN, "--unit", "SN 17", "--out", out).exit_code == 0
    words = ("export", out, "--out", tmp_path / "a.toml", "--unit")
    assert call(*words, "SN 17").exit_code == 0
    with pytest.raises(InputError, match="belongs to unit 'SN 17', but unit 'SN 18'"):
        call(*words, "SN 18")


def test_measured_data_say_fitted_and_simulated_ones_known(dynamic, tmp_path):
    rng = np.random.default_rng(0)
    data = simulated_tracker(dynamic, random_joints(dynamic.geometry, 10, rng), rng)
    assert data.frames == "known"
    assert read_measurements(data.write_csv(tmp_path / "m.csv"), dynamic.geometry).frames == "known"
    bare = Measurements(data.joints, data.position, data.rotation, data.prismatic)
    assert read_measurements(bare.write_csv(tmp_path / "b.csv"), dynamic.geometry).frames == "fitted"
    both = choose(data, None, rng)
    train, test = (data.select(np.sort(rows)) for rows in both)
    with pytest.raises(InputError, match=r"say.* known, .* fitted; give `frames`"):
        calibrate(dynamic.arm, train, test=replace(test, frames="fitted"))
