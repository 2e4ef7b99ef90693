"""The settings of an environment with their types, so that editors complete them.

settings: EnvSettings = {"episode_steps": 500, "magic": True}
gymnasium.make("pneuma/PneumaArena-v0", **settings)
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypedDict


class EnvSettings(TypedDict, total=False):
    """The fields of `pneuma.env.fields.EnvConfig`, which docs/environment.md explains."""

    level: str
    random_levels: int
    monsters: Literal["bamboo", "mixed"]
    characters: str
    players: int
    classes: str | Sequence[str]
    magic: bool
    reward: str | Sequence[str]
    shared_reward: bool
    observation: Literal["thesis", "pygame", "godot"]
    perceive: str
    order: Literal["", "nearest", "fixed"]
    scale: Literal["", "unit", "map", "raw"]
    observe_facing: bool
    start: Literal["random", "first"]
    trees: Literal["wall", "pass"]
    terrain_stops: Literal["all", "players"]
    attack_ticks: int
    blow: Literal["attack", "entry"]
    kill_credit: Literal["striker", "near"]
    xp_scope: Literal["episode", "forever"]
    ending_cost: float
    episode_steps: int
    time_limit: Literal["truncate", "terminate"]
    end_on_clear: bool
