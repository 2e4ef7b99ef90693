"""The fields of an environment, their types, and the values that each shipped environment sets.

`pneuma.config` builds a run's configuration on it; like that module it imports nothing heavy.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from annotated_types import Interval, MinLen

from pneuma.errors import UserError, unknown_name
from pneuma.values import MOST_NAMES, OneOf, Reads, matching, names_like

SHIPPED_LEVELS = ("thesis",)
SHIPPED_CHARACTERS = ("pygame",)
REWARDS = ("thesis", "pygame", "godot", "kills", "distance-sigmoid")
OBSERVATIONS = ("thesis", "pygame", "godot")
ORDERS = ("nearest", "fixed")
SCALES = ("unit", "map", "raw")
ACTION_NAMES = ("down", "left", "up", "right", "attack")
SPELL_NAMES = ("flame", "heal")
DASH = "dash"
WEAPON_NAMES = ("first_weapon", "second_weapon")
KINDS_OF_MONSTERS = ("bamboo", "mixed", "golems")
MAX_PLAYERS = MOST_NAMES
MOST_STEPS = 1_000_000
"""Most agent steps of an episode."""
PERCEIVE = "all, nearest:K for the K nearest, kind:NAME,… for monsters of some kinds, or rays:N, 1 to 64"


_PERCEIVE = r"|all|nearest:[1-9]\d*|kind:[\w-]+(,[\w-]+)*|rays:([1-9]|[1-5]\d|6[0-4])"
MODULE = r"(.+/)?\w+\.py|[A-Za-z_]\w*(\.\w+)*"
"""The form of a module: the path of its file, or its name."""
_REWARD = rf"{'|'.join(REWARDS)}|({MODULE}):\w+"
_REWARD_ALLOWED = f"one of {', '.join(REWARDS)}, or module:function"


def _read_codes(value: Any) -> tuple[int, ...]:
    codes = (value,) if type(value) is int else tuple(value)
    if not all(type(code) is int and 0 <= code < 2**28 for code in codes):
        raise ValueError
    return tuple(sorted({*codes}))


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """The fields of one environment; each is a keyword of `gymnasium.make` and a key of a study.

    `pneuma.env.gym.PneumaEnv` tells what each means. The defaults are those of `pneuma/Pneuma-v0`, the
    environment of the thesis's text; empty texts are filled by `make_env_config`.
    """

    level: Annotated[str, MinLen(1)] = "thesis"
    random_levels: Annotated[int, Interval(ge=1, le=10_000)] = 1
    monsters: Annotated[str, OneOf(KINDS_OF_MONSTERS)] = "bamboo"
    characters: str = ""
    players: Annotated[int, Interval(ge=1, le=MAX_PLAYERS)] = 1
    classes: Annotated[tuple[str, ...], names_like(r"[\w-]+", "a class, or a list of one a player")] = (
        "base",
    )
    weapons: Annotated[tuple[str, ...], names_like(r"[\w-]+", "a weapon, or a list of one a player")] = (
        "own",
    )
    second_weapon: Annotated[str, matching(r"|[\w-]+", "a weapon")] = ""
    magic: bool = False
    dash: bool = False
    tokens: Annotated[int, Interval(ge=0, le=8)] = 0
    reward: Annotated[tuple[str, ...], names_like(_REWARD, _REWARD_ALLOWED, REWARDS)] = ("thesis",)
    shared_reward: bool = False
    observation: Annotated[str, OneOf(OBSERVATIONS)] = "thesis"
    perceive: Annotated[str, matching(_PERCEIVE, PERCEIVE)] = ""
    order: Annotated[str, OneOf(("", *ORDERS))] = ""
    scale: Annotated[str, OneOf(("", *SCALES))] = ""
    observe_facing: bool = False
    start: Annotated[str, OneOf(("random", "first"))] = "random"
    bodies: Annotated[str, OneOf(("block", "pass"))] = "block"
    coast: Annotated[str, OneOf(("wall", "deadly"))] = "wall"
    trees: Annotated[str, OneOf(("wall", "pass"))] = "wall"
    terrain_stops: Annotated[str, OneOf(("all", "players"))] = "all"
    slow: Annotated[tuple[int, ...], Reads(_read_codes, "a list of codes of the ground, from 0")] = ()
    slow_factor: Annotated[float, Interval(gt=0, le=1)] = 0.5
    attack_ticks: Annotated[int, Interval(ge=0, le=3600)] = 0
    blow: Annotated[str, OneOf(("attack", "entry"))] = "attack"
    bite_while_knocked: bool = False
    healing_cap: bool = False
    kill_credit: Annotated[str, OneOf(("striker", "near"))] = "striker"
    xp_scope: Annotated[str, OneOf(("episode", "forever"))] = "episode"
    ending_cost: Annotated[float, Interval(ge=0, le=1000)] = 0.0
    episode_steps: Annotated[int, Interval(ge=1, le=MOST_STEPS)] = 1000
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
    "pneuma/PneumaEasy-v0": {
        "reward": "kills", "observe_facing": True, "perceive": "nearest:5", "classes": "tank",
    },
    "pneuma/PneumaHard-v0": {
        "reward": "kills", "observe_facing": True, "perceive": "rays:32", "level": "random:train:0",
        "random_levels": 200, "monsters": "mixed", "slow": (1,), "episode_steps": 300,
    },
}  # fmt: skip
"""What each environment sets other than the defaults: the published code's quirks for Godot's; for the arena
a reward for kills, and the facing observed; an easier and a harder task than the arena's."""

ENVIRONMENTS = tuple(ENVIRONMENT_FIELDS)

ENVIRONMENT_SLOTS = {"pneuma/PneumaGodot-v0": 4}
"""Slots of a study that does not set them."""

OBSERVATION_FIELDS = {
    "thesis": {"perceive": "all", "order": "nearest", "scale": "unit"},
    "pygame": {"perceive": "nearest:5", "order": "nearest", "scale": "map"},
    "godot": {"perceive": "all", "order": "fixed", "scale": "raw"},
}
"""What each layout perceives by default."""


def action_names(config: EnvConfig) -> tuple[str, ...]:
    """Return the names of a world's actions, in order."""
    names = ACTION_NAMES + (SPELL_NAMES if config.magic else ()) + ((DASH,) if config.dash else ())
    names += WEAPON_NAMES if config.second_weapon else ()
    return names + tuple(f"say_{token}" for token in range(1, config.tokens + 1))


# --- Resolving -----------------------------------------------------------------------------------


def make_env_config(given: Mapping[str, object], env: str = ENVIRONMENTS[0]) -> EnvConfig:
    """Resolve the fields of an environment to a complete configuration."""
    if env not in ENVIRONMENT_FIELDS:
        raise unknown_name("environment", env, ENVIRONMENTS)
    return EnvConfig(**resolve_world(read_fields(EnvConfig, with_environment(env, given))))


def with_environment(env: str, given: Mapping[str, object]) -> dict[str, Any]:
    """Return an environment's fields with given ones over them.

    Setting `level` drops the preset's `random_levels`, `monsters` and `slow`.
    """
    fields = ENVIRONMENT_FIELDS.get(env, {})
    left = ("random_levels", "monsters", "slow") if "level" in given else ()
    return {**{key: value for key, value in fields.items() if key not in left}, **given}


def with_layout(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields with those that their observation layout implies, where they leave them open."""
    layout = OBSERVATION_FIELDS[values.get("observation", "thesis")]
    return {**values, **{key: values.get(key) or implied for key, implied in layout.items()}}


OF_PLAYERS = ("classes", "weapons", "reward")
"""Fields with one name, or one for each player."""


def resolve_world(values: dict[str, Any]) -> dict[str, Any]:
    """Fill in what an observation layout implies, and check fields that depend on each other."""
    values = with_layout(values)
    players = values.get("players", 1)
    for key in OF_PLAYERS:
        if len(values.get(key, ("",))) not in (1, players):
            raise UserError(
                f"{key} has {len(values[key])} names for {players} players: give one, or one each"
            )
        if len(set(values.get(key, ()))) == 1:
            values[key] = values[key][:1]
    if players == 1:
        values.pop("shared_reward", None)
    if not values.get("slow"):
        values.pop("slow_factor", None)  # nothing reads it
    if values.get("random_levels", 1) > 1 and not is_random_level(values.get("level", "")):
        raise UserError(
            f"random_levels = {values['random_levels']} is not allowed: only random levels come in numbers"
        )
    if values.get("monsters", "bamboo") != "bamboo" and not is_random_level(values.get("level", "")):
        raise UserError(
            f"monsters = {values['monsters']} is not allowed: levels that are not random have their own"
        )
    return values


def is_own_level(name: str) -> bool:
    return bool(name) and name not in SHIPPED_LEVELS and not is_random_level(name)


def is_random_level(name: str) -> bool:
    return name.startswith("random:")


def are_own_characters(name: str) -> bool:
    return bool(name) and name not in SHIPPED_CHARACTERS


def own_rewards(names: Iterable[str]) -> list[str]:
    return [name for name in names if ":" in name]


def read_fields(config: type[EnvConfig], values: Mapping[str, object]) -> dict[str, Any]:
    """Check fields of a configuration and return each in its final type."""
    from pneuma.schema import read_dataclass_fields

    return read_dataclass_fields(config, values)


def read_field(config: type[EnvConfig], key: str, value: object) -> Any:
    """Check one field of a configuration; see `read_fields`."""
    return read_fields(config, {key: value})[key]
