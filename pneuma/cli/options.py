"""Options that several commands share, and how their text is converted."""

from __future__ import annotations

import functools
import inspect
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from pneuma.cli import complete
from pneuma.cli.output import OUTPUT_FORMATS
from pneuma.errors import UserError, nearest_name
from pneuma.figures import FIGURE_FORMATS
from pneuma.study.executors.base import (
    EXECUTORS,
    LOCAL,
    LOCAL_CONFIG,
    RAY,
    SLURM,
    ExecutorConfig,
    load_executor,
)
from pneuma.study.plan import Selection
from pneuma.study.spec import CLAIMS, MOST_SEEDS, PRESETS, SEEDS_ALLOWED, read_seeds
from pneuma.study.store import Store
from pneuma.values import read_value, setting_words, shown_seeds
from pneuma.worlds import WORLDS

# --- How options are declared ----------------------------------------------------------------------


def option(
    name: str,
    metavar: str,
    help_text: str,
    read: Callable[[str], Any] | None = None,
    offer: complete.Complete | None = None,
) -> Any:
    """Return an option; `read` converts its text, and `offer` completes it."""
    return typer.Option(name, metavar=metavar, help=help_text, parser=read, autocompletion=offer)


def argument(metavar: str, help_text: str, offer: complete.Complete | None = None) -> Any:
    """Return an argument; `offer` completes it."""
    return typer.Argument(metavar=metavar, help=help_text, autocompletion=offer, show_default=False)


def flag(name: str, help_text: str) -> Any:
    return typer.Option(name, help=help_text)


def choice(name: str, allowed: Iterable[str], help_text: str, metavar: str = "") -> Any:
    """Return an option with a fixed set of values."""
    names = tuple(allowed)

    def read(text: str) -> str:
        if text not in names:
            raise UserError(f"{name} {text}: must be one of {', '.join(names)}{nearest_name(text, names)}")
        return text

    return option(name, metavar or "|".join(names), help_text, read, complete.offering(lambda typed: names))


def count(name: str, help_text: str) -> Any:
    """Return an option for a whole number of at least 1: 100000, 100_000 or 1e5."""

    def read(text: str) -> int:
        try:
            number = float(text)
        except ValueError:
            number = 0.0
        if not (1 <= number < 2**53 and number.is_integer()):
            raise UserError(f"{name} {text}: must be a whole number of at least 1")
        return int(number)

    return option(name, "N", help_text, read)


def seeds(name: str, help_text: str, first: int = 0) -> Any:
    """Return an option for seeds: a count from `first` on, a list, or ranges that include both ends."""

    def read(text: str) -> tuple[int, ...]:
        try:
            parts = [seed for part in text.split(",") if part.strip() for seed in _span(part)]
            if "," in text or ".." in text:
                return read_seeds(parts)
            return tuple(first + seed for seed in read_seeds(parts[0]))
        except (ValueError, IndexError):
            raise UserError(f"{name} {text}: must be {SEEDS_ALLOWED}, as in 3,5,8 or 1..5") from None

    return option(name, "N|LIST", help_text, read)


def _span(text: str) -> range:
    first, dots, last = text.partition("..")
    seeds = range(int(first), int(last if dots else first) + 1)
    if len(seeds) > MOST_SEEDS:
        raise ValueError
    return seeds


def _key_and_value(name: str, example: str) -> Callable[[str], tuple[str, str]]:
    def read(text: str) -> tuple[str, str]:
        key, equals, value = (part.strip() for part in text.partition("="))
        if not (key and equals):
            raise UserError(f"{name} {text}: must be KEY=VALUE, as in {name} {example}")
        return key, value

    return read


def _read_setting(text: str) -> tuple[str, Any]:
    key, value = _key_and_value("--set", "learning_rate=1e-3")(text)
    return key, read_value(value)


def _read_contrast(text: str) -> tuple[str, Any, Any]:
    """Read KEY=A:B. Either value may contain colons, as many as the other."""
    key, _, values = (part.strip() for part in text.partition("="))
    parts = values.split(":")
    pair = [":".join(part).strip() for part in (parts[: len(parts) // 2], parts[len(parts) // 2 :])]
    if not (key and all(pair)) or len(parts) % 2:
        raise UserError(f"--contrast {text}: must be KEY=A:B, as in activation=tanh:relu")
    return key, read_value(pair[0]), read_value(pair[1])


# --- The options -----------------------------------------------------------------------------------

RESULTS = Path("results")
"""The default results folder."""

Text = str | None
"""An option that may be left out."""
Several = list[str] | None
"""An option that may be repeated."""

StudyName = Annotated[
    str, argument("NAME", "A study's name, or the path of a study file (….toml).", complete.studies)
]
RunName = Annotated[str, argument("RUN_ID", "A stored run's id, or its first digits.", complete.runs)]
Results = Annotated[
    Path, typer.Option("--results", metavar="DIR", envvar="PNEUMA_RESULTS", help="Where runs are kept.")
]
Json = Annotated[bool, flag("--json", "Print one JSON document on standard output.")]
OutputFormat = Annotated[
    str, choice("--format", OUTPUT_FORMATS, "How to print it; --json is short for json.")
]
Quiet = Annotated[bool, flag("--quiet", "Print nothing but results and mistakes.")]
Force = Annotated[bool, flag("--force", "Replace the file even if Pneuma has not made it.")]
Trust = Annotated[bool, flag("--trust", "Use the reward, level and characters files that the run names.")]
RetryFailed = Annotated[bool, flag("--retry-failed", "Try runs again that crashed before.")]
Preset = Annotated[
    Text,
    option(
        "--preset",
        "|".join((*PRESETS, CLAIMS)),
        "How much to run (default: quick, or the first).",
        offer=complete.presets,
    ),
]
Seeds = Annotated[
    Any, seeds("--seeds", "A count N (seeds 0 to N-1), or seeds: 3,5,8 or 1..5; '7,' is seed 7 alone.")
]
Steps = Annotated[Any, count("--steps", "Steps of each run, rounded up to whole updates.")]
Workers = Annotated[Any, count("--workers", "Runs trained at once (default: one a core).")]
Conditions = Annotated[
    Several,
    option("--condition", "NAME", "Only this condition (may be repeated).", offer=complete.conditions),
]
Settings = Annotated[
    list[Any] | None,
    option(
        "--set",
        "KEY=VALUE",
        "Set a field of the run, or of the world (may be repeated).",
        _read_setting,
        complete.fields,
    ),
]
"""Pairs of a field and its value; use `dict(set_ or ())`."""
Contrast = Annotated[
    Any,
    option(
        "--contrast",
        "KEY=A:B",
        "A field, its value said to be better, another: activation=tanh:relu.",
        _read_contrast,
    ),
]
WorldName = Annotated[
    Text,
    choice(
        "--world",
        WORLDS,
        "Whose rules: the arena (default), the thesis's text, or its published code.",
    ),
]
Formats = Annotated[
    list[Any] | None,
    choice("--format", FIGURE_FORMATS, "Of figures (may be repeated; default: png and svg)."),
]
FigureFolder = Annotated[Path | None, option("--out", "DIR", "Draw a figure into this folder.")]
PlotFolder = Annotated[Path | None, option("--out", "DIR", "Where to write (default: RESULTS/figures).")]
Outcome = Annotated[
    str | None,
    option("--outcome", "NAME", "One of docs/outcomes.md (default: monsters killed, or return)."),
]
Outcomes = Annotated[
    Several,
    option("--outcome", "NAME", "One of docs/outcomes.md, instead of the usual (repeatable)."),
]

# --- Options that come together --------------------------------------------------------------------


@dataclass(frozen=True)
class Chosen:
    selection: Selection
    world: str | None
    store: Store


def _chosen(
    preset: Preset = None,
    seeds: Seeds = None,
    steps: Steps = None,
    condition: Conditions = None,
    set_: Settings = None,
    world: WorldName = None,
    results: Results = RESULTS,
) -> Chosen:
    """Read the options that select runs to train."""
    selection = Selection(preset, seeds, steps, tuple(condition or ()), dict(set_ or ()))
    return Chosen(selection, world, Store(results))


def _picked(
    seeds: Seeds = None,
    steps: Annotated[
        Any, count("--steps", "Runs of so many steps (default: those last trained here).")
    ] = None,
    condition: Conditions = None,
    set_: Settings = None,
    world: WorldName = None,
    results: Results = RESULTS,
) -> Chosen:
    """Read the options that select stored runs."""
    selection = Selection(None, seeds, steps, tuple(condition or ()), dict(set_ or ()))
    return Chosen(selection, world, Store(results))


def _place(
    executor: Annotated[
        str, choice("--executor", EXECUTORS, "Where runs are trained, as docs/scaling.md says.")
    ] = LOCAL,
    address: Annotated[
        Text, option("--address", "HOST:PORT", "The cluster of --executor ray (default: its own).")
    ] = None,
    slurm: Annotated[
        list[Any] | None,
        option(
            "--slurm",
            "KEY=VALUE",
            "What jobs of --executor slurm ask for: partition, time, mem, …",
            _key_and_value("--slurm", "partition=short"),
        ),
    ] = None,
    detach: Annotated[
        bool, flag("--detach", "Leave once jobs of --executor slurm are submitted (no search).")
    ] = False,
) -> ExecutorConfig:
    """Read the options that say where runs train."""
    for name, given, executor_of_option in (
        ("address", address, RAY),
        ("slurm", slurm, SLURM),
        ("detach", detach, SLURM),
    ):
        if given and executor != executor_of_option:
            raise UserError(f"--{name}: goes with --executor {executor_of_option}")
    asked = tuple((key.replace("-", "_"), value) for key, value in slurm or ())
    return ExecutorConfig(executor=executor, address=address, slurm=asked, detach=detach)


Answer = TypeVar("Answer")
_GROUPS: dict[str, Callable[..., Any]] = {"chosen": _chosen, "picked": _picked, "place": _place}


def grouped(command: Callable[..., Answer]) -> Callable[..., Answer]:
    """Add to a command the options behind its parameters `chosen`, `picked` and `place`.

    Typer makes a command's options from its signature, so they are added to it.
    """
    signature = inspect.signature(command, eval_str=True)
    added = {
        name: list(inspect.signature(_GROUPS[name], eval_str=True).parameters.values())
        for name in signature.parameters
        if name in _GROUPS
    }

    @functools.wraps(command)
    def run(**given: Any) -> Answer:
        for name, options in added.items():
            given[name] = _GROUPS[name](
                **{parameter.name: given.pop(parameter.name) for parameter in options}
            )
        return command(**given)

    parameters = [
        parameter for one in signature.parameters.values() for parameter in added.get(one.name, [one])
    ]
    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
    return run


def most_workers(asked: int | None, place: ExecutorConfig = LOCAL_CONFIG) -> int:
    """Return how many runs train at once: `--workers`, or what the executor has room for.

    Raises:
        UserError: when the place cannot be reached.
    """
    room = load_executor(place).most_workers(place)
    return asked or room


def selecting_words(selection: Selection) -> list[str]:
    """Return a selection of stored runs as words of a command."""
    words = []
    if selection.seeds is not None:
        counted_up = selection.seeds == tuple(range(len(selection.seeds)))
        listed = shown_seeds(selection.seeds) + ("," if len(selection.seeds) == 1 else "")
        words += ["--seeds", str(len(selection.seeds)) if counted_up else listed]
    words += ["--steps", str(selection.steps)] if selection.steps is not None else []
    words += [word for name in selection.conditions for word in ("--condition", name)]
    return words + setting_words(selection.settings or {})


def drawing_command(words: Sequence[str], picked: Chosen, look: Mapping[str, Iterable[str]]) -> str:
    chosen = [*selecting_words(picked.selection), *(["--world", picked.world] if picked.world else [])]
    options = [word for key, values in look.items() for value in values for word in (f"--{key}", value)]
    return shlex.join(["pneuma", "study", *words, *chosen, *options])
