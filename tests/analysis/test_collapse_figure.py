"""The figure of collapses: what its bars and lines are of."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from pneuma.analysis.run_index import open_study
from pneuma.figures import collapse, style
from pneuma.study.store import Store

from ..hand_made import collapse_record, healthy, learning, one_action, save_collapse


def test_bars_are_shares_of_runs_and_hollow_where_they_recovered(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two runs of tanh collapse, one of them for a while; of dqn no entropy is known, and one falls."""
    unknown, fallen = healthy(), learning()
    unknown[:, 0] = np.nan
    fallen[14:] = 0.1
    runs = {
        ("tanh", 0): (one_action(61), learning()),
        ("tanh", 1): (one_action(61, 80), learning()),
        ("tanh", 2): (healthy(), learning()),
        ("dqn", 0): (unknown, fallen),
        ("dqn", 1): (unknown, learning()),
    }
    store, ids = Store(tmp_path / "results"), {key: f"{place:016x}" for place, key in enumerate(runs)}
    for key, (updates, shares) in runs.items():
        save_collapse(store, ids[key], updates, shares)
    figures: list[Figure] = []
    monkeypatch.setattr(style, "save_figure", lambda figure, *_: figures.append(figure))
    collapse.draw_collapse(open_study(store, collapse_record(ids)), tmp_path, "collapse")
    panels = {axes.get_title(loc="left"): axes for axes in figures[0].axes}
    bars = [(bar.get_x(), bar.get_width()) for bar in panels["How often"].patches]  # type: ignore[attr-defined]
    full_tanh, hollow_tanh, full_dqn, hollow_dqn = bars
    assert full_tanh == pytest.approx((0, 2 / 3)) and hollow_tanh == pytest.approx((1 / 3, 1 / 3))
    assert full_dqn == pytest.approx((0, 1 / 2)) and hollow_dqn == pytest.approx((1 / 2, 0))
    lines = panels["Entropy (nats)"].get_lines()
    drawn = [line for line in lines if len(np.asarray(line.get_xdata())) > 2]
    assert len(drawn) == 2  # dqn's collapsed run has no entropy to draw
