"""Whatever a user's own file is, its reader gives a value or one `UserError`, and waits for nothing."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from pneuma.analysis.claims import load_claims
from pneuma.env.characters import load_characters
from pneuma.env.level import load_level
from pneuma.errors import UserError
from pneuma.search.spec import load_search
from pneuma.study.spec import load_study

READERS: dict[str, Callable[[str], Any]] = {
    "study": load_study,
    "search": load_search,
    "claims": load_claims,
    "characters": load_characters,
    "level": lambda path: load_level(str(Path(path).parent), {}),
}


@pytest.mark.parametrize("kind", ["pipe", "device", "ring", "folder", "sparse"])
@pytest.mark.parametrize("reader", READERS)
def test_fuzz_what_is_no_ordinary_file_is_refused_at_once(tmp_path: Path, reader: str, kind: str) -> None:
    path = tmp_path / ("obstacles.csv" if reader == "level" else "mine.toml")
    match kind:
        case "pipe":
            os.mkfifo(path)
        case "device":
            path.symlink_to("/dev/zero")
        case "ring":
            path.symlink_to(path)
        case "folder":
            path.mkdir()
        case "sparse":
            path.touch()
            os.truncate(path, 2**38)
    with pytest.raises(UserError):
        READERS[reader](str(path))


@pytest.mark.parametrize("text", ["a." * 5000 + "a = 1", f"[{'a.' * 900}a]", f"a = {'[' * 5000}"])
@pytest.mark.parametrize("reader", [reader for reader in READERS if reader != "level"])
def test_fuzz_endless_nesting_is_refused(tmp_path: Path, reader: str, text: str) -> None:
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(UserError, match="mine.toml"):
        READERS[reader](str(tmp_path / "mine.toml"))
