"""What a value of a configuration may be, declared without loading pydantic, which checks it; and as text."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike, fspath
from typing import Annotated, Any

from annotated_types import Interval

MOST_NAMES = 8
"""As many as there can be players in a world."""

Share = Annotated[float, Interval(ge=0, le=1)]


@dataclass(frozen=True)
class OneOf:
    """Says that a text is one of a few names; the empty one, where it is among them, leaves it open."""

    names: tuple[str, ...]

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        return core_schema.literal_schema(list(self.names))


@dataclass(frozen=True)
class Reads:
    """Says that a value is what a function makes of it, which raises ValueError for what is not allowed.

    Attributes:
        read: the function.
        allowed: what is allowed, in words.
        names: those known beforehand, to suggest one of them.
    """

    read: Callable[[Any], Any]
    allowed: str
    names: tuple[str, ...] = ()

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import PydanticCustomError, core_schema

        def read(value: Any) -> Any:
            try:
                return self.read(value)
            except (ValueError, TypeError):
                context = {"allowed": self.allowed, "names": self.names}
                raise PydanticCustomError("allowed", "{allowed}", context) from None

        return core_schema.no_info_plain_validator_function(read)


def matching(pattern: str, allowed: str) -> Reads:
    """Say that a text has a certain form."""

    def read(value: Any) -> str:
        if not isinstance(value, str) or not re.fullmatch(pattern, value):
            raise ValueError
        return value

    return Reads(read, allowed)


def names_like(pattern: str, allowed: str, names: tuple[str, ...] = ()) -> Reads:
    """Say that a value is a name of a certain form, or a list of one a player; a tuple in the end.

    As a text its names have commas between them, which no name has.
    """

    def read(value: Any) -> tuple[str, ...]:
        each = tuple(value.split(",") if isinstance(value, str) else value)
        if not 1 <= len(each) <= MOST_NAMES:
            raise ValueError
        if not all(isinstance(name, str) and re.fullmatch(pattern, name) for name in each):
            raise ValueError
        return each

    return Reads(read, allowed, names)


def shown_value(value: object) -> str:
    """Return a field's value as people read it: a list without its brackets, nothing as "none"."""
    if isinstance(value, list | tuple):
        return ", ".join(map(shown_value, value)) or "none"
    if isinstance(value, bool):
        return str(value).lower()
    return "none" if value in (None, "") else str(value)


def shown_level(value: object) -> str:
    """Return a field's value where others stand beside it, between commas: a list in brackets."""
    shown = shown_value(value)
    return f"[{shown}]" if "," in shown else shown


@dataclass(frozen=True)
class Number:
    """A number within bounds; `whole` for integers, `optional` where "none" switches it off."""

    low: float
    high: float = math.inf
    whole: bool = False
    above: bool = False
    """Whether `low` itself is excluded."""
    below: bool = False
    """Whether `high` itself is excluded."""
    optional: bool = False

    def read(self, value: object) -> int | float | None:
        """Return the number, or raise ValueError."""
        if self.optional and (value is None or value == "none"):
            return None
        value = _plain(value)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise ValueError
        try:
            number = float(value)
        except OverflowError:  # a whole number with hundreds of digits
            raise ValueError from None
        if not math.isfinite(number) or (self.whole and value != int(value)):
            raise ValueError
        too_low = value <= self.low if self.above else value < self.low
        too_high = value >= self.high if self.below else value > self.high
        if too_low or too_high:
            raise ValueError
        return int(value) if self.whole else number + 0.0  # -0.0 is 0.0

    @property
    def allowed(self) -> str:
        """Say in words what is allowed."""
        kind = "a whole number" if self.whole else "a number"
        parts = [f"{'above' if self.above else 'of at least'} {self._told(self.low)}"]
        if self.high < math.inf:
            parts.append(f"{'below' if self.below else 'at most'} {self._told(self.high)}")
        return f"{kind} {' and '.join(parts)}" + (', or "none"' if self.optional else "")

    def _told(self, bound: float) -> str:
        return str(int(bound)) if self.whole else f"{bound:g}"


@dataclass(frozen=True)
class Text:
    """A name or a path."""

    allowed: str = "a name or a path"
    empty: bool = False

    def read(self, value: object) -> str:
        """Return the text, or raise ValueError."""
        text = fspath(value) if isinstance(value, PathLike) else value
        if not isinstance(text, str) or not (text or self.empty):
            raise ValueError
        return text


@dataclass(frozen=True)
class Several:
    """A list of numbers, each of one kind, with a least and a greatest length."""

    each: Number
    shortest: int
    longest: int

    def read(self, value: object) -> tuple[int | float | None, ...]:
        """Return the numbers as a tuple, or raise ValueError."""
        if not isinstance(value, (list, tuple)) or not self.shortest <= len(value) <= self.longest:
            raise ValueError
        return tuple(self.each.read(item) for item in value)

    @property
    def allowed(self) -> str:
        """Say in words what is allowed."""
        if self.shortest == self.longest:
            return f"{self.shortest} of: {self.each.allowed}"
        return f"a list in brackets of {self.shortest} to {self.longest}, each: {self.each.allowed}"


def _plain(value: object) -> object:
    """Return a NumPy number or truth value as Python's; anything else as it is."""
    if type(value).__module__ != "numpy" or getattr(value, "ndim", None) != 0:
        return value
    return value.item()  # type: ignore[attr-defined]


Reader = Number | Text | Several


def as_tuple(value: Any) -> Any:
    """Return a list, as JSON and TOML give it, as the tuple that a run holds; anything else as it is."""
    return tuple(value) if isinstance(value, list) else value
