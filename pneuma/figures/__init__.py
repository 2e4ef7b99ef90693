"""Figures, drawn with matplotlib from the results of analysis; the same data give the same bytes."""

FIGURE_FORMATS = ("png", "svg", "pdf")
