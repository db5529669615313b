"""Every tab of a recording in rerun's own viewer: nothing complains, and what a view includes can be seen in it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from tests.browser.layout import Tab, include_rules, showing, tabs, title_of, without_rule
from tests.browser.native_viewer import Viewer, look
from tests.browser.pictures import Picture, changed_share, decode, file_name, settled


def pictures(viewer: Viewer, views: Iterable[str]) -> dict[str, Picture]:
    return {view: decode(viewer.client.take_screenshot(view)) for view in views}


def changed(viewer: Viewer, before: dict[str, Picture]) -> set[str]:
    """Views that no longer look as ``before``, once the screen has come to rest where they seem to."""
    same = {view for view, now in pictures(viewer, before).items() if changed_share(before[view], now) == 0.0}
    if same:
        settled(viewer.client.take_screenshot)
        same -= {view for view, now in pictures(viewer, same).items() if changed_share(before[view], now) > 0.0}
    return set(before) - same


def unseen(viewer: Viewer, tab: Tab, seen: set[str]) -> list[str]:
    """Include rules of a tab's views whose entities change no pixel: taken away, the picture stays as it is.

    Rules in ``seen`` are trusted, and those that are seen here join them: what draws in one view draws in the next.
    """
    layout = showing(viewer.blueprint, tab)
    rules = {view: include_rules(layout, view) for view in tab.views}
    whole = pictures(viewer, [view for view in tab.views if set(rules[view]) - seen])
    found = []
    for number in range(max(map(len, rules.values()))):
        asked = {view: rules[view][number] for view in whole if number < len(rules[view])}
        asked = {view: rule for view, rule in asked.items() if rule not in seen}
        if not asked:
            continue
        viewer.show(without_rule(layout, number))
        visible = changed(viewer, {view: whole[view] for view in asked})
        seen |= {asked[view] for view in visible}
        found += [f"{title_of(layout, f'view/{view}')}: {asked[view]}" for view in set(asked) - visible]
    return found


def walk(viewer: Viewer, screenshots: Path) -> tuple[list[str], list[str]]:
    """Bring every tab to the front and keep its picture; what complains, and what cannot be seen."""
    complaints: list[str] = []
    invisible: list[str] = []
    seen: set[str] = set()
    for tab in tabs(viewer.blueprint):
        viewer.show(showing(viewer.blueprint, tab))
        png = settled(viewer.client.take_screenshot)
        (screenshots / f"native-{file_name(tab.title)}.png").write_bytes(png)
        complaints += [f"{tab.title}: {report}" for report in viewer.reports()]
        invisible += [f"{tab.title}, {rule}" for rule in unseen(viewer, tab, seen)]
    return complaints, invisible


def test_every_tab_shows_what_it_includes_and_nothing_complains(recording: Path, screenshots: Path) -> None:
    complaints, invisible = look(recording, lambda viewer: walk(viewer, screenshots))
    assert complaints == []
    assert invisible == []


def test_the_layout_has_its_tabs(blueprint: dict[str, dict[str, dict[str, object]]]) -> None:
    titles = [tab.title for tab in tabs(blueprint)]
    assert len(titles) == len(set(titles)) >= 5
    assert all(titles)
