"""The error for users' mistakes, suggestions for misspelled names, safe text, and lines on standard error.

Any function may raise `UserError` for what the user gave (a key, a value, a file, an option), and docstrings
do not repeat it; the command line prints it as one line and leaves with exit code 2.
"""

from __future__ import annotations

import difflib
import re
import shutil
import sys
import textwrap
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from typing import Any, TextIO

NEAR = 0.6
"""Least similarity of a name that is suggested."""
LONGEST_MESSAGE = 4000
"""Characters of a message."""
MOST_LISTED = 10
"""Most names in an error message; the most similar ones are listed."""
SYNONYMS = {
    "lr": "learning_rate", "reward": "return", "rewards": "return", "ep_rew_mean": "return",
    "n_steps": "horizon", "num_steps": "horizon", "batch_size": "minibatch", "minibatch_size": "minibatch",
    "n_epochs": "epochs", "update_epochs": "epochs", "clip_coef": "clip_range", "activation_fn": "activation",
    "ent_coef": "entropy_coefficient", "vf_coef": "value_coefficient", "max_grad_norm": "gradient_limit",
    "n_envs": "slots", "num_envs": "slots", "total_timesteps": "steps",
}  # fmt: skip
"""Other common names of fields, quantities and outcomes."""


@dataclass(frozen=True)
class Hint:
    """An argument that a message names; the command line writes `--steps 5`, Python `steps=5`.

    Attributes:
        field: the argument's name in Python.
        value: the value that helps, or that is wrong, True for a flag; None if the message names the argument
            alone.
    """

    field: str
    value: Any = None

    def __str__(self) -> str:
        return self.field if self.value is None else f"{self.field}={self.value!r}"


class Message(str):
    """A text with hints in it, which are written as in Python.

    Attributes:
        parts: texts, other messages and hints.
    """

    parts: tuple[str | Hint, ...]

    def __new__(cls, *message_parts: str | Hint) -> Message:
        """Join the parts."""
        message = super().__new__(cls, "".join(map(str, message_parts)))
        message.parts = message_parts
        return message


Say = Callable[[str], object]


def silent(message: str) -> None:
    """Say nothing."""


def write_hints(message: str, write_hint: Callable[[Hint], str]) -> str:
    """Return a text or message whose hints are written by a function."""
    if not isinstance(message, Message):
        return message
    return "".join(
        write_hint(message_part) if isinstance(message_part, Hint) else write_hints(message_part, write_hint)
        for message_part in message.parts
    )


class UserError(Exception):
    """A mistake in a command or a file. Its message is one line that names what to change.

    Its arguments are the parts of its `Message`.
    """

    def __str__(self) -> str:
        return "".join(map(str, self.args))


class StorageError(UserError):
    """The disk is full or read-only: training stops and can be resumed later."""


class OwnCodeError(UserError):
    """An error of a user's own code, which is not retried because it would occur again."""


class RunWarning(UserWarning):
    """An oddity of a run that is trained anyway; reported once per run, and stored with it."""


NEEDED_BY_STUDIES = (
    "typer", "rich", "pandas", "pyarrow", "scipy", "torch", "stable_baselines3", "sb3_contrib", "optuna",
    "matplotlib", "jinja2", "safetensors", "yaml",
)  # fmt: skip
"""Packages that commands and studies need, and Pneuma's worlds do not."""


def require(*packages: str, command: str = "") -> None:
    """Raise an error that names the command to install packages, if one is missing."""
    for package in packages:
        if find_spec(package) is None:
            message = f"{package} is not installed: {command or install_command()}"
            raise ModuleNotFoundError(message, name=package) from None


def install_command(extra_name: str = "") -> str:
    """Return the command that installs what Pneuma needs, or an extra.

    Of an installed Pneuma pip only takes what is missing. PyPI's `pneuma` is another project.
    """
    extra = f"[{extra_name}]" if extra_name else ""
    try:
        distribution("pneuma-rl")
    except PackageNotFoundError:
        return f"pip install -c constraints.txt -e '.{extra}' in Pneuma's folder"
    return f"pip install 'pneuma-rl{extra}'" if extra else "pip install pneuma-rl"


def printable(text: str) -> str:
    """Return text in which each invisible character is written as its code, as in JSON.

    For terminals and figures: titles and names may come from untrusted files, and control characters could
    drive a terminal, reverse the direction of writing, or make an SVG that is not valid XML.
    """
    if text.isprintable():
        return text
    return "".join(character if character.isprintable() else f"\\u{ord(character):04x}" for character in text)


def shortened(text: str) -> str:
    """Return text without its middle if it is longer than a message; values and errors may be endless."""
    if len(text) <= LONGEST_MESSAGE:
        return text
    return f"{text[: LONGEST_MESSAGE // 2]} … {text[-LONGEST_MESSAGE // 2 :]}"


def print_aside(message: str) -> None:
    """Print a line on standard error, which stops nothing if its reader has gone."""
    with suppress(OSError):
        print(folded(printable(shortened(message)), sys.stderr), file=sys.stderr, flush=True)


def folded(line: str, stream: TextIO) -> str:
    """Return a line folded between words at a terminal's width; commands stay whole, to be copied."""
    if not (stream and stream.isatty()):
        return line
    width = shutil.get_terminal_size().columns
    indent = " " * (len(line) - len(line.lstrip(" ")))
    whole_commands = re.sub(r"`[^`]*`", lambda command: command[0].replace(" ", "\0"), line)
    folded_line = textwrap.fill(
        whole_commands, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
    return folded_line.replace("\0", " ")


def counted(count: int, noun: str) -> str:
    """Return a count with its noun: 1 run, 2 runs, 10,000 runs."""
    return f"{count:,} {noun}" if count == 1 else f"{count:,} {noun}s"


def tallied(words: Iterable[str]) -> str:
    """Return how often there is each word: 3 done, 1 crashed."""
    return ", ".join(f"{count} {word}" for word, count in Counter(words).items())


def nearest_name(word: str, known_names: Iterable[str]) -> str:
    """Return ' (did you mean X?)' for the most similar of `known_names`; empty if none is similar.

    Another common name of the same thing is near, too, or a first word: `lr` of `learning_rate`, `reward`
    of `final-return`, `entropy` of `entropy_coefficient`.
    """
    candidates, typed_word = list(known_names), str(word).lower()
    pneuma_name = SYNONYMS.get(typed_word, typed_word)
    similar = [name for name in (pneuma_name, f"final-{pneuma_name}".replace("_", "-")) if name in candidates]
    similar += [name for name in candidates if name.startswith(f"{typed_word}_")]
    similar += difflib.get_close_matches(typed_word, candidates, 1, NEAR)
    return f" (did you mean {similar[0]}?)" if similar else ""


def unknown_name(category: str, word: str, known_names: Iterable[str]) -> UserError:
    """Return the error for a name that is not among `known_names`."""
    listed = list(known_names)
    hint = nearest_name(word, listed)
    hidden_count = len(listed) - MOST_LISTED
    if hidden_count > 1:
        if hint:
            return UserError("unknown ", category, f" {word!r}{hint}")
        closest_names = difflib.get_close_matches(str(word).lower(), listed, MOST_LISTED, 0)
        listed = [name for name in listed if name in closest_names] + [f"{hidden_count} more"]
    separator = "; " if any("," in name for name in listed) else ", "
    return UserError("unknown ", category, f" {word!r}{hint}; known are {separator.join(listed)}")
