"""What is asked of stored runs, and the runs that answer it.

    a study's name, world, changed fields → Asked: conditions, each with its configuration's id
    Asked, steps and seeds → Shown: the entries of `RunIndex` that have them, and what else is stored
    Shown → StudyData: the finished ones with their rows

A study is a question: its conditions in a world, with `--set`, give configuration ids, and the runs that have
them are its runs, wherever they are. Only studies without a file (imported logs, forks, a search's trials)
list theirs.
"""

from __future__ import annotations

import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pneuma.analysis.run_index import Entry, RunIndex
from pneuma.config import Run, as_fields
from pneuma.errors import UserError, counted, unknown_name
from pneuma.study.plan import Selection, configure, round_up
from pneuma.study.spec import Study, list_studies, load_study, run_command
from pneuma.values import as_tuple, setting_words, shown_settings
from pneuma.worlds import TEXT, WORLDS

if TYPE_CHECKING:
    from pneuma.analysis.frames import StudyData  # which loads pandas: not for `status`

ALL = Selection()
MOST_TOLD = 80
"""Characters for what else is stored, in the line that says what is shown."""
Tell = Callable[[str], object]
"""Says something to the user."""
Stored = tuple[str, int, Entry]
"""Condition and seed of a run of a study, and where it is."""


@dataclass(frozen=True)
class Asked:
    """A study as it is asked for, before any run is looked at.

    Attributes:
        study: in its world and with changed fields; one that lists its runs has no path.
        fields: the fields of each condition, apart from seed and steps; of an import, what is known.
        runs: the configurations, by condition; empty if the study lists its runs.
        listed: of a study that lists them, condition and seed of each run, by id.
        same: groups of conditions that are one configuration.
        narrowed: conditions, seeds and steps that were asked for, which figures' names contain.
    """

    study: Study
    fields: Mapping[str, Mapping[str, Any]]
    runs: Mapping[str, Run] = field(default_factory=dict)
    listed: Mapping[str, tuple[str, int]] = field(default_factory=dict)
    same: Sequence[Sequence[str]] = ()
    narrowed: Sequence[str] = ()

    @property
    def where(self) -> str:
        study, changed = self.study, shown_settings(self.study.settings)
        world = f" in {WORLDS[study.world].title}" if len(study.worlds) > 1 else ""
        return f"{study.name}{world}" + (f" with {changed}" if changed else "")


@dataclass(frozen=True)
class Shown:
    """The runs that answer a question, finished or not.

    Attributes:
        asked: the question.
        runs: condition, seed and entry of each run, seed by seed.
        budget: agent steps, as `--steps` takes them; None for a study that lists its runs.
        others: what else is stored of the study, each with the option that shows it.
        last_here: whether the budget is that of the study's last `study run` in this results folder.
    """

    asked: Asked
    runs: Sequence[tuple[str, int, Entry]]
    budget: int | None = None
    others: Sequence[str] = ()
    last_here: bool = False

    def told(self, root: Path) -> str:
        """Say in one sentence what of a results folder is shown, and what else is stored."""
        entries = [entry for *_, entry in self.runs]
        published = sum(entry.table is not None for entry in entries)
        origin = (
            f"published; none was trained in {root}"
            if published == len(entries)
            else f"{published} of them published"
        )
        parts = [f"{self.asked.where}: {counted(len(entries), 'run')}"]
        parts += [f"of {self.budget:,} steps"] if self.budget else []
        here = "(trained here)" if any(entry.finished for entry in entries) else "(none has finished yet)"
        here = "(as last run here)" if self.last_here and here == "(trained here)" else here
        parts += [f"({origin})" if published else here * bool(self.budget)]
        return " ".join(filter(None, parts)) + "." + self._told_others()

    def _told_others(self) -> str:
        """Say what else is stored in at most `MOST_TOLD` characters; `study status` says the rest."""
        told: list[str] = []
        rest = list(self.others)
        while rest and len("; ".join([*told, rest[0]])) < MOST_TOLD:
            told.append(rest.pop(0))
        more = [f"{len(rest)} more (pneuma study status {self.asked.study.name})"] if rest else []
        return f" Stored too: {'; '.join([*told, *more])}." if self.others else ""


def ask(index: RunIndex, name: str, picked: Selection = ALL, world: str | None = None) -> Asked:
    """Return a study as a question.

    Raises:
        UserError: for an unknown study, world or condition, or fields that do not go together.
    """
    of_file = name in list_studies() or name.endswith(".toml")
    if not of_file and (listing := index.listing(name)) is not None:
        return _ask_listed(index, listing, picked)
    study = load_study(name, world, () if of_file else index.listings())
    found = configure(study, picked.settings, picked.conditions, index.engine_of)
    fields = {name: _without_amount(as_fields(run)) for name, run in found.runs.items()}
    narrowed = picked.conditions if {*found.origins} < {*found.study.conditions} else ()
    return Asked(found.study, fields, found.runs, same=found.same, narrowed=narrowed)


def _ask_listed(index: RunIndex, listing: Mapping[str, Any], picked: Selection) -> Asked:
    name = listing["study"]
    every: dict[str, dict[str, Any]] = {run["condition"]: {} for run in listing["runs"]}
    for condition in picked.conditions:
        if condition not in every:
            raise unknown_name(f"condition of study {name}", condition, every)
    if picked.settings:
        raise UserError(f"--set: study {name} has no file whose fields could be changed")
    fields: dict[str, Mapping[str, Any]] = {
        condition: {} for condition in every if condition in (picked.conditions or every)
    }
    listed = {
        run["run_id"]: (run["condition"], run["seed"])
        for run in listing["runs"]
        if run["condition"] in fields and run["run_id"] in index.entries
    }
    for run_id, row in index.rows(index.entries[run_id] for run_id in listed).items():
        fields[listed[run_id][0]] = _without_amount(row.fields)
    baseline, title = listing["baseline"], listing["title"]
    study = Study.without_file(name, title, every, baseline=baseline, worlds=(TEXT,))
    narrowed = picked.conditions if len(fields) < len(every) else ()
    return Asked(study, fields, listed=listed, narrowed=narrowed)


def _without_amount(fields: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in fields.items() if key not in ("seed", "steps")}


# --- The runs ---------------------------------------------------------------------------------------


def answer(index: RunIndex, asked: Asked, picked: Selection = ALL) -> Shown:
    """Return the runs of a study that have the steps and seeds that were asked for.

    Without steps these are the runs of the budget of this study's last `study run` here, or else of the
    published budget with most conditions and runs. What other studies train changes neither. Budgets without
    any of the seeds that were asked for are passed over.

    Raises:
        UserError: when nothing is stored that is asked for.
    """
    stored = stored_runs(index, asked)
    if not asked.runs:
        found = [run for run in stored if picked.steps in (None, run[2].steps)]
        if not found:
            of = f" of {picked.steps:,} steps" if picked.steps else ""
            raise UserError(f"study {asked.study.name} has no runs{of} in {index.store.root}")
        return _narrowed(Shown(asked, found), picked)
    if not stored:
        raise UserError(_nothing(index, asked))
    budgets, last_here = _by_budget(asked, stored), False
    if picked.steps is None:
        having = {
            steps: runs
            for steps, runs in budgets.items()
            if picked.seeds is None or any(seed in picked.seeds for _, seed, _ in runs)
        }
        budget, last_here = _usual_budget(index, asked.study, having or budgets)
    elif chosen := _of_budget(asked, stored, picked.steps):
        budgets, budget = {**budgets, picked.steps: chosen}, picked.steps
    else:
        known = ", ".join(f"{steps:,}" for steps in budgets)
        raise UserError(f"--steps {picked.steps}: {asked.where} has runs of {known} steps")
    shown, others = budgets[budget], []
    for steps, runs in sorted(budgets.items(), key=lambda each: -len(each[1])):
        if runs != shown:
            published = ", published" if all(entry.table for *_, entry in runs) else ""
            others.append(f"{counted(len(runs), 'run')} of {steps:,} steps{published} (--steps {steps})")
    others += _elsewhere(index, asked.study)
    return _narrowed(Shown(asked, shown, budget, others, last_here), picked)


def stored_runs(index: RunIndex, asked: Asked) -> list[Stored]:
    """Return condition, seed and entry of every run of a study, of any budget."""
    listed = [(*named, index.entries[run_id]) for run_id, named in asked.listed.items()]
    return listed + [
        (name, each.seed, each) for name, run in asked.runs.items() for each in index.of_run(run)
    ]


def _narrowed(shown: Shown, picked: Selection) -> Shown:
    seeds = {seed for _, seed, _ in shown.runs}
    kept = seeds if picked.seeds is None else seeds & {*picked.seeds}
    if not kept:
        few = ", ".join(map(str, sorted(seeds)[:10])) + (", …" if len(seeds) > 10 else "")
        raise UserError(f"--seeds: {shown.asked.where} has none of these; it has {few or 'no runs'}")
    asked, order = shown.asked, list(shown.asked.fields)
    narrowed = ["seeds", *map(str, sorted(kept))] if kept < seeds else []
    narrowed += ["steps", str(picked.steps)] if picked.steps else []
    asked = replace(asked, narrowed=[*asked.narrowed, *narrowed])
    runs = [run for run in shown.runs if run[1] in kept]
    return replace(shown, asked=asked, runs=sorted(runs, key=lambda run: (run[1], order.index(run[0]))))


def _by_budget(asked: Asked, stored: Sequence[Stored]) -> dict[int, list[Stored]]:
    """Return the stored runs of each budget, in the words of the study's presets where they have it."""
    known = [preset.steps for preset in asked.study.presets.values()]
    found: dict[int, list[Stored]] = {}
    for steps in dict.fromkeys([*known, *sorted({entry.steps for *_, entry in stored})]):
        runs = _of_budget(asked, stored, steps)
        if runs and not any({*map(id, runs)} <= {*map(id, others)} for others in found.values()):
            found[steps] = runs
    return found


def _of_budget(asked: Asked, stored: Sequence[Stored], steps: int) -> list[Stored]:
    """Return the runs of one budget: so many steps, rounded up, or what a preset of it says instead."""
    amounts = dict.fromkeys(asked.runs, steps)
    for preset in asked.study.presets.values():
        if preset.steps == steps:
            amounts |= {name: each.steps for name, each in preset.conditions.items() if name in amounts}
    budgets = {name: round_up(asked.runs[name], amount) for name, amount in amounts.items()}
    return [each for each in stored if each[2].steps == budgets[each[0]]]


def _usual_budget(index: RunIndex, study: Study, budgets: Mapping[int, Sequence[Stored]]) -> tuple[int, bool]:
    """Return the budget that is shown without --steps, and whether it is that of the last run here."""
    last = index.store.last_steps(study.name, study.variant)
    if last is not None and last in budgets:
        return last, True
    published = {steps: runs for steps, runs in budgets.items() if any(entry.table for *_, entry in runs)}
    sizes = {steps: (len({name for name, *_ in runs}), len(runs)) for steps, runs in budgets.items()}
    return max(published or budgets, key=sizes.__getitem__), False


# --- What else there is -----------------------------------------------------------------------------


def _elsewhere(index: RunIndex, study: Study) -> list[str]:
    """Return in which other worlds runs of a study are stored."""
    found = []
    for world in study.worlds:
        if world != study.world:
            other = configure(load_study(study.own_path or study.name, world), study.settings)
            count = sum(len(index.of_run(run)) for run in other.runs.values())
            found += [f"{counted(count, 'run')} in {WORLDS[world].title} (--world {world})"] if count else []
    return found


def _nothing(index: RunIndex, asked: Asked) -> str:
    """Return that no runs are stored, what to run, and what is stored that differs in one field."""
    others = [*_elsewhere(index, asked.study), *_changed(index, asked)]
    stored = f" Stored are: {'; '.join(others)}." if others else ""
    train = f"run `{run_command(asked.study)}` first, or give --results"
    damaged = "".join(f" {problem}." for problem in index.problems)
    return f"study {asked.where} has no runs in {index.store.root}: {train}.{stored}{damaged}"


def _changed(index: RunIndex, asked: Asked) -> list[str]:
    """Return the single fields by whose change stored runs are those of the study."""
    counts: dict[str, int] = {}
    for entries in index.by_configuration.values():
        finished = next((entry for entry in entries if entry.finished), None)
        row = index.row(finished.run_id) if finished else None
        kept = _without_amount(row.fields) if row else {}
        for fields in asked.fields.values() if row else ():
            unlike = [
                key for key in {**fields, **kept} if as_tuple(fields.get(key)) != as_tuple(kept.get(key))
            ]
            if len(unlike) == 1:
                option = shlex.join(setting_words({unlike[0]: kept.get(unlike[0])}))
                counts[option] = counts.get(option, 0) + len(entries)
    return [f"{counted(count, 'run')} ({option})" for option, count in counts.items()]


# --- The answer -------------------------------------------------------------------------------------


def open_study(
    index: RunIndex,
    name: str,
    picked: Selection = ALL,
    world: str | None = None,
    tell: Tell = lambda message: None,
) -> StudyData:
    """Return the finished runs of a study that are asked for, wherever they are.

    `name` is that of a study, with or without a file, or the path of its file; `world` is one of `WORLDS`, by
    default the arena where the study is run in it. `tell` is told what is shown and what else is stored.

    Raises:
        UserError: when nothing is stored that is asked for, or no run of it has finished.
    """
    shown = answer(index, ask(index, name, picked, world), picked)
    tell(shown.told(index.store.root))
    return read_answer(index, shown, tell)


def read_answer(index: RunIndex, shown: Shown, tell: Tell = lambda message: None) -> StudyData:
    data = read_runs(index, shown.asked, shown.runs)
    for problem in index.problems:
        tell(f"Note: {problem}.")
    if left_out := len(shown.runs) - (len(data.runs) if data else 0):
        tell(f"Note: {left_out} of {len(shown.runs)} runs are not finished or damaged, and left out.")
    if data is None:
        train = f": run `{run_command(shown.asked.study)}` first" if shown.asked.runs else ""
        raise UserError(f"no finished run of study {shown.asked.where} is in {index.store.root}{train}")
    return replace(data, steps=shown.budget)


def read_runs(index: RunIndex, asked: Asked, stored: Sequence[Stored]) -> StudyData | None:
    from pneuma.analysis.frames import StudyData

    rows, study = index.rows(entry for *_, entry in stored), asked.study
    runs = [
        replace(rows[entry.run_id], condition=condition, seed=seed)
        for condition, seed, entry in stored
        if entry.run_id in rows
    ]
    if not runs:
        return None
    return StudyData(
        study=study.name,
        title=study.title,
        figure=study.figure,
        baseline=study.baseline,
        fields=asked.fields,
        runs=runs,
        same=asked.same,
        every=tuple(study.conditions),
        narrowed=asked.narrowed,
        world=study.world if len(study.worlds) > 1 else "",
        changed=study.settings,
        outcomes=study.outcomes,
        labels=study.labels,
    )
