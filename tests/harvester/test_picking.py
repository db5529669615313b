"""What becomes of attempts: the cup's clearance, pushed fruit, clusters."""

from dataclasses import replace

import numpy as np
import pytest

from papers.li2016.lab import sample_image
from pickenv.harvester import attempt, draw_luck, load_orchard, load_picking, sample_tree
from pickenv.harvester.harvest_run import displacements, in_the_way
from pickenv.harvester.pick_points import PICKING_FILE
from pickenv.orchard import coupling, swing

NOTHING = np.zeros((0, 3))


@pytest.fixture(scope="module")
def sure():
    """The picking model with nothing left to chance but the cup."""
    return replace(load_picking(), cut_success=1.0, undamaged=1.0, push=0.0)


def tries(model, lateral, rng, count=400, axial=0.0):
    """Shares of attempts, far apart, at one misalignment."""
    fruit = np.arange(count)[:, None] * np.array([1.0, 0.0, 0.0])
    tips = fruit - np.array([lateral, 0.0, axial])
    still = np.zeros_like(fruit)
    return attempt(model, tips, fruit, still, np.full(count, 0.06), NOTHING, draw_luck(rng, count))[2].mean()


def luck_of(count, **given):
    """Attempts without a push, or with what is given."""
    none = draw_luck(np.random.default_rng(0), count)
    return none._replace(push=np.zeros(count), heading=np.zeros(count), **given)


def test_the_cups_radial_clearance_is_5_mm_not_nearly_10(sure):
    assert (sure.cup.opening - sure.cup.fruit) / 2 == pytest.approx(0.005)


def test_a_cup_takes_fruit_within_its_clearance_and_ever_fewer_beyond(sure):
    rng = np.random.default_rng(0)
    shares = [tries(sure, lateral * 1e-3, rng) for lateral in (0, 4.9, 7, 9, 12)]
    assert shares[:2] == [1.0, 1.0] and shares[-1] == 0.0
    assert shares[1] > shares[2] > shares[3] > 0
    assert tries(sure, 0.0, rng, axial=0.04) == 0.0


def test_a_push_moves_neighbours_less_the_farther_they_are_and_dies_away(sure):
    model, luck = replace(sure, push=0.02), luck_of(2)
    for wait, far in ((0.5, 0.1), (0.5, 0.4)):
        fruit = np.array([[0.0, 0, 0], [far, 0, 0]])
        moved = displacements(model, fruit, np.full(2, 0.1), np.array([0.0, wait]), luck)
        assert (moved[0] == 0).all()  # nothing came before the first
        assert 0 < np.linalg.norm(moved[1]) < 0.02 * np.exp(-far / model.branch.coupling) * 1.01
    late = displacements(model, fruit, np.full(2, 0.1), np.array([0.0, 60.0]), luck)
    stays = model.lasting * 0.02 * np.exp(-0.4 / model.branch.coupling)
    assert np.linalg.norm(late[1]) == pytest.approx(stays, rel=1e-3)


def test_fruit_in_a_cluster_is_in_the_cups_way(sure):
    fruit = np.array([0.0, 0.0, 1.0])
    others = np.array([[0.061, 0, 1.0], [0.0, 0.03, 0.94], [0.2, 0, 1.0], [0.0, 0.0, 1.2]])
    assert in_the_way(sure, fruit, 0.06, others).tolist() == [True, True, False, False]
    rng, lost = np.random.default_rng(1), 0
    for _ in range(100):
        still, luck = np.zeros((1, 3)), draw_luck(rng, 1)
        *_, collected = attempt(sure, fruit[None], fruit[None], still, np.array([0.06]), others[:1], luck)
        lost += not collected[0]
    assert 30 < lost < 70


def test_trees_stand_where_the_paper_has_them(machine):
    tree = sample_tree(machine, load_orchard(), np.random.default_rng(2))
    heights = tree.fruit[:, 2] + machine.base_height
    assert heights.min() >= 0.8 and heights.max() <= 2.8
    assert tree.fruit[:, 1].max() <= -1.0 + 1e-9 and tree.fruit[:, 1].min() >= -1.4 - 1e-9
    assert np.abs(tree.fruit[:, 0]).max() <= 1.25


def test_images_of_the_lab_show_seven_fruit_in_reach(machine):
    image = sample_image(machine, np.random.default_rng(3))
    assert len(image) == 7
    gaps = np.linalg.norm(image.fruit[:, None] - image.fruit[None], axis=-1) + np.eye(7)
    assert gaps.min() >= 0.12


def test_a_pushed_fruit_first_swings_with_all_of_the_push_and_then_as_its_branch_does(sure):
    fruit, masses = np.array([[0.0, 0, 0], [0.1, 0, 0]]), np.full(2, 0.1)
    model = replace(sure, push=0.02)
    start = 0.02 * float(coupling(sure.branch, 0.1))
    for wait in (1e-6, 0.15, 0.4):
        moved = displacements(model, fruit, masses, np.array([0.0, wait]), luck_of(2))[1]
        swung, _ = swing(sure.branch, [start, 0.0, 0.0], np.zeros(3), 0.1, wait)
        expected = sure.lasting * start + (1 - sure.lasting) * swung[0]
        np.testing.assert_allclose(moved, [expected, 0.0, 0.0], atol=1e-12)
        if wait < 1e-3:
            assert moved[0] == pytest.approx(start, rel=1e-6)


def test_a_cup_that_goes_where_the_fruit_was_pushed_to_takes_it(sure):
    fruit, moved = np.array([[0.0, 0, 0], [1.0, 0, 0]]), np.array([[0.0, 0, 0], [0.03, -0.01, 0]])
    for tips, lateral in ((fruit + moved, [0.0, 0.0]), (fruit, [0.0, np.hypot(0.03, 0.01)])):
        luck = draw_luck(np.random.default_rng(0), 2)
        *_, collected = attempt(sure, tips, fruit, moved, np.full(2, 0.06), NOTHING, luck)
        assert collected.tolist() == [True, lateral[1] == 0.0]


def test_fruit_that_does_not_fit_into_the_cup_is_never_taken(sure):
    fruit = np.zeros((1, 3))
    for diameter, taken in ((0.069, True), (0.071, False)):
        luck = luck_of(1)._replace(grasp=np.zeros(1))
        attached, *_ = attempt(sure, fruit, fruit, np.zeros((1, 3)), np.array([diameter]), NOTHING, luck)
        assert attached[0] == taken


def test_a_picking_file_that_was_changed_is_read_again(tmp_path):
    path = tmp_path / "mine.toml"
    text = PICKING_FILE.read_text(encoding="utf-8")
    for push in ("16.0", "40.0"):
        path.write_text(text.replace("push_mm = 16.0", f"push_mm = {push}"), encoding="utf-8")
        assert load_picking(path).push == pytest.approx(float(push) * 1e-3)
