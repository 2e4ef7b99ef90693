"""Cases to try the kernel on: small levels, characters, configurations and ways to play, for Hypothesis.

Levels are CSV folders, and everybody lives close together, so that fights happen all the time; numbers
are awkward (thirds, tenths), so that the order of operations shows in the bits. How players play is
drawn as bytes, each a mood that a player keeps for four steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st

from pneuma.config import OBSERVATIONS, ORDERS, REWARDS, SCALES, make_env_config
from pneuma.env.rules import ATTACK, DOWN, FLAME, HEAL, LEFT, RIGHT, UP
from pneuma.env.state import LANES
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError

from .oracle import Oracle
from .oracle_parts import Player

KINDS = {"bamboo": 390, "spirit": 391, "raccoon": 392, "squid": 393}
CLASSES = ("base", "tank", "mage", "warrior")
WEAPONS = ("own", "blade", "sword", "lance", "axe", "rapier", "sai")
START, OBSTACLE, WATER, GRASS = 400, 395, 0, 2
HALF_BODY = 35.05  # of the largest body: nearer to the edge of the grid, a level is refused
STEPS_OF_A_MOOD = 4

Tile = tuple[int, int]
Place = tuple[float, float]


# --- Levels ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Map:
    """A level to be: tiles by (column, row), places in pixels from the upper left corner."""

    columns: int = 16
    rows: int = 16
    tile: float = 64.0
    shore: int = 1  # tiles of water around
    lakes: tuple[Tile, ...] = ()
    obstacles: tuple[Tile, ...] = ()
    starts: tuple[Place, ...] = ((512.0, 512.0),)
    monsters: tuple[tuple[str, float, float], ...] = ()

    def write(self, folder: Path) -> str:
        """Write the CSV layers, clear of the places where somebody lives; return the path."""
        folder.mkdir(parents=True, exist_ok=True)
        lived_in = {(int(x // self.tile), int(y // self.tile)) for x, y in self.places}
        ground = np.full((self.rows, self.columns), WATER)
        shore = self.shore
        ground[shore : self.rows - shore, shore : self.columns - shore] = GRASS
        obstacles = np.full_like(ground, -1)
        for layer, code, tiles in ((ground, WATER, self.lakes), (obstacles, OBSTACLE, self.obstacles)):
            for column, row in set(tiles) - lived_in:
                layer[row % self.rows, column % self.columns] = code
        codes = [START] * len(self.starts) + [KINDS[kind] for kind, _, _ in self.monsters]
        objects = [f"{code},{x!r},{y!r}" for code, (x, y) in zip(codes, self.places, strict=True)]
        header = f"tile = {self.tile}\norigin = [0, 0]\ncoast = [{WATER}]\n"
        (folder / "level.toml").write_text(header)
        (folder / "objects.csv").write_text("\n".join(["code,x,y", *objects]))
        np.savetxt(folder / "ground.csv", ground, "%d", ",")
        np.savetxt(folder / "obstacles.csv", obstacles, "%d", ",")
        return str(folder)

    @property
    def places(self) -> list[Place]:
        """Where somebody lives: start places, then monsters."""
        return [*self.starts, *((x, y) for _, x, y in self.monsters)]


@st.composite
def maps(draw: st.DrawFn) -> Map:
    """Draw a level with most of its start places and monsters around one point."""
    columns, rows = draw(st.integers(12, 20)), draw(st.integers(12, 20))
    tile = draw(st.sampled_from([64.0, 64.0, 40.0, 48.0, 50.5, 96.0]))
    shore = draw(st.integers(0, 2))
    tiles = st.lists(st.tuples(st.integers(0, columns - 1), st.integers(0, rows - 1)), max_size=12)
    edge = max(shore * tile + 1.0, HALF_BODY)
    far = (columns * tile - edge, rows * tile - edge)

    def within(shares: tuple[int, int]) -> Place:
        x, y = (edge + (f - edge) * share / 999 for share, f in zip(shares, far, strict=True))
        return x, y

    def near(offset: tuple[int, int]) -> Place:
        x, y = (min(max(h + third / 3, edge), f) for h, third, f in zip(hub, offset, far, strict=True))
        return x, y

    anywhere = st.tuples(st.integers(0, 999), st.integers(0, 999)).map(within)
    hub = draw(anywhere)
    around = st.tuples(st.integers(-450, 450), st.integers(-450, 450)).map(near)
    place = st.one_of(around, around, around, anywhere)
    starts = draw(st.lists(place, min_size=1, max_size=3))
    crowd = draw(st.sampled_from([6, 6, 6, 2 * LANES + 1]))  # now and then more than move side by side
    kinds = st.tuples(st.sampled_from(sorted(KINDS)), place)
    monsters = draw(st.lists(kinds, min_size=1 if crowd == 6 else LANES, max_size=crowd))
    return Map(
        columns, rows, tile, shore, tuple(draw(tiles)[:4]), tuple(draw(tiles)), tuple(starts),
        tuple((kind, *at) for kind, at in monsters),
    )  # fmt: skip


# --- Characters --------------------------------------------------------------------------------------

_BODIES = ([24, 50], [56, 56], [13.3, 2 * HALF_BODY], [47, 48])
_POOLS: dict[str, dict[str, Sequence[Any]]] = {
    "players": {
        "hp": (3.9, 10.1, 30, 70), "energy": (0, 25, 60.7), "attack": (0, 12, 0.7), "magic": (0, 4, 30.3),
        "speed": (0, 60, 300, 431.7), "body": _BODIES, "invulnerable": (0.0, 0.05, 0.3),
        "energy_recovery": (0, 0.6, 10.3),
    },
    "weapons": {
        "damage": (0.3, 15, 20), "swing": (0.017, 0.1, 0.4), "knock_back": (0, 120, 777.7),
        "knock_back_time": (0, 0.07, 0.5), "box": ([51, 79], [80.3, 40.1], [20, 200]),
        "reach": (
            {"down": 52, "left": 54, "up": 44, "right": 54}, {"down": 9.7, "left": 30, "up": 0, "right": 1},
        ),
    },
    "spells": {
        "strength": (0, 5, 20.1), "cost": (0, 5, 20.7), "cast": (0.017, 0.1, 0.4), "length": (320, 99.9),
        "width": (64, 20.3),
    },
    "monsters": {
        "hp": (1, 7.3, 20, 40, 55.5), "speed": (0, 90, 150, 237.7, 600), "body": _BODIES,
        "notice": (0, 60, 180, 300, 333.3), "attack": (40, 100, 160.5), "stand_off": (0, 12.7, 30),
        "damage": (0.1, 7, 13.3, 40), "bite_time": (0.017, 0.1, 0.4, 1), "invulnerable": (0, 0.05, 0.3),
        "xp": (0, 0.1, 1, 11.7), "heal": (0, 0.3, 7),
    },
}  # fmt: skip
_NAMES = {
    "players": CLASSES, "weapons": WEAPONS[1:], "spells": ("flame", "heal"), "monsters": tuple(KINDS),
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
        names = (
            set(_NAMES[group])
            if group == "players" and frail
            else draw(st.sets(st.sampled_from(_NAMES[group])))
        )
        for name in sorted(names):
            keys = draw(st.sets(st.sampled_from(sorted(pools)), max_size=4))
            values = {key: draw(st.sampled_from(pools[key])) for key in sorted(keys)}
            if group == "players":
                values |= frail
            if group == "monsters" and draw(st.booleans()):
                values["knock_back"], values["knock_back_time"] = draw(st.sampled_from(_FLIGHTS))
            lines += [f"[{group}.{name}]", *(f"{key} = {_toml(value)}" for key, value in values.items())]
    return "\n".join(lines)


def _toml(value: Any) -> str:
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key} = {item}" for key, item in value.items()) + "}"
    return str(value)


# --- Configurations ----------------------------------------------------------------------------------


@st.composite
def configurations(draw: st.DrawFn, level: Map) -> dict[str, Any]:
    """Draw the settings of an environment, all but level and characters."""
    players = draw(st.integers(1, 3))

    def one_each(names: Sequence[str]) -> list[str]:
        return draw(st.lists(st.sampled_from(names), min_size=players, max_size=players))

    kinds = sorted({kind for kind, _, _ in level.monsters})
    some = st.lists(st.sampled_from(kinds), min_size=1, unique=True).map(lambda names: ",".join(names))
    perceive = st.one_of(
        st.sampled_from(["", "all"]), st.integers(1, 4).map("nearest:{}".format), some.map("kind:{}".format)
    )
    return {
        "players": players,
        "classes": one_each(CLASSES),
        "weapons": one_each(WEAPONS),
        "magic": draw(st.booleans()),
        "reward": one_each(REWARDS),
        "observation": draw(st.sampled_from(OBSERVATIONS)),
        "perceive": draw(perceive),
        "order": draw(st.sampled_from(["", *ORDERS])),
        "scale": draw(st.sampled_from(["", *SCALES])),
        "start": draw(st.sampled_from(["random", "first"])),
        "coast": draw(st.sampled_from(["wall", "wall", "deadly"])),
        "kill_credit": draw(st.sampled_from(["striker", "near"])),
        "xp_scope": draw(st.sampled_from(["episode", "forever"])),
        "ending_cost": draw(st.sampled_from([0.0, 1.0, 0.3])),
        "episode_steps": draw(st.sampled_from([9, 25, 60, 200])),
        "time_limit": draw(st.sampled_from(["truncate", "terminate"])),
        "end_on_clear": draw(st.booleans()),
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
    settings = draw(configurations(level))
    characters = draw(st.one_of(character_files(), st.sampled_from(["", "pygame"])))
    count, length = draw(st.integers(1, 2)), draw(st.integers(8, 20))
    size = length * settings["players"] * count
    moods, breaks = (
        draw(st.binary(min_size=size, max_size=size)),
        draw(st.binary(min_size=length, max_size=length)),
    )
    return Case(settings, level, characters, count, draw(st.integers(0, 2**32)), moods, breaks)


def make_worlds(case: Case, folder: Path) -> Worlds:
    """Write the case's files to a folder of its own and set up its worlds.

    Where obstacles wall somebody in, they are left out.
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
    magic = bool(world.book.settings.magic)
    if mood < 120:
        return hunt(world, player, ATTACK)
    if mood < 150:
        return hunt(world, player, FLAME if magic else ATTACK)
    if mood < 165:
        return HEAL if magic else ATTACK
    if mood < 200:
        return mood % 4
    return (mood >> step % STEPS_OF_A_MOOD) % (HEAL + 1 if magic else ATTACK + 1)


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
