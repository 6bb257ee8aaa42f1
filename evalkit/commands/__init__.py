"""The commands of the program, one folder each; ``evalkit.cli`` imports a command when it is called."""
