"""Harvest-v0 and the reproduction of Li's experiment let one and the same cup go to the fruit."""

from dataclasses import replace

import numpy as np
import pytest

from pickenv.agents import ScriptedHarvest
from pickenv.envs import CONTROL_PERIOD, HarvestEnv
from pickenv.envs.harvesting import harvest_task as batch
from pickenv.envs.harvesting.harvest_task import make_harvest_task
from pickenv.harvester import attempt, draw_luck, pushes
from pickenv.harvester.harvest_run import displacements

AWAY = np.array([0.0, 0.0, 9.0])


def zone(seed=0, fruit=8, **changes):
    """A task, and one machine before a zone."""
    task = make_harvest_task(fruit=fruit, vision="ideal")
    task = replace(task, model=replace(task.model, **changes))
    return task, batch.begin_zones(task, [np.random.default_rng(seed)])


def tried_one_by_one(task, state, order, miss, gap, luck, monkeypatch):
    """Status of the fruit after a cup, ``miss`` m off, has gone to each of ``order``, ``gap`` periods apart."""
    turn = iter(range(len(order)))
    monkeypatch.setattr(
        batch, "draw_luck", lambda _rng, _count: type(luck)(*(v[[i]] for i in [next(turn)] for v in luck))
    )
    tips = np.full((1, task.machine.arms, 3), AWAY)
    for fruit in order:
        batch.attempts(task, state, tips, [None])  # the cup goes away, and is ready for the next
        state.busy[:] = 0
        tips[0, 0] = state.fruit[0, fruit] + miss
        batch.attempts(task, state, tips, [None])
        tips[0, 0] = AWAY
        for _ in range(gap):
            step = task.model.branch, state.swing, state.velocity, state.masses, CONTROL_PERIOD
            state.swing, state.velocity = batch.swing(*step)
    return state.status[0, order]


@pytest.mark.parametrize("seed", range(12))
def test_the_same_fruit_and_the_same_draws_have_the_same_fate(seed, monkeypatch):
    task, state = zone(seed, undamaged=0.7, cut_success=0.8)
    rng = np.random.default_rng(100 + seed)
    order, miss = rng.permutation(task.fruit), rng.normal(size=3) * [0.004, 0.004, 0.001]
    luck, entry = draw_luck(rng, task.fruit), np.arange(task.fruit) * 3 * CONTROL_PERIOD
    fruit, masses, diameters = state.fruit[0, order], state.masses[0, order], state.diameters[0, order]
    moved = displacements(task.model, fruit, masses, entry, luck)
    assert np.abs(moved).max() > 3e-4
    _, detached, collected = attempt(task.model, fruit + miss, fruit, moved, diameters, np.zeros((0, 3)), luck)
    status = tried_one_by_one(task, state, order, miss, 3, luck, monkeypatch)
    assert (status == batch.COLLECTED).tolist() == collected.tolist()
    assert (status == batch.LOST).tolist() == (detached & ~collected).tolist()


def test_fruit_swings_in_the_environment_as_the_pushes_of_earlier_cups_say(monkeypatch):
    task, state = zone(5, cut_success=0.0)
    luck, order = draw_luck(np.random.default_rng(5), 8), np.arange(8)
    fruit, entry = state.fruit[0].copy(), np.arange(8) * 3 * CONTROL_PERIOD
    tried_one_by_one(task, state, order[:7], np.zeros(3), 3, luck, monkeypatch)
    moved = displacements(task.model, fruit, state.masses[0], entry, luck)
    np.testing.assert_allclose(state.moved[0, 7], moved[7], rtol=0, atol=1e-12)


def test_a_cup_that_comes_pushes_no_fruit_that_is_gone_and_never_moves_what_it_takes():
    task, state = zone(3, push=0.05)
    state.status[0, 4:] = batch.COLLECTED
    tips = np.full((1, task.machine.arms, 3), AWAY)
    tips[0, 0] = state.fruit[0, 0]
    batch.attempts(task, state, tips, [np.random.default_rng(0)])
    moved = np.linalg.norm(state.moved[0], axis=-1)
    assert (moved[1:4] > 0).all() and (moved[4:] == 0).all()


def scripted(changes, seeds=range(3)):
    """Fruit collected and lost, reward, and how often the guard held arms, over some episodes."""
    env = HarvestEnv(ideal=True, vision="ideal")
    env.task = replace(env.task, model=replace(env.task.model, **changes))
    policy, found, reward = ScriptedHarvest(env), np.zeros(2), 0.0
    for seed in seeds:
        observation, info = env.reset(seed=seed)
        policy.reset()
        for _ in range(200):
            observation, gained, over, _, info = env.step(policy.act(observation))
            reward += gained
            if over:
                break
        found += info["collected"], info["lost"]
    return found, reward


def test_fruit_that_is_damaged_counts_as_lost_and_costs_what_it_would_have_brought():
    (collected, lost), reward = scripted({"undamaged": 1.0})
    (none, all_), paid = scripted({"undamaged": 0.0})
    assert (lost, none) == (0, 0) and all_ == collected > 15
    assert reward - paid == pytest.approx(2 * collected, abs=1e-9)


def test_the_shipped_cup_damages_fruit_as_often_as_its_file_says():
    task, state = zone(0, push=0.0)
    rng, arms, fates = np.random.default_rng(0), task.machine.arms, []
    for _ in range(10_000 // arms):
        state.status[:], state.busy[:], state.tried[:] = batch.LOST, 0, -1
        state.status[0, :arms] = batch.HANGING
        batch.attempts(task, state, state.fruit[:, :arms], [rng])
        fates += state.status[0, :arms].tolist()
    kept, lost = (np.mean(np.array(fates) == fate) for fate in (batch.COLLECTED, batch.LOST))
    wanted = task.model.cut_success * (1 - task.model.undamaged)
    assert abs(lost - wanted) < 4 * np.sqrt(wanted / 10_000)
    assert kept == pytest.approx(task.model.cut_success * task.model.undamaged, abs=0.02)


def test_the_reward_is_what_the_class_says_term_by_term():
    env, rng = HarvestEnv(slaves=4), np.random.default_rng(1)
    env.reset(seed=1)
    machine, held = env.task.machine, 0
    before = batch.work_left(env.task, env.state)[0]
    collected = lost = 0
    for _ in range(150):
        action = rng.choice([-1.0, 1.0], env.action_space.shape) * (rng.random(env.action_space.shape) < 0.7)
        action[:3] = 0.0
        *_, info = (out := env.step(action))
        work = batch.work_left(env.task, env.state)[0]
        wanted = (info["collected"] - collected) - (info["lost"] - lost) + before - work
        wanted -= 0.05 * info["held"] + 0.005 + 0.005 * np.abs(action).mean()
        assert out[1] == pytest.approx(wanted, abs=1e-12)
        before, collected, lost, held = work, info["collected"], info["lost"], held + info["held"]
    assert held > 0 and machine.arms == 4


def test_two_cups_at_one_fruit_are_one_attempt(monkeypatch):
    task, state = zone(2)
    tips = np.full((1, task.machine.arms, 3), AWAY)
    tips[0, :2] = state.fruit[0, 3] + np.array([[0.001, 0, 0], [0.0, 0.002, 0]])
    batch.attempts(task, state, tips, [np.random.default_rng(0)])
    assert state.attempts[0] == 1 and state.tried[0].tolist() == [3, -1, -1]


def test_pushes_fall_off_with_distance_and_have_the_stated_median():
    model = make_harvest_task().model
    luck = draw_luck(np.random.default_rng(0), 4001)
    here = np.zeros((4001, 3))
    pushed = np.linalg.norm(pushes(model, here, np.array([[0.0, 0, 0], [0.3, 0, 0]]), luck), axis=-1)
    assert np.median(pushed[:, 0]) == pytest.approx(model.push, rel=0.05)
    assert np.std(np.log(pushed[:, 0])) == pytest.approx(model.push_spread, rel=0.05)
    np.testing.assert_allclose(pushed[:, 1] / pushed[:, 0], np.exp(-0.3 / model.branch.coupling), rtol=1e-9)
