"""A specification that can be written down: paths among an environment's arguments stand in it as text."""

from __future__ import annotations

import copy
from pathlib import PurePath

from gymnasium.envs.registration import EnvSpec


class PlainSpec:
    """An environment, single or vector, whose `spec.to_json()` works whatever files were given as paths."""

    _spec: EnvSpec | None = None

    @property
    def spec(self) -> EnvSpec | None:
        """What it was made by."""
        return self._spec

    @spec.setter
    def spec(self, given: EnvSpec | None) -> None:
        if given is not None and any(isinstance(value, PurePath) for value in given.kwargs.values()):
            given = copy.copy(given)
            given.kwargs = {
                key: str(value) if isinstance(value, PurePath) else value for key, value in given.kwargs.items()
            }
        self._spec = given
