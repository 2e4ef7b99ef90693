"""Two players that anchor every scale: the uniformly random one and the scripted hunter.

A player chooses actions for all worlds at once, from their state; score 0 is the random one's,
score 1 the hunter's.
"""

from __future__ import annotations

import numpy as np

from pneuma.env import rules
from pneuma.env.characters import TICKS_PER_STEP
from pneuma.env.paths import Body, Plan, Ways, spot
from pneuma.env.worlds import Worlds

FARTHEST = 1e6
"""Beyond every way that can be walked: monsters that cannot be reached come last."""


class RandomPlayer:
    """Chooses every action with equal probability, from the generator it is given."""

    def __init__(self, generator: np.random.Generator) -> None:
        self.generator = generator

    def act(self, worlds: Worlds) -> np.ndarray:
        """Return (N, P) actions."""
        return self.generator.integers(int(worlds.action_space.n), size=worlds.players.shape)


class Hunter:
    """Walks to the living monster nearest on foot and strikes whenever the sword would meet one.

    From afar it follows a way over the level's tiles (`pneuma.env.paths`). Near by it lines up on one
    axis, steps back from a monster that is too close for the sword, and goes across for a few steps
    when something is in the way. It knows the whole state, not only what a player observes.
    """

    SIDE_STEPS = 4
    BACK_STEPS = 2
    NEAR_PIXELS = 128.0
    """On foot; nearer monsters are walked to straight on."""

    def __init__(self, worlds: Worlds) -> None:
        self._left_off = np.full((2, *worlds.players.shape), np.nan)  # where the last walk began
        self._detour = np.zeros(worlds.players.shape, np.int64)  # steps left of a way round
        self._way = np.zeros(worlds.players.shape, np.int64)
        self._seen = np.full((2, *worlds.monsters.shape), np.nan)  # where awake monsters last were
        self._plans: dict[tuple[int, int], Plan] = {}
        stops, sea = int(worlds.settings["player_stops"][0]), worlds.config.coast == "deadly"
        bodies = {_body(row) for row in worlds.player_stats}
        self._ways = {body: Ways(worlds.levels, body, stops, sea) for body in bodies}

    def act(self, worlds: Worlds) -> np.ndarray:
        """Return (N, P) actions."""
        self._begin_again(worlds.worlds["steps"] == 0)
        alive = worlds.monsters["hp"][:, None, :] > 0
        free = (worlds.players["busy"] == 0) & (worlds.players["hp"] > 0) & alive.any(axis=-1)
        free &= (worlds.worlds["ending"] == 0)[:, None]
        actions = self._choose(worlds, alive, free) if free.any() else free
        self._left_off[:, ~free] = np.nan
        awake = worlds.monsters["noticed"] > 0
        for axis, name in enumerate("xy"):
            self._seen[axis] = np.where(awake, worlds.monsters[name], np.nan)
        return np.where(free, actions, rules.ATTACK)

    def _choose(self, worlds: Worlds, alive: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Return actions, of which those of the players that are free to act count."""
        x, y = _offsets(worlds)
        on_foot = self._lengths(worlds)
        order = np.where(np.isfinite(on_foot), on_foot, FARTHEST + np.hypot(x, y))
        nearest = np.where(alive, order, np.inf).argmin(axis=-1)[..., None]
        dx, dy, length = (np.take_along_axis(each, nearest, -1)[..., 0] for each in (x, y, on_foot))
        strike = (self._meets_sword(worlds, x, y) & alive).any(axis=-1)
        walks = free & ~strike
        far = (length * worlds.level.tile > self.NEAR_PIXELS) & np.isfinite(length) | self._under_way(worlds)
        walk = self._walk(worlds, dx, dy, walks, far)
        self._left_off = np.where(walks, [worlds.players["x"], worlds.players["y"]], np.nan)
        for world, player in np.argwhere(far & walks & (self._detour == 0)).tolist():
            action = self._follow(worlds, world, player, int(nearest[world, player, 0]))
            if action is not None:
                walk[world, player] = action
        if worlds.config.coast == "deadly":
            self._keep_ashore(worlds, walk, walks)
        return np.where(strike, rules.ATTACK, walk)

    def _keep_ashore(self, worlds: Worlds, walk: np.ndarray, may_walk: np.ndarray) -> None:
        """Let players strike where they stand whose next step would drown them."""
        for world, player in np.argwhere(may_walk).tolist():
            row, level = worlds.players[world, player], int(worlds.worlds["level"][world])
            place, way = (float(row["x"]), float(row["y"])), int(walk[world, player])
            if self._ways_of(worlds, player).step(level, place, way, _reach(worlds, player)) is None:
                walk[world, player] = rules.ATTACK

    def _begin_again(self, fresh: np.ndarray) -> None:
        """Forget what concerns the worlds whose episodes have only just begun, (N,)."""
        if fresh.any():
            self._left_off[:, fresh], self._seen[:, fresh], self._detour[fresh] = np.nan, np.nan, 0
            self._plans = {key: plan for key, plan in self._plans.items() if not fresh[key[0]]}

    def _lengths(self, worlds: Worlds) -> np.ndarray:
        """Return how many tiles every player has to walk to every monster, (N, P, M)."""
        level = worlds.worlds["level"].astype(np.int64)
        monsters, players = worlds.monsters, worlds.players
        return np.stack(
            [
                self._ways_of(worlds, p).lengths(
                    level, monsters["x"], monsters["y"], players["x"][:, p], players["y"][:, p]
                )
                for p in range(players.shape[1])
            ],
            axis=1,
        )

    def _under_way(self, worlds: Worlds) -> np.ndarray:
        """Return who is in the middle of a plan, which is walked to its end, (N, P)."""
        flags = np.zeros(worlds.players.shape, bool)
        x, y = worlds.players["x"], worlds.players["y"]
        for key, plan in self._plans.items():
            flags[key] = spot((x[key], y[key])) in plan
        return flags

    def _ways_of(self, worlds: Worlds, player: int) -> Ways:
        return self._ways[_body(worlds.player_stats[player])]

    def _follow(self, worlds: Worlds, world: int, player: int, monster: int) -> int | None:
        """Return the next step of the plan, of a new one where the last is at its end."""
        row, prey = worlds.players[world, player], worlds.monsters[world, monster]
        place = float(row["x"]), float(row["y"])
        plan = self._plans.get((world, player), {})
        if spot(place) not in plan:
            level, goal = int(worlds.worlds["level"][world]), (float(prey["x"]), float(prey["y"]))
            ways, reach = self._ways_of(worlds, player), _reach(worlds, player)
            plan = self._plans[world, player] = ways.plan(level, place, goal, reach)
        return plan.get(spot(place))

    def _walk(
        self, worlds: Worlds, dx: np.ndarray, dy: np.ndarray, walks: np.ndarray, far: np.ndarray
    ) -> np.ndarray:
        """Return the way to walk to a monster at (dx, dy), or for a while some other way.

        Only those who walk this time, (N, P) booleans, come any further with going round something;
        those far off have a plan to go back to.
        """
        along_x = np.where(dx > 0, rules.RIGHT, rules.LEFT)
        along_y = np.where(dy > 0, rules.DOWN, rules.UP)
        sideways = np.abs(dx) > np.maximum(np.abs(dy), worlds.player_stats["sword_half_width"][:, rules.UP])
        straight, across = np.where(sideways, along_x, along_y), np.where(sideways, along_y, along_x)
        stand_off = worlds.monster_stats["stand_off"].max(initial=0.0)
        crowded = walks & (np.abs(dx) <= stand_off) & (np.abs(dy) <= stand_off)
        self._go_round(worlds, walks, crowded, far, back=(along_y + 2) % 4, across=across)
        return np.where(self._detour > 0, self._way, straight)

    def _go_round(
        self,
        worlds: Worlds,
        walks: np.ndarray,
        crowded: np.ndarray,
        far: np.ndarray,
        back: np.ndarray,
        across: np.ndarray,
    ) -> None:
        """Begin, go on with and end detours: back from a monster too close to strike, across where stopped.

        A detour that is stopped as well turns round, or, once it has led past what was in the way of one
        far off, is over. All are (N, P): who walks, who is crowded, who is far off, and the ways.
        """
        crowded = crowded & (self._detour == 0)
        stopped = (worlds.players["x"] == self._left_off[0]) & (worlds.players["y"] == self._left_off[1])
        stopped &= walks
        again = stopped & (self._detour > 0)
        over = again & far & (self._detour < self.SIDE_STEPS)
        self._detour = np.maximum(self._detour - walks, 0)
        self._detour[crowded], self._detour[stopped] = self.BACK_STEPS, self.SIDE_STEPS
        self._way = np.where(crowded, back, self._way)
        self._detour[over] = 0
        self._way = np.where(again, (self._way + 2) % 4, np.where(stopped, across, self._way))

    def _meets_sword(self, worlds: Worlds, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Tell which monsters a swing begun now would meet, the way the player faces: (N, P, M).

        One that is awake comes closer meanwhile, on each axis on which nothing holds it up.
        """
        facing = worlds.players["facing"]
        player = np.arange(facing.shape[1])
        stats = _kinds(worlds)
        monsters = worlds.monsters
        awake = monsters["noticed"] > 0
        meets = np.ones(x.shape, bool)
        for i, (between, axis, side) in enumerate(((x, "x", "width"), (y, "y", "height"))):
            centre = worlds.player_stats[f"sword_{axis}"][player, facing][..., None]  # (N, P, 1)
            half = worlds.player_stats[f"sword_half_{side}"][player, facing][..., None]
            comes = awake & (monsters[axis] != self._seen[i])
            after = np.where(comes[:, None, :], _come_closer(worlds, between), between)
            low, high = np.minimum(between, after), np.maximum(between, after)
            middle, body = stats[f"body_{axis}"], stats[f"half_{side}"]
            meets &= (low + middle - body < centre + half) & (high + middle + body > centre - half)
        return meets


def _body(stats: np.void) -> Body:
    return Body(*(float(stats[name]) for name in ("half_width", "half_height", "body_x", "body_y")))


def _reach(worlds: Worlds, player: int) -> float:
    """Return how far a player walks in one step."""
    return float(worlds.player_stats["speed"][player]) * TICKS_PER_STEP


def _kinds(worlds: Worlds) -> np.ndarray:
    """Return the stats of every monster on its world's level, (N, 1, M)."""
    return np.asarray(worlds.monster_stats[worlds.worlds["level"]][:, None, :])


def _offsets(worlds: Worlds) -> tuple[np.ndarray, np.ndarray]:
    """Return x and y from every player to every monster, each (N, P, M)."""
    monsters, players = worlds.monsters[:, None, :], worlds.players[:, :, None]
    return monsters["x"] - players["x"], monsters["y"] - players["y"]


def _come_closer(worlds: Worlds, offset: np.ndarray) -> np.ndarray:
    """Return where, on one axis, a chasing monster is after two thirds of a swing."""
    stats = _kinds(worlds)
    way = stats["speed"] * worlds.player_stats["swing"].min() * 2 / 3
    closer = np.maximum(np.abs(offset) - way, stats["stand_off"])
    return np.where(np.abs(offset) > stats["stand_off"], np.sign(offset) * closer, offset)
