"""The rule that recommends map settings, on made-up numbers."""

import numpy as np

from evalkit_paper.map_recommendation import Recommendation, recommend


def choose(f1, loss, departures, peers=None):
    f1 = np.array(f1)[:, :, None]
    peers = np.zeros(len(f1), dtype=int) if peers is None else np.array(peers)
    return recommend(f1, np.array(loss)[:, None], peers, np.array(departures), 0)


def test_the_settings_of_the_paper_are_kept_unless_others_are_better_by_the_margin():
    assert choose([[0.80, 0.79], [0.809, 0.80]], [0.1, 0.1], [0, 1]) == Recommendation(0, 0, 1, 0)


def test_the_fewest_changes_within_the_margin_are_chosen_and_a_threshold_counts_as_one():
    f1 = [[0.80, 0.80], [0.80, 0.895], [0.893, 0.80]]
    assert choose(f1, [0.1, 0.1, 0.1], [0, 1, 1]) == Recommendation(2, 0, 1, 1)  # 0.895 needs two changes, 0.893 one


def test_better_walls_with_worse_probabilities_do_not_count():
    assert choose([[0.80], [0.95], [0.90]], [0.1, 0.2, 0.1], [0, 1, 1]).variant == 2


def test_probabilities_are_compared_at_equal_cell_size():
    f1, loss = [[0.80], [0.85], [0.95]], [0.1, 0.3, 0.2]
    assert choose(f1, loss, [0, 1, 2], peers=[0, 1, 1]).variant == 2
    assert choose(f1, loss, [0, 1, 2], peers=[0, 0, 0]).variant == 0


def test_ties_are_broken_by_better_probabilities_and_then_by_the_better_threshold():
    assert choose([[0.80], [0.900], [0.905]], [0.1, 0.08, 0.09], [0, 1, 1]).variant == 1
    three = choose([[0.80, 0.80, 0.80], [0.85, 0.90, 0.904]], [0.1, 0.08], [0, 1])
    assert (three.variant, three.threshold) == (1, 2)
