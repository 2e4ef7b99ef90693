"""The functions that scripts, notebooks and the command line call.

    new_study(name)       copies a shipped study to a file of your own
    run_study(study)      trains what is missing, and opens it: `plan_study`, `train_plan`, `open_data`
    open_data(study)      a study's data, for `pneuma.analysis`
    check_study(study)    trains published runs again and compares them to the last bit: `check_runs`
    compare(study, a, b)  the differences of two conditions, with intervals
    summarize(study)      the outcomes of each condition
    plot(study)           a study's curves in axes of your own
    promote(search)       trains a search's best trial and its base on fresh seeds, as a study
    load_policy(run_id)   a stored run's policy, with its environment
    evaluate(agent)       evaluates any agent as runs are evaluated

docs/python.md shows them at work.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from pneuma.config import WORLD_FIELDS, Run, as_fields, is_gymnasium_id, make_run
from pneuma.env.fields import ENVIRONMENTS, make_env_config, read_field
from pneuma.errors import Message, Say, UserError, counted, silent, unknown_name
from pneuma.files import create_whole, write_error
from pneuma.schema import normalize, read_toml
from pneuma.seeds import read_seeds
from pneuma.store.last_queries import on_top_of_last
from pneuma.store.provenance import available_cores, project
from pneuma.store.store import Store
from pneuma.store.stored_runs import find_trained, stored_run, trusted_settings
from pneuma.study import plan, shipped, spec
from pneuma.study.identity import describe_user_code, user_files
from pneuma.training import execute
from pneuma.training.executors.base import ExecutorConfig
from pneuma.training.progress import ProgressDisplay

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from pneuma.analysis.answer import Answer
    from pneuma.analysis.check import CheckAnswer
    from pneuma.analysis.study_data import StudyData
    from pneuma.engines.evaluation import Act
    from pneuma.engines.policy import Policy
    from pneuma.engines.sb3_open import LearnedPolicy

Where = str | os.PathLike[str]


def new_study(name: str, source: str = "activation") -> Path:
    """Copy a shipped study to NAME.toml in this folder, to edit, with the module that it needs.

    Args:
        name: the new study's name.
        source: the shipped study.

    Returns:
        The file's path, which `run_study` takes.

    Raises:
        UserError: for a name that is taken or not allowed, or an unknown source.
    """
    if not re.fullmatch(r"[\w-]+", name):
        raise UserError(f"{name}: a study's name may only have letters, digits, - and _")
    path, folder = Path(f"{name}.toml"), shipped.studies_folder()
    shipped.refuse_taken_name(path, folder / path.name, "study")
    if path.exists():
        raise UserError(f"{path}: already exists; choose another name")
    if source not in shipped.list_studies():
        raise unknown_name("shipped study", source, shipped.list_studies())
    toml = (folder / f"{source}.toml").read_text(encoding="utf-8")
    toml = re.sub(r'^about = """(?s:.*?)"""\n|^(section|figure) = .*\n|\A(#.*\n)+', "", toml, flags=re.M)
    toml = re.sub(r"^title = .*$", f'title = "{name}"', toml, flags=re.M)
    toml = f"# From the study {source}. docs/studies.md lists what can be set.\n{toml}"
    try:
        create_whole(path, toml.encode())
        for module in re.findall(r'"(\w+):\w+"', toml):  # its files are in its folder
            source_file = folder / f"{module}.py"
            if source_file.is_file():
                create_whole(path.with_name(source_file.name), source_file.read_bytes())
    except OSError as error:
        raise write_error(path, error) from None
    return path


def run_study(
    study: Where,
    results: Where | None = None,
    *,
    preset: str | None = None,
    seeds: int | Sequence[int] | None = None,
    steps: int | None = None,
    conditions: Sequence[str] = (),
    settings: Mapping[str, Any] | None = None,
    world: str | None = None,
    workers: int | None = None,
    on_progress: execute.OnProgress | None = None,
    quiet: bool = False,
) -> StudyData:
    """Train the missing runs of a study and open it. Stored runs are not trained again.

    Args:
        study: name of a shipped study, or path of your own file.
        results: the results folder; PNEUMA_RESULTS or ./results when left out.
        preset: one of the study's presets; default: quick.
        seeds: a count or a list of seeds, instead of the preset's.
        steps: agent steps of each run, instead of the preset's.
        conditions: names of conditions; default: all.
        settings: fields to set in every condition.
        world: a key of `pneuma.presets.WORLDS`; default: the arena where the study is run in it.
        workers: number of runs that train at once, each in a process of one thread; default: one per core.
        on_progress: called with a cell and an event, such as a step, instead of showing progress.
        quiet: show no progress.

    Raises:
        UserError: for an unknown study, selection or world, or when a run crashed or was killed.
        KeyboardInterrupt: after Ctrl-C; the same call resumes.
    """
    most_workers, store = _count("workers", workers) or available_cores(), _store(results)
    planned = plan_study(_query(study, world, preset, seeds, steps, conditions, settings), store)
    executor_config = ExecutorConfig(workers=most_workers)
    cell_results = train_plan(planned, store, executor_config, quiet=quiet, on_progress=on_progress)
    unfinished = [cell_result for cell_result in cell_results if not cell_result.status.finished]
    if unfinished:
        cell, status = unfinished[0].cell, unfinished[0].status
        raise UserError(
            f"{len(unfinished)} of {len(cell_results)} runs did not finish: {cell.condition} "
            f"seed {cell.seed} {status.name} {unfinished[0].reason}; "
            f"see {store.run_folder(cell.run_id) / 'error.txt'}"
        )
    return open_data(study, results, preset=spec.LAST, world=world)


def plan_study(query: plan.Query, store: Store, say: Say = silent) -> plan.Plan:
    """Plan the runs of a query to train, after `say` was called with the user's own code that they run."""
    try:
        study = spec.load_study(query.study, query.world, copies=store.studies)
    except UserError:
        if store.listing(query.study):
            raise UserError(f"study {query.study}: its runs were imported and cannot be trained") from None
        raise
    if query.preset == spec.LAST:
        query = on_top_of_last(store, study.name, study.world, query)
    _say_user_code([study.fields(condition, query.settings) for condition in study.conditions], say)
    if query.preset == spec.CLAIMS:
        from pneuma.analysis.claims.preset import with_claims

        study = with_claims(study, query.steps)
    planned = plan.make_plan(study, query)
    if study.outcomes:
        _check_outcomes(study, {cell.run.env for cell in planned.cells})
    return planned


def _say_user_code(fields_of_runs: Iterable[Mapping[str, Any]], say: Say) -> None:
    """Say which code of the user's own some runs would run."""
    uses: dict[str, None] = {}
    for fields in fields_of_runs:
        uses |= dict.fromkeys(describe_user_code(fields).values())
    for use in uses:
        if use.startswith("run "):
            say(f"Note: the study's file asks to {use}.")


def _check_outcomes(study: spec.Study, environments: Collection[str]) -> None:
    """Refuse outcomes of a study's file that its runs cannot have, before anything is trained."""
    from pneuma.analysis.outcomes import check_outcome

    try:
        for outcome in study.outcomes:
            check_outcome(outcome, environments)
    except UserError as error:
        assert study.path is not None
        raise read_toml(study.path).mistake((), f"outcomes: {error}", "outcomes") from None


def train_plan(
    planned: plan.Plan,
    store: Store,
    config: ExecutorConfig,
    *,
    retry_failed: bool = False,
    quiet: bool = False,
    on_progress: execute.OnProgress | None = None,
    say: Say = silent,
) -> list[execute.CellResult]:
    """Train a plan's missing runs, with `retry_failed` also those that crashed, and show the progress.

    Runs pause at the step `config.until`.
    """
    missing, notes = execute.prepare(planned, store, retry_failed, config.until)
    own_path = planned.study.own_path
    if own_path:
        own_files = {own_file for cell in planned.cells for own_file in user_files(as_fields(cell.run))}
        config = replace(config, project=project(Path(own_path), own_files))
    for note in list(planned.notes) + list(notes):
        say(Message("Note: ", note, "."))
    if missing:
        say(f"Training {counted(len(missing), 'run')}; compiling for the first time takes up to a minute.")
    with ProgressDisplay(missing, store, quiet or on_progress is not None, config.until) as display:
        return execute.execute(planned, missing, store, config, on_progress or display.update)


def open_data(
    study: Where,
    results: Where | None = None,
    *,
    preset: str | None = None,
    seeds: int | Sequence[int] | None = None,
    steps: int | None = None,
    conditions: Sequence[str] = (),
    settings: Mapping[str, Any] | None = None,
    world: str | None = None,
    say: Say = silent,
) -> StudyData:
    """Open the finished runs of a study's cells, stored or published.

    Arguments are those of `run_study`; `study` may also be "NAME@PRESET". What is left out is as the study
    was last run in the results folder, in this world; if it was not, it is as in its preset `paper`.

    Raises:
        UserError: for an unknown study, preset, condition or world, or when none of the cells has finished.
    """
    from pneuma.analysis.runs import open_study
    from pneuma.store.index import RunIndex

    query = _query(study, world, preset, seeds, steps, conditions, settings)
    return open_study(RunIndex(_store(results)), query, say)


def compare(
    study: StudyData | Where,
    a: str = "",
    b: str = "",
    outcomes: Sequence[str] = (),
    results: Where | None = None,
    *,
    other: StudyData | Where | None = None,
) -> Answer:
    """Compare condition `a` of a study, or of opened data, with `b`, as `pneuma study compare` does.

    Args:
        study: opened data, or what `open_data` takes.
        a: a condition.
        b: the condition that it is compared with.
        outcomes: names from docs/outcomes.md; default: the study's, or the default ones.
        results: as of `run_study`.
        other: another study, each of whose conditions is compared with that of the same name, instead of two
            conditions.

    Returns:
        An answer whose `table` has a row for each outcome: means, their difference with its interval,
        `p_better`, and counts of runs. Its `notes` list what makes the numbers doubtful.

    Raises:
        UserError: for unknown names, or outcomes that cannot be compared.
    """
    from pneuma.analysis.comparison import compare

    second_data = None if other is None else _opened(other, results)
    return compare(_opened(study, results), a, b, _names(outcomes), second_data)


def check_study(
    study: Where,
    results: Where | None = None,
    *,
    runs: int = 2,
    preset: str | None = None,
    seeds: int | Sequence[int] | None = None,
    steps: int | None = None,
    conditions: Sequence[str] = (),
    settings: Mapping[str, Any] | None = None,
    world: str | None = None,
    quiet: bool = False,
    say: Say = silent,
) -> CheckAnswer:
    """Train published runs of a study again, and compare them to the last bit with the published ones.

    The shortest runs are trained, in a temporary folder that is removed afterwards. Runs that an earlier
    version published are not compared.

    Args:
        study: as of `run_study`; may also be "NAME@PRESET".
        results: as of `run_study`; its published tables are read, and it is not written.
        runs: how many runs are trained.
        preset: one of the study's presets; default: paper.
        seeds: as of `run_study`.
        steps: as of `run_study`.
        conditions: as of `run_study`.
        settings: as of `run_study`.
        world: as of `run_study`.
        quiet: show no progress.
        say: is called with messages, such as how long the runs took.

    Returns:
        An answer that has `is_same`. Its `table` has a row for each run: whether it is the same, and the
        first value that differs, as it was published and as it is here.

    Raises:
        UserError: if no run can be checked, or one does not finish.
        KeyboardInterrupt: after Ctrl-C.
    """
    query = _query(study, world, preset, seeds, steps, conditions, settings)
    return check_runs(query, _store(results), _count("runs", runs) or 2, quiet=quiet, say=say)


def check_runs(
    query: plan.Query, store: Store, most_runs: int, *, quiet: bool = False, say: Say = silent
) -> CheckAnswer:
    """Train some published runs of a query's cells again, and compare them; see `check_study`."""
    from pneuma.analysis.check import choose_runs, compare_runs
    from pneuma.store.index import RunIndex
    from pneuma.store.row_builder import stored_row

    chosen = choose_runs(RunIndex(store, stored=False), query, most_runs)
    cells = chosen.plan.cells
    try:
        folder = TemporaryDirectory(prefix="pneuma-check-")
    except OSError:
        raise UserError("no temporary folder can be written: let the variable TMPDIR name one") from None
    rows = {}
    with folder as folder_name:
        for note in chosen.notes:
            say(note)
        _say_user_code([as_fields(cell.run) for cell in cells], say)
        scratch = Store(folder_name)
        executor_config = ExecutorConfig(workers=min(available_cores(), len(cells)))
        for cell_result in train_plan(chosen.plan, scratch, executor_config, quiet=quiet, say=say):
            cell, status = cell_result.cell, cell_result.status
            if not status.finished:
                text = f"{cell.condition} seed {cell.seed} {status.name}, so nothing was compared"
                raise UserError(f"{text}: {cell_result.reason}")
            rows[cell.run_id] = stored_row(scratch, cell.run_id)
    return compare_runs(chosen, rows)


def summarize(study: StudyData | Where, outcomes: Sequence[str] = (), results: Where | None = None) -> Answer:
    """Summarize the outcomes of each condition, as `pneuma study summary` does.

    Args:
        study: opened data, or what `open_data` takes.
        outcomes: names from docs/outcomes.md; default: the study's, or the default ones.
        results: as of `run_study`.

    Returns:
        An answer whose `table` has a row for each condition, outcome and statistic.
    """
    from pneuma.analysis.summaries import summarize

    return summarize(_opened(study, results), _names(outcomes))


def plot(
    study: StudyData | Where,
    quantity: str = "",
    ax: Axes | None = None,
    results: Where | None = None,
    **options: Any,
) -> Axes:
    """Draw a study's curves of one quantity into axes of your own, in matplotlib's present settings.

    Args:
        study: opened data, or what `open_data` takes.
        quantity: as `pneuma study plot --quantity` takes it; default: the first of the study's figure.
        ax: default: matplotlib's current axes.
        results: as of `run_study`.
        options: `band`, `window`, `x` and `log`, as the options are called.

    Returns:
        The axes, with a legend.

    Raises:
        UserError: for a quantity, band or axis that the study's data do not have.
    """
    from pneuma.analysis.curves import find_curves
    from pneuma.figures.curves import plot_curves

    quantities = [quantity] if quantity else []
    return plot_curves(find_curves({"": _opened(study, results)}, quantities, **options), ax)


def promote(
    search: Where,
    results: Where | None = None,
    *,
    seeds: int | Sequence[int] = 10,
    steps: int | None = None,
    trial: int | None = None,
    world: str | None = None,
    workers: int | None = None,
    quiet: bool = False,
) -> StudyData:
    """Train the best trial of a search and its base on fresh seeds; return their study's data.

    Args:
        search: its name, or the path of its file.
        results: as of `run_study`.
        seeds: those that the search has not used.
        steps: of each run; default: the search's.
        trial: one to train instead of the best.
        world: the one in which it was searched.
        workers: as of `run_study`.
        quiet: as of `run_study`.

    Returns:
        The data of a study with the conditions `base` and `tuned`.

    Raises:
        UserError: for an unknown search, one without a complete trial, or when a run crashed or was killed.
    """
    from pneuma.search.log import read_record
    from pneuma.search.promote import find_trial, promotion_study, write_study

    store = _store(results)
    search_record = read_record(store, os.fspath(search), world)
    promoted = find_trial(search_record, trial)
    study_text = promotion_study(search_record, promoted, _seeds(seeds) or (), _count("steps", steps))
    return run_study(write_study(store, search_record, study_text), results, workers=workers, quiet=quiet)


def load_policy(
    run_id: str, results: Where | None = None, *, trust: bool = False
) -> tuple[Policy | LearnedPolicy, str, dict[str, Any]]:
    """Load the final policy of a stored run, or of one that comes with Pneuma.

    Args:
        run_id: the run's id, or its first digits if no other begins so.
        results: as of `run_study`.
        trust: use files, modules, and arguments of its environment, that the run names.

    Returns:
        The policy, the id of its environment, and the settings for `gymnasium.make(id, **settings)`. If the
        run has a module and wrappers of its own, you import and apply them. A `Policy` counts actions from 0:
        add `env.action_space.start` where they begin elsewhere. A learner of Stable-Baselines3's kind without
        fields of its own left a `LearnedPolicy`, which has `predict`.

    Raises:
        UserError: for an unknown run, a run without a policy, or one that needs `trust`.
    """
    store, full_id = find_trained(_store(results), run_id)
    run_settings = trusted_settings(store, full_id, trust)
    policy = stored_policy(store, full_id, run_settings)
    env_id = read_field(Run, "env", run_settings.get("env"))
    if is_gymnasium_id(env_id):
        settings = json.loads(run_settings.get("env_kwargs") or "{}")
    else:
        settings = {
            field_name: run_settings[field_name] for field_name in WORLD_FIELDS if field_name in run_settings
        }
    return policy, env_id, settings


def stored_policy(store: Store, run_id: str, settings: Mapping[str, Any]) -> Policy | LearnedPolicy:
    """Read the final policy of a run with these settings, which may be untrusted; nothing is unpickled."""
    from pneuma.engines.policy import LEARNER_FILE, read_sound_policy
    from pneuma.engines.records import POLICY_FILE

    checksums = store.checksums(run_id)
    if POLICY_FILE in checksums:
        return read_sound_policy(store.read_file(run_id, POLICY_FILE))
    if LEARNER_FILE in checksums:
        from pneuma.engines.sb3_open import load_learner

        return load_learner(stored_run(settings), store.read_file(run_id, LEARNER_FILE))
    raise UserError(f"run {run_id} has no stored policy")


def evaluate(
    agent: Policy | Act,
    env_id: str = ENVIRONMENTS[0],
    settings: Mapping[str, Any] | None = None,
    *,
    best: Act | None = None,
    seed: int = 0,
    episodes: int = 50,
) -> dict[str, float]:
    """Evaluate an agent as runs are evaluated, with random streams that training never uses.

    All worlds play one episode at the same time. At every step the agent gets the observations of all of
    them, in the same order, until the last one has ended. Each player has its own row: row i is player i %
    players.

    Args:
        agent: a policy of a stored run, or any function from observations, (N, features) float32, to
            actions, (N,) whole numbers.
        env_id: one of `pneuma.config.ENVIRONMENTS`.
        settings: keywords of `gymnasium.make`.
        best: the same agent without exploration or memory, which plays once from every start place. (A policy
            has its own.)
        seed: as of a run; its random player is 0 on the score's scale.
        episodes: number of episodes; studies use 50.

    Returns:
        The columns of a run's evaluations: share_killed, score, return, length, died and so on. Those that
        begin with `argmax` are present if best actions were played.

    Raises:
        UserError: for an unknown environment or world, or invalid actions.
    """
    from pneuma.engines.evaluation import Evaluation, OwnAgent
    from pneuma.engines.policy import Policy, check_fits

    world_settings = asdict(make_env_config(dict(settings or {}), env_id))
    run = make_run({**world_settings, "env": env_id, "seed": seed, "evaluation_episodes": episodes})
    evaluation = Evaluation(run)
    if isinstance(agent, Policy):
        check_fits(agent, evaluation.worlds)
        return evaluation.evaluate(agent, 0)
    row = evaluation.evaluate(OwnAgent(agent, best, int(evaluation.worlds.action_space.n)), 0)
    return row if best else {name: value for name, value in row.items() if not name.startswith("argmax")}


def _opened(study: StudyData | Where, results: Where | None) -> StudyData:
    from pneuma.analysis.study_data import StudyData

    return study if isinstance(study, StudyData) else open_data(study, results)


def _store(results: Where | None) -> Store:
    if results is None:
        results = os.environ.get("PNEUMA_RESULTS") or "results"
    return Store(os.path.expanduser(results))


def _query(
    study: Where,
    world: str | None,
    preset: str | None,
    seeds: int | Sequence[int] | None,
    steps: int | None,
    conditions: Sequence[str],
    settings: Mapping[str, Any] | None,
) -> plan.Query:
    query = plan.Query(
        world=world,
        preset=preset,
        seeds=_seeds(seeds),
        steps=_count("steps", steps),
        conditions=_names(conditions),
        settings=normalize(dict(settings or {})),
    )
    return query.named(os.fspath(study))


def _names(names: str | Sequence[str]) -> tuple[str, ...]:
    return (names,) if isinstance(names, str) else tuple(names)


def _seeds(seeds: int | Sequence[int] | None) -> tuple[int, ...] | None:
    if seeds is None:
        return None
    try:
        plain_seeds = normalize(seeds)
        return read_seeds(plain_seeds if isinstance(plain_seeds, int | str) else normalize(list(plain_seeds)))
    except (ValueError, TypeError):
        raise UserError(f"seeds = {seeds!r} is not allowed: a count, or different whole numbers") from None


def _count(argument_name: str, argument: object) -> int | None:
    count: int | None = normalize(argument)
    if count is not None and not (isinstance(count, int) and count >= 1):
        raise UserError(f"{argument_name} = {count} is not allowed: a whole number of at least 1")
    return count
