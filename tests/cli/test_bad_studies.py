"""Every key of a study's file misspelt in turn, and every value pushed out of what is allowed.

Each must be refused by the command line in one line, with exit code 2, that names the file, the line,
the key, the value, what is allowed and, for misspellings, the nearest right name; and nothing may be
written.
"""

from __future__ import annotations

import json
import os
import re
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import pytest
from typer.main import get_command

from pneuma import cli
from pneuma.cli import main
from pneuma.study.executors import local
from pneuma.study.spec import list_studies, load_study, studies_folder

from .bad_studies import MAXIMAL, WRONG, Place, header_places, misspellings, places

Captured = pytest.CaptureFixture[str]

COMMAND = get_command(cli.app)
"""The command line, set up once: Typer does that anew at each call otherwise."""

SHIPPED = {name: (studies_folder() / f"{name}.toml").read_text(encoding="utf-8") for name in list_studies()}


def _some(things: Sequence[str], place: Place, every: bool) -> Sequence[str]:
    """Return all things, or one of them: another at another place."""
    return things if every else [things[place.line % len(things)]]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty working directory, so that even the default results folder would be seen."""

    def refuse(groups: Iterable[object], *_: object) -> None:
        pytest.fail("training was started")

    monkeypatch.setattr(local, "run_groups", refuse)
    monkeypatch.setattr(cli, "app", COMMAND)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("PNEUMA_RESULTS", raising=False)
    return tmp_path


def _refusal(text: str, captured: Captured) -> str:
    """Run a study that must be refused; return its one line."""
    Path("mine.toml").write_text(text, encoding="utf-8")
    code = main(["study", "run", "mine.toml"])
    output = captured.readouterr()
    assert (code, output.out) == (2, ""), text
    (line,) = output.err.splitlines()
    assert os.listdir() == ["mine.toml"]
    return line


# --- The walk --------------------------------------------------------------------------------------


def _known(line: str) -> set[str]:
    return set(line.partition("known are ")[2].split(", "))


def test_the_maximal_study_is_right_and_has_every_key(here: Path, capsys: Captured) -> None:
    tables = {"title": {"run", "factors", "conditions", "presets"}, "gamma": set[str](), "seeds": set[str]()}
    known = set[str]()
    for key, more in tables.items():
        place = next(place for place in places(MAXIMAL) if place.key == key)
        known |= _known(_refusal(place.replaced(MAXIMAL, key="zzz"), capsys)) | more
    headers = {"run", "factors", "conditions", "presets"}
    assert {place.key for place in places(MAXIMAL)} | headers == known == set(WRONG)
    path = here / "mine.toml"
    path.write_text(MAXIMAL, encoding="utf-8")
    assert set(load_study(str(path)).conditions) == {
        *("adam", "sgd", "rmsprop", "slow", "useful", "trpo", "dqn", "table"),
    }


def _walk_keys(text: str, captured: Captured, every: bool) -> None:
    for place in (*places(text), *header_places(text)):
        for wrong in _some(misspellings(place.key), place, every):
            line = _refusal(place.replaced(text, key=wrong), captured)
            assert line.startswith(f"pneuma: mine.toml, line {place.line}: "), line
            for words in (f"{wrong!r}", f"did you mean {place.key}?", "known are"):
                assert words in line, (words, line)


def _walk_values(text: str, captured: Captured, every: bool) -> None:
    for place in places(text):
        values, allowed = WRONG[place.key]
        for value in _some(values, place, every):
            line = _refusal(place.replaced(text, value=value), captured)
            assert line.startswith(f"pneuma: mine.toml, line {place.line}: "), (value, line)
            given: Any = tomllib.loads(f"value = {value}")["value"]
            shown = json.dumps(given, default=str), repr(given)
            assert any(words in line for words in shown), (shown, line)
            for words in (place.key, *allowed):
                assert words in line, (words, line)


def test_every_key_misspelt_is_told_with_its_right_name(here: Path, capsys: Captured) -> None:
    _walk_keys(MAXIMAL, capsys, every=True)


def test_every_value_that_is_not_allowed_is_told_with_what_is(here: Path, capsys: Captured) -> None:
    _walk_values(MAXIMAL, capsys, every=True)


@pytest.mark.parametrize("study", SHIPPED)
def test_a_shipped_study_with_any_key_or_value_wrong_is_refused(
    study: str, here: Path, capsys: Captured
) -> None:
    _walk_keys(SHIPPED[study], capsys, every=False)
    _walk_values(SHIPPED[study], capsys, every=False)


@pytest.mark.slow
@pytest.mark.parametrize("study", SHIPPED)
def test_a_shipped_study_wrong_in_every_way_is_refused(study: str, here: Path, capsys: Captured) -> None:
    _walk_keys(SHIPPED[study], capsys, every=True)
    _walk_values(SHIPPED[study], capsys, every=True)


@pytest.mark.parametrize("table", ["run", "factors", "conditions", "presets"])
def test_a_value_in_place_of_a_table_is_told(table: str, here: Path, capsys: Captured) -> None:
    lines = MAXIMAL.splitlines()
    kept, inside = [], False
    for line in lines:
        inside = line.startswith(f"[{table}") if line.startswith("[") else inside
        kept += [] if inside else [line]
    for value in WRONG[table][0]:
        line = _refusal("\n".join([f"{table} = {value}", *kept]), capsys)
        assert line.startswith("pneuma: mine.toml, line 1: ")
        assert f"{table} must be a table, not {value}" in line


MISSPELT_NAMES = {
    "env": ("pneuma/Pneuma-v1", "pneuma/Pneuma-v0"),
    "level": ("thesi", "thesis"),
    "classes": ("bse", "base"),
    "weapons": ("swrod", "sword"),
    "reward": ("kils", "kills"),
    "observation": ("thesi", "thesis"),
    "order": ("neerest", "nearest"),
    "start": ("radnom", "random"),
    "coast": ("deadley", "deadly"),
    "kill_credit": ("strikr", "striker"),
    "xp_scope": ("epsiode", "episode"),
    "time_limit": ("trunctate", "truncate"),
    "algorithm": ("pppo", "ppo"),
    "activation": ("leakyrelu", "leaky-relu"),
    "clip": ("jiont", "joint"),
    "optimizer": ("rmspro", "rmsprop"),
    "base": ("table-6-22", "table-6-2"),
    "baseline": ("adamm", "adam"),
}


@pytest.mark.parametrize("key", MISSPELT_NAMES)
def test_a_misspelt_value_is_told_with_the_nearest_name(key: str, here: Path, capsys: Captured) -> None:
    wrong, right = MISSPELT_NAMES[key]
    place = next(place for place in places(MAXIMAL) if place.key == key)
    line = _refusal(place.replaced(MAXIMAL, value=f'"{wrong}"'), capsys)
    assert f"line {place.line}: " in line
    assert wrong in line and f"did you mean {right}?" in line


# --- Values that are wrong only together -----------------------------------------------------------


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("minibatch", "129", ("minibatch = 129", "128")),  # 32 steps x 2 slots x 2 players
        ("horizon", "3", ("horizon = 3", "minibatch = 16", "12")),
        ("players", "3", ("classes has 2 names for 3 players",)),
        ("random_levels", "2", ("random_levels = 2", "only random levels")),
        ("perceive", '"kind:raccon"', ('perceive = "kind:raccon"', "unknown kind of monster")),
    ],
)
def test_values_that_do_not_go_together_are_told_at_one_of_them(
    key: str, value: str, words: tuple[str, ...], here: Path, capsys: Captured
) -> None:
    place = next(place for place in places(MAXIMAL) if place.key == key)
    line = _refusal(place.replaced(MAXIMAL, value=value), capsys)
    found = re.search(r"line (\d+): \[run\]", line)
    assert found and MAXIMAL.splitlines()[int(found[1]) - 1].split()[0] in line
    for word in words:
        assert word in line
