"""Options that several commands share, and how their texts become values."""

from __future__ import annotations

import functools
import inspect
import math
import os
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from json import dumps
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from pneuma.errors import UserError, unknown_name
from pneuma.study.executors.base import EXECUTORS, HERE, LOCAL, RAY, SLURM, Place, load_executor
from pneuma.study.plan import Selection
from pneuma.study.spec import CLAIMS, MOST_SEEDS, PRESETS, SEEDS_ALLOWED, read_seeds
from pneuma.worlds import TEXT, WORLDS


def read_path(text: str) -> Path:
    """Read a path as a shell does: a `~` that somebody's home folder can stand for is that folder."""
    return Path(os.path.expanduser(text))


def _option(name: str, metavar: str, told: str) -> Any:
    return typer.Option(name, metavar=metavar, help=told)


Text = str | None
"""An option that may be left out; its text becomes a value by the functions below."""
Several = list[str] | None
"""An option that may be repeated."""

StudyName = Annotated[
    str, typer.Argument(metavar="NAME", help="A study's name, or the path of a study file (….toml).")
]
Results = Annotated[
    Path,
    typer.Option(
        "--results", metavar="DIR", parser=read_path, envvar="PNEUMA_RESULTS", help="Where runs are kept."
    ),
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document on standard output.")]
Quiet = Annotated[bool, typer.Option("--quiet", help="Print nothing but results and mistakes.")]
Trust = Annotated[
    bool, typer.Option("--trust", help="Use the reward, level and characters files that the run names.")
]
_AMOUNT = "How much to run: quick for plan and run, else as last run"
Preset = Annotated[Text, _option("--preset", "|".join(PRESETS), f"{_AMOUNT}.")]
StudyPreset = Annotated[Text, _option("--preset", "|".join((*PRESETS, CLAIMS)), f"{_AMOUNT}.")]
_SEEDS = _option(
    "--seeds", "N|LIST", "A count N (seeds 0 to N-1), or seeds: 3,5,8 or 1..5; '7,' is seed 7 alone."
)
Seeds = Annotated[Text, _SEEDS]
OwnSeeds = Annotated[str, _SEEDS]
"""The same of commands with seeds of their own where none are given."""
Steps = Annotated[Text, _option("--steps", "N", "Steps of each run, rounded up to whole horizons.")]
EngineName = Annotated[
    Text, _option("--engine", "NAME", "What trains: batched or sb3 (default: batched where it can).")
]
Workers = Annotated[Text, _option("--workers", "N", "Runs trained at once (default: one a core).")]
Conditions = Annotated[Several, _option("--condition", "NAME", "Only this condition (may be repeated).")]
Settings = Annotated[
    Several, _option("--set", "KEY=VALUE", "Set a field of the run in every condition (may be repeated).")
]
_WORLDS = "|".join(WORLDS)
WorldName = Annotated[
    Text,
    _option("--world", _WORLDS, f"{', '.join(w.title for w in WORLDS.values())} (default: {TEXT})."),
]
NamedWorld = Annotated[
    Text, _option("--world", _WORLDS, f"One world alone (default with NAME: {TEXT}; without: all).")
]
"""Of commands that take all studies where none is named."""
OnlyWorld = Annotated[Text, _option("--world", _WORLDS, "One world alone (default: all, and the logs).")]
"""Of a command that judges all there is, the logs among it."""

Answer = TypeVar("Answer")


@dataclass(frozen=True)
class Selecting:
    """The options that select runs; None or empty where one is not given."""

    preset: StudyPreset = None
    seeds: Seeds = None
    steps: Steps = None
    engine: EngineName = None
    condition: Conditions = None
    set_: Settings = None

    def read(self) -> Selection | None:
        """Return what they select; None when none of them was given.

        Raises:
            UserError: naming the option, the value and what is allowed.
        """
        if not any(value is not None and value != [] for value in vars(self).values()):
            return None
        return Selection(
            preset=self.preset,
            seeds=None if self.seeds is None else read_seeds_option(self.seeds),
            steps=None if self.steps is None else read_count("--steps", self.steps),
            engine=self.engine,
            conditions=tuple(self.condition or ()),
            settings=read_settings_options(self.set_),
        )


@dataclass(frozen=True)
class Placing:
    """The options that say where runs are trained."""

    executor: Annotated[
        str,
        _option("--executor", "|".join(EXECUTORS), "Where runs are trained, as docs/scaling.md says."),
    ] = LOCAL
    address: Annotated[
        Text, _option("--address", "HOST:PORT", "The cluster of --executor ray (default: its own).")
    ] = None
    slurm: Annotated[
        Several,
        _option("--slurm", "KEY=VALUE", "What jobs of --executor slurm ask for: partition, time, mem, …"),
    ] = None
    detach: Annotated[
        bool, typer.Option("--detach", help="Leave once jobs of --executor slurm are submitted.")
    ] = False

    def read(self) -> Place:
        """Return the place.

        Raises:
            UserError: naming the option, the value and what is allowed.
        """
        executor, address, slurm = self.executor, self.address, self.slurm or []
        if executor not in EXECUTORS:
            raise UserError(f"--executor {executor}: {unknown_name('executor', executor, EXECUTORS)}")
        if address is not None and executor != RAY:
            raise UserError(f"--address {address}: goes with --executor {RAY}")
        if (slurm or self.detach) and executor != SLURM:
            raise UserError(f"{'--slurm ' + slurm[0] if slurm else '--detach'}: goes with --executor {SLURM}")
        return Place(executor, address, slurm=tuple(map(_read_slurm, slurm)), detach=self.detach)


def _read_slurm(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip() or not value.strip():
        raise UserError(f"--slurm {text}: must be KEY=VALUE, as in --slurm partition=short")
    return key.strip().replace("-", "_"), value.strip()


def read_selection(*options: Any) -> Selection | None:
    """Return what the selecting options select; None when none of them was given."""
    return Selecting(*options).read()


Selected = Selection | None
"""What `selects` hands to a command; None when no selecting option was given."""


def selects(command: Callable[..., Answer]) -> Callable[..., Answer]:
    """Give a command the options that select runs; it gets what they come to as its `selection`."""
    return _with_options(command, "selection", Selecting)


def places(command: Callable[..., Answer]) -> Callable[..., Answer]:
    """Give a command the options that say where runs are trained; it gets that as its `place`."""
    return _with_options(command, "place", Placing)


def _with_options(
    command: Callable[..., Answer], name: str, options: type[Selecting | Placing]
) -> Callable[..., Answer]:
    """Put options in the place of a command's parameter, which then is what they read as.

    Typer makes a command's options from its signature, so they are put there.
    """
    signature = inspect.signature(command, eval_str=True)
    added = inspect.signature(options, eval_str=True).parameters

    @functools.wraps(command)
    def run(**given: Any) -> Answer:
        told = options(**{key: given.pop(key) for key in added}).read()
        return command(**{name: told}, **given)

    parameters = [
        own
        for parameter in signature.parameters.values()
        for own in (added.values() if parameter.name == name else (parameter,))
    ]
    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {own.name: own.annotation for own in parameters}
    return run


def read_workers(workers: str | None, place: Place = HERE) -> int:
    """Return how many runs train at once: as `--workers` says, or what the place has room for.

    Raises:
        UserError: where that is no number, or the place cannot be reached.
    """
    if workers is not None:
        return read_count("--workers", workers)
    return load_executor(place).most_workers(place)


def read_count(option: str, text: str) -> int:
    """Read a whole number of at least 1: 100000, 100_000 or 1e5."""
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not (1 <= number < 2**53 and number.is_integer()):
        raise UserError(f"{option} {text}: must be a whole number of at least 1, as in 1e5")
    return int(number)


def read_seconds(option: str, text: str) -> float:
    """Read a positive number of seconds."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not 0 < seconds < float("inf"):
        raise UserError(f"{option} {text}: must be a positive number of seconds")
    return seconds


def read_seeds_option(text: str) -> tuple[int, ...]:
    """Read `--seeds`: a count, a list, or ranges with both ends among them: 3,5,8 or 1..5."""
    try:
        parts = [seed for part in text.split(",") if part.strip() for seed in _span(part)]
        return read_seeds(parts if "," in text or ".." in text else parts[0])
    except (ValueError, IndexError, UserError):
        raise UserError(f"--seeds {text}: must be {SEEDS_ALLOWED}, as in 3,5,8 or 1..5") from None


def _span(text: str) -> range:
    """Read a seed, or a first and a last one."""
    first, dots, last = text.partition("..")
    seeds = range(int(first), int(last if dots else first) + 1)
    if len(seeds) > MOST_SEEDS:
        raise ValueError
    return seeds


def selecting_words(selection: Selection) -> list[str]:
    """Return the options by which a person selects this, as words of a command."""
    words = ["--preset", selection.preset] if selection.preset else []
    if selection.seeds is not None:
        counted_up = selection.seeds == tuple(range(len(selection.seeds)))
        listed = ",".join(map(str, selection.seeds)) + ("," if len(selection.seeds) == 1 else "")
        words += ["--seeds", str(len(selection.seeds)) if counted_up else listed]
    if selection.steps is not None:
        words += ["--steps", str(selection.steps)]
    if selection.engine:
        words += ["--engine", selection.engine]
    words += [word for name in selection.conditions for word in ("--condition", name)]
    for key, value in (selection.settings or {}).items():
        words += ["--set", f"{key}={value if isinstance(value, str) else dumps(value)}"]
    return words


def read_settings_options(texts: Sequence[str] | None) -> dict[str, Any]:
    """Read every `--set KEY=VALUE`."""
    return dict(_read_setting(text) for text in texts or ())


def _read_setting(text: str) -> tuple[str, Any]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip():
        raise UserError(f"--set {text}: must be KEY=VALUE, as in --set learning_rate=1e-3")
    return key.strip(), _read_value(value.strip())


def _read_value(text: str) -> Any:
    """Read a value as TOML would, a list without its brackets and a word without its quotes."""
    for form in (text, f"[{text}]") if "," in text else (text,):
        try:
            return tomllib.loads(f"value = {form}")["value"]
        except (ValueError, RecursionError):
            continue
    return text


def print_json(document: object) -> None:
    """Print the one JSON document of a command; numbers that JSON has not, as NaN, are null in it."""
    print(dumps(_without_nan(document), indent=2, allow_nan=False))


def print_listed(kind: str, tables: Mapping[str, Mapping[str, Any]], json: bool) -> None:
    """Print names, titles and sections of shipped files, whose contents are given by their names."""
    rows = [{kind: name, "title": t["title"], "section": t.get("section", "")} for name, t in tables.items()]
    if json:
        many = {"study": "studies", "search": "searches"}[kind]
        return print_json({"schema": 1, many: rows})
    for row in rows:
        section = f"thesis section {row['section']}" if row["section"] else ""
        print(f"{row[kind]:<18} {row['title']:<44} {section}")
    return None


def _without_nan(value: object) -> object:
    if isinstance(value, Mapping):
        return {key: _without_nan(own) for key, own in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(own) for own in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def say(text: str, aside: bool = False, quiet: bool = False) -> None:
    """Print a line for people; aside is on standard error, where standard output is for a document.

    Nobody need read standard error for a command to go on.
    """
    if quiet:
        return
    try:
        print(text, file=sys.stderr if aside else sys.stdout)
    except OSError:  # nobody reads any more, or the terminal was closed
        if not aside:
            raise
