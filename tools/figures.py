"""Everything in `paper_figures/`; `make figures` runs this module.

    python -m tools.figures [FOLDER]

From the repository's root, it draws the environment's own figures and its gallery; the thesis's Figs. 6.2 to
6.5 with its conditions; one figure of every study in results/published, over the worlds in which it has runs;
the searches that pages show; and the verdicts on all claims.
Figures of an earlier run that are no longer drawn are removed.
"""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pandas as pd
from PIL import Image

from pneuma.analysis.claims.claim_list import shipped_claims
from pneuma.analysis.claims.verdicts import judge
from pneuma.analysis.claims.words import verdicts_by_claim
from pneuma.analysis.export import encode_frame
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.answers.curves import find_curves
from pneuma.answers.one_action import find_one_action
from pneuma.answers.outcomes import show_outcomes
from pneuma.config import as_fields, make_run
from pneuma.errors import UserError
from pneuma.figures.curves import curves_page
from pneuma.figures.grid import Page, save_page
from pneuma.figures.origin import KEYS
from pneuma.figures.search import draw_search
from pneuma.figures.shares import one_action_page
from pneuma.figures.style import MOST_IN_A_PANEL, PANEL_INCHES
from pneuma.figures.summary import summary_page
from pneuma.figures.words import capital
from pneuma.presets import BASES, WORLDS
from pneuma.search.log import read_published
from pneuma.search.spec import load_search
from pneuma.store.index import RunIndex
from pneuma.store.provenance import available_cores
from pneuma.store.series import MOST_OF_ONE
from pneuma.store.store import PUBLISHED, Store
from pneuma.study.plan import Query
from pneuma.values import format_value
from tools import noise_scale
from tools.environment_figures import draw_level, draw_mailman, draw_screens
from tools.gallery import draw_gallery
from tools.verdicts import draw_verdicts

FOLDER, RESULTS = Path("paper_figures"), Path("results")

THESIS_FIGURES = {
    "fig-6-2": ("architecture", ("small", "mid", "big")),
    "fig-6-3": ("actor-size", ("small", "smallest", "small-critic", "big", "big-actor")),
    "fig-6-4": ("optimizer", ("stationary", "non-stationary")),
    "fig-6-5": ("activation", ("tanh", "relu", "leaky-relu")),
}
"""The study of a figure in chapter 6, and the conditions in it."""
OWN_GAME = "own-game"
OF_OWN_GAME: Mapping[str, Mapping[str, Mapping[str, str]]] = {
    "fig-6-4": {
        "clip 0.1": {"stationary": "stationary", "non-stationary": "non-stationary"},
        "clip 0.2": {"stationary-wide": "stationary", "non-stationary-wide": "non-stationary"},
    },
    "fig-6-5": {"": {"non-stationary": "tanh", "relu": "relu", "leaky-relu": "leaky-relu"}},
    OWN_GAME: {
        "clip range 0.1": {"stationary": "stationary", "non-stationary": "non-stationary"},
        "clip range 0.2": {
            "stationary-wide": "stationary",
            "non-stationary-wide": "non-stationary",
            "l2-wide": "l2",
            "upgd-wide": "upgd",
        },
    },
}
"""The conditions of the thesis's own game that a figure shows, by title, with the figure's names for them."""
ONE_ENVIRONMENT = "Older runs, trained in one environment, not in four."
REWARDS = {"classes": "All classes are rewarded for kills."}
OWN_QUANTITIES = ("return", "entropy")
THESIS_QUANTITIES = ("return", "share_killed")
SEARCHES = {("ppo", "arena"): (), ("ppo", "text"): ("values",), ("godot", None): ("values",)}
"""The published searches that a page shows, each with its world if it has several; () is all its pictures."""
ELSEWHERE: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "CartPole": ("cartpole", {}),
    "Acrobot": ("acrobot", {}),
    "Acrobot, rewards normalised": ("acrobot", {"normalize_rewards": True}),
    "MinAtar's Breakout": ("breakout", {}),
}
"""Studies of the same question in other environments, with changed fields, by the titles of their panels."""
WHOLE = (
    "architecture", "activation", "actor-size", "author-logs", "breakout", "cartpole", "collapse",
    "late-collapse", "published-logs", "robustness", "team", "three-updates",
)  # fmt: skip
"""Studies without a figure: another figure shows every condition, or a table or a sentence is enough."""
EARLIER: Mapping[str, tuple[str, dict[str, Any]]] = {"fig-6-2": ("one-environment", {"slots": 1})}
"""Figures that show earlier runs too: the preset and the changed fields that these have."""
SEEN_SEEDS = range(100, 150)
"""Of runs that were known when their claims were stated. They are not drawn beside fresh ones."""
IN_ONE_ACTION = ("betas-by-clip", "betas-longer", "xp-scope", "xp-scope-longer")
"""Studies whose figure shows training's returns, and its updates in one action."""

SETTINGS = (
    "gamma", "gae_lambda", "learning_rate", "clip_range", "horizon", "minibatch", "epochs",
    "value_coefficient", "entropy_coefficient", "optimizer", "betas", "epsilon", "activation",
    "gradient_limit", "actor", "critic",
)  # fmt: skip
"""Fields that the thesis's Tables 6.1 and 6.2 state or leave to the library."""


def draw_all(folder: Path, results: Path = RESULTS) -> list[Path]:
    """Draw all figures and write the table of settings; return the files written."""
    folder.mkdir(parents=True, exist_ok=True)
    written = [*_draw_environment(folder), _write_settings(folder)]
    index = _published(results)
    sizes: dict[str, int] = {}
    for table in index.tables.values():
        sizes[table.about["study"]] = sizes.get(table.about["study"], 0) + len(table.index)
    largest_first = sorted(sizes, key=lambda name: (-sizes[name], name))
    with ProcessPoolExecutor(available_cores(), get_context("spawn")) as pool:
        verdicts = pool.submit(_draw_verdicts, folder, results)
        for paths in pool.map(partial(_draw_one, folder, results), largest_first):
            written += paths
    written += verdicts.result()
    written += _draw_searches(folder, results)
    if folder == FOLDER:
        _remove_others(folder, written)
    return written


def _save(folder: Path, pages: Iterable[Page]) -> list[Path]:
    return [path for page in pages for path in save_page(page, folder, ("png",))]


def _published(results: Path) -> RunIndex:
    return RunIndex(Store(results), stored=False, shipped=False)


def _remove_others(folder: Path, written: Collection[Path]) -> None:
    """Remove figures of an earlier run."""
    for path in {*folder.glob("*.png")} - {*written}:
        if _is_drawn_by_pneuma(path):
            path.unlink()


def _is_drawn_by_pneuma(path: Path) -> bool:
    try:
        with Image.open(path) as image:
            return bool(image.info.get(KEYS["png"], "").startswith("Pneuma"))
    except OSError:
        return False


def _draw_verdicts(folder: Path, results: Path) -> list[Path]:
    """Draw the verdicts on the thesis's claims; nothing where no study is published."""
    index = _published(results)
    if not index.tables:
        return []
    verdicts = [verdict for claims in shipped_claims() for verdict in judge(claims, index)]
    return draw_verdicts(verdicts_by_claim(verdicts), folder)


def _draw_searches(folder: Path, results: Path) -> list[Path]:
    """Draw the searches that pages show, if they are published in this folder."""
    drawn: list[Path] = []
    for (name, world), pictures in SEARCHES.items():
        search = load_search(name, world)
        if (results / PUBLISHED / f"search-{search.label}.log").exists():
            record = read_published(Store(results), search)
            drawn += draw_search(record, folder, ("png",), pictures)
    return drawn


def _draw_environment(folder: Path) -> list[Path]:
    """Draw the figures of the environment itself, and its gallery."""
    draws = (draw_mailman, draw_screens, draw_level, draw_gallery)
    return [path for draw in draws for path in draw(folder)]


def _write_settings(folder: Path) -> Path:
    """Write the thesis's two tables of hyperparameters: a row a field, and whether its two values differ."""
    names = ("table-6-1", "table-6-2")
    bases = [as_fields(make_run(BASES[name])) for name in names]
    rows = [[name, *(format_value(base[name]) for base in bases)] for name in SETTINGS]
    table = pd.DataFrame(rows, columns=["setting", *names])
    table["differs"] = ["yes" if one != other else "" for _, one, other in rows]
    path = folder / "tables" / "table-6-1-and-6-2.md"
    path.parent.mkdir(exist_ok=True)
    path.write_bytes(encode_frame(table, "markdown"))
    return path


# --- One study ---------------------------------------------------------------------------------------


def _draw_one(folder: Path, results: Path, study: str) -> list[Path]:
    """Draw all figures of a study; return the files written."""
    index, pages = _published(results), []
    for figure, (figure_study, _) in THESIS_FIGURES.items():
        if figure_study == study:
            curves = find_curves(thesis_columns(index, figure), THESIS_QUANTITIES)
            pages.append(curves_page(curves, basename=figure))
    if study == OWN_GAME:
        pages.append(curves_page(find_curves(_own_columns(index, study), OWN_QUANTITIES), basename=study))
    elif study == noise_scale.STUDY:
        pages.append(noise_scale.noise_page(noise_scale.open_noise_scale(index)))
    elif study == "acrobot":
        pages.append(_elsewhere(index))
    elif study in IN_ONE_ACTION:
        runs_there = study_runs(index, study, "godot")
        pages += [_in_training(runs_there)] if runs_there else []
    elif study not in WHOLE:
        pages += _study_pages(index, study)
    return _save(folder, pages)


def _in_training(study_data: StudyData) -> Page:
    """Return the figure of returns in training, and of training's updates in one action."""
    returns = curves_page(find_curves({"": study_data}, OWN_QUANTITIES[:1]), basename=study_data.study.name)
    ((_, updates_panel),) = one_action_page(find_one_action(study_data)).grid
    one_action = f"at least {100 * MOST_OF_ONE:g} % one action"
    note = f"Right: updates whose rollout is {one_action}, means in 95 % intervals."
    panels, notes = [*returns.grid[0], updates_panel], [note, *returns.caption]
    return replace(returns, grid=[panels], inches=PANEL_INCHES, caption=notes)


def _elsewhere(index: RunIndex) -> Page:
    columns: dict[str, StudyData] = {}
    for title, (study, settings) in ELSEWHERE.items():
        data = study_runs(index, study, None, settings=settings)
        if data:
            headline = {"title": "tanh or ReLU, and Adam's betas, in other environments", "settings": {}}
            columns[title] = replace(data, study=data.study.model_copy(update=headline))
    return curves_page(find_curves(columns), basename="elsewhere")


def _study_pages(index: RunIndex, study: str) -> list[Page]:
    """Return a study over the worlds of its tables: curves if they fit, or else its summary; and more."""
    worlds = {table.about.get("world") for table in index.tables.values() if table.about["study"] == study}
    columns: dict[str, StudyData] = {}
    for world in [None, *WORLDS]:
        data = study_runs(index, study, world) if world in worlds else None
        if data:
            trained = [name for name in data.conditions if data.of_condition(name)]
            columns[_title(world)] = data.of_conditions(trained)
    if not columns:  # tables of changed fields alone
        return []
    shown = {name for data in columns.values() for name in data.conditions}
    data = next(iter(columns.values()))
    pages: list[Page] = []
    if len(data.study.outcomes) > 1:
        for data in columns.values():
            basename = f"{study}-{data.world}" if len(columns) > 1 else study
            pages.append(summary_page(show_outcomes({"": data}), basename))
    elif data.study.outcomes or len(shown) > MOST_IN_A_PANEL:
        pages = [summary_page(show_outcomes(columns), basename=study)]
    else:
        pages = [curves_page(find_curves(columns), basename=study)]
    if study in REWARDS:
        pages = [replace(page, caption=[REWARDS[study], *page.caption]) for page in pages]
    if all(fields.get("slots") == 1 for data in columns.values() for fields in data.fields.values()):
        pages = [replace(page, caption=[ONE_ENVIRONMENT, *page.caption]) for page in pages]
    return pages


def _title(world: str | None) -> str:
    return capital(WORLDS[world].title) if world else ""


def study_runs(
    index: RunIndex,
    study: str,
    world: str | None,
    conditions: Sequence[str] = (),
    preset: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> StudyData | None:
    """Return the published runs of a study's preset (default: paper) in a world; None if there are none."""
    query = Query(study, world, preset, conditions=tuple(conditions), settings=settings or {})
    try:
        return open_study(index, query)
    except UserError:
        return None


def thesis_columns(index: RunIndex, figure: str) -> dict[str, StudyData]:
    """Return the runs of a figure's conditions in each world that has two of them or more, by title."""
    study, conditions = THESIS_FIGURES[figure]
    columns: dict[str, StudyData] = {}
    for world in WORLDS:
        if world == "godot" and figure in OF_OWN_GAME:
            columns |= _own_columns(index, figure)
            continue
        data = study_runs(index, study, world)
        if data is not None:
            _add_column(columns, _title(world), data, conditions)
        if figure in EARLIER:
            preset, settings = EARLIER[figure]
            data = study_runs(index, study, world, preset=preset, settings=settings)
            if data is not None:
                _add_column(columns, f"{_title(world)}, one environment", data, conditions)
    return columns


def _add_column(
    columns: dict[str, StudyData], title: str, data: StudyData, conditions: Sequence[str]
) -> None:
    shown = [name for name in conditions if data.of_condition(name)]
    has_fresh_seed = ~data.runs["seed"].isin(SEEN_SEEDS)
    fresh_conditions = {*data.runs["condition"][has_fresh_seed]}
    if fresh_conditions:
        shown = [name for name in shown if name in fresh_conditions]
    if len(shown) > 1:
        columns[title] = data.of_conditions(shown)


def _own_columns(index: RunIndex, figure: str) -> dict[str, StudyData]:
    """Return the runs of the thesis's own game that a figure shows, under the names of its conditions."""
    if figure not in OF_OWN_GAME or not (data := study_runs(index, OWN_GAME, None)):
        return {}
    columns = {}
    for clip_text, names in OF_OWN_GAME[figure].items():
        renamed = data.renamed(names)
        labels = {
            name: label.partition(";")[0] for name, label in renamed.study.labels.items() if name != "tanh"
        }
        title = ", ".join(filter(None, [_title("godot"), clip_text]))
        if figure == OWN_GAME:
            title = capital(clip_text)
        columns[title] = replace(renamed, study=renamed.study.model_copy(update={"labels": labels}))
    return {title: data for title, data in columns.items() if len(data.runs)}


if __name__ == "__main__":
    for drawn in draw_all(Path(sys.argv[1]) if sys.argv[1:] else FOLDER):
        print(f"wrote {drawn}")
