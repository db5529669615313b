"""From how many rows the stages choose terms and residual models, among which, and how those are ranked."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from pickenv.base import InputError
from pickenv.calibration import (
    Choices,
    GateVerdict,
    GravityTerm,
    PeriodicTerm,
    random_joints,
    simulated_tracker,
    workspace_joints,
)
from pickenv.calibration.assessment.quality import workspace_error
from pickenv.calibration.identification.diagnosis import LeftOut
from pickenv.calibration.pipeline import stages
from pickenv.calibration.residuals.residual_models import AUTO as OURS

AUTO = Choices(frames="known", residual="auto", terms="auto", seed=5)


@pytest.fixture(scope="module")
def sets(dynamic):
    rng = np.random.default_rng(0)
    return [simulated_tracker(dynamic, random_joints(dynamic.geometry, n, rng), rng) for n in (40, 10)]


@pytest.fixture(scope="module")
def identified(dynamic, sets):
    """``identified(rows, choices)``: the draft before terms, which depends on no choice of terms or residual model."""

    @cache
    def draft_of(rows):
        train = sets[0].select(np.arange(rows))
        draft = stages.Draft(dynamic.arm, AUTO, train, sets[1], np.random.default_rng(0))
        return stages._identify(stages._check(draft))

    def draft(rows=40, choices=AUTO):
        return replace(draft_of(rows), choices=choices, rng=np.random.default_rng(0))

    return draft


def gravity(dynamic):
    return GravityTerm(tuple(range(dynamic.geometry.joints)), (0.0, 0.0, 1.0))


@pytest.mark.parametrize(("rows", "asked"), [(39, False), (40, True)])
def test_forty_training_rows_are_enough_to_choose_terms_on_blocks(dynamic, identified, rows, asked, monkeypatch):
    calls = []

    weight = (gravity(dynamic),)

    def choosing(arm, bare, data):
        calls.append(len(data))
        assert bare.poses == len(data) and not bare.arm_model.terms
        return ("gravity", {"none": 2e-3, "gravity": 1e-3}, weight)

    monkeypatch.setattr(stages, "choose_terms", choosing)
    draft = stages._add_terms(identified(rows))
    assert calls == ([rows] if asked else [])
    assert list(draft.fits) == ["geometry"] + ["geometry+gravity"] * asked
    assert (draft.term_choice is not None) == asked and len(draft.best[1].calibration.model.terms) == asked
    if asked:
        assert draft.best[1].calibration.record["terms"] == ["gravity"]
        assert draft.best[1].calibration.model.terms == weight
    told = stages._add_terms(identified(39, replace(AUTO, terms="gravity")))
    assert list(told.fits) == ["geometry", "geometry+gravity"] and told.term_choice is None


def test_of_terms_that_do_not_converge_the_last_is_given_up_first(dynamic, identified, monkeypatch):
    draft = identified(choices=replace(AUTO, terms="gravity+periodic"))
    wave = PeriodicTerm((0,), (4.0,))
    monkeypatch.setattr(stages, "terms_of", lambda *_: (gravity(dynamic), wave))
    tried, real = [], stages.identify_terms

    def wandering(terms, *given):
        tried.append(len(terms))
        return replace(real(terms, *given), converged=len(terms) == 1)

    monkeypatch.setattr(stages, "identify_terms", wandering)
    found = stages._add_terms(draft)
    assert tried[-1] == 1 < tried[0] and len(tried) == 2
    assert list(found.fits) == ["geometry", "geometry+gravity"] and len(found.best[1].calibration.model.terms) == 1
    monkeypatch.setattr(stages, "identify_terms", lambda *given: replace(real(*given), converged=False))
    none = stages._add_terms(draft)
    assert list(none.fits) == ["geometry"] and none.best[1].calibration.model.terms == ()


def verdict(name, blocked=1e-3, inner=1e-3, accepted=True):
    return GateVerdict(name, blocked, 4e-3, None, None, inner, 5e-3, accepted, "")


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "asked"), [(39, False), (40, True)])
def test_and_to_judge_residual_models(identified, rows, asked, monkeypatch):
    calls = []

    def judging(data, refit, rng, *, models, fitters, progress):
        calls.append((len(data), models, rng.bit_generator.state))
        assert refit(data).geometry is not None
        return (verdict("gp"),)

    monkeypatch.setattr(stages.residual_models, "gate_residuals", judging)
    draft = stages._learn(identified(rows))
    assert list(draft.fits) == ["geometry"] + ["geometry+gp"] * asked and bool(draft.gate) == asked
    if asked:
        ((count, models, state),) = calls
        assert (count, models) == (40, OURS)
        assert state == np.random.default_rng(5).bit_generator.state
    named = stages._learn(identified(rows, replace(AUTO, residual="rbf")))
    assert calls[-1][1] == ("rbf",) if asked else calls == []
    assert list(named.fits)[1:] == (["geometry+gp"] if asked else [])


def test_a_model_that_does_not_win_is_used_only_by_force(dynamic, sets, identified, monkeypatch):
    monkeypatch.setattr(stages.residual_models, "gate_residuals", lambda *_, **__: (verdict("rbf", accepted=False),))
    named = replace(AUTO, residual="rbf")
    for choices, fits in (
        (named, ["geometry"]),
        (replace(named, force=True), ["geometry", "geometry+rbf"]),
        (replace(AUTO, force=True), ["geometry"]),
        (replace(AUTO, residual="none", force=True), ["geometry"]),
    ):
        assert list(stages._learn(identified(choices=choices)).fits) == fits
    with pytest.raises(InputError, match="there is no residual 'magic'; give one of bpnn, rbf, gp"):
        stages.calibrate(dynamic.arm, sets[0], choices=replace(AUTO, residual="magic"))


def test_residual_models_are_judged_on_3000_rows_at_most(sets, identified, monkeypatch):
    rows = []
    monkeypatch.setattr(stages.residual_models, "gate_residuals", lambda data, *_, **__: rows.append(data.joints[:, 0]))
    draft = identified()
    many = sets[0].select(np.arange(3100) % 40)
    many = replace(many, joints=np.arange(3100.0)[:, None] * np.ones(6))
    stages._verdicts(draft, many, ("rbf",))
    assert len(rows[0]) == 3000 and rows[0][0] == 0 and rows[0][-1] == 3099 and (np.diff(rows[0]) >= 1).all()


def test_options_of_poses_are_refused_for_other_kinds_and_defaults_are_not(dynamic, sets):
    class Wires:
        source, kind, poses = "wires.csv", "distance", None

        @property
        def parts(self):
            return (self,)

    stages.refuse_options(Wires(), Choices())
    stages.refuse_options(Wires(), Choices(residual="none", frames="fitted"))
    for choices, option in (
        (Choices(frames="known"), "`frames='known'` is"),
        (Choices(residual="gp"), "`residual='gp'` is"),
    ):
        with pytest.raises(InputError, match=f"^{option} for poses and positions, but wires.csv holds distance"):
            stages.refuse_options(Wires(), choices)


def test_the_generator_of_a_calibration_is_that_of_its_seed(dynamic, sets, monkeypatch):
    """Rows are held out by one generator of the seed, and the residual model drawn from another."""
    seen = []
    monkeypatch.setattr(stages, "_learn", lambda draft: seen.append(draft) or draft)
    stages.calibrate(dynamic.arm, sets[0], choices=replace(AUTO, seed=9, terms="none", residual="none"))
    (draft,) = seen
    assert draft.rng.bit_generator.state == np.random.default_rng(9).bit_generator.state
    order = np.random.default_rng(9).permutation(40)
    np.testing.assert_array_equal(draft.train.joints, sets[0].joints[np.sort(order[:32])])
    np.testing.assert_array_equal(draft.test.joints, sets[0].joints[np.sort(order[32:])])


def test_a_result_carries_all_that_the_stages_found(dynamic, sets, monkeypatch):
    """Fits step by step, the choice of terms, the gate's verdicts, rows left out, and what is expected elsewhere."""
    choice = ("gravity", {"none": 2e-3, "gravity": 1e-3}, (gravity(dynamic),))
    gate = (verdict("rbf"),)
    monkeypatch.setattr(stages, "choose_terms", lambda *_: choice)
    monkeypatch.setattr(stages.residual_models, "gate_residuals", lambda *_, **__: gate)
    left = (LeftOut("tracker.csv", 7, False, 5e-3, None, 9.0),)
    seen, learn = [], stages._learn
    monkeypatch.setattr(stages, "_learn", lambda draft: seen.append(replace(learn(draft), left_out=left)) or seen[0])
    found = stages.calibrate(dynamic.arm, sets[0], test=sets[1], choices=AUTO, unit="17")
    (draft,) = seen
    assert list(found.errors) == ["nominal", "geometric", "geometry+gravity", "geometry+gravity+rbf"]
    assert found.terms is choice and found.gate is gate and found.left_out is left and found.unit == "17"
    nominal, limits = draft.fits["geometry"].calibration.nominal, workspace_joints(None, dynamic.arm.nominal)
    over = workspace_error(draft.best[1].identification, nominal, draft.train.joints, limits[1])
    assert over is not None and replace(found.quality.workspace, remains=0.0) == over
    assert found.quality.workspace.remains == pytest.approx(found.best.rms * 1e-3)
    assert found.fit is draft.best[1] and found.geometric is draft.fits["geometry"]
    assert found.best_model == "geometry+gravity+rbf"
    assert found.calibration.record["left_out"] == ["tracker.csv:7"]
    held = {
        "geometric": sets[1].difference(draft.fits["geometry"].calibration.model),
        "geometry+gravity": sets[1].difference(draft.fits["geometry+gravity"].calibration.model),
    }
    for name, errors in held.items():
        np.testing.assert_allclose(found.errors[name], errors, atol=1e-15)
    learnt = draft.best[1].calibration.learnt.predict(sets[1].joints)
    np.testing.assert_allclose(found.errors["geometry+gravity+rbf"], held["geometry+gravity"] - learnt, atol=1e-12)
    rows = next(block for block in found.blocks() if block.title == "Further terms").rows
    assert rows == (("none", "2.000"), ("gravity", "1.000"))
    assert found.as_dict()["terms"] == {"chosen": "gravity", "blocked_rms_mm": {"none": 2.0, "gravity": 1.0}}


@pytest.mark.parametrize(
    ("frames", "label"), [("known", "nominal"), ("fitted", "nominal, base and tool fitted")], ids=["known", "fitted"]
)
def test_the_first_row_says_whether_base_and_tool_were_fitted(dynamic, sets, frames, label):
    choices = replace(AUTO, frames=frames, terms="none", residual="none")
    found = stages.calibrate(dynamic.arm, sets[0], test=sets[1], choices=choices)
    block = next(block for block in found.blocks() if block.title == "Errors on held-out rows")
    assert [row[0] for row in block.rows] == [label, "geometry"]
    assert found.known_frames == (frames == "known") == (found.base_frame is None)
    assert found.as_dict()["frames"] == frames
    assert (found.as_dict()["base_frame"] is None) == (frames == "known")
    record = found.calibration.record
    assert ("base_frame" in record) == (frames == "fitted") and record["frames"] == frames
    said = found.frames_text
    assert ("base and tool are known" in said) == (frames == "known")
