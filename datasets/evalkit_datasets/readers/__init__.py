"""Log formats, one file each; start here to add one.

The class of a file reads a recording as a Sequence. Its ``SPEC`` describes it and says which files are of this format
(``suffixes``, ``recognises``); a line in ``pyproject.toml`` registers it. ``reader_common`` has what the readers share.
"""
