"""Statistics over runs: bootstrap, intervals, paired tests."""
