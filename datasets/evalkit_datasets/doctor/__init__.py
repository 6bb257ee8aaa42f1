"""The data doctor: what a recording holds, what is wrong with it, and which lines of an experiment would run it."""
