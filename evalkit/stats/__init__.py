"""Statistics over runs: intervals, bootstrap, paired tests, ranks, correlation."""
