"""What is known of an implementation, level by level, up to one verdict."""
