"""What the tests of figures share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from matplotlib.figure import Figure

from pneuma.figures import style
from pneuma.figures.style import save_figure

from .hand_made import HandMade


@pytest.fixture
def figures(monkeypatch: pytest.MonkeyPatch) -> list[Figure]:
    """The figures that were about to be saved; they are saved all the same."""
    figures: list[Figure] = []

    def save(figure: Figure, *arguments: Any) -> list[Path]:
        figures.append(figure)
        return save_figure(figure, *arguments)

    monkeypatch.setattr(style, "save_figure", save)
    return figures


@pytest.fixture
def study(tmp_path: Path) -> HandMade:
    """Two conditions of two runs."""
    study = HandMade(tmp_path)
    for seed in (0, 1):
        study.add("tanh", seed)
        study.add("relu", seed, evaluations=(0.0, 0.1, 0.1, 0.2))
    return study
