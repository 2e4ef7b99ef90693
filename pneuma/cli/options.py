"""Options: how they are declared, and those that several commands share.

A command is a function whose parameters are annotated with options, as `steps: opt.Steps = None`, or with a
dataclass of options, as `selection: opt.RunFilter`. It returns a `Result` or an `Answer`, which `Commands`
prints, with `--json` for programs.
"""

from __future__ import annotations

import functools
import inspect
import os
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from pneuma.analysis.answer import Answer
from pneuma.cli.examples import EXAMPLES
from pneuma.cli.output import OUTPUT_FORMATS, Result, answer_result, kept_for_the_result, print_result, say
from pneuma.config import is_gymnasium_id
from pneuma.errors import UserError, nearest_name
from pneuma.figures import FIGURE_FORMATS
from pneuma.presets import WORLDS
from pneuma.seeds import SEEDS_ALLOWED, read_seeds
from pneuma.store.store import Store
from pneuma.study.plan import Query
from pneuma.study.spec import load_study
from pneuma.training.executors.base import EXECUTORS, LOCAL, RAY, ExecutorConfig, load_executor
from pneuma.values import read_value

if TYPE_CHECKING:
    from pneuma.analysis.study_data import StudyData
    from pneuma.store.index import RunIndex

# --- How options are declared ----------------------------------------------------------------------


class WrongText(typer.BadParameter):
    """The text of an option that is not allowed; its message is read after the option's name."""

    def format_message(self) -> str:
        return f"{self.param.opts[0]} {self.message}" if self.param else self.message


def option(
    metavar: str, help_text: str, read: Callable[[str], Any] | None = None, name: str = "", **details: Any
) -> Any:
    """Return an option, called as its parameter unless it has a name; `read` converts its text."""
    option_names = [name] if name else []
    return typer.Option(*option_names, metavar=metavar, help=help_text, parser=read, **details)


def argument(metavar: str, help_text: str) -> Any:
    return typer.Argument(metavar=metavar, help=help_text, show_default=False)


def flag(name: str, help_text: str) -> Any:
    return typer.Option(name, help=help_text)


def choice(allowed: Iterable[str], help_text: str, metavar: str = "", name: str = "", hint: str = "") -> Any:
    """Return an option with a fixed set of values; `hint` ends the message if another one is given."""
    names = tuple(allowed)

    def read(typed: str) -> str:
        if typed not in names:
            raise WrongText(f"{typed}: must be one of {', '.join(names)}{nearest_name(typed, names)}{hint}")
        return typed

    return option(metavar or "|".join(names), help_text, read, name, autocompletion=lambda: list(names))


LARGEST_COUNT = 1e15


def count(help_text: str, form: str = "of at least 1") -> Any:
    """Return an option for a whole number of at least 1; a message on another one has its `form`."""

    def read(typed: str) -> int:
        try:
            number = float(typed)
        except ValueError:
            number = 0.0
        if not (1 <= number <= LARGEST_COUNT and number.is_integer()):
            limit = f", and at most {LARGEST_COUNT:,.0f}" if number > LARGEST_COUNT else ""
            raise WrongText(f"{typed}: must be a whole number {form}{limit}")
        return int(number)

    return option("N", help_text, read)


def seeds(help_text: str, first_seed: int = 0) -> Any:
    """Return an option for seeds: a count from `first_seed` on, a list, or ranges that include both ends."""

    def read(typed: str) -> tuple[int, ...]:
        try:
            return read_seeds(typed, first_seed)
        except ValueError:
            raise WrongText(f"{typed}: must be {SEEDS_ALLOWED}") from None

    return option("N|LIST", help_text, read)


def _read_folder(typed: str) -> Path:
    if os.path.isfile(os.path.expanduser(typed)):
        raise WrongText(f"{typed}: is not a folder")
    return Path(typed)


def _read_setting(typed: str) -> tuple[str, Any]:
    field_name, equals, value_text = typed.partition("=")
    if not (field_name.strip() and equals):
        raise WrongText(f"{typed}: must be KEY=VALUE, as in learning_rate=1e-3")
    return field_name.strip(), read_value(value_text.strip())


# --- The options -----------------------------------------------------------------------------------

Several = list[str] | None
"""The type of an option that may be repeated."""
SeveralRead = list[Any] | None
"""That of one whose texts are converted; `Any` is that of a single one."""

Study = Annotated[str, argument("NAME[@PRESET]", "A study's name, or the path of its file (….toml).")]
RunId = Annotated[str, argument("RUN_ID", "A stored run's id, or its first digits.")]
HERE = Path("results")
Results = Annotated[Path, option("DIR", "Results folder.", _read_folder, envvar="PNEUMA_RESULTS")]
Format = Annotated[str, choice(OUTPUT_FORMATS, "Output format; --json is the same as --format json.")]
TABLE = OUTPUT_FORMATS[0]
"""The default of `Format`."""
JSON = Annotated[bool, flag("--json", "Print one JSON document on standard output.")]
Quiet = Annotated[bool, flag("--quiet", "Print only results and errors.")]
Force = Annotated[bool, flag("--force", "Replace the file even if Pneuma did not write it.")]
Trust = Annotated[bool, flag("--trust", "Load the files, code and environment arguments that the run names.")]
RetryFailed = Annotated[bool, flag("--retry-failed", "Retry runs that crashed before.")]
Seeds = Annotated[Any, seeds("A count N (seeds 0 to N-1), or a list: 3,5,8 or 1..5 ('7,' is only seed 7).")]
Steps = Annotated[
    Any, count("Steps of each run; the last update is completed.", "from 1 to 1e15, as 100_000 or 1e5")
]
Conditions = Annotated[Several, option("NAME", "Include only this condition (repeatable).")]
_CHANGE = "Change a setting of the run or the world (repeatable)."
Settings = Annotated[SeveralRead, option("KEY=VALUE", _CHANGE, _read_setting, "--set")]
"""Pairs of a field and its value; use `dict(set_ or ())`."""
World = Annotated[str | None, choice(WORLDS, "Rule set: arena (default), text or godot.")]
_PLANS = "A preset of the study, such as quick or paper; or write NAME@PRESET."
Preset = Annotated[str | None, option("PRESET", _PLANS)]
_FIGURE_FORMATS = "File format of figures (repeatable; default: png and svg)."
Formats = Annotated[SeveralRead, choice(FIGURE_FORMATS, _FIGURE_FORMATS, name="--format")]
PlotFolder = Annotated[
    Path | None, option("FILE|DIR", "File or folder to write (default: RESULTS/figures).", name="--out")
]
_OUTCOMES = "Outcome to report instead of the defaults (repeatable; see docs/outcomes.md)."
Outcomes = Annotated[Several, option("NAME", _OUTCOMES)]
Workers = Annotated[Any, count("Parallel workers (default: one per core).")]
_WHERE = "Where runs are trained (default: local; see docs/scaling.md)."
_QUEUES = "; docs/scaling.md shows how to use the queue of a cluster"
Executor = Annotated[str | None, choice(EXECUTORS, _WHERE, hint=_QUEUES)]
Address = Annotated[str | None, option("HOST:PORT", "Address of a Ray cluster (default: start a local one).")]


# --- Groups of options -----------------------------------------------------------------------------


@dataclass(frozen=True)
class RunFilter:
    """Which cells of a study a command is about."""

    seeds: Seeds = None
    steps: Steps = None
    condition: Conditions = None
    set_: Settings = None
    preset: Preset = None
    world: World = None
    results: Results = HERE

    def query(self, study_name: str) -> Query:
        """Return the query of a study by its name, or by STUDY@PRESET."""
        query = Query(
            world=self.world,
            preset=self.preset,
            seeds=self.seeds,
            steps=self.steps,
            conditions=tuple(self.condition or ()),
            settings=dict(self.set_ or ()),
        )
        query = query.named(study_name)
        if self.world:
            with suppress(UserError):  # a mistake in its file is told where it is read
                study = load_study(query.study)
                envs = {str(study.fields(condition).get("env", "")) for condition in study.conditions}
                if all(is_gymnasium_id(env) for env in envs):
                    raise typer.BadParameter(
                        f"--world {self.world}: has no effect in {', '.join(sorted(envs))}"
                    )
        return query

    @property
    def store(self) -> Store:
        return Store(self.results)

    @functools.cached_property
    def index(self) -> RunIndex:
        """Every run, stored or published."""
        from pneuma.store.index import RunIndex

        if self.results != HERE and not (self.store.runs() or self.store.published(shipped=False)):
            say(f"Note: {self.results} has no results.")
        return RunIndex(self.store)

    def open(self, study: str | Query) -> StudyData:
        """Open the finished runs of a study's cells, and print what is shown."""
        from pneuma.analysis.runs import open_study

        study_query = self.query(study) if isinstance(study, str) else study
        return open_study(self.index, study_query, say)


@dataclass(frozen=True)
class Resources:
    """Where runs train, and how many at once."""

    workers: Workers = None
    executor: Executor = None
    address: Address = None

    def config(self) -> ExecutorConfig:
        """Return the executor's configuration; refuse options that do not go together."""
        executor = self.executor or LOCAL
        if self.address and executor != RAY:
            raise UserError(f"--address requires --executor {RAY}")
        config = ExecutorConfig(executor=executor, address=self.address)
        most_workers = load_executor(config).most_workers(config)  # refuses a place that cannot be reached
        return replace(config, workers=self.workers or most_workers)


# --- Commands --------------------------------------------------------------------------------------


class Commands(typer.Typer):
    """A group of commands."""

    def __init__(self, name: str, help_text: str, **options: Any) -> None:
        """Make a group without commands."""
        super().__init__(
            name=name,
            help=help_text,
            **{"no_args_is_help": True, "rich_markup_mode": None, "add_completion": False, **options},
        )

    def command(self, name: str | None = None, **options: Any) -> Any:
        """Return what adds a function as a command, whose help ends with its example."""
        add_with = super().command

        def add(function: Callable[..., Result | Answer]) -> Any:
            words = f"{self.info.name} {name or function.__name__}".strip()
            example = f"Example: pneuma {words} {EXAMPLES.get(words, '')}".rstrip()
            return add_with(name, epilog=example, **options)(_printing(function))

        return add


def _printing(function: Callable[..., Result | Answer]) -> Callable[..., int]:
    """Return a command as Typer takes it: it prints its result, has --json, and options one by one."""
    groups: dict[str, Any] = {}
    options: list[inspect.Parameter] = []
    keyword = inspect.Parameter.KEYWORD_ONLY
    for parameter_name, parameter in inspect.signature(function, eval_str=True).parameters.items():
        group = parameter.annotation
        if not is_dataclass(group):
            options.append(parameter.replace(kind=keyword))
            continue
        groups[parameter_name] = group
        types_by_option = get_type_hints(group, include_extras=True)
        for item in fields(group):
            annotation = types_by_option[item.name]
            options.append(inspect.Parameter(item.name, keyword, default=item.default, annotation=annotation))

    @functools.wraps(function)
    def called(json: bool, **values: Any) -> int:
        values = {option_name: _expanded(value) for option_name, value in values.items()}
        for parameter_name, group in groups.items():
            values[parameter_name] = group(**{item.name: values.pop(item.name) for item in fields(group)})
        with kept_for_the_result():
            result = function(**values)
        if isinstance(result, Answer):
            result = answer_result(result)
        if json and result.file:
            raise UserError("--json: standard output already gets the table; name a file with --out")
        print_result(result, "json" if json else values.get("format", TABLE))
        return result.code

    options.append(inspect.Parameter("json", keyword, default=False, annotation=JSON))
    called.__signature__ = inspect.Signature(options)  # type: ignore[attr-defined]
    return called


def _expanded(value: Any) -> Any:
    """Return paths with the user's home in the place of ~, which a shell leaves in --results=~/x."""
    if isinstance(value, list):
        return list(map(_expanded, value))
    return Path(os.path.expanduser(value)) if isinstance(value, Path) else value
