"""Options that several commands share, and how their texts become values."""

from __future__ import annotations

import functools
import inspect
import json
import math
import os
import sys
import tomllib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import typer

from pneuma.errors import UserError, unknown_name
from pneuma.study.executors.base import EXECUTORS, HERE, LOCAL, RAY, SLURM, Place, load_executor
from pneuma.study.plan import Selection
from pneuma.study.spec import CLAIMS, PRESETS, SEEDS_ALLOWED, read_seeds
from pneuma.worlds import TEXT, WORLDS


def read_path(text: str) -> Path:
    """Read a path as a shell does: a `~` that somebody's home folder can stand for is that folder."""
    return Path(os.path.expanduser(text))


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
Preset = Annotated[
    str | None,
    typer.Option(
        "--preset",
        metavar="|".join(PRESETS),
        help="How much to run: quick for plan and run, else as last run.",
    ),
]
StudyPreset = Annotated[
    str | None,
    typer.Option(
        "--preset",
        metavar="|".join((*PRESETS, CLAIMS)),
        help="How much to run, also joined (paper+claims): quick for plan and run, else as last run.",
    ),
]
_SEEDS = typer.Option(
    "--seeds", metavar="N|LIST", help="A count N (seeds 0 to N-1) or a list: 3,5,8; '7,' is seed 7."
)
Seeds = Annotated[str | None, _SEEDS]
OwnSeeds = Annotated[str, _SEEDS]
"""The same of commands with seeds of their own where none are given."""
Steps = Annotated[
    str | None,
    typer.Option("--steps", metavar="N", help="Steps of each run, rounded up to whole horizons."),
]
EngineName = Annotated[
    str | None,
    typer.Option(
        "--engine",
        metavar="NAME",
        help="What trains the runs: batched or sb3 (default: batched where it can).",
    ),
]
Workers = Annotated[
    str | None, typer.Option("--workers", metavar="N", help="Runs trained at once (default: one a core)")
]
ExecutorName = Annotated[
    str,
    typer.Option(
        "--executor",
        metavar="|".join(EXECUTORS),
        help="Where runs are trained: in processes of this machine, or on a cluster (docs/scaling.md).",
    ),
]
Address = Annotated[
    str | None,
    typer.Option(
        "--address", metavar="HOST:PORT", help="With --executor ray: its cluster (default: one of its own)."
    ),
]
SlurmOptions = Annotated[
    list[str] | None,
    typer.Option(
        "--slurm",
        metavar="KEY=VALUE",
        help="With --executor slurm: what jobs ask for: partition, time, account, mem … (may be repeated).",
    ),
]
Detach = Annotated[
    bool, typer.Option("--detach", help="With --executor slurm: leave once jobs are submitted.")
]
Trust = Annotated[
    bool,
    typer.Option(
        "--trust", help="Run the reward and read the level and characters files that the run names."
    ),
]
Conditions = Annotated[
    list[str] | None,
    typer.Option("--condition", metavar="NAME", help="Only this condition (may be repeated)."),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set", metavar="KEY=VALUE", help="Set a field of the run in every condition (may be repeated)."
    ),
]


def _world_option(told: str) -> Any:
    return typer.Option("--world", metavar="|".join(WORLDS), help=told)


WorldName = Annotated[
    str | None,
    _world_option(f"Where: {', '.join(world.title for world in WORLDS.values())} (default: {TEXT})."),
]
NamedWorld = Annotated[
    str | None,
    _world_option(f"One world alone (default with NAME: {TEXT}; without: all)."),
]
"""Of commands that take all studies where none is named."""
OnlyWorld = Annotated[
    str | None,
    _world_option("One world alone (default: all, and the logs)."),
]
"""Of a command that judges all there is, the logs among it."""

Selected = Selection | None
"""What `selects` hands to a command; None when no selecting option was given."""
Answer = TypeVar("Answer")
Options = tuple[inspect.Parameter, ...]


def read_selection(
    preset: str | None,
    seeds: str | None,
    steps: str | None,
    engine: str | None,
    conditions: Sequence[str] | None,
    settings: Sequence[str] | None,
) -> Selection | None:
    """Turn the selecting options into a `Selection`; None when none of them was given.

    Raises:
        UserError: naming the option, the value and what is allowed.
    """
    if all(given in (None, []) for given in (preset, seeds, steps, engine, conditions, settings)):
        return None
    return Selection(
        preset=preset,
        seeds=None if seeds is None else read_seeds_option(seeds),
        steps=None if steps is None else read_count("--steps", steps),
        engine=engine,
        conditions=tuple(conditions or ()),
        settings=read_settings_options(settings),
    )


def read_place(executor: str, address: str | None, slurm: Sequence[str] | None, detach: bool) -> Place:
    """Turn the options that say where runs are trained into a `Place`.

    Raises:
        UserError: naming the option, the value and what is allowed.
    """
    if executor not in EXECUTORS:
        raise UserError(f"--executor {executor}: {unknown_name('executor', executor, EXECUTORS)}")
    if address is not None and executor != RAY:
        raise UserError(f"--address {address}: goes with --executor {RAY}")
    if (slurm or detach) and executor != SLURM:
        raise UserError(f"{'--slurm ' + slurm[0] if slurm else '--detach'}: goes with --executor {SLURM}")
    return Place(executor, address, slurm=tuple(_read_slurm(text) for text in slurm or ()), detach=detach)


def _read_slurm(text: str) -> tuple[str, str]:
    key, equals, value = text.partition("=")
    if not equals or not key.strip() or not value.strip():
        raise UserError(f"--slurm {text}: must be KEY=VALUE, as in --slurm partition=short")
    return key.strip().replace("-", "_"), value.strip()


def read_workers(workers: str | None, place: Place = HERE) -> int:
    """Return how many runs train at once: as `--workers` says, or what the place has room for.

    Raises:
        UserError: where that is no number, or the place cannot be reached.
    """
    if workers is not None:
        return read_count("--workers", workers)
    return load_executor(place).most_workers(place)


def selects(command: Callable[..., Answer]) -> Callable[..., Answer]:
    """Give a command the options that select runs; it gets what they come to as its `selection`."""
    return _with_options(command, "selection", _SELECTING, read_selection)


def places(command: Callable[..., Answer]) -> Callable[..., Answer]:
    """Give a command the options that say where runs are trained; it gets that as its `place`."""
    return _with_options(command, "place", _PLACING, read_place)


def _with_options(
    command: Callable[..., Answer], name: str, options: Options, read: Callable[..., object]
) -> Callable[..., Answer]:
    """Put options in the place of a command's parameter, which then is what `read` makes of them.

    Typer makes a command's options from its signature, so they are put there.
    """
    signature = inspect.signature(command, eval_str=True)

    @functools.wraps(command)
    def run(**given: Any) -> Answer:
        told = read(*(given.pop(option.name) for option in options))
        return command(**{name: told}, **given)

    parameters = [
        own
        for parameter in signature.parameters.values()
        for own in (options if parameter.name == name else (parameter,))
    ]
    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {own.name: own.annotation for own in parameters}
    return run


def _option(name: str, kind: object, default: object = None) -> inspect.Parameter:
    return inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD, default=default, annotation=kind)


_SELECTING = (
    _option("preset", StudyPreset),
    _option("seeds", Seeds),
    _option("steps", Steps),
    _option("engine", EngineName),
    _option("condition", Conditions),
    _option("set_", Settings),
)
"""The parameters of `read_selection`, as options."""
_PLACING = (
    _option("executor", ExecutorName, LOCAL),
    _option("address", Address),
    _option("slurm", SlurmOptions),
    _option("detach", Detach, False),
)
"""The parameters of `read_place`, as options."""


def read_count(option: str, text: str) -> int:
    """Read a whole number of at least 1; underscores may group its digits."""
    try:
        count = int(text)
    except ValueError:
        count = 0
    if count < 1:
        raise UserError(f"{option} {text}: must be a whole number of at least 1")
    return count


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
    """Read `--seeds`: a count, or a list."""
    try:
        parts = [int(part) for part in text.split(",") if part.strip()]
        return read_seeds(parts if "," in text else parts[0])
    except (ValueError, IndexError, UserError):
        raise UserError(f"--seeds {text}: must be {SEEDS_ALLOWED}, as in 3,5,8") from None


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
        words += ["--set", f"{key}={value if isinstance(value, str) else json.dumps(value)}"]
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
    print(json.dumps(_without_nan(document), indent=2, allow_nan=False))


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
