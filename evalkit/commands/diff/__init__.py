"""``evalkit diff``: compare two results folders, or two sets of benchmark files."""
