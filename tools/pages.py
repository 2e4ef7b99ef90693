"""Pages contain output of commands and parts of docstrings. `make figures` updates it; a test compares it.

    <!-- pneuma study verify --format markdown -->

    the command's output

    <!-- end -->
    <!-- docstring pneuma.env.gym.PneumaEnv Actions -->

    the docstring's text under this heading

    <!-- end -->

    python -m tools.pages

Commands read published tables alone, so that every clone prints the same.
"""

from __future__ import annotations

import io
import os
import re
import shlex
import shutil
import sys
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from functools import cache
from inspect import getdoc
from pathlib import Path
from pydoc import locate
from tempfile import TemporaryDirectory
from unittest.mock import patch

from pneuma.cli import main
from pneuma.errors import UserError
from pneuma.store.store import PUBLISHED
from pneuma.study.shipped import shipped_tables

ROOT = Path(__file__).parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
TABLES = (ROOT / "paper_figures/tables/own-game.md",)
"""Tables that pages link to."""
READING = (
    "study list", "study show", "study summary", "study compare", "study collapse",
    "study verify", "env list",
)  # fmt: skip
"""Commands that print the same wherever they run."""
WRITING = ("--out", "--trust", "--results")
"""Their options that write, train, run a user's code, or read other results."""
_BEGIN = re.compile(r"^<!-- (?:pneuma|docstring) ", re.MULTILINE)
_BLOCK = re.compile(
    r"^<!-- ((?:pneuma|docstring) [^\n]+) -->\n(?:(?!^<!-- (?:pneuma|docstring) ).)*?^<!-- end -->$",
    re.MULTILINE | re.DOTALL,
)


def rewrite(pages: Sequence[Path] = (*PAGES, *TABLES)) -> list[Path]:
    """Write all blocks of pages again; return the pages that this changed."""
    changed = renewed(pages)
    for page, text in changed.items():
        page.write_text(text, encoding="utf-8")
    return [*changed]


def renewed(pages: Sequence[Path] = (*PAGES, *TABLES)) -> dict[Path, str]:
    """Return the new text of each page whose commands now print something else.

    Commands read a results folder of published tables without runs.

    Raises:
        UserError: for a block of an unknown command, or one that fails.
    """
    changed, output = {}, cache(_output)
    with TemporaryDirectory() as folder, patch.dict(os.environ, PNEUMA_RESULTS=folder):
        shutil.copytree(shipped_tables(), Path(folder, PUBLISHED))
        for page in pages:
            text = page.read_text(encoding="utf-8")
            if len(_BLOCK.findall(text)) < len(_BEGIN.findall(text)):
                raise UserError(f"{page}: a block has no line <!-- end -->")
            new = _BLOCK.sub(lambda block: f"<!-- {block[1]} -->\n\n{output(block[1])}\n<!-- end -->", text)
            if new != text:
                changed[page] = new
    return changed


def _output(block: str) -> str:
    kind, _, command = block.partition(" ")
    if kind == "docstring":
        return _section(*command.split(" ", 1))
    words = shlex.split(command)
    if " ".join(words[:2]) not in READING or any(word.partition("=")[0] in WRITING for word in words):
        raise UserError(f"<!-- pneuma {command} -->: pages hold what {', '.join(READING)} print")
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        code = main(words)
    if code:
        raise UserError(f"<!-- pneuma {command} -->: {err.getvalue().strip()}")
    return out.getvalue()


def _section(place: str, heading: str = "") -> str:
    """Return what a docstring has under a heading."""
    found = re.search(rf"^## {heading}\n+(.*?\n)\n*(?=## |Raises:)", getdoc(locate(place)) or "", re.M | re.S)
    if not found:
        raise UserError(f"<!-- docstring {place} {heading} -->: there is no such heading")
    return found[1]


if __name__ == "__main__":
    try:
        for page in rewrite():
            print(f"wrote {page.relative_to(ROOT)}")
    except (UserError, OSError) as error:
        sys.exit(f"pneuma: {error}")
