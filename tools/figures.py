"""Everything in `paper_figures/`; `make figures` runs this module.

    python -m tools.figures [FOLDER]

From the repository's root, it draws the environment's own figures and its gallery; the thesis's Figs. 6.2 to
6.5 with its conditions; one figure of every study in results/published, over the worlds in which it has runs,
or what `PICTURES` has instead; and the verdicts on all claims.
Figures of an earlier run that are no longer drawn are removed.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import pandas as pd
from PIL import Image

from pneuma.analysis.claims.claim_list import shipped_claims
from pneuma.analysis.claims.verdicts import judge
from pneuma.analysis.claims.words import verdicts_by_claim
from pneuma.analysis.curves import find_curves
from pneuma.analysis.export import encode_frame
from pneuma.analysis.one_action import find_one_action
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.analysis.summaries import show_outcomes
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
from pneuma.study.shipped import random_returns_file
from pneuma.values import format_value
from tools import noise_scale
from tools.environment_figures import draw_level, draw_mailman, draw_screens
from tools.gallery import draw_gallery
from tools.verdicts import draw_verdicts

FOLDER, RESULTS = Path("paper_figures"), Path("results")

OWN_GAME = "own-game"
ONE_ENVIRONMENT = "Older runs, trained in one environment, not in four."
OWN_QUANTITIES = ("return", "entropy")
THESIS_QUANTITIES = ("return", "share_killed")
SEEN_SEEDS = range(100, 150)
"""Of runs that were known when their claims were stated. They are not drawn beside fresh ones."""

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
    logs = sorted((results / PUBLISHED).glob("search-*.log"))
    searches = [log.stem for log in logs if log.stem in PICTURES]
    with ProcessPoolExecutor(available_cores(), get_context("spawn")) as pool:
        verdicts = pool.submit(_draw_verdicts, folder, results)
        for paths in pool.map(partial(_draw_one, folder, results), largest_first + searches):
            written += paths
    written += verdicts.result()
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


# --- One study or search -----------------------------------------------------------------------------


def _draw_one(folder: Path, results: Path, study: str) -> list[Path]:
    """Draw all figures of a study or search; return the files written."""
    index = _published(results)
    paths: list[Path] = []
    for draw in PICTURES.get(study, [_study]):
        paths += draw(folder, index, study)
    return paths


Draw = Callable[[Path, RunIndex, str], list[Path]]
"""Draws into a folder, from an index, what is published of a study or search; returns the files."""


@dataclass(frozen=True)
class Column:
    """A column of a figure.

    Attributes:
        names: the conditions in it, with the figure's names for them; none is all by their own names.
    """

    title: str
    study: str
    names: Mapping[str, str] = field(default_factory=dict)
    world: str | None = None
    preset: str | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)


def _curves(
    figure: str, quantities: Sequence[str], columns: Iterable[Column], headline: str | None = None
) -> Draw:
    """Return what draws a figure of curves.

    Args:
        figure: the file's name.
        quantities: a row of panels for each; () for the studies' own.
        columns: those without runs are left out.
        headline: instead of the study's title.
    """

    def draw(folder: Path, index: RunIndex, study: str) -> list[Path]:
        opened: dict[str, StudyData] = {}
        for column in columns:
            data = _open_column(index, column)
            if data and headline:
                updates = {"title": headline, "settings": {}}
                data = replace(data, study=data.study.model_copy(update=updates))
            if data:
                opened[column.title] = data
        return _save(folder, [curves_page(find_curves(opened, quantities), basename=figure)])

    return draw


def _open_column(index: RunIndex, column: Column) -> StudyData | None:
    """Return a column's runs; None if there are none, or only of one condition out of several."""
    data = study_runs(index, column.study, column.world, column.preset, column.settings)
    if data is None or not column.names:
        return data
    shown = list(column.names.values())
    if shown != list(column.names):
        data = data.renamed(column.names)
        labels = {
            name: label.partition(";")[0] for name, label in data.study.labels.items() if name != "tanh"
        }
        data = replace(data, study=data.study.model_copy(update={"labels": labels}))
    return _fresh(data, shown)


def _fresh(data: StudyData, shown: Sequence[str]) -> StudyData | None:
    """Return those conditions that have runs, with fresh seeds if any has; None if it is one alone."""
    runs = data.runs[data.runs["condition"].isin(shown)]
    fresh_runs = runs[~runs["seed"].isin(SEEN_SEEDS)]
    if len(fresh_runs):
        runs = fresh_runs
    trained = runs["condition"].unique().tolist()
    return data.of_conditions(trained) if len(trained) > 1 else None


def _noise(folder: Path, index: RunIndex, study: str) -> list[Path]:
    return _save(folder, [noise_scale.noise_page(noise_scale.open_noise_scale(index))])


def _in_training(folder: Path, index: RunIndex, study: str, quantity: str = "return") -> list[Path]:
    """Draw the figure of a quantity of training's episodes, and of training's updates in one action."""
    data = study_runs(index, study, "godot")
    if data is None:
        return []
    curves = curves_page(find_curves({"": data}, [quantity]), basename=study)
    ((_, updates_panel),) = one_action_page(find_one_action(data)).grid
    one_action = f"at least {100 * MOST_OF_ONE:g} % one action"
    first_notes = [f"Right: updates whose rollout is {one_action}, means in 95 % intervals."]
    if quantity == "kills":
        random_players = json.loads(random_returns_file().read_text())
        first_notes.append(f"A random player kills {random_players['godot']['late_kills']:.1f} monsters.")
    panels, notes = [*curves.grid[0], updates_panel], [*first_notes, *curves.caption]
    return _save(folder, [replace(curves, grid=[panels], inches=PANEL_INCHES, caption=notes)])


def _search(name: str, world: str | None, pictures: Sequence[str] = ()) -> Draw:
    """Return what draws pictures of a published search; () is all of them."""

    def draw(folder: Path, index: RunIndex, study: str) -> list[Path]:
        return draw_search(read_published(index.store, load_search(name, world)), folder, ("png",), pictures)

    return draw


def _study(folder: Path, index: RunIndex, study: str, note: str = "") -> list[Path]:
    return _save(folder, study_pages(index, study, note))


def study_pages(index: RunIndex, study: str, note: str = "") -> list[Page]:
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
    if note:
        pages = [replace(page, caption=[note, *page.caption]) for page in pages]
    if all(fields.get("slots") == 1 for data in columns.values() for fields in data.fields.values()):
        pages = [replace(page, caption=[ONE_ENVIRONMENT, *page.caption]) for page in pages]
    return pages


def _title(world: str | None) -> str:
    return capital(WORLDS[world].title) if world else ""


def study_runs(
    index: RunIndex,
    study: str,
    world: str | None,
    preset: str | None = None,
    settings: Mapping[str, Any] | None = None,
) -> StudyData | None:
    """Return the published runs of a study's preset (default: paper) in a world; None if there are none."""
    query = Query(study, world, preset, settings=settings or {})
    try:
        return open_study(index, query)
    except UserError:
        return None


def _named(*conditions: str) -> Mapping[str, str]:
    """Return conditions under their own names."""
    return {condition: condition for condition in conditions}


def _in_world(world: str, study: str, names: Mapping[str, str]) -> Column:
    return Column(_title(world), study, names, world)


# --- The table of pictures ---------------------------------------------------------------------------

_BETAS = _named("stationary", "non-stationary")
_BETAS_WIDE = {"stationary-wide": "stationary", "non-stationary-wide": "non-stationary"}
_SIZES = _named("small", "mid", "big")
_ACTOR_SIZES = _named("small", "smallest", "small-critic", "big", "big-actor")
_ACTIVATIONS = _named("tanh", "relu", "leaky-relu")
_OWN_ACTIVATIONS = {"non-stationary": "tanh", "relu": "relu", "leaky-relu": "leaky-relu"}

PICTURES: Mapping[str, Sequence[Draw]] = {
    # the thesis's
    "architecture": [_curves("fig-6-2", THESIS_QUANTITIES, [
        *(_in_world(world, "architecture", _SIZES) for world in WORLDS),
        Column(
            "The arena, one environment", "architecture", _SIZES, "arena", "one-environment", {"slots": 1}
        ),
    ])],
    "actor-size": [_curves("fig-6-3", THESIS_QUANTITIES, [
        _in_world(world, "actor-size", _ACTOR_SIZES) for world in WORLDS
    ])],
    "optimizer": [
        _curves("fig-6-4", THESIS_QUANTITIES, [
            _in_world("text", "optimizer", _BETAS),
            Column("The published code's world, clip 0.1", OWN_GAME, _BETAS),
            Column("The published code's world, clip 0.2", OWN_GAME, _BETAS_WIDE),
            _in_world("arena", "optimizer", _BETAS),
        ]),
        _study,
    ],
    "activation": [_curves("fig-6-5", THESIS_QUANTITIES, [
        _in_world("text", "activation", _ACTIVATIONS),
        Column("The published code's world", OWN_GAME, _OWN_ACTIVATIONS),
        _in_world("arena", "activation", _ACTIVATIONS),
    ])],
    # others of curves
    OWN_GAME: [_curves(OWN_GAME, OWN_QUANTITIES, [
        Column("Clip range 0.1", OWN_GAME, _BETAS),
        Column("Clip range 0.2", OWN_GAME, {**_BETAS_WIDE, "l2-wide": "l2", "upgd-wide": "upgd"}),
    ])],
    "acrobot": [_curves("elsewhere", (), [
        Column("CartPole", "cartpole"),
        Column("Acrobot", "acrobot"),
        Column("Acrobot, rewards normalised", "acrobot", settings={"normalize_rewards": True}),
        Column("MinAtar's Breakout", "breakout"),
    ], "tanh or ReLU, and Adam's betas, in other environments")],
    "betas-by-clip": [_in_training],
    "betas-longer": [_in_training],
    # returns with XP that is never reset and with XP of the episode have other scales
    "xp-scope": [partial(_in_training, quantity="kills")],
    "xp-scope-longer": [partial(_in_training, quantity="kills")],
    # others
    "classes": [partial(_study, note="All classes are rewarded for kills.")],
    "noise-scale": [_noise],
    "search-ppo-arena": [_search("ppo", "arena")],
    "search-ppo-text": [_search("ppo", "text", ("values",))],
    "search-godot": [_search("godot", None, ("values",))],
    # none: another figure shows every condition, or a table or a sentence is enough
    "author-logs": [], "breakout": [], "cartpole": [], "collapse": [], "late-collapse": [],
    "published-logs": [], "robustness": [], "team": [], "three-updates": [],
}  # fmt: skip
"""What is drawn of a published study or search; of a study without a row, curves or its summary."""


if __name__ == "__main__":
    for drawn in draw_all(Path(sys.argv[1]) if sys.argv[1:] else FOLDER):
        print(f"wrote {drawn}")
