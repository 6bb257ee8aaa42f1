"""Plug-ins: protocols, specs, parameters, the registry of names, the code hash."""
