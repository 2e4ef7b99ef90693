"""The fields of an environment, their types, and the values that each shipped environment sets.

`pneuma.config` builds a run's configuration on it; like that module it imports nothing heavy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Interval, MinLen

from pneuma.errors import UserError, unknown_name
from pneuma.field_types import MOST_NAMES, OneOf, declare, matching, names_like

SHIPPED_LEVELS = ("thesis",)
RANDOM = "random:"
"""What names of random levels begin with."""
SHIPPED_CHARACTERS = ("pygame",)
REWARDS = ("thesis", "pygame", "godot", "kills", "distance-sigmoid")
OBSERVATIONS = ("thesis", "pygame", "godot")
ORDERS = ("nearest", "fixed")
SCALES = ("unit", "map", "raw")
ACTION_NAMES = ("down", "left", "up", "right", "attack")
SPELL_NAMES = ("flame", "heal")
POPULATION_NAMES = ("bamboo", "mixed")
MAX_PLAYERS = MOST_NAMES
MAX_STEPS = 1_000_000
"""Most agent steps of an episode."""
PERCEIVE_FORMS = "all, nearest:K for the K nearest, or rays:N, 1 to 64"


_PERCEIVE = r"|all|nearest:[1-9]\d*|rays:([1-9]|[1-5]\d|6[0-4])"
MODULE = r"(.+/)?\w+\.py|[A-Za-z_]\w*(\.\w+)*"
"""The form of a module: the path of its file, or its name."""
_REWARD = rf"{'|'.join(REWARDS)}|({MODULE}):\w+"
_REWARD_ALLOWED = f"one of {', '.join(REWARDS)}, or module:function"


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """The fields of one environment; each is a keyword of `gymnasium.make` and a key of a study.

    The defaults are those of `pneuma/Pneuma-v0`, the environment of the thesis's text; empty texts are filled
    by `make_env_config`. The docstring of `pneuma.env.gym.PneumaEnv` explains each.
    """

    level: Annotated[str, MinLen(1)] = declare("thesis", paces=True)
    random_levels: Annotated[int, Interval(ge=1, le=10_000)] = declare(1, paces=True)
    monsters: Annotated[str, OneOf(POPULATION_NAMES)] = "bamboo"
    characters: str = ""
    players: Annotated[int, Interval(ge=1, le=MAX_PLAYERS)] = declare(1, paces=True)
    classes: Annotated[tuple[str, ...], names_like(r"[\w-]+", "a class, or a list of one a player")] = (
        declare(("base",), paces=True)
    )
    magic: bool = declare(False, paces=True)
    reward: Annotated[tuple[str, ...], names_like(_REWARD, _REWARD_ALLOWED, REWARDS)] = declare(
        ("thesis",), paces=True
    )
    shared_reward: bool = False
    observation: Annotated[str, OneOf(OBSERVATIONS)] = declare("thesis", paces=True)
    perceive: Annotated[str, matching(_PERCEIVE, PERCEIVE_FORMS)] = ""
    order: Annotated[str, OneOf(("", *ORDERS))] = ""
    scale: Annotated[str, OneOf(("", *SCALES))] = ""
    observe_facing: bool = False
    start: Annotated[str, OneOf(("random", "first"))] = "random"
    trees: Annotated[str, OneOf(("wall", "pass"))] = "wall"
    terrain_stops: Annotated[str, OneOf(("all", "players"))] = "all"
    attack_ticks: Annotated[int, Interval(ge=0, le=3600)] = 0
    blow: Annotated[str, OneOf(("attack", "entry"))] = "attack"
    kill_credit: Annotated[str, OneOf(("striker", "near"))] = "striker"
    xp_scope: Annotated[str, OneOf(("episode", "forever"))] = "episode"
    ending_cost: Annotated[float, Interval(ge=0, le=1000)] = 0.0
    episode_steps: Annotated[int, Interval(ge=1, le=MAX_STEPS)] = declare(1000, paces=True)
    time_limit: Annotated[str, OneOf(("truncate", "terminate"))] = "truncate"
    end_on_clear: bool = False


ENVIRONMENT_FIELDS: dict[str, dict[str, Any]] = {
    "pneuma/Pneuma-v0": {},
    "pneuma/PneumaGodot-v0": {
        "reward": "godot",
        "observation": "godot",
        "start": "first",
        "trees": "pass",
        "terrain_stops": "players",
        "kill_credit": "near",
        "xp_scope": "forever",
        "ending_cost": 1.0,
        "episode_steps": 7500,
        "time_limit": "terminate",
        "end_on_clear": True,
    },
    "pneuma/PneumaArena-v0": {"reward": "kills", "observe_facing": True},
}
"""What each environment sets other than the defaults: the published code's quirks for Godot's; for the arena
a reward for kills, and the facing observed."""

ENVIRONMENTS = tuple(ENVIRONMENT_FIELDS)

ENVIRONMENT_SLOTS = {"pneuma/PneumaGodot-v0": 4}
"""Slots of a study that does not set them."""

OBSERVATION_FIELDS = {
    "thesis": {"perceive": "all", "order": "nearest", "scale": "unit"},
    "pygame": {"perceive": "nearest:5", "order": "nearest", "scale": "map"},
    "godot": {"perceive": "all", "order": "fixed", "scale": "raw"},
}
"""What each layout perceives by default."""


# --- Resolving -----------------------------------------------------------------------------------


def make_env_config(settings: Mapping[str, object], env_id: str = ENVIRONMENTS[0]) -> EnvConfig:
    """Resolve the fields of an environment to a complete configuration."""
    if env_id not in ENVIRONMENT_FIELDS:
        raise unknown_name("environment", env_id, ENVIRONMENTS)
    field_values = read_fields(EnvConfig, with_environment(env_id, settings))
    return EnvConfig(**resolve_world(field_values))


def with_environment(env_id: str, settings: Mapping[str, object]) -> dict[str, Any]:
    """Return an environment's fields with the settings over them."""
    return {**ENVIRONMENT_FIELDS.get(env_id, {}), **settings}


PLAYER_FIELDS = ("classes", "reward")
"""Fields with one name, or one for each player."""


def resolve_world(field_values: Mapping[str, Any]) -> dict[str, Any]:
    """Fill in what an observation layout implies, and check fields that depend on each other."""
    resolved = dict(field_values)
    for field_name, implied in OBSERVATION_FIELDS[field_values.get("observation", "thesis")].items():
        resolved[field_name] = field_values.get(field_name) or implied
    players = field_values.get("players", 1)
    for field_name in PLAYER_FIELDS:
        names_by_player = resolved.get(field_name)
        if not names_by_player:
            continue
        if len(names_by_player) not in (1, players):
            problem = f"{field_name} has {len(names_by_player)} names for {players} players"
            raise UserError(f"{problem}: give one value, or one for each")
        if len(set(names_by_player)) == 1:
            resolved[field_name] = names_by_player[:1]
    if players == 1:
        resolved.pop("shared_reward", None)
    if not field_values.get("level", "").startswith(RANDOM):
        for field_name, only_value in (("random_levels", 1), ("monsters", "bamboo")):
            field_value = resolved.get(field_name, only_value)
            if field_value != only_value:
                raise UserError(
                    f"{field_name} = {field_value} is not allowed: it applies only to random levels"
                )
    return resolved


def is_own_level(level_name: str) -> bool:
    return bool(level_name) and level_name not in SHIPPED_LEVELS and not level_name.startswith(RANDOM)


def are_own_characters(characters_name: str) -> bool:
    return bool(characters_name) and characters_name not in SHIPPED_CHARACTERS


def is_own_reward(reward_name: str) -> bool:
    return ":" in reward_name


def read_fields(config_type: type[EnvConfig], values: Mapping[str, object]) -> dict[str, Any]:
    """Check fields of a configuration and return each in its final type."""
    return {field_name: read_field(config_type, field_name, value) for field_name, value in values.items()}


def read_field(config_type: type[EnvConfig], field_name: str, field_value: object) -> Any:
    from pneuma import schema  # pydantic: not for `import pneuma`

    return schema.read_field(config_type, field_name, field_value)
