"""A study whose records are written by hand, and what its figures say."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.text import Text

from pneuma.analysis.run_index import open_study
from pneuma.analysis.tables import StudyData
from pneuma.engines.records import EPISODE_COLUMNS, EVALUATION_COLUMNS, METRIC_COLUMNS
from pneuma.figures.curves import draw_study
from pneuma.study.store import Status, Store
from pneuma.study.tables import to_parquet

BUDGET = 1000


def make_id(condition: str, seed: int) -> str:
    """Return sixteen hexadecimal digits for a run."""
    return hashlib.sha256(f"{condition} {seed}".encode()).hexdigest()[:16]


class HandMade:
    """A results folder that is filled by hand, and the selection that it was recorded for."""

    def __init__(self, folder: Path) -> None:
        self.store = Store(folder / "results")
        self.record: dict[str, Any] = {
            "study": "mine",
            "title": "Mine",
            "figure": "fig-mine",
            "same": [],
            "runs": [],
        }

    def add(
        self,
        condition: str,
        seed: int,
        episodes: int = 20,
        evaluations: Sequence[float] = (0.1, 0.2, 0.3, 0.4),
        status: str = "done",
        run_id: str = "",
        steps: int = BUDGET,
        returns: float = 1.0,
        hunter: float = 0.5,
        random: float = 0.04,
    ) -> None:
        """Store a run that finished an episode every 50 steps and was evaluated every 250."""
        run_id = run_id or make_id(condition, seed)
        settings = {"steps": steps, "slots": 1, "env": "pneuma/Pneuma-v0"}
        self.record["runs"].append({"condition": condition, "seed": seed, "run_id": run_id, "run": settings})
        files = {
            "episodes.parquet": to_parquet(
                [_episode(k, seed, returns) for k in range(episodes)], EPISODE_COLUMNS
            ),
            "evaluations.parquet": to_parquet(
                [_evaluation(k, share, hunter, random) for k, share in enumerate(evaluations)],
                EVALUATION_COLUMNS,
            ),
        }
        files["provenance.json"] = b"{}"
        files["metrics.parquet"] = to_parquet([_update(k, seed) for k in range(20)], METRIC_COLUMNS)
        self.store.save_run(run_id, Status(status, steps), files)

    @property
    def data(self) -> StudyData:
        return open_study(self.store, self.record)

    def draw(self, folder: Path, **options: Any) -> list[Path]:
        return draw_study(self.data, folder, **{"formats": ("svg",), **options})


def _update(k: int, seed: int) -> dict[str, Any]:
    """Return an update whose gradient norm goes through the powers of ten."""
    return {**dict.fromkeys(METRIC_COLUMNS, 0.5), "step": 50 * (k + 1), "grad_norm": 10.0 ** (k % 4 + seed)}


def _episode(k: int, seed: int, returns: float) -> dict[str, Any]:
    gained = returns * (k + seed)
    row = {"slot": 0, "episode": k, "step": 50 * (k + 1), "return": gained, "length": 50}
    return {**row, "kills": 1, "hp": 0.0, "ending": "killed"}


def _evaluation(k: int, share: float, hunter: float, random: float) -> dict[str, Any]:
    return {
        **dict.fromkeys(EVALUATION_COLUMNS, 0.5),
        "step": 250 * (k + 1),
        "episodes": 50,
        "argmax_starts": 6,
        "share_killed": share,
        "random_share_killed": random,
        "hunter_share_killed": hunter,
    }


def legend(figure: Figure) -> list[str]:
    """Return the entries of a figure's legend."""
    (legend,) = figure.legends
    return [text.get_text() for text in legend.get_texts()]


def words(figure: Figure) -> str:
    """Return all texts of a figure, one after the other."""
    texts = (text.get_text() for text in figure.findobj(Text) if isinstance(text, Text))
    return " ".join(" ".join(texts).split())
