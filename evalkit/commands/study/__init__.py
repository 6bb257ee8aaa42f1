"""``evalkit study``: designed experiments over parameters and driving."""
