"""Small levels to try the kernel on, for Hypothesis: CSV folders in which everybody lives close together."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from hypothesis import strategies as st

KINDS = {"bamboo": 390, "spirit": 391, "raccoon": 392, "squid": 393}
START, OBSTACLE, WATER, GRASS, SAND = 400, 395, 0, 2, 3
CROWD = 30

Tile = tuple[int, int]
Place = tuple[float, float]
Extent = tuple[float, float, float, float]
"""Left, top, right and bottom of a body, from its position."""


@dataclass(frozen=True)
class Map:
    """A level to be: tiles by (column, row), places in pixels from the origin."""

    columns: int = 16
    rows: int = 16
    tile: float = 64.0
    origin: tuple[float, float] = (0, 0)  # column and row of the corner where x = y = 0
    shore: int = 1  # tiles of water around
    lakes: tuple[Tile, ...] = ()
    obstacles: tuple[Tile, ...] = ()
    sand: tuple[Tile, ...] = ()
    starts: tuple[Place, ...] = ((512.0, 512.0),)
    monsters: tuple[tuple[str, float, float], ...] = ()
    clear: frozenset[Tile] = frozenset()

    def write(self, folder: Path) -> str:
        """Write the CSV layers; return the path."""
        folder.mkdir(parents=True, exist_ok=True)
        ground = np.full((self.rows, self.columns), WATER)
        shore = self.shore
        ground[shore : self.rows - shore, shore : self.columns - shore] = GRASS
        obstacles = np.full_like(ground, -1)
        layers = (ground, SAND, self.sand), (ground, WATER, self.lakes), (obstacles, OBSTACLE, self.obstacles)
        for layer, code, tiles in layers:
            for column, row in tiles:
                layer[row % self.rows, column % self.columns] = code
        for column, row in self.clear:
            ground[row, column], obstacles[row, column] = GRASS, -1
        objects = [f"{START},{x!r},{y!r}" for x, y in self.starts]
        objects += [f"{KINDS[kind]},{x!r},{y!r}" for kind, x, y in self.monsters]
        header = f"tile = {self.tile}\norigin = {[*self.origin]}\ncoast = [{WATER}]\n"
        (folder / "level.toml").write_text(header)
        (folder / "objects.csv").write_text("\n".join(["code,x,y", *objects]))
        np.savetxt(folder / "ground.csv", ground, "%d", ",")
        np.savetxt(folder / "obstacles.csv", obstacles, "%d", ",")
        return str(folder)


@st.composite
def maps(draw: st.DrawFn) -> Map:
    """Draw a level with most of its start places and monsters around one point; they may overlap."""
    least, most = draw(st.sampled_from([(12, 20), (12, 20), (6, 8)]))  # now and then hardly any room
    columns, rows = draw(st.integers(least, most)), draw(st.integers(least, most))
    tile = draw(st.sampled_from([64.0, 64.0, 40.0, 48.0, 50.5, 96.0]))
    shore = draw(st.integers(0, 2))
    tiles = st.lists(st.tuples(st.integers(0, columns - 1), st.integers(0, rows - 1)), max_size=12)
    far = (columns * tile, rows * tile)

    def within(shares: tuple[int, int]) -> Place:
        x, y = (f * share / 999 for share, f in zip(shares, far, strict=True))
        return x, y

    def near(offset: tuple[int, int]) -> Place:
        x, y = (min(max(h + third / 3, 0.0), f) for h, third, f in zip(hub, offset, far, strict=True))
        return x, y

    anywhere = st.tuples(st.integers(0, 999), st.integers(0, 999)).map(within)
    hub = draw(anywhere)
    around = st.tuples(st.integers(-450, 450), st.integers(-450, 450)).map(near)
    place = st.one_of(around, around, around, anywhere)
    starts = draw(st.lists(place, min_size=1, max_size=3))
    crowded = draw(st.sampled_from([False, False, True]))
    kinds = st.tuples(st.sampled_from(sorted(KINDS)), place)
    monsters = draw(st.lists(kinds, min_size=6 if crowded else 1, max_size=CROWD if crowded else 6))
    return Map(
        columns, rows, tile, shore=shore, lakes=tuple(draw(tiles)[:4]), obstacles=tuple(draw(tiles)),
        sand=tuple(draw(tiles)), starts=tuple(starts), monsters=tuple((kind, *at) for kind, at in monsters),
    )  # fmt: skip


def settle(level: Map, cast: Mapping[str, Any], classes: Sequence[str]) -> Map:
    """Return a level in which everybody has room: within the grid, on open tiles, and clear of others.

    Who has none where the level has him gets the nearest of some places around, or is left out. At any
    start place any of the players may begin.
    """
    bodies = [_extent(cast["players"][name]) for name in classes]
    lefts, tops, rights, bottoms = zip(*bodies, strict=True)
    player = min(lefts), min(tops), max(rights), max(bottoms)
    wanted = [("", player, place) for place in level.starts]
    wanted += [(kind, _extent(cast["monsters"][kind]), (x, y)) for kind, x, y in level.monsters]
    taken: list[tuple[str, Place, Extent]] = []
    for kind, extent, place in wanted:
        for x, y in _around(place):
            box = extent[0] + x, extent[1] + y, extent[2] + x, extent[3] + y
            if _on_grid(level, box) and not any(_overlap(box, other) for _, _, other in taken):
                taken.append((kind, (x, y), box))
                break
    tiles = [tile for _, _, box in taken for tile in _tiles(level, box)]
    return replace(
        level,
        starts=tuple(place for kind, place, _ in taken if not kind),
        monsters=tuple((kind, *place) for kind, place, _ in taken if kind),
        clear=frozenset(tiles),
    )


def _extent(character: Mapping[str, Any]) -> Extent:
    (width, height), (x, y) = character["body"], character.get("body_at", (0, 0))
    return x - width / 2, y - height / 2, x + width / 2, y + height / 2


def _around(place: Place) -> Iterator[Place]:
    """Yield a place, then others around it, further and further off."""
    yield place
    for ring in range(1, 40):
        for across, down in itertools.product((-1, 0, 1), repeat=2):
            yield place[0] + 10.3 * ring * across, place[1] + 10.3 * ring * down


def _on_grid(level: Map, box: Extent) -> bool:
    right, bottom = level.columns * level.tile, level.rows * level.tile
    return box[0] >= 0 and box[1] >= 0 and box[2] <= right and box[3] <= bottom


def _overlap(one: Extent, other: Extent) -> bool:
    return one[0] < other[2] and other[0] < one[2] and one[1] < other[3] and other[1] < one[3]


def _tiles(level: Map, box: Extent) -> Iterator[Tile]:
    """Yield the tiles that a box lies on or touches."""
    first, above, last, below = (int(side // level.tile) for side in box)
    for column in range(first, min(last, level.columns - 1) + 1):
        for row in range(above, min(below, level.rows - 1) + 1):
            yield column, row
