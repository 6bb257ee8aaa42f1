"""Catalogued recordings (``catalog.toml``): found on this machine, downloaded or built, and registered as data sets."""
