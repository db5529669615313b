"""Install torch: without CUDA, unless a graphics processor by NVIDIA is there or CUDA is asked for.

On Linux the build that pip takes by itself brings gigabytes of CUDA. The build without it has the same version with
"+cpu" behind, which pip takes for the newer one where PyTorch's index is named besides the usual one. Where that index
cannot be reached pip says so and takes what the usual one has.

Run: python scripts/install_torch.py [auto|cpu|cuda] [CONSTRAINTS]
"""

import platform
import shutil
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

CPU_INDEX = "https://download.pytorch.org/whl/cpu"
BUILDS = ("auto", "cpu", "cuda")
PIP = ("-m", "pip", "install", "--disable-pip-version-check", "--quiet", "-c")


def has_nvidia() -> bool:
    """Whether a driver by NVIDIA runs here."""
    return Path("/proc/driver/nvidia").exists() or shutil.which("nvidia-smi") is not None


def wanted(choice: str, nvidia: bool) -> tuple[str, str]:
    """The build, "cpu" or "cuda", and why.

    Args:
        choice: One of `BUILDS`.
        nvidia: Whether a graphics processor by NVIDIA is there.

    Raises:
        SystemExit: If the choice is none of them.
    """
    if choice not in BUILDS:
        raise SystemExit(f"'{choice}' is none of {', '.join(BUILDS)}")
    if choice != "auto":
        return choice, f"{choice} was asked for"
    if nvidia:
        return "cuda", "a driver by NVIDIA runs here; asked for cpu, this takes the small build"
    return "cpu", "no driver by NVIDIA runs here; asked for cuda, this takes the build with CUDA"


def pip_calls(build: str, system: str, constraints: str = "constraints.txt") -> list[tuple[str, ...]]:
    """Arguments of Python, one call after the other; only on Linux are there two builds.

    torch goes alone, so that PyTorch's index is asked for nothing else; what it needs comes from the usual one.
    """
    small = [(*PIP, constraints, "--retries", "1", "--no-deps", "--extra-index-url", CPU_INDEX, "torch")]
    return [*(small if (build, system) == ("cpu", "Linux") else []), (*PIP, constraints, "torch")]


def main() -> None:
    """Install, and say what was taken."""
    choice, constraints, *_ = (*sys.argv[1:], *("auto", "constraints.txt")[len(sys.argv) - 1 :])
    build, why = wanted(choice, nvidia=has_nvidia())
    for call in pip_calls(build, platform.system(), constraints):
        subprocess.run([sys.executable, *call], check=True)
    print(f"torch {version('torch')} ({why})")


if __name__ == "__main__":
    main()
