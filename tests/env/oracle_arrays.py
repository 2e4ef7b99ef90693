"""Between `Worlds` and the oracle: reads what the oracle is given, plays both, and compares what they say.

Everything is compared field by field and bit by bit (0.0 is not -0.0, 1 is not 1.0), observations as
float32. Of the eight places that a monster keeps for players, those of existing players count.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np

from pneuma.env.rules import COAST, SOLID
from pneuma.env.worlds import Worlds

from .oracle import Oracle
from .oracle_moves import Ground
from .oracle_parts import Events, Row, Rulebook
from .oracle_view import mask, observe

SETS = ("noticed", "inside")
"""Sets of players, which the kernel keeps as bits."""


def read_rulebook(worlds: Worlds) -> Rulebook:
    """Read what does not change: the configuration, and numbers from the arrays that `Worlds` made.

    The kernel's switches and shortcuts, which `Worlds` makes of the configuration, go unread.
    """
    config, row = worlds.config, worlds.settings[0]
    left, top = row["corner"].tolist()
    trees = {SOLID} if config.trees == "wall" else set()
    return Rulebook(
        config=config,
        actions=worlds.action_names,
        rewards=config.reward if len(config.reward) > 1 else config.reward * config.players,
        closed_to_players=frozenset(trees | {COAST}),
        closed_to_monsters=frozenset(trees | {COAST} if config.terrain_stops == "all" else ()),
        settings=_read_row(row),
        stats=[_read_row(stats) for stats in worlds.player_stats],
        kinds=[[_read_row(kind) for kind in level] for level in worlds.monster_stats],
        grounds=[Ground(left, top, float(row["tile"]), level.terrain.tolist()) for level in worlds.levels],
        starts=[[(x, y) for x, y in level.starts.tolist()] for level in worlds.levels],
        homes=[[(x, y) for _, x, y in level.monsters] for level in worlds.levels],
    )


def _read_row(row: Any) -> Row:
    fields = {name: row[name] for name in row.dtype.names}
    return Row(**{name: _read_row(of) if of.dtype.names else of.tolist() for name, of in fields.items()})


def _read_fields(target: Any, row: Any) -> None:
    for name in row.dtype.names:
        if hasattr(target, name):
            setattr(target, name, row[name].tolist())


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
        book = read_rulebook(worlds)
        self.oracles = [Oracle(book, int(key)) for key in worlds.worlds["key"]]
        self.seen: list[list[tuple[list[float], list[int]]]] = [[] for _ in self.oracles]
        self.reset(range(len(worlds)))

    def reset(self, chosen: Iterable[int], start: int | None = None, seed: int | None = None) -> None:
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

    def play(self, *actions: int | Sequence[int]) -> None:
        """Play steps of one action for everybody, or one for each player."""
        for action in actions:
            self.step(np.broadcast_to(action, self.worlds.players.shape))

    def told(self, name: str) -> list[Any]:
        """Return a field of the first world's players, or of their events."""
        array = self.worlds.events if name in (self.worlds.events.dtype.names or ()) else self.worlds.players
        return list(array[name][0].tolist())

    def monster(self, *names: str) -> tuple[Any, ...]:
        """Return fields of the first world's first monster."""
        return tuple(self.worlds.monsters[name][0, 0].tolist() for name in names)

    def put(self, monsters: bool = False, **fields: Any) -> None:
        """Write fields of the first world's players, or monsters, by hand: a number for all, or a list."""
        for name, values in fields.items():
            bodies = self.worlds.monsters if monsters else self.worlds.players
            many = np.atleast_1d(np.asarray(values))
            bodies[name][0, : len(many) if np.ndim(values) else None] = many
        self.take_over()

    def take_over(self) -> None:
        """Let the oracles go on from the kernel's state; what happened before is forgotten by both."""
        worlds = self.worlds
        worlds.events[:] = np.zeros((), worlds.events.dtype)
        worlds.observe()
        for index, world in enumerate(self.oracles):
            _read_fields(world, worlds.worlds[index])
            for player, row in zip(world.players, worlds.players[index], strict=True):
                _read_fields(player, row)
                player.events = Events()
            for monster, row in zip(world.monsters, worlds.monsters[index], strict=True):
                _read_fields(monster, row)
                for name in SETS:
                    players = range(len(world.players))
                    setattr(monster, name, {p for p in players if int(row[name]) >> p & 1})
            self._look(index)
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
            bits = {name: sum(1 << p for p in getattr(monster, name)) for name in SETS}
            yield from _unlike(f"monsters[{index}, {m}]", worlds.monsters[index, m], vars(monster) | bits)


def _unlike(name: str, row: Any, told: dict[str, Any]) -> Iterator[str]:
    """Tell the fields of a row that the oracle tells otherwise."""
    for field, value in zip(row.dtype.names, row.tolist(), strict=True):
        if isinstance(value, (np.ndarray, list)):
            value = [int(item) for item in value][: len(told[field])]
        if repr(value) != repr(told[field]):
            yield f"{name}.{field}: {value}, {told[field]}"
