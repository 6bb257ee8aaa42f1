"""Terminal output and command-line options shared by several commands."""
