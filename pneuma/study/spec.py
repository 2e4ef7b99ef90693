"""Studies: named conditions that differ in the fields they set, and the worlds that they run in.

A study is a TOML file:

    [run]                        what all conditions share
    [factors]                    what every condition is crossed with
    reward = ["thesis", "kills"]
    [conditions.tanh]            what one condition changes

gives the conditions `reward=thesis, tanh` and `reward=kills, tanh`. A study with factors needs no conditions.

file → Study, checked here → Plan (`plan.py`). A study owns no results.
"""

from __future__ import annotations

import math
import os
import shlex
import tomllib
from collections.abc import Iterable, Mapping
from itertools import product
from pathlib import Path
from typing import Annotated, Any

from annotated_types import Interval, MinLen
from pydantic import AfterValidator, BeforeValidator, Field, ValidationInfo, field_validator, model_validator

from pneuma.config import FORK_FIELDS, Run, Steps, make_run, reads
from pneuma.env.fields import ENVIRONMENT_SLOTS, ENVIRONMENTS, read_field
from pneuma.errors import UserError, unknown_name
from pneuma.files import shipped_folder
from pneuma.presets import BASES, TEXT, WORLDS, checked_world, usual_world, world_fields, world_option
from pneuma.sb3_names import own_fields
from pneuma.schema import Table, TomlFile, read_model, read_toml, shown, wrong
from pneuma.study.identity import files_beside
from pneuma.values import SEEDS_ALLOWED, OneOf, Reads, matching, read_seeds, setting_words, short

PRESETS = ("quick", "standard", "paper")
CLAIMS = "claims"
"""The preset that comes from claims (`analysis/claims.py`) and not from a study's file."""
CLAIMS_FILE = "claims.toml"
"""The file of claims, in the folder of studies."""

MOST_CONDITIONS = 1000
CONDITION = "condition"
"""In a crossed study, the factor whose values are the file's conditions."""
PLANNED = {"seed": "a preset (seeds)", "steps": "a preset (steps)"} | dict.fromkeys(
    FORK_FIELDS, "`pneuma run fork`"
)
"""Fields of a run that a study does not set, and what sets them."""


# --- What the file may hold ------------------------------------------------------------------------


def _named_values(factors: Any) -> Any:
    """Name the values of a factor that is a field of the run, as those of other factors are."""
    if not isinstance(factors, Mapping):
        return factors
    named = {}
    for factor, values in factors.items():
        refused = f"{factor} = {shown(values)} is not allowed: "
        if factor == CONDITION:
            raise wrong(f"{factor} is what [conditions] are; name it otherwise", factor)
        if not isinstance(values, tuple | Mapping) or len(values) < 2:
            raise wrong(f"{refused}a list of two values or more, or a table of named ones", factor)
        if isinstance(values, tuple) and any(value in values[:place] for place, value in enumerate(values)):
            raise wrong(f"{refused}a list of different values", factor)
        table = isinstance(values, Mapping)
        named[factor] = values if table else {f"{factor}={short(value)}": {factor: value} for value in values}
    return named


def _read_fields(table: Any) -> Any:
    """Read a table of a run's fields, by the names of Stable-Baselines3 too; return them by Pneuma's."""
    if not isinstance(table, Mapping):
        return table
    key, fields = "", dict[str, Any]()
    try:
        own_fields(table)  # no two keys are one field
        for key, value in table.items():
            for name, own in own_fields({key: value}).items():
                if name in PLANNED:
                    raise UserError(f"{name} is set by {PLANNED[name]}, not here")
                fields[name] = read_field(Run, name, own)
    except UserError as error:
        told = str(error)
        key = key or told.split()[0].strip(":")
        raise wrong(told if key in told else f"{key}: {told}", key) from None
    return fields


Name = Annotated[str, matching(r"(?!_)(?s:.*\S.*)", "a name that can be read and begins otherwise than _")]
"""The name of a condition or a value. Names that begin with _ have a meaning to matplotlib."""
Fields = Annotated[dict[str, Any], BeforeValidator(_read_fields)]
Seeds = Annotated[tuple[int, ...], Reads(read_seeds, SEEDS_ALLOWED)]


class Amount(Table):
    """[presets.NAME.conditions.NAME]: seeds and steps of one condition; the preset's where it says none."""

    seeds: Seeds = ()
    steps: Steps = 0


class Preset(Amount):
    """[presets.NAME]: seeds and steps of every condition but those of `conditions`, which say their own.

    The preset of claims has no seeds: it is of its `conditions` alone.
    """

    seeds: Seeds
    steps: Steps
    conditions: Mapping[str, Amount] = {}

    @field_validator("conditions")
    @classmethod
    def _spread(cls, conditions: Mapping[str, Amount], info: ValidationInfo) -> Mapping[str, Amount]:
        """Fill in the preset's own seeds and steps."""
        return {
            name: Amount.model_construct(**{**info.data, **each.model_dump(exclude_unset=True)})
            for name, each in conditions.items()
        }


class Scale(Table):
    """[scores.ENVIRONMENT]: the outcomes that are scores of 0 and 1 there."""

    random: float
    expert: float

    @model_validator(mode="after")
    def _not_flat(self) -> Scale:
        if self.random == self.expert:
            raise wrong(f"random and expert are both {self.random:g}: a scale needs two numbers", "expert")
        return self


class Study(Table):
    """A comparison: named conditions that differ in what they set. Its file has no keys for the last five.

    Attributes:
        title, section, about: shown to users.
        figure: file stem of its figure.
        base: name of the fields to start from.
        baseline: the condition that the others are compared with.
        outcomes: what it asks about, in place of the usual ones.
        keep_checkpoints: number of checkpoints kept of each run for forks, evenly spread, besides that of its
            first update.
        worlds: those of `WORLDS` in which it can be run.
        run: fields of every condition on top of the base.
        factors: what each value of each factor sets.
        conditions: what each condition sets on top; once it is read, crossed with the factors.
        labels: what conditions are called in figures, where not by their names.
        scores: by an environment's id, the scale of its scores.
        levels: for each condition of a crossed study, its value of each factor.
        path: the file; None for a study without a file, such as a fork.
        world: one of `WORLDS`.
        settings: fields that `--set` changed in every condition.
    """

    title: Annotated[str, MinLen(1)]
    section: str = ""
    about: Annotated[str, AfterValidator(lambda text: " ".join(text.split()))] = ""
    figure: Annotated[str, matching(r"([\w-][\w.-]*)?", "a file name without folders and ending")] = ""
    base: Annotated[str, OneOf(tuple(BASES))]
    baseline: str = ""
    outcomes: tuple[str, ...] = ()
    keep_checkpoints: Annotated[int, Interval(ge=0, le=1000)] = 0
    worlds: Annotated[tuple[Annotated[str, OneOf(tuple(WORLDS))], ...], MinLen(1)] = ()
    run: Fields = {}
    factors: Annotated[dict[str, dict[Name, Fields]], BeforeValidator(_named_values)] = {}
    conditions: dict[Name, Fields] = {}
    labels: dict[str, Annotated[str, MinLen(1)]] = {}
    scores: dict[str, Scale] = {}
    presets: Annotated[dict[Annotated[str, OneOf(PRESETS)], Preset], MinLen(1)]

    name: str = Field("", exclude=True)
    path: Path | None = Field(None, exclude=True)
    levels: Mapping[str, Mapping[str, str]] = Field({}, exclude=True)
    world: str = Field(TEXT, exclude=True)
    settings: Mapping[str, Any] = Field({}, exclude=True)

    @model_validator(mode="before")
    @classmethod
    def _spread_budget(cls, data: Any) -> Any:
        """Take `n_timesteps` of [run] as the steps of presets that say none."""
        run, presets = data.get("run"), data.get("presets")
        if not isinstance(run, Mapping) or "n_timesteps" not in run or not isinstance(presets, Mapping):
            return data
        run, presets = {**run}, {**presets}
        try:
            steps = read_field(Run, "steps", run.pop("n_timesteps"))
        except UserError as error:
            raise wrong(f"[run] n_timesteps: {error}", "run") from None
        for name, table in presets.items():
            presets[name] = {"steps": steps, **table} if isinstance(table, Mapping) else table
        return {**data, "presets": presets, "run": run}

    @classmethod
    def without_file(cls, name: str, title: str, conditions: Iterable[str], **more: Any) -> Study:
        """Return a study whose runs are listed or forked; the first condition is the baseline."""
        named: dict[str, dict[str, Any]] = {condition: {} for condition in conditions}
        usual = {"baseline": next(iter(named)), "figure": name, "presets": {}, "worlds": tuple(WORLDS)}
        return cls.model_construct(name=name, title=title, conditions=named, **{**usual, **more})

    def fields(self, condition: str, over: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Return all fields that a condition sets, including base and shared ones; `over` overrides them."""
        set_by_itself = {*self.run, *(key for fields in self.conditions.values() for key in fields)}
        shared = {**self.run, **world_fields(self.world, set_by_itself)}
        return join_fields(self.base, {**shared, **self.conditions[condition], **(over or {})})

    def in_world(self, world: str) -> Study:
        """Return the study as it runs in one of its worlds.

        All conditions get the world's environment, and its other fields unless the study sets them itself.
        """
        if world not in self.worlds:
            known = ", ".join(self.worlds)
            raise UserError(f"study {self.name} is not run in the world {world}; it is in {known}")
        return self.model_copy(update={"world": world})

    @property
    def variant(self) -> str:
        """The study's world and changed fields, as one text."""
        return " ".join([self.world, *setting_words(self.settings)])

    @property
    def own_path(self) -> str | None:
        """The path of a user's own file; None for a shipped study, or one without a file."""
        if self.path is None or self.path.resolve().parent == studies_folder().resolve():
            return None
        return str(self.path.resolve())

    @property
    def file(self) -> str:
        """What finds the study again: its name, or the path of a user's own file."""
        return self.own_path or self.name


def join_fields(base: str, fields: Mapping[str, Any]) -> dict[str, Any]:
    """Combine fields with a base and with the defaults of the environment that they choose."""
    env = fields.get("env")
    slots = {"slots": ENVIRONMENT_SLOTS[env]} if env in ENVIRONMENT_SLOTS else {}
    return {**BASES[base], **slots, **fields}


# --- Reading ---------------------------------------------------------------------------------------


def load_study(name: str, world: str | None = None, others: Iterable[str] = ()) -> Study:
    """Load a shipped study by its name, or any study by the path of its file or by NAME for NAME.toml here.

    Its usual world is the arena, if it is run in it. A mistyped name may mean one of `others`.
    """
    study = _read_study(find_file("study", name, studies_folder(), others))
    return study.in_world(checked_world(world) or usual_world(study.worlds))


def _read_study(path: Path) -> Study:
    """Read a study's file and check that its conditions make valid runs in each of its worlds."""
    file = read_toml(path)
    study = _crossed(file, read_model(Study, file))
    conditions = study.conditions
    if not conditions:
        raise file.mistake((), "a study needs at least one condition", "conditions")
    baseline = study.baseline or next(iter(conditions))
    mentioned = [((), "baseline", baseline), *((("labels",), name, name) for name in study.labels)]
    mentioned += [
        (("presets", preset, "conditions"), name, name)
        for preset, amounts in study.presets.items()
        for name in amounts.conditions
    ]
    for where, key, name in mentioned:
        if name not in conditions:
            said = "baseline: " if key == "baseline" else ""
            raise file.mistake(where, f"{said}{unknown_name('condition', name, conditions)}", key)
    env = study.run.get("env", ENVIRONMENTS[0])
    fixed = env != ENVIRONMENTS[0] or any("env" in fields for fields in conditions.values())
    alike = [name for name, world in WORLDS.items() if world.env == env and not world.overrides]
    usual = (alike or [TEXT]) if fixed else [*WORLDS]
    figure, usual_figure = study.figure, f"study-{path.stem}"
    own = path.resolve().parent != studies_folder().resolve()
    if own and any(read_head(name).get("figure") == figure for name in list_studies()):
        figure = usual_figure  # so that the shipped study's figure stays
    study = study.model_copy(
        update={
            "name": path.stem,
            "path": path,
            "figure": figure or usual_figure,
            "baseline": baseline,
            "run": files_beside(path, study.run),
            "conditions": {name: files_beside(path, fields) for name, fields in conditions.items()},
            "worlds": tuple(dict.fromkeys(study.worlds or usual)),
        }
    )
    for world in study.worlds:
        _check_runs(file, study.in_world(world))
    return study


def _crossed(file: TomlFile, study: Study) -> Study:
    """Return a study with its conditions crossed with its factors."""
    factors = {**study.factors, **({CONDITION: study.conditions} if study.conditions else {})}
    if not study.factors:
        return study
    if (count := math.prod(map(len, factors.values()))) > MOST_CONDITIONS:
        message = f"{count:,} conditions are too many: at most {MOST_CONDITIONS:,}"
        raise file.mistake((), message, "factors")
    crossed: dict[str, dict[str, Any]] = {}
    levels: dict[str, dict[str, str]] = {}
    baseline = study.baseline
    for names in product(*factors.values()):
        fields: dict[str, Any] = {}
        for factor, name in zip(factors, names, strict=True):
            if twice := fields.keys() & factors[factor][name].keys():
                message = f"{factor}: {name} sets {min(twice)}, which another factor or condition sets too"
                raise file.mistake(("factors",), message, factor)
            fields |= factors[factor][name]
        joined = ", ".join(names)
        if joined in crossed:
            message = f"two combinations are both called {joined}; name their values otherwise"
            raise file.mistake(("factors",), message)
        baseline = joined if baseline in names else baseline
        pairs = zip(factors, names, strict=True)
        crossed[joined] = fields
        levels[joined] = {factor: name.removeprefix(f"{factor}=") for factor, name in pairs}
    return study.model_copy(update={"conditions": crossed, "levels": levels, "baseline": baseline})


def _check_runs(file: TomlFile, study: Study) -> None:
    """Refuse conditions that make no valid run, and fields that do nothing."""
    runs: list[Run] = []
    for name, fields in study.conditions.items():
        try:
            runs.append(make_run(study.fields(name)))
            for key in unread_fields(runs[-1:], fields):
                raise UserError(does_nothing(key, runs[-1:]))
        except UserError as error:
            raise _mistake_in(file, study, name, str(error)) from None
    for key in unread_fields(runs, study.run):
        raise file.mistake(("run",), does_nothing(key, runs), key)


def _mistake_in(file: TomlFile, study: Study, name: str, message: str) -> UserError:
    """Return an error that points at the field it begins with, or else at the condition."""
    key = next((key for key in study.fields(name) if message.startswith(f"{key} ")), "")
    if key in study.run and key not in study.conditions[name]:
        return file.mistake(("run",), message, key)
    if study.levels:
        return file.mistake(("factors",), f"{message} (in {name})", key)
    return file.mistake(("conditions", name), message, key)


def unread_fields(runs: Iterable[Run], keys: Iterable[str]) -> list[str]:
    read = {key for run in runs for key in reads(run)}
    return [key for key in keys if key not in read]


def does_nothing(key: str, runs: Iterable[Run]) -> str:
    """Return the message for a field that neither the runs' environments nor their learners read."""
    names = dict.fromkeys(name for run in runs for name in (run.env, run.algorithm, run.optimizer))
    return f"{key} does nothing: it is read by none of {', '.join(names)} as they are set"


# --- Files -----------------------------------------------------------------------------------------


def studies_folder() -> Path:
    return shipped_folder("pneuma.studies", "studies")


def shipped_names(folder: Path) -> list[str]:
    return sorted(path.stem for path in folder.glob("*.toml") if path.name != CLAIMS_FILE)


def list_studies() -> list[str]:
    return shipped_names(studies_folder())


def read_head(name: str, folder: Path | None = None) -> dict[str, Any]:
    """Return the contents of a shipped study's file, or of another in a folder, unchecked."""
    return tomllib.loads(((folder or studies_folder()) / f"{name}.toml").read_text(encoding="utf-8"))


def find_file(what: str, name: str, folder: Path, others: Iterable[str] = ()) -> Path:
    """Return the path of a file by itself, by a shipped name, or by that of NAME.toml here or in examples.

    A mistyped name may mean one of `others`.
    """
    known = shipped_names(folder)
    if name in known:
        return folder / f"{name}.toml"
    path = Path(name if name.endswith(".toml") else f"{name}.toml")
    if not name.endswith(".toml") and not os.path.isfile(path):  # a Path would refuse a long name
        examples = shipped_names(folder / "examples")
        if os.path.isfile(f"examples/{name}.toml"):
            path = Path("examples") / path
        elif name in examples:
            return folder / "examples" / path
        else:
            raise unknown_name(what, name, [*known, *others, *examples])
    refuse_taken_name(path, folder / path.name, what)
    return path


def refuse_taken_name(path: Path, shipped: Path, what: str) -> None:
    if shipped.is_file() and path.resolve() != shipped.resolve():
        raise UserError(f"{path}: a shipped {what} is called {path.stem}; give yours another file name")


def asked_words(study: Study) -> list[str]:
    """Return a command's words for a study as it is: its name or file, world and changed fields."""
    return [study.file, *world_option(study.world, study.worlds), *setting_words(study.settings)]


def run_command(study: Study) -> str:
    return shlex.join(["pneuma", "study", "run", *asked_words(study)])
