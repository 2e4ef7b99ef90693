"""Options: how they are declared, and those that several commands share.

A command's parameters are annotated with options, as `steps: opt.Steps = None`. It returns a `Result`, which
`Command` prints, with `--json` for programs.
"""

from __future__ import annotations

import functools
import shlex
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand
from typer.main import get_command

from pneuma.cli.output import OUTPUT_FORMATS, Result, kept_for_the_result, print_result, say
from pneuma.errors import UserError, nearest_name
from pneuma.figures import FIGURE_FORMATS
from pneuma.presets import WORLDS
from pneuma.study.executors.base import EXECUTORS, LOCAL, RAY, SLURM, ExecutorConfig, load_executor
from pneuma.study.plan import Selection
from pneuma.study.spec import CLAIMS, PRESETS
from pneuma.study.store import Store
from pneuma.values import MOST_SEEDS, SEEDS_ALLOWED, read_seeds, read_value, setting_words, shown_seeds

if TYPE_CHECKING:
    from pneuma.analysis.study_data import StudyData

# --- How options are declared ----------------------------------------------------------------------


def option(name: str, metavar: str, help_text: str, read: Callable[[str], Any] | None = None) -> Any:
    """Return an option; `read` converts its text."""
    return typer.Option(name, metavar=metavar, help=help_text, parser=read)


def argument(metavar: str, help_text: str) -> Any:
    return typer.Argument(metavar=metavar, help=help_text, show_default=False)


def flag(name: str, help_text: str) -> Any:
    return typer.Option(name, help=help_text)


def number(name: str, help_text: str, metavar: str = "N", **limits: Any) -> Any:
    """Return an option for a number within limits."""
    return typer.Option(name, help=help_text, metavar=metavar, **limits)


def choice(name: str, allowed: Iterable[str], help_text: str, metavar: str = "") -> Any:
    """Return an option with a fixed set of values."""
    names = tuple(allowed)

    def read(text: str) -> str:
        if text not in names:
            raise UserError(f"{name} {text}: must be one of {', '.join(names)}{nearest_name(text, names)}")
        return text

    return typer.Option(
        name, metavar=metavar or "|".join(names), help=help_text, parser=read,
        autocompletion=lambda: [*names],
    )  # fmt: skip


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


# --- The options -----------------------------------------------------------------------------------

Several = list[str] | None
"""The type of an option that may be repeated."""
SeveralRead = list[Any] | None
"""That of one whose texts are converted; `Any` is that of a single one."""

Study = Annotated[str, argument("NAME", "A study's name, or the path of a study file (….toml).")]
RunId = Annotated[str, argument("RUN_ID", "A stored run's id, or its first digits.")]
HERE = Path("results")
Results = Annotated[
    Path, typer.Option("--results", metavar="DIR", envvar="PNEUMA_RESULTS", help="Where runs are kept.")
]
Format = Annotated[str, choice("--format", OUTPUT_FORMATS, "How to print it; --json is short for json.")]
TABLE = OUTPUT_FORMATS[0]
"""The default of `Format`."""
Quiet = Annotated[bool, flag("--quiet", "Print nothing but results and mistakes.")]
Force = Annotated[bool, flag("--force", "Replace the file even if Pneuma has not made it.")]
Trust = Annotated[
    bool, flag("--trust", "Use files, code and arguments of its environment that the run names.")
]
RetryFailed = Annotated[bool, flag("--retry-failed", "Try runs again that crashed before.")]
Seeds = Annotated[
    Any, seeds("--seeds", "A count N (seeds 0 to N-1), or seeds: 3,5,8 or 1..5; '7,' is seed 7 alone.")
]
Steps = Annotated[Any, count("--steps", "Steps of each run, rounded up to whole updates.")]
StoredSteps = Annotated[Any, count("--steps", "Runs of so many steps (default: those last trained here).")]
Conditions = Annotated[Several, option("--condition", "NAME", "Only this condition (may be repeated).")]
Settings = Annotated[
    SeveralRead,
    option("--set", "KEY=VALUE", "Set a field of the run, or of the world (may be repeated).", _read_setting),
]
"""Pairs of a field and its value; use `dict(set_ or ())`."""
World = Annotated[
    str | None,
    choice("--world", WORLDS, "Whose rules: the arena (default), the thesis's text, or its published code."),
]
Preset = Annotated[
    str | None,
    option("--preset", "|".join((*PRESETS, CLAIMS)), "How much to run (default: quick, or the first)."),
]
Formats = Annotated[
    SeveralRead, choice("--format", FIGURE_FORMATS, "Of figures (may be repeated; default: png and svg).")
]
PlotFolder = Annotated[Path | None, option("--out", "DIR", "Where to write (default: RESULTS/figures).")]
Outcomes = Annotated[
    Several, option("--outcome", "NAME", "One of docs/outcomes.md, instead of the usual (repeatable).")
]
Workers = Annotated[Any, count("--workers", "Runs trained at once (default: one a core).")]
Executor = Annotated[
    str | None,
    choice("--executor", EXECUTORS, "Where runs are trained, as docs/scaling.md says (default: local)."),
]
Address = Annotated[
    str | None, option("--address", "HOST:PORT", "The cluster of --executor ray (default: its own).")
]
Slurm = Annotated[
    SeveralRead,
    option(
        "--slurm",
        "KEY=VALUE",
        "What jobs of --executor slurm ask for: partition, time, mem, …",
        _key_and_value("--slurm", "partition=short"),
    ),
]


# --- What they say together ------------------------------------------------------------------------


@dataclass(frozen=True)
class RunFilter:
    """Which runs of a study a command reads, or trains: the options that choose them."""

    seeds: Any = None
    steps: Any = None
    condition: Several = None
    set_: SeveralRead = None
    world: str | None = None
    results: Path = HERE
    preset: str | None = None

    @property
    def selection(self) -> Selection:
        conditions = tuple(self.condition or ())
        return Selection(self.preset, self.seeds, self.steps, conditions, dict(self.set_ or ()))

    @property
    def store(self) -> Store:
        return Store(self.results)

    def open(self, name: str) -> StudyData:
        """Open the finished runs of a study, and say what is shown and what else is stored."""
        from pneuma import api  # pydantic: not for `--help`

        picked, aside = self.selection, functools.partial(say, aside=True)
        return api.open_data(
            name, self.results, steps=picked.steps, seeds=picked.seeds, conditions=picked.conditions,
            settings=picked.settings, world=self.world, say=aside,
        )  # fmt: skip

    def again(self, data: StudyData, *words: str, **look: Iterable[str]) -> str:
        """Return the command that draws a figure of some data again, whatever budget is trained meanwhile.

        `look` are its other options, each with all its values.
        """
        chosen = selecting_words(replace(self.selection, steps=data.steps or self.steps))
        chosen += ["--world", self.world] if self.world else []
        options = [word for key, values in look.items() for value in values for word in (f"--{key}", value)]
        where = ["--results", str(self.results)]
        return shlex.join(["pneuma", "study", *words, *chosen, *options, *where])


def place(
    workers: int | None = None,
    executor: str | None = None,
    address: str | None = None,
    slurm: SeveralRead = None,
    detach: bool = False,
) -> ExecutorConfig:
    """Return where runs train, and how many at once; refuse options that do not go together."""
    executor = executor or LOCAL
    given = {"address": (address, RAY), "slurm": (slurm, SLURM), "detach": (detach, SLURM)}
    for name, (value, needed) in given.items():
        if value and executor != needed:
            raise UserError(f"--{name}: goes with --executor {needed}")
    asked = tuple((key.replace("-", "_"), value) for key, value in slurm or ())
    config = ExecutorConfig(executor=executor, address=address, slurm=asked, detach=detach)
    room = load_executor(config).most_workers(config)  # refuses a place that cannot be reached
    return replace(config, workers=workers or room)


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


class Command(TyperCommand):
    """A command whose result is printed, with `--json` as one document."""

    def __init__(self, *given: Any, **more: Any) -> None:
        """Make a command with its own options and `--json`."""
        super().__init__(*given, **more)
        self.params += _options_of_all()

    def invoke(self, ctx: Any) -> int:
        json = ctx.params.pop("json")
        with kept_for_the_result():
            result: Result = super().invoke(ctx)
        if json and result.file:
            raise UserError("--json: standard output is for the table; name a file by --out")
        print_result(result, "json" if json else result.form)
        return result.code


@functools.cache
def _options_of_all() -> list[Any]:
    """Return the options of every command, as Typer makes them."""
    app = typer.Typer(add_completion=False)

    @app.command()
    def _command(
        json: Annotated[bool, flag("--json", "Print one JSON document on standard output.")] = False,
    ) -> None: ...

    return get_command(app).params


class Commands(typer.Typer):
    """A group of commands."""

    def __init__(self, help_text: str, **more: Any) -> None:
        """Make a group without commands."""
        super().__init__(help=help_text, no_args_is_help=True, rich_markup_mode=None, **more)

    def command(self, name: str | None = None, **more: Any) -> Any:
        return super().command(name, cls=Command, **more)
