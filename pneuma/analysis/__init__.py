"""Analysis: from records to curves. Reads the store, trains nothing."""
