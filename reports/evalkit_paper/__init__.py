"""Reproduce the paper: its tables, figures and claims beside what is measured here."""
