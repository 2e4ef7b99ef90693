"""Figures: what people see. Reads analysis, draws with matplotlib, writes the same bytes every time."""

FIGURE_FORMATS = ("png", "svg", "pdf")
FIGURE_LAYOUTS = ("pneuma", "thesis")
"""Share killed and return with what can be said of them; or one panel, as in the thesis."""
FIGURE_SIZES = ("page", "column", "slide")
"""Two columns of a page, one, or a slide of 16:9."""
FIGURE_KINDS = ("curves", "summary")
"""What a study's runs did over their steps; or what they came to in the end."""
