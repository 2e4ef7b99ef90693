"""The store: runs in a results folder and in published tables, their rows, locks and provenance."""
