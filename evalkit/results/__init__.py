"""Results on disk: the store, its reader, and the export formats."""
