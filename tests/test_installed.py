"""What is built and installed: one package, whose names nobody else's packages can take away."""

import os
import re
import subprocess
import sys
import sysconfig
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
OTHERS = {"openai-agents": "agents", "uncertainty-calibration": "calibration"}
"""Other people's packages, and the top-level folder that each installs."""

USE = """
import numpy as np, pickenv
from pickenv.agents import ScriptedReach
from pickenv.calibration import Choices, random_joints, simulated_tracker
assert "site-packages" in pickenv.__file__, pickenv.__file__
plant, rng = pickenv.load_plant("geometry_only"), np.random.default_rng(0)
train, test = (simulated_tracker(plant, random_joints(plant.arm.nominal, n, rng), rng) for n in (30, 12))
result = pickenv.calibrate(plant.arm, train, test=test, choices=Choices(terms="none", residual="none"))
assert result.best.mean < 0.1 < result.position["nominal"].mean, str(result)
print(ScriptedReach.__module__, result.quality.grade)
"""


ENVIRONMENT = {
    name: value for name, value in os.environ.items() if name != "PYTHONPATH"
}  # which hides what is installed


def run(*command: str | Path, cwd: Path) -> str:
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=cwd, env=ENVIRONMENT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with wheel and source distribution, and an environment that has our requirements but not us."""
    folder = tmp_path_factory.mktemp("built")
    run(sys.executable, "-m", "venv", folder / "env", cwd=folder)
    site = next((folder / "env/lib").glob("python*/site-packages"))
    (site / "requirements.pth").write_text(sysconfig.get_path("purelib") + "\n", encoding="utf-8")
    python = folder / "env/bin/python"
    tried = subprocess.run(
        [python, "-m", "pip", "install", "--quiet", "hatchling", "--target", folder / "hatchling"],
        capture_output=True,
        text=True,
        check=False,
    )
    if tried.returncode:
        pytest.skip(f"no package index to take hatchling from: {tried.stderr.strip().splitlines()[-1]}")
    tools = str(folder / "hatchling")
    code = f"import sys; sys.path.insert(0, {tools!r}); import hatchling.cli; hatchling.cli.hatchling()"
    run(sys.executable, "-c", code, "build", "-d", folder / "dist", cwd=ROOT)
    return folder


@pytest.mark.slow
def test_wheel_and_source_hold_one_package_and_every_file_of_it(built: Path) -> None:
    (wheel,), (source,) = ((built / "dist").glob(pattern) for pattern in ("*.whl", "*.tar.gz"))
    inside = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert {name.split("/")[0] for name in inside} == {"pickenv"}
    kept = run("git", "ls-files", "pickenv", "calibration", "agents", cwd=ROOT).split()
    ours = {f"pickenv/{name}" if not name.startswith("pickenv/") else name for name in kept}
    assert inside == ours - {"pickenv/calibration", "pickenv/agents"}  # the links of a checkout
    with tarfile.open(source) as archive:
        members = archive.getmembers()
    assert not [member.name for member in members if member.issym()]
    names = [member.name.partition("/")[2] for member in members]
    assert sorted(name for name in names if name.startswith("pickenv/")) == sorted(inside)
    assert not [name for name in names if name.split("/")[0] in ("calibration", "agents")]


@pytest.mark.slow
def test_an_index_is_given_the_readme_with_addresses_of_this_version(built: Path) -> None:
    (wheel,) = (built / "dist").glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (name for name in archive.namelist() if name.endswith(".dist-info/METADATA"))
        _, _, shown = archive.read(name).decode().partition("\n\n")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    home, tag = project["urls"]["Homepage"], f"v{project['version']}"
    links = re.findall(r"\]\(([^)\s]+)\)", shown)
    own = re.findall(r"\]\(([^)\s]+)\)", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert len(links) == len(own) > 30
    for link, local in zip(links, own, strict=True):
        assert link in (local, f"{home}/raw/{tag}/{local}", f"{home}/blob/{tag}/{local}")
        assert link.startswith("https://")
        assert ("/raw/" in link) == local.endswith((".gif", ".png", ".webp"))


@pytest.mark.slow
def test_other_packages_of_the_same_names_come_and_go_and_nothing_breaks(built: Path) -> None:
    python, folder = built / "env/bin/python", built
    pip = (python, "-m", "pip", "--quiet", "--disable-pip-version-check")
    (wheel,) = (built / "dist").glob("*.whl")
    site = next((built / "env/lib").glob("python*/site-packages"))
    run(*pip, "install", "--no-deps", "--force-reinstall", wheel, cwd=folder)
    first = run(python, "-c", USE, cwd=folder)
    assert first.startswith("pickenv.agents.policies.scripted ")
    run(*pip, "install", "--no-deps", *OTHERS, cwd=folder)
    assert all((site / top / "__init__.py").exists() for top in OTHERS.values())
    assert run(python, "-c", USE, cwd=folder) == first
    run(*pip, "uninstall", "--yes", *OTHERS, cwd=folder)
    assert not any((site / top / "__init__.py").exists() for top in OTHERS.values())
    assert run(python, "-c", USE, cwd=folder) == first


def test_in_a_checkout_the_folders_names_give_the_same_things() -> None:
    code = (
        "import calibration, agents, pickenv\n"
        "assert calibration.Calibration is pickenv.Calibration\n"
        "assert agents.ScriptedReach is pickenv.agents.ScriptedReach\n"
        "try:\n    import calibration.model\nexcept ModuleNotFoundError as error:\n    print(error)"
    )
    assert run(sys.executable, "-c", code, cwd=ROOT) == "No module named 'calibration.model'\n"


def test_the_face_shows_what_users_need_and_nothing_leaks() -> None:
    code = "import pickenv; print(*dir(pickenv)); print(*[name for name in dir(pickenv) if not getattr(pickenv, name)])"
    shown, missing = run(sys.executable, "-c", code, cwd=ROOT).split("\n")[:2]
    assert {"calibrate", "Calibration", "Plant", "load_arm", "load_plant", "agents", "envs", "wrappers"} <= set(
        shown.split()
    )
    assert not [name for name in shown.split() if name.startswith("_") and name != "__version__"]
    assert missing == ""
