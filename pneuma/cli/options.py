"""Options: how they are declared, and those that several commands share.

A command is a function whose parameters are annotated with options, as `steps: opt.Steps = None`, or with a
dataclass of options, as `picked: opt.RunFilter`. It returns a `Result`, which `Commands` prints, with
`--json` for programs.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Iterable
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

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
    from pneuma.analysis.runs import RunIndex
    from pneuma.analysis.study_data import StudyData

# --- How options are declared ----------------------------------------------------------------------


def option(
    name: str, metavar: str, help_text: str, read: Callable[[str], Any] | None = None, **limits: Any
) -> Any:
    """Return an option; `read` converts its text, and limits are those of a number."""
    return typer.Option(name, metavar=metavar, help=help_text, parser=read, **limits)


def argument(metavar: str, help_text: str) -> Any:
    return typer.Argument(metavar=metavar, help=help_text, show_default=False)


def flag(name: str, help_text: str) -> Any:
    return typer.Option(name, help=help_text)


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
JSON = Annotated[bool, flag("--json", "Print one JSON document on standard output.")]
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
    """Which runs of a study a command reads: the options that choose them."""

    seeds: Seeds = None
    steps: StoredSteps = None
    condition: Conditions = None
    set_: Settings = None
    world: World = None
    results: Results = HERE

    @property
    def selection(self) -> Selection:
        settings, preset = dict(self.set_ or ()), getattr(self, "preset", None)
        return Selection(preset, self.seeds, self.steps, tuple(self.condition or ()), settings)

    @property
    def store(self) -> Store:
        return Store(self.results)

    @functools.cached_property
    def index(self) -> RunIndex:
        """Every run, stored or published."""
        from pneuma.analysis.runs import RunIndex

        return RunIndex(self.store)

    def open(self, name: str, world: str | None = None) -> StudyData:
        """Open the finished runs of a study, and say what is shown and what else is stored."""
        from pneuma.analysis.runs import open_study

        return open_study(self.index, name, self.selection, world or self.world, say)

    def choose(self, name: str) -> StudyData:
        """Return the runs of a study, finished or not."""
        from pneuma.analysis.runs import choose_runs, find_study

        found = find_study(self.index, name, self.selection, self.world)
        return choose_runs(self.index, found, self.selection)


@dataclass(frozen=True)
class TrainFilter(RunFilter):
    """Which runs of a study are trained."""

    steps: Steps = None
    preset: Preset = None


@dataclass(frozen=True)
class Place:
    """Where runs train, and how many at once."""

    workers: Workers = None
    executor: Executor = None
    address: Address = None
    slurm: Slurm = None

    def config(self, **more: Any) -> ExecutorConfig:
        """Return it with other fields; refuse options that do not go together."""
        executor, given = self.executor or LOCAL, {**vars(self), **more}
        for name, needed in {"address": RAY, "slurm": SLURM, "detach": SLURM}.items():
            if given.get(name) and executor != needed:
                raise UserError(f"--{name}: goes with --executor {needed}")
        asked = tuple((key.replace("-", "_"), value) for key, value in self.slurm or ())
        config = ExecutorConfig(executor=executor, address=self.address, slurm=asked, **more)
        room = load_executor(config).most_workers(config)  # refuses a place that cannot be reached
        return replace(config, workers=self.workers or room)


def words_of(asked: Any) -> list[object]:
    """Return the options in a dataclass that are not at their defaults, as words of a command."""
    words: list[object] = []
    for item in _options_of(type(asked)):
        value, name = getattr(asked, item.name), item.annotation.__metadata__[0].default
        if value in (None, item.default) and item.name != "results":
            continue
        if name == "--set":
            words += setting_words(dict(value))
        elif name == "--seeds":
            words += [name, shown_seeds(value) + "," * (len(value) == 1)]
        elif value is True:
            words.append(name)
        else:
            several = value if isinstance(value, list) else [value]
            words += [word for each in several for word in (name, each)]
    return words


# --- Commands --------------------------------------------------------------------------------------


class Commands(typer.Typer):
    """A group of commands."""

    def __init__(self, name: str, help_text: str, **more: Any) -> None:
        """Make a group without commands."""
        usual = {"no_args_is_help": True, "rich_markup_mode": None, "add_completion": False}
        super().__init__(name=name, help=help_text, **{**usual, **more})

    def command(self, name: str | None = None, **more: Any) -> Any:
        add = super().command(name, **more)
        return lambda function: add(_printing(function))


def _printing(function: Callable[..., Result]) -> Callable[..., int]:
    """Return a command as Typer takes it: it prints its result, has --json, and options one by one."""
    own = inspect.signature(function, eval_str=True).parameters
    groups: dict[str, Any] = {
        name: each.annotation for name, each in own.items() if is_dataclass(each.annotation)
    }

    @functools.wraps(function)
    def called(json: bool, **given: Any) -> int:
        for name, group in groups.items():
            given[name] = group(**{item.name: given.pop(item.name) for item in fields(group)})
        with kept_for_the_result():
            result = function(**given)
        if json and result.file:
            raise UserError("--json: standard output is for the table; name a file by --out")
        print_result(result, "json" if json else given.get("format", TABLE))
        return result.code

    options: list[inspect.Parameter] = []
    for name, each in own.items():
        options += _options_of(groups[name]) if name in groups else [each.replace(kind=each.KEYWORD_ONLY)]
    json = inspect.Parameter("json", inspect.Parameter.KEYWORD_ONLY, default=False, annotation=JSON)
    called.__signature__ = inspect.Signature([*options, json])  # type: ignore[attr-defined]
    return called


def _options_of(group: Any) -> list[inspect.Parameter]:
    types, kind = get_type_hints(group, include_extras=True), inspect.Parameter.KEYWORD_ONLY
    return [
        inspect.Parameter(item.name, kind, default=item.default, annotation=types[item.name])
        for item in fields(group)
    ]
