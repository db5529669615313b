"""One door for every kind of extension: names, packages of others, and what a saved file says of them."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from pickenv.base import InputError, register, registry


@pytest.fixture(autouse=True)
def door(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """What a test registers or imports is forgotten afterwards."""
    for kind in registry.KINDS:
        registry.names(kind)  # what ships registers itself once, when it is imported
    modules = set(sys.modules)
    monkeypatch.setattr(registry, "_entries", {kind: dict(entries) for kind, entries in registry._entries.items()})
    yield
    for module in {name for name in sys.modules if name.startswith("stranger")} - modules:
        del sys.modules[module]


Install = Callable[..., None]


@pytest.fixture
def install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Install:
    """Install a package of one module: what pip leaves behind, on the path."""

    def put(package: str, version: str, module: str, source: str, points: str) -> None:
        folder = tmp_path / package
        info = folder / f"{package.replace('-', '_')}-{version}.dist-info"
        info.mkdir(parents=True)
        (folder / f"{module}.py").write_text(source)
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: {version}\n")
        (info / "entry_points.txt").write_text(points)
        (info / "top_level.txt").write_text(f"{module}\n")
        monkeypatch.syspath_prepend(folder)

    return put


FOREST = "class Forest:\n    pass\n"
POINTS = "[pickenv.residual]\nforest = stranger_forest:Forest\n"


def test_a_package_is_imported_when_its_name_is_asked_for(install: Install) -> None:
    install("forest-for-pickenv", "1.2", "stranger_forest", FOREST, POINTS)
    assert registry.names("residual")[-1] == "forest"
    assert registry.origin("residual", "forest") == registry.Origin("forest-for-pickenv", "1.2")
    assert "stranger_forest" not in sys.modules
    assert registry.get("residual", "forest").__name__ == "Forest"
    assert registry.get("residual", "forest", package="forest-for-pickenv", version="1.1").__name__ == "Forest"
    assert registry.origin("residual", "forest") == registry.Origin("forest-for-pickenv", "1.2")


def test_what_ships_comes_first_and_others_are_sorted(monkeypatch: pytest.MonkeyPatch) -> None:
    packages = registry.metadata.packages_distributions()  # a third of a second, and asked for at each registration
    monkeypatch.setattr(registry.metadata, "packages_distributions", lambda: packages)
    for kind in registry.KINDS:
        own = [name for name in registry.names(kind) if registry.origin(kind, name).package == "pickenv"]
        others = set(registry.names(kind)) - set(own)
        register(kind, "zebra")(Path)
        register(kind, "aardvark")(Path)
        assert own and registry.names(kind) == (*own, *sorted({*others, "aardvark", "zebra"}))


def test_code_of_no_package_says_its_module() -> None:
    @register("policy", "lazy")
    def lazy() -> None:
        """Do nothing."""

    assert registry.origin("policy", "lazy") == registry.Origin("", "", lazy.__module__)
    assert registry.get("policy", "lazy", module=lazy.__module__) is lazy


@pytest.mark.parametrize("name", ["", "two words", "a.b", "naïve", "a/b", "../up"])
def test_a_name_is_a_word(name: str) -> None:
    with pytest.raises(InputError, match="is no name; take letters"):
        register("residual", name)


def test_an_unknown_kind_is_refused() -> None:
    for ask in (
        lambda: register("engine", "v8"),
        lambda: registry.names("engine"),
        lambda: registry.get("engine", "v8"),
    ):
        with pytest.raises(InputError, match="there is no kind 'engine' of extension; give one of arm_format, instru"):
            ask()


def test_a_value_is_refused() -> None:
    with pytest.raises(InputError, match="backend 'jax' is neither a class nor a function; register what makes it"):
        register("backend", "jax")(3.0)  # type: ignore[type-var]


def test_a_name_that_another_package_holds_is_refused(install: Install) -> None:
    install("forest-for-pickenv", "1.2", "stranger_forest", FOREST, POINTS)
    with pytest.raises(InputError, match=r"'forest' is held by the package forest-for-pickenv 1\.2; take another name"):
        register("residual", "forest")(Path)


def test_a_package_may_register_itself_again(install: Install) -> None:
    source = f"import pickenv\n@pickenv.register('residual', 'forest')\n{FOREST}"
    install("forest-for-pickenv", "1.2", "stranger_forest", source, POINTS)
    assert registry.get("residual", "forest").__name__ == "Forest"
    assert registry.origin("residual", "forest") == registry.Origin("forest-for-pickenv", "1.2")


def test_two_packages_of_one_name_are_refused_only_when_asked_for(install: Install) -> None:
    install("forest-for-pickenv", "1.2", "stranger_forest", FOREST, POINTS)
    install("wood", "2.0", "stranger_wood", FOREST, POINTS.replace("stranger_forest", "stranger_wood"))
    assert registry.names("residual").count("forest") == 1
    with pytest.raises(InputError, match=r"by the package wood 2\.0 and by the package forest-for-pickenv 1\.2"):
        registry.get("residual", "forest")


def test_a_broken_package_breaks_itself_alone(install: Install) -> None:
    install("forest-for-pickenv", "1.2", "stranger_forest", "import nothing_of_this_name", POINTS)
    assert "forest" in registry.names("residual")
    message = r"'forest' of the package forest-for-pickenv 1\.2 cannot be loaded \(ModuleNotFoundError: .*\); mend or"
    with pytest.raises(InputError, match=message):
        registry.get("residual", "forest")


def test_what_is_absent_is_refused_with_what_there_is() -> None:
    register("gripper", "claw")(Path)
    with pytest.raises(InputError, match=r"there is no gripper 'claws'; give one of .*claw"):
        registry.get("gripper", "claws")


def test_what_a_file_needs_is_refused_with_its_package(install: Install) -> None:
    message = (
        r"^residual 'forest' comes from the package forest-for-pickenv 1\.2, which is not installed: "
        r"pip install forest-for-pickenv$"
    )
    with pytest.raises(InputError, match=message):
        registry.get("residual", "forest", package="forest-for-pickenv", version="1.2")
    with pytest.raises(InputError, match="comes from the module fit_forest, which is of no package: import it first"):
        registry.get("residual", "forest", module="fit_forest")
    install("forest-for-pickenv", "1.3", "stranger_forest", FOREST, "")
    with pytest.raises(InputError, match=r"another version that lacks it: pip install forest-for-pickenv==1\.2"):
        registry.get("residual", "forest", package="forest-for-pickenv", version="1.2")


def test_what_a_file_needs_is_not_taken_from_another_package(install: Install) -> None:
    install("wood", "2.0", "stranger_wood", FOREST, POINTS.replace("stranger_forest", "stranger_wood"))
    with pytest.raises(InputError, match=r"comes from the package forest-for-pickenv 1\.2, but here from .* wood 2\.0"):
        registry.get("residual", "forest", package="forest-for-pickenv", version="1.2")


def test_packages_that_extend_are_named_with_their_versions(install: Install) -> None:
    before = registry.packages()
    install("forest-for-pickenv", "1.2", "stranger_forest", FOREST, POINTS)
    assert registry.packages() == before | {"forest-for-pickenv": "1.2"}
    kind = registry.get("residual", "forest")
    assert registry.registered_as(kind) == ("residual", "forest") and registry.registered_as(Path) is None


def test_what_cannot_be_loaded_is_left_aside_with_a_warning(install: Install) -> None:
    install("forest-for-pickenv", "1.2", "stranger_forest", "import nothing_of_this_name", POINTS)
    with pytest.warns(UserWarning, match=r"'forest' of the package forest-for-pickenv 1\.2 cannot be loaded"):
        assert "forest" not in registry.load_all("residual")
    install(
        "greedy", "1.0", "stranger_greedy", FOREST, POINTS.replace("forest = stranger_forest", "gp = stranger_greedy")
    )
    with pytest.warns(UserWarning, match="'gp' of the package greedy 1.0 is left aside: pickenv ships that name"):
        registry.names("residual")
    assert registry.origin("residual", "gp").package == "pickenv"
