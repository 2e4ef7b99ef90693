"""Gymnasium's faces: one world, N worlds as one environment, both also with vector rewards; and its recorder.

Both give the same bits for the same seeds and actions. A slot of several players' worlds is as in `Slots`.
"""

from __future__ import annotations

import numbers
import operator
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces, wrappers
from gymnasium.error import DependencyNotInstalled, ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from pneuma.env.characters import TICKS_PER_STEP
from pneuma.env.kernel import announce_compiling
from pneuma.env.layouts import MOST_XP, most_hp
from pneuma.env.reward import PARTS, reward_parts
from pneuma.env.slots import Slots, chosen_starts, ending_info
from pneuma.env.watch import Rendering, write_video
from pneuma.env.worlds import Worlds
from pneuma.env_fields import ENVIRONMENTS, limited, make_env_config
from pneuma.errors import UserError

announce_compiling()


class PneumaEnv(Rendering, gymnasium.Env[np.ndarray, np.int64]):
    """PneumaRL: one player against the monsters of a level.

    ## Description
    A top-down island of snow, field and desert. Monsters notice a player within 300 pixels, chase
    and bite; the player kills them with a sword for experience points (XP). `pneuma/Pneuma-v0` is the
    thesis's text, well posed; `pneuma/PneumaGodot-v0` its published code, with its quirks;
    `pneuma/PneumaArena-v0` is the text's with another reward.

    ## Action space
    `Discrete(5)`: 0 walk down, 1 left, 2 up, 3 right, 4 attack towards the last direction walked.
    With `magic` also 5 flame and 6 heal. An action lasts 8 ticks of 1/60 s; an attack 24, during
    which further actions do nothing. `info["action_mask"]` is 0 where an action would do nothing.

    ## Observation space
    A `Box` of float32; `pneuma.env.observe` lists what stands where.

    ## Reward
    By formula; `pneuma.env.reward` lists them. That of Pneuma-v0: XP so far minus HP over full HP, at
    every step (thesis section 5.3).

    ## Start
    One of the level's start places, at random, or with `start = "first"` always the first;
    `reset(options={"start": i})` chooses the i-th.

    ## End
    Terminates when the player's HP are gone, and with `end_on_clear` when every monster is dead;
    truncates after `episode_steps` steps, or terminates with `time_limit = "terminate"`. `info` then
    holds `ending`, `kills`, `xp` and `hp`.

    ## Saving
    `copy.deepcopy` and `pickle` copy the environment, its random stream included.

    ## Arguments
    The fields of `pneuma.config.EnvConfig`.

    Raises:
        UserError: at construction, for an argument out of range or a level that cannot be played.
    """

    def __init__(
        self,
        env_id: str = ENVIRONMENTS[0],
        render_mode: str | None = None,
        camera: str = "map",
        **settings: object,
    ) -> None:
        config = make_env_config(settings, env_id)
        if config.players != 1:
            raise UserError(
                f"players = {config.players}: this face has one player; make the vector environment, or "
                "pneuma.env.pettingzoo.parallel_env"
            )
        self._env_id = env_id
        self.state = Worlds(1, config)
        self.observation_space = self.state.space
        self.action_space = self.state.action_space
        self._set_up_rendering(self.state, render_mode, camera)
        self._actions = np.zeros((1, 1), np.int64)
        self._keyed = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; see `gymnasium.Env.reset`. The same seed starts the same world."""
        start = chosen_starts(self.state, (options or {}).get("start"))
        super().reset(seed=seed)
        if seed is not None or not self._keyed:
            self.state.seed([seed if seed is not None else int(self.np_random.integers(2**63))])
            self._keyed = True
        self.state.reset(starts=start)
        return self._seen()

    def _seen(self) -> tuple[np.ndarray, dict[str, Any]]:
        self._show()
        return self.state.observations[0, 0].copy(), {"action_mask": self.state.masks[0, 0].copy()}

    def step(self, action: np.int64) -> tuple[np.ndarray, Any, bool, bool, dict[str, Any]]:
        """Play one action; see `gymnasium.Env.step`."""
        index = operator.index(action)
        if not 0 <= index < self.state.action_space.n:
            raise ValueError(f"action {action!r} is outside {self.action_space}")
        if not self._keyed:
            raise ResetNeeded("no episode has begun: call reset first")
        state = self.state
        self._actions[0, 0] = index
        ended = state.advance(self._actions)
        observation, info = self._seen()
        if not ended:
            if state.worlds["ending"][0]:
                raise ResetNeeded("the episode has ended: call reset first")
            return observation, self._reward(), False, False, info
        info |= ending_info(state, 0)
        truncated = bool(state.truncated[0])
        return observation, self._reward(), not truncated, truncated, info

    def _reward(self) -> Any:
        return self.state.events["reward"].item()

    def limit_episodes(self, max_episode_steps: int) -> None:
        """Set the world's time limit as `pneuma.env_fields.limited` has it, and tell it in the spec."""
        self.state.config = limited(self.state.config, self._env_id, max_episode_steps)
        steps = self.state.config.episode_steps
        self.state.settings["step_limit"] = steps
        if self.spec is not None:
            self.spec.max_episode_steps = steps
            self.spec.kwargs = {**self.spec.kwargs, "episode_steps": steps}


def without_time_limit(env: gymnasium.Env[Any, Any]) -> gymnasium.Env[Any, Any]:
    """Take off the TimeLimit that `gymnasium.make` puts around a world, which limits its episodes itself."""
    if not isinstance(env, wrappers.TimeLimit):
        return env
    world = env.unwrapped
    assert isinstance(world, PneumaEnv)
    world.limit_episodes(env._max_episode_steps)
    return env.env


class PneumaVectorEnv(Rendering, VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """N worlds as one environment; see `PneumaEnv` for each.

    World i of a batch reset with seed s is the single world reset with seed s + i, bit for bit. With
    several players to a world, each is a slot: slot i is player i % players of world i // players. A
    slot whose player dies before its world ends idles until then (`pneuma.env.worlds.Slots`).

    Args:
        num_envs: number of slots, a multiple of the players in a world.
        autoreset_mode: Gymnasium's three. `NEXT_STEP`, its default: the step after an ending
            resets and ignores the action. `SAME_STEP`: the step that ends resets too, and `info`
            holds `final_obs` and `final_info`. `DISABLED`: reset by hand with
            `reset(options={"reset_mask": booleans})`, one a slot.
        max_episode_steps: Gymnasium's name of `episode_steps`.
        settings: the fields of `pneuma.config.EnvConfig`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        env_id: str = ENVIRONMENTS[0],
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        camera: str = "map",
        max_episode_steps: int | None = None,
        **settings: object,
    ) -> None:
        config = limited(make_env_config(settings, env_id), env_id, max_episode_steps)
        if num_envs < 1 or num_envs % config.players:
            raise UserError(
                f"num_envs = {num_envs} is not allowed: a multiple of the {config.players} players in a world"
            )
        self.num_envs = num_envs
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}  # type: ignore[misc]
        self.state = Worlds(num_envs // config.players, config)
        self.slots = Slots(self.state)
        self._set_up_rendering(self.state, render_mode, camera)
        self.single_observation_space = self.state.slot_space
        self.single_action_space = self.state.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.state.action_space, num_envs)
        self._note_over(np.zeros(len(self.state), np.bool_))

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin an episode in every world, or in those of `options["reset_mask"]`.

        `seed` is one seed, or a list with one per world, for the random streams of the worlds that are reset;
        those with None go on.
        `options["start"]` is the index of a start place, or one for each world.

        Raises:
            ResetNeeded: when the first reset leaves out some worlds.
        """
        given = options or {}
        starts = chosen_starts(self.state, given.get("start"))
        seeds = self._seeds(seed)
        mask = self._reset_mask(given.get("reset_mask"))
        if not self.slots.begun and not mask.all():
            raise ResetNeeded("no episode has begun in the other worlds: reset all of them first")
        super().reset(seed=None if seeds is None else seeds[0])
        if not self.slots.begun and (seeds is None or None in seeds):
            first, asked = int(self.np_random.integers(2**62)), seeds or [None] * len(self.state)
            seeds = [first + i if own is None else own for i, own in enumerate(asked)]
        if seeds:
            self.state.seed([own or 0 for own in seeds], mask & [own is not None for own in seeds])
            self.slots.begun = True
        self.state.reset(mask, starts)
        self._note_over(self._over & ~mask)
        self._show()
        return self.slots.observations, self._infos()

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None] | None:
        """Return a seed for each world, None where its random stream goes on."""
        if seed is None:
            return None
        if isinstance(seed, numbers.Integral):
            return [int(seed) + i for i in range(len(self.state))]
        seeds = [None if own is None else operator.index(own) for own in seed]  # type: ignore[union-attr]
        if len(seeds) != len(self.state):
            raise ValueError(f"{len(seeds)} seeds for {len(self.state)} worlds")
        return seeds

    def _reset_mask(self, mask: object) -> np.ndarray:
        """Return which worlds to reset, (N,)."""
        if mask is None:
            return np.ones(len(self.state), np.bool_)
        if not (isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.shape == (self.num_envs,)):
            raise TypeError(f"reset_mask must be an array of {self.num_envs} booleans, not {mask!r}")
        return np.asarray(mask.reshape(len(self.state), -1).any(axis=1))

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Play one action in every slot; see `gymnasium.vector.VectorEnv.step`."""
        actions = self.slots.checked(actions)
        if not self.slots.begun:
            raise ResetNeeded("no episode has begun: call reset first")
        if self.autoreset_mode == AutoresetMode.DISABLED and self._waiting:
            raise ValueError("some worlds have ended: reset them with options={'reset_mask': …} first")
        slots = self.slots
        ended = slots.step(actions)
        if self._waiting:  # NEXT_STEP: this step resets what the last one ended
            self.state.reset(self._over)
        rewards = self._rewards()
        infos = self._final(slots.terminated | slots.truncated) if ended else {}
        if ended or self._waiting:
            self._note_over(slots.world_over.copy())
        self._show()
        seen = slots.observations
        return seen, rewards, slots.terminated.copy(), slots.truncated.copy(), self._infos(infos)

    def _note_over(self, over: np.ndarray) -> None:
        """Record which worlds are over, and reset them if the ending step does so."""
        self._over, self._waiting = over, bool(over.any())
        if self._waiting and self.autoreset_mode == AutoresetMode.SAME_STEP:
            self.state.reset(over)
            over[:] = self._waiting = False

    def _rewards(self) -> np.ndarray:
        return self.slots.rewards.copy()

    def _infos(self, infos: dict[str, Any] | None = None) -> dict[str, Any]:
        return {
            "action_mask": self.slots.masks,
            "_action_mask": np.ones(self.num_envs, np.bool_),
            **(infos or {}),
        }

    def _final(self, over: np.ndarray) -> dict[str, Any]:
        """Return the infos of the slots that ended, in Gymnasium's form for this autoreset mode."""
        infos: dict[str, Any] = {}
        for slot in np.flatnonzero(over):
            world, player = divmod(int(slot), self.slots.players)
            info = ending_info(self.state, world, player)
            if self.autoreset_mode == AutoresetMode.SAME_STEP:
                final = self.state.observations[world, player].copy()
                mask = self.state.masks[world, player].copy()
                info = {"final_obs": final, "final_info": {"action_mask": mask, **info}}
            infos = self._add_info(infos, info, int(slot))
        return infos


# --- Vector rewards -------------------------------------------------------------------------------


class VectorRewards:
    """A mixin for vector rewards; it comes before the environment among the bases."""

    state: Worlds

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        if "reward" in settings:
            raise UserError(
                f"reward = {settings['reward']!r} is not allowed: vector rewards are always the same parts; "
                "weigh them, or choose a reward for an id without mo-"
            )
        super().__init__(*arguments, **settings)
        self.reward_space = parts_space(self.state)
        self.reward_dim = len(PARTS)

    def _parts(self) -> np.ndarray:
        return reward_parts(self.state.events, self.state.players, self.state.player_stats)


class PneumaMOEnv(VectorRewards, PneumaEnv):
    """The same world with a vector reward, in MO-Gymnasium's convention.

    `step` returns an array of `pneuma.env.reward.PARTS`: XP and HP share after the step, XP gained, HP
    share lost, notice and attack circles entered. The thesis's reward is the first minus the second,
    the reward `kills` the third minus the fourth. There is no `reward` to choose.
    """

    def _reward(self) -> Any:
        return self._parts()[0, 0]


class PneumaMOVectorEnv(VectorRewards, PneumaVectorEnv):
    """The same with vector rewards, (slots, 6), in MO-Gymnasium's convention; see `PneumaMOEnv`."""

    def _rewards(self) -> np.ndarray:
        return self._parts().reshape(self.num_envs, -1)


def parts_space(state: Worlds) -> spaces.Box:
    """Return the finite bounds of a vector reward."""
    config = state.config
    worth = float(state.monster_stats["xp"].sum(axis=-1).max(initial=0.0))
    least, most = (-MOST_XP, MOST_XP) if config.xp_scope == "forever" else (-config.ending_cost, worth)
    circles = float(state.monsters.shape[1] * TICKS_PER_STEP)
    hp = max(most_hp(row, state.monster_stats, config) / float(row["hp"]) for row in state.player_stats)
    lost = hp * TICKS_PER_STEP  # a player that is healed in between may lose all HP in every tick
    low = np.array([least, 0.0, -config.ending_cost, 0.0, 0.0, 0.0], np.float32)
    return spaces.Box(low, np.array([most, hp, worth, lost, circles, circles], np.float32), dtype=np.float32)


# --- Videos ---------------------------------------------------------------------------------------


class RecordVideo(wrappers.RecordVideo[Any, Any]):
    """Gymnasium's wrapper with its arguments, but without moviepy, which needs an older Pillow than Pneuma.

    Videos are written by imageio-ffmpeg (extra `video`).

    Raises:
        UserError: at the end of a recording, for a missing imageio-ffmpeg or a video that cannot be written.
    """

    def __init__(self, *arguments: Any, **keywords: Any) -> None:
        with suppress(DependencyNotInstalled):  # that there is no moviepy, after all else is set up
            super().__init__(*arguments, **keywords)

    def stop_recording(self) -> None:
        """Write the recording, if it has frames."""
        frames: Any = self.recorded_frames
        self.recorded_frames, self.recording = [], False
        if frames:
            path = Path(self.video_folder, f"{self._video_name}.mp4")
            write_video(path, frames, self.frames_per_sec)
