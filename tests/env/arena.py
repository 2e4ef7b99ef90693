"""Bare levels and worlds set by hand, so that every expected value is a short sum.

The arena is 20 x 20 tiles of 64 px around the origin: the grid spans -640 … 640 on both axes. Its
outermost ring is coast, so the land spans -576 … 576. One tile, column 14 and row 10, is an
obstacle: x from 256 to 320, y from 0 to 64.

A player's body reaches 25 px to the left of its place, 22 to the right, 22 up and 26 down; a bamboo's
12 px to either side, 23 up and 27 down. So the two touch where the bamboo is 34 px to the right of the
player, 37 to the left, or 49 above or below. Facing right the sword strikes a bamboo that is between -13 and
90 px to the right and between -49 and 52 px below; its hilt is at (54, 14).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from types import ModuleType

import numpy as np

from pneuma.env import rules
from pneuma.env.fields import ENVIRONMENTS, make_env_config
from pneuma.env.worlds import Worlds

EAST = 576.0 - 22
"""Where a player's body is flush with the coast."""
TILES = 20
HEADER = 'title = "Arena"\ntile = 64\norigin = [10, 10]\ncoast = [0]\n'
START, BAMBOO, SPIRIT, RACCOON, SQUID = 400, 390, 391, 392, 393

THESIS, GODOT, ARENA = ENVIRONMENTS[:3]
DOWN, LEFT, UP, RIGHT, ATTACK = rules.DOWN, rules.LEFT, rules.UP, rules.RIGHT, rules.ATTACK
FLAME, HEAL = rules.FLAME, rules.HEAL
STAND = ATTACK  # whoever swings stands still

STATE_ARRAYS = ("worlds", "players", "monsters")
TOLD_ARRAYS = ("events", "observations", "masks")

Place = tuple[float, float]


def write_level(
    folder: Path,
    starts: Sequence[Place],
    monsters: Sequence[Place],
    obstacles: Sequence[tuple[int, int]] = (),
    codes: Sequence[int] = (),
) -> str:
    """Write a level of 20 x 20 tiles and return its path.

    Args:
        folder: where.
        starts: x and y of each start place.
        monsters: x and y of each monster.
        obstacles: columns and rows.
        codes: which kind each monster is, instead of bamboo.
    """
    folder.mkdir(parents=True, exist_ok=True)
    ground = np.zeros((TILES, TILES), np.int64)
    ground[1:-1, 1:-1] = 2
    blocks = np.full((TILES, TILES), -1, np.int64)
    for column, row in obstacles:
        blocks[row, column] = 395
    kinds = codes or [BAMBOO] * len(monsters)
    objects = [(START, *place) for place in starts]
    objects += [(code, *place) for code, place in zip(kinds, monsters, strict=True)]
    (folder / "level.toml").write_text(HEADER)
    (folder / "ground.csv").write_text(layer(ground))
    (folder / "obstacles.csv").write_text(layer(blocks))
    (folder / "objects.csv").write_text(
        "code,x,y\n" + "".join(f"{code},{x:g},{y:g}\n" for code, x, y in objects)
    )
    return str(folder)


def layer(tiles: np.ndarray) -> str:
    """Return a layer as the text of a CSV file."""
    return "".join(",".join(str(code) for code in row) + "\n" for row in tiles)


def begin(count: int, seed: int = 0, env_id: str = THESIS, **settings: object) -> Worlds:
    """Return worlds seeded seed, seed + 1, … at the beginning of an episode."""
    worlds = Worlds(count, make_env_config(settings, env_id))
    worlds.seed(range(seed, seed + count))
    worlds.reset()
    return worlds


def stage(
    level: str,
    *monsters: Place,
    players: Sequence[Place] = ((0.0, 0.0),),
    facing: int = RIGHT,
    ticks: int = 8,
    still: bool = False,
    env_id: str = THESIS,
    settings: Mapping[str, object] | None = None,
) -> Worlds:
    """Set up one world by hand: players and the first monsters at these places, other monsters at home.

    Args:
        level: the folder of a level whose other monsters live too far off to matter.
        monsters: x and y of the first of them.
        players: x and y of each player.
        facing: of every player.
        ticks: how many a step takes, instead of 8.
        still: whether monsters stay where they are unless knocked back.
        env_id: the environment whose presets hold.
        settings: other settings.
    """
    config = make_env_config({**(settings or {}), "level": level, "players": len(players)}, env_id)
    worlds = Worlds(1, config)
    worlds.seed([0])
    worlds.reset()
    worlds.settings["ticks"] = ticks
    worlds.players["x"][0], worlds.players["y"][0] = np.array(players).T
    worlds.players["facing"] = facing
    for index, place in enumerate(monsters):
        move_monster(worlds, index, *place)
    if still:
        worlds.monster_stats["speed"] = 0.0
    worlds.observe()
    return worlds


def move_monster(worlds: Worlds, index: int, x: float, y: float) -> None:
    """Put a monster of the first world somewhere."""
    worlds.monsters["x"][0, index], worlds.monsters["y"][0, index] = x, y


def play(worlds: Worlds, *actions: int) -> None:
    """Step every player of every world through the same actions."""
    for action in actions:
        worlds.step(np.full(worlds.players.shape, action, np.int64))


def player_at(worlds: Worlds, player: int = 0) -> Place:
    """Return where a player of the first world is."""
    return float(worlds.players["x"][0, player]), float(worlds.players["y"][0, player])


def monster_at(worlds: Worlds, monster: int = 0) -> Place:
    """Return where a monster of the first world is."""
    return float(worlds.monsters["x"][0, monster]), float(worlds.monsters["y"][0, monster])


def player_hp(worlds: Worlds, player: int = 0) -> float:
    """Return a player's HP in the first world."""
    return float(worlds.players["hp"][0, player])


def monster_hp(worlds: Worlds, monster: int = 0) -> float:
    """Return a monster's HP in the first world."""
    return float(worlds.monsters["hp"][0, monster])


def bits(*arrays: np.ndarray) -> list[bytes]:
    """Return every bit of some arrays, field by field: what lies between fields is nobody's."""
    fields = [array[name] for array in arrays for name in array.dtype.names or (...,)]
    return [np.ascontiguousarray(field).tobytes() for field in fields]


def state_bits(worlds: Worlds, which: object = slice(None)) -> list[bytes]:
    """Return every bit of the state of all worlds, or of some, and of what they last told."""
    return bits(*(getattr(worlds, name)[which] for name in (*STATE_ARRAYS, *TOLD_ARRAYS)))


def on_screen(pygame: ModuleType) -> np.ndarray:
    """Return what pygame's window shows, shape (height, width, 3)."""
    return np.asarray(pygame.surfarray.array3d(pygame.display.get_surface())).swapaxes(0, 1)
