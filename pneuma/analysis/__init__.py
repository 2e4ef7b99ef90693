"""Analysis: from records to curves. Reads the store, trains nothing."""

BAND_NAMES = ("std", "se", "minmax")
WINDOWS = ("budget-5%", "trailing-100")
RECORD_TABLES = ("episodes", "metrics", "evaluations")
EXPORT_TABLES = (*RECORD_TABLES, "curves")
EXPORT_FORMATS = ("csv", "parquet", "latex")
EXPORT_SUFFIXES = {".csv": "csv", ".parquet": "parquet", ".tex": "latex"}
