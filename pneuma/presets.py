"""Named sets of fields: the bases that studies and searches start from, and the worlds that they run in."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

from pneuma.errors import unknown_name

_THESIS: dict[str, Any] = {
    "gamma": 0.99, "gae_lambda": 0.95, "learning_rate": 3e-4, "minibatch": 64, "entropy_coefficient": 0.01,
    "optimizer": "adam", "epsilon": 1e-5, "actor": (128,), "critic": (256,), "slots": 1, "clip": "joint",
}  # fmt: skip
BASES: dict[str, dict[str, Any]] = {
    "table-6-1": {
        **_THESIS, "clip_range": 0.2, "horizon": 2048, "epochs": 15, "value_coefficient": 1.0,
        "betas": (0.9, 0.999), "activation": "relu", "gradient_limit": None,
    },
    "table-6-2": {
        **_THESIS, "clip_range": 0.1, "horizon": 256, "epochs": 10, "value_coefficient": 0.5,
        "betas": (0.9, 0.9), "activation": "tanh", "gradient_limit": 0.5,
    },
}  # fmt: skip
"""Thesis Tables 6.1 and 6.2, completed from the text (sections 6.1 and 6.2)."""
NO_BASE = ""
"""The base of a file that names none: runs have their algorithm's defaults."""


@dataclass(frozen=True)
class World:
    """A world in which studies run."""

    env: str
    title: str  # as in "In the arena"
    overrides: Mapping[str, Any] = field(default_factory=dict)
    """Fields that its runs have instead of the base's, where the study sets none itself."""


TEXT, ARENA = "text", "arena"
"""The world that changes nothing in a study, with the thesis's reward as printed; and the default world."""

WORLDS = {
    TEXT: World("pneuma/Pneuma-v0", "the text's world"),
    # the published code, where it sets other values than the thesis's tables
    "godot": World(
        "pneuma/PneumaGodot-v0", "the published code's world", {"clip_range": 0.2, "actor": (256,)}
    ),
    ARENA: World("pneuma/PneumaArena-v0", "the arena"),
}


def world_fields(world: str, set_by_study: Collection[str]) -> dict[str, Any]:
    """Return the fields that a world sets, except those that the study or search sets itself."""
    if world == TEXT:
        return {}
    row = WORLDS[world]
    return {"env": row.env, **{key: value for key, value in row.overrides.items() if key not in set_by_study}}


def checked_world(world: str | None) -> str | None:
    if world is not None and world not in WORLDS:
        raise unknown_name("world", world, WORLDS)
    return world


def default_world(worlds: Collection[str]) -> str:
    """Return the default of some worlds: the arena, or else the first."""
    return ARENA if ARENA in worlds else next(iter(worlds))
