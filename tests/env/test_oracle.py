"""The kernel against the oracle: whatever is played, both tell the same, bit for bit, and some laws hold.

`oracle.py` tells the rules tick by tick in plain Python. `Pair` plays it beside the kernel and compares
all state, events, observations and masks after every step and reset. Levels, characters,
configurations and ways to play are Hypothesis's (`oracle_cases.py`). What both could have wrong is worked
out by hand in `test_rules.py`.
"""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings

from pneuma.env.fields import make_env_config
from pneuma.env.players import Hunter
from pneuma.env.rules import ATTACK, CLEARED, KILLED, RIGHT, RUNNING, TIME_LIMIT
from pneuma.env.worlds import Worlds

from .arena import FIELD, THESIS, characters_file, stage
from .oracle import Oracle
from .oracle_arrays import Pair
from .oracle_cases import STEPS_OF_A_MOOD, Case, cases, choose_actions, hunt, make_worlds
from .oracle_moves import CONTACT_EPS, Box
from .oracle_parts import Monster, Player

FEW = settings(
    max_examples=60,
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
)
MANY = settings(FEW, max_examples=2000)
ROUNDING = 1e-6

# --- Whatever is played ------------------------------------------------------------------------------


@pytest.mark.parametrize("many", [FEW, pytest.param(MANY, marks=pytest.mark.slow)], ids=["few", "many"])
def test_the_kernel_plays_as_the_oracle_tells(tmp_path: Path, many: settings) -> None:
    happened: Counter[str] = Counter()
    folders = itertools.count()

    @many
    @given(cases())
    def check(case: Case) -> None:
        play(case, make_worlds(case, tmp_path / str(next(folders))), happened)

    check()
    ends = [f"ending {ending}" for ending in (KILLED, CLEARED, TIME_LIMIT)]
    expected = (
        "hits", "kills", "notices", "contacts", "healed", "bitten", "flying", "masked",
        "in contact", *ends,
    )  # fmt: skip
    assert all(happened[name] for name in expected), happened


def play(case: Case, worlds: Worlds, happened: Counter[str]) -> None:
    """Play a case; ended worlds begin anew after a step or two, and at times all of them do."""
    pair = Pair(worlds, case.seed)
    for step in range(len(case.breaks) * STEPS_OF_A_MOOD):
        before = [list(law(world)) for world in pair.oracles]
        actions = choose_actions(case, pair.oracles, step)
        stuck = [list(held(pair, index, actions)) for index in range(case.count)]
        pair.step(actions)
        count_events(pair, happened)
        for p, space in enumerate(worlds.spaces):
            seen = worlds.observations[:, p]
            assert ((seen >= space.low) & (seen <= space.high)).all() and np.isfinite(space.high).all()
        for world, allowed, masked in zip(pair.oracles, before, stuck, strict=True):
            assert {*law(world)} <= {*allowed}
            for player, place in masked:
                happened["masked"] += 1
                assert player.hp == 0 or place == (player.x, player.y, player.facing)
        over = np.flatnonzero(worlds.worlds["ending"] != RUNNING).tolist()
        pause = case.breaks[step // STEPS_OF_A_MOOD]
        if pause >= 250 and step % STEPS_OF_A_MOOD == 0:
            start = pause % len(worlds.level.starts)
            pair.reset(range(case.count), start, seed=pause if pause % 2 else None)
        else:
            pair.reset([index for index in over if (pause + step + index) % 3])


def law(world: Oracle) -> Iterator[tuple[int, ...]]:
    """Yield who is inside what stops it, and which two are inside each other, by more than a hair.

    Nobody gets there. Players who begin at one place are inside each other; they may part, and not come back.
    """
    book = world.book
    bodies: list[Player | Monster] = [*world.players, *world.monsters]
    for number, body in enumerate(bodies):
        if body.hp > 0.0:
            box = shrunk(body, ROUNDING)
            closed = book.closed_to_monsters if isinstance(body, Monster) else book.closed_to_players
            columns, rows = (world.ground.covered(box, axis) for axis in (0, 1))
            if any(world.ground.is_closed(column, row, closed) for column in columns for row in rows):
                yield (number,)
    living = [(number, body) for number, body in enumerate(bodies) if body.hp > 0.0]
    for (one, first), (other, second) in itertools.combinations(living, 2):
        if shrunk(first, CONTACT_EPS + ROUNDING).meets(second.box):
            yield one, other


def shrunk(body: Player | Monster, hair: float) -> Box:
    return Box(body.box.centre, (body.box.half[0] - hair, body.box.half[1] - hair))


def held(pair: Pair, index: int, actions: np.ndarray) -> Iterator[tuple[Player, tuple[float, float, int]]]:
    """Yield whose action its mask forbids, and its place and facing, which then stay."""
    world = pair.oracles[index]
    for player, (_, mask), action in zip(world.players, pair.seen[index], actions[index], strict=True):
        if player.hp > 0 and not mask[action]:
            yield player, (player.x, player.y, player.facing)


def count_events(pair: Pair, happened: Counter[str]) -> None:
    for name in ("hits", "kills", "notices", "contacts"):
        happened[name] += int(pair.worlds.events[name].sum())
    for world in pair.oracles:
        happened["flying"] += sum(monster.knocked > 0 for monster in world.monsters)
        happened[f"ending {world.ending}"] += world.steps > 0
        for player in world.players:
            happened["bitten"] += player.events.died
            happened["healed"] += player.events.hp_gained > 0
            grown = shrunk(player, -2 * CONTACT_EPS)
            alive = [monster for monster in world.monsters if player.hp > 0 and monster.hp > 0]
            happened["in contact"] += any(grown.meets(monster.box) for monster in alive)


# --- The shipped and the random levels, and eight players --------------------------------------------


@pytest.mark.parametrize(
    ("env_id", "chosen"),
    [
        ("pneuma/PneumaGodot-v0", {}),
        ("pneuma/Pneuma-v0", {"players": 2, "classes": ["mage", "tank"], "observation": "pygame"}),
    ],
)
def test_the_hunter_on_the_shipped_level(env_id: str, chosen: dict[str, object]) -> None:
    worlds = Worlds(2, make_env_config(chosen, env_id))
    pair, hunter = Pair(worlds, seed=5), Hunter(worlds)
    kills = 0
    for _ in range(300):
        pair.step(hunter.act(worlds))
        kills += int(worlds.events["kills"].sum())
        pair.reset(np.flatnonzero(worlds.worlds["ending"]))
    assert kills >= 2


def test_random_levels_are_drawn_before_starts() -> None:
    worlds = Worlds(3, make_env_config({"level": "random:train:3", "random_levels": 4, "players": 2}))
    pair, played = Pair(worlds, seed=1), set()
    for _ in range(12):
        played |= set(worlds.worlds["level"].tolist())
        for _ in range(20):
            pair.step(np.array([[hunt(o, player, ATTACK) for player in o.players] for o in pair.oracles]))
        pair.reset(range(3))
    assert played == {0, 1, 2, 3}
    assert worlds.worlds["draws"].tolist() == [26, 26, 26]  # a level and a start for each of 13 episodes


def test_eight_players_fill_every_bit(tmp_path: Path) -> None:
    tough = characters_file(tmp_path, "[monsters.bamboo]\nhp = 5000\n")
    pair = stage(FIELD.write(tmp_path), (0.0, 0.0), players=8, classes="tank", characters=tough)
    pair.put(x=-54.0, y=3.0 * np.arange(8), facing=RIGHT)
    pair.play(ATTACK)
    assert pair.monster("noticed", "struck_by") == (255, [1] * 8)
    for step in range(40):
        pair.play([(step // 4 + p) % 5 for p in range(8)])


def test_a_monster_right_at_the_hilt_flies_nowhere(tmp_path: Path) -> None:
    """Its flight is too short to be flown: with a longer one, the NaN of 0 / 0 once ended the process."""
    own = "[weapons.blade]\nhilt = {down = 0, left = 0, up = 0, right = 0}\n"
    file = characters_file(tmp_path, f"{own}[monsters.bamboo]\nknock_back = 120\nknock_back_time = 0\n")
    pair = stage(FIELD.write(tmp_path), (0.0, 0.0), env_id=THESIS, characters=file)
    pair.play(ATTACK)
    assert (pair.told("hits"), pair.monster("knock_x")) == ([1], (0.0,))
