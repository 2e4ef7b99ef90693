"""Small levels to try the kernel on, for Hypothesis: CSV folders in which everybody lives close together."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from hypothesis import strategies as st

KINDS = {"bamboo": 390, "spirit": 391, "raccoon": 392, "squid": 393}
START, OBSTACLE, WATER, GRASS = 400, 395, 0, 2
CROWD = 30
REACH = 47.5
"""No drawn body reaches further from the middle of the square in which it begins."""
CELL = 2 * REACH

Tile = tuple[int, int]
Place = tuple[float, float]


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
        for layer, code, tiles in ((ground, WATER, self.lakes), (obstacles, OBSTACLE, self.obstacles)):
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
    """Draw a level whose start places and monsters are around one point, with some room between."""
    least, most = draw(st.sampled_from([(12, 20), (12, 20), (6, 8)]))  # now and then hardly any room
    columns, rows = draw(st.integers(least, most)), draw(st.integers(least, most))
    tile = draw(st.sampled_from([64.0, 64.0, 40.0, 48.0, 50.5, 96.0]))
    tiles = st.lists(st.tuples(st.integers(0, columns - 1), st.integers(0, rows - 1)), max_size=12)
    across, down = int(columns * tile / CELL), int(rows * tile / CELL)
    x, y = draw(st.integers(0, across - 1)), draw(st.integers(0, down - 1))
    cells = sorted(np.ndindex(across, down), key=lambda cell: max(abs(cell[0] - x), abs(cell[1] - y)))
    crowded = draw(st.sampled_from([False, False, True]))
    count = draw(st.integers(2, min(CROWD if crowded else 8, len(cells))))
    off_centre = st.integers(-9, 9).map(lambda third: CELL / 2 + third / 3)
    chosen = draw(st.permutations(cells[: 3 * count // 2]))[:count]
    places = [(column * CELL + draw(off_centre), row * CELL + draw(off_centre)) for column, row in chosen]
    starts = draw(st.integers(1, min(3, count - 1)))
    kinds = st.sampled_from(sorted(KINDS))
    corners = itertools.product((-REACH, -REACH / 3, REACH / 3, REACH), repeat=2)
    under = [
        (min(max(int((x + dx) // tile), 0), columns - 1), min(max(int((y + dy) // tile), 0), rows - 1))
        for dx, dy in corners
        for x, y in places
    ]
    return Map(
        columns, rows, tile, shore=draw(st.integers(0, 2)), lakes=tuple(draw(tiles)[:4]),
        obstacles=tuple(draw(tiles)), starts=tuple(places[:starts]),
        monsters=tuple((draw(kinds), *place) for place in places[starts:]), clear=frozenset(under),
    )  # fmt: skip
