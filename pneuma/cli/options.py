"""Options: how they are declared, those that several commands share, and those that come together.

A command's options are its parameters, whose defaults declare them, or the fields of a dataclass that is a
parameter of it: `Picked`, `Chosen`, `Place` or `PlaceToLeave`. It returns a `Result`,
which `--json` prints for programs.
"""

from __future__ import annotations

import functools
import inspect
import shlex
from collections.abc import Callable, Iterable
from contextlib import nullcontext
from dataclasses import dataclass, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import typer

from pneuma.cli.output import OUTPUT_FORMATS, Result, kept_for_the_result, print_result, say
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
from pneuma.study.spec import CLAIMS, PRESETS
from pneuma.study.store import Store
from pneuma.values import MOST_SEEDS, SEEDS_ALLOWED, read_seeds, read_value, setting_words, shown_seeds
from pneuma.worlds import WORLDS

if TYPE_CHECKING:
    from pneuma.analysis.frames import StudyData

# --- How options are declared ----------------------------------------------------------------------


def option(
    name: str,
    metavar: str,
    help_text: str,
    read: Callable[[str], Any] | None = None,
    default: Any = None,
) -> Any:
    """Return an option; `read` converts its text."""
    return typer.Option(default, name, metavar=metavar, help=help_text, parser=read)


REQUIRED = ...
"""The default of an option that may not be left out."""


def argument(metavar: str, help_text: str, default: Any = ...) -> Any:
    return typer.Argument(default, metavar=metavar, help=help_text, show_default=False)


def flag(name: str, help_text: str) -> Any:
    return typer.Option(False, name, help=help_text)


def number(name: str, help_text: str, default: Any = None, **limits: Any) -> Any:
    """Return an option for a number within limits; `metavar` is N."""
    return typer.Option(default, name, help=help_text, **{"metavar": "N", **limits})


def choice(name: str, allowed: Iterable[str], help_text: str, metavar: str = "", default: Any = None) -> Any:
    """Return an option with a fixed set of values."""
    names = tuple(allowed)

    def read(text: str) -> str:
        if text not in names:
            raise UserError(f"{name} {text}: must be one of {', '.join(names)}{nearest_name(text, names)}")
        return text

    return typer.Option(
        default, name, metavar=metavar or "|".join(names), help=help_text, parser=read,
        autocompletion=lambda: [*names],
    )  # fmt: skip


def count(name: str, help_text: str, default: Any = None) -> Any:
    """Return an option for a whole number of at least 1: 100000, 100_000 or 1e5."""

    def read(text: str) -> int:
        try:
            number = float(text)
        except ValueError:
            number = 0.0
        if not (1 <= number < 2**53 and number.is_integer()):
            raise UserError(f"{name} {text}: must be a whole number of at least 1")
        return int(number)

    return option(name, "N", help_text, read, default=default)


def seeds(name: str, help_text: str, first: int = 0, default: Any = None) -> Any:
    """Return an option for seeds: a count from `first` on, a list, or ranges that include both ends."""

    def read(text: str) -> tuple[int, ...]:
        try:
            parts = [seed for part in text.split(",") if part.strip() for seed in _span(part)]
            if "," in text or ".." in text:
                return read_seeds(parts)
            return tuple(first + seed for seed in read_seeds(parts[0]))
        except (ValueError, IndexError):
            raise UserError(f"{name} {text}: must be {SEEDS_ALLOWED}, as in 3,5,8 or 1..5") from None

    return option(name, "N|LIST", help_text, read, default=default)


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


# --- The options -----------------------------------------------------------------------------------

Text = str | None
"""An option that may be left out."""
Several = list[str] | None
"""An option that may be repeated."""
SeveralRead = list[Any] | None
"""One whose texts are converted."""

STUDY = argument("NAME", "A study's name, or the path of a study file (….toml).")
RUN = argument("RUN_ID", "A stored run's id, or its first digits.")
RESULTS = typer.Option(
    Path("results"), "--results", metavar="DIR", envvar="PNEUMA_RESULTS", help="Where runs are kept."
)
JSON = flag("--json", "Print one JSON document on standard output.")
OUTPUT_FORMAT = choice(
    "--format", OUTPUT_FORMATS, "How to print it; --json is short for json.", default="table"
)
QUIET = flag("--quiet", "Print nothing but results and mistakes.")
FORCE = flag("--force", "Replace the file even if Pneuma has not made it.")
TRUST = flag("--trust", "Use files, code and arguments of its environment that the run names.")
RETRY_FAILED = flag("--retry-failed", "Try runs again that crashed before.")
STEPS = count("--steps", "Steps of each run, rounded up to whole updates.")
WORKERS = count("--workers", "Runs trained at once (default: one a core).")
SETTINGS = option(
    "--set",
    "KEY=VALUE",
    "Set a field of the run, or of the world (may be repeated).",
    _read_setting,
)
"""Pairs of a field and its value; use `dict(set_ or ())`."""
WORLD = choice(
    "--world", WORLDS, "Whose rules: the arena (default), the thesis's text, or its published code."
)
FORMATS = choice("--format", FIGURE_FORMATS, "Of figures (may be repeated; default: png and svg).")
PLOT_FOLDER = option("--out", "DIR", "Where to write (default: RESULTS/figures).")
OUTCOMES = option("--outcome", "NAME", "One of docs/outcomes.md, instead of the usual (repeatable).")


def seeds_of_runs(default: str | None = None) -> Any:
    help_text = "A count N (seeds 0 to N-1), or seeds: 3,5,8 or 1..5; '7,' is seed 7 alone."
    return seeds("--seeds", help_text, default=default)


# --- Options that come together --------------------------------------------------------------------


@dataclass(frozen=True)
class Picked:
    """Which stored runs of a study a command reads."""

    seeds: Any = seeds_of_runs()
    steps: Any = count("--steps", "Runs of so many steps (default: those last trained here).")
    condition: Several = option("--condition", "NAME", "Only this condition (may be repeated).")
    set_: SeveralRead = SETTINGS
    world: Text = WORLD
    results: Path = RESULTS

    @property
    def selection(self) -> Selection:
        return Selection(None, self.seeds, self.steps, tuple(self.condition or ()), dict(self.set_ or ()))

    @property
    def store(self) -> Store:
        return Store(self.results)

    def open(self, name: str) -> StudyData:
        """Open the finished runs of a study, and say what is shown and what else is stored."""
        from pneuma.analysis.asked import open_study
        from pneuma.analysis.run_index import RunIndex

        tell = functools.partial(say, aside=True)
        return open_study(RunIndex(self.store), name, self.selection, self.world, tell)

    def again(self, data: StudyData, *words: str, **look: Iterable[str]) -> str:
        """Return the command that draws a figure of some data again, whatever budget is trained meanwhile.

        `look` are its other options, each with all its values.
        """
        chosen = selecting_words(replace(self.selection, steps=data.steps or self.steps))
        chosen += ["--world", self.world] if self.world else []
        options = [word for key, values in look.items() for value in values for word in (f"--{key}", value)]
        where = ["--results", str(self.results)]
        return shlex.join(["pneuma", "study", *words, *chosen, *options, *where])


@dataclass(frozen=True)
class Chosen(Picked):
    """Which runs of a study a command trains."""

    steps: Any = STEPS
    preset: Text = option(
        "--preset",
        "|".join((*PRESETS, CLAIMS)),
        "How much to run (default: quick, or the first).",
    )

    @property
    def selection(self) -> Selection:
        return replace(super().selection, preset=self.preset)


@dataclass(frozen=True)
class Place:
    """Where runs train, and how many at once."""

    workers: Any = WORKERS
    executor: str = choice(
        "--executor", EXECUTORS, "Where runs are trained, as docs/scaling.md says.", default=LOCAL
    )
    address: Text = option("--address", "HOST:PORT", "The cluster of --executor ray (default: its own).")
    slurm: SeveralRead = option(
        "--slurm",
        "KEY=VALUE",
        "What jobs of --executor slurm ask for: partition, time, mem, …",
        _key_and_value("--slurm", "partition=short"),
    )
    detach = False

    def config(self) -> ExecutorConfig:
        """Return where and how runs train; refuse options that do not go together."""
        for name, executor in (("address", RAY), ("slurm", SLURM), ("detach", SLURM)):
            if getattr(self, name) and self.executor != executor:
                raise UserError(f"--{name}: goes with --executor {executor}")
        slurm = tuple((key.replace("-", "_"), value) for key, value in self.slurm or ())
        place = ExecutorConfig(executor=self.executor, address=self.address, slurm=slurm, detach=self.detach)
        return replace(place, workers=most_workers(self.workers, place))


@dataclass(frozen=True)
class PlaceToLeave(Place):
    """The same, for a command that need not wait for its runs."""

    detach: bool = flag("--detach", "Leave once jobs of --executor slurm are submitted.")


def most_workers(asked: int | None, place: ExecutorConfig = LOCAL_CONFIG) -> int:
    """Return how many runs train at once: `--workers`, or what the executor has room for."""
    room = load_executor(place).most_workers(place)  # refuses a place that cannot be reached
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
    return words + setting_words(selection.settings)


# --- Commands --------------------------------------------------------------------------------------


class Commands(typer.Typer):
    """A group of commands whose options may come in dataclasses, and whose results are printed."""

    def __init__(self, help_text: str, **more: Any) -> None:
        """Make a group without commands."""
        super().__init__(help=help_text, no_args_is_help=True, rich_markup_mode=None, **more)

    def command(self, name: str | None = None, **more: Any) -> Callable[[Function], Function]:
        register = super().command(name, **more)

        def add(function: Function) -> Function:
            register(_as_command(function))
            return function

        return add


Function = TypeVar("Function", bound=Callable[..., Result | None])


def _as_command(function: Callable[..., Result | None]) -> Callable[..., int]:
    """Return a command that takes the fields of dataclasses as options, and prints the result.

    Typer makes a command's options from its signature. If it returns a result, `--json` is one of them.
    """
    signature = inspect.signature(function, eval_str=True)
    parameters, groups = [], {}
    for name, one in signature.parameters.items():
        if is_dataclass(group := one.annotation) and isinstance(group, type):
            groups[name] = [*inspect.signature(group, eval_str=True).parameters.values()]
        parameters += groups.get(name, [one])
    takes_json, of_result = "json" in signature.parameters, signature.return_annotation is not None
    if of_result and not takes_json:
        kind = inspect.Parameter.POSITIONAL_OR_KEYWORD
        parameters.append(inspect.Parameter("json", kind, default=JSON, annotation=bool))

    @functools.wraps(function)
    def run(**given: Any) -> int:
        json = given.get("json", False) if takes_json else given.pop("json", False)
        for name, options in groups.items():
            fields = {option.name: given.pop(option.name) for option in options}
            given[name] = signature.parameters[name].annotation(**fields)
        with kept_for_the_result() if of_result else nullcontext():
            result = function(**given)
        if result is None:
            return 0
        print_result(result, "json" if json else result.form)
        return result.code

    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {one.name: one.annotation for one in parameters}
    return run
