"""The core works without any extra, and where one is missing one sentence says which and how to get it."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from pickenv.base import EXTRAS, InputError, extra_of, extras, require

ROOT = Path(__file__).parents[2]

BLOCKED = """
import sys
from importlib.abc import MetaPathFinder

class Gone(MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in {modules!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
        return None

import importlib.util
found = importlib.util.find_spec
importlib.util.find_spec = lambda name, package=None: None if name.partition(".")[0] in {modules!r} else found(name)
sys.meta_path.insert(0, Gone())
"""
ALL = tuple(module for modules in EXTRAS.values() for module in modules)


def without(modules: tuple[str, ...], code: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run code in an interpreter that cannot find these modules."""
    text = BLOCKED.format(modules=modules) + code
    return subprocess.run([sys.executable, "-c", text], cwd=cwd, capture_output=True, text=True, check=False)


def command(*words: str) -> str:
    return f"import sys; sys.argv = ['pickenv', *{words!r}]\nfrom pickenv.cli import main\nmain()"


CORE = """
import gymnasium, numpy as np, pickenv
from pickenv.agents import ScriptedReach, episode_seeds, run_reaches
from pickenv.calibration import random_joints, simulated_tracker
plant, rng = pickenv.load_plant("qiao2026"), np.random.default_rng(0)
train, test = (simulated_tracker(plant, random_joints(plant.arm.nominal, n, rng), rng) for n in (60, 20))
result = pickenv.calibrate(plant.arm, train, test=test)
result.save("arm.npz")
read = pickenv.Calibration.load("arm.npz")
env = pickenv.wrappers.CompensationWrapper(gymnasium.make("pickenv/Reach-v0"), read.compensator())
reaches = run_reaches(env, ScriptedReach(env), episode_seeds(0, 10))
vector = gymnasium.make_vec("pickenv/Reach-v0", 4)
vector.reset(seed=0)
vector.step(vector.action_space.sample())
for name in ("Pick", "Harvest"):
    gymnasium.make(f"pickenv/{name}-v0").reset(seed=0)
loaded = {module.partition(".")[0] for module in sys.modules}
print(f"{reaches.position_error_mm.mean():.3f} mm", *sorted(loaded & set(EXTRA)))
"""


@pytest.mark.slow
def test_the_core_calibrates_corrects_and_picks_without_any_extra(tmp_path: Path) -> None:
    done = without(ALL, f"EXTRA = {ALL!r}\n{CORE}", tmp_path)
    assert done.returncode == 0, done.stderr
    miss, unit = done.stdout.split()
    assert unit == "mm"
    assert float(miss) < 0.8  # raw: 1.9


MAKE = "import gymnasium, pickenv\ngymnasium.make"


NEEDS = [
    ("torch", MAKE + "_vec('pickenv/Reach-v0', 2, executor='torch')"),
    ("llvmlite", MAKE + "_vec('pickenv/Reach-v0', 2, executor='compiled')"),
    ("matplotlib", MAKE + "('pickenv/Reach-v0', render_mode='rgb_array')"),
    ("matplotlib", MAKE + "_vec('pickenv/Reach-v0', 2, render_mode='rgb_array')"),
    ("rerun", "import pickenv\npickenv.inspect.LogRerun"),
    ("stable_baselines3", "import pickenv\npickenv.wrappers.make_sb3_vec"),
    ("stable_baselines3", "import pickenv\npickenv.agents.train"),
    ("pyarrow", "import pickenv\npickenv.experiments.run_study"),
    ("skimage", "import numpy as np\nfrom pickenv.orchard import fruit_mask\nfruit_mask(None, np.eye(3))"),
    (
        "rosbags",
        "from pathlib import Path\nfrom pickenv.calibration.reading.table_files import read_log\n"
        "Path('run.mcap').touch()\nread_log(Path('run.mcap'), '/joint_states')",
    ),
    ("cv2", "from pickenv.calibration.camera.boards import opencv\nopencv()"),
]
RAISED = """
import traceback
for code in {codes!r}:
    try:
        exec(code, {{}})
        print("nothing was missed")
    except Exception as error:
        print(*traceback.format_exception_only(error), end="")
"""


def test_a_missing_package_is_one_sentence_with_the_command_that_installs_it(tmp_path: Path) -> None:
    """Of each that is asked for, where no extra is installed."""
    done = without(ALL, RAISED.format(codes=[code for _, code in NEEDS]), tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        f"pickenv.base.extras.MissingExtra: this needs {module}, which is not installed; "
        f"get it with: pip install 'pickenv[{extra_of(module)}]'"
        for module, _ in NEEDS
    ]


GONE = {
    "matplotlib": ("calibrate", "rows.csv", "--arm", "ur5", "--report", "page.html"),
    "rerun": ("inspect", "errors.rrd"),
    "minari": ("datasets", "--out", "sets"),
}
GONE_TOO = {
    "jinja2": ("calibrate", "rows.csv", "--arm", "ur5", "--run", "run"),
    "stable_baselines3": ("train", "--out", "run"),
    "h5py": ("datasets", "--out", "sets"),
}
TYPED = """
import sys
from pickenv.cli import main
for words in {commands!r}:
    sys.argv = ["pickenv", *words]
    try:
        main()
    except SystemExit as error:
        print(error.code)
"""


@pytest.mark.parametrize(
    "gone",
    [
        GONE,
        *(
            pytest.param(gone, marks=pytest.mark.slow)
            for gone in (GONE_TOO, {"matplotlib": ("board", "charuco_a4", "--out", "board.pdf")})
        ),
    ],
)
def test_a_command_says_so_and_ends_as_after_bad_input(gone: dict[str, tuple[str, ...]], tmp_path: Path) -> None:
    (tmp_path / "errors.rrd").write_bytes(b"RRF2")
    done = without(tuple(gone), TYPED.format(commands=list(gone.values())), tmp_path)
    assert [line for line in done.stdout.splitlines() if line.isdigit()] == ["2"] * len(gone)
    for module, said in zip(gone, done.stderr.strip().splitlines(), strict=True):
        assert re.fullmatch(rf"error: this needs {module}, .*pip install 'pickenv\[{extra_of(module)}\]'", said)


def test_a_module_of_no_extra_is_a_fault_and_no_missing_extra(tmp_path: Path) -> None:
    done = without(("tomllib",), command("calibrate", "rows.csv", "--arm", "ur5"), tmp_path)
    assert done.returncode == 70


def test_what_is_there_is_not_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    require("numpy", "scipy")
    monkeypatch.setitem(sys.modules, "numpy", None)
    with pytest.raises(ImportError, match="numpy"):
        require("numpy")
    assert extra_of("torch.nn") == "learn"
    assert extra_of("scipy") is None
    assert isinstance(extras.missing("cv2"), InputError)


def test_a_face_hides_no_other_error(tmp_path: Path) -> None:
    done = without(("pydantic",), "import pickenv\npickenv.load_arm('ur5')", tmp_path)
    assert done.stderr.strip().splitlines()[-1] == "ModuleNotFoundError: No module named 'pydantic'"
