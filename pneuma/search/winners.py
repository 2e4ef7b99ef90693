"""The winners of several searches as one study: each beside what it was tuned from, on seeds of none.

Whether one optimizer beats another can be told only where both were tuned alike; that is what searches with
the same trials, seeds and steps are for, and this study is where their winners meet.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import count, islice
from os.path import commonprefix
from typing import Any

from pneuma.config import EnvConfig, Run, as_settings, env_config, make_run
from pneuma.errors import UserError
from pneuma.search import promote
from pneuma.search.promote import (
    listed,
    own_settings,
    settings_lines,
    settings_that_count,
    toml_value,
    without,
)
from pneuma.search.record import refuse_unfinished
from pneuma.search.spec import Search
from pneuma.study.definition import join_settings
from pneuma.worlds import split_world

TUNED = "tuned"
SEEDS = 10


@dataclass(frozen=True)
class Winner:
    """A search as it was recorded, its record, and its best trial."""

    search: Search
    record: Mapping[str, Any]
    trial: Mapping[str, Any]


def find_winner(search: Search, record: Mapping[str, Any]) -> Winner:
    """Return a recorded search with its best trial.

    Raises:
        UserError: where there is no best one: it has not ended, no trial is complete, or there are several
            objectives.
    """
    if len(search.objectives) > 1:
        raise UserError(
            f"search {search.name}: has several objectives, and a front for a winner; promote a trial"
        )
    refuse_unfinished(record)
    return Winner(search, record, promote.winner(record, None))


def winners_study(winners: Sequence[Winner]) -> str:
    """Return a study file of several winners, each beside its search's base, with their lineage as comments.

    A condition is called as its search, without what all their names begin with; its tuned one beside it.

    Raises:
        UserError: where searches start from different bases, seek different things, or had different trials,
            seeds or steps.
    """
    names = _short_names([split_world(winner.search.name)[0] for winner in winners])
    _check_alike(winners, names)
    tables: dict[str, dict[str, Any]] = {}
    for name, winner in zip(names, winners, strict=True):
        fixed = winner.search.space.fixed
        tuned = {**fixed, **own_settings(winner.search, winner.trial)}
        tables[name] = settings_that_count(winner.search, fixed)
        tables[f"{name}-{TUNED}"] = settings_that_count(winner.search, tuned)
    shared = _shared([*tables.values()])
    lines = [
        "# Winners of searches, each beside what it was tuned from.",
        "#",
        *(line for name, winner in zip(names, winners, strict=True) for line in _lineage(name, winner)),
        "",
        f"title = {toml_value('Winners of ' + ', '.join(names))}",
        f"base = {toml_value(winners[0].search.space.base)}",
        f"baseline = {toml_value(names[0])}",
        'worlds = ["text"]',  # its environment stands in the tables below
        "",
        "[run]",
        *settings_lines(shared),
    ]
    for name, settings in tables.items():
        lines += ["", _table(name), *settings_lines(without(settings, shared))]
    lines += [
        "",
        "[presets.quick]",
        f"seeds = {_fresh_seeds(winners)}",
        f"steps = {winners[0].record['steps']}",
    ]
    return "\n".join(lines) + "\n"


def _check_alike(winners: Sequence[Winner], names: Sequence[str]) -> None:
    for name, winner in zip(names, winners, strict=True):
        if names.count(name) > 1 or f"{name}-{TUNED}" in names:
            raise UserError(
                f"search {winner.search.name}: two conditions would be called {name}; name each search once"
            )
    first = winners[0]
    for winner in winners[1:]:
        told = f"searches {first.search.name} and {winner.search.name}"
        if winner.search.space.base != first.search.space.base:
            bases = f"{first.search.space.base} and {winner.search.space.base}"
            raise UserError(f"{told} start from different bases, {bases}: no study has two")
        for what, one, other in (
            ("trials", len(first.record["trials"]), len(winner.record["trials"])),
            ("seeds", first.record["seeds"], winner.record["seeds"]),
            ("steps", first.record["steps"], winner.record["steps"]),
            ("objectives", _sought(first), _sought(winner)),
            ("worlds", first.search.world, winner.search.world),
            ("environments", _start(first).env, _start(winner).env),
            ("engines", _start(first).engine, _start(winner).engine),
        ):
            if one != other:
                raise UserError(f"{told} are not tuned alike: {what} {one} and {other}; run both the same")
        one_world, other_world = as_settings(_world(first)), as_settings(_world(winner))
        if unlike := [key for key, value in one_world.items() if other_world[key] != value]:
            raise UserError(f"{told} are not tuned alike: {', '.join(unlike)} differ; run both the same")


def _start(winner: Winner) -> Run:
    """Return the run that a winner was tuned from."""
    space = winner.search.space
    return make_run(join_settings(space.base, space.fixed))


def _world(winner: Winner) -> EnvConfig:
    """Return that run's world, but for what the search varied of it."""
    searched = {key: None for parameter in winner.search.space.parameters for key in parameter.keys}
    usual = EnvConfig()
    world = env_config(_start(winner))
    return replace(world, **{key: getattr(usual, key) for key in searched if hasattr(usual, key)})


def _sought(winner: Winner) -> str:
    objectives = winner.record["identity"]["objectives"]
    return ", ".join(f"{own['direction']} {own['over_seeds']} {own['outcome']}" for own in objectives)


def _fresh_seeds(winners: Sequence[Winner]) -> int | list[int]:
    """Return how many seeds, from 0 on, no search has seen, or the first of these where it has seen some."""
    seen = {seed for winner in winners for seed in winner.record["seeds"]}
    fresh = list(islice((seed for seed in count() if seed not in seen), SEEDS))
    return SEEDS if fresh[-1] == SEEDS - 1 else fresh


def _shared(settings: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the settings that all have alike."""
    return {
        key: value
        for key, value in settings[0].items()
        if all(key in own and own[key] == value for own in settings)
    }


def _short_names(names: Sequence[str]) -> list[str]:
    """Return names without what all begin with, up to a hyphen."""
    start = commonprefix(list(names)).rpartition("-")
    cut = len(start[0]) + 1 if start[1] and len(names) > 1 else 0
    return [name[cut:] for name in names]


def _lineage(name: str, winner: Winner) -> list[str]:
    record, trial = winner.record, winner.trial
    count, seeds = len(record["trials"]), listed(record["seeds"])
    return [
        f"# {name}: trial {trial['number']} of search {winner.search.name} ({record['digest']}), "
        f"which came to {trial['value']}",
        f"# there: {count} trials on seeds {seeds}, {record['steps']} steps a run.",
    ]


def _table(name: str) -> str:
    return f"[conditions.{name if re.fullmatch(r'[A-Za-z0-9_-]+', name) else toml_value(name)}]"
