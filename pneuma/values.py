"""Values of fields as text, for messages, tables, file names and commands; reading such text."""

from __future__ import annotations

import hashlib
import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from contextlib import suppress
from typing import Any


def format_value(field_value: object) -> str:
    """Return a field's value as text: a list without brackets, None as "none"."""
    if isinstance(field_value, list | tuple):
        return ", ".join(map(format_value, field_value)) or "none"
    if isinstance(field_value, bool):
        return str(field_value).lower()
    return "none" if field_value in (None, "") else str(field_value)


def format_short(value: object) -> str:
    """Return a value as short as it can be written: 3e-4, kills, [0.9, 0.999]. Different values differ."""
    if isinstance(value, float):
        digits, _, exponent = f"{value:e}".partition("e")
        scientific = f"{digits.rstrip('0').rstrip('.')}e{int(exponent)}"
        shortest = min(f"{value:g}", scientific, key=len)
        return shortest if float(shortest) == value else repr(value)
    if isinstance(value, str):
        return value
    return format_json(value)


def format_json(value: object) -> str:
    """Return a value as JSON, much as a TOML file has it."""
    return json.dumps(value, default=str, ensure_ascii=False)


def per_cent(share: float) -> str:
    """Return a share in per cent without superfluous decimals: 17.5 %."""
    return f"{100 * share:.3g} %"


def format_settings(settings: Mapping[str, Any]) -> str:
    return ", ".join(
        f"{field_name} = {format_value(field_value)}" for field_name, field_value in settings.items()
    )


def setting_words(settings: Mapping[str, Any]) -> list[str]:
    """Return changed fields as words of a command."""
    return [f"--set={field_name}={_value_word(field_value)}" for field_name, field_value in settings.items()]


def _value_word(field_value: Any) -> str:
    """Return a value as `read_value` reads it."""
    if field_value is None or isinstance(field_value, bool):
        return format_value(field_value)
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


def settings_name(settings: Mapping[str, Any], *words: str) -> str:
    """Return a file name for changed fields; the end of a long one is replaced by a checksum."""
    settings_texts = [
        f"{field_name}={format_value(field_value)}" for field_name, field_value in settings.items()
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
