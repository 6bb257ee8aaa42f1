"""Odometry: front end around a registration, local maps, motion prior, planar values in 3D, the run loop."""
