"""``evalkit inspect``: what a recording holds, what is wrong with it, and a config that runs it."""
