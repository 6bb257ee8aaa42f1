"""Data sets and readers that ship with evalkit: synthetic worlds and recordings."""
