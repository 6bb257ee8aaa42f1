"""Values that cross evalkit: poses, scans, trajectories, grids, run results. Imports nothing else of evalkit."""
