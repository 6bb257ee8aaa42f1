"""``evalkit compare``: run methods on sequences, and write the report."""
