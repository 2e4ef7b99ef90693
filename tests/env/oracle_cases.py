"""Cases to try the kernel on: small levels, characters, configurations and ways to play, for Hypothesis.

Everybody lives close together, so that fights happen all the time and bodies are in each other's way; numbers
are awkward (thirds, tenths), so that the order of operations shows in the bits. How players play is drawn as
bytes, each a mood that a player keeps for four steps.
"""

from __future__ import annotations

import itertools
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, get_type_hints

import numpy as np
from hypothesis import reject
from hypothesis import strategies as st

from pneuma.env.characters import DATA
from pneuma.env.fields import REWARDS, EnvConfig, make_env_config
from pneuma.env.rules import ATTACK, DOWN, LEFT, RIGHT, UP
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError
from pneuma.field_types import OneOf

from .oracle import Oracle, Pair, Player

MOOD_STEPS = 4
SHIPPED = tomllib.loads((DATA / "characters.toml").read_text(encoding="utf-8"))
CODES = {name: monster["code"] for name, monster in SHIPPED["monsters"].items()}
"""Of the shipped monsters, by their names."""
START, OBSTACLE, WATER, GRASS = 400, 395, 0, 2
CROWD = 30
REACH = 47.5
"""No drawn body reaches further from the middle of the square in which it begins."""
CELL = 2 * REACH

# --- Levels ------------------------------------------------------------------------------------------

Tile = tuple[int, int]


@dataclass(frozen=True)
class Map:
    """A level to be: tiles by (column, row), positions in pixels from the origin."""

    columns: int = 16
    rows: int = 16
    tile: float = 64.0
    origin: Pair = (0, 0)  # column and row of the corner where x = y = 0
    shore: int = 1  # tiles of water around
    lakes: tuple[Tile, ...] = ()
    obstacles: tuple[Tile, ...] = ()
    starts: tuple[Pair, ...] = ((512.0, 512.0),)
    monsters: tuple[tuple[str, float, float], ...] = ()
    clear: frozenset[Tile] = frozenset()

    def write(self, folder: Path) -> str:
        """Write the CSV layers; return the path."""
        folder.mkdir(parents=True, exist_ok=True)
        ground = np.full((self.rows, self.columns), WATER)
        shore = self.shore
        ground[shore : self.rows - shore, shore : self.columns - shore] = GRASS
        obstacles = np.full_like(ground, -1)
        for layer, code, tiles in ((ground, WATER, self.lakes), (obstacles, OBSTACLE, self.obstacles)):
            for column, row in tiles:
                layer[row % self.rows, column % self.columns] = code
        for column, row in self.clear:
            ground[row, column], obstacles[row, column] = GRASS, -1
        objects = ["code,x,y", *(f"{START},{x!r},{y!r}" for x, y in self.starts)]
        objects += [f"{CODES[name]},{x!r},{y!r}" for name, x, y in self.monsters]
        header = f"tile = {self.tile}\norigin = {list(self.origin)}\ncoast = [{WATER}]\n"
        (folder / "level.toml").write_text(header)
        (folder / "objects.csv").write_text("\n".join(objects))
        np.savetxt(folder / "ground.csv", ground, "%d", ",")
        np.savetxt(folder / "obstacles.csv", obstacles, "%d", ",")
        return str(folder)


@st.composite
def maps(draw: st.DrawFn) -> Map:
    """Draw a level whose start positions and monsters are around one point, with some room between."""
    fewest, largest = draw(st.sampled_from([(12, 20), (12, 20), (6, 8)]))  # now and then hardly any room
    columns, rows = draw(st.integers(fewest, largest)), draw(st.integers(fewest, largest))
    tile = draw(st.sampled_from([64.0, 64.0, 40.0, 48.0, 50.5, 96.0]))
    tiles = st.lists(st.tuples(st.integers(0, columns - 1), st.integers(0, rows - 1)), max_size=12)
    across, down = int(columns * tile / CELL), int(rows * tile / CELL)
    x, y = draw(st.integers(0, across - 1)), draw(st.integers(0, down - 1))
    cells = sorted(np.ndindex(across, down), key=lambda cell: max(abs(cell[0] - x), abs(cell[1] - y)))
    most_bodies = draw(st.sampled_from([8, 8, CROWD]))
    count = draw(st.integers(2, min(most_bodies, len(cells))))
    off_centre = st.integers(-9, 9).map(lambda third: CELL / 2 + third / 3)
    positions, under = [], set()
    for column, row in draw(st.permutations(cells[: 3 * count // 2]))[:count]:
        position = (column * CELL + draw(off_centre), row * CELL + draw(off_centre))
        positions.append(position)
        for dx, dy in itertools.product((-REACH, -REACH / 3, REACH / 3, REACH), repeat=2):
            under_column = min(max(int((position[0] + dx) // tile), 0), columns - 1)
            under.add((under_column, min(max(int((position[1] + dy) // tile), 0), rows - 1)))
    starts = draw(st.integers(1, min(3, count - 1)))
    names = st.sampled_from(sorted(CODES))
    return Map(
        columns, rows, tile, shore=draw(st.integers(0, 2)), lakes=tuple(draw(tiles)[:4]),
        obstacles=tuple(draw(tiles)), starts=tuple(positions[:starts]),
        monsters=tuple((draw(names), *position) for position in positions[starts:]), clear=frozenset(under),
    )  # fmt: skip


# --- Characters --------------------------------------------------------------------------------------

_BODIES = ([24, 50], [56, 56], [13.3, 70.1], [47, 48])
_OFFSETS = ([0, 0], [-1.5, 2], [6.1, -9.3])  # of a body or a circle from the position
_REACHES = (
    "{down = [0, 52], left = [-54, 0], up = [0, -44], right = [54, 0]}",
    "{down = [0, 9.7], left = [-38.5, 24.5], up = [0, 0], right = [1, -20.1]}",
)
CLASSES = ("base", "tank", "mage", "warrior")
WEAPONS = ("blade", "sword", "lance", "axe", "rapier", "sai")
_STRENGTH: dict[str, Sequence[Any]] = {
    "strength": (0, 5, 20.1), "cost": (0, 5, 20.7), "cast": (0.017, 0.1, 0.4),
}  # fmt: skip
_PLAYER: dict[str, Sequence[Any]] = {
    "hp": (3.9, 10.1, 30, 70), "energy": (0, 25, 60.7), "attack": (0, 12, 0.7), "magic": (0, 4, 30.3),
    "weapon": tuple(f'"{name}"' for name in WEAPONS), "speed": (0, 60, 300, 431.7), "body": _BODIES,
    "body_at": _OFFSETS, "invulnerable": (0.0, 0.05, 0.3), "energy_recovery": (0, 0.6, 10.3),
}  # fmt: skip
_WEAPON: dict[str, Sequence[Any]] = {
    "damage": (0.3, 15, 20), "swing": (0.017, 0.1, 0.4), "knock_back": (0, 120, 777.7),
    "knock_back_time": (0, 0.07, 0.5), "box": ([79, 51], [80.3, 40.1], [20, 200]),
    "reach": _REACHES, "hilt": _REACHES,
}  # fmt: skip
_MONSTER: dict[str, Sequence[Any]] = {
    "hp": (1, 7.3, 20, 40, 55.5), "speed": (0, 90, 150, 237.7, 600), "body": _BODIES,
    "body_at": _OFFSETS, "notice_at": _OFFSETS, "attack_at": _OFFSETS,
    "notice": (0, 60, 180, 300, 333.3), "attack": (40, 100, 160.5), "stand_off": (0, 12.7, 30),
    "damage": (0.1, 7, 13.3, 40), "bite_time": (0.017, 0.1, 0.4, 1), "invulnerable": (0, 0.05, 0.3),
    "xp": (0, 0.1, 1, 11.7), "heal": (0, 0.3, 7),
}  # fmt: skip
TABLES = {
    **{f"players.{name}": _PLAYER for name in CLASSES},
    **{f"weapons.{name}": _WEAPON for name in WEAPONS},
    "spells.flame": {**_STRENGTH, "length": (320, 99.9), "width": (64, 20.3)},
    "spells.heal": {**_STRENGTH, "reach": (0, 40.3, 500)},
    **{f"monsters.{name}": _MONSTER for name in CODES},
}
_FLIGHTS = ((1200, 0.05), (333.3, 0.4), (0, 0.2), (600, 0))


@st.composite
def character_files(draw: st.DrawFn) -> str:
    """Draw the text of a file of characters that overrides some numbers of the shipped ones.

    Every second time all players are frail: a bite or two kill them.
    """
    tables: dict[str, dict[str, Any]] = {}
    for table in sorted(draw(st.sets(st.sampled_from(sorted(TABLES))))):
        keys = sorted(draw(st.sets(st.sampled_from(sorted(TABLES[table])), max_size=4)))
        tables[table] = {key: draw(st.sampled_from(TABLES[table][key])) for key in keys}
        if table.startswith("monsters") and draw(st.booleans()):
            tables[table]["knock_back"], tables[table]["knock_back_time"] = draw(st.sampled_from(_FLIGHTS))
    if draw(st.booleans()):
        hp = draw(st.sampled_from(_PLAYER["hp"][:2]))
        for name in CLASSES:
            tables.setdefault(f"players.{name}", {})["hp"] = hp
    lines = []
    for table, values in tables.items():
        lines.append(f"[{table}]")
        lines += [f"{key} = {value}" for key, value in values.items()]
    return "\n".join(lines)


# --- Configurations ----------------------------------------------------------------------------------

CHOICES: dict[str, Sequence[object]] = {}
"""What each field may be that is a choice; `monsters` is of random levels alone."""
for _name, _hint in get_type_hints(EnvConfig, include_extras=True).items():
    if _hint is bool:
        CHOICES[_name] = (False, True)
    for _limit in getattr(_hint, "__metadata__", ()):
        if isinstance(_limit, OneOf) and _name != "monsters":
            CHOICES[_name] = _limit.names


@st.composite
def configurations(draw: st.DrawFn) -> dict[str, Any]:
    """Draw the settings of an environment, all but level and characters."""
    players = draw(st.integers(1, 3))
    settings = {name: draw(st.sampled_from(choices)) for name, choices in CHOICES.items()}
    nearest, rays = st.integers(1, 4).map("nearest:{}".format), st.integers(1, 9).map("rays:{}".format)
    for name, names in (("classes", CLASSES), ("reward", REWARDS)):
        settings[name] = draw(st.lists(st.sampled_from(names), min_size=players, max_size=players))
    return {
        **settings,
        "players": players,
        "attack_ticks": draw(st.sampled_from([0, 0, 1, 25])),
        "perceive": draw(st.one_of(st.sampled_from(["", "all"]), nearest, rays)),
        "ending_cost": draw(st.sampled_from([0.0, 1.0, 0.3])),
        "episode_steps": draw(st.sampled_from([9, 25, 60, 200])),
    }


# --- Cases -------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """What is played, and how: moods by player, and when to begin again, a byte for every four steps."""

    settings: dict[str, Any]
    level: Map
    characters: str  # text of a file that overrides the shipped ones, or `pygame`
    worlds: int
    seed: int
    moods: bytes
    breaks: bytes


@st.composite
def cases(draw: st.DrawFn) -> Case:
    """Draw a case of 32 to 80 steps."""
    level, settings = draw(maps()), draw(configurations())
    characters = draw(st.one_of(character_files(), st.sampled_from(["", "pygame"])))
    worlds, length = draw(st.integers(1, 2)), draw(st.integers(8, 20))
    size = length * settings["players"] * worlds
    moods = draw(st.binary(min_size=size, max_size=size))
    breaks = draw(st.binary(min_size=length, max_size=length))
    return Case(settings, level, characters, worlds, draw(st.integers(0, 2**32)), moods, breaks)


def make_worlds(case: Case, folder: Path) -> Worlds:
    """Write the case's files to a folder of its own and set up its worlds.

    Where lakes and obstacles wall somebody in, they are left out.
    """
    folder.mkdir(parents=True)
    settings = {**case.settings, "characters": case.characters}
    if case.characters not in ("", "pygame"):
        (folder / "characters.toml").write_text(case.characters)
        settings["characters"] = str(folder / "characters.toml")
    for number, level in enumerate((case.level, replace(case.level, lakes=(), obstacles=()))):
        settings["level"] = level.write(folder / f"level{number}")
        try:
            return Worlds(case.worlds, make_env_config(settings))
        except UserError:
            continue
    reject()


def choose_actions(case: Case, oracles: Sequence[Oracle], step: int) -> np.ndarray:
    """Return (N, P) actions, by everybody's mood."""
    actions = np.zeros((len(oracles), case.settings["players"]), np.int64)
    moods = itertools.islice(case.moods, step // MOOD_STEPS * actions.size, None)
    for slot in np.ndindex(*actions.shape):
        world = oracles[slot[0]]
        actions[slot] = _act(world, world.players[slot[1]], next(moods), step)
    return actions


def _act(world: Oracle, player: Player, mood: int, step: int) -> int:
    """Return what a player does: hunts, burns, heals, walks straight on, or anything."""
    names = world.rulebook.actions
    if mood < 100 or (mood < 145 and len(names) == 5):
        return hunt(world, player, ATTACK)
    if mood < 130:
        return hunt(world, player, names.index("flame"))
    if mood < 145:
        return names.index("heal")
    if mood < 200:
        return mood % 4
    return (mood >> step % MOOD_STEPS) % len(names)


def hunt(world: Oracle, player: Player, strike: int) -> int:
    """Walk up to the nearest living monster, and strike when facing it close by; step back to turn to it."""
    offsets = [(monster.x - player.x, monster.y - player.y) for monster in world.monsters if monster.hp > 0.0]
    if not offsets:
        return strike
    dx, dy = min(offsets, key=lambda offset: abs(offset[0]) + abs(offset[1]))
    facing = RIGHT if dx > 0 else LEFT
    if abs(dx) <= abs(dy):
        facing = DOWN if dy > 0 else UP
    distance = max(abs(dx), abs(dy))
    if player.facing == facing and 20 < distance < 90:
        return strike
    if distance > 85:
        return facing
    return (facing + 2) % 4
