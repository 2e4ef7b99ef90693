"""What a field of a run may be, declared without loading pydantic, which checks it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from typing import Annotated, Any

from annotated_types import Interval

MOST_NAMES = 8
LONGEST_TEXT = 1000
"""Most letters of what tables and figures show: a title, the name or label of a condition."""

Share = Annotated[float, Interval(ge=0, le=1)]


@dataclass(frozen=True)
class OneOf:
    """Restricts text to some names. The empty one, if among them, means the default."""

    names: tuple[str, ...]

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        return core_schema.literal_schema(list(self.names))


@dataclass(frozen=True)
class Reads:
    """Converts a value by a function that raises ValueError for values that are not allowed.

    Attributes:
        allowed: what is allowed, in words.
        names: those known beforehand, to suggest one of them.
    """

    read: Callable[[Any], Any]
    allowed: str
    names: tuple[str, ...] = ()

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import PydanticCustomError, core_schema

        def read(field_value: Any) -> Any:
            try:
                return self.read(field_value)
            except Exception:  # whatever a value of another kind makes of it
                context = {"allowed": self.allowed, "names": self.names}
                raise PydanticCustomError("allowed", "{allowed}", context) from None

        return core_schema.no_info_plain_validator_function(read)


OPTIMIZER, GYMNASIUM, OPEN_LEARNER = "optimizer", "gymnasium", "open learner"


@dataclass(frozen=True)
class Declaration:
    """What is known of a field of a run, apart from its type and default.

    Attributes:
        read_by: the algorithms that read it. Or `OPTIMIZER`, if the optimizer decides that;
            `GYMNASIUM`, for environments other than Pneuma's; `OPEN_LEARNER`, for learners of
            Stable-Baselines3 as a script would set them up. Empty if every run reads it.
        arguments: its other names in Stable-Baselines3's learners or torch's optimizers, PPO's first.
        paces: whether it affects how long a step takes.
    """

    read_by: tuple[str, ...] = ()
    arguments: tuple[str, ...] = ()
    paces: bool = False


def declare(
    default: Any,
    *,
    read_by: str = "",
    arguments: str = "",
    paces: bool = False,
) -> Any:
    """Return a dataclass's field with its default and `Declaration`; commas separate several names."""
    declaration = Declaration(_names(read_by), _names(arguments), paces)
    return field(default=default, metadata={"declaration": declaration})


def _names(names_text: str) -> tuple[str, ...]:
    return tuple(names_text.split(", ")) if names_text else ()


def field_declarations(dataclass_type: type) -> dict[str, Declaration]:
    """Return the declaration of each field of a dataclass."""
    return {
        dataclass_field.name: dataclass_field.metadata.get("declaration", Declaration())
        for dataclass_field in fields(dataclass_type)
    }


def matching(pattern: str, allowed: str, known_names: tuple[str, ...] = ()) -> Reads:
    """Restrict text to a form."""

    def read(field_value: Any) -> str:
        if not isinstance(field_value, str) or not re.fullmatch(pattern, field_value):
            raise ValueError
        return field_value

    return Reads(read, allowed, known_names)


def names_like(pattern: str, allowed: str, known_names: tuple[str, ...] = ()) -> Reads:
    """Restrict a value to names of a form: one, or a list with one per player. The result is a tuple.

    In text form the names are separated by commas, which no name contains.
    """
    read_name = matching(pattern, allowed).read

    def read(field_value: Any) -> tuple[str, ...]:
        names_given = field_value.split(",") if isinstance(field_value, str) else field_value
        if not 1 <= len(names_given) <= MOST_NAMES:
            raise ValueError
        return tuple(map(read_name, names_given))

    return Reads(read, allowed, known_names)
