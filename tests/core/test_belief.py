"""What an odometry tells of its answer is heard once."""

from evalkit.core import belief


def test_what_was_told_is_heard_once_and_the_last_word_counts():
    belief.tell(False)
    belief.tell(True)
    assert belief.heard() == belief.ACCEPTED
    assert belief.heard() == belief.UNTOLD
    belief.tell(False)
    assert belief.heard() == belief.GUESS_KEPT


def test_what_was_told_of_stages_is_heard_once_each_by_its_last_word():
    first, last = belief.Registered(True, True, 3, 0.01, 50), belief.Registered(False, False, 40, 0.05, 7)
    belief.tell_stage("s2s", first)
    belief.tell_stage("s2m", first)
    belief.tell_stage("s2m", last)
    assert belief.heard_of_stages() == {"s2s": first, "s2m": last}
    assert belief.heard_of_stages() == {}
    assert belief.heard() == belief.UNTOLD
