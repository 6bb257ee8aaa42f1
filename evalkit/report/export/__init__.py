"""A finished comparison in the formats of other programs: tables, papers, trajectories, maps, viewers."""
