"""A finished comparison in the formats of other programs: papers, spreadsheets of text, trajectories, maps, viewers."""
