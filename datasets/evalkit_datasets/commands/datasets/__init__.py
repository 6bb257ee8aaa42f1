"""``evalkit datasets list | fetch NAME... | example BAG``."""
