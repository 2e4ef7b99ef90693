"""The oracle: the rules of one world, told slowly and tick by tick, in plain Python, to be read.

The compiled kernel (`pneuma/env/rules.py`) plays the same game; `test_oracle.py` holds it to this
telling, bit for bit. Nothing here is fast, and nothing is left out: every monster lives through every
tick, every move is checked tile by tile and body by body.

A tick goes:

1. Every living player acts, in order.
2. Every living monster, in order, is struck by the players' swords and flames, in their order; if it
   lives, it looks for every player and bites those within reach; then it flies or chases.
3. Every player who was there gets what the tick brought: first what kills heal, then the bites. Who has
   no HP left is dead from the next tick on; until then he stands in the way.

Bodies are boxes around points beside which they may lie; who observes, chases or is knocked goes by the
points. The living stop each other as walls do; nobody pushes.

An agent step is 8 of them with the same actions, or as many as `settings.ticks` says. Its end may be the
episode's.

Inputs are the configuration itself, and what `Worlds` made of levels and characters (`oracle_arrays.py` reads
it); what players see is in `oracle_view.py`. Units: pixels, ticks of 1/60 s, pixels a tick; y points down.
"""

from __future__ import annotations

import math

from pneuma.env.rules import CLEARED, KILLED, RUNNING, TIME_LIMIT

from .oracle_moves import Box, Ground, Pair, move
from .oracle_parts import WAYS, Blow, Events, Gain, Monster, Player, Rulebook

# --- The world -------------------------------------------------------------------------------------


class Oracle:
    """One world."""

    def __init__(self, book: Rulebook, key: int) -> None:
        self.book = book
        self.key = key
        self.draws = self.steps = self.level = self.start = 0
        self.monsters_left = self.players_left = 0
        self.ending = RUNNING
        self.players = [Player(stats, reward) for stats, reward in zip(book.stats, book.rewards, strict=True)]
        self.monsters: list[Monster] = []

    @property
    def ground(self) -> Ground:
        """The tiles of the level that is played."""
        return self.book.grounds[self.level]

    def seed(self, key: int) -> None:
        """Begin a random stream; XP that outlives episodes starts again from 0."""
        self.key, self.draws = key, 0
        for player in self.players:
            player.xp = 0.0

    def reset(self, start: int) -> None:
        """Begin an episode at a start place, or at a random one if `start` is below zero."""
        book = self.book
        self.steps, self.ending = 0, RUNNING
        self.level = self._draw_below(len(book.starts)) if len(book.starts) > 1 else 0
        places = book.starts[self.level]
        self.start = start if start >= 0 else self._draw_below(len(places))
        for p, player in enumerate(self.players):
            xp = 0.0 if book.config.xp_scope == "episode" else player.xp
            (x, y), stats = places[(self.start + p) % len(places)], player.stats
            given = stats, player.reward, x, y, stats.hp, xp, stats.energy
            self.players[p] = Player(*given, events=player.events)
        self.monsters = [
            Monster(kind, *home, kind.hp, [0] * len(self.players), [0] * len(self.players))
            for kind, home in zip(book.kinds[self.level], book.homes[self.level], strict=True)
        ]
        self.monsters_left, self.players_left = len(self.monsters), len(self.players)

    def step(self, actions: list[int]) -> bool:
        """Play one agent step; tell whether the episode ended with it. After its end nothing happens."""
        for player in self.players:
            player.events = Events()
        if self.ending != RUNNING:
            return False
        for _ in range(self.book.settings.ticks):
            self._tick(actions)
        self.steps += 1
        self._end()
        return self.ending != RUNNING

    def reward(self) -> None:
        """Pay those who were there, once they have seen how the step ended."""
        for player in self.players:
            events = player.events
            if events.present:
                events.reward = player.formula()
        if self.book.config.shared_reward:
            total = 0.0  # not by `sum`, which rounds differently from Python 3.12 on
            for player in self.players:
                total += player.events.reward
            mean = total / len(self.players)
            for player in self.players:
                if player.events.present:
                    player.events.reward = mean

    # --- Random numbers --------------------------------------------------------------------------

    def _draw(self) -> int:
        """Return 64 random bits: splitmix64 (Steele, Lea and Flood 2014), from key and counter."""
        self.draws += 1
        z = (self.key + self.draws * 0x9E3779B97F4A7C15) % 2**64
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) % 2**64
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) % 2**64
        return z ^ (z >> 31)

    def _draw_below(self, bound: int) -> int:
        """Return a random whole number in [0, bound), from the upper 32 of 64 bits."""
        return (self._draw() >> 32) * bound >> 32

    # --- The end of a step -----------------------------------------------------------------------

    def _end(self) -> None:
        """Decide whether the episode is over, and charge the living for an ending."""
        config = self.book.config
        self.players_left = sum(player.hp > 0.0 for player in self.players)
        self.monsters_left = sum(monster.hp > 0.0 for monster in self.monsters)
        if self.players_left == 0:
            self.ending = KILLED
        elif self.monsters_left == 0 and config.end_on_clear:
            self.ending = CLEARED
        elif self.steps >= config.episode_steps:
            self.ending = TIME_LIMIT
        if self.ending in (CLEARED, TIME_LIMIT):
            for player in self.players:
                if player.hp > 0.0:
                    self._charge(player)

    def _charge(self, player: Player) -> None:
        """Take the XP that an ending costs; the published code then sets the reward to the XP."""
        cost = self.book.config.ending_cost
        if cost != 0.0:
            player.xp -= cost
            player.events.xp_gained -= cost
            player.events.reward = player.xp

    # --- A tick ----------------------------------------------------------------------------------

    def _tick(self, actions: list[int]) -> None:
        gains = [Gain() for _ in self.players]
        blows: dict[int, Blow] = {}
        for p, player in enumerate(self.players):
            if player.hp > 0.0:
                struck = self._act(player, actions[p])
                if struck:
                    blows[p] = struck
        there = [p for p, player in enumerate(self.players) if player.hp > 0.0]
        for monster in self.monsters:
            if monster.hp > 0.0:
                self._live(monster, there, blows, gains)
        for p in there:
            self._settle(self.players[p], gains[p])

    # --- A tick: players act ---------------------------------------------------------------------

    def _act(self, player: Player, action: int) -> Blow | None:
        """Let a player act, unless an attack or spell still lasts; return what strikes in this tick."""
        stats, name = player.stats, self.book.actions[action]
        struck = None
        if player.busy == 0:
            if name == "attack":
                player.busy, player.action_kind = stats.swing, 1
                player.attack += 1
            elif name == "flame" and player.energy >= stats.flame_cost:
                player.energy -= stats.flame_cost
                player.busy, player.action_kind = stats.flame_ticks, 2
                player.attack += 1
                struck = player.blow(player.stats.flame)
            elif name == "heal" and player.energy >= stats.heal_cost:
                player.energy -= stats.heal_cost
                player.busy, player.action_kind = stats.heal_ticks, 3
                for other in self.players:
                    dx, dy = other.x - player.x, other.y - player.y
                    near = dx * dx + dy * dy <= stats.heal_reach * stats.heal_reach and stats.heal_reach > 0.0
                    if other is player or (near and other.hp > 0.0):
                        other.heal(stats.heal, capped=True)
            elif action in WAYS:
                self._walk(player, action)
        if player.busy > 0:
            player.busy -= 1
            if player.action_kind == 1:
                struck = player.blow(stats.sword)
        player.energy = min(player.energy + stats.energy_gain, stats.energy)
        return struck

    def _walk(self, player: Player, way: int) -> None:
        """Turn a player and take it one tick that way."""
        player.facing = way
        player.x, player.y = self.walked(player, way, self._others(player))

    def walked(self, player: Player, way: int, others: list[Box]) -> Pair:
        """Return where one tick of walking takes a player among others."""
        stats = player.stats
        dx, dy = (part * stats.speed for part in WAYS[way])
        offset = stats.body_x, stats.body_y
        closed = self.book.closed_to_players
        return move((player.x, player.y), offset, player.box.half, (dx, dy), self.ground, closed, others)

    def _others(self, mover: Player | Monster) -> list[Box]:
        """Return the bodies that stop one: of all others who live."""
        players = [player.box for player in self.players if player is not mover and player.hp > 0.0]
        return players + [m.box for m in self.monsters if m is not mover and m.hp > 0.0]

    # --- A tick: monsters live -------------------------------------------------------------------

    def _live(self, monster: Monster, there: list[int], blows: dict[int, Blow], gains: list[Gain]) -> None:
        """Let a monster live one tick among the players who are `there`."""
        monster.safe = max(monster.safe - 1, 0)
        for p in range(len(self.players)):
            if p not in there:
                monster.noticed.discard(p)
                monster.bite[p] = 0
        met = {p for p in blows if monster.box.meets(blows[p].box)}
        on_entry = self.book.config.blow == "entry"
        swords = {p for p in blows if on_entry and self.players[p].action_kind == 1}
        for p in sorted(met):
            enters = p in swords
            hit = p not in monster.inside if enters else monster.struck_by[p] != blows[p].number
            if hit and monster.hp > 0.0 and monster.safe == 0:
                self._strike(monster, p, blows[p], there, gains)
            elif hit and enters:
                monster.struck_by[p] = 0
        monster.inside = met & swords
        if monster.hp <= 0.0:
            return
        target = self._sense(monster, there, gains)
        dx = dy = 0.0
        if monster.knocked > 0:
            monster.knocked -= 1
            dx, dy = monster.knock_x, monster.knock_y
        elif target is not None:
            dx = monster.approach(target.x - monster.x)
            dy = monster.approach(target.y - monster.y)
        place, offset = (monster.x, monster.y), (monster.kind.body_x, monster.kind.body_y)
        closed, others, steps = self.book.closed_to_monsters, self._others(monster), (dx, dy)
        monster.x, monster.y = move(place, offset, monster.box.half, steps, self.ground, closed, others)

    def _strike(self, monster: Monster, p: int, blow: Blow, there: list[int], gains: list[Gain]) -> None:
        """Strike a living monster that a blow meets for the first time."""
        kind = monster.kind
        monster.struck_by[p] = blow.number
        monster.safe = kind.safe
        monster.hp = max(monster.hp - blow.damage, 0.0)
        gains[p].hits += 1
        if monster.hp > 0.0:
            monster.knock_back(blow)
            return
        gains[p].kills += 1
        for q in there:
            # Within the attack circle is who was when the monster last looked, a tick ago.
            earns = monster.bite[q] > 0 if self.book.config.kill_credit == "near" else q == p
            if earns:
                gains[q].deaths += 1
                gains[q].xp += kind.xp
                gains[q].kill_heal += kind.heal

    def _sense(self, monster: Monster, there: list[int], gains: list[Gain]) -> Player | None:
        """Let a monster look for all players, and bite; return the nearest that it notices.

        In flight it does not bite: what is due then comes when it has landed.
        """
        kind, target, nearest = monster.kind, None, math.inf
        flies = monster.knocked > 0
        for p in there:
            player, gain = self.players[p], gains[p]
            gap = player.gap_squared(monster.x + kind.notice_x, monster.y + kind.notice_y)
            if gap > kind.notice_squared:
                monster.noticed.discard(p)
            else:
                gain.notices += p not in monster.noticed
                monster.noticed.add(p)
                if gap < nearest:
                    target, nearest = player, gap
            gap = player.gap_squared(monster.x + kind.attack_x, monster.y + kind.attack_y)
            if gap > kind.attack_squared:
                monster.bite[p] = 0
            elif monster.bite[p] > 1:
                monster.bite[p] -= 1
            else:
                gain.contacts += monster.bite[p] == 0
                monster.bite[p] = 1 if flies else kind.bite_ticks
                # Who is safe after a bite gets one a tick.
                if not flies and (player.stats.safe == 0 or gain.bitten == 0.0):
                    gain.bitten += kind.damage
        return target

    # --- A tick: what it brought -----------------------------------------------------------------

    def _settle(self, player: Player, gain: Gain) -> None:
        """Give a player what a tick brought: XP, what kills heal, then the bites."""
        stats, events = player.stats, player.events
        events.present += 1
        player.xp += gain.xp
        player.kills += gain.kills
        events.xp_gained += gain.xp
        events.hits += gain.hits
        events.kills += gain.kills
        events.notices += gain.notices
        events.contacts += gain.contacts
        if gain.deaths:
            events.reward = player.xp
        events.reward += gain.notices + gain.contacts

        player.safe = max(player.safe - 1, 0)
        player.heal(gain.kill_heal, capped=False)
        if gain.bitten > 0.0 and player.safe == 0:
            left = max(player.hp - gain.bitten, 0.0)
            events.hp_lost += player.hp - left
            player.hp, player.safe = left, stats.safe
            if player.hp <= 0.0:
                player.die()
                self._charge(player)
