"""Studies: many small computations, kept as they come, and what follows from them together."""
