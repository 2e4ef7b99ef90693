"""Which of all runs a study's name and options mean.

    results folder, published tables → `RunIndex.frame`: a row for each run, finished or not
    a study's name, world, changed fields → `find_study`: its conditions, each with its configuration's id,
        joined with the frame: every run of the study
    steps and seeds → `choose_runs`: those of one budget → `read_runs`: the finished ones, with their rows

The runs that have a study's configurations are its runs, wherever they are. Only studies without a file
(imported logs, forks, a search's trials) list theirs.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import pandas as pd

from pneuma.analysis.run_index import RunIndex
from pneuma.analysis.study_data import StudyData
from pneuma.config import Run, as_fields, round_up
from pneuma.errors import UserError, counted, unknown_name
from pneuma.presets import TEXT, WORLDS
from pneuma.study.identity import config_id, own_files
from pneuma.study.plan import Selection, configure
from pneuma.study.shipped import list_studies
from pneuma.study.spec import Study, load_study, run_command
from pneuma.study.store import FINISHED
from pneuma.values import read_settings, setting_words, shown_seeds

ALL = Selection()
Fields = Mapping[str, Mapping[str, Any]]
Say = Callable[[str], object]


def find_study(index: RunIndex, name: str, picked: Selection = ALL, world: str | None = None) -> StudyData:
    """Return a study in a world, with changed fields, and all its runs of any budget.

    Raises:
        UserError: for an unknown study, world or condition, or fields that do not go together.
    """
    of_file = name in list_studies() or name.endswith(".toml")
    if not of_file and (listing := index.listing(name)) is not None:
        return _find_listed(index, listing, picked)
    others = () if of_file else index.listings()
    return find_runs(index, load_study(name, world, others, index.store.studies), picked)


def find_runs(index: RunIndex, study: Study, picked: Selection = ALL) -> StudyData:
    """Return a study of a file in its world, with changed fields, and all its runs of any budget."""
    found = configure(study, picked.settings, picked.conditions, index.engine_of)
    fields = {condition: _without_amount(as_fields(run)) for condition, run in found.runs.items()}
    ids = [(condition, config_id(run)) for condition, run in found.runs.items()]
    if picked.any_version:
        ids += _other_versions(index, fields, found.runs)
    places = [(condition, place) for condition, known in ids for place in index.places.get(known, ())]
    runs = index.frame.iloc[[place for _, place in places]].reset_index(drop=True)
    runs = runs.assign(condition=[condition for condition, _ in places])
    runs = runs.drop_duplicates(["condition", "seed", "steps"], ignore_index=True)  # the present version's
    return StudyData(found.study, fields, runs, found.runs)


def _find_listed(index: RunIndex, listing: Mapping[str, Any], picked: Selection) -> StudyData:
    name = listing["study"]
    every: dict[str, dict[str, Any]] = {run["condition"]: {} for run in listing["runs"]}
    for condition in picked.conditions:
        if condition not in every:
            raise unknown_name(f"condition of study {name}", condition, every)
    if picked.settings:
        raise UserError(f"--set: study {name} has no file whose fields could be changed")
    listed = pd.DataFrame(listing["runs"])[["run_id", "condition", "seed"]]
    listed = listed.drop_duplicates("run_id", keep="last")
    listed = listed[listed["condition"].isin(picked.conditions or every)]
    runs = listed.merge(index.frame.drop(columns="seed").reset_index(drop=True), on="run_id")
    fields: dict[str, Mapping[str, Any]] = {each: {} for each in every if each in {*listed["condition"]}}
    baseline, title = listing["baseline"], listing["title"]
    study = Study.without_file(name, title, every, baseline=baseline, worlds=(TEXT,))
    data = StudyData(study, fields, runs)
    found = finished_rows(index, data).runs.set_index("condition")["row"]
    known = {str(name): _without_amount(row.fields) for name, row in found.items()}
    return replace(data, fields={**fields, **known})


def _without_amount(fields: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in fields.items() if key not in ("seed", "steps")}


def choose_runs(index: RunIndex, data: StudyData, picked: Selection = ALL) -> StudyData:
    """Return a study with those of its runs that have the steps and seeds that were asked for, seed by seed.

    Without steps these are the runs of the budget of this study's last `study run` here, or else of the
    published budget with most conditions and runs. What other studies train changes neither. Budgets without
    any of the seeds that were asked for are passed over, and those without one of the conditions.

    Raises:
        UserError: when nothing is stored that is asked for.
    """
    runs, study = data.runs, data.study
    if not data.configurations:
        runs = runs[runs["steps"] == picked.steps] if picked.steps else runs
        if not len(runs):
            of = f" of {picked.steps:,} steps" if picked.steps else ""
            raise UserError(f"study {study.name} has no runs{of} in {index.store.root}")
        return _narrowed(replace(data, runs=runs), picked)
    if not len(runs):
        raise UserError(_nothing(index, data))
    tried = runs["run_id"].isin(index.trials)
    if picked.seeds is None and not tried.all():  # a winner looks better by the runs that chose it
        data = replace(data, runs=runs[~tried])
    of_search = []
    if len(data.runs) < len(runs):
        seeds = shown_seeds(runs["seed"][tried])
        of_search = [f"{counted(int(tried.sum()), 'run')} of a search's trials (--seeds {seeds})"]
    budgets, last_here = _by_budget(data), False
    if picked.steps is None:
        having = {
            steps: each
            for steps, each in budgets.items()
            if picked.seeds is None or each["seed"].isin(picked.seeds).any()
        }
        whole = {steps: each for steps, each in having.items() if {*data.fields} <= {*each["condition"]}}
        having = whole if picked.conditions and whole else having
        budget, last_here = _usual_budget(index, data, having or budgets)
    elif len(chosen := runs_of_budget(data, picked.steps)):
        budgets, budget = {**budgets, picked.steps: chosen}, picked.steps
    else:
        known = ", ".join(f"{steps:,}" for steps in budgets)
        known = "; ".join([f"{known} steps", *of_search])
        raise UserError(f"--steps {picked.steps}: {data.where} has runs of {known}")
    shown, others = budgets[budget], []
    for steps, each in sorted(budgets.items(), key=lambda each: -len(each[1])):
        if not each.equals(shown):
            published = ", published" if (each["where"] != "").all() else ""
            others.append(f"{counted(len(each), 'run')} of {steps:,} steps{published} (--steps {steps})")
    others += of_search + _elsewhere(index, study)
    if any(map(own_files, data.fields.values())) and not picked.any_version:
        others += _earlier(index, data)
    chosen_data = replace(data, runs=shown, steps=budget, others=others, last_here=last_here)
    return _narrowed(chosen_data, picked)


def _narrowed(data: StudyData, picked: Selection) -> StudyData:
    seeds = {*data.runs["seed"]}
    kept = seeds if picked.seeds is None else seeds & {*picked.seeds}
    if not kept:
        few = ", ".join(map(str, sorted(seeds)[:10])) + (", …" if len(seeds) > 10 else "")
        raise UserError(f"--seeds: {data.where} has none of these; it has {few or 'no runs'}")
    narrowed = [*picked.conditions] if len(data.fields) < len(data.study.conditions) else []
    narrowed += ["seeds", *map(str, sorted(kept))] if kept < seeds else []
    narrowed += ["steps", str(picked.steps)] if picked.steps else []
    narrowed += ["any-version"] if picked.any_version else []
    runs = data.runs[data.runs["seed"].isin(kept)].sort_values("seed", kind="stable")
    return replace(data, runs=runs, narrowed=narrowed)


def _by_budget(data: StudyData) -> dict[int, pd.DataFrame]:
    """Return the runs of each budget, in the words of the study's presets where they have it."""
    known = [preset.steps for preset in data.study.presets.values()]
    found: dict[int, pd.DataFrame] = {}
    for steps in dict.fromkeys([*known, *sorted({*data.runs["steps"]})]):
        runs = runs_of_budget(data, steps)
        if len(runs) and not any({*runs.index} <= {*others.index} for others in found.values()):
            found[steps] = runs
    return found


def runs_of_budget(data: StudyData, steps: int) -> pd.DataFrame:
    """Return the runs of one budget: so many steps, rounded up, or what a preset of it says instead."""
    amounts = dict.fromkeys(data.configurations, steps)
    for preset in data.study.presets.values():
        if preset.steps == steps:
            amounts |= {name: each.steps for name, each in preset.conditions.items() if name in amounts}
    budgets = {name: round_up(data.configurations[name], amount) for name, amount in amounts.items()}
    return data.runs[data.runs["steps"] == data.runs["condition"].map(budgets)]


def _usual_budget(index: RunIndex, data: StudyData, budgets: Mapping[int, pd.DataFrame]) -> tuple[int, bool]:
    """Return the budget that is shown without --steps, and whether it is that of the last run here."""
    for last in index.store.noted_steps(data.study.name).get(data.study.variant, [])[-1:]:
        runs = {*runs_of_budget(data, last).index}
        for steps, each in budgets.items():
            if runs and runs <= {*each.index}:
                return steps, True
    published = {steps: runs for steps, runs in budgets.items() if (runs["where"] != "").any()}
    sizes = {steps: (runs["condition"].nunique(), len(runs)) for steps, runs in budgets.items()}
    return max(published or budgets, key=sizes.__getitem__), False


def finished_rows(index: RunIndex, data: StudyData) -> StudyData:
    """Return a study with its finished runs alone, and their rows; there may be none."""
    runs = data.finished
    runs = runs.assign(row=pd.Series([*map(index.row, runs["run_id"])], runs.index, dtype=object))
    return replace(data, runs=runs.dropna(subset="row").reset_index(drop=True))


def read_runs(index: RunIndex, data: StudyData, say: Say = lambda message: None) -> StudyData:
    """Return a study with its finished runs and their rows; a UserError if there are none."""
    found = finished_rows(index, data)
    for problem in index.problems:
        say(f"Note: {problem}.")
    if left_out := len(data.runs) - len(found.runs):
        say(f"Note: {left_out} of {len(data.runs)} runs are not finished or damaged, and left out.")
    if not len(found.runs):
        train = f": run `{run_command(data.study, index.store.root)}` first" if data.configurations else ""
        raise UserError(f"no finished run of study {data.where} is in {index.store.root}{train}")
    return found


def open_study(
    index: RunIndex,
    name: str,
    picked: Selection = ALL,
    world: str | None = None,
    say: Say = lambda message: None,
) -> StudyData:
    """Return the finished runs of a study that are asked for, wherever they are.

    `name` may be the path of a file; `world` is by default the arena where the study is run in it. `say` is
    told what is shown and what else is stored.

    Raises:
        UserError: when nothing is stored that is asked for, or no run of it has finished.
    """
    data = choose_runs(index, find_study(index, name, picked, world), picked)
    say(data.text(index.store.root))
    return read_runs(index, data, say)


def studies_here(index: RunIndex, world: str | None = None) -> Iterator[StudyData]:
    """Yield the studies that were run in the results folder, in each world and with each change of fields.

    Each has the runs there of the steps that it was run with.
    """
    for name in index.store.noted_studies():
        for variant, noted in index.store.noted_steps(name).items():
            with suppress(UserError, OSError, ValueError):  # its file or its record is damaged
                data = _find_variant(index, name, variant, noted)
                yield from _those_here(data) if world in (None, data.study.world) else ()
    for name in index.store.listings() if world is None else ():
        with suppress(UserError):
            yield from _those_here(find_study(index, name))


def _find_variant(index: RunIndex, name: str, variant: str, noted: Sequence[int]) -> StudyData:
    """Return a study as one of its variants is noted, with the runs of the steps that are noted."""
    world, *words = shlex.split(variant)
    study = load_study(name, world, kept=index.store.studies)
    data = find_runs(index, study, Selection(settings=read_settings(words)))
    runs = [runs_of_budget(data, steps) for steps in noted]
    return replace(data, runs=pd.concat(runs).drop_duplicates())


def _those_here(data: StudyData) -> Iterator[StudyData]:
    if len(runs := data.runs[data.runs["where"] == ""]):
        yield replace(data, runs=runs)


# --- What else there is -----------------------------------------------------------------------------


def _elsewhere(index: RunIndex, study: Study) -> list[str]:
    """Return in which other worlds runs of a study are stored."""
    found = []
    for world in study.worlds:
        if world != study.world:
            other = configure(load_study(study.file, world), study.settings)
            count = sum(len(index.places.get(config_id(run), ())) for run in other.runs.values())
            found += [f"{counted(count, 'run')} in {WORLDS[world].title} (--world {world})"] if count else []
    return found


def _nothing(index: RunIndex, data: StudyData) -> str:
    """Return that no runs are stored, what to run, and what is stored that differs in one field."""
    others = [*_elsewhere(index, data.study), *_changed(index, data)]
    stored = f" Stored are: {'; '.join(others)}." if others else ""
    train = f"run `{run_command(data.study, index.store.root)}` first, or give --results"
    lacking = {name for fields in data.fields.values() for name in own_files(fields, missing=True)}
    if lacking:
        train = f"{', '.join(sorted(lacking))} is not found, by which its runs are known; {train}"
    damaged = "".join(f" {problem}." for problem in index.problems)
    return f"study {data.where} has no runs in {index.store.root}: {train}.{stored}{damaged}"


def _changed(index: RunIndex, data: StudyData) -> list[str]:
    """Return the single fields by whose change stored runs are those of the study."""
    counts: dict[str, int] = {}
    alike = [*_alike(index, data.fields)]
    own = {known for _, known, unlike in alike if not unlike}  # of another version, of whichever condition
    for _, known, unlike in alike:
        if known not in own:
            option = shlex.join(setting_words(unlike))
            counts[option] = counts.get(option, 0) + len(index.places[known])
    return [*_earlier(index, data), *(f"{counted(n, 'run')} ({option})" for option, n in counts.items())]


def _earlier(index: RunIndex, data: StudyData) -> list[str]:
    """Return how many runs another version of the user's modules, the rules or an engine made."""
    others = {known for _, known in _other_versions(index, data.fields, data.configurations)}
    runs = sum(len(index.places[known]) for known in others)
    own = {Path(name).name for fields in data.fields.values() for name in own_files(fields)}
    of = ", ".join(sorted(own)) or "rules or engine"
    return [f"{counted(runs, 'run')} of another version of {of} (--any-version)"] if runs else []


def _other_versions(index: RunIndex, fields: Fields, runs: Mapping[str, Run]) -> list[tuple[str, str]]:
    """Return the configurations of stored runs whose fields are those of a condition, but not the id."""
    ids = {condition: config_id(run) for condition, run in runs.items()}
    alike = ((condition, known) for condition, known, unlike in _alike(index, fields) if not unlike)
    return [(condition, known) for condition, known in alike if known != ids[condition]]


def _alike(index: RunIndex, fields: Fields) -> Iterator[tuple[str, str, dict[str, Any]]]:
    """Yield each condition with configurations that differ from it in one field or none, and its value."""
    finished = index.frame[index.frame["status"].isin(FINISHED)].drop_duplicates("config_id")
    bare = {condition: {key: _bare(value) for key, value in own.items()} for condition, own in fields.items()}
    for known, run_id in finished[["config_id", "run_id"]].itertuples(index=False):
        if (row := index.row(run_id)) is None:
            continue
        kept = {key: _bare(value) for key, value in _without_amount(row.fields).items()}
        for condition, own in bare.items():
            unlike = (key for key in {**own, **kept} if own.get(key) != kept.get(key))
            if len(few := [*islice(unlike, 2)]) < 2:
                yield condition, known, {key: row.fields.get(key) for key in few}


def _bare(value: Any) -> Any:
    """Return a field's value with the user's own files by their names alone."""
    if isinstance(value, list | tuple):
        return tuple(map(_bare, value))
    if isinstance(value, str) and value.startswith("/"):
        file, colon, inside = value.partition(":")
        return Path(file).name.removesuffix(".py") + colon + inside
    return value
