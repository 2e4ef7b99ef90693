"""Analysis: from rows to curves, outcomes, contrasts and verdicts. Trains nothing."""

BAND_NAMES = ("ci", "se", "std", "minmax", "runs")
EDGED_BANDS = tuple(name for name in BAND_NAMES if name != "runs")
"""Bands with a lower and an upper edge."""
EXPORTED_BAND = "std"
"""The band of exported curves by default."""
EXPORT_TABLES = ("episodes", "metrics", "evaluations", "curves", "summary")
EXPORT_SUFFIXES = {".csv": "csv", ".parquet": "parquet", ".tex": "latex", ".md": "markdown"}
