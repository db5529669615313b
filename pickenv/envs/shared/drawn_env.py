"""What environments that can be drawn have in common: render modes, pictures, and the window that shows them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium as gym
from numpy.typing import NDArray

from pickenv.envs.shared.plain_spec import PlainSpec
from pickenv.envs.shared.task import check_choice
from pickenv.errors import InputError
from pickenv.extras import require

if TYPE_CHECKING:
    from pickenv.pictures.stage import Pixels, Stage

RENDER_MODES = ("human", "rgb_array")


class DrawnEnv(PlainSpec, gym.Env[Any, NDArray[Any]]):
    """An environment that can be seen; `_stage` says what there is to see, once an episode has begun.

    Attributes:
        render_mode: None, "human" or "rgb_array".
        dark: Whether pictures have a dark background; it can be changed at any time.
    """

    metadata = {"render_modes": list(RENDER_MODES), "render_fps": 10}  # noqa: RUF012

    def __init__(self, render_mode: str | None) -> None:
        self.render_mode = checked_render_mode(render_mode, RENDER_MODES)
        self.dark = False
        self._window: Any = None

    def render(self) -> Any:
        """Draw arms, the ghost of where the controller believes them to be, and fruit: an RGB array, or a window."""
        if self.render_mode is None:
            gym.logger.warn(
                "render does nothing without a render_mode; make the environment with 'rgb_array' or 'human'"
            )
            return None
        from pickenv.pictures.show_window import Window

        picture = drawn(self._stage())
        if self.render_mode == "rgb_array":
            return picture
        self._window = self._window or Window(self.metadata["render_fps"])
        self._window.show(picture)
        return None

    def close(self) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None

    def _stage(self) -> Stage | None:
        """What there is to see; None before the first reset."""
        raise NotImplementedError


def checked_render_mode(mode: str | None, modes: tuple[str, ...]) -> str | None:
    """The render mode, which is known and for which all that draws is there.

    Raises:
        InputError: If it is unknown.
        MissingExtra: If what draws is not installed.
    """
    if mode is not None:
        check_choice("render_mode", mode, modes)
        require("matplotlib")
    return mode


def drawn(stage: Stage | None) -> Pixels:
    """The picture of a stage.

    Raises:
        InputError: If there is none, since no episode has begun.
    """
    from pickenv.pictures.drawers import painted

    if stage is None:
        raise InputError("render was called before reset; call reset first")
    return painted(stage)
