"""``evalkit realtime``: which scans a slower device drops, on a virtual clock."""
