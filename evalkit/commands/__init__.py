"""The commands that have a module of their own; ``evalkit.cli`` registers each in one line."""
