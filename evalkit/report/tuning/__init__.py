"""The page of a tuning: what was found, what it cost, and whether it holds on what was not tuned on."""
