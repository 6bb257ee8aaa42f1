"""The metrics: pure functions of what a run left behind, and one table of them."""
