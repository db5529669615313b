"""`pickenv/Harvest-v0`: one policy moves a master arm and its slaves to pick a zone's fruit without a collision."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pickenv.base import InputError
from pickenv.envs.harvesting import harvest_batch as batch
from pickenv.envs.harvesting.harvest_batch import HarvestState
from pickenv.envs.harvesting.harvest_task import OPTIONS, HarvestTask, given_zones, harvest_spaces, make_harvest_task
from pickenv.envs.shared.arm_env import DrawnEnv
from pickenv.envs.shared.spaces import given_options
from pickenv.envs.shared.task import Compensate, checked_action

if TYPE_CHECKING:
    from pickenv.pictures.stage import Stage

Information = dict[str, Any]
LONGEST = 600
"""Periods of an episode: a minute."""


class HarvestEnv(DrawnEnv):
    """Pick the fruit of one zone with the multi-arm harvester of Li 2016.

    ## Description

    A master arm (turn, lift, reach) carries one to six slave arms (lift, swing, stretch), each with a cup that takes a
    fruit from below, cuts its stalk and keeps it. One policy moves all joints. What moves is the machine as built,
    whose cups are 6 to 9 mm off while they forgive 5 to 11 mm; a cup that goes in pushes its neighbours' fruit away.
    Arms never collide: a guard holds those that would come nearer than two arm radii and a margin. What becomes of an
    attempt is what `pickenv.harvester.picking` says, as in the reproduction of Li's experiment: how far off the cup is,
    fruit in its way, blade and damage; pushed fruit swings on its branch, and a part of the push stays.

    ## Action Space

    `Box(-1, 1, (3 + 3 arms,), float32)`: joint increments, as shares of the largest increment per period of 0.1 s.

    | Num    | Action              | Control Min | Control Max | Largest increment | Unit |
    |--------|---------------------|-------------|-------------|-------------------|------|
    | 0      | master turn theta1  | -1          | 1           | 4.5               | deg  |
    | 1      | master lift d2      | -1          | 1           | 40                | mm   |
    | 2      | master reach d3     | -1          | 1           | 50                | mm   |
    | 3 + 3i | slave i lift d4     | -1          | 1           | 40                | mm   |
    | 4 + 3i | slave i swing theta5| -1          | 1           | 6                 | deg  |
    | 5 + 3i | slave i stretch d6  | -1          | 1           | 50                | mm   |

    A cup whose sensor finds a fruit inside (15 mm in height) closes its blade by itself: its arm and the master stand
    for 1 s. Afterwards it tries again only once it has gone 50 mm away.

    ## Observation Space

    `Box(float32)`: joints scaled to their limits (3 + 3 arms, -1 to 1); the share of sensing and cutting left of each
    slave (arms, 0 to 1); then for each fruit slot its place as the camera saw it, right of, ahead of and above frame 3
    (-2 to 2 m), and 1 while it hangs in reach (else all four are 0; so they are where the camera does not find it).

    ## Rewards

    Per period: 1 x (fruit collected whole) - 1 x (fruit damaged) + (progress in m) - 0.05 x (arms that the guard holds)
    - 0.005 - 0.005 x (mean size of the action's numbers, held or not). Progress is by how much less is left than
    before: the distances from the fruit in reach that hangs, as the camera saw it, to the believed cup nearest to each,
    summed and divided by the fruit of the zone. Eight fruit give at most about 8; doing nothing for a minute gives -3.

    ## Starting State

    Fruit evenly in 0.7 x 0.4 x 0.55 m somewhere on the tree's side, some of it found by the cameras 1 m before the
    tree; the master at the pick point that reaches most of what was found, the slaves at rest. A cup that comes back
    empty looks again: at where the fruit hangs by then, past the same leaves, so with the same error.
    `reset(options=...)` takes `"fruit"`, positions (fruit, 3) in m in the base frame, where the cameras look at their
    middle, and `"start_joints"` of the whole machine (rad and m).

    ## Episode End

    - Termination: no fruit in reach hangs any more.
    - Truncation: after 600 periods (`max_episode_steps`).

    ## Information

    `collected`, `lost`, `located` (by the cameras), `reachable`, `attempts`, `held` (arms held in the last period),
    `closest_mm` (least distance between two arms' centre lines so far), `picks_per_hour`, `is_success` (all located
    fruit in reach collected).

    ## Arguments

    ```python
    >>> import gymnasium as gym
    >>> import pickenv
    >>> from pickenv.envs.harvesting.harvest_env import HarvestEnv
    >>> env = HarvestEnv(slaves=2, fruit=6)
    >>> observation, info = env.reset(seed=1)
    >>> observation.shape
    (35,)

    ```

    - `slaves` (1 to 6, default 3), `spacing_mm` (default 350), `fruit` (1 to 40, default 8).
    - `ideal` (bool, default False): whether the machine is as drawn.
    - `vision`: "measured_errors" (default) draws recall and errors from the table made by reading rendered pictures of
      this canopy; "rendered" draws and reads a stereo pair of each zone (a tenth of a second, needs the extra
      `harvest`); "ideal" shows all fruit where it is. `detector`: "li2016" (default; R-G, Otsu, centroids) or
      "circles". `canopy`: "li2016" (default, leafy) or "li2016_bare". Detections of no fruit are left out.
    - `out_of_range` ("clip" or "refuse"): whether actions beyond -1 to 1 are cut to it or are an error.
    - `render_mode` (None, "human" or "rgb_array").

    `pickenv.wrappers.CompensationWrapper` takes a compensator of the whole machine's joints, for instance a
    `pickenv.harvester.true_machine.Controller`.

    ## Version History

    * v0: First version. Before its first release, attempts came to be judged as in the reproduction of Li's experiment:
      pushes are log-normal and fruit swings; and the cameras came to see what a stereo pair can, instead of 97 % of the
      fruit to a millimetre. Returns from before cannot be compared.
    """

    def __init__(
        self,
        *,
        slaves: int | None = None,
        spacing_mm: float | None = None,
        fruit: int = 8,
        ideal: bool = False,
        vision: str = "measured_errors",
        detector: str = "li2016",
        canopy: str | None = None,
        out_of_range: str = "clip",
        render_mode: str | None = None,
    ) -> None:
        """See the class for the arguments; raises `InputError` for impossible ones."""
        super().__init__(render_mode)
        self.task: HarvestTask = make_harvest_task(
            slaves, spacing_mm, fruit, ideal, vision, detector, canopy, out_of_range
        )
        self.compensator: Compensate | None = None
        self.observation_space, self.action_space = harvest_spaces(self.task)
        self.state: HarvestState | None = None

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], Information]:
        """Start with another zone; see the class for `options`."""
        super().reset(seed=seed)
        given = given_zones(self.task, given_options(options, OPTIONS), 1)
        self.state = batch.begin_zones(self.task, [self.np_random], given)
        if self.render_mode == "human":
            self.render()
        return batch.observe(self.task, self.state)[0], self._information()

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool, bool, Information]:
        """Move all joints by ``action``.

        Raises:
            InputError: If the action is not finite or has another shape, or before the first reset.
        """
        values = checked_action(action, (self.task.machine.joints,), self.task.most_action)
        if self.state is None:
            raise InputError("step was called before reset; call reset first")
        rewards = batch.step(self.task, self.state, values[None], [self.np_random], self.compensator)
        terminated = bool(batch.finished(self.state)[0])
        if self.render_mode == "human":
            self.render()
        return batch.observe(self.task, self.state)[0], float(rewards[0]), terminated, False, self._information()

    def _stage(self) -> Stage | None:
        from pickenv.envs.harvesting.harvest_drawing import draw_harvest

        return None if self.state is None else draw_harvest(self.task, self.state, self.compensator, dark=self.dark)

    def _information(self) -> Information:
        assert self.state is not None
        return {key: values[0].item() for key, values in batch.information(self.state).items()}
