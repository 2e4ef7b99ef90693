"""Every face gives the same bits for the same seeds and actions: the law of design section 6.

Each face plays the same worlds, and what it told is written down as one transcript for each world, in
which the faces' own ways to reset leave no trace.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from pneuma.config import make_env_config
from pneuma.env.parallel import PneumaParallelEnv
from pneuma.env.sb3 import PneumaVecEnv
from pneuma.env.single import PneumaEnv
from pneuma.env.vector import PneumaVectorEnv

from .arena import ATTACK, GODOT, THESIS

STEPS = 120
SEED = 30
ENDING = ("ending", "kills", "xp", "hp")

Entry = tuple[Any, ...]
Transcript = list[Entry]


def begun(observation: np.ndarray, mask: np.ndarray) -> Entry:
    """Write down the beginning of an episode."""
    return "reset", observation.tobytes(), mask.tobytes()


def stepped(
    observation: np.ndarray, reward: float, terminated: bool, truncated: bool, info: dict[str, Any]
) -> Entry:
    """Write down a step: what was seen, paid and told; rewards as Stable-Baselines3 has them."""
    over = terminated or truncated
    told = [info[key] for key in ENDING] if over else np.asarray(info["action_mask"]).tobytes()
    return (
        "step",
        observation.tobytes(),
        np.float32(reward).tobytes(),
        bool(terminated),
        bool(truncated),
        told,
    )


class Actions:
    """The actions of every world, handed out one after another."""

    def __init__(self, worlds: int) -> None:
        generator = np.random.default_rng(worlds)
        self.table = generator.choice([0, 1, 2, 3, ATTACK, ATTACK, ATTACK], size=(worlds, 2 * STEPS))
        self.taken = np.zeros(worlds, np.int64)

    def next(self, idle: np.ndarray | None = None) -> np.ndarray:
        """Return an action for every world; those that are idle keep theirs for later."""
        actions = self.table[np.arange(len(self.taken)), self.taken]
        self.taken += 1 if idle is None else ~idle
        return actions


def play_single(worlds: int, env_id: str, settings: dict[str, Any]) -> list[Transcript]:
    actions, transcripts = Actions(worlds).table, []
    for world in range(worlds):
        env = PneumaEnv(env_id, **settings)
        observation, info = env.reset(seed=SEED + world)
        transcript = [begun(observation, info["action_mask"])]
        for action in actions[world, :STEPS]:
            observation, reward, terminated, truncated, info = env.step(action)
            transcript.append(stepped(observation, reward, terminated, truncated, info))
            if terminated or truncated:
                observation, info = env.reset()
                transcript.append(begun(observation, info["action_mask"]))
        transcripts.append(transcript)
    return transcripts


def play_parallel(worlds: int, env_id: str, settings: dict[str, Any]) -> list[Transcript]:
    actions, transcripts, me = Actions(worlds).table, [], "player_0"
    for world in range(worlds):
        env = PneumaParallelEnv(env_id, players=1, **settings)
        observations, infos = env.reset(seed=SEED + world)
        transcript = [begun(observations[me], infos[me]["action_mask"])]
        for action in actions[world, :STEPS]:
            seen, rewards, terminated, truncated, infos = env.step({me: action})
            transcript.append(stepped(seen[me], rewards[me], terminated[me], truncated[me], infos[me]))
            if not env.agents:
                observations, infos = env.reset()
                transcript.append(begun(observations[me], infos[me]["action_mask"]))
        transcripts.append(transcript)
    return transcripts


def infos_of(infos: dict[str, Any], world: int) -> dict[str, Any]:
    """Return what a vector's infos say of one world."""
    return {key: infos[key][world] for key in (*ENDING, "action_mask") if key in infos}


def play_vector(mode: AutoresetMode) -> Callable[[int, str, dict[str, Any]], list[Transcript]]:
    """Return how to play a vector environment that resets in this way."""

    def play(worlds: int, env_id: str, settings: dict[str, Any]) -> list[Transcript]:
        env = PneumaVectorEnv(worlds, env_id, mode, **settings)
        actions = Actions(worlds)
        observations, infos = env.reset(seed=SEED)
        transcripts = [[begun(observations[w], infos["action_mask"][w])] for w in range(worlds)]
        over = np.zeros(worlds, np.bool_)
        for _ in range(STEPS):
            resets = over if mode == AutoresetMode.NEXT_STEP else np.zeros(worlds, np.bool_)
            observations, rewards, terminated, truncated, infos = env.step(actions.next(resets))
            over = terminated | truncated
            masks, final = infos["action_mask"], infos.get("final_info", {})
            for w, transcript in enumerate(transcripts):
                if resets[w]:
                    assert rewards[w] == 0 and not over[w]
                    transcript.append(begun(observations[w], masks[w]))
                    continue
                same_step = mode == AutoresetMode.SAME_STEP and over[w]
                seen = infos["final_obs"][w] if same_step else observations[w]
                told = infos_of(final if same_step else infos, w)
                transcript.append(stepped(seen, rewards[w], terminated[w], truncated[w], told))
                if same_step:
                    transcript.append(begun(observations[w], masks[w]))
            if mode == AutoresetMode.DISABLED and over.any():
                observations, infos = env.reset(options={"reset_mask": over})
                for w in np.flatnonzero(over).tolist():
                    transcripts[w].append(begun(observations[w], infos["action_mask"][w]))
        return transcripts

    return play


def play_learner(worlds: int, env_id: str, settings: dict[str, Any]) -> list[Transcript]:
    env = PneumaVecEnv(range(SEED, SEED + worlds), make_env_config(settings, env_id))
    actions = Actions(worlds)
    observations, masks = env.reset(), env.action_masks().astype(np.int8)
    transcripts = [[begun(observations[w], masks[w])] for w in range(worlds)]
    for _ in range(STEPS):
        told = env.step(actions.next())
        assert isinstance(told[0], np.ndarray)
        observations, rewards, dones, infos = told[0], *told[1:]
        masks = env.action_masks().astype(np.int8)
        for w, (transcript, info) in enumerate(zip(transcripts, infos, strict=True)):
            cut = info.get("TimeLimit.truncated", False)
            seen = info["terminal_observation"] if dones[w] else observations[w]
            info = {**info, "action_mask": masks[w]}
            transcript.append(stepped(seen, rewards[w], dones[w] and not cut, cut, info))
            if dones[w]:
                transcript.append(begun(observations[w], masks[w]))
    return transcripts


FACES = {
    "parallel": play_parallel,
    "next step": play_vector(AutoresetMode.NEXT_STEP),
    "same step": play_vector(AutoresetMode.SAME_STEP),
    "disabled": play_vector(AutoresetMode.DISABLED),
    "Stable-Baselines3": play_learner,
}
SETTINGS: list[tuple[str, dict[str, Any]]] = [
    (THESIS, {"episode_steps": 20}),
    (
        THESIS,
        {"episode_steps": 25, "classes": "tank", "observation": "pygame", "reward": "kills", "magic": True},
    ),
    (GODOT, {"episode_steps": 30, "start": "random"}),
]

_played: dict[tuple[int, int], list[Transcript]] = {}


@pytest.mark.parametrize("face", FACES)
@pytest.mark.parametrize("worlds", [1, 16])
@pytest.mark.parametrize("which", range(len(SETTINGS)), ids=["thesis", "pygame", "godot"])
def test_every_face_tells_the_same_as_single_environments(
    pit: str, face: str, worlds: int, which: int
) -> None:
    env_id, settings = SETTINGS[which]
    settings = {**settings, "level": pit}
    if (which, worlds) not in _played:
        _played[which, worlds] = play_single(worlds, env_id, settings)
    expected = _played[which, worlds]
    ends = 0
    for world, (transcript, single) in enumerate(
        zip(FACES[face](worlds, env_id, settings), expected, strict=True)
    ):
        length = min(len(transcript), len(single))
        assert length > STEPS - 10
        assert transcript[:length] == single[:length], world
        ends += sum(entry[0] == "reset" for entry in transcript[1:length])
    assert ends >= 3 * worlds  # across several resets
