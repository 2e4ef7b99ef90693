"""Analysis: from records to curves. Reads the store, trains nothing."""

BAND_NAMES = ("ci", "se", "std", "minmax", "runs")
EDGED_BANDS = tuple(name for name in BAND_NAMES if name != "runs")
"""Bands with a lower and an upper edge."""
EXPORTED_BAND = "std"
"""The band of exported curves by default."""
WINDOWS = ("budget-5%", "trailing-100")
RECORD_TABLES = ("episodes", "metrics", "evaluations")
EXPORT_TABLES = (*RECORD_TABLES, "curves", "summary")
EXPORT_SUFFIXES = {".csv": "csv", ".parquet": "parquet", ".tex": "latex", ".md": "markdown"}

EPISODE_QUANTITIES = ("return", "length", "kills", "hp")
"""Quantities of a training curve that average over episodes."""

ACTION_QUANTITIES = tuple(f"action_{i}" for i in range(5))

UPDATE_QUANTITIES = (
    "entropy",
    "grad_norm",
    "grad_norm_actor",
    "grad_norm_critic",
    "approx_kl",
    "explained_variance",
    "dead_units",
    *ACTION_QUANTITIES,
)
"""Quantities that average over updates: columns of the metrics table."""

TRAINING_QUANTITIES = (*EPISODE_QUANTITIES, *UPDATE_QUANTITIES)

EVALUATION_QUANTITIES = ("share_killed", "score", "argmax_share_killed", "success")
"""Quantities of a curve over evaluations: columns of the evaluations table."""

CURVE_QUANTITIES = (*EVALUATION_QUANTITIES, *TRAINING_QUANTITIES)
"""All quantities of curves."""
