"""The commands of the program, one folder each; ``evalkit.cli`` imports a command when it is called.

``inspect`` and ``datasets`` are in ``datasets/evalkit_datasets/commands/``: they use readers and a catalogue, which
evalkit does not know.
"""
