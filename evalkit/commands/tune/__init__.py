"""``evalkit tune``: the same search budget for each back end, judged on other data."""
