"""Synthetic worlds: floor plans, the robot that drives through them, its lidar and its wheel odometry.

To add a world, write its floor plan and route into ``floorplans.toml`` and its spec at the end of ``synthetic.py``; a
line in ``pyproject.toml`` registers it. ``random_office.py``, ``random_home.py`` and ``random_warehouse.py`` draw a
floor plan and a route from a seed, of the parts in ``drawn_plan.py``.
"""
