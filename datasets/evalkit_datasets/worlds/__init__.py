"""Synthetic worlds: floor plans, the robot that drives through them, its lidar and its wheel odometry."""
