"""Calibrate the fit of a scan to a known map against the true error of the position."""
