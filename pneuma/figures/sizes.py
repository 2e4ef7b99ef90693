"""Sizes of figures: for one column of a page, for both, and for a slide."""

from __future__ import annotations

import math
from dataclasses import dataclass

from pneuma.errors import UserError


@dataclass(frozen=True)
class Size:
    """How large a figure is, and how it is divided; lengths in inches.

    Attributes:
        width: of the figure.
        height: of the figure; None where it is as high as its panels and words need.
        columns: most panels side by side.
        panel_height: of a panel with its axis, where the height is free.
        small_columns: most small multiples side by side.
        small_height: of a small multiple, where the height is free.
        type_points: size of the text; titles are larger, ticks and captions smaller.
        small_points: the same over small multiples.
        dots_per_inch: of a PNG.
    """

    width: float
    height: float | None
    columns: int
    panel_height: float
    small_columns: int
    small_height: float
    type_points: float
    small_points: float
    dots_per_inch: int

    @property
    def line_inches(self) -> float:
        """Height of a line of text."""
        return self.type_points * 1.5 / 72

    def grid(self, panels: int) -> tuple[int, int]:
        """Return rows and columns of a number of panels, about as many of both."""
        columns = min(self.columns, math.ceil(math.sqrt(panels)))
        return -(-panels // columns), columns

    def check_room(self, rows: int, inches: float) -> None:
        """Refuse more rows of panels than a fixed height has room for.

        Raises:
            UserError: when they would be lower than four lines of text.
        """
        if self.height is not None and inches < rows * 4 * self.line_inches:
            raise UserError(
                f"{rows} rows of panels do not fit a height of {self.height} inches: ask for fewer "
                "quantities or conditions, or for --size page, which is as high as it needs"
            )

    def characters(self, points: float) -> int:
        """Return how many characters of a size, in points, fit a line: DejaVu's are 0.56 as wide as high."""
        return int((self.width - 0.15) * 72 / (0.56 * points))


SIZES = {
    "page": Size(7.0, None, 2, 2.45, 6, 1.0, 8.0, 6.4, 300),
    "column": Size(3.3, None, 1, 2.1, 3, 0.95, 7.0, 5.8, 300),
    "slide": Size(10.0, 5.625, 3, 2.5, 8, 1.0, 12.0, 7.6, 192),  # 1,920 × 1,080
}
