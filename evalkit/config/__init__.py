"""Read experiment files into frozen, checked plans."""
