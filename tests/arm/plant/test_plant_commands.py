"""`pickenv iso9283` and `pickenv effects`, as people call them: a table to read, and the same numbers as JSON."""

import json

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from pickenv.arm import causes_of, largest_cube, load_arm, load_plant, shipped_arms
from pickenv.base import InputError
from pickenv.calibration import fit, random_joints, simulated_tracker
from pickenv.commands import plants

app = typer.Typer()
app.command()(plants.arms)
app.command()(plants.effects)
app.command()(plants.iso9283)


def call(*words):
    done = CliRunner().invoke(app, [str(word) for word in words])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == 0, done.output
    return done.output


@pytest.fixture(scope="module")
def calibration(tmp_path_factory):
    plant, rng = load_plant("qiao2026"), np.random.default_rng(0)
    measurements = simulated_tracker(plant, random_joints(plant.arm.nominal, 60, rng), rng)
    return fit(plant.arm, measurements, known_frames=True).calibration.save(tmp_path_factory.mktemp("fit") / "arm.npz")


def test_iso9283_prints_and_writes_the_raw_and_the_calibrated_arm(calibration, tmp_path, monkeypatch):
    cube = largest_cube(load_plant("qiao2026").arm.nominal)
    monkeypatch.setattr("pickenv.arm.plant.iso9283.largest_cube", lambda geometry: cube)
    file = tmp_path / "iso.json"
    words = ("iso9283", "--plant", "qiao2026", "--calibration", calibration, "--cycles", 2, "--json", file)
    said = call(*words)
    found = json.loads(file.read_text())
    assert found["standard"] == "ISO 9283:1998" and found["settings"]["cycles"] == 2
    assert found["calibrated"]["worst_accuracy_mm"] < 0.5 * found["raw"]["worst_accuracy_mm"]
    for kind in ("raw", "calibrated"):
        performance = found[kind]
        assert f"{kind}:" in said and len(performance["poses"]) == 5
        assert sorted(performance["variation_mm"]) == ["P1", "P2", "P4"]
        assert all(f"{pose['accuracy_mm']:.3f}" in said for pose in performance["poses"])
        assert f"{performance['drift_mm']:.3f} mm" in said
    call(*words[:-1], tmp_path / "again.json")
    assert json.loads((tmp_path / "again.json").read_text()) == found
    call("iso9283", "--plant", "qiao2026", "--cycles", 2, "--seed", 1, "--json", tmp_path / "other.json")
    assert json.loads((tmp_path / "other.json").read_text())["raw"] != found["raw"]


def test_a_reservation_of_no_calibration_is_refused():
    with pytest.raises(InputError, match="`allow` goes with `calibration` only"):
        call("iso9283", "--allow", "do-not-use")


def test_arms_lists_every_shipped_arm(tmp_path):
    file = tmp_path / "arms.json"
    said = call("arms", "--json", file)
    found = {row["name"]: row for row in json.loads(file.read_text())["arms"]}
    assert list(found) == shipped_arms()
    for name, row in found.items():
        arm = load_arm(name)
        assert [kind == "P" for kind in row["joints"]] == list(arm.nominal.prismatic) and row["source"] == arm.source
        assert name in said and f"{row['reach_mm']}" in said


def test_effects_prints_and_writes_each_effects_share(tmp_path):
    file = tmp_path / "effects.json"
    said = call("effects", "--reaches", 20, "--json", file)
    orchard = load_plant("orchard")
    on = list(causes_of(orchard))
    found = json.loads(file.read_text())
    assert list(found["alone"]) == list(found["without"]) == on and found["unit"] == "mm"
    assert all(f"{share['mean']:.3f}" in said for share in (*found["alone"].values(), *found["without"].values()))
    assert f"{found['all']['mean']:.3f}" in said


@pytest.mark.parametrize("command", ["effects", "iso9283"])
def test_unknown_plants_are_refused(command):
    with pytest.raises(InputError, match="unknown plant 'peach'"):
        call(command, "--plant", "peach")
