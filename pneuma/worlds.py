"""The worlds in which a study or a search can run.

A name that ends in `-WORLD` stands for the study or search of that name in that world; without an ending
it stands for the usual one, which is the text's but where a study's file lists others alone, or sets the
arena's environment.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from pneuma.errors import UserError, unknown_name


@dataclass(frozen=True)
class World:
    """A world in which studies run.

    Attributes:
        env: the environment of its runs.
        title: as in "In the arena".
        overrides: fields that its runs have instead of the base's, where the study sets none itself.
    """

    env: str
    title: str
    overrides: Mapping[str, Any] = field(default_factory=dict)


TEXT = "text"
"""The usual world: a study's file unchanged, whichever environment it sets."""

WORLDS = {
    TEXT: World("pneuma/Pneuma-v0", "the text's world"),
    # the published code, where it sets other values than the thesis's tables
    "godot": World(
        "pneuma/PneumaGodot-v0", "the published code's world", {"clip_range": 0.2, "actor": (256,)}
    ),
    "arena": World("pneuma/PneumaArena-v0", "the arena"),
}


def world_fields(world: str, set_by_study: Collection[str]) -> dict[str, Any]:
    """Return the fields that a world sets, except those that the study or search sets itself."""
    if world == TEXT:
        return {}
    row = WORLDS[world]
    return {"env": row.env, **{key: value for key, value in row.overrides.items() if key not in set_by_study}}


def in_world(name: str, world: str) -> str:
    """Return the name of a study, record or figure in a world."""
    return name if world == TEXT or name.endswith(f"-{world}") else f"{name}-{world}"


def split_world(name: str) -> tuple[str, str]:
    """Return a study's own name, and its world."""
    for world in WORLDS:
        if world != TEXT and name.endswith(f"-{world}"):
            return name.removesuffix(f"-{world}"), world
    return name, TEXT


def chosen_world(name: str, world: str | None) -> tuple[str, str | None]:
    """Return a study's own name, and the world chosen by it or by --world, if any.

    Raises:
        UserError: for an unknown world, or where they stand for two.
    """
    if world is not None and world not in WORLDS:
        raise UserError(f"--world {world}: {unknown_name('world', world, WORLDS)}")
    study, named = split_world(name)
    if named != TEXT and world not in (None, named):
        raise UserError(f"--world {world}: the name {name} stands for the world {named}")
    return study, world or (None if named == TEXT else named)


def world_option(world: str) -> list[str]:
    """Return the command-line words that choose a world; none for the usual one."""
    return [] if world == TEXT else ["--world", world]
