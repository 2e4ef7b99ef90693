"""What a value of a configuration may be, declared without loading pydantic, which checks it; and as text."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from collections.abc import Callable, Collection, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, fields
from typing import Annotated, Any

from annotated_types import Interval

MOST_NAMES = 8

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
class About:
    """What is known of a field of a run beside its type and default.

    Attributes:
        read_by: the algorithms that read it. Or `OPTIMIZER`, if the optimizer decides that;
            `GYMNASIUM`, for environments other than Pneuma's; `OPEN_LEARNER`, for learners of
            Stable-Baselines3 as a script would set them up. Empty if every run reads it.
        arguments: what Stable-Baselines3's learners or torch's optimizers call it, if otherwise; PPO first.
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
    """Return the default of a dataclass's field with its `About`; several names are separated by commas."""
    declaration = About(_names(read_by), _names(arguments), paces)
    return field(default=default, metadata={"about": declaration})


def _names(names_text: str) -> tuple[str, ...]:
    return tuple(names_text.split(", ")) if names_text else ()


def about_fields(dataclass_type: type) -> dict[str, About]:
    """Return what is known of each field of a dataclass."""
    return {
        dataclass_field.name: dataclass_field.metadata.get("about", About())
        for dataclass_field in fields(dataclass_type)
    }


def matching(pattern: str, allowed: str) -> Reads:
    """Restrict text to a form."""

    def read(field_value: Any) -> str:
        if not isinstance(field_value, str) or not re.fullmatch(pattern, field_value):
            raise ValueError
        return field_value

    return Reads(read, allowed)


def names_like(pattern: str, allowed: str, known_names: tuple[str, ...] = ()) -> Reads:
    """Restrict a value to names of a form: one, or a list with one per player. The result is a tuple.

    In text form the names are separated by commas, which no name contains.
    """

    def read(field_value: Any) -> tuple[str, ...]:
        names_given = tuple(field_value.split(",") if isinstance(field_value, str) else field_value)
        if not 1 <= len(names_given) <= MOST_NAMES:
            raise ValueError
        if not all(isinstance(name, str) and re.fullmatch(pattern, name) for name in names_given):
            raise ValueError
        return names_given

    return Reads(read, allowed, known_names)


def shown_value(field_value: object) -> str:
    """Return a field's value as text: a list without brackets, None as "none"."""
    if isinstance(field_value, list | tuple):
        return ", ".join(map(shown_value, field_value)) or "none"
    if isinstance(field_value, bool):
        return str(field_value).lower()
    return "none" if field_value in (None, "") else str(field_value)


def short(value: object) -> str:
    """Return a value as short as it can be written: 3e-4, kills, [0.9, 0.999]. Different values differ."""
    if isinstance(value, float):
        digits, _, exponent = f"{value:e}".partition("e")
        scientific = f"{digits.rstrip('0').rstrip('.')}e{int(exponent)}"
        shortest = min(f"{value:g}", scientific, key=len)
        return shortest if float(shortest) == value else repr(value)
    if isinstance(value, str):
        return value
    return json.dumps(value, default=str, ensure_ascii=False)


def per_cent(share: float) -> str:
    """Return a share in per cent without superfluous decimals: 17.5 %."""
    return f"{100 * share:.3g} %"


def shown_settings(settings: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{field_name} = {shown_value(field_value)}" for field_name, field_value in settings.items()
    )


def setting_words(settings: Mapping[str, Any]) -> list[str]:
    """Return changed fields as words of a command."""
    return [f"--set={field_name}={_value_word(field_value)}" for field_name, field_value in settings.items()]


def _value_word(field_value: Any) -> str:
    """Return a value as `read_value` reads it."""
    if field_value is None or isinstance(field_value, bool):
        return shown_value(field_value)
    if isinstance(field_value, Mapping):
        argument_list = ", ".join(
            f"{argument_name} = {json.dumps(argument)}" for argument_name, argument in field_value.items()
        )
        return f"{{{argument_list}}}"
    if isinstance(field_value, tuple):
        field_value = list(field_value)
    return str(field_value)


def read_settings(words: Iterable[str]) -> dict[str, Any]:
    """Return the changed fields that `setting_words` gave as words."""
    pairs = (word.removeprefix("--set=").split("=", 1) for word in words)
    return {field_name: read_value(field_value) for field_name, field_value in pairs}


LONGEST_NAME = 100
MOST_SEEDS = 10_000
SEEDS_ALLOWED = f"a count from 1 to {MOST_SEEDS}, a list of different seeds, or text such as 3,5,8 or 1..5"


def read_seeds(seeds: object, first_seed: int = 0) -> tuple[int, ...]:
    """Read seeds: a count n, for the n seeds from the first on; a list; or text with numbers and ranges.

    As text, `"5"` is a count, `"5,"` is the seed 5 alone, and `"1..5"` includes both ends.

    Raises:
        ValueError: for anything else, including repeated seeds.
    """
    if isinstance(seeds, str):
        seeds = _seeds_of_text(seeds)
    if type(seeds) is int and 1 <= seeds <= MOST_SEEDS:
        return tuple(range(first_seed, first_seed + seeds))
    if not isinstance(seeds, list | tuple) or not seeds:
        raise ValueError
    if not all(type(seed) is int and 0 <= seed < 2**32 for seed in seeds):
        raise ValueError
    if len(set(seeds)) < len(seeds):
        raise ValueError
    return tuple(seeds)


def _seeds_of_text(seeds_text: str) -> int | list[int]:
    """Return the count that a text names, or the list of its seeds."""
    if "," not in seeds_text and ".." not in seeds_text:
        return int(seeds_text)
    seeds: list[int] = []
    for range_text in seeds_text.split(","):
        if range_text.strip():
            first_seed, dots, last_seed = range_text.partition("..")
            seed_range = range(int(first_seed), int(last_seed if dots else first_seed) + 1)
            if len(seed_range) > MOST_SEEDS:
                raise ValueError
            seeds.extend(seed_range)
    return seeds


def shown_seeds(seeds: Iterable[int]) -> str:
    """Return seeds as `--seeds` reads them, sorted, neighbours as a range: 0..49,60."""
    ranges: list[list[int]] = []
    for seed in sorted(set(seeds)):
        if ranges and seed == ranges[-1][-1] + 1:
            ranges[-1] = [ranges[-1][0], seed]
        else:
            ranges.append([seed])
    return ",".join("..".join(map(str, range_ends)) for range_ends in ranges)


def seeds_option(seeds: Collection[int]) -> str:
    """Return seeds as the value of an option: as `shown_seeds`, but `7,` for the seed 7 alone."""
    seeds_text = shown_seeds(seeds)
    return f"{seeds_text}," if len(seeds) == 1 else seeds_text


def settings_name(settings: Mapping[str, Any], *words: str) -> str:
    """Return a file name for changed fields; the end of a long one is replaced by a checksum."""
    settings_texts = [
        f"{field_name}={shown_value(field_value)}" for field_name, field_value in settings.items()
    ]
    settings_text = "-".join(settings_texts + list(words))
    file_name = re.sub(r"[^\w.=+-]+", "-", settings_text).strip("-")
    if len(file_name) > LONGEST_NAME:
        digest = hashlib.sha256(settings_text.encode(errors="replace")).hexdigest()
        file_name = f"{file_name[:LONGEST_NAME]}-{digest[:6]}"
    return file_name


def read_value(value_text: str) -> Any:
    """Read a value as TOML would, also without a list's brackets, a word's quotes, or a 0 before a point."""
    if not value_text:
        return value_text
    with_zeros = re.sub(r"(?<![\w.])\.(?=\d)", "0.", value_text)
    for toml_form in (value_text, f"[{value_text}]", with_zeros, f"[{with_zeros}]"):
        with suppress(ValueError, RecursionError):
            return tomllib.loads(f"value = {toml_form}")["value"]
    if value_text.startswith("[") and value_text.endswith("]"):
        return [read_value(item_text) for item_text in split_list(value_text[1:-1])]
    return value_text


def split_list(list_text: str) -> list[str]:
    """Return the items of a list without its brackets; a list in it is one item."""
    items, depth = [""], 0
    for character in list_text:
        if character in "[{":
            depth += 1
        elif character in "]}":
            depth -= 1
        if character == "," and not depth:
            items.append("")
        else:
            items[-1] += character
    return [item.strip() for item in items]
