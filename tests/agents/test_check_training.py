"""`pickenv check` verifies what a training leaves behind."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from pickenv.cli import app


def checked(path: Path) -> tuple[int, str]:
    done = CliRunner().invoke(app, ["check", str(path)])
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code, done.output


def test_a_training_s_checkpoint_and_policy_are_sound(trained: Path) -> None:
    code, output = checked(trained)
    assert code == 0
    assert "checkpoint.pt: checkpoint, format" in output
    assert "policy.npz: policy, format" in output


@pytest.mark.parametrize("name", ["checkpoint.pt", "policy.npz"])
@pytest.mark.parametrize("count", [5, pytest.param(200, marks=pytest.mark.thorough)])
def test_one_flipped_bit_anywhere_is_refused(trained: Path, tmp_path: Path, name: str, count: int) -> None:
    path = Path(shutil.copy(trained / name, tmp_path))
    whole = path.read_bytes()
    for number in range(count):
        rng, content = np.random.default_rng([8, number]), bytearray(whole)
        content[rng.integers(len(content))] ^= 1 << rng.integers(8)
        path.write_bytes(content)
        code, output = checked(path)
        assert code == 3
        assert output.startswith("REFUSED") and name in output
