"""Read and write files that come from outside, with bounds: TOML, JSON, arrays, map_server maps."""
