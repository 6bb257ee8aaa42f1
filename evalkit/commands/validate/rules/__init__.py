"""Rules that every back end, data set and mapper must keep; start here to add one.

A rule is a function ``check_...(fixture)`` in the module of its kind of plug-in (``registration_rules``,
``odometry_rules``, ``slam_rules``, ``dataset_rules``, ``mapper_rules``), named in ``RULES`` at its end.
``range_rules`` and ``state_rules`` hold further rules of registrations, ``odometry_state_rules`` of odometries, and
``resource_rules`` those of both on what many calls do to a process, which ``endurance`` measures.
"""
