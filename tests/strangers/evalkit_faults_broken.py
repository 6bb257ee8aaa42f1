"""A module that fails when it is imported, and not for want of a library."""

raise RuntimeError("the licence server does not answer")
