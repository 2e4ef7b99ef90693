"""Between `Worlds` and the oracle: reads what the oracle is given, and compares what both say.

Everything is compared field by field and bit by bit (0.0 is not -0.0, 1 is not 1.0), observations as
float32. Of the eight places that a monster keeps for players, those of existing players count.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from pneuma.env.worlds import Worlds

from .oracle import Oracle
from .oracle_moves import Ground
from .oracle_parts import Events, Monster, Player, Row, Rulebook
from .oracle_view import mask, observe

# --- From arrays -------------------------------------------------------------------------------------


def make_oracles(worlds: Worlds) -> list[Oracle]:
    """Return an oracle for each world, before its first reset."""
    book = read_rulebook(worlds)
    return [Oracle(book, int(key)) for key in worlds.worlds["key"]]


def read_rulebook(worlds: Worlds) -> Rulebook:
    """Read what does not change from the arrays that `Worlds` made; the kernel's shortcuts go unread."""
    row = worlds.settings[0]
    corner = float(row["left"]), float(row["top"]), float(row["tile"])
    return Rulebook(
        settings=_read_row(row, actions=int(worlds.action_space.n)),
        stats=[_read_row(stats) for stats in worlds.player_stats],
        stats_of_second_weapons=[_read_row(stats) for stats in _armed_otherwise(worlds)],
        kinds=[[_read_row(kind) for kind in level] for level in worlds.monster_stats],
        grounds=[Ground(*corner, level.terrain.tolist()) for level in worlds.levels],
        starts=[[(x, y) for x, y in level.starts.tolist()] for level in worlds.levels],
        homes=[[(x, y) for _, x, y in level.monsters] for level in worlds.levels],
    )


def _armed_otherwise(worlds: Worlds) -> np.ndarray:
    """Return the stats of players whose usual weapon is what the others have as their second."""
    config = worlds.config
    if not config.second_weapon:
        return worlds.player_stats
    return Worlds(1, replace(config, weapons=(config.second_weapon,), second_weapon="")).player_stats


def read_state(world: Oracle, worlds: Worlds, index: int) -> None:
    """Let an oracle go on from the state of a world; what happened before is forgotten by both."""
    for name in ("key", "draws", "steps", "level", "start", "monsters_left", "players_left", "ending"):
        setattr(world, name, int(worlds.worlds[name][index]))
    for player, row in zip(world.players, worlds.players[index], strict=True):
        _read_fields(player, row, ())
    for monster, kind, row in zip(
        world.monsters, world.book.kinds[world.level], worlds.monsters[index], strict=True
    ):
        _read_fields(monster, row, ("noticed", "bite", "struck_by", "inside"))
        count = len(world.players)
        monster.kind = kind
        monster.noticed = {p for p in range(count) if int(row["noticed"]) >> p & 1}
        monster.inside = {p for p in range(count) if int(row["inside"]) >> p & 1}
        monster.bite, monster.struck_by = row["bite"].tolist()[:count], row["struck_by"].tolist()[:count]
    worlds.events[index] = np.zeros((), worlds.events.dtype)
    worlds.events["distance"][index] = np.inf
    for player in world.players:
        player.events = Events()


def _read_row(row: Any, **beside: Any) -> Row:
    fields = {name: row[name] for name in row.dtype.names}
    told = {name: _read_row(part) if part.dtype.names else part.tolist() for name, part in fields.items()}
    return Row(**told, **beside)


def _read_fields(target: Player | Monster, row: Any, but: tuple[str, ...]) -> None:
    for name in row.dtype.names:
        if name not in but:
            setattr(target, name, row[name].tolist())


# --- Side by side ------------------------------------------------------------------------------------


class Pair:
    """Worlds of the kernel and their oracles, played alike; every call ends with a comparison.

    Attributes:
        worlds: the kernel's.
        oracles: one for each of them.
        seen: what each oracle's players saw last, and which actions they may take.
    """

    def __init__(self, worlds: Worlds, seed: int = 0) -> None:
        self.worlds = worlds
        worlds.seed(range(seed, seed + len(worlds)))
        self.oracles = make_oracles(worlds)
        self.seen: list[list[tuple[list[float], list[int]]]] = [[] for _ in self.oracles]
        self.reset(range(len(worlds)))

    def reset(self, chosen: Any, start: int | None = None, seed: int | None = None) -> None:
        """Begin an episode in some worlds, seeded anew if asked for."""
        mask = np.zeros(len(self.worlds), bool)
        mask[list(chosen)] = True
        starts = None if start is None else np.full(len(self.worlds), start)
        if seed is not None:
            self.worlds.seed(range(seed, seed + len(self.worlds)), mask)
        self.worlds.reset(mask, starts)
        usual = -1 if self.worlds.config.start == "random" else 0
        for index in np.flatnonzero(mask).tolist():
            if seed is not None:
                self.oracles[index].seed(int(self.worlds.worlds["key"][index]))
            self.oracles[index].reset(usual if start is None else start)
            self._look(index)
        self.compare("after a reset")

    def step(self, actions: np.ndarray) -> None:
        """Play one step in all worlds; actions (N, P)."""
        ended = self.worlds.step(actions)
        count = 0
        for index, world in enumerate(self.oracles):
            running = world.ending == 0
            count += world.step(actions[index].tolist())
            if running:
                self._look(index)
                world.reward()
        assert ended == count, "another number of episodes ended"
        self.compare(f"after actions {actions.tolist()}")

    def take_over(self) -> None:
        """Let the oracles go on from the kernel's state, after it was changed by hand."""
        for index, world in enumerate(self.oracles):
            read_state(world, self.worlds, index)
            self._look(index)
        self.worlds.observe()
        self.compare("after a change by hand")

    def compare(self, when: str) -> None:
        """Assert that everything that can be read is equal."""
        different = [line for index in range(len(self.oracles)) for line in self._differences(index)]
        assert not different, "\n".join([f"{when} (kernel, oracle):", *different])

    def _look(self, index: int) -> None:
        world = self.oracles[index]
        self.seen[index] = [(observe(world, player), mask(world, player)) for player in world.players]

    def _differences(self, index: int) -> Iterator[str]:
        worlds, world = self.worlds, self.oracles[index]
        yield from _unlike(f"worlds[{index}]", worlds.worlds[index], vars(world))
        for p, player in enumerate(world.players):
            place = f"[{index}, {p}]"
            yield from _unlike(f"players{place}", worlds.players[index, p], vars(player))
            yield from _unlike(f"events{place}", worlds.events[index, p], vars(player.events))
            numbers, allowed = self.seen[index][p]
            view = np.array(numbers, np.float32)
            if view.tobytes() != worlds.observations[index, p].tobytes():
                yield f"observations{place}: {worlds.observations[index, p].tolist()}, {view.tolist()}"
            if allowed != worlds.masks[index, p].tolist():
                yield f"masks{place}: {worlds.masks[index, p].tolist()}, {allowed}"
        for m, monster in enumerate(world.monsters):
            told = {
                **vars(monster),
                **{name: _as_bits(getattr(monster, name)) for name in ("noticed", "inside")},
            }
            yield from _unlike(f"monsters[{index}, {m}]", worlds.monsters[index, m], told)


def _as_bits(players: set[int]) -> int:
    return sum(1 << p for p in players)


def _unlike(name: str, row: Any, told: dict[str, Any]) -> Iterator[str]:
    """Tell the fields of a row that the oracle tells otherwise."""
    for field, value in zip(row.dtype.names, row.tolist(), strict=True):
        if isinstance(value, (np.ndarray, list)):
            value = list(value)[: len(told[field])]
            value = [int(item) for item in value]
        if repr(value) != repr(told[field]):
            yield f"{name}.{field}: {value}, {told[field]}"
