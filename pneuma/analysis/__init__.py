"""Analysis: from rows to curves, outcomes, contrasts, verdicts and answers. Trains nothing."""

EDGED_BANDS = ("sd", "variance", "ci", "minmax")
"""Bands with a lower and an upper edge, the default first; `variance` is another name of `sd`."""
BAND_NAMES = (*EDGED_BANDS, "runs", "none")
X_AXES = ("steps", "episodes", "wall-clock")
"""What curves lie over; the default first."""
EXPORT_TABLES = ("episodes", "metrics", "evaluations", "curves", "summary")
EXPORT_SUFFIXES = {".csv": "csv", ".parquet": "parquet", ".tex": "latex", ".md": "markdown"}
