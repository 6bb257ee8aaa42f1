"""``evalkit validate``: check an implementation against rules and a reference."""
