"""Between `Worlds` and the oracle: reads what the oracle is given, plays both, and compares them.

Everything is compared field by field and bit by bit (0.0 is not -0.0, 1 is not 1.0), observations as
float32. Of the eight entries that a monster keeps for players, those of existing players count.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from pneuma.env.rules import COAST, SOLID
from pneuma.env.worlds import Worlds

from .oracle import Events, Ground, Oracle, Row
from .oracle_view import mask, observe

SETS = ("noticed", "inside")
"""Sets of players, which the kernel keeps as bits."""


def read_rulebook(worlds: Worlds) -> Row:
    """Read what does not change: the configuration, and numbers from the arrays that `Worlds` made.

    Rewards and stats are of each player; codes of tiles stop players and monsters; the last four go by level.

    The kernel's switches and shortcuts, which `Worlds` makes of the configuration, are not read.
    """
    config, settings = worlds.config, _read_row(worlds.settings[0])
    closed = {COAST}
    if config.trees == "wall":
        closed.add(SOLID)
    closed_to_monsters = closed
    if config.terrain_stops == "players":
        closed_to_monsters = set()
    rewards = config.reward
    if len(rewards) == 1:
        rewards *= config.players
    left, top = settings.corner
    return Row(
        config=config,
        actions=worlds.action_names,
        rewards=rewards,
        closed_to_players=frozenset(closed),
        closed_to_monsters=frozenset(closed_to_monsters),
        settings=settings,
        stats=[_read_row(stats) for stats in worlds.player_stats],
        monster_stats=[[_read_row(stats) for stats in level_stats] for level_stats in worlds.monster_stats],
        grounds=[Ground((left, top), settings.tile, level.terrain.tolist()) for level in worlds.levels],
        starts=[[(x, y) for x, y in level.starts.tolist()] for level in worlds.levels],
        homes=[[(x, y) for _, x, y in level.monsters] for level in worlds.levels],
    )


def _read_row(row: Any) -> Row:
    fields = {}
    for name in row.dtype.names:
        value = row[name]
        fields[name] = _read_row(value) if value.dtype.names else value.tolist()
    return Row(**fields)


class Pair:
    """Worlds of the kernel and their oracles, played alike; every call ends with a comparison.

    `views` is what each oracle's players observed last, and which actions they may take.
    """

    def __init__(self, worlds: Worlds, seed: int = 0) -> None:
        self.worlds = worlds
        worlds.seed(range(seed, seed + len(worlds)))
        rulebook = read_rulebook(worlds)
        self.oracles = [Oracle(rulebook, int(key)) for key in worlds.worlds["key"]]
        self.views: list[list[tuple[list[float], list[int]]]] = [[] for _ in self.oracles]
        self.reset(range(len(worlds)))

    def reset(self, indices: Iterable[int], start: int | None = None, seed: int | None = None) -> None:
        """Begin an episode in some worlds, seeded again if asked for."""
        worlds = self.worlds
        resets = np.zeros(len(worlds), bool)
        resets[list(indices)] = True
        if seed is not None:
            worlds.seed([seed + index if resets[index] else None for index in range(len(worlds))])
        if start is None:
            start = -1 if worlds.config.start == "random" else 0
        worlds.reset(resets, np.full(len(worlds), start))
        for index in np.flatnonzero(resets).tolist():
            if seed is not None:
                self.oracles[index].seed(int(worlds.worlds["key"][index]))
            self.oracles[index].reset(start)
            self._look(index)
        self.compare("after a reset")

    def step(self, actions: np.ndarray) -> None:
        """Play one step in all worlds; actions (N, P)."""
        ended = self.worlds.step(actions)
        for index, world in enumerate(self.oracles):
            running = world.ending == 0
            ended -= world.step(actions[index].tolist())
            if running:
                self._look(index)
                world.reward()
        assert ended == 0, "another number of episodes ended"
        self.compare(f"after actions {actions.tolist()}")

    def play(self, *actions: int | Sequence[int]) -> None:
        """Play steps of one action for everybody, or one for each player."""
        for action in actions:
            self.step(np.broadcast_to(action, self.worlds.players.shape))

    def player(self, name: str) -> list[Any]:
        """Return a field of the first world's players, or of their events."""
        array = self.worlds.players
        if name in (self.worlds.events.dtype.names or ()):
            array = self.worlds.events
        return list(array[name][0].tolist())

    def monster(self, *names: str) -> tuple[Any, ...]:
        """Return fields of the first world's first monster."""
        return tuple(self.worlds.monsters[name][0, 0].tolist() for name in names)

    def put(self, monsters: bool = False, **fields: Any) -> None:
        """Write fields of the first world's players, or monsters, by hand: a number for all, or a list."""
        bodies = self.worlds.monsters if monsters else self.worlds.players
        for name, values in fields.items():
            count = len(values) if np.ndim(values) else None
            bodies[name][0, :count] = values
        self.take_over()

    def take_over(self) -> None:
        """Let the oracles go on from the kernel's state; what happened before is forgotten by both."""
        worlds = self.worlds
        worlds.events[:] = np.zeros((), worlds.events.dtype)
        worlds.observe()
        for index, world in enumerate(self.oracles):
            _copy_fields(world, worlds.worlds[index])
            for player, row in zip(world.players, worlds.players[index], strict=True):
                _copy_fields(player, row)
                player.events = Events()
            for monster, row in zip(world.monsters, worlds.monsters[index], strict=True):
                _copy_fields(monster, row)
                for name in SETS:
                    players = range(len(world.players))
                    setattr(monster, name, {player for player in players if int(row[name]) >> player & 1})
            self._look(index)
        self.compare("after a change by hand")

    def compare(self, when: str) -> None:
        """Assert that everything that can be read is equal."""
        differences: list[str] = []
        for index in range(len(self.oracles)):
            differences += self._differences(index)
        assert not differences, "\n".join([f"{when} (kernel, oracle):", *differences])

    def _look(self, index: int) -> None:
        world = self.oracles[index]
        self.views[index] = [(observe(world, player), mask(world, player)) for player in world.players]

    def _differences(self, index: int) -> Iterator[str]:
        worlds, world = self.worlds, self.oracles[index]
        yield from _unlike(f"worlds[{index}]", worlds.worlds[index], vars(world))
        for player_index, player in enumerate(world.players):
            slot = (index, player_index)
            yield from _unlike(f"players{slot}", worlds.players[slot], vars(player))
            yield from _unlike(f"events{slot}", worlds.events[slot], vars(player.events))
            numbers, allowed = self.views[index][player_index]
            view = np.array(numbers, np.float32)
            if view.tobytes() != worlds.observations[slot].tobytes():
                yield f"observations{slot}: {worlds.observations[slot].tolist()}, {view.tolist()}"
            if allowed != worlds.masks[slot].tolist():
                yield f"masks{slot}: {worlds.masks[slot].tolist()}, {allowed}"
        for monster_index, monster in enumerate(world.monsters):
            bits = {name: sum(1 << player for player in getattr(monster, name)) for name in SETS}
            row = worlds.monsters[index, monster_index]
            yield from _unlike(f"monsters{index, monster_index}", row, vars(monster) | bits)


def _copy_fields(target: Any, row: Any) -> None:
    for name in row.dtype.names:
        if hasattr(target, name):
            setattr(target, name, row[name].tolist())


def _unlike(name: str, row: Any, expected: dict[str, Any]) -> Iterator[str]:
    """Yield the fields of a row that differ from the oracle's."""
    for field, value in zip(row.dtype.names, row.tolist(), strict=True):
        if isinstance(value, (np.ndarray, list)):
            value = [int(item) for item in value][: len(expected[field])]
        if repr(value) != repr(expected[field]):
            yield f"{name}.{field}: {value}, {expected[field]}"
