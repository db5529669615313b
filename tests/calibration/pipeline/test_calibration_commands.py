"""The commands around a calibration, as people call them: plan-poses, apply, export and the report page."""

import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

from pickenv.arm import forward, load_arm
from pickenv.base import InputError
from pickenv.calibration import BpnnSettings, Calibration, assess, fit, random_joints, simulated_tracker
from pickenv.cli import app
from pickenv.inspect import write_calibration_report


def call(*words, code=0):
    done = CliRunner().invoke(app, [str(word) for word in words])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    assert done.exit_code == code, done.output
    return done.output


@pytest.fixture(scope="module")
def folder(dynamic, tmp_path_factory):
    """A calibration with a network, its held-out data, and targets."""
    folder, rng = tmp_path_factory.mktemp("run"), np.random.default_rng(0)
    sets = [simulated_tracker(dynamic, random_joints(dynamic.arm.nominal, n, rng), rng) for n in (60, 64, 30)]
    found = fit(dynamic.arm, *sets[:2], known_frames=True, rng=rng, settings=BpnnSettings(epochs=5))
    result = assess(dynamic.arm, found, sets[0], sets[2])
    result.calibration.save(folder / "arm.npz")
    sets[2].write_csv(folder / "targets.csv")
    page = folder / "report.html"
    assert write_calibration_report(page, result, {"seed": 0}) == page
    return folder


def test_poses_are_planned_and_written(folder):
    said = call("plan-poses", "--arm", "qiao2026", "--n", 20, "--out", folder / "p.csv", "--json", folder / "p.json")
    assert "20 of 2000 candidates" in said and "wrote" in said
    found = json.loads((folder / "p.json").read_text())
    assert found["condition"] <= 37 and found["random_condition"] > 45 and found["seconds"] < 5
    assert np.loadtxt(folder / "p.csv", delimiter=",", skiprows=1).shape == (20, 6)


def test_poses_are_planned_for_targets(folder):
    words = ("--criterion", "test-poses", "--at", folder / "targets.csv", "--kind", "position", "--frames", "known")
    assert "error to expect at the test poses" in call("plan-poses", "--arm", "qiao2026", "--n", 20, *words)
    refused = CliRunner().invoke(app, ["plan-poses", "--arm", "qiao2026", "--frames", "lost"])
    assert refused.exit_code == 2 and "'lost' is not one of 'fitted', 'known'" in re.sub(r"[\s│]+", " ", refused.output)


def test_targets_become_commands(folder):
    said = call("apply", folder / "arm.npz", folder / "targets.csv", "--arm", "qiao2026", "--out", folder / "c.csv")
    assert "30 targets can be reached" in said and "standard uncertainty" in said
    header = (folder / "c.csv").read_text().splitlines()[0]
    assert header.startswith("q1_deg,q2_mm") and "uncertainty_mm" in header and "noncompensable_error_deg" in header


def test_what_cannot_be_reached_has_no_command_and_its_own_exit_code(folder):
    targets, out = folder / "poses.csv", folder / "some.csv"
    targets.write_text("x_mm,y_mm,z_mm,rx_deg,ry_deg,rz_deg\n700,-750,400,0,0,0\n5000,0,0,0,0,0\n", encoding="utf-8")
    said = call("apply", folder / "arm.npz", targets, "--arm", "qiao2026", "--out", out, code=3)
    assert "1 of 2 targets can be reached" in said and "row 3: no joints" in said
    first, second = (row.split(",") for row in out.read_text().splitlines()[1:])
    assert all(first[:6]) and first[6] == "yes"
    assert second[:6] == [""] * 6 and second[6] == "no" and "no joints" in ",".join(second)


def test_the_corrected_arm_is_exported(folder):
    for name in ("a.toml", "a.urdf"):
        said = call("export", folder / "arm.npz", "--out", folder / name)
        assert "not in the file, because no geometry can hold it: learnt residual 'bpnn'" in said and "wrote" in said
    assert load_arm(folder / "a.toml").name == "qiao2026_calibrated"
    with pytest.raises(InputError, match="does not tell what to write; give --as"):
        call("export", folder / "arm.npz", "--out", folder / "a.dat")
    with pytest.raises(InputError, match="belongs to arm"):
        call("export", folder / "arm.npz", "--arm", "ur5", "--out", folder / "b.toml")


def test_models_that_the_data_allow_are_written_side_by_side(folder):
    said = call("export", folder / "arm.npz", "--out", folder / "m.xml", "--sample", 2)
    names = ["m.xml", "m_nominal.xml", "m_1.xml", "m_2.xml"]
    assert [line.rpartition("/")[2] for line in said.splitlines() if line.startswith("wrote")] == names
    calibration = Calibration.load(folder / "arm.npz")
    found, joints = (
        load_arm(folder / "m.xml#tool").nominal,
        random_joints(calibration.identified, 20, np.random.default_rng(0)),
    )
    np.testing.assert_allclose(
        forward(found, joints).position, forward(calibration.identified, joints).position, atol=1e-8
    )
    with pytest.raises(InputError, match=r"--out would write over .*m_1\.xml, which --arm reads"):
        call("export", folder / "arm.npz", "--arm", folder / "m_1.xml", "--out", folder / "m.xml", "--sample", 2)


def test_what_is_said_of_a_file_or_a_plant_is_written_down_too(folder):
    said = call("export", folder / "arm.npz", "--out", folder / "t.urdf", "--json", folder / "t.json")
    told = json.loads((folder / "t.json").read_text(encoding="utf-8"))
    assert told["files"] == [str(folder / "t.urdf")] and len(told["notes"]) == 2
    assert said.startswith("\n".join(told["notes"]).replace("`onto`", "--onto"))
    with pytest.raises(InputError, match="does not know how sure it is; give the rows"):
        call("twin", folder / "arm.npz", "--out", folder / "w.npz")
    calibration = Calibration.load(folder / "arm.npz").without_residual()
    bare = calibration.save(folder / "bare.npz")
    said = call("twin", bare, "--out", folder / "w", "--json", folder / "w.json")
    told = json.loads((folder / "w.json").read_text(encoding="utf-8"))
    assert (told["name"], told["arm"]) == ("w", "qiao2026")
    assert told["not_identified"] == len(calibration.record["dropped"])
    assert all(note in said for note in told["notes"]) and f"{told['parameters']} parameters of arm" in said
    assert (folder / "w.npz").is_file()


def test_the_robots_own_file_is_never_written_over(folder):
    own = folder / "own.urdf"
    call("export", folder / "arm.npz", "--out", own)
    with pytest.raises(InputError, match=r"--out would write over .*own\.urdf, which --onto reads"):
        call("export", folder / "arm.npz", "--onto", f"{own}#tool", "--out", own)


def test_the_network_is_exported(folder):
    pytest.importorskip("onnx")
    assert "wrote" in call("export", folder / "arm.npz", "--out", folder / "a.onnx")
