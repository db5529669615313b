"""A plan for a zone by the name of the method that makes it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from pickenv.errors import InputError
from pickenv.harvester.optimiser import cp_sat, local_search
from pickenv.harvester.rules import hungarian_waves, li_rule, nearest_neighbour, static_columns
from pickenv.harvester.work import Plan, Work


def assign(work: Work, method: str, rng: np.random.Generator | None = None) -> Plan:
    """A plan by the name of its method.

    Raises:
        InputError: If the method is unknown.
    """
    methods: dict[str, Callable[[Work], Plan]] = {
        "li": li_rule,
        "nearest": nearest_neighbour,
        "columns": static_columns,
        "hungarian": hungarian_waves,
        "search": lambda work: local_search(work, rng),
        "cp-sat": lambda work: cp_sat(work, rng),
    }
    if method not in methods:
        raise InputError(f"unknown assignment '{method}'; give one of {', '.join(methods)}")
    return methods[method](work)
