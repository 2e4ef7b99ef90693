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

        def read(value: Any) -> Any:
            try:
                return self.read(value)
            except Exception:  # whatever a value of another kind makes of it
                context = {"allowed": self.allowed, "names": self.names}
                raise PydanticCustomError("allowed", "{allowed}", context) from None

        return core_schema.no_info_plain_validator_function(read)


OF_OPTIMIZER, OF_GYMNASIUM_ENV, OF_OPEN_LEARNER = "optimizer", "gymnasium", "open learner"


@dataclass(frozen=True)
class About:
    """What is known of a field of a run beside its type and default.

    Attributes:
        read_by: the algorithms that read it. Or `OF_OPTIMIZER`, if the optimizer decides that;
            `OF_GYMNASIUM_ENV`, for environments other than Pneuma's; `OF_OPEN_LEARNER`, for learners of
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
    about = About(_names(read_by), _names(arguments), paces)
    return field(default=default, metadata={"about": about})


def _names(text: str) -> tuple[str, ...]:
    return tuple(text.split(", ")) if text else ()


def about_fields(owner: type) -> dict[str, About]:
    """Return what is known of each field of a dataclass."""
    return {item.name: item.metadata.get("about", About()) for item in fields(owner)}


def matching(pattern: str, allowed: str) -> Reads:
    """Restrict text to a form."""

    def read(value: Any) -> str:
        if not isinstance(value, str) or not re.fullmatch(pattern, value):
            raise ValueError
        return value

    return Reads(read, allowed)


def names_like(pattern: str, allowed: str, names: tuple[str, ...] = ()) -> Reads:
    """Restrict a value to names of a form: one, or a list with one per player. The result is a tuple.

    In text form the names are separated by commas, which no name contains.
    """

    def read(value: Any) -> tuple[str, ...]:
        names_given = tuple(value.split(",") if isinstance(value, str) else value)
        if not 1 <= len(names_given) <= MOST_NAMES:
            raise ValueError
        if not all(isinstance(name, str) and re.fullmatch(pattern, name) for name in names_given):
            raise ValueError
        return names_given

    return Reads(read, allowed, names)


def shown_value(value: object) -> str:
    """Return a field's value as text: a list without brackets, None as "none"."""
    if isinstance(value, list | tuple):
        return ", ".join(map(shown_value, value)) or "none"
    if isinstance(value, bool):
        return str(value).lower()
    return "none" if value in (None, "") else str(value)


def short(value: object) -> str:
    """Return a value as short as it can be written: 3e-4, kills, [0.9, 0.999]. Different values differ."""
    if isinstance(value, float):
        digits, _, power = f"{value:e}".partition("e")
        scientific = f"{digits.rstrip('0').rstrip('.')}e{int(power)}"
        shortest = min(f"{value:g}", scientific, key=len)
        return shortest if float(shortest) == value else repr(value)
    if isinstance(value, str):
        return value
    return json.dumps(value, default=str, ensure_ascii=False)


def per_cent(share: float) -> str:
    """Return a share in per cent without superfluous decimals: 17.5 %."""
    return f"{100 * share:.3g} %"


def shown_settings(settings: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} = {shown_value(value)}" for key, value in settings.items())


def setting_words(settings: Mapping[str, Any]) -> list[str]:
    """Return changed fields as words of a command."""
    return [f"--set={key}={_value_word(value)}" for key, value in settings.items()]


def _value_word(value: Any) -> str:
    """Return a value as `read_value` reads it."""
    if value is None or isinstance(value, bool):
        return shown_value(value)
    if isinstance(value, Mapping):
        items = ", ".join(f"{key} = {json.dumps(item)}" for key, item in value.items())
        return f"{{{items}}}"
    if isinstance(value, tuple):
        value = list(value)
    return str(value)


def read_settings(words: Iterable[str]) -> dict[str, Any]:
    """Return the changed fields that `setting_words` gave as words."""
    pairs = (word.removeprefix("--set=").split("=", 1) for word in words)
    return {key: read_value(value) for key, value in pairs}


LONGEST_NAME = 100
MOST_SEEDS = 10_000
SEEDS_ALLOWED = f"a count from 1 to {MOST_SEEDS}, a list of different seeds, or text such as 3,5,8 or 1..5"


def read_seeds(value: object, first: int = 0) -> tuple[int, ...]:
    """Read seeds: a count n, for the n seeds from the first on; a list; or text with numbers and ranges.

    As text, `"5"` is a count, `"5,"` is the seed 5 alone, and `"1..5"` includes both ends.

    Raises:
        ValueError: for anything else, including repeated seeds.
    """
    if isinstance(value, str):
        value = _seeds_of_text(value)
    if type(value) is int and 1 <= value <= MOST_SEEDS:
        return tuple(range(first, first + value))
    if not isinstance(value, list | tuple) or not value:
        raise ValueError
    if not all(type(seed) is int and 0 <= seed < 2**32 for seed in value):
        raise ValueError
    if len(set(value)) < len(value):
        raise ValueError
    return tuple(value)


def _seeds_of_text(text: str) -> int | list[int]:
    """Return the count that a text names, or the list of its seeds."""
    if "," not in text and ".." not in text:
        return int(text)
    seeds: list[int] = []
    for item in text.split(","):
        if item.strip():
            first, dots, last = item.partition("..")
            seed_range = range(int(first), int(last if dots else first) + 1)
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
    return ",".join("..".join(map(str, ends)) for ends in ranges)


def seeds_option(seeds: Collection[int]) -> str:
    """Return seeds as the value of an option: as `shown_seeds`, but `7,` for the seed 7 alone."""
    text = shown_seeds(seeds)
    return f"{text}," if len(seeds) == 1 else text


def settings_name(settings: Mapping[str, Any], *words: str) -> str:
    """Return a file name for changed fields; the end of a long one is replaced by a checksum."""
    settings_texts = [f"{key}={shown_value(value)}" for key, value in settings.items()]
    text = "-".join(settings_texts + list(words))
    name = re.sub(r"[^\w.=+-]+", "-", text).strip("-")
    if len(name) > LONGEST_NAME:
        digest = hashlib.sha256(text.encode(errors="replace")).hexdigest()
        name = f"{name[:LONGEST_NAME]}-{digest[:6]}"
    return name


def read_value(text: str) -> Any:
    """Read a value as TOML would, also without a list's brackets, a word's quotes, or a 0 before a point."""
    if not text:
        return text
    with_zeros = re.sub(r"(?<![\w.])\.(?=\d)", "0.", text)
    for form in (text, f"[{text}]", with_zeros, f"[{with_zeros}]"):
        with suppress(ValueError, RecursionError):
            return tomllib.loads(f"value = {form}")["value"]
    if text.startswith("[") and text.endswith("]"):
        return [read_value(item) for item in split_list(text[1:-1])]
    return text


def split_list(text: str) -> list[str]:
    """Return the items of a list without its brackets; a list in it is one item."""
    items, depth = [""], 0
    for character in text:
        if character in "[{":
            depth += 1
        elif character in "]}":
            depth -= 1
        if character == "," and not depth:
            items.append("")
        else:
            items[-1] += character
    return [item.strip() for item in items]
