"""Recipes of other clients: each is code, has its row and its packages, and runs where its client is installed."""

import ast
import json
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / ".ci" / "clients"))
import run_clients

CLIENTS = run_clients.clients()
PAGE = run_clients.PAGE.read_text(encoding="utf-8")
TRAINED = re.compile(r"(?:steps = |steps, epochs = |--n-timesteps )([\d_]+)")


def test_every_client_has_a_recipe_and_every_recipe_its_client() -> None:
    headings = [line[3:] for line in PAGE.splitlines() if line.startswith("## ")]
    recipes = [
        heading for heading in headings if run_clients.BLOCK.search(PAGE.split(f"## {heading}\n")[1].split("\n## ")[0])
    ]
    assert recipes == [client["heading"] for client in CLIENTS.values()]
    for client in CLIENTS.values():
        assert all("==" in package for package in client["packages"])
        blocks = run_clients.recipe(client["heading"])
        assert blocks[-1][0] == "python" and "reaches_behind" in blocks[-1][1]
        for language, text in blocks:
            if language == "python":
                ast.parse(text)


def test_short_runs_are_short_everywhere() -> None:
    for client in CLIENTS.values():
        blocks = [text for _, text in run_clients.recipe(client["heading"])]
        changed = [run_clients.shortened(text) for text in blocks]
        assert sum(str(run_clients.SHORT) in text for text in changed) == 1 and blocks != changed


def test_blocks_are_run_by_the_clients_own_python() -> None:
    blocks = [
        ("sh", "python -m rl_zoo3.train --kwargs plant:\"'ideal'\"\npickenv datasets --out d\n"),
        ("python", "x = 1\n"),
    ]
    first, second, third = run_clients.commands(blocks, "/its/python")
    assert first == ["/its/python", "-W", "ignore", "-m", "rl_zoo3.train", "--kwargs", "plant:'ideal'"]
    assert second == ["/its/python", "-W", "ignore", "-m", "pickenv.cli", "datasets", "--out", "d"]
    assert third[-1] == "x = 1\n"


def test_the_table_of_the_page_is_what_was_printed() -> None:
    """Rows of `run_clients.py --json`, of the recipes as they stand there now."""
    rows = {row["client"]: row for row in json.loads((run_clients.HERE / "clients.json").read_text("utf-8"))}
    lines = [line for line in PAGE.splitlines() if line.startswith("| [")]
    assert len(lines) == len(CLIENTS) and len(rows) >= 6
    for line, (name, client) in zip(lines, CLIENTS.items(), strict=True):
        heading, version, _, steps, *numbers, seconds = [cell.strip() for cell in line.strip("|").split("|")]
        assert f"[{client['heading'].partition(',')[0]}]" in heading
        assert not client["packages"] or any(package.endswith(f"=={version}") for package in client["packages"])
        texts = "".join(text for _, text in run_clients.recipe(client["heading"]))
        assert steps in [f"{int(each):_}".replace("_", " ") for each in re.findall(TRAINED, texts)]
        if name not in rows:  # the page says that it was run in short only
            assert [*numbers, seconds] == [""] * 4 and "in short only" in PAGE
            continue
        recipe = run_clients.recipe_hash(client["packages"], run_clients.recipe(client["heading"]))
        assert rows[name]["recipe"] == recipe and not rows[name]["quick"]
        assert numbers == [f"{rows[name][key]:.2f}" for key in ("raw", "ls", "ls_bpnn")]
        assert seconds == f"{rows[name]['processor_s']:.0f}"


@pytest.mark.slow
@pytest.mark.parametrize("name", CLIENTS)
def test_a_recipe_trains_where_its_client_is_installed(name: str, tmp_path: Path) -> None:
    """In short: what a whole training reaches stands on the page."""
    if find_spec(CLIENTS[name]["module"]) is None:  # not imported here: some change Gymnasium for the whole process
        pytest.skip(f"{name} is not installed; .ci/clients/run_clients.py --client {name} sets it up and runs it")
    said = ""
    blocks = [(kind, run_clients.shortened(text)) for kind, text in run_clients.recipe(CLIENTS[name]["heading"])]
    for command in run_clients.commands(blocks, sys.executable):
        done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        said += done.stdout
    assert [key for key, _ in run_clients.PRINTED.findall(said)] == ["raw", "ls", "ls_bpnn"]
