"""A module that fails when it is imported, for another reason than a missing library."""

raise RuntimeError("the licence server does not answer")
