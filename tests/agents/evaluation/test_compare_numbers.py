"""A comparison's numbers by other ways: fields stepped by hand, names and calibrations paired, picks by sums."""

from __future__ import annotations

import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium import spaces

from pickenv.agents import RandomReach, ServoReach, compare, episode_seeds
from pickenv.agents.evaluation.compare import GRID_STEP, _command, _field
from pickenv.agents.evaluation.contenders import Kind, contenders_of, kind_of, maker_of, policy_name
from pickenv.agents.policies.adaptive import CALIBRATED_PRIOR
from pickenv.arm import load_plant
from pickenv.base import InputError, seed_words, stream
from pickenv.base.registry import names
from pickenv.calibration import Calibration, fit, random_joints, simulated_tracker
from pickenv.inspect import Comparison, Reaches, ended, field_grid, matters, pick_changes
from pickenv.inspect.runs import comparison_summary as matters_module
from pickenv.inspect.runs.comparison_summary import PERCEPTION_MM, change_cells, pick_share, stage_label
from pickenv.orchard import load_gripper


def change(gripper: str, perception_mm: float, before: float, after: float) -> dict[str, Any]:
    return {"gripper": gripper, "perception_mm": perception_mm, "before": before, "after": after}


class Late(gym.Env[Any, Any]):
    """A tool that stands beside a fruit; where it is, is told from the step ``since`` on. Episodes have three steps."""

    observation_space = spaces.Box(-1.0, 1.0, (3,), np.float32)
    action_space = spaces.Box(-1.0, 1.0, (3,), np.float32)

    def __init__(self, since: int = 0, rate: int | None = None) -> None:
        self.since = since
        if rate is not None:
            self.metadata = {"render_fps": rate}

    def reset(self, *, seed: int | None = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self.moment, self.fruit = 0, self.np_random.uniform(0.2, 0.8, 3)
        return np.zeros(3, np.float32), self._told()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self.moment += 1
        return np.zeros(3, np.float32), 1.0, False, self.moment == 3, self._told()

    def _told(self) -> dict[str, Any]:
        if self.moment < self.since:
            return {}
        return {"tool_position": np.add(self.fruit, [0.0, 0.003, 0.004]), "fruit_position": self.fruit.copy()}


gym.register("tests/Late-v0", Late)


def test_a_comparison_of_an_environment_without_an_arm() -> None:
    told: list[tuple[str, int, int]] = []
    found = compare(["random"], "tests/Late-v0", labels=["any"], progress=lambda *each: told.append(each))
    assert told == [("any, episodes", done, 20) for done in range(1, 21)]
    assert found.command == (
        "pickenv compare random --env tests/Late-v0 --episodes 20 --seed 0 --gripper li_cup --label any"
    )
    whole = found.episodes
    assert (whole.env_id, whole.plant_name, whole.gripper, whole.seed, whole.period) == (
        "tests/Late-v0", "", "li_cup", 0, 0.1,
    )  # fmt: skip
    assert whole.seeds == episode_seeds(0, 20) and whole.tolerance_mm == 5.0
    assert (whole.plant, whole.nominal) == (None, None) and not isinstance(whole, Comparison)
    (policy,) = whole.policies
    np.testing.assert_allclose(policy.position_error_mm, 5.0)
    np.testing.assert_array_equal(policy.moments, [4] * 20)
    assert compare(["random"], "tests/Late-v0", episodes=1, rate=25).episodes.period == 1 / 25
    with pytest.raises(InputError, match="its info lacks 'tool_position' and 'fruit_position'"):
        compare(["random"], "tests/Late-v0", episodes=1, since=1)


@pytest.mark.parametrize("policy", ["servo", "random"])
def test_an_environment_without_positions_is_refused_before_a_policy_acts(policy: str) -> None:
    told: list[tuple[str, int, int]] = []
    with pytest.raises(InputError, match=r"^pickenv/Harvest-v0 cannot be compared: its info lacks 'tool_position'"):
        compare([policy], "pickenv/Harvest-v0", episodes=1, progress=lambda *each: told.append(each))
    assert not told


def test_a_command_says_what_no_default_says() -> None:
    given = {"env": "e", "episodes": 3, "seed": 1, "gripper": "g", "grid_step": None, "compensate": [None, "x", 1j]}
    assert _command(["a", Path("b/c"), object()], given, ["l", "m"], {"camera_noise_mm": 2.0}) == (
        "pickenv compare a b/c '<object>' --env e --episodes 3 --seed 1 --gripper g --compensate none --compensate x "
        "--compensate '<complex>' --label l --label m --camera-noise 2.0"
    )
    assert GRID_STEP == 0.1


@pytest.mark.parametrize(("name", "number"), [("random", 0), ("random", 1), ("servo", 0)])
def test_a_field_is_stepped_with_its_own_seeds(name: str, number: int) -> None:
    grid = field_grid(load_plant("qiao2026").arm.nominal, 0.4, 3)
    arguments: dict[str, Any] = {"feedback": "camera", "camera_noise_mm": 5.0} if name == "servo" else {}
    (contender,) = contenders_of([name])
    found = _field(contender, "pickenv/Reach-v0", arguments, grid, 3, number)
    envs = gym.make_vec("pickenv/Reach-v0", num_envs=len(grid.joints), autoreset_mode="Disabled", **arguments)
    rng = np.random.default_rng(seed_words(stream(3, "policy", number, 1), 1)[0])
    policy = RandomReach(envs, rng) if name == "random" else ServoReach(envs)
    words = seed_words(stream(3, "fruit", 1), len(grid.joints))
    observation, infos = envs.reset(seed=words, options={"goal_joints": grid.joints})
    policy.reset()
    for _ in range(60):
        observation, _, _, _, infos = envs.step(policy.act(observation))
    np.testing.assert_array_equal(found, infos["pose_error"])


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    plant, rng = load_plant("qiao2026"), np.random.default_rng(0)
    train, more = (simulated_tracker(plant, random_joints(plant.arm.nominal, n, rng), rng) for n in (60, 60))
    return fit(plant.arm, train, more, known_frames=True, residual="rbf", rng=rng).calibration


def test_a_comparison_of_arms_has_fields_ends_and_grasps(calibration: Calibration) -> None:
    told: list[tuple[str, int, int]] = []
    found = compare(
        ["scripted", "random"], compensate=[calibration, None], episodes=3, seed=4, grid_step=0.4, labels=["LS", "any"],
        gripper="compliant_hand", progress=lambda *each: told.append(each),
    )  # fmt: skip
    assert told == [
        *(("LS, episodes", done, 3) for done in (1, 2, 3)),
        *(("any, episodes", done, 3) for done in (1, 2, 3)),
        *(("error fields", done, 2) for done in (1, 2)),
    ]
    assert isinstance(found.episodes, Comparison) and "--grid-step 0.4" in found.command
    plant, comparison = load_plant("qiao2026"), found.episodes
    assert (comparison.seed, comparison.tolerance_mm) == (4, found.episodes.tolerance_mm)
    grid = field_grid(plant.arm.nominal, 0.4, 4)
    np.testing.assert_array_equal(comparison.grid.joints, grid.joints)
    assert comparison.plant.name == plant.name and comparison.nominal.d is comparison.plant.arm.nominal.d
    named = contenders_of(["scripted", "random"], [calibration, None], ["LS", "any"])
    for number, (contender, errors, policy) in enumerate(
        zip(named, comparison.policies, found.episodes.policies, strict=True)
    ):
        field = _field(contender, "pickenv/Reach-v0", {}, grid, 4, number)
        np.testing.assert_array_equal(errors.field_errors, field[:, :3])
        np.testing.assert_array_equal(errors.field_attitude, field[:, 3:])
        last = [(e, k - 1) for e, k in enumerate(policy.moments)]
        for mine, all_of_it in (
            (errors.ends.joint_command, policy.joint_command),
            (errors.ends.tool_position, policy.tool_position),
            (errors.ends.position_error_mm, policy.position_error_mm),
            (errors.ends.attitude_error_deg, policy.attitude_error_deg),
            (errors.ends.picked, policy.picked),
            (comparison.fruit, policy.fruit_position),
        ):
            np.testing.assert_array_equal(mine, [all_of_it[place] for place in last])


def test_policies_are_paired_with_calibrations_and_named_by_what_differs(
    calibration: Calibration, tmp_path: Path
) -> None:
    file = calibration.save(tmp_path / "cal")
    file = file if isinstance(file, Path) else tmp_path / "cal.npz"

    def named(*given: Any, **more: Any) -> list[tuple[str, bool]]:
        return [(each.label, each.compensator is not None) for each in contenders_of(*given, **more)]

    assert named(["scripted"]) == [("scripted", False)]
    assert named(["scripted"], [calibration]) == [("LS+RBF", True)]
    assert named(["random"], [f"{file}#ls", "none", file]) == [("raw", False), ("LS", True), ("LS+RBF", True)]
    assert named(["scripted", "random"]) == [("scripted", False), ("random", False)]
    assert named(["scripted", "random"], [calibration]) == [("scripted", True), ("random", True)]
    assert named(["random", "scripted"], [None, calibration]) == [("random, raw", False), ("scripted, LS+RBF", True)]
    assert named([file]) == [("LS+RBF", True)] and named([f"{file}#ls", "random"]) == [
        ("scripted, LS", True), ("random, raw", False),
    ]  # fmt: skip
    assert named(["random", file, "servo"], ["none", "none", calibration], ["b", "raw", "LS"]) == [
        ("raw", True), ("LS", True), ("b", False),
    ]  # fmt: skip
    with pytest.raises(InputError, match="1 policies and 2 calibrations"):
        contenders_of([file], ["none", "none"])
    with pytest.raises(InputError, match="2 policies and 3 calibrations"):
        contenders_of(["random", "scripted"], ["none"] * 3)
    with pytest.raises(InputError, match="a calibration is whole, or #ls"):
        contenders_of(["random"], [f"{file}#bpnn"])
    for label in ("", "+-"):
        with pytest.raises(InputError, match="has no letter or digit"):
            contenders_of(["random", "scripted"], (), [label, "a"])
    with pytest.raises(InputError, match="two policies are called 'A b'"):
        contenders_of(["random", "scripted"], (), ["A b", "a-b"])
    with pytest.raises(InputError, match="unknown policy"):
        contenders_of([tmp_path / "none.npy"])
    made = contenders_of([object()], [calibration])[0]
    assert made.label == "LS+RBF" and made.compensator is not None
    assert contenders_of([SimpleNamespace()])[0].label == "SimpleNamespace"
    assert stage_label(calibration) == "LS+RBF" and stage_label(calibration.without_residual()) == "LS"
    learnt = SimpleNamespace(learnt=SimpleNamespace(kind="some_kind"))
    assert stage_label(learnt) == "LS+SOME KIND"


def test_an_adaptive_policy_trusts_a_calibrated_arm_more(calibration: Calibration) -> None:
    env = gym.make("pickenv/Reach-v0", feedback="camera")
    for noise, compensation, prior in ((2.0, "raw", 1.0), (3.0, "ls", 0.2)):
        policy = maker_of("adaptive", noise, compensation)(env, 0)
        assert (policy.camera_std, policy.prior) == (pytest.approx(1e-3 * noise), prior)
    assert CALIBRATED_PRIOR == 0.2
    assert maker_of("adaptive")(env, 0).camera_std == 0.0
    raw, ls = contenders_of(["adaptive"], [None, calibration], camera_noise_mm=1.5)
    for contender, prior in ((raw, 1.0), (ls, 0.2)):
        policy = contender.make(env, 0)
        assert (policy.camera_std, policy.prior) == (pytest.approx(1.5e-3), prior)
    one, other = (maker_of("random")(env, seed) for seed in (3, 4))
    seen = np.zeros((1, *env.observation_space.shape), np.float32)
    again = RandomReach(env, np.random.default_rng(3))
    acted = one.act(seen)
    np.testing.assert_array_equal(acted, again.act(seen))
    assert not np.array_equal(acted, other.act(seen))


@pytest.mark.parametrize(
    ("arguments", "noise"),
    [({}, 0.0), ({"camera_noise_mm": 3.0, "fruit_noise_mm": 4.0}, 5.0), ({"fruit_noise_mm": 2.0}, 2.0)],
)
def test_an_adaptive_policy_is_told_of_all_noise(
    arguments: dict[str, float], noise: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pickenv.agents.evaluation import compare as module

    told: list[tuple[float, Any, Any]] = []

    def stop(*_: Any, arm: Any, camera_noise_mm: float, allow: Any) -> Any:
        told.append((camera_noise_mm, arm.name, allow))
        raise InputError("enough")

    monkeypatch.setattr(module, "contenders_of", stop)
    with pytest.raises(InputError, match="enough"):
        compare(["adaptive"], episodes=1, feedback="camera", allow=["some"], **arguments)
    assert told == [(pytest.approx(noise), load_plant("qiao2026").arm.name, ["some"])]


def test_kinds_steps_and_names_of_policies(tmp_path: Path) -> None:
    kinds = {name: kind_of(name) for name in names("policy")}
    assert {name: (kind.feedback, kind.sequential, kind.raw_only, kind.steps) for name, kind in kinds.items()} == {
        "random": (("encoders",), False, False, 60),
        "scripted": (("encoders",), False, False, 60),
        "oracle": (("encoders",), False, True, 60),
        "servo": (("camera",), False, False, 60),
        "adaptive": (("camera",), True, False, 30),
    }
    assert (Kind().sequential, Kind().raw_only, Kind().files, Kind().steps) == (False, False, (), 60)
    assert kind_of("servo") == Kind(("camera",)) and kind_of("mine.py") == Kind(files=("mine.py",))
    assert kind_of("ppo_camera") == Kind(("camera",), files=("ppo_camera",))
    assert kind_of("ppo_encoders") == Kind(("encoders",), files=("ppo_encoders",))
    assert kind_of("recurrent_camera") == Kind(("camera",), sequential=True, files=("recurrent_camera",))
    called = {"a/b/mine.py": "mine", "w/x/y/seed0/policy.npz": "y/seed0/policy", "policy.npz": "policy",
             "scripted": "scripted", "runs/several": "several"}  # fmt: skip
    assert {name: policy_name(name) for name in called} == called
    with pytest.raises(InputError, match="holds no trainings"):
        kind_of(str(tmp_path))


def test_a_policys_errors_are_lengths_in_mm_and_degrees() -> None:
    rng = np.random.default_rng(2)
    field, joints, positions, errors = (rng.normal(size=shape) for shape in ((5, 6), (4, 6), (4, 3), (4, 6)))
    taken = np.array([True, False, True, True])
    reaches = Reaches((1, 2, 3, 4), errors, errors, taken, joints, positions, positions + 0.1)
    found = ended("LS + BPNN", reaches).with_field(field)
    assert (found.label, found.key) == ("LS + BPNN", "ls_bpnn")
    np.testing.assert_array_equal(found.field_errors, field[:, :3])
    np.testing.assert_array_equal(found.field_attitude, field[:, 3:])
    ends = found.ends
    for values, expected in (
        (ends.joint_command, joints), (ends.tool_position, positions), (ends.fruit_position, positions + 0.1),
        (ends.success, taken), (ends.picked, taken), (ends.miss_mm, ends.position_error_mm),
    ):  # fmt: skip
        np.testing.assert_array_equal(values, expected)
    for i, (x, y, z, a, b, c) in enumerate(errors):
        assert found.position_error_mm[i, 0] == pytest.approx(1e3 * math.sqrt(x * x + y * y + z * z))
        assert found.attitude_error_deg[i, 0] == pytest.approx(math.degrees(math.sqrt(a * a + b * b + c * c)))
    bare = ended("LS", reaches, key="mine").with_field(field[:, :3])
    assert bare.key == "mine" and bare.field_attitude is None
    plant = load_plant("qiao2026")
    grid = field_grid(plant.arm.nominal, 0.4, 0)
    few = Comparison(policies=(bare,), plant=plant, grid=grid, seed=3, tolerance_mm=7.0)
    assert (few.plant_name, few.nominal, few.field_uncertainty) == ("qiao2026", plant.arm.nominal, None)
    np.testing.assert_array_equal(few.fruit, positions + 0.1)
    np.testing.assert_allclose(grid.corner, grid.origin - 0.2)
    np.testing.assert_allclose(grid.size, 0.4 * np.array(grid.shape))


@pytest.mark.parametrize("seen", [0.0, 0.7, 4.0])
def test_a_share_is_the_mean_over_rings_and_spokes(seen: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """24 distances of equal probability of a normal error in a plane, each in 24 directions."""
    monkeypatch.setattr(matters_module, "capture_probability", lambda _, lateral, axial, angle: lateral + axial + angle)
    own = [0.0, 0.25, 3.0]
    away = [seen * math.sqrt(2.0 * math.log(1.0 / (1.0 - (k + 0.5) / 24))) for k in range(24)]
    turns = [math.radians(15.0 * k + 7.5) for k in range(24)]
    each = [math.hypot(o + r * math.cos(t), r * math.sin(t)) for o in own for r in away for t in turns]
    assert pick_share(load_gripper("li_cup"), own, seen) == pytest.approx(1e-3 * sum(each) / len(each), rel=1e-9)
    assert PERCEPTION_MM == (0.0, 1.0, 2.0, 3.0, 5.0)
    changes = pick_changes([1.0], [3.0])
    assert [(c["gripper"], c["perception_mm"]) for c in changes] == [
        (name, seen) for name in ("li_cup", "compliant_hand") for seen in PERCEPTION_MM
    ]
    assert all(c["before"] < c["after"] for c in changes)
    assert change_cells(change("cup", 2.0, 0.512, 0.4)) == ("cup", "2", "51.2", "40.0", "-11.2")


def test_what_matters_is_said_at_its_very_limits() -> None:
    def said(*changes: tuple[str, float, float, float]) -> str:
        return matters("arm", [change(*each) for each in changes])

    assert said(("a", 0.0, 0.0, 0.03), ("b", 2.0, 0.5, 0.48)) == (
        "On arm this changes no more than 3 of 100 picks, with any gripper and however well the fruit is seen; most "
        "with a and the fruit seen without error: 0 % taken without, 3 % with calibration."
    )
    assert "no more than 4 of 100" in said(("a", 0.0, 0.0, 0.0301))
    assert "no more than 0 of 100" in said(("a", 0.0, 0.5, 0.5))
    assert said(("a", 0.0, 0.0, 0.05), ("b", 1.0, 1.0, 0.25), ("b", 0.0, 0.25, 0.75)) == (
        "On arm this changes picks with b and the fruit seen to 1 mm per axis: 100 % taken without, 25 % with "
        "calibration; with a and the fruit seen without error: 0 % taken without, 5 % with calibration."
    )
    assert said(("a", 2.0, 0.2, 0.8), ("a", 0.0, 0.0, 0.005), ("b", 2.0, 0.5, 0.52), ("b", 0.0, 0.5, 0.5)) == (
        "On arm this changes picks with a and the fruit seen to 2 mm per axis: 20 % taken without, 80 % with "
        "calibration. Were the fruit seen without error, it would change hardly any (0 % taken without, 0 % with "
        "calibration). Hardly a pick changes with b (50 % taken without, 52 % with calibration)."
    )
    assert "would change none" in said(("a", 2.0, 0.2, 0.8), ("a", 0.0, 0.0, 0.004))
    assert "Were the fruit" not in said(("a", 2.0, 0.2, 0.8), ("a", 0.0, 0.0, 0.05))


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    plant, rng = load_plant("qiao2026"), np.random.default_rng(0)
    rows = simulated_tracker(plant, random_joints(plant.arm.nominal, 60, rng), rng)
    return fit(plant.arm, rows, known_frames=True).calibration.save(tmp_path_factory.mktemp("known") / "known.npz")


def test_no_contender_is_corrected_twice(known):
    with pytest.raises(InputError, match="is a calibration already"):
        contenders_of([known], [known])
    with pytest.raises(InputError, match="policy 'oracle' corrects the arm itself"):
        contenders_of(["scripted", "oracle"], [known])
    assert len(contenders_of(["scripted", "oracle"], [known, "none"])) == 2
