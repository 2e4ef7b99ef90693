"""The settings of one environment: typed, checked, and what each shipped environment sets.

`pneuma.config` builds a run's configuration on it; like that module it imports nothing heavy.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any, TypeVar

from pneuma.errors import UserError, nearest_name, unknown_name
from pneuma.values import MOST_NAMES, Choice, Flag, Matching, Names, Number, Reader, Text

SHIPPED_LEVELS = ("thesis",)
SHIPPED_CHARACTERS = ("pygame",)
REWARDS = ("thesis", "pygame", "godot", "kills", "distance-sigmoid")
OBSERVATIONS = ("thesis", "pygame", "godot")
ORDERS = ("nearest", "fixed")
SCALES = ("unit", "map", "raw")
ACTION_NAMES = ("down", "left", "up", "right", "attack")
SPELL_NAMES = ("flame", "heal")
MAX_PLAYERS = MOST_NAMES
MOST_STEPS = 1_000_000
"""Agent steps that an episode may last."""
PERCEIVE = "all, nearest:K for the K nearest, or kind:NAME,… for monsters of some kinds"


def setting(default: Any, reader: Reader) -> Any:
    """Declare a field of a configuration with what its value may be."""
    return field(default=default, metadata={"reader": reader})


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """The settings of one environment; each is a keyword of `gymnasium.make` and a key of a study.

    The defaults are those of `pneuma/Pneuma-v0`, the environment of the thesis's text; empty texts are
    filled by `make_env_config`.
    """

    level: str = setting("thesis", Text())
    """A shipped level, a folder of CSV layers, a .tmx map, or random:train:N or random:test:N."""
    random_levels: int = setting(1, Number(1, 10_000, whole=True))
    """How many random levels, from number N on; each episode draws one."""
    characters: str = setting("", Text(empty=True))
    """A file whose classes, weapons, spells and monsters override the shipped ones; or pygame."""
    players: int = setting(1, Number(1, MAX_PLAYERS, whole=True))
    classes: tuple[str, ...] = setting(("base",), Names(r"[\w-]+", "a class, or a list of one a player"))
    weapons: tuple[str, ...] = setting(("own",), Names(r"[\w-]+", "a weapon, or a list of one a player"))
    magic: bool = setting(False, Flag())
    """Whether there are two more actions, flame and heal, paid from energy (thesis section 5.2)."""
    reward: tuple[str, ...] = setting(
        ("thesis",),
        Names(
            rf"{'|'.join(REWARDS)}|[\w.]+:\w+", f"one of {', '.join(REWARDS)}, or module:function", REWARDS
        ),
    )
    """A formula, or a list of one a player."""
    observation: str = setting("thesis", Choice(OBSERVATIONS))
    """Layout: of the thesis's text, of its PyGame version or of its Godot version."""
    perceive: str = setting("", Matching(r"|all|nearest:[1-9]\d*|kind:[\w-]+(,[\w-]+)*", PERCEIVE))
    order: str = setting("", Choice(("", *ORDERS)))
    scale: str = setting("", Choice(("", *SCALES)))
    """unit: distances in notice radii; map: over the map's size; raw: pixels and points."""
    observe_facing: bool = setting(False, Flag())
    """Whether four numbers, one of them 1, follow on what a player observes of itself."""
    start: str = setting("random", Choice(("random", "first")))
    bodies: str = setting("block", Choice(("block", "pass")))
    """Whether living bodies stop each other."""
    coast: str = setting("wall", Choice(("wall", "deadly")))
    trees: str = setting("wall", Choice(("wall", "pass")))
    """Whether what stands in the layer of obstacles stops anybody."""
    terrain_stops: str = setting("all", Choice(("all", "players")))
    bite_while_knocked: bool = setting(False, Flag())
    healing_cap: bool = setting(False, Flag())
    """Whether the HP of a kill stop at full HP."""
    kill_credit: str = setting("striker", Choice(("striker", "near")))
    """Who earns a kill's XP and HP: its striker, or all within the dying monster's attack circle."""
    xp_scope: str = setting("episode", Choice(("episode", "forever")))
    ending_cost: float = setting(0.0, Number(0, 1000))
    """XP lost when an episode ends otherwise than at sea."""
    episode_steps: int = setting(1000, Number(1, MOST_STEPS, whole=True))
    """Time limit of an episode in agent steps of 8 ticks."""
    time_limit: str = setting("truncate", Choice(("truncate", "terminate")))
    end_on_clear: bool = setting(False, Flag())
    """Whether the last monster's death ends the episode."""


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
"""How many worlds a study collects from side by side, unless it says so itself."""

OBSERVATION_FIELDS = {
    "thesis": {"perceive": "all", "order": "nearest", "scale": "unit"},
    "pygame": {"perceive": "nearest:5", "order": "nearest", "scale": "map"},
    "godot": {"perceive": "all", "order": "fixed", "scale": "raw"},
}
"""What each layout perceives unless told otherwise."""


# --- Resolving -----------------------------------------------------------------------------------


def make_env_config(settings: Mapping[str, object], env: str = ENVIRONMENTS[0]) -> EnvConfig:
    """Resolve settings (keys of `EnvConfig`) of an environment to a complete configuration.

    Raises:
        UserError: for an unknown key, a value out of range, or values that do not go together.
    """
    if env not in ENVIRONMENT_FIELDS:
        raise unknown_name("environment", env, ENVIRONMENTS)
    given = read_fields(EnvConfig, {**ENVIRONMENT_FIELDS[env], **settings})
    return EnvConfig(**resolve_world(given))


def resolve_world(values: dict[str, Any]) -> dict[str, Any]:
    """Fill what a layout of observations implies, and check what must go together."""
    layout = OBSERVATION_FIELDS[values.get("observation", "thesis")]
    values = {**values, **{key: values.get(key) or implied for key, implied in layout.items()}}
    players = values.get("players", 1)
    for key in ("classes", "weapons", "reward"):
        if len(values.get(key, ("",))) not in (1, players):
            raise UserError(
                f"{key} has {len(values[key])} names for {players} players: give one, or one each"
            )
        if len(set(values.get(key, ()))) == 1:
            values[key] = values[key][:1]
    if values.get("random_levels", 1) > 1 and not is_random_level(values.get("level", "")):
        raise UserError(
            f"random_levels = {values['random_levels']} is not allowed: only random levels come in numbers"
        )
    return values


def is_own_level(name: str) -> bool:
    """Tell whether a level is a file of its user's, and neither shipped nor made from a number."""
    return bool(name) and name not in SHIPPED_LEVELS and not is_random_level(name)


def is_random_level(name: str) -> bool:
    """Tell whether a level is made from a number."""
    return name.startswith("random:")


def are_own_characters(name: str) -> bool:
    """Tell whether characters are a file of their user's."""
    return bool(name) and name not in SHIPPED_CHARACTERS


def own_rewards(names: Iterable[str]) -> list[str]:
    """Return those of the names of rewards that are functions of their user's."""
    return [name for name in names if ":" in name]


_Config = TypeVar("_Config", bound=EnvConfig)


def read_fields(config: type[_Config], settings: Mapping[str, object]) -> dict[str, Any]:
    """Check a mapping of key to value and return it with every value in its final type.

    Raises:
        UserError: naming the key, the value and what is allowed.
    """
    return {key: read_field(config, key, value) for key, value in settings.items()}


def read_field(config: type[_Config], key: str, value: object) -> Any:
    """Check one key and value of a configuration; see `read_fields`."""
    readers: dict[str, Reader] = {item.name: item.metadata["reader"] for item in fields(config)}
    if key not in readers:
        raise unknown_name("key", key, readers)
    try:
        return readers[key].read(value)
    except (ValueError, TypeError, OverflowError):
        reader = readers[key]
        hint = _nearest(value, reader.names) if isinstance(reader, Choice | Names) else ""
        shown = json.dumps(value, default=str)
        raise UserError(f"{key} = {shown} is not allowed{hint}: {reader.allowed}") from None


def _nearest(value: object, names: tuple[str, ...]) -> str:
    """Return the suggestion of the nearest name to a wrong one, or to the wrong one in a list."""
    words = [value] if isinstance(value, str) else value if isinstance(value, list | tuple) else []
    hints = [nearest_name(word, names) for word in words if isinstance(word, str) and word not in names]
    return next((hint for hint in hints if hint), "")
