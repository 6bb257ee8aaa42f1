"""``evalkit inspect``: measure the content and the defects of a recording, and suggest a configuration for it."""
