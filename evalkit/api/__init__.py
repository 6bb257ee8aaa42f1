"""The Python API: compare methods, run an experiment, load results, register a pair of clouds."""
