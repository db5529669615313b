"""Which link of a tree is the arm's flange, where nobody names one: never a finger, a wheel or a head.

From the root on, the way leads where joints move. It ends where the chain branches or where only a gripper's joints
follow; of the links that are fixed to its end, the one that its maker calls the flange is taken.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from pickenv.base import InputError, shortened

GRIPPERS = re.compile("finger|gripper|jaw|knuckle|thumb|claw|pinch|grasp", re.IGNORECASE)
"""Words in the names of joints that move a gripper."""

FLANGES = ("tool0", "flange", "attachment_site")
"""How makers call the flange, surest first: ROS-Industrial, REP 199, MuJoCo Menagerie; a prefix may stand before it."""

SIDE = 2
"""A branch is passed by where the way beside it has at least so many times its joints: wheels, a head, a pinion."""


class Carried(NamedTuple):
    """A link and what holds it: the moving joints before it, by name; none where it is fixed.

    ``only_named`` says that it is a mere mark, which is the flange only where it is called so.
    """

    link: str
    joints: tuple[str, ...]
    only_named: bool = False


def flange(children: Mapping[str, Sequence[Carried]], root: str) -> str:
    """The link to which a tool is bolted.

    Args:
        children: What stands on each link; a tree.
        root: Where the arm stands.

    Raises:
        InputError: If the tree branches into arms, or into a gripper, before anything like an arm has moved.
    """
    order = [root]
    for link in order:  # grows as it is walked
        order += [branch.link for branch in children.get(link, ())]
    hands = _hands(children, order)
    below: dict[str, int] = {}  # most joints in a row behind a link, grippers left out
    for link in reversed(order):
        below[link] = max((_length(branch, below, hands) for branch in children.get(link, ())), default=0)
    link, moved = root, 0
    while ways := sorted(
        (branch for branch in children.get(link, ()) if _length(branch, below, hands)),
        key=lambda branch: -_length(branch, below, hands),
    ):
        longest, second = _length(ways[0], below, hands), _length(ways[1], below, hands) if len(ways) > 1 else 0
        if longest < SIDE * second:
            if moved <= second:
                names = " and ".join(f"'{shortened(branch.link)}'" for branch in ways[:2])
                raise InputError(
                    f"the chain branches at link '{shortened(link)}' towards {names}; name the arm's last link, "
                    "as in file#link"
                )
            break
        link, moved = ways[0].link, moved + len(ways[0].joints)
    return _named(children, link) or _onwards(children, link)


def _hands(children: Mapping[str, Sequence[Carried]], order: Sequence[str]) -> set[str]:
    """Links behind whose joints, and before them, only joints named as a gripper's stand; none if all were."""
    found: set[str] = set()
    arms: set[str] = set()  # links behind which another joint stands
    for link in reversed(order):
        for branch in children.get(link, ()):
            if branch.link in arms or not all(map(GRIPPERS.search, branch.joints)):
                arms.add(link)
            elif branch.joints:
                found.add(branch.link)
    return found if order[0] in arms else set()


def _length(branch: Carried, below: Mapping[str, int], hands: set[str]) -> int:
    return 0 if branch.link in hands else len(branch.joints) + below[branch.link]


def _named(children: Mapping[str, Sequence[Carried]], end: str) -> str | None:
    """The link called the flange among those fixed to ``end``, and ``end`` itself."""
    fixed = [end]
    for link in fixed:
        fixed += [branch.link for branch in children.get(link, ()) if not branch.joints]
    for word in FLANGES:
        for link in fixed:
            if re.search(rf"(^|[^a-z0-9]){word}$", link, re.IGNORECASE):
                return link
    return None


def _onwards(children: Mapping[str, Sequence[Carried]], link: str) -> str:
    """From ``link`` along what is fixed to it, as long as there is one way only."""
    while True:
        ways = [branch for branch in children.get(link, ()) if not branch.only_named]
        if len(ways) != 1 or ways[0].joints:
            return link
        link = ways[0].link
