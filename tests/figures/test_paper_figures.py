"""All that `make figures` draws of published studies, without their runs."""

from __future__ import annotations

from pathlib import Path

import pytest
from matplotlib.figure import Figure
from PIL import Image

from pneuma.config import make_run
from pneuma.figures.origin import origin_text
from pneuma.figures.style import save_figure
from pneuma.presets import WORLDS
from pneuma.store.published import encode_published
from pneuma.store.row_builder import stored_row
from pneuma.store.store import Store
from pneuma.study.plan import configure
from pneuma.study.spec import load_study
from tools import figures

from ..analysis.claim_files import save_run
from ..analysis.published_runs import publish
from .hand_made import HandMade

SETTINGS = "table-6-1-and-6-2.md"


@pytest.fixture(autouse=True)
def little_to_draw(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the environment's own figures, which tests of theirs draw; one process has the rest."""
    monkeypatch.setattr(figures, "FOLDER", tmp_path / "paper")
    monkeypatch.setattr(figures, "available_cores", lambda: 1)
    monkeypatch.setattr(figures, "_draw_environment", lambda folder: [])


@pytest.fixture
def published(tmp_path: Path) -> Path:
    """A results folder with two published tables alone: of a shipped study, and of one without a file."""
    study = HandMade(tmp_path, WORLDS["arena"].env)
    for condition, seed in (("tanh", 0), ("tanh", 1), ("relu", 0), ("relu", 1)):
        study.add(condition, seed)
    fresh, trained = Store(tmp_path / "fresh"), Store(tmp_path / "trained")
    publish(study.data, fresh)
    conditions = configure(load_study("activation"), {}, ("tanh", "relu")).runs
    for run in conditions.values():
        for seed in (300, 301):  # of the preset paper
            save_run(trained, make_run({**vars(run), "steps": 1_000_448, "seed": seed}), 0.5)
    rows = [stored_row(trained, name) for name in trained.runs()]
    about = {"study": "activation", "world": "arena", "settings": {}}
    fresh.write(fresh.published_path("activation-arena"), encode_published(rows, about))
    return fresh.root


def test_every_table_is_drawn_and_traced_to_its_runs(published: Path, tmp_path: Path) -> None:
    folder = tmp_path / "paper"
    written = figures.draw_all(folder, published)
    assert {*written} == {path for path in folder.rglob("*") if path.is_file()}
    assert {path.stem for path in written if path.suffix == ".png"} == {"fig-6-5", "mine", "verdicts"}
    assert _runs(folder / "mine.png") == ["mine, tanh, seeds 0..1", "mine, relu, seeds 0..1"]
    of_activation = ["activation, tanh, seeds 300..301", "activation, relu, seeds 300..301"]
    assert _runs(folder / "fig-6-5.png") == of_activation


def test_runs_that_were_known_are_not_drawn_beside_fresh_ones(tmp_path: Path) -> None:
    study = HandMade(tmp_path)
    for condition, seed in (("tanh", 300), ("relu", 300), ("leaky-relu", 100)):
        study.add(condition, seed)
    data = figures._fresh(study.data, ("tanh", "relu", "leaky-relu"))
    assert data is not None and {*data.runs["condition"]} == {"tanh", "relu"}


def test_captions_say_that_runs_had_one_environment(published: Path) -> None:
    (page,) = figures.study_pages(figures._published(published), "mine")
    assert page.caption[0] == figures.ONE_ENVIRONMENT


def _runs(path: Path) -> list[str]:
    """Return the lines on runs in a figure's origin, without ids."""
    with Image.open(path) as image:
        _, *lines = image.info["Description"].splitlines()
    return [line.partition(", ids")[0] for line in lines]


def test_what_is_drawn_no_more_is_removed_and_nothing_else(tmp_path: Path) -> None:
    folder = tmp_path / "paper"
    save_figure(Figure(), folder, "old", ("png",), origin_text("old"))
    for name in ("notes.txt", "other.png"):
        (folder / name).write_bytes(b"")
    figures.draw_all(folder, tmp_path / "results")
    left = {path.name for path in folder.rglob("*") if path.is_file()}
    assert left == {"notes.txt", "other.png", SETTINGS}
