"""Tables in LaTeX: each passes pdflatex. Needs `texlive-latex-base`."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from pneuma.cli import main

TABLES = {
    "thesis": ["study", "table", "table-6-2"],
    "summary": ["study", "summary", "activation"],
    "crossed": ["study", "summary", "robustness"],
    "comparison": ["study", "compare", "activation", "tanh", "relu"],
    "verdict": ["study", "verify", "betas-solve"],
}


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="pdflatex is not installed")
@pytest.mark.parametrize("name", TABLES)
def test_pdflatex_sets_a_table(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    where = [] if name == "thesis" else ["--results", "none"]
    assert main([*TABLES[name], "--format", "latex", *where]) == 0
    table = capsys.readouterr().out
    packages = r"\usepackage{booktabs}\usepackage{longtable}"
    page = rf"\documentclass{{article}}{packages}\begin{{document}}\noindent {table}\end{{document}}"
    (tmp_path / "page.tex").write_text(page)
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "page.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, errors="replace")
    assert done.returncode == 0, done.stdout
