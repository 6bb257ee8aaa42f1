"""Measure how well each map metric follows a known error."""
