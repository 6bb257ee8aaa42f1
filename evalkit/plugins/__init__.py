"""What a plug-in implements and how it is found: protocols, specs, parameters, the registry, the code hash."""
