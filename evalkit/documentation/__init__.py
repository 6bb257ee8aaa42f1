"""The documentation site: its pages, and what writes the reference pages from the program itself."""
