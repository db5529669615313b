"""Every tab of a recording in rerun's own viewer: nothing complains, and what a view includes can be seen in it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from tests.browser.layout import Tab, include_rules, showing, tabs, title_of, without_rule
from tests.browser.native_viewer import Viewer, look
from tests.browser.pictures import Picture, changed_share, decode, file_name, settled


def pictures(viewer: Viewer, views: Iterable[str]) -> dict[str, Picture]:
    settled(viewer.client.take_screenshot)
    return {view: decode(viewer.client.take_screenshot(view)) for view in views}


def unseen(viewer: Viewer, tab: Tab, views: set[str]) -> list[str]:
    """Include rules of ``views`` whose entities change no pixel: taken away, the picture stays as it is."""
    layout = showing(viewer.blueprint, tab)
    whole, rules = pictures(viewer, views), {view: include_rules(layout, view) for view in views}
    found = []
    for number in range(max(map(len, rules.values()), default=0)):
        viewer.show(without_rule(layout, number))
        for view, picture in pictures(viewer, [view for view in views if number < len(rules[view])]).items():
            if changed_share(whole[view], picture) == 0.0:
                found.append(f"{tab.title}, {title_of(layout, f'view/{view}')}: {rules[view][number]}")
    return found


def walk(viewer: Viewer, screenshots: Path) -> tuple[list[str], list[str]]:
    """Bring every tab to the front and keep its picture; what complains, and what cannot be seen."""
    complaints, invisible, visited = [], [], set()
    for tab in tabs(viewer.blueprint):
        viewer.show(showing(viewer.blueprint, tab))
        png = settled(viewer.client.take_screenshot)
        (screenshots / f"native-{file_name(tab.title)}.png").write_bytes(png)
        complaints += [f"{tab.title}: {report}" for report in viewer.reports()]
        invisible += unseen(viewer, tab, set(tab.views) - visited)
        visited |= set(tab.views)
    return complaints, invisible


def test_every_tab_shows_what_it_includes_and_nothing_complains(
    recording: Path, screenshots: Path, tmp_path: Path
) -> None:
    complaints, invisible = look(recording, tmp_path / "viewer.txt", lambda viewer: walk(viewer, screenshots))
    assert complaints == []
    assert invisible == []


def test_the_layout_has_its_tabs(blueprint: dict[str, dict[str, dict[str, object]]]) -> None:
    titles = [tab.title for tab in tabs(blueprint)]
    assert len(titles) == len(set(titles)) >= 5
    assert all(titles)
