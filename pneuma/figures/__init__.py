"""Figures: what people see. Reads analysis, draws with matplotlib, writes the same bytes every time."""

FIGURE_FORMATS = ("png", "svg", "pdf")
