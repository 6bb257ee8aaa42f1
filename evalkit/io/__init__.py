"""Read and write files with bounds on time and memory: TOML, JSON, arrays, text lines, TUM, map_server maps."""
