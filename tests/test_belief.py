"""What an odometry tells of its answer is heard once."""

from evalkit import belief


def test_what_was_told_is_heard_once_and_the_last_word_counts():
    belief.tell(False)
    belief.tell(True)
    assert belief.heard() == belief.BELIEVED
    assert belief.heard() == belief.UNTOLD
    belief.tell(False)
    assert belief.heard() == belief.GUESS_KEPT
