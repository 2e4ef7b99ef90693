"""Options that several commands share, and how their texts become values."""

from __future__ import annotations

import functools
import inspect
import os
import tomllib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from json import dumps
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from pneuma.errors import UserError, unknown_name
from pneuma.figures import FIGURE_FORMATS
from pneuma.study.executors.base import EXECUTORS, HERE, LOCAL, RAY, SLURM, Supervision, load_executor
from pneuma.study.plan import Selection
from pneuma.study.spec import CLAIMS, MOST_SEEDS, PRESETS, SEEDS_ALLOWED, read_seeds
from pneuma.worlds import TEXT, WORLDS


def read_path(text: str) -> Path:
    """Read a path as a shell does: a `~` that somebody's home folder can stand for is that folder."""
    return Path(os.path.expanduser(text))


def option(name: str, metavar: str, told: str) -> Any:
    """Return an option of a text, which becomes a value by the functions below."""
    return typer.Option(name, metavar=metavar, help=told)


def flag(name: str, told: str) -> Any:
    """Return an option that is there or not."""
    return typer.Option(name, help=told)


def path_option(name: str, metavar: str, told: str) -> Any:
    """Return an option of a path."""
    return typer.Option(name, metavar=metavar, parser=read_path, help=told)


RESULTS = Path("results")
"""The usual results folder."""

Text = str | None
"""An option that may be left out."""
Several = list[str] | None
"""An option that may be repeated."""

StudyName = Annotated[
    str, typer.Argument(metavar="NAME", help="A study's name, or the path of a study file (….toml).")
]
RunName = Annotated[
    str, typer.Argument(metavar="RUN_ID", help="A stored run's id, or its first digits (4 at least).")
]
Results = Annotated[
    Path,
    typer.Option(
        "--results", metavar="DIR", parser=read_path, envvar="PNEUMA_RESULTS", help="Where runs are kept."
    ),
]
Json = Annotated[bool, flag("--json", "Print one JSON document on standard output.")]
Quiet = Annotated[bool, flag("--quiet", "Print nothing but results and mistakes.")]
Trust = Annotated[bool, flag("--trust", "Use the reward, level and characters files that the run names.")]
RetryFailed = Annotated[bool, flag("--retry-failed", "Try runs again that crashed before.")]
_AMOUNT = "How much to run: quick for plan and run, else as last run"
Preset = Annotated[Text, option("--preset", "|".join(PRESETS), f"{_AMOUNT}.")]
StudyPreset = Annotated[Text, option("--preset", "|".join((*PRESETS, CLAIMS)), f"{_AMOUNT}.")]
_SEEDS = option(
    "--seeds", "N|LIST", "A count N (seeds 0 to N-1), or seeds: 3,5,8 or 1..5; '7,' is seed 7 alone."
)
Seeds = Annotated[Text, _SEEDS]
OwnSeeds = Annotated[str, _SEEDS]
"""The same of commands with seeds of their own where none are given."""
Steps = Annotated[Text, option("--steps", "N", "Steps of each run, rounded up to whole horizons.")]
EngineName = Annotated[
    Text, option("--engine", "NAME", "What trains: batched or sb3 (default: batched where it can).")
]
Workers = Annotated[Text, option("--workers", "N", "Runs trained at once (default: one a core).")]
Conditions = Annotated[Several, option("--condition", "NAME", "Only this condition (may be repeated).")]
Settings = Annotated[
    Several, option("--set", "KEY=VALUE", "Set a field of the run in every condition (may be repeated).")
]
_WORLDS = "|".join(WORLDS)
WorldName = Annotated[
    Text, option("--world", _WORLDS, f"{', '.join(w.title for w in WORLDS.values())} (default: {TEXT}).")
]
OneWorld = Annotated[
    Text, option("--world", _WORLDS, "One world alone (default: of a study its first, else all).")
]
"""Of commands that show all worlds, or all studies where none is named."""
Formats = Annotated[
    Several,
    option("--format", "|".join(FIGURE_FORMATS), "Of figures (repeatable; default: png and svg)."),
]
FigureFolder = Annotated[Path | None, path_option("--out", "DIR", "Draw a figure into this folder.")]
Outcome = Annotated[str, option("--outcome", "NAME", "What to look at: one of docs/outcomes.md.")]

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
        """Return what they select; None when none of them was given."""
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
        str, option("--executor", "|".join(EXECUTORS), "Where runs are trained, as docs/scaling.md says.")
    ] = LOCAL
    address: Annotated[
        Text, option("--address", "HOST:PORT", "The cluster of --executor ray (default: its own).")
    ] = None
    slurm: Annotated[
        Several,
        option("--slurm", "KEY=VALUE", "What jobs of --executor slurm ask for: partition, time, mem, …"),
    ] = None
    detach: Annotated[bool, flag("--detach", "Leave once jobs of --executor slurm are submitted.")] = False

    def read(self) -> Supervision:
        """Return where runs are trained."""
        executor, address, slurm = self.executor, self.address, self.slurm or []
        if executor not in EXECUTORS:
            raise UserError(f"--executor {executor}: {unknown_name('executor', executor, EXECUTORS)}")
        if address is not None and executor != RAY:
            raise UserError(f"--address {address}: goes with --executor {RAY}")
        if (slurm or self.detach) and executor != SLURM:
            raise UserError(f"{'--slurm ' + slurm[0] if slurm else '--detach'}: goes with --executor {SLURM}")
        asked = (_key_and_value("--slurm", text, "partition=short") for text in slurm)
        own = tuple((key.replace("-", "_"), value) for key, value in asked)
        return Supervision(executor=executor, address=address, slurm=own, detach=self.detach)


Selected = Selection | None
"""A parameter `selection`: what the selecting options come to; None when none of them was given."""
_GROUPS: dict[str, type[Selecting | Placing]] = {"selection": Selecting, "place": Placing}


def grouped(command: Callable[..., Answer]) -> Callable[..., Answer]:
    """Give a command the options that its parameters `selection` and `place` are read from.

    Typer makes a command's options from its signature, so they are put there.
    """
    signature = inspect.signature(command, eval_str=True)
    groups = {name: _GROUPS[name] for name in signature.parameters if name in _GROUPS}
    added = {
        name: list(inspect.signature(group, eval_str=True).parameters.values())
        for name, group in groups.items()
    }

    @functools.wraps(command)
    def run(**given: Any) -> Answer:
        read = {
            name: group(**{own.name: given.pop(own.name) for own in added[name]}).read()
            for name, group in groups.items()
        }
        return command(**read, **given)

    parameters = [own for one in signature.parameters.values() for own in added.get(one.name, [one])]
    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {own.name: own.annotation for own in parameters}
    return run


def read_workers(workers: str | None, place: Supervision = HERE) -> int:
    """Return how many runs train at once: as `--workers` says, or what the place has room for.

    Raises:
        UserError: where that is no number, or the place cannot be reached.
    """
    asked, most = workers and read_count("--workers", workers), load_executor(place).most_workers(place)
    return asked or most


def read_count(option: str, text: str) -> int:
    """Read a whole number of at least 1: 100000, 100_000 or 1e5."""
    try:
        number = float(text)
    except ValueError:
        number = 0.0
    if not (1 <= number < 2**53 and number.is_integer()):
        raise UserError(f"{option} {text}: must be a whole number of at least 1, as in 1e5")
    return int(number)


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
    pairs = (_key_and_value("--set", text, "learning_rate=1e-3") for text in texts or ())
    return {key: _read_value(value) for key, value in pairs}


def _key_and_value(option: str, text: str, example: str) -> tuple[str, str]:
    key, equals, value = (part.strip() for part in text.partition("="))
    if not (key and equals):
        raise UserError(f"{option} {text}: must be KEY=VALUE, as in {option} {example}")
    return key, value


def _read_value(text: str) -> Any:
    """Read a value as TOML would, a list without its brackets and a word without its quotes."""
    for form in (text, f"[{text}]") if "," in text else (text,):
        try:
            return tomllib.loads(f"value = {form}")["value"]
        except (ValueError, RecursionError):
            continue
    return text
