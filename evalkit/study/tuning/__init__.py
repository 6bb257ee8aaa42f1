"""Fair tuning: the same search budget for every back end, spent on training worlds only."""
