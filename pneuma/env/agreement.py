"""Do all faces tell the same story, and does a world that was put back go on as it would have?

Every face plays the same actions in the same worlds, over several short episodes. What it says is
brought into one form: a list of entries a world, each what the players who were playing saw and
got, their last observations among it, or what they saw after a reset. The lists must be equal.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
from collections.abc import Iterator, Mapping
from contextlib import redirect_stdout
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from pneuma.config import EnvConfig, make_env_config
from pneuma.env.parallel import PneumaParallelEnv
from pneuma.env.sb3 import PneumaVecEnv
from pneuma.env.single import PneumaEnv
from pneuma.env.vector import PneumaVectorEnv
from pneuma.env.worlds import Snapshot, Worlds
from pneuma.errors import UserError

WORLDS = 3
SEED = 5
STEPS = 150
EPISODE_STEPS = 20
"""At most; so that endings and resets are met often."""

Entry = dict[int, tuple[Any, ...]]
"""What one step, or a reset, told each player who was playing."""

Settings = Mapping[str, object]


def check_faces(env_id: str, settings: Settings) -> None:
    """Compare the vector face in each autoreset mode, and the others, with single worlds.

    Raises:
        UserError: naming the face, the world and the step that differ.
    """
    config = make_env_config(settings, env_id)
    settings = {**settings, "episode_steps": min(config.episode_steps, EPISODE_STEPS)}
    worlds = range(WORLDS)
    told = [list(_parallel(env_id, settings, config, world)) for world in worlds]
    if config.players == 1:
        _compare("the single face", [list(_single(env_id, settings, world)) for world in worlds], told)
    for mode in AutoresetMode:
        _compare(f"the vector face, {mode.name}", _vector(env_id, settings, config, mode), told)
    _compare("the Stable-Baselines3 face", _slots(env_id, settings, config), told)


def check_restore(env_id: str, settings: Settings) -> None:
    """Put a world back in another slot, object and process, and compare how each goes on, bit by bit."""
    config = make_env_config(settings, env_id)
    worlds = _begin(2, config)
    before, after = _actions(0, config)[:120].reshape(2, 60, -1)
    _step_all(worlds, before)
    saved = worlds.save(0)
    worlds.restore(1, saved)
    _step_all(worlds, after)
    expected = _bits(worlds, 0)
    if _bits(worlds, 1) != expected:
        raise UserError("a world that was put back into another slot went another way")
    if _go_on(config, saved, after) != expected:
        raise UserError("a world that was put back into another object went another way")
    job = pickle.dumps((config, saved, after))
    command = [sys.executable, "-c", f"from {__name__} import answer; answer()"]
    same = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(command, input=job, capture_output=True, check=False, env=same)
    if done.returncode:
        raise UserError(f"another process failed: {done.stderr.decode(errors='replace').strip()[-300:]}")
    if pickle.loads(done.stdout) != expected:
        raise UserError("a world that was put back in another process went another way")


def answer() -> None:
    """Go on with the world on standard input, and say on standard output where it gets; another process."""
    config, saved, actions = pickle.load(sys.stdin.buffer)
    with redirect_stdout(sys.stderr):  # for what a reward prints
        there = _go_on(config, saved, actions)
    sys.stdout.buffer.write(pickle.dumps(there))


def _go_on(config: EnvConfig, saved: Snapshot, actions: np.ndarray) -> list[bytes]:
    """Put a world back into an object of its own and return where some actions lead it."""
    worlds = Worlds(1, config)
    worlds.restore(0, saved)
    _step_all(worlds, actions)
    return _bits(worlds, 0)


def _step_all(worlds: Worlds, actions: np.ndarray) -> None:
    """Play actions (steps, players), the same in every world, into new episodes where they end."""
    for chosen in actions:
        worlds.step(np.stack([chosen] * len(worlds)))
        worlds.reset(worlds.worlds["ending"] != 0)


def _bits(worlds: Worlds, world: int) -> list[bytes]:
    """Return every bit of one world's state and of what its last step told."""
    state = (worlds.worlds, worlds.players, worlds.monsters, worlds.events)
    fields = [array[world][name] for array in state for name in array.dtype.names or ()]
    return [np.ascontiguousarray(each).tobytes() for each in (*fields, worlds.observations[world])]


def _begin(count: int, config: EnvConfig) -> Worlds:
    worlds = Worlds(count, config)
    worlds.seed(range(SEED, SEED + count))
    worlds.reset()
    return worlds


def _actions(world: int, config: EnvConfig) -> np.ndarray:
    """Return what the players of a world do in its first steps, (steps, players)."""
    count = 7 if config.magic else 5
    return np.random.default_rng(world).integers(count, size=(STEPS, config.players))


def _compare(face: str, told: list[list[Entry]], expected: list[list[Entry]]) -> None:
    """Raise an error at the first entry of a world's story that is not as expected."""
    for world, (story, other) in enumerate(zip(told, expected, strict=True)):
        if len(story) < len(other) // 2:
            raise UserError(f"{face}: world {world} got stuck after {len(story)} steps")
        for step, (entry, right) in enumerate(zip(story, other, strict=False)):
            what = _difference(entry, right)
            if what:
                raise UserError(f"{face}: world {world}, step {step}: {what} differ")


def _difference(entry: Entry, right: Entry) -> str:
    """Name what differs between two entries, if anything does."""
    if entry.keys() != right.keys():
        return "the players in play"
    for player, own in entry.items():
        if len(own) != len(right[player]):
            return "endings and resets"
        for what, one, other in zip(("observations", "rewards", "endings"), own, right[player], strict=False):
            if not np.array_equal(np.asarray(one), np.asarray(other)):
                return what
    return ""


# --- The story that each face tells --------------------------------------------------------------


def _single(env_id: str, settings: Settings, world: int) -> Iterator[Entry]:
    """Yield the story of one world as the single face tells it."""
    env = PneumaEnv(env_id, None, "map", **settings)
    yield {0: (env.reset(seed=SEED + world)[0],)}
    for action in _actions(world, env.state.config)[:, 0]:
        observation, reward, terminated, truncated, _ = env.step(action)
        yield {0: (observation, np.float32(reward), (terminated, truncated))}
        if terminated or truncated:
            yield {0: (env.reset()[0],)}


def _parallel(env_id: str, settings: Settings, config: EnvConfig, world: int) -> Iterator[Entry]:
    """Yield the story of one world as PettingZoo's face tells it."""
    env = PneumaParallelEnv(env_id, **{**settings, "players": config.players})  # type: ignore[arg-type]
    seen = env.reset(seed=SEED + world)[0]
    names = env.possible_agents
    yield {i: (seen[name],) for i, name in enumerate(names)}
    for actions in _actions(world, config):
        acting = list(env.agents)
        chosen = {name: actions[names.index(name)] for name in acting}
        seen, rewards, terminated, truncated, _ = env.step(chosen)
        yield {
            names.index(name): (seen[name], np.float32(rewards[name]), (terminated[name], truncated[name]))
            for name in acting
        }
        if not env.agents:
            seen = env.reset()[0]
            yield {i: (seen[name],) for i, name in enumerate(names)}


class _Batch:
    """Brings what a batched face tells of all slots into stories of worlds, and picks their actions."""

    def __init__(self, config: EnvConfig, first: np.ndarray) -> None:
        self.stories: list[list[Entry]] = [[] for _ in range(WORLDS)]
        self._players = config.players
        self._actions = [_actions(world, config) for world in range(WORLDS)]
        self._taken = [0] * WORLDS
        self._playing = np.ones(len(first), bool)
        self.begin(np.ones(WORLDS, bool), first)

    def choose(self) -> np.ndarray:
        """Return the next actions of all slots."""
        chosen = [actions[taken % STEPS] for actions, taken in zip(self._actions, self._taken, strict=True)]
        return np.concatenate(chosen)

    def begin(self, which: np.ndarray, seen: np.ndarray) -> None:
        """Note that worlds, (N,) booleans, have begun again, and what their slots see."""
        for world in np.flatnonzero(which).tolist():
            slots = self._slots(world)
            self._playing[slots] = True
            self.stories[world].append({i: (seen[slot].copy(),) for i, slot in enumerate(slots)})

    def note(
        self, which: np.ndarray, last: np.ndarray, rewards: np.ndarray, ended: np.ndarray, cut: np.ndarray
    ) -> np.ndarray:
        """Note a step of worlds, (N,) booleans: what all slots saw last, got, and whether it ended them.

        Returns:
            (N,) which of these worlds nobody plays in any more.
        """
        for world in np.flatnonzero(which).tolist():
            self._taken[world] += 1
            entry: Entry = {}
            for i, slot in enumerate(self._slots(world)):
                if self._playing[slot]:
                    ending = bool(ended[slot]), bool(cut[slot])
                    entry[i] = last[slot].copy(), np.float32(rewards[slot]), ending
                    self._playing[slot] = not any(ending)
            self.stories[world].append(entry)
        return which & ~self._playing.reshape(WORLDS, -1).any(axis=1)

    def _slots(self, world: int) -> range:
        return range(world * self._players, (world + 1) * self._players)


def _vector(env_id: str, settings: Settings, config: EnvConfig, mode: AutoresetMode) -> list[list[Entry]]:
    """Return the stories of all worlds as the vector face tells them."""
    env = PneumaVectorEnv(WORLDS * config.players, env_id, mode, **settings)  # type: ignore[arg-type]
    batch = _Batch(config, env.reset(seed=SEED)[0])
    over = np.zeros(WORLDS, bool)
    for _ in range(STEPS):
        if mode == AutoresetMode.DISABLED and over.any():
            batch.begin(over, env.reset(options={"reset_mask": over.repeat(config.players)})[0])
            over = np.zeros(WORLDS, bool)
        seen, rewards, ended, cut, infos = env.step(batch.choose())
        last = np.array(seen)
        if mode == AutoresetMode.SAME_STEP:
            for slot in np.flatnonzero(ended | cut):
                last[slot] = infos["final_obs"][slot]
        batch.begin(over, seen)  # NEXT_STEP: this step was their reset
        over = batch.note(~over, last, rewards, ended, cut)
        if mode == AutoresetMode.SAME_STEP:
            batch.begin(over, seen)
            over = np.zeros(WORLDS, bool)
    return batch.stories


def _slots(env_id: str, settings: Settings, config: EnvConfig) -> list[list[Entry]]:
    """Return the stories of all worlds as the face of Stable-Baselines3 tells them."""
    env = PneumaVecEnv(range(SEED, SEED + WORLDS), make_env_config(settings, env_id))
    batch = _Batch(config, np.array(env.reset()))
    every = np.ones(WORLDS, bool)
    for _ in range(STEPS):
        seen, rewards, dones, infos = env.step(batch.choose())
        last = np.array(seen)
        for slot in np.flatnonzero(dones):
            if "terminal_observation" not in infos[slot]:
                raise UserError("the Stable-Baselines3 face: an ended slot has no terminal observation")
            last[slot] = infos[slot]["terminal_observation"]
        cut = np.array([bool(info.get("TimeLimit.truncated")) for info in infos])
        over = batch.note(every, last, rewards, dones & ~cut, cut)
        batch.begin(over, np.array(seen))
    return batch.stories
