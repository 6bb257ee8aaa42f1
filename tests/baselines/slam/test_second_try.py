from dataclasses import dataclass, field

import numpy as np

from evalkit.core.match import Match
from evalkit.core.pose import Pose
from evalkit.core.scan import Cloud
from evalkit_baselines.slam.second_try import SecondTry

CORNER = Cloud(np.concatenate([np.column_stack([np.linspace(0, 4, 80), np.zeros(80)]),
                               np.column_stack([np.zeros(80), np.linspace(0, 4, 80)])]))  # fmt: skip


@dataclass
class Answer:
    """A registration that always answers the same, and counts its calls."""

    pose: Pose
    error: float
    calls: list[Pose] = field(default_factory=list)

    def register(self, target, source, guess):
        self.calls.append(guess)
        return Match(self.pose, True, 3, self.error, 100)


def test_a_good_answer_is_not_doubted():
    narrow = Answer(Pose(), 0.01)
    answer = SecondTry(Answer(Pose(0.5, 0.0, 0.0), 0.1), narrow).register(CORNER, CORNER, Pose())
    assert answer.target_from_source == Pose(0.5, 0.0, 0.0)
    assert not narrow.calls


def test_of_two_poor_answers_the_one_with_more_points_on_the_target_is_taken():
    guess, right, wrong = Pose(0.1, 0.0, 0.0), Pose(), Pose(0.6, 0.4, 0.2)
    for wide, near in ((wrong, right), (right, wrong)):
        narrow = Answer(near, 0.3)
        answer = SecondTry(Answer(wide, 0.2), narrow).register(CORNER, CORNER, guess)
        assert answer.target_from_source == right
        assert narrow.calls == [guess]
