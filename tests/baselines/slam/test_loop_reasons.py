import pytest

from evalkit_baselines.slam import loop_reasons


@pytest.mark.parametrize(
    ("reason", "text"),
    [
        (loop_reasons.describe_passed(3.14159, 0.876), "chi2 3.1, overlap 0.88"),
        (loop_reasons.describe_few_points(12, 50.0), "12 points, fewer than 50"),
        (loop_reasons.describe_low_score(0.55001, 0.55), "score at most 0.5501, not above 0.55"),
        (loop_reasons.describe_ambiguous(0.923, 0.7), "ambiguous: another motion has 0.92 of the score 0.70"),
        (loop_reasons.describe_little_overlap(0.69999, 0.7), "overlap 0.699 < 0.7"),
        (loop_reasons.describe_degenerate(0.1301, 0.13), "degenerate: position known to 0.131 m > 0.13 m"),
        (loop_reasons.describe_far(12.06, 11.345), "chi2 12.1 > 11.3"),
        (
            loop_reasons.describe_contradiction(0.94999, 0.95),
            "contradicted: 0.949 < 0.95 of what could be seen there",
        ),
        (
            loop_reasons.describe_withdrawn(loop_reasons.describe_found_again("chi2 1.0, overlap 0.90", 2)),
            "withdrawn, contradicts other loops: found again after a lost track (part 2): chi2 1.0, overlap 0.90",
        ),
        (loop_reasons.describe_unconfirmed("chi2 1.0, overlap 0.90"), "not confirmed yet: chi2 1.0, overlap 0.90"),
    ],
)
def test_a_reason_shows_the_numbers_that_decide_and_rounds_none_to_its_limit(reason, text):
    assert reason == text
