"""The blueprint that a viewer holds, as its JSON: its tabs, and which views each of them shows."""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

Blueprint = dict[str, Any]


@dataclass(frozen=True)
class Tab:
    """One tab in front.

    Attributes:
        title: As the tab says.
        active: The child in front by container of kind Tabs; those of the way to this tab.
        views: Identities of all views on screen then, those beside the tabs among them.
    """

    title: str
    active: dict[str, str]
    views: tuple[str, ...]


def tabs(blueprint: Blueprint) -> list[Tab]:
    """Every tab of the layout, nested ones too, in order."""
    root = f"container/{blueprint['/viewport']['ViewportBlueprint']['root_container']}"
    found = [
        Tab(title, active, tuple(_views(blueprint, root, active))) for title, active in _fronts(blueprint, root, "")
    ]
    return [tab for tab in found if tab.active]


def showing(blueprint: Blueprint, tab: Tab) -> Blueprint:
    """The same layout with ``tab`` in front."""
    changed = copy.deepcopy(blueprint)
    for container, child in tab.active.items():
        changed[f"/{container}"]["ContainerBlueprint"]["active_tab"] = child
    return changed


def include_rules(blueprint: Blueprint, view: str) -> list[str]:
    """What a view includes; entities that an override hides are left out."""
    rules = _listed(blueprint[f"/view/{view}/ViewContents"]["ViewContents"]["query"])
    return [rule for rule in rules if rule.startswith("+") and not _hidden(blueprint, view, rule.removeprefix("+ "))]


def without_rule(blueprint: Blueprint, number: int) -> Blueprint:
    """The same layout where each view has lost one of its include rules, the one at ``number``."""
    changed = copy.deepcopy(blueprint)
    for part, content in changed.items():
        if part.endswith("/ViewContents"):
            lost = include_rules(blueprint, part.split("/")[2])[number : number + 1]
            query = _listed(content["ViewContents"]["query"])
            content["ViewContents"]["query"] = [rule for rule in query if rule not in lost] or ["- /**"]
    return changed


def title_of(blueprint: Blueprint, part: str) -> str:
    kind = "ViewBlueprint" if part.startswith("view/") else "ContainerBlueprint"
    return str(blueprint[f"/{part}"][kind].get("display_name", ""))


def _listed(value: str | list[str]) -> list[str]:
    """A list, which the viewer writes without brackets where it has one element."""
    return [value] if isinstance(value, str) else value


def _hidden(blueprint: Blueprint, view: str, entity: str) -> bool:
    override = blueprint.get(f"/view/{view}/ViewContents/overrides{entity}/visualizers", {})
    return override.get("EntityBehavior", {}).get("visible") is False


def _container(blueprint: Blueprint, part: str) -> tuple[str, list[str]]:
    content = blueprint[f"/{part}"]["ContainerBlueprint"]
    return content["container_kind"], _listed(content.get("contents", []))


def _fronts(blueprint: Blueprint, part: str, title: str) -> Iterator[tuple[str, dict[str, str]]]:
    """Title and choice of tabs that bring each tab below ``part`` to the front."""
    if part.startswith("view/"):
        yield title, {}
        return
    kind, children = _container(blueprint, part)
    if kind == "Tabs":
        for child in children:
            for name, active in _fronts(blueprint, child, title_of(blueprint, child)):
                yield name, {part: child} | active
        return
    inner = [front for child in children for front in _fronts(blueprint, child, title) if front[1]]
    yield from inner or [(title, {})]


def _views(blueprint: Blueprint, part: str, active: dict[str, str]) -> Iterator[str]:
    if part.startswith("view/"):
        yield part.removeprefix("view/")
        return
    kind, children = _container(blueprint, part)
    if kind == "Tabs" and children:
        content = blueprint[f"/{part}"]["ContainerBlueprint"]
        children = [active.get(part, content.get("active_tab", children[0]))]
    for child in children:
        yield from _views(blueprint, child, active)
