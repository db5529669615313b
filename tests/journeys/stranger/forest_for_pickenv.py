"""A package of somebody else, written from docs/extending.md alone: one thing of each of four kinds."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from scipy.spatial import KDTree

from pickenv.agents import ScriptedReach
from pickenv.arm import BASE, Effect
from pickenv.base import MM, toml_table


@dataclass(frozen=True, eq=False)
class Forest:
    rows: np.ndarray
    targets: np.ndarray

    @staticmethod
    def fit(inputs, targets, rng):
        return Forest(inputs, targets)

    def predict(self, inputs):
        return self.targets[KDTree(self.rows).query(inputs, k=5)[1]].mean(axis=-2)

    def arrays(self):
        return vars(self)

    @staticmethod
    def from_arrays(named):
        return Forest(**named)


@toml_table
class SoftGround(Effect, place=BASE + 0.5, spreads={"sink": 0.3}):
    sink: Annotated[float, MM.not_negative]

    def act(self, at, memory):
        *axes, x, y, z = at.frame
        at.frame = (*axes, x, y, z - self.sink * at.m.sqrt(x * x + y * y))


class Patient(ScriptedReach):
    feedback = ("encoders",)

    def __init__(self, env, seed):
        super().__init__(env)

    def act(self, observation):
        return 0.5 * super().act(observation)


@toml_table
class Funnel:
    name: str = "funnel"
    mouth: Annotated[float, MM.positive] = 0.06
    kind: str = "funnel"
    tolerance = 0.03

    def probability(self, lateral, axial, angle, diameter):
        return np.clip(1.0 - lateral / self.mouth, 0.0, 1.0) * (axial < self.mouth) * (angle < 1.0)
