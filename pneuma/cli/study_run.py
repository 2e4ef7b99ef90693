"""`pneuma study plan` and `pneuma study run`."""

from __future__ import annotations

import os
import re
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import Annotated

from pneuma.analysis.answer import Answer
from pneuma.cli import STOPPED
from pneuma.cli import options as opt
from pneuma.cli.hints import command
from pneuma.cli.output import Result, say
from pneuma.errors import UserError, counted, install_command, tallied
from pneuma.store.provenance import uncommitted
from pneuma.store.store import Store
from pneuma.study import plan, spec
from pneuma.study.command_words import results_words, study_words
from pneuma.training import execute
from pneuma.training.executors.base import ExecutorConfig

Unpublished = Annotated[
    bool, opt.flag("--unpublished", "Leave out runs that a published table already contains.")
]


def plan_(
    name: opt.Study,
    selection: opt.RunFilter,
    unpublished: Unpublished = False,
    detect: Annotated[
        float | None, opt.option("X", "Estimate how many seeds detect a difference of X.")
    ] = None,
    outcome: Annotated[
        str | None, opt.option("NAME", "With --detect: the outcome (default: the study's primary one).")
    ] = None,
    sd: Annotated[
        float | None, opt.option("SD", "With --detect: the SD to assume if there are no runs.")
    ] = None,
    claims: Annotated[
        Path | None, opt.option("FILE", "With --detect: a list of claims, whose intervals decide.")
    ] = None,
) -> Answer:
    """Show which runs are stored, which would be trained, and how long that would take."""
    from pneuma.analysis import planned
    from pneuma.analysis.intervals import LEVEL

    if detect is not None:
        level = LEVEL
        if claims:
            from pneuma.analysis.claims.claim_list import load_claims

            level = load_claims(claims).level_on(
                spec.load_study(selection.query(name).study, selection.world)
            )
        study_data = None if sd else selection.open(name)
        return planned.seeds_to_detect(study_data, detect, outcome or "", sd, level)
    for option, value in {"--outcome": outcome, "--sd": sd, "--claims": claims}.items():
        if value:
            raise UserError(f"{option} requires --detect")
    planned_runs = _plan(selection, name, unpublished)
    return planned.plan_answer(selection.index, planned_runs, opt.Resources().config().workers)


def run(
    name: opt.Study,
    selection: opt.RunFilter,
    resources: opt.Resources,
    checkpoint_seconds: Annotated[
        float, opt.option("S", "Seconds between a run's checkpoints.", min=0.01)
    ] = 15.0,
    tensorboard: Annotated[
        Path | None, opt.option("DIR", "Write TensorBoard logs to this folder during training.")
    ] = None,
    retry_failed: opt.RetryFailed = False,
    unpublished: Unpublished = False,
    quiet: opt.Quiet = False,
) -> Result:
    """Train the missing runs of a study, resuming those that were stopped."""
    if selection.preset == spec.CLAIMS:
        changed = uncommitted()
        if changed:
            raise UserError(
                f"--preset {spec.CLAIMS}: {changed[0]} is not as committed ({counted(len(changed), 'file')} "
                "of pneuma/ and studies/): commit first, so that each run records the code that trains it"
            )
        from pneuma.analysis.claims.history import refuse_changed

        refuse_changed(selection.index, spec.load_study(name, selection.world))
    planned = _plan(selection, name, unpublished)
    log_folders = _log_folders(planned, tensorboard) if tensorboard else {}
    executor_config = replace(resources.config(), checkpoint_seconds=checkpoint_seconds, logs=log_folders)
    return train(planned, selection.store, executor_config, retry_failed, quiet)


def train(
    planned: plan.Plan, store: Store, config: ExecutorConfig, retry_failed: bool, quiet: bool
) -> Result:
    """Train a plan's missing runs, with `retry_failed` also those that crashed, and show the progress."""
    from pneuma import api

    unfinished = set()
    for cell in planned.cells:
        if not store.status(cell.run_id, quick=True).finished:
            unfinished.add(cell.run_id)
    _check_logs(folder for run_id, folder in config.logs.items() if run_id in unfinished)
    notes: list[str] = []
    say_unless_quiet = partial(say, quiet=quiet)
    try:
        results = api.train_plan(
            planned, store, config, retry_failed=retry_failed, quiet=quiet, say=say_unless_quiet
        )
        exit_code = int(not all(cell_result.status.finished for cell_result in results))
        notes += _failures(results, store)
        if not quiet:
            notes += _outcome(planned, results, store)
    except KeyboardInterrupt:
        say("Stopped. The same command goes on where every run was stopped.")
        results, exit_code = execute.cell_results(planned, store, unfinished), STOPPED
    run_rows = []
    for cell_result in results:
        identity = {key: getattr(cell_result.cell, key) for key in ("run_id", "condition", "seed")}
        run_rows.append({**identity, "status": cell_result.status.name, "trained": cell_result.trained})
    return Result({"study": planned.study.name, "runs": run_rows}, notes=notes, code=exit_code)


def _check_logs(folders: Iterable[str]) -> None:
    """Make the folders of TensorBoard logs, and refuse one that cannot be written."""
    for folder in folders:
        try:
            os.makedirs(folder, exist_ok=True)
            tempfile.TemporaryFile(dir=folder).close()
        except OSError as error:
            raise UserError(f"--tensorboard: {folder} cannot be written ({error.strerror})") from None


def _log_folders(planned: plan.Plan, folder: Path) -> dict[str, str]:
    """Return the folder of each run's TensorBoard log, named so that `pneuma import` can read it."""
    if find_spec("tensorboard") is None:
        raise UserError(f"--tensorboard needs the tensorboard package: {install_command('tensorboard')}")
    study_folder = folder.resolve() / planned.study.name
    slugs: dict[str, str] = {}
    for condition in planned.conditions:
        slug = re.sub(r"[^\w.=+-]", "-", condition)
        while slug in slugs.values():
            slug += "-"
        slugs[condition] = slug
    return {cell.run_id: str(study_folder / f"{slugs[cell.condition]}_{cell.seed}") for cell in planned.cells}


def _plan(selection: opt.RunFilter, study_name: str, unpublished: bool) -> plan.Plan:
    """Plan a study; with `unpublished`, skip published runs."""
    from pneuma import api

    planned = api.plan_study(selection.query(study_name), selection.store, say)
    if not unpublished:
        return planned
    from pneuma.analysis.runs import runs_of_plan
    from pneuma.store.index import RunIndex

    index = RunIndex(selection.store, stored=False)
    published_runs = runs_of_plan(index, planned).runs  # also those of other versions, as reading shows them
    published_cells = set(zip(published_runs["condition"], published_runs["seed"], strict=True))
    published = frozenset(
        cell.run_id for cell in planned.cells if (cell.condition, cell.seed) in published_cells
    )
    for problem in index.problems:
        say(f"Note: {problem}; its runs are trained.")
    return replace(planned, published=published)


def _failures(cell_results: Sequence[execute.CellResult], store: Store) -> Iterator[str]:
    """Yield which runs did not end as they should, and where to look."""
    for cell_result in cell_results:
        cell_label, status = f"{cell_result.cell.condition} seed {cell_result.cell.seed}", cell_result.status
        if status.name == "diverged":
            yield f"{cell_label} diverged at step {status.step:,}; its records count"
        elif not status.finished:
            error_file = store.run_folder(cell_result.cell.run_id) / "error.txt"
            reason = cell_result.reason or f"at step {status.step:,}"
            if error_file.is_file():
                reason = f"{cell_result.reason} ({error_file})"
            yield f"{cell_label} {status.name}: {reason}"


def _outcome(planned: plan.Plan, cell_results: Sequence[execute.CellResult], store: Store) -> Iterator[str]:
    """Count what was trained, and yield the command that draws it."""
    trained = sum(cell_result.trained for cell_result in cell_results)
    states = tallied(cell_result.status.name for cell_result in cell_results) or "nothing to train"
    yield f"{planned.study.name}: {states}; {trained} trained now, {len(cell_results) - trained} were stored."
    if cell_results and all(cell_result.status.finished for cell_result in cell_results):
        words = study_words(planned.study) + results_words(store.root)
        yield f"Draw it with: {command('study', 'plot', *words)}"
