"""``evalkit export``: write results in other formats."""
