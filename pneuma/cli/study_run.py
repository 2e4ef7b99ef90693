"""`pneuma study plan` and `pneuma study run`."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from pneuma.cli import STOPPED
from pneuma.cli import options as opt
from pneuma.cli.output import Result, Table, command, frame_table, say, tallied
from pneuma.config import Run
from pneuma.errors import UserError, counted, install_extra
from pneuma.store.provenance import uncommitted
from pneuma.store.store import Status, Store
from pneuma.study import plan, spec
from pneuma.training import execute
from pneuma.training.executors.base import ExecutorConfig
from pneuma.training.progress import duration, expected_seconds, stored_paces

if TYPE_CHECKING:
    from pneuma.analysis.study_data import StudyData

Unpublished = Annotated[
    bool, opt.flag("--unpublished", "Leave out runs that are finished in a published table.")
]


def plan_(
    name: opt.Study,
    chosen: opt.RunFilter,
    unpublished: Unpublished = False,
    detect: Annotated[float | None, opt.option("X", "How many seeds find a difference of X.")] = None,
    outcome: Annotated[str | None, opt.option("NAME", "With --detect: of what (default: as usual).")] = None,
    sd: Annotated[float | None, opt.option("SD", "With --detect: the SD, where there are no runs.")] = None,
) -> Result:
    """Say which runs are stored and which would be trained, and estimate how long that takes."""
    if detect is not None:
        return _seeds_to_detect(None if sd else chosen.open(name), detect, outcome, sd)
    if outcome or sd:
        raise UserError(f"{'--outcome' if outcome else '--sd'} requires --detect")
    store, planned = chosen.store, _plan(chosen, name, unpublished)
    statuses = {cell.run_id: store.status(cell.run_id) for cell in planned.cells}
    todo = execute.missing(planned, statuses)
    execute.check_environments(todo.values())
    paces = stored_paces(store, statuses)
    seconds = {
        key: expected_seconds(paces, run, run.steps - execute.kept_step(statuses[key]))
        for key, run in todo.items()
    }
    states = {key: _state(status, key in planned.published) for key, status in statuses.items()}
    cells = [
        {**_cell(cell), "state": states[cell.run_id], "expected_seconds": seconds.get(cell.run_id)}
        for cell in planned.cells
    ]
    rows = []
    for each in planned.conditions:
        of_condition = [cell for cell in planned.cells if cell.condition == each]
        counts = tallied(states[cell.run_id] for cell in of_condition)
        rows.append((each, f"{len(of_condition):>3} x {of_condition[0].run.steps:>11,} steps", counts))
    shown: list[str | Table] = [Table([""] * 3, rows), f"{tallied(states.values())}."]
    if todo:
        shown.append(f"Time to train: {_expected_time(chosen, todo, statuses, seconds)}.")
    notes = [f"Note: {note}." for note in planned.notes]
    return Result({"study": planned.study.name, "runs": cells}, shown, notes=notes)


def _expected_time(
    chosen: opt.RunFilter,
    todo: Mapping[str, Run],
    statuses: Mapping[str, Status],
    seconds: Mapping[str, float | None],
) -> str:
    """Return how long runs take, by runs that were trained here, or else by published ones."""
    by = ""
    if any(expected is None for expected in seconds.values()):
        from pneuma.analysis.estimates import published_seconds

        by = " on the machine that made the published runs"
        seconds = {
            run_id: published_seconds(chosen.index, run, run.steps - execute.kept_step(statuses[run_id]))
            for run_id, run in todo.items()
        }
    known = [expected for expected in seconds.values() if expected is not None]
    if len(known) < len(seconds):
        return "unknown until a run of each kind has ended"
    workers = opt.Place().config().workers
    return f"about {duration(max(sum(known) / workers, *known))}{by}, with {workers} at once"


def _seeds_to_detect(data: StudyData | None, detect: float, outcome: str | None, sd: float | None) -> Result:
    """Return how many seeds a condition needs, by the runs there are or by a standard deviation."""
    import pandas as pd

    from pneuma.analysis.environments import by_environment
    from pneuma.analysis.outcomes import primary, with_unit
    from pneuma.analysis.power import ENOUGH_RUNS, POWER, seeds_for_means, seeds_table, seeds_text

    for option, value in (("--detect", detect), ("--sd", sd)):
        if value is not None and value <= 0:
            raise UserError(f"{option} {value:g}: must be above 0")
    if data is None:
        assert sd is not None
        table = pd.DataFrame([{"SD": f"{sd:g}", "seeds": seeds_text(seeds_for_means(detect, sd, sd))}])
        name, title = outcome or "any outcome", f"Seeds to detect {detect:g} of {outcome or 'any outcome'}"
    else:
        name = outcome or primary(data)
        tables = {env: seeds_table(part, name, detect) for env, part in by_environment(data).items()}
        table = pd.concat(tables, names=["environment"]).reset_index(level=0)
        table = table if len(tables) > 1 else table.drop(columns="environment")
        title = f"{data.full_title}: seeds to detect {detect:g} of {with_unit(name)}"
    legend = [
        f"Seeds of each condition with which the 95 % interval of the difference leaves out 0 in {POWER:.0%}",
        "of studies, if it is that large.",
    ]
    if data and any(len(data.of_condition(condition)) < ENOUGH_RUNS for condition in data.conditions):
        rough = f"From fewer than {ENOUGH_RUNS} runs a spread is rough"
        legend.append(f"{rough}: it may take three times as many seeds, or half.")
    document = {"outcome": name, "detect": detect, "seeds": table}
    return Result(document, ["", frame_table(table), "", *legend], title, (), table, table)


def run(
    name: opt.Study,
    chosen: opt.RunFilter,
    place: opt.Place,
    checkpoint_seconds: Annotated[float, opt.option("S", "Between a run's checkpoints.", min=0.01)] = 15.0,
    tensorboard: Annotated[Path | None, opt.option("DIR", "Log to TensorBoard while runs train.")] = None,
    retry_failed: opt.RetryFailed = False,
    unpublished: Unpublished = False,
    quiet: opt.Quiet = False,
) -> Result:
    """Train the missing runs of a study, resuming those that were stopped."""
    if chosen.preset == spec.CLAIMS and (changed := uncommitted()):
        raise UserError(
            f"--preset {spec.CLAIMS}: {changed[0]} is not as committed ({counted(len(changed), 'file')} of "
            "pneuma/ and studies/): commit first, so that each run tells the code that it was trained by"
        )
    if chosen.preset == spec.CLAIMS:
        from pneuma.analysis.claims.history import refuse_changed
        from pneuma.store.index import RunIndex

        refuse_changed(RunIndex(chosen.store), spec.load_study(name, chosen.world))
    planned = _plan(chosen, name, unpublished)
    config = replace(
        place.config(),
        checkpoint_seconds=checkpoint_seconds,
        logs=_log_folders(planned, tensorboard) if tensorboard else {},
    )
    return train(planned, chosen.store, config, retry_failed, quiet)


def train(
    planned: plan.Plan, store: Store, config: ExecutorConfig, retry_failed: bool, quiet: bool
) -> Result:
    """Train a plan's missing runs, with `retry_failed` also those that crashed, and show the progress."""
    from pneuma import api  # pydantic: not for `--help`

    unfinished = {each.run_id for each in planned.cells if not store.status(each.run_id, quick=True).finished}
    _check_logs(folder for name, folder in config.logs.items() if name in unfinished)
    results, text, code = [], [], STOPPED
    try:
        aside = partial(say, quiet=quiet)
        results = api.train_plan(planned, store, config, retry_failed=retry_failed, quiet=quiet, say=aside)
        code = int(not all(result.status.finished for result in results))
        text = [*_failures(results, store), *([] if quiet else _outcome(planned, results, store))]
    except KeyboardInterrupt:
        say("Stopped. The same command goes on where every run was stopped.")
    results = results or execute.cell_results(planned, store, unfinished)
    rows = [{**_cell(each.cell), "status": each.status.name, "trained": each.trained} for each in results]
    return Result({"study": planned.study.name, "runs": rows}, notes=text, code=code)


def _check_logs(folders: Iterable[str]) -> None:
    """Make the folders of TensorBoard logs, and refuse one that cannot be written."""
    for folder in folders:
        try:
            os.makedirs(folder, exist_ok=True)
            with tempfile.TemporaryFile(dir=folder):
                pass
        except OSError as error:
            raise UserError(f"--tensorboard: {folder} cannot be written ({error.strerror})") from None


def _log_folders(planned: plan.Plan, folder: Path) -> dict[str, str]:
    """Return the folder of each run's TensorBoard log, named so that `pneuma import` can read it."""
    if find_spec("tensorboard") is None:
        raise UserError(f"--tensorboard needs the tensorboard package: {install_extra('tensorboard')}")
    of_study = folder.resolve() / planned.study.name
    names: dict[str, str] = {}
    for condition in planned.conditions:
        slug = re.sub(r"[^\w.=+-]", "-", condition)
        while slug in names.values():
            slug += "-"
        names[condition] = slug
    return {cell.run_id: str(of_study / f"{names[cell.condition]}_{cell.seed}") for cell in planned.cells}


def _plan(chosen: opt.RunFilter, name: str, unpublished: bool) -> plan.Plan:
    """Plan a study; with `unpublished`, skip published runs."""
    from pneuma import api

    planned = api.plan_study(chosen.query(name), chosen.store, say)
    if not unpublished:
        return planned
    from pneuma.store.index import RunIndex

    index = RunIndex(chosen.store, stored=False)
    published = frozenset(cell.run_id for cell in planned.cells if cell.run_id in index.frame.index)
    for problem in index.problems:
        say(f"Note: {problem}; its runs are trained.")
    return replace(planned, published=published)


def _cell(cell: plan.Cell) -> dict[str, Any]:
    return {"run_id": cell.run_id, "condition": cell.condition, "seed": cell.seed}


def _state(status: Status, published: bool) -> str:
    if status.finished:
        return "stored"
    if published:
        return "published"
    if status.failed:
        return "failed"
    return "partial" if status.step else "to-train"


def _failures(results: Sequence[execute.CellResult], store: Store) -> Iterator[str]:
    """Say which runs did not end as they should, and where to look."""
    for result in results:
        label, state = f"{result.cell.condition} seed {result.cell.seed}", result.status
        if state.name == "diverged":
            yield f"{label} diverged at step {state.step:,}; its records count"
        elif not state.finished:
            trace, why = store.run_folder(result.cell.run_id) / "error.txt", result.reason
            why = f"{why} ({trace})" if trace.is_file() else why or f"at step {state.step:,}"
            yield f"{label} {state.name}: {why}"


def _outcome(planned: plan.Plan, results: Sequence[execute.CellResult], store: Store) -> Iterator[str]:
    """Count what was trained, and say what draws it."""
    trained = sum(result.trained for result in results)
    states = tallied(result.status.name for result in results) or "nothing to train"
    stored = f"{trained} trained now, {len(results) - trained} were stored"
    yield f"{planned.study.name}: {states}; {stored}."
    if results and all(result.status.finished for result in results):
        drawn = command("study", "plot", *spec.asked_words(planned.study), *spec.results_words(store.root))
        yield f"Draw it with: {drawn}"
