"""The kernel against the oracle: whatever is played, both agree, bit for bit, and some laws hold.

`Pair` plays the oracle with the kernel and compares all state, events, observations and masks after each
step and reset. Levels, characters, configurations and ways to play are Hypothesis's (`oracle_cases.py`). What
both could have wrong is worked out by hand in `test_rules.py`.
"""

from __future__ import annotations

import itertools
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from pneuma.env.fields import make_env_config
from pneuma.env.rules import ATTACK, CLEARED, KILLED, RIGHT, RUNNING, TIME_LIMIT
from pneuma.env.worlds import Worlds

from .arena import FIELD, characters_file, stage
from .oracle import CONTACT_EPS, Body, Box, Monster, Oracle, Player
from .oracle_arrays import Pair
from .oracle_cases import MOOD_STEPS, Case, cases, choose_actions, hunt, make_worlds

FEW = settings(
    max_examples=60,
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
MANY = settings(FEW, max_examples=2000)
ROUNDING = 1e-6
EVENTS = ("hits", "kills", "notices", "contacts", "hp_gained", "died")


@pytest.mark.parametrize("examples", [FEW, pytest.param(MANY, marks=pytest.mark.slow)], ids=["few", "many"])
def test_the_kernel_plays_as_the_oracle(tmp_path: Path, examples: settings) -> None:
    counts: Counter[str] = Counter()
    folders = itertools.count()

    @examples
    @given(cases())
    def check(case: Case) -> None:
        play(case, make_worlds(case, tmp_path / str(next(folders))), counts)

    check()
    endings = [f"ending {ending}" for ending in (KILLED, CLEARED, TIME_LIMIT)]
    assert all(counts[name] for name in (*EVENTS, *endings, "flying", "masked", "in contact")), counts


def play(case: Case, worlds: Worlds, counts: Counter[str]) -> None:
    """Play a case; ended worlds begin again after a step or two, and at times all of them do."""
    pair = Pair(worlds, case.seed)
    for step in range(len(case.breaks) * MOOD_STEPS):
        before = [overlaps(world) for world in pair.oracles]
        actions = choose_actions(case, pair.oracles, step)
        masked = masked_players(pair, actions)
        pair.step(actions)
        count_events(pair, counts)
        for space, observations in zip(worlds.spaces, worlds.observations.swapaxes(0, 1), strict=True):
            assert ((observations >= space.low) & (observations <= space.high)).all()
            assert np.isfinite(space.high).all()
        for world, allowed in zip(pair.oracles, before, strict=True):
            assert overlaps(world) <= allowed
        for player, before_step in masked:
            counts["masked"] += 1
            assert player.hp == 0 or before_step == (player.x, player.y, player.facing)
        ended = np.flatnonzero(worlds.worlds["ending"] != RUNNING).tolist()
        pause = case.breaks[step // MOOD_STEPS]
        if pause >= 250 and step % MOOD_STEPS == 0:
            pair.reset(range(case.worlds), pause % len(worlds.level.starts), pause if pause % 2 else None)
        else:
            pair.reset([index for index in ended if (pause + step + index) % 3])


def overlaps(world: Oracle) -> set[tuple[int, ...]]:
    """Return who is inside what stops it, and which two are inside each other, by more than a hair.

    Nobody gets there. Players who begin at one place are inside each other; they may part, and not come back.
    """
    bodies: list[Body] = [*world.players, *world.monsters]
    living = [(number, body) for number, body in enumerate(bodies) if body.hp > 0.0]
    inside: set[tuple[int, ...]] = set()
    for number, body in living:
        closed = world.rulebook.closed_to_players
        if isinstance(body, Monster):
            closed = world.rulebook.closed_to_monsters
        box = shrunk(body, ROUNDING)
        for column, row in itertools.product(*(world.ground.covered(box, axis) for axis in (0, 1))):
            if world.ground.is_closed(column, row, closed):
                inside.add((number,))
    for (number, body), (second_number, second) in itertools.combinations(living, 2):
        if shrunk(body, CONTACT_EPS + ROUNDING).meets(second.box):
            inside.add((number, second_number))
    return inside


def shrunk(body: Body, hair: float) -> Box:
    return Box(body.box.centre, (body.box.half[0] - hair, body.box.half[1] - hair))


def masked_players(pair: Pair, actions: np.ndarray) -> list[tuple[Player, tuple[float, float, int]]]:
    """Return the players whose action their mask forbids, and their place and facing, which then stay."""
    masked = []
    for world, views, world_actions in zip(pair.oracles, pair.views, actions, strict=True):
        for player, (_, mask), action in zip(world.players, views, world_actions, strict=True):
            if player.hp > 0 and not mask[action]:
                masked.append((player, (player.x, player.y, player.facing)))
    return masked


def count_events(pair: Pair, counts: Counter[str]) -> None:
    for name in EVENTS:
        counts[name] += int((pair.worlds.events[name] > 0).sum())
    for world in pair.oracles:
        counts["flying"] += sum(monster.knocked > 0 for monster in world.monsters)
        counts[f"ending {world.ending}"] += world.steps > 0
        living = [monster.box for monster in world.monsters if monster.hp > 0]
        for player in world.players:
            grown = shrunk(player, -2 * CONTACT_EPS)
            counts["in contact"] += player.hp > 0 and any(grown.meets(box) for box in living)


def test_random_levels_are_drawn_before_starts() -> None:
    worlds = Worlds(3, make_env_config({"level": "random:train:3", "random_levels": 4, "players": 2}))
    pair, levels = Pair(worlds, seed=1), set()
    for _ in range(6):
        levels |= set(worlds.worlds["level"].tolist())
        for _ in range(6):
            pair.step(np.array([[hunt(o, player, ATTACK) for player in o.players] for o in pair.oracles]))
        pair.reset(range(3))
    assert levels == {0, 1, 2, 3}
    assert worlds.worlds["draws"].tolist() == [14, 14, 14]  # a level and a start for each of 7 episodes


def test_eight_players_fill_every_bit(tmp_path: Path) -> None:
    tough = characters_file(tmp_path, "[monsters.bamboo]\nhp = 5000\n")
    pair = stage(FIELD.write(tmp_path), (0.0, 0.0), players=8, classes="tank", characters=tough)
    pair.put(x=-54.0, y=3.0 * np.arange(8), facing=RIGHT)
    pair.play(ATTACK)
    assert pair.monster("noticed", "struck_by") == (255, [1] * 8)
    for step in range(40):
        pair.play([(step // 4 + player) % 5 for player in range(8)])


def test_a_monster_right_at_the_hilt_flies_nowhere(tmp_path: Path) -> None:
    """Its flight is too short to be flown: with a longer one, the NaN of 0 / 0 once ended the process."""
    hilt = "[weapons.blade]\nhilt = {down = [0, 0], left = [0, 0], up = [0, 0], right = [0, 0]}\n"
    file = characters_file(tmp_path, f"{hilt}[monsters.bamboo]\nknock_back = 120\nknock_back_time = 0\n")
    pair = stage(FIELD.write(tmp_path), (0.0, 0.0), characters=file)
    pair.play(ATTACK)
    assert (pair.player("hits"), pair.monster("knock_x")) == ([1], (0.0,))
