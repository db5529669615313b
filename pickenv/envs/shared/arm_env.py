"""Base classes of single environments: rendering, and one arm with its task, true arm and compensator."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array, Geometry, Plant, Scalar, Scalars, plant_at, plants_on
from pickenv.base import InputError, is_there, require
from pickenv.envs.shared import simulation
from pickenv.envs.shared.backends import FLOATS, NUMPY, Executor
from pickenv.envs.shared.simulation import ArmState
from pickenv.envs.shared.situation import drawn_start
from pickenv.envs.shared.spaces import PlainSpec
from pickenv.envs.shared.task import Compensate, Task, check_choice, exact_plant
from pickenv.pictures import shapes
from pickenv.pictures.stage import Dial, Mesh, Pixels, Rgb, Stage, seen_along

# What environments that can be drawn have in common: render modes, pictures, and the window that shows them.


RENDER_MODES = ("human", "rgb_array")


class DrawnEnv(PlainSpec, gym.Env[Any, NDArray[Any]]):
    """Base class of environments that can be rendered; subclasses return what to draw from `_stage`.

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
        """Draw the true arms, their ghosts (the arms as the controller believes them to be), and the fruit.

        Returns:
            An RGB array ``(height, width, 3)`` with the render mode "rgb_array". None with "human", which shows a
            window, and without a render mode.
        """
        if self.render_mode is None:
            gym.logger.warn(
                "render does nothing without a render_mode; make the environment with 'rgb_array' or 'human'"
            )
            return None
        from pickenv.pictures.drawers import Window

        picture = self._picture()
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

    def _picture(self) -> Pixels:
        """Draw the environment as it is now, as RGB pixels ``(height, width, 3)``."""
        return drawn(self._stage())

    def _stage(self) -> Stage | None:
        """Return the contents of the picture to draw, or None before the first reset."""
        raise NotImplementedError


def checked_render_mode(mode: str | None, modes: tuple[str, ...]) -> str | None:
    """Check that a render mode is one of ``modes`` and that matplotlib is installed, and return it.

    Raises:
        InputError: If the mode is unknown.
        MissingExtra: If a mode is given and matplotlib is not installed.
    """
    if mode is not None:
        check_choice("render_mode", mode, modes)
        require("matplotlib")
    return mode


Begun = TypeVar("Begun")


def begun(state: Begun | None, method: str) -> Begun:
    """Return ``state``, which is None until the first episode begins.

    Raises:
        InputError: If ``state`` is None; the message names the ``method`` that was called too early.
    """
    if state is None:
        raise InputError(f"{method} was called before reset; call reset first")
    return state


def drawn(stage: Stage | None) -> Pixels:
    """Draw a stage, as RGB pixels ``(height, width, 3)``.

    Raises:
        InputError: If ``stage`` is None, since no episode has begun.
    """
    from pickenv.pictures.drawers import painted

    return painted(begun(stage, "render"))


Information = dict[str, Any]
Options = dict[str, Any] | None
EXECUTORS = {"auto": FLOATS, "floats": FLOATS, "compiled": FLOATS, "numpy": NUMPY}
"""Arithmetic for each value of the argument `executor`. If steps are compiled, episodes still begin on floats."""


class ArmEnv(DrawnEnv):
    """An environment of one arm.

    Attributes:
        task: The task that the environment simulates.
        plant: The true arm.
        compensator: Function from joint targets to joint commands, or None.
        look: Function that simulates a period and returns what is measured and true then: `simulation.look`, or
            another function with the same arguments.
    """

    look: Callable[..., Any] = staticmethod(simulation.look)

    def __init__(self, task: Task, render_mode: str | None, executor: str) -> None:
        check_choice("executor", executor, tuple(EXECUTORS))
        super().__init__(render_mode)
        self.task: Task = task
        self.metadata = {**type(self).metadata, "render_fps": task.situation.frames_per_second}
        self._x: Executor = EXECUTORS[executor]
        shipped = all(type(effect).__module__.startswith("pickenv.") for effect in task.plant.effects)
        fixed = task.arms == "fixed"  # the numbers of one arm are constants of the code
        self._compiled: Any = None
        if executor == "compiled" and not fixed:
            raise InputError("a population of arms is not compiled; give executor='floats'")
        if executor == "compiled" or (executor == "auto" and shipped and fixed and is_there("llvmlite")):
            require("llvmlite")
            from pickenv.envs.shared.compiled_look import CompiledLook

            self._compiled = CompiledLook(self.look, task)
        self.plant: Plant = task.plant if fixed else plant_at(task.plant, 0)
        if self._x is NUMPY:
            self.plant = exact_plant(self.plant)
        self.compensator: Compensate | None = None
        self._state: ArmState | None = None
        self._arm: int | None = None
        self._key: Scalar = 0
        self._step = 0

    @property
    def joint_target(self) -> Array:
        """Nominal joint target ``(n,)``, the sum of the actions so far, rad or m."""
        return np.array(self.task.middle if self._state is None else self._plain(self._state.target))

    @property
    def arm(self) -> int:
        """Index (from 0) of the true arm in its population; 0 for a fixed arm."""
        return self._arm or 0

    @property
    def increment(self) -> Array:
        """Largest increment of each joint in one action, rad or m."""
        return np.array(self.task.increment)

    def _use_arm(self, number: int) -> None:
        """Use the arm with the index ``number`` (from 0) in the population as the true arm."""
        self._arm = number
        if self._x is FLOATS:
            self.plant = plant_at(self.task.plant, number)
        else:
            self.plant = exact_plant(plants_on(self.task.plant, lambda values: values[number : number + 1]))

    def _start(self, joints: Any) -> Scalars:
        """Return the joint target at the start: ``joints`` if given, drawn if the task has a spread, else mid-range."""
        task = self.task
        if joints is not None:
            return self._numbers(task.given_joints("start_joints", joints).tolist())
        if task.situation.spread:
            return drawn_start(self._x, task.situation, self._key, *task.box)
        return self._numbers(task.middle)

    def _command(self, target: Scalars) -> Scalars:
        """Compute the joint command for a joint target, with the compensator if there is one."""
        if self.compensator is None:
            return target
        joints = np.array(self._plain(target))
        fast = self.compensator if self._compiled is None else self._compiled.fast(self.compensator)
        # On NumPy as one of many, which is corrected in another order of operations than one alone.
        command = fast(joints) if self._x is FLOATS and fast is self.compensator else fast(joints[None])[0]
        return self._numbers(command.tolist())

    def _looked(self, state: ArmState, moment: int, dt: Scalar) -> tuple[Any, Scalars]:
        """Simulate ``dt`` seconds at the joint target of ``state``; return what `look` measures, and the joint command.

        ``moment`` is the number of steps in the episode so far, 0 at its start.
        """
        command = self._command(state.target)
        if self._compiled is not None and dt != 0.0:
            self._state, view = self._compiled(state, command, self._key, moment, self.arm)
        else:
            word = self._word(moment)
            self._state, view = self.look(self._x, self.task, self.plant, state, command, self._key, word, dt)
        return view, command

    def _numbers(self, values: Sequence[float]) -> Scalars:
        """Convert floats to the executor's form: floats, or NumPy arrays of one number."""
        return values if self._x is FLOATS else [np.array([value]) for value in values]

    def _plain(self, values: Scalars) -> list[float]:
        """Convert the executor's numbers to floats."""
        if self._x is FLOATS:
            return list(values)
        return [float(value[0]) if isinstance(value, np.ndarray) else float(value) for value in values]

    def _word(self, number: int) -> Scalar:
        return number if self._x is FLOATS else np.array([number], dtype=np.uint64)


# One arm at work as a stage to draw: the true arm, the ghost of where its controller believes it to be, its base.
# What the environments of one arm add to it stands beside them. Units: m; mm in words and on the dial.


MARK: Rgb = (0, 114, 178)
GHOST_WORDS = f"ghost: the arm as believed, deviation × {shapes.GAIN}"


def standing(geometry: Geometry, ground: float, dark: bool) -> tuple[Mesh, ...]:
    """Return the meshes of the ground at height ``ground``, m, and of the pedestal under the arm's base."""
    x, y, _ = geometry.base.position.tolist()
    return shapes.ground_around(x, y, ground, dark), shapes.pedestal(geometry, ground)


def tool_dial(axis: Array, offset: Array, tolerance_mm: float) -> Dial:
    """Return the dial that shows the tool's true offset from the fruit, seen along the tool's axis.

    Args:
        axis: Unit vector along the tool's true axis ``(3,)``, base frame.
        offset: The tool's true position minus the fruit's ``(3,)``, m, base frame.
        tolerance_mm: Radius of the ring on the dial, mm.
    """
    across_mm = 1e3 * seen_along(axis, offset, np.array([0.0, -1.0, 0.0]))
    return Dial(across_mm[None], tolerance_mm, MARK)
