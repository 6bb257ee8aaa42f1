"""Parse files from outside into plain values, with bounds on the cost of a damaged file: the readers use them."""
