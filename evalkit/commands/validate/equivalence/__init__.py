"""Compare two implementations question by question, in lockstep."""
