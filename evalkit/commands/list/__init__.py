"""``evalkit list``: the registered plug-ins and the metrics."""
