"""A study whose records are written by hand, and what its figures say."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.text import Text

from pneuma.analysis.curves import find_curves
from pneuma.analysis.runs import open_study
from pneuma.analysis.study_data import StudyData
from pneuma.engines.records import METRIC_COLUMNS
from pneuma.figures.curves import curves_page
from pneuma.figures.grid import Page, save_page
from pneuma.store.index import RunIndex
from pneuma.store.store import Store
from pneuma.study.plan import Query

from ..hand_made import make_id, save_listing, save_run

BUDGET = 1000

_HALF = dict.fromkeys(METRIC_COLUMNS, 0.5)


class HandMade:
    """A results folder that is filled by hand, with a study called 'mine' that lists its runs."""

    def __init__(self, folder: Path, env: str = "pneuma/Pneuma-v0") -> None:
        self.store = Store(folder / "results")
        self.fields: dict[str, Any] = {"env": env}
        self.cells: dict[tuple[str, int], str] = {}

    def add(
        self,
        condition: str,
        seed: int,
        episodes: int = 20,
        evaluations: Sequence[float] = (0.1, 0.2, 0.3, 0.4),
        status: str = "done",
        run_id: str = "",
        random: float = 0.04,
        returned: float = float("nan"),
        actions: Sequence[float] = (),
        end: int = BUDGET,
    ) -> None:
        """Store a run that finished an episode every 50 steps and was evaluated every 250.

        `actions` are its shares of the most frequent action at evaluations, evenly over the budget.
        """
        self.cells[condition, seed] = run_id = run_id or make_id(condition, seed)
        save_listing(self.store, self.cells)
        rows = [{"episode": k, "step": 50 * (k + 1), "return": float(k + seed)} for k in range(episodes)]
        updates = [  # gradient norms go through the powers of ten
            {**_HALF, "step": 50 * (k + 1), "grad_norm": 10.0 ** (k % 4 + seed)} for k in range(20)
        ]
        levels = {"random_share_killed": random, "score": 0.5, "argmax_share_killed": 0.5}
        levels |= {"random_return": returned, "return": returned}
        evaluated = [
            {**levels, "step": 250 * (k + 1), "share_killed": share} for k, share in enumerate(evaluations)
        ]
        for number, share in enumerate(actions, 1):
            evaluated.append({**levels, "step": number * BUDGET // len(actions), "commonest_action": share})
        save_run(self.store, run_id, rows, updates, evaluated, end, status, self.fields)

    @property
    def data(self) -> StudyData:
        return open_study(RunIndex(self.store, shipped=False), Query(study="mine"))

    def page(self, *quantities: str, **how: Any) -> Page:
        return curves_page(find_curves({"": self.data}, quantities, **how))

    def draw(
        self, folder: Path, *quantities: str, formats: Sequence[str] = ("svg",), **how: Any
    ) -> list[Path]:
        return save_page(self.page(*quantities, **how), folder, formats)


def legend(figure: Figure) -> list[str]:
    """Return the entries of a figure's legend."""
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def words(figure: Figure) -> str:
    """Return all texts of a figure, one after the other."""
    texts = (text.get_text() for text in figure.findobj(Text) if isinstance(text, Text))
    return " ".join(" ".join(texts).split())
