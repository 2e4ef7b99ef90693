"""Figures: what people see. Reads analysis, draws with matplotlib, writes the same bytes every time."""

FIGURE_FORMATS = ("png", "svg", "pdf")
FIGURE_KINDS = ("curves", "summary")
"""What a study's runs did over their steps; or what they came to in the end."""
