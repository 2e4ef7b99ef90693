"""What has just happened in a world and passes within a second: spells, deaths and XP gained.

The state says where everybody is, but not who died in this step, or which spell was cast. So whoever draws
compares each state with the one drawn before it. Where none was, or a new episode has begun, nothing shows.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from pneuma.env.worlds import Worlds

DEATH_TICKS = 24
"""How long a monster's death shows."""
XP_TICKS = 45
"""How long XP gained show."""


@dataclass(frozen=True)
class Effect:
    """Something that shows for some ticks; a place and lengths in pixels.

    Attributes:
        kind: "death", "xp", "flame" or "heal".
        began: tick of the episode.
        ticks: how long it shows.
        x, y: where: the player or monster, or the middle of the box that burns.
        width, height: of what burns.
        xp: those gained.
    """

    kind: str
    began: int
    ticks: int
    x: float
    y: float
    width: float = 0.0
    height: float = 0.0
    xp: float = 0.0


class Effects:
    """The effects that show in one world, by the states seen so far."""

    def __init__(self, worlds: Worlds, world: int) -> None:
        self._worlds, self._world = worlds, world
        self._tick = -1
        self._players, self._monsters = worlds.players[world].copy(), worlds.monsters[world].copy()
        self._showing: list[Effect] = []

    def look(self) -> list[tuple[Effect, int]]:
        """Compare the state with the one seen before; return what shows now, and since how many ticks."""
        players, monsters = self._worlds.players[self._world], self._worlds.monsters[self._world]
        tick = int(self._worlds.worlds["steps"][self._world]) * int(self._worlds.settings["ticks"][0])
        risen = ((monsters["hp"] > 0) & (self._monsters["hp"] <= 0)).any()
        if tick < self._tick or risen:  # another episode
            self._showing = []
        elif 0 <= self._tick < tick:
            self._showing += [*self._spells(tick), *self._deaths(tick), *self._gains(tick)]
        self._tick, self._players, self._monsters = tick, players.copy(), monsters.copy()
        self._showing = [effect for effect in self._showing if tick - effect.began < effect.ticks]
        return [(effect, tick - effect.began) for effect in self._showing]

    def _spells(self, tick: int) -> Iterator[Effect]:
        """Yield the spells that have begun: a flame counts as an attack, healing does not."""
        before = self._players
        for player, was, stats in zip(
            self._worlds.players[self._world], before, self._worlds.player_stats, strict=True
        ):
            casts = player["hp"] > 0 and player["busy"] > 0 and player["armed"] == 0
            if not casts or (was["armed"] == 0 and player["busy"] <= was["busy"]):
                continue
            if player["attack"] == was["attack"]:
                ticks = int(stats["heal_ticks"])
                yield Effect("heal", tick - ticks + int(player["busy"]), ticks, player["x"], player["y"])
                continue
            ticks, facing = int(stats["flame_ticks"]), player["facing"]
            yield Effect(
                "flame",
                tick - ticks + int(player["busy"]),
                ticks,
                player["x"] + stats["flame_x"][facing],
                player["y"] + stats["flame_y"][facing],
                width=2 * stats["flame_half_width"][facing],
                height=2 * stats["flame_half_height"][facing],
            )

    def _deaths(self, tick: int) -> Iterator[Effect]:
        monsters = self._worlds.monsters[self._world]
        for monster in monsters[(monsters["hp"] <= 0) & (self._monsters["hp"] > 0)]:
            yield Effect("death", tick, DEATH_TICKS, monster["x"], monster["y"])

    def _gains(self, tick: int) -> Iterator[Effect]:
        players = self._worlds.players[self._world]
        gains = players["xp"] - self._players["xp"]
        for index in np.flatnonzero(gains > 0):
            player = players[index]
            yield Effect("xp", tick, XP_TICKS, player["x"], player["y"], xp=float(gains[index]))
