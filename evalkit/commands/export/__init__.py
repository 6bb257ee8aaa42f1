"""``evalkit export``: convert a finished report to the formats of other programs."""
