"""Pages hold what commands print and docstrings say. `make figures` writes it anew, and a test compares it.

    <!-- pneuma study verify --format markdown -->

    the command's output

    <!-- end -->
    <!-- docstring pneuma.env.gym.PneumaEnv Actions -->

    what stands in the docstring under this heading

    <!-- end -->

    python -m tools.pages README.md docs/findings.md

Commands read published tables alone, so that every clone prints the same.
"""

from __future__ import annotations

import io
import os
import re
import shlex
import shutil
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from functools import cache, partial
from inspect import getdoc
from pathlib import Path
from pydoc import locate
from tempfile import TemporaryDirectory

from pneuma.cli import main
from pneuma.errors import UserError
from pneuma.study.store import PUBLISHED, shipped_tables

READING = (
    "study list", "study show", "study summary", "study compare", "study collapse", "study effects",
    "study robustness", "study verify", "env list",
)  # fmt: skip
"""Commands that print the same wherever they run."""
WRITING = ("--out", "--plot", "--fork", "--trust", "--results")
"""Their options that write, train, run a user's code, or read other results."""
RESULTS = "PNEUMA_RESULTS"
_BEGIN = re.compile(r"^<!-- (?:pneuma|docstring) ", re.MULTILINE)
_BLOCK = re.compile(
    r"^<!-- ((?:pneuma|docstring) [^\n]+) -->\n(?:(?!^<!-- (?:pneuma|docstring) ).)*?^<!-- end -->$",
    re.MULTILINE | re.DOTALL,
)


def rewrite(pages: Sequence[Path]) -> list[Path]:
    """Write all blocks of pages anew; return the pages that this changed.

    Raises:
        UserError: for a block of an unknown command, or one that fails.
    """
    changed = []
    for page, text in renewed(pages):
        if text != page.read_text(encoding="utf-8"):
            page.write_text(text, encoding="utf-8")
            changed.append(page)
    return changed


def renewed(pages: Sequence[Path]) -> Iterator[tuple[Path, str]]:
    """Yield the text of each page with what its commands print now."""
    with _published_alone():
        run = cache(_output)
        for page in pages:
            text = page.read_text(encoding="utf-8")
            if len(_BLOCK.findall(text)) < len(_BEGIN.findall(text)):
                raise UserError(f"{page}: a block has no line <!-- end -->")
            yield page, _BLOCK.sub(partial(_filled, run), text)


def _filled(run: Callable[[str], str], block: re.Match[str]) -> str:
    return f"<!-- {block[1]} -->\n\n{run(block[1])}\n<!-- end -->"


@contextmanager
def _published_alone() -> Iterator[None]:
    """Let commands read a results folder of published tables without runs."""
    with TemporaryDirectory() as folder:
        shutil.copytree(shipped_tables(), Path(folder, PUBLISHED))
        before = os.environ.get(RESULTS)
        os.environ[RESULTS] = folder
        try:
            yield
        finally:
            os.environ.pop(RESULTS)
            os.environ |= {RESULTS: before} if before else {}


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
        for name in rewrite([Path(name) for name in sys.argv[1:]]):
            print(f"wrote {name}")
    except (UserError, OSError) as error:
        sys.exit(f"pneuma: {error}")
