"""Figures, drawn with matplotlib from the results of analysis; the same data give the same bytes."""

FIGURE_FORMATS = ("png", "svg", "pdf")
FIGURE_KINDS = ("curves", "summary", "profile")
"""Curves over steps, a summary of final outcomes, or performance profiles over several environments."""
