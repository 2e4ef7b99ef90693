"""Frames of the world, what people watch, and the files that they become.

The arena's grid spans -640 … 640 on both axes, so that the art pixel of a place is (x + 640) / 4.
"""

from __future__ import annotations

import re
from io import BytesIO
from pathlib import Path
from textwrap import dedent
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest
from PIL import Image, ImageSequence

from pneuma.env import rules, watch
from pneuma.env.fields import ENVIRONMENTS
from pneuma.env.gym import PneumaEnv
from pneuma.env.players import Hunter
from pneuma.env.render import Renderer
from pneuma.env.sprites import monster_picture
from pneuma.env.worlds import Worlds

from .arena import ATTACK, FLAME, HEAL, begin, stage
from .oracle_cases import CODES

MIDDLE = 160  # the art pixel of (0, 0)
MARGIN, PITCH = 6, 13  # art pixels above the first strip, and from one to the next


def bare(worlds: Worlds) -> np.ndarray:
    """Return the whole map at 16 px a tile without the panel; it is drawn three times as large."""
    return Renderer(worlds, panel=False).frame()[::3, ::3]


def action_pixels(worlds: Worlds) -> np.ndarray:
    """Return x and y, from the middle, of the pixels that show what the player does, shape (2, count)."""
    frame, action_kind = bare(worlds), worlds.players["action_kind"].copy()
    worlds.players["action_kind"] = 0
    rows, columns = np.nonzero((bare(worlds) != frame).any(axis=-1))
    worlds.players["action_kind"] = action_kind
    return np.stack([columns, rows]) - MIDDLE


def test_ground_is_blue_exactly_where_the_coast_is() -> None:
    """In the middle of every tile of the shipped level; borders may wander by a few pixels."""
    worlds = Worlds(1)
    centres = Renderer(worlds).background[8::16, 8::16].astype(int)
    np.testing.assert_array_equal(centres[..., 2] - centres[..., 0] > 40, worlds.level.terrain == rules.COAST)


@pytest.mark.parametrize(
    ("x", "y", "first_column", "first_row"),
    [
        (0.0, 0.0, MIDDLE - 120, MIDDLE - 88),  # half of a view of 240 x 176 art pixels
        (540.0, 540.0, 320 - 240, 320 - 176),
        (-540.0, 40.0, 0, MIDDLE + 10 - 88),
    ],
)
def test_following_camera_is_the_map_around_the_player(
    arena: str, x: float, y: float, first_column: int, first_row: int
) -> None:
    """Law: every art pixel is the map's, four times as large; the window never leaves the map."""
    pair = stage(arena)
    pair.put(x=x, y=y)
    expected = bare(pair.worlds)[first_row : first_row + 176, first_column : first_column + 240]
    expected = expected.repeat(4, 0).repeat(4, 1)
    np.testing.assert_array_equal(Renderer(pair.worlds, "follow", panel=False).frame(), expected)


@pytest.mark.parametrize(("spell", "nearest", "farthest"), [(FLAME, 70, 86), (HEAL, 0, 12)])
def test_a_spell_shows_while_it_is_cast(arena: str, spell: int, nearest: int, farthest: int) -> None:
    """It lasts 24 ticks, 3 steps. The flame's box reaches 320 px ahead; signs of healing stay near."""
    pair = stage(arena, magic=True)
    reaches = []
    for _ in range(3):
        pair.play(spell)
        reaches.append(action_pixels(pair.worlds)[0].max(initial=0))
    assert reaches[2] == 0 and nearest < min(reaches[:2]) and max(reaches[:2]) <= farthest


@pytest.mark.parametrize("facing", range(4))
def test_an_arc_covers_the_box_that_strikes(arena: str, facing: int) -> None:
    """All of it is brightened but the round corners."""
    worlds = stage(arena, facing=facing).worlds
    worlds.players["busy"], worlds.players["action_kind"] = 12, rules.BLADE
    x, y = action_pixels(worlds) + 0.5
    sword = worlds.player_stats["sword"]
    half_width, half_height = sword["half_width"][0, facing] / 4, sword["half_height"][0, facing] / 4
    inside = abs(x - sword["x"][0, facing] / 4) <= half_width + 1
    inside &= abs(y - sword["y"][0, facing] / 4) <= half_height + 1
    assert inside.sum() > 0.85 * 4 * half_width * half_height


@pytest.mark.parametrize("name", CODES)
def test_each_shipped_monster_has_a_picture_of_its_own(name: str) -> None:
    """In two poses, each calm and alert; one without a file would look like a stranger."""
    poses = [(0, False), (1, False), (0, True), (1, True)]
    pictures = [monster_picture(name, *pose) for pose in poses]
    strangers = [monster_picture("stranger", *pose) for pose in poses]
    assert {picture.tobytes() for picture in pictures}.isdisjoint(picture.tobytes() for picture in strangers)
    assert len({picture.tobytes() for picture in pictures}) == 4 and pictures[0][..., 3].any()


def test_a_badge_tells_the_three_worlds_apart(arena: str) -> None:
    """At the beginning of an episode the rest of their strips is alike."""
    strips = set()
    for name in ENVIRONMENTS:
        env: Any = gymnasium.make(name, render_mode="rgb_array", level=arena)
        env.reset(seed=0)
        strips.add(env.render()[: MARGIN + PITCH].tobytes())
    assert len(strips) == 3


@pytest.mark.parametrize("player", range(3))
def test_in_teams_each_player_has_a_strip(arena: str, player: int) -> None:
    worlds = stage(arena, players=3, classes="tank").worlds
    renderer = Renderer(worlds, "follow", zoom=2)
    before = renderer.frame(0, 1)
    worlds.players["hp"][0, player] = 30
    height = MARGIN + 4 * PITCH
    assert len(before) == height + len(Renderer(worlds, "follow", panel=False, zoom=2).frame(0, 1))
    rows = np.flatnonzero((renderer.frame(0, 1) != before)[:height].any(axis=(1, 2)))
    assert set((rows - MARGIN + 3) // PITCH) == {1 + player}  # the first is the world's


def test_an_episode_is_shown_in_two_frames_a_step_and_ends_as_it_does() -> None:
    watched, played = (begin(1, seed=3, episode_steps=60) for _ in range(2))
    frames = sum(1 for _ in watch.episode_frames(watched, Hunter(watched).act, Renderer(watched)))
    hunter = Hunter(played)
    for _ in range(60):
        played.step(hunter.act(played))
    assert frames == 1 + 2 * 60
    assert np.array_equal(watched.players, played.players)
    assert np.array_equal(watched.monsters, played.monsters)
    assert watched.ending(0) == played.ending(0) == "time-limit"


def recipe(first_line: str) -> str:
    """Return the lines of docs/environment.md from this one to the end of its block."""
    text = (Path(__file__).parents[2] / "docs" / "environment.md").read_text(encoding="utf-8")
    block = re.search(rf"^(?: {{4}}.*\n)*? {{4}}{re.escape(first_line)}\n(?: {{4}}.*\n)*", text, re.MULTILINE)
    assert block, first_line
    return dedent(block.group())


@pytest.mark.filterwarnings("ignore:.*matplotlib is not installed")  # Gymnasium's, of a backend without Tk
def test_the_recipe_opens_a_window_to_play_in(pygame: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    actions: list[int] = []
    step = PneumaEnv.step

    def noting_step(env: PneumaEnv, action: np.int64) -> Any:
        actions.append(int(action))
        if len(actions) == 3:
            pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pygame.K_ESCAPE))
        return step(env, action)

    monkeypatch.setattr(PneumaEnv, "step", noting_step)
    pygame.init()
    for key in (pygame.K_a, pygame.K_SPACE):
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))
    exec(recipe("from gymnasium.utils.play import play"), {})
    assert actions == [ATTACK] * 3  # of two keys the later action counts


def test_the_recipe_shows_an_agent_in_a_window(pygame: ModuleType) -> None:
    names: dict[str, Any] = {"gymnasium": gymnasium}
    exec(recipe("from gymnasium.wrappers import HumanRendering"), names)
    env = names["env"]
    on_screen = np.asarray(pygame.surfarray.array3d(pygame.display.get_surface())).swapaxes(0, 1)
    assert np.array_equal(on_screen, Renderer(env.unwrapped.worlds, env_id=ENVIRONMENTS[2]).frame())
    env.close()


def test_gif_has_every_frame_pixel_by_pixel() -> None:
    """Of frames that repeat there is one, which stays longer: 1 s together."""
    frames = np.zeros((30, 64, 64, 3), np.uint8)
    frames[..., 0] = np.arange(64)[:, None] // 8 * 20
    for number in range(30):
        column = number // 2 * 3
        frames[number, column : column + 8, column : column + 8] = 255  # moves with every other frame
    pictures, milliseconds = [], []
    with Image.open(BytesIO(watch.encode_gif(frames, 30))) as image:
        for picture in ImageSequence.Iterator(image):
            pictures.append(np.array(picture.convert("RGB")))
            milliseconds.append(picture.info["duration"])
    np.testing.assert_array_equal(pictures, frames[::2])
    assert sum(milliseconds) == 1000 and set(milliseconds) == {60, 70}
