"""The fields of an environment, their types, and the values that each shipped environment sets.

`pneuma.config` builds a run's configuration on it; like that module it imports nothing heavy.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, get_type_hints

from annotated_types import DocInfo, Interval, MinLen, doc

from pneuma.errors import UserError, unknown_name
from pneuma.values import MOST_NAMES, OneOf, declare, matching, names_like

SHIPPED_LEVELS = ("thesis",)
SHIPPED_CHARACTERS = ("pygame",)
REWARDS = ("thesis", "pygame", "godot", "kills", "distance-sigmoid")
OBSERVATIONS = ("thesis", "pygame", "godot")
ORDERS = ("nearest", "fixed")
SCALES = ("unit", "map", "raw")
ACTION_NAMES = ("down", "left", "up", "right", "attack")
SPELL_NAMES = ("flame", "heal")
KINDS_OF_MONSTERS = ("bamboo", "mixed")
MAX_PLAYERS = MOST_NAMES
MOST_STEPS = 1_000_000
"""Most agent steps of an episode."""
PERCEIVE = "all, nearest:K for the K nearest, or rays:N, 1 to 64"


_PERCEIVE = r"|all|nearest:[1-9]\d*|rays:([1-9]|[1-5]\d|6[0-4])"
MODULE = r"(.+/)?\w+\.py|[A-Za-z_]\w*(\.\w+)*"
"""The form of a module: the path of its file, or its name."""
_REWARD = rf"{'|'.join(REWARDS)}|({MODULE}):\w+"
_REWARD_ALLOWED = f"one of {', '.join(REWARDS)}, or module:function"


@dataclass(frozen=True, kw_only=True)
class EnvConfig:
    """The fields of one environment; each is a keyword of `gymnasium.make` and a key of a study.

    The defaults are those of `pneuma/Pneuma-v0`, the environment of the thesis's text; empty texts are filled
    by `make_env_config`. The table of `pneuma.env.gym.PneumaEnv` explains each.
    """

    level: Annotated[
        str, MinLen(1), doc("a shipped level, a folder of tables, `random:train:N` or `random:test:N`")
    ] = declare("thesis", paces=True)
    random_levels: Annotated[
        int, Interval(ge=1, le=10_000), doc("so many random levels from number N on; each episode draws one")
    ] = declare(1, paces=True)
    monsters: Annotated[
        str,
        OneOf(KINDS_OF_MONSTERS),
        doc("on random levels: `bamboo` alone; or `mixed`: 8, and 2 of each other"),
    ] = "bamboo"
    characters: Annotated[str, doc("a file that overrides and extends the shipped ones; or `pygame`")] = ""
    players: Annotated[
        int,
        Interval(ge=1, le=MAX_PLAYERS),
        doc("1 to 8 in a world; more than one not here, but in the other interfaces"),
    ] = declare(1, paces=True)
    classes: Annotated[
        tuple[str, ...],
        names_like(r"[\w-]+", "a class, or a list of one a player"),
        doc("`base`, `tank`, `mage`, `warrior`, or a list of one per player"),
    ] = declare(("base",), paces=True)
    magic: Annotated[bool, doc("whether there are the actions flame and heal")] = declare(False, paces=True)
    reward: Annotated[
        tuple[str, ...],
        names_like(_REWARD, _REWARD_ALLOWED, REWARDS),
        doc("a formula, or a list of one per player"),
    ] = declare(("thesis",), paces=True)
    shared_reward: Annotated[bool, doc("whether each player gets the mean of all players' rewards")] = False
    observation: Annotated[str, OneOf(OBSERVATIONS), doc("the layout")] = declare("thesis", paces=True)
    perceive: Annotated[
        str, matching(_PERCEIVE, PERCEIVE), doc("`all`, `nearest:K`, or `rays:N`, 1 to 64")
    ] = ""
    order: Annotated[
        str, OneOf(("", *ORDERS)), doc("dead monsters are left out, or rows of zeros (HP 0 in `godot`)")
    ] = ""
    scale: Annotated[str, OneOf(("", *SCALES)), doc("of what is observed")] = ""
    observe_facing: Annotated[bool, doc("whether a player observes its facing: four numbers")] = declare(
        False
    )
    start: Annotated[
        str, OneOf(("random", "first")), doc("a random start place of the level, or always the first")
    ] = "random"
    trees: Annotated[str, OneOf(("wall", "pass")), doc("whether trees and other obstacles stop bodies")] = (
        "wall"
    )
    terrain_stops: Annotated[str, OneOf(("all", "players")), doc("whom trees and coast stop")] = "all"
    attack_ticks: Annotated[
        int, Interval(ge=0, le=3600), doc("that every attack lasts; 0: the weapon's, 24 for `blade`")
    ] = 0
    blow: Annotated[
        str,
        OneOf(("attack", "entry")),
        doc("a sword hits a monster once an attack; or on each `entry` into its box"),
    ] = "attack"
    kill_credit: Annotated[
        str, OneOf(("striker", "near")), doc("who gains: who struck, or all within the attack circle")
    ] = "striker"
    xp_scope: Annotated[
        str, OneOf(("episode", "forever")), doc("`forever`: XP is kept until `reset(seed=...)`")
    ] = "episode"
    ending_cost: Annotated[
        float,
        Interval(ge=0, le=1000),
        doc("XP lost by death, clearing the level and the time limit"),
    ] = 0.0
    episode_steps: Annotated[int, Interval(ge=1, le=MOST_STEPS), doc("the world's time limit")] = declare(
        1000, paces=True
    )
    time_limit: Annotated[
        str, OneOf(("truncate", "terminate")), doc("whether it truncates or terminates")
    ] = "truncate"
    end_on_clear: Annotated[bool, doc("whether the last kill ends the episode")] = False


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


def action_names(config: EnvConfig) -> tuple[str, ...]:
    """Return the names of a world's actions, in order."""
    if config.magic:
        return ACTION_NAMES + SPELL_NAMES
    return ACTION_NAMES


# --- Resolving -----------------------------------------------------------------------------------


def make_env_config(settings: Mapping[str, object], env: str = ENVIRONMENTS[0]) -> EnvConfig:
    """Resolve the fields of an environment to a complete configuration."""
    if env not in ENVIRONMENT_FIELDS:
        raise unknown_name("environment", env, ENVIRONMENTS)
    values = read_fields(EnvConfig, with_environment(env, settings))
    return EnvConfig(**resolve_world(values))


def with_environment(env: str, settings: Mapping[str, object]) -> dict[str, Any]:
    """Return an environment's fields with the settings over them."""
    return {**ENVIRONMENT_FIELDS.get(env, {}), **settings}


def with_layout(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return fields with those that their observation layout implies, where they leave them open."""
    filled = dict(values)
    for field_name, implied in OBSERVATION_FIELDS[values.get("observation", "thesis")].items():
        filled[field_name] = values.get(field_name) or implied
    return filled


OF_PLAYERS = ("classes", "reward")
"""Fields with one name, or one for each player."""


def resolve_world(values: Mapping[str, Any]) -> dict[str, Any]:
    """Fill in what an observation layout implies, and check fields that depend on each other."""
    resolved = with_layout(values)
    players = resolved.get("players", 1)
    for field_name in OF_PLAYERS:
        names = resolved.get(field_name)
        if not names:
            continue
        if len(names) not in (1, players):
            problem = f"{field_name} has {len(names)} names for {players} players"
            raise UserError(f"{problem}: give one, or one each")
        if len(set(names)) == 1:
            resolved[field_name] = names[:1]
    if players == 1:
        resolved.pop("shared_reward", None)
    if not is_random_level(resolved.get("level", "")):
        _refuse_random_fields(resolved)
    return resolved


def _refuse_random_fields(values: Mapping[str, Any]) -> None:
    """Refuse fields of random levels for another level."""
    random_levels = values.get("random_levels", 1)
    if random_levels > 1:
        message = f"random_levels = {random_levels} is not allowed"
        raise UserError(f"{message}: only random levels come in numbers")
    monsters = values.get("monsters", "bamboo")
    if monsters != "bamboo":
        message = f"monsters = {monsters} is not allowed"
        raise UserError(f"{message}: levels that are not random have their own")


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
    return {field_name: read_field(config, field_name, value) for field_name, value in values.items()}


def read_field(config: type[EnvConfig], field_name: str, value: object) -> Any:
    from pneuma import schema  # pydantic: not for `import pneuma`

    return schema.read_field(config, field_name, value)


# --- The table of arguments ----------------------------------------------------------------------


def arguments_table() -> str:
    """Return a Markdown table of all fields: their defaults, in the three worlds where they differ."""
    worlds = [vars(make_env_config({}, env)) for env in ENVIRONMENTS]
    rows = ["| argument | default | meaning |", "| --- | --- | --- |"]
    for field_name, hint in get_type_hints(EnvConfig, include_extras=True).items():
        defaults = [_default_text(world[field_name]) for world in worlds]
        if len(set(defaults)) == 1:
            defaults = defaults[:1]
        for note in hint.__metadata__:
            if isinstance(note, DocInfo):
                rows.append(f"| `{field_name}` | {', '.join(defaults)} | {note.documentation} |")
    return "\n".join(rows)


def _default_text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, int | float):
        return f"{value:g}"
    if isinstance(value, tuple):
        value = ", ".join(value)
    return value or "none"
