"""Log formats: one file each, whose class reads a recording as a Sequence and whose ``SPEC`` describes it."""
