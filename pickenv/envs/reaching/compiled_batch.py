"""Many reach tasks on NumPy arrays, with the step compiled into one pass over the environments.

Results equal `NumpyBatch`'s up to rounding. The first step traces the simulation and compiles it to machine code
(`pickenv.arm.kinematics.machine_code`). Episodes begin on NumPy.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pickenv.arm import Array, arrays_of
from pickenv.arm.kinematics.machine_code import DOUBLE, FLAG, SINGLE, WORD, Compiled, Goals, Trace, Traced
from pickenv.envs.reaching.batch import NumpyBatch, Views
from pickenv.envs.shared import simulation
from pickenv.envs.shared.arm_batch import Words, naming_effects
from pickenv.envs.shared.compiled_look import TRACER, LatestCompiled, with_numbers
from pickenv.envs.shared.task import Compensators, commanded


class CompiledBatch(NumpyBatch):
    """The state of N reach tasks, with compiled steps; arguments as in `pickenv.envs.reaching.batch.Batch`."""

    remade = ("_table", "_arms", "_code", "_fast")

    def remake(self) -> None:
        """Copy the state into one array and the true arms' numbers into another, and discard all compiled code."""
        self._table = np.array(self.columns)
        self.columns = list(self._table)
        self._arms = np.array([values for values in arrays_of(self.plant) if values.ndim == 1])
        self.plant = with_numbers(self.plant, self._arms)
        super().remake()
        self._code: dict[str, Compiled] = {}
        self._fast = LatestCompiled(self.count)

    def advance(self, actions: Array, moments: Words, compensate: Compensators | None) -> Views:
        """Act in all environments; see `pickenv.envs.reaching.batch.Batch.advance`."""
        out = self._empty(self.count)
        arrays: dict[str, NDArray[Any]] = {
            **{"columns": self._table, "arms": self._arms, "keys": self.keys, "moments": moments, "actions": actions},
            **{f"observation{i}": part for i, part in enumerate(out.observation)},
            **{"reward": out.reward, "success": out.success, "numbers": out.numbers, "vectors": out.vectors},
        }
        if compensate is None:
            self._run("step", arrays)
            return out
        self._run("act", arrays)
        targets = self._table[: self.task.joints].T
        fast = self._fast(compensate) if callable(compensate) else compensate
        arrays["commands"] = np.ascontiguousarray(commanded(fast, targets).T, dtype=float)
        self._run("look", arrays)
        return out

    def _run(self, part: str, arrays: dict[str, NDArray[Any]]) -> None:
        """Run one part of the step on ``arrays``, the inputs and outputs by name.

        The ``part`` is "act" (move the joint targets), "look" (simulate and measure), or "step" for both.
        """
        if part not in self._code:
            with naming_effects(self.plant, "compiled"):
                self._code[part] = self._compiled(part)
        self._code[part].bound(arrays, self.count)()

    def _compiled(self, part: str) -> Compiled:
        trace = Trace()
        state = self.state_of(trace.inputs("columns", len(self.columns)))
        if part != "look":
            state = simulation.act(TRACER, self.task, state, trace.inputs("actions", self.task.moves))
        if part == "act":
            goals = self._remembered(trace, state)
        else:
            command = state.target if part == "step" else trace.inputs("commands", self.task.joints)
            goals = self._looked(trace, state, command)
        return Compiled(trace, goals, self.count)

    def _remembered(self, trace: Trace, state: simulation.ArmState) -> Goals:
        """Return the outputs of ``trace`` (recorded operations) for the numbers of ``state`` that a step changes."""
        changed = trace.outputs("columns", state.columns[self.fixed :], DOUBLE, self.fixed)
        return trace.outputs("columns", state.columns[: self.task.joints]) + changed

    def _looked(self, trace: Trace, state: simulation.ArmState, command: Sequence[Traced]) -> Goals:
        """Record the simulation of one period at a joint command, and return the outputs of ``trace`` for it.

        The outputs are the changed state, and the parts of `pickenv.envs.reaching.batch.Views`.
        """
        x, task = TRACER, self.task
        (key,), (moment,) = trace.inputs("keys", 1, WORD), trace.inputs("moments", 1, WORD)
        period = task.situation.value("period", state.drawn)
        plant = with_numbers(self.plant, trace.inputs("arms", len(self._arms)))
        state, scene = simulation.look(x, task, plant, state, command, key, moment, period)
        observation = [[trace.single(value) for value in part] for part in self.parts(scene)]
        goals = ([trace.double(value) for value in part] for part in observation[1:])
        return [
            *self._remembered(trace, state),
            *(goal for i, part in enumerate(observation) for goal in trace.outputs(f"observation{i}", part, SINGLE)),
            *trace.outputs("reward", [self.reward(x, scene, *goals)]),
            *trace.outputs("success", [scene.success], FLAG),
            *trace.outputs("numbers", scene.numbers),
            *trace.outputs("vectors", scene.vectors if self.poses else ()),
        ]
