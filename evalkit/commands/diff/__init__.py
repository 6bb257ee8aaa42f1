"""``evalkit diff``: what changed between two results folders or two benchmark files."""
