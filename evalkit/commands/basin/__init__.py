"""``evalkit basin``: from how far off a registration still converges."""
