"""Cases to try the kernel on: small levels, characters, configurations and ways to play, for Hypothesis.

Everybody lives close together (`oracle_maps.py`), so that fights happen all the time and bodies are in
each other's way; numbers are awkward (thirds, tenths), so that the order of operations
shows in the bits. How players play is drawn as bytes, each a mood that a player keeps for four steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st

from pneuma.env.fields import REWARDS, EnvConfig, make_env_config
from pneuma.env.rules import ATTACK, DOWN, LEFT, RIGHT, UP
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError
from pneuma.values import OneOf

from .oracle import Oracle
from .oracle_maps import KINDS, Map, maps
from .oracle_parts import Player

CLASSES = ("base", "tank", "mage", "warrior")
WEAPONS = ("blade", "sword", "lance", "axe", "rapier", "sai")
STEPS_OF_A_MOOD = 4

# --- Characters --------------------------------------------------------------------------------------

_BODIES = ([24, 50], [56, 56], [13.3, 70.1], [47, 48])
_PLACES = ([0, 0], [-1.5, 2], [6.1, -9.3])  # of a body or a circle from the position
_REACHES = (
    {"down": 52, "left": 54, "up": 44, "right": 54},
    {"down": 9.7, "left": [-38.5, 24.5], "up": 0, "right": [1, -20.1]},
)
_POOLS: dict[str, dict[str, Sequence[Any]]] = {
    "players": {
        "hp": (3.9, 10.1, 30, 70), "energy": (0, 25, 60.7), "attack": (0, 12, 0.7), "magic": (0, 4, 30.3),
        "weapon": tuple(f'"{name}"' for name in WEAPONS),
        "speed": (0, 60, 300, 431.7), "body": _BODIES, "body_at": _PLACES, "invulnerable": (0.0, 0.05, 0.3),
        "energy_recovery": (0, 0.6, 10.3),
    },
    "weapons": {
        "damage": (0.3, 15, 20), "swing": (0.017, 0.1, 0.4), "knock_back": (0, 120, 777.7),
        "knock_back_time": (0, 0.07, 0.5), "box": ([79, 51], [80.3, 40.1], [20, 200]),
        "reach": _REACHES, "hilt": _REACHES,
    },
    "spells": {
        "strength": (0, 5, 20.1), "cost": (0, 5, 20.7), "cast": (0.017, 0.1, 0.4), "length": (320, 99.9),
        "width": (64, 20.3),
    },
    "monsters": {
        "hp": (1, 7.3, 20, 40, 55.5), "speed": (0, 90, 150, 237.7, 600), "body": _BODIES,
        "body_at": _PLACES, "notice_at": _PLACES, "attack_at": _PLACES,
        "notice": (0, 60, 180, 300, 333.3), "attack": (40, 100, 160.5), "stand_off": (0, 12.7, 30),
        "damage": (0.1, 7, 13.3, 40), "bite_time": (0.017, 0.1, 0.4, 1), "invulnerable": (0, 0.05, 0.3),
        "xp": (0, 0.1, 1, 11.7), "heal": (0, 0.3, 7),
    },
}  # fmt: skip
_NAMES = {
    "players": CLASSES, "weapons": WEAPONS, "spells": ("flame", "heal"), "monsters": tuple(KINDS),
}  # fmt: skip
_FLIGHTS = ((1200, 0.05), (333.3, 0.4), (0, 0.2), (600, 0))


@st.composite
def character_files(draw: st.DrawFn) -> str:
    """Draw the text of a file of characters that overrides some numbers of the shipped ones.

    Every second time all players are frail: a bite or two kill them.
    """
    frail = {"hp": draw(st.sampled_from(_POOLS["players"]["hp"][:2]))} if draw(st.booleans()) else {}
    lines = []
    for group, pools in _POOLS.items():
        every = group == "players" and frail
        names = _NAMES[group] if every else sorted(draw(st.sets(st.sampled_from(_NAMES[group]))))
        for name in names:
            keys = draw(st.sets(st.sampled_from(sorted(pools)), max_size=4))
            values = {key: draw(st.sampled_from(pools[key])) for key in sorted(keys)}
            if group == "players":
                values |= frail
            if name == "heal":  # it strikes no box
                values = {key: value for key, value in values.items() if key not in ("length", "width")}
                values["reach"] = draw(st.sampled_from((0, 40.3, 500)))
            if group == "monsters" and draw(st.booleans()):
                values["knock_back"], values["knock_back_time"] = draw(st.sampled_from(_FLIGHTS))
            lines += [f"[{group}.{name}]", *(f"{key} = {_toml(value)}" for key, value in values.items())]
    return "\n".join(lines)


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {item}" for key, item in value.items()) + "}"
    return str(value)


# --- Configurations ----------------------------------------------------------------------------------

CHOICES: dict[str, Sequence[object]] = {}
for _name, _hint in get_type_hints(EnvConfig, include_extras=True).items():
    if _hint is bool:
        CHOICES[_name] = (False, True)
    for _limit in getattr(_hint, "__metadata__", ()):
        if isinstance(_limit, OneOf) and _name != "monsters":
            CHOICES[_name] = _limit.names
"""What each field may be that is a choice; `monsters` is of random levels alone."""


@st.composite
def configurations(draw: st.DrawFn) -> dict[str, Any]:
    """Draw the settings of an environment, all but level and characters."""
    players = draw(st.integers(1, 3))

    def one_each(names: Sequence[str]) -> list[str]:
        return draw(st.lists(st.sampled_from(names), min_size=players, max_size=players))

    perceive = st.one_of(
        st.sampled_from(["", "all"]),
        st.integers(1, 4).map("nearest:{}".format),
        st.integers(1, 9).map("rays:{}".format),
    )
    chosen = {name: draw(st.sampled_from(choices)) for name, choices in CHOICES.items()}
    return {
        **chosen,
        "players": players,
        "classes": one_each(CLASSES),
        "attack_ticks": draw(st.sampled_from([0, 0, 1, 25])),
        "reward": one_each(REWARDS),
        "perceive": draw(perceive),
        "ending_cost": draw(st.sampled_from([0.0, 1.0, 0.3])),
        "episode_steps": draw(st.sampled_from([9, 25, 60, 200])),
    }


# --- Cases -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """What is played, and how.

    Attributes:
        settings: of the environment.
        level: where.
        characters: text of a file that overrides the shipped ones, or `pygame`.
        count: worlds.
        seed: of the first.
        moods: a byte for every player, four steps at a time.
        breaks: a byte for every four steps: when to begin anew.
    """

    settings: dict[str, Any]
    level: Map
    characters: str
    count: int
    seed: int
    moods: bytes
    breaks: bytes


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """Draw a case of 32 to 80 steps."""
    level = draw(maps())
    settings = draw(configurations())
    characters = draw(st.one_of(character_files(), st.sampled_from(["", "pygame"])))
    count, length = draw(st.integers(1, 2)), draw(st.integers(8, 20))
    size = length * settings["players"] * count
    moods, breaks = (draw(st.binary(min_size=many, max_size=many)) for many in (size, length))
    return Case(settings, level, characters, count, draw(st.integers(0, 2**32)), moods, breaks)


def make_worlds(case: Case, folder: Path) -> Worlds:
    """Write the case's files to a folder of its own and set up its worlds.

    Where lakes and obstacles wall somebody in, they are left out.
    """
    settings = dict(case.settings)
    folder.mkdir(parents=True)
    settings["characters"] = case.characters
    if case.characters not in ("", "pygame"):
        (folder / "characters.toml").write_text(case.characters)
        settings["characters"] = str(folder / "characters.toml")
    for number, level in enumerate((case.level, replace(case.level, lakes=(), obstacles=()))):
        settings["level"] = level.write(folder / f"level{number}")
        try:
            return Worlds(case.count, make_env_config(settings))
        except UserError:
            continue
    reject()


# --- Playing -----------------------------------------------------------------------------------------


def choose_actions(case: Case, oracles: Sequence[Oracle], step: int) -> np.ndarray:
    """Return (N, P) actions, by everybody's mood."""
    players = case.settings["players"]
    first = step // STEPS_OF_A_MOOD * len(oracles) * players
    moods = iter(case.moods[first : first + len(oracles) * players])
    return np.array(
        [[_act(world, player, next(moods), step) for player in world.players] for world in oracles]
    )


def _act(world: Oracle, player: Player, mood: int, step: int) -> int:
    """Return what a player does: hunts, burns, heals, walks straight on, or anything."""
    names = world.book.actions
    for below, name in ((100, "attack"), (130, "flame"), (145, "heal")):
        if mood < below:
            action = names.index(name) if name in names else ATTACK
            return hunt(world, player, action) if mood < 130 else action
    return mood % 4 if mood < 200 else (mood >> step % STEPS_OF_A_MOOD) % len(names)


def hunt(world: Oracle, player: Player, strike: int) -> int:
    """Walk up to the nearest living monster, and strike when facing it close by; step back to turn to it."""
    living = [monster for monster in world.monsters if monster.hp > 0.0]
    if not living:
        return strike
    offsets = [(monster.x - player.x, monster.y - player.y) for monster in living]
    dx, dy = min(offsets, key=lambda offset: abs(offset[0]) + abs(offset[1]))
    way = (RIGHT if dx > 0 else LEFT) if abs(dx) > abs(dy) else (DOWN if dy > 0 else UP)
    distance = max(abs(dx), abs(dy))
    if player.facing == way and 20 < distance < 90:
        return strike
    return way if distance > 85 else (way + 2) % 4
