"""Data sets that ship with evalkit: synthetic worlds, recordings, and readers of log formats.

An import goes to the right only: ``commands`` (``evalkit inspect`` and ``evalkit datasets``), ``recordings`` (the
catalogue), ``readers`` (one file a log format) and ``worlds`` (simulated drives), ``parsing`` (files to plain values).
"""
