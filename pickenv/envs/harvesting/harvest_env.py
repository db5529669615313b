"""`pickenv/Harvest-v0`: one policy moves a master arm and its slaves to pick a zone's fruit without a collision."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from pickenv.arm import Array, tree_map
from pickenv.base import InputError
from pickenv.envs.harvesting import harvest_task as batch
from pickenv.envs.shared.arm_env import GHOST_WORDS, DrawnEnv, Information, Options, begun
from pickenv.envs.shared.backends import Flags, Rows
from pickenv.envs.shared.native_vector import NativeVectorEnv, set_spaces
from pickenv.envs.shared.situation import CONTROL_PERIOD
from pickenv.envs.shared.spaces import given_options
from pickenv.envs.shared.task import Compensate, checked_action, refuse_unknown
from pickenv.harvester import Machine
from pickenv.pictures import shapes
from pickenv.pictures.stage import SIZE, Eye, Mesh, Rods, Stage, Words, rgba, spheres

LONGEST = 600


class HarvestEnv(DrawnEnv):
    """Pick the fruit of one zone with the multi-arm harvester of Li 2016.

    ## Description

    A master arm (turn, lift, reach) carries one to six slave arms (lift, swing, stretch). Each slave has a cup that
    takes a fruit from below, cuts its stalk and keeps it. One policy moves all joints. The machine that moves is the
    machine as built. Its cups are 6 to 9 mm off, and they tolerate 5 to 11 mm. A cup that moves into the canopy pushes
    neighbouring fruit away. Arms never collide, since a guard stops arms that would come nearer to each other than two
    arm radii and a margin. As in the reproduction of Li's experiment, `pickenv.harvester.harvest_run` decides an
    attempt's outcome. It considers how far off the cup is, fruit in its way, the blade and damage. Pushed fruit swings
    on its branch, and a part of its displacement remains.

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

    A cup closes its blade by itself when its sensor detects a fruit inside, within 15 mm in height. Its arm and the
    master then stand still for 1 s. The cup tries again only after it has gone 50 mm away from that fruit.

    ## Observation Space

    `Box(float32)`: joints scaled to their limits (3 + 3 arms, -1 to 1); for each slave the share of sensing and cutting
    that it still has to do (arms, 0 to 1); then four numbers for each fruit: its position as the camera saw it, to the
    right of, ahead of and above frame 3 (-2 to 2 m), and 1 while it hangs in reach. Frame 3 is the frame at the
    master's end. All four are 0 for fruit that does not hang in reach or that the camera did not find.

    ## Rewards

    Per period: 1 x (fruit collected whole) - 1 x (fruit damaged) + (progress in m) - 0.05 x (arms that the guard holds)
    - 0.005 - 0.005 x (mean size of the action's numbers, also of arms that the guard holds). Progress is the decrease
    of a distance. To compute it, the distances from each hanging fruit in reach, as the camera saw it, to the nearest
    believed cup are summed. The sum is divided by the number of fruit in the zone. Eight fruit give at most about 8;
    doing nothing for a minute gives -3.

    ## Starting State

    Fruit is drawn uniformly in a zone of 0.7 x 0.4 x 0.55 m somewhere on the tree's side. The cameras, 1 m from the
    tree, find some of it. The master stands at the pick point from which its slaves reach most of the fruit found. A
    zone without fruit in reach is drawn anew. The slaves are at rest. If a fruit still hangs after an attempt, the
    camera measures it again where it then hangs. The same leaves hide it, so the error is the same.
    `reset(options=...)` takes `"fruit"`, positions (fruit, 3) in m in the base frame, and `"start_joints"` of the whole
    machine (rad and m). The cameras look at the middle of given fruit. Fruit is in reach if a slave reaches it from the
    pick point; the start joints do not matter.

    ## Episode End

    - Termination: no fruit in reach hangs any more, and no blade is closing.
    - Truncation: after 600 periods, which take a minute (`max_episode_steps`).

    ## Information

    - `collected`, `lost`, `located` (by the cameras) and `reachable`: numbers of fruit.
    - `attempts`: number of attempts so far.
    - `held`: number of arms that the guard held in the last period.
    - `closest_mm`: least distance between two arms' centre lines so far.
    - `picks_per_hour`: fruit collected per hour of simulated time.
    - `is_success`: whether all located fruit in reach is collected.

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

    - `slaves` (1 to 6, default 3): number of slave arms; `spacing_mm` (default 350): distance between neighbouring
      slaves; `fruit` (1 to 40, default 8): number of fruit in the zone.
    - `ideal` (bool, default False): whether the machine is built exactly as designed.
    - `vision`: how the camera's errors are made. "measured_errors" (default) draws detections and errors from a table,
      which was made by detecting fruit in rendered pictures of this canopy. "rendered" renders a stereo pair of each
      zone and detects the fruit in it (a tenth of a second, needs the extra `harvest`). "ideal" shows all fruit at its
      true position.
    - `detector`: "li2016" (default; R-G, Otsu, centroids) or "circles".
    - `canopy`: "li2016" (default, with leaves) or "li2016_bare" (without). False detections are not simulated.
    - `out_of_range` ("clip" or "refuse"): whether actions beyond -1 to 1 are clipped or raise an error.
    - `executor` ("auto" or "numpy"): "auto" computes cups and distances between arms in machine code if llvmlite is
      installed. Its results equal NumPy's up to rounding (1e-12).
    - `render_mode` (None, "human" or "rgb_array").

    `pickenv.wrappers.CompensationWrapper` takes a compensator of the whole machine's joints, for example a
    `pickenv.harvester.true_machine.Controller`.

    ## Version History

    * v0: First version. Two things changed before its first release. Attempts are now decided as in the reproduction of
      Li's experiment, with log-normal pushes and swinging fruit. The cameras now see what a stereo pair can
      see. Before, they saw 97 % of the fruit to a millimetre. Returns from before these changes cannot be compared.
    """

    def __init__(self, *, render_mode: str | None = None, **arguments: Any) -> None:
        """See the class for the arguments; raises `InputError` for values that are not allowed."""
        super().__init__(render_mode)
        refuse_unknown(self, arguments, batch.make_harvest_task)
        self.task: batch.HarvestTask = batch.make_harvest_task(**arguments)
        self.compensator: Compensate | None = None
        self.observation_space, self.action_space = batch.harvest_spaces(self.task)
        self.state: batch.HarvestState | None = None

    def reset(self, *, seed: int | None = None, options: Options = None) -> tuple[NDArray[np.float32], Information]:
        """Start an episode in a new zone; see the class for `options`."""
        super().reset(seed=seed)
        zones = batch.given_zones(self.task, given_options(options, batch.OPTIONS), 1)
        self.state = batch.begin_zones(self.task, [self.np_random], **zones)
        return self._shown(self.state)

    def step(self, action: ArrayLike) -> tuple[NDArray[np.float32], float, bool, bool, Information]:
        """Move all joints by ``action`` for one period.

        Raises:
            InputError: If the action is not finite or has another shape, or if `reset` was not called before.
        """
        values = checked_action(action, (self.task.machine.joints,), self.task.most_action)
        state = begun(self.state, "step")
        (reward,) = batch.step(self.task, state, values[None], [self.np_random], self.compensator)
        observation, information = self._shown(state)
        return observation, float(reward), bool(batch.finished(state)[0]), False, information

    def _stage(self) -> Stage | None:
        return None if self.state is None else draw_harvest(self.task, self.state, self.compensator, dark=self.dark)

    def _shown(self, state: batch.HarvestState) -> tuple[NDArray[np.float32], Information]:
        if self.render_mode == "human":
            self.render()
        information = {key: values[0].item() for key, values in batch.information(state).items()}
        return batch.observe(self.task, state)[0], information


# The native vector version of `pickenv/Harvest-v0`: many zones in one set of arrays.


class HarvestVectorEnv(NativeVectorEnv):
    """N `pickenv/Harvest-v0` in one vector environment.

    Environment i (from 0) has the seed ``seed + i``, and its numbers do not depend on N.

    Args:
        num_envs: N, the number of harvesters.
        max_episode_steps: Periods after which an episode is truncated, or None for never.
        autoreset_mode: "NextStep", "SameStep" or "Disabled", or an `AutoresetMode`.
        render_mode: None or "rgb_array".
        arguments: Arguments of `pickenv.envs.harvesting.harvest_env.HarvestEnv`.
    """

    options = batch.OPTIONS

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = LONGEST,
        autoreset_mode: str | AutoresetMode = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        """See the class."""
        super().__init__(num_envs, max_episode_steps, autoreset_mode, render_mode)
        refuse_unknown(self, arguments, batch.make_harvest_task)
        self.task: batch.HarvestTask = batch.make_harvest_task(**arguments)
        set_spaces(self, *batch.harvest_spaces(self.task))
        self.state: batch.HarvestState

    def _checked(self, actions: ArrayLike) -> NDArray[Any]:
        return checked_action(actions, (self.num_envs, self.task.machine.joints), self.task.most_action)

    def _begin(self, rows: Rows, options: Information, seeded: Flags) -> None:
        zones = batch.given_zones(self.task, options, self.num_envs, rows)
        fresh = batch.begin_zones(self.task, [self._rngs[i] for i in rows], **zones)
        if self._begun:
            self.state.put(rows, fresh)
        else:
            self.state = fresh

    def _act(self, actions: NDArray[Any], live: Flags) -> NDArray[Any]:
        rewards, rows = np.zeros(self.num_envs), np.flatnonzero(live)
        if rows.size:
            some: batch.HarvestState = tree_map(lambda values: values[rows], self.state)
            rewards[rows] = batch.step(self.task, some, actions[rows], [self._rngs[i] for i in rows], self._one())
            self.state.put(rows, some)
        return rewards

    def _finished(self) -> Flags:
        return batch.finished(self.state)

    def _observation(self) -> NDArray[np.float32]:
        return batch.observe(self.task, self.state)

    def _information(self) -> Information:
        return dict(batch.information(self.state))

    def _stage(self, row: int) -> Stage:
        return draw_harvest(self.task, self.state, self._one(), row=row)

    def _one(self) -> Compensate | None:
        """Return the compensator that all harvesters share, or None; refuse a sequence of one per harvester."""
        if self.compensator is None or callable(self.compensator):
            return self.compensator
        raise InputError("each harvester has several arms; give one compensator for all of them")


# A harvester before its zone as a stage to draw: column, boom, slave arms with cups, fruit, trees, cameras. What
# moves is the machine as built; the ghosts of its slaves show where the controller believes their cups to be. Units:
# m; mm in words.


UP = np.array([0.0, 0.0, 1.0])


def draw_harvest(
    task: batch.HarvestTask, states: batch.HarvestState, compensate: Compensate | None, row: int = 0, dark: bool = False
) -> Stage:
    """Return the stage to draw for one machine in front of its zone.

    Args:
        task: The task.
        states: State of one or more machines.
        compensate: Maps nominal joints of whole machines to joint commands, or None.
        row: Index of the machine to draw in ``states``, from 0.
        dark: Whether the background is dark.
    """
    state: batch.HarvestState = tree_map(lambda values: values[row : row + 1], states)
    machine, target = task.machine, state.joints
    command = target if compensate is None else compensate(target)
    ghosts = machine.tips(*machine.parted(target))[0]
    tips = task.true.tips(*machine.parted(command))[0]
    master, slaves = machine.parted(command)
    pivots = machine.tips(master, slaves * [1.0, 0.0, 0.0])[0]
    picked = int((state.status[0] == batch.COLLECTED).sum())
    solids = shapes.joined_solids(
        _master(machine, command[0], pivots),
        slave_solids(pivots, tips, machine.body.radius / 2),
        _ghosts(pivots, tips + shapes.GAIN * (ghosts - tips), machine.body.radius / 2),
        *(shapes.cup_solids(tip, UP, shapes.CUP_RADIUS) for tip in tips),
        zone_fruit(state),
        shapes.crate(_eye(state), SIZE, picked, float(state.diameters[0].mean()), -machine.base_height),
        _cameras(task, command[0]),
    )
    words = (
        Words(f"picked {picked} of {int(state.reachable[0].sum())}", large=True),
        Words(f"missed {int(state.attempts[0]) - picked}"),
        Words(f"{float(state.periods[0]) * CONTROL_PERIOD:.1f} s", "top right"),
        Words(GHOST_WORDS, "bottom left"),
    )
    return Stage(_eye(state), *solids, still=_surroundings(task, state, dark), words=words, dark=dark)


def _master(machine: Machine, joints: Array, pivots: Array) -> shapes.Solids:
    """Return the solids of the master arm: the column, the boom, and the rail that carries the slaves.

    Args:
        machine: The machine as designed.
        joints: Joint command of the whole machine ``(joints,)``, rad or m.
        pivots: Positions of the slaves' pivots ``(arms, 3)``, m.
    """
    frame, foot = machine.frame3(joints[:3]), -machine.base_height
    axis, shoulder = np.array([0.0, 0.0, foot]), np.array([0.0, 0.0, frame[2]])
    ends = pivots[[0, -1]].copy()
    ends[:, 2] = frame[2]
    top = np.array([0.0, 0.0, float(machine.upper[1]) + machine.d1])
    start = np.stack([axis, shoulder, ends[0], *(np.array([*pivot[:2], frame[2]]) for pivot in pivots)])
    end = np.stack([top, frame, ends[1], *pivots])
    radius = np.array([0.05, 0.035, 0.03, *[0.022] * len(pivots)])
    colour = np.concatenate([rgba(shapes.METAL, 1), rgba(shapes.LINK, 2), rgba(shapes.METAL, len(pivots))])
    balls = spheres(np.stack([shoulder, frame]), np.array([0.075, 0.05]), rgba(shapes.JOINT, 2))
    return (Rods(start, end, radius, colour),), (balls,), ()


def slave_solids(pivots: Array, tips: Array, radius: float) -> shapes.Solids:
    """Return the solids of the slave arms, each a tube with a rod in it that ends below its cup.

    Args:
        pivots: Positions of the slaves' pivots ``(arms, 3)``, m.
        tips: Positions of the slaves' cups ``(arms, 3)``, m.
        radius: Radius of the tubes, m.
    """
    ends = tips - 0.06 * UP
    half = pivots + 0.5 * (ends - pivots)
    count = len(tips)
    tubes = Rods(pivots, half, np.full(count, radius), rgba(shapes.LINK, count))
    rods = Rods(half, ends, np.full(count, 0.6 * radius), rgba(shapes.METAL, count))
    return (tubes, rods), (spheres(pivots, np.full(count, 1.3 * radius), rgba(shapes.JOINT, count)),), ()


def _ghosts(pivots: Array, tips: Array, radius: float) -> shapes.Solids:
    count = len(tips)
    colour = rgba(shapes.GHOST, count, shapes.FAINT)
    rods = Rods(pivots, tips - 0.06 * UP, np.full(count, 0.8 * radius), colour)
    return (rods,), (spheres(tips - 0.03 * UP, np.full(count, 0.035), colour),), ()


def zone_fruit(state: batch.HarvestState) -> shapes.Solids:
    """Return the solids of all fruit in front of the first machine of ``state``, except collected fruit.

    Ripe fruit in reach is red, fruit out of reach is green, and lost fruit has a third colour.
    """
    hanging = state.status[0] != batch.COLLECTED
    colours = shapes.fruit_colours(state.fruit.shape[1])
    colours[~state.reachable[0]] = shapes.GREEN
    colours[state.status[0] == batch.LOST] = shapes.MISSED_FRUIT
    places = state.fruit[0] + state.moved[0]
    return shapes.fruit_solids(places[hanging], state.diameters[0][hanging], colours[hanging])


def _cameras(task: batch.HarvestTask, joints: Array) -> shapes.Solids:
    """Return the solids of the stereo pair, which took its pictures from the aisle before the machine came.

    ``joints`` is the joint command of the whole machine ``(joints,)``, rad or m.
    """
    frame = task.machine.frame3(joints[:3])
    eye = np.array([frame[0], 0.0, frame[2]])
    return shapes.frustum_solids(eye, np.array([0.0, -1.0, 0.0]), (0.6, 0.45), 0.3, (110, 96, 160))


def _surroundings(task: batch.HarvestTask, state: batch.HarvestState, dark: bool) -> tuple[Mesh, ...]:
    """Return the meshes of the ground and of the zone's trees."""
    canopy, height = task.orchard.canopy, -task.machine.base_height
    middle = np.round(state.fruit[0].mean(axis=0), 1)
    low = (float(middle[0]) - 0.6, -canopy.standoff - canopy.depth, max(float(middle[2]) - 0.5, height + 0.3))
    high = (float(middle[0]) + 0.6, -canopy.standoff, float(middle[2]) + 0.6)
    trees = shapes.row_of_trees(low, high, canopy.leaf_area_per_volume, height)
    return (shapes.ground_around(0.0, -0.5, height, dark), *trees)


def _eye(state: batch.HarvestState) -> Eye:
    """Return a viewpoint that is fixed during an episode, on the machine's side of the trees.

    It is 1.75 m in x, 1.9 m in y and 0.75 m in z from the point looked at. The trees are at negative y.
    """
    fruit = state.fruit[0].mean(axis=0)
    target = np.array([0.45 * fruit[0], 0.62 * fruit[1], 0.95 * fruit[2]])
    return Eye(target + np.array([1.75, 1.9, 0.75]), target, 34.0)
