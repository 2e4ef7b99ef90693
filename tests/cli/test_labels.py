"""Labels with mathematics in figures and LaTeX tables, where a column of numbers is right-aligned."""

from __future__ import annotations

from pathlib import Path

import pandas as pd
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from pneuma.analysis.export import encode_frame
from pneuma.figures.style import house_style, save_figure
from pneuma.store.store import Store

from ..analysis.claim_files import save_runs
from .calls import printed


def test_a_label_is_mathematics_in_a_latex_table_and_numbers_are_right_aligned(tmp_path: Path) -> None:
    names = [r"$\beta_2 = 0.9$", r"$\input{x_1}$", r"$\$_1", "$x$", "$a_$", "costs $5 and $6", "\ue000"]
    numbers = ["0.40 ± 0.20", "3", "–", "-1,234 [-1 to 2]", "0.3 (n = 2)", "12.5 %", "1e-05"]
    frame = pd.DataFrame({"condition": names, r"$\alpha^2$": numbers, "text": [*numbers[:6], "six"]})
    head, *rows = encode_frame(frame, "latex").decode().splitlines()[3:]
    assert encode_frame(frame, "latex").decode().splitlines()[1] == r"\begin{tabular}{lrl}"
    assert head == r"condition & $\alpha^2$ & text \\"
    assert rows[1].startswith(r"$\beta_2 = 0.9$ & 0.40 $\pm$ 0.20")
    cells = [row.partition(" & ")[0] for row in rows[2:8]]
    assert cells[0] == r"\$\textbackslash input\{x\_1\}\$"  # it would read a file
    assert not any(cell.replace(r"\$", "").count("$") for cell in cells)


def test_the_papers_table_has_the_labels_of_a_study(tmp_path: Path) -> None:
    save_runs(Store(tmp_path / "results"), tmp_path, {"high": [0.2, 0.4, 0.6], "middle": [0.2] * 3})
    path = tmp_path / "mine.toml"
    path.write_text(path.read_text() + "\n[labels]\nhigh = '$\\beta_2$'\n")
    words = (
        "study",
        "summary",
        path,
        "--world",
        "text",
        "--results",
        tmp_path / "results",
        "--format",
        "latex",
    )
    latex = printed(*words, "--outcome", "final-share-killed")
    assert r"$\beta_2$ & 3 & 0.40 $\pm$ 0.20 \\" in latex and "{lrr}" in latex


@pytest.mark.parametrize(
    ("text", "is_formula"),
    [
        (r"$\beta_2$ (5)", True), ("a\n$x^2$", True), ("$x$", False), ("costs $5 and $6", False),
        (r"$\nonsense_1$", False), ("$a_$", False), ("$a_1$ $b", False), ("$_" + "{" * 250 + "$", False),
    ],
)  # fmt: skip
def test_a_label_is_drawn_as_mathematics_where_it_parses(text: str, is_formula: bool, tmp_path: Path) -> None:
    with house_style():
        figure = Figure(figsize=(2, 1))
        figure.text(0.1, 0.5, text)
        save_figure(figure, tmp_path, "label", ["png", "svg", "pdf"], "origin")
    (label,) = figure.findobj(Text)
    assert isinstance(label, Text) and label.get_parse_math() == is_formula


def test_settings_that_differ_are_written_as_a_study_sets_them(tmp_path: Path) -> None:
    """Not as numbers of a column: no limit is none, and a whole number stays whole."""
    path = tmp_path / "mine.toml"
    path.write_text(
        """title = "Mine"
[conditions.free]
gradient_limit = "none"
minibatch = 32
[conditions.limited]
gradient_limit = 0.25
minibatch = 64
[presets.quick]
seeds = 1
steps = 2_048
"""
    )
    lines = printed("study", "show", path).splitlines()
    assert [line.split() for line in lines[3:6]] == [
        ["condition", "minibatch", "gradient_limit", "clip"],
        ["free", "32", "none", "none"],
        ["limited", "64", "0.25", "joint"],
    ]
