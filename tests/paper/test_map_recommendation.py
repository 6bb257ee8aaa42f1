"""The rule that recommends settings of the map, on numbers made up for it."""

import numpy as np

from evalkit_paper.map_recommendation import Recommendation, recommend


def choose(f1, loss, departures, peers=None):
    f1 = np.array(f1)[:, :, None]
    peers = np.zeros(len(f1), dtype=int) if peers is None else np.array(peers)
    return recommend(f1, np.array(loss)[:, None], peers, np.array(departures), 0)


def test_the_papers_settings_stay_where_nothing_is_better_by_the_margin():
    assert choose([[0.80, 0.79], [0.809, 0.80]], [0.1, 0.1], [0, 1]) == Recommendation(0, 0, 1, 0)


def test_the_fewest_departures_within_the_margin_are_taken_and_a_threshold_is_one():
    f1 = [[0.80, 0.80], [0.80, 0.895], [0.893, 0.80]]
    assert choose(f1, [0.1, 0.1, 0.1], [0, 1, 1]) == Recommendation(2, 0, 1, 1)  # 0.895 needs two departures, 0.893 one


def test_walls_bought_with_worse_probabilities_do_not_count():
    assert choose([[0.80], [0.95], [0.90]], [0.1, 0.2, 0.1], [0, 1, 1]).variant == 2


def test_probabilities_are_held_against_the_same_cell_size():
    f1, loss = [[0.80], [0.85], [0.95]], [0.1, 0.3, 0.2]
    assert choose(f1, loss, [0, 1, 2], peers=[0, 1, 1]).variant == 2
    assert choose(f1, loss, [0, 1, 2], peers=[0, 0, 0]).variant == 0


def test_of_equals_the_one_with_the_better_probabilities_is_taken_and_then_the_better_threshold():
    assert choose([[0.80], [0.900], [0.905]], [0.1, 0.08, 0.09], [0, 1, 1]).variant == 1
    three = choose([[0.80, 0.80, 0.80], [0.85, 0.90, 0.904]], [0.1, 0.08], [0, 1])
    assert (three.variant, three.threshold) == (1, 2)
