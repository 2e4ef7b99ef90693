"""A mistake in a file is one line: file, line, key, value, what is allowed and the nearest name."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import pytest
from pydantic import Field

from pneuma.config import make_run
from pneuma.errors import UserError, nearest_name, unknown_name
from pneuma.schema import Table, passes, read_model, read_toml


def _fruit(name: str) -> None:
    if name not in ("apple", "pear"):
        raise unknown_name("fruit", name, ("apple", "pear"))


class Inner(Table):
    share: Annotated[float, Field(gt=0, le=1)] = 1.0
    count: Annotated[int, Field(ge=2)] = 2
    sizes: Annotated[tuple[Annotated[int, Field(le=9)], ...], Field(min_length=1)] = (1,)
    fruit: Annotated[str, passes(_fruit)] = "pear"


class Outer(Table):
    title: str
    colour: Literal["red", "green"] = "red"
    inner: dict[str, Inner] = {}
    amounts: dict[Literal["quick", "paper"], int] = {}


def _read(folder: Path, text: str) -> Outer:
    path = folder / "mine.toml"
    path.write_text(text, encoding="utf-8")
    return read_model(Outer, read_toml(path))


def test_what_is_right_is_read(tmp_path: Path) -> None:
    read = _read(tmp_path, 'title = "t"\n[inner.a]\nshare = 1\ncount = 1e6\nsizes = [1, 2]\n')
    assert read.inner["a"] == Inner(share=1.0, count=1_000_000, sizes=(1, 2))


def test_whole_numbers_are_made_of_floats_but_for_code_of_others(tmp_path: Path) -> None:
    path = tmp_path / "mine.toml"
    path.write_text("steps = 1e6\n[run.env_kwargs]\ng = 2.0\nlarge = 1e25\ndeep = { x = [1.0, 2] }\n")
    text = repr(read_toml(path).data)
    env_kwargs = "'env_kwargs': {'g': 2.0, 'large': 1e+25, 'deep': {'x': (1.0, 2)}}"
    assert text == f"{{'steps': 1000000, 'run': {{{env_kwargs}}}}}"
    fields = {"env": "Mine-v0", "env_kwargs": {"g": np.float64(2), "n": np.int64(2)}}
    assert make_run(fields).env_kwargs == '{"g": 2.0, "n": 2}'


def test_values_that_are_nested_too_deep_are_refused_in_python_too() -> None:
    nested: dict[str, object] = {}
    for _ in range(60):
        nested = {"a": nested}
    with pytest.raises(UserError, match="nested more than 50 deep"):
        make_run({"env": "Mine-v0", "env_kwargs": nested})


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("", "", "the key 'title' is missing"),
        ("color = 3", ", line 2", "unknown key 'color' (did you mean colour?); known are "),
        ('colour = "gren"', ", line 2", 'colour = "gren" is not allowed (did you mean green?)'),
        ("inner = 3", ", line 2", "inner must be a table, not 3"),
        ("[inner.a]\nshare = 2.5", ", line 3", "[inner.a] share = 2.5 is not allowed: must be at most 1"),
        ("[inner.a]\ncount = true", ", line 3", "[inner.a] count = true is not allowed: must be a whole"),
        ("[inner.a]\nsizes = [3, 10]", ", line 3", "[inner.a] sizes = [3, 10] is not allowed: "),
        ('[inner.a]\nfruit = "aple"', ", line 3", "[inner.a] fruit: unknown fruit 'aple' ("),
        ("[amounts]\nquik = 1", ", line 3", "[amounts] unknown key 'quik' (did you mean q"),
        ("colour = ", "", "not TOML: "),
    ],
)
def test_a_mistake_has_a_message_with_its_line(tmp_path: Path, text: str, line: str, message: str) -> None:
    with pytest.raises(UserError) as caught:
        _read(tmp_path, f'title = "t"\n{text}' if text else "")
    assert str(caught.value).startswith(f"{tmp_path / 'mine.toml'}{line}: {message}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ('a = """\nx\nb = 5 # 12"\n', 1),
        ("# it's\na = 'x\nb = \"its\"\n", 2),
        ("a = \"it's\"\nb = '''\nc = 'y\n", 2),
        ('a = "x\\"\nb = "y"\n', 1),
        ('a = """\n\\"""\n"""\nb = ""\nc = ["x, 1]\n', 5),
        ('a = """"x"""""\nb = "x', 2),
        ("a = 1\nb = 'x\nc = 'y'\n", 2),
        ('a = 1\nb = """\nc = 2 \\', 2),
    ],
)
def test_the_line_of_a_text_that_is_not_closed_is_named(tmp_path: Path, text: str, line: int) -> None:
    """Quotes in comments and in other texts open nothing."""
    (tmp_path / "x.toml").write_text(text)
    with pytest.raises(UserError, match=f"; the text that line {line} opens is not closed$"):
        read_toml(tmp_path / "x.toml")


def test_a_line_is_found_behind_a_text_of_several_lines(tmp_path: Path) -> None:
    with pytest.raises(UserError, match="line 5: "):
        _read(tmp_path, 'title = """\ncolour = "blue"\n[inner]\n"""\ncolour = "blue"\n')


@pytest.mark.parametrize(
    ("typed", "names", "suggestion"),
    [
        ("activaton", ["search", "activation"], "activation"),
        ("Activation", ["search", "activation"], "activation"),
        ("final", ["finality", "final-hp", "final"], "final"),
        ("lr", ["clip", "learning_rate"], "learning_rate"),  # by meaning
        ("reward", ["length", "return"], "return"),
        ("fin", ["final-share-killed"], ""),  # as well of finish, or of a fin
        ("reward", ["auc-return", "final-return"], "final-return"),
        ("share_killed", ["auc-share-killed", "final-share-killed"], "final-share-killed"),
        ("xyz", ["search", "activation"], ""),
    ],
)
def test_a_near_name_is_suggested(typed: str, names: list[str], suggestion: str) -> None:
    assert nearest_name(typed, names) == (f" (did you mean {suggestion}?)" if suggestion else "")


MANY = ".a" * 16_000
USUAL = f'about = "{"x" * 900_000}"\nshort{".a" * 40} = 1\nend = "{"." * 10_000}"'


@pytest.mark.parametrize("text", [f"a{MANY} = 1", f"[a{MANY}]", f"x = {{ a{MANY} = 1 }}", f'"b"{MANY} = 1'])
def test_untrusted_a_key_of_endless_names_is_refused_at_once(tmp_path: Path, text: str) -> None:
    """Python's parser takes a second for 16,000 of them, and half an hour for a megabyte."""
    path, started = tmp_path / "x.toml", time.process_time()
    path.write_text(text)
    with pytest.raises(UserError, match="x.toml: not TOML: 100 names or more are joined by dots"):
        read_toml(path)
    path.write_text(USUAL)
    assert read_toml(path).data["end"] == "." * 10_000
    assert time.process_time() - started < 0.5


def test_untrusted_a_number_that_no_message_could_print_is_refused(tmp_path: Path) -> None:
    """Python prints whole numbers of at most 4,300 digits, but reads longer ones in base 16."""
    path = tmp_path / "x.toml"
    path.write_text(f"steps = 0x{'f' * 4_000}")
    with pytest.raises(UserError, match="x.toml: not TOML: a whole number is beyond 1e308"):
        read_toml(path)
    path.write_text("steps = 1e308")
    assert read_toml(path).data["steps"] == int(1e308)
