"""Measure how honest intervals and verdicts are: many seeds run once, then resampled."""
