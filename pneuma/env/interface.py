"""What the interfaces of other libraries share: their arguments, starting episodes, pictures and a `spec`."""

from __future__ import annotations

import operator
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
from gymnasium.envs.registration import EnvSpec

from pneuma.env.fields import make_env_config
from pneuma.env.render import CAMERAS, Renderer
from pneuma.env.slots import Slots, make_slots
from pneuma.env.watch import STEPS_PER_SECOND
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError, unknown_name


class Interface:
    """Worlds and their slots, as all interfaces make, start and draw them.

    The environments are not registered with a time limit, because `gymnasium.make` would put it around the
    world whatever `episode_steps` is. The `spec` has the world's own limit. So `gymnasium.make(env.spec)`
    puts one around it: a step that terminates at the limit is then truncated, too, as in all environments of
    Gymnasium.

    Attributes:
        slots: the players of all worlds.
        worlds: their state.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "pneuma",
        "render_modes": ["rgb_array"],
        "render_fps": round(STEPS_PER_SECOND),
        "is_parallelizable": True,
    }
    render_mode: str | None = None
    slots: Slots
    worlds: Worlds
    _env_id: str
    _camera: str
    _renderer: Renderer | None = None
    _spec: EnvSpec | None = None

    def _set_up(
        self,
        slot_count: int,
        env_id: str,
        render_mode: str | None,
        camera: str,
        settings: Mapping[str, object],
    ) -> None:
        """Check the arguments and make the worlds, in which no episode has begun."""
        if render_mode not in (None, "rgb_array"):
            allowed = "rgb_array, or none; for a window there is gymnasium.wrappers.HumanRendering"
            raise UserError(f"render_mode = {render_mode!r} is not allowed: {allowed}")
        if camera not in CAMERAS:
            raise unknown_name("camera", camera, CAMERAS)
        self.slots = make_slots(slot_count, make_env_config(settings, env_id))
        self.worlds = self.slots.worlds
        self.render_mode, self._camera, self._env_id = render_mode, camera, env_id

    def _begin(self, seeds: Sequence[int | None], start: Any, mask: np.ndarray | bool = True) -> None:
        """Start an episode in all worlds, or in those of `mask`.

        Args:
            seeds: of each world's random stream, None where it goes on.
            start: the index of a start place, None for the default one, or one of these for each world.
            mask: (N,) booleans; True for all.
        """
        starts = self.worlds.default_starts.copy()
        for world, start_index in enumerate(np.broadcast_to(np.array(start, object), len(starts))):
            if start_index is not None:
                starts[world] = operator.index(start_index)
        self.worlds.seed(seeds)
        self.worlds.reset(mask, starts)
        self.slots.has_begun = True

    @property
    def spec(self) -> EnvSpec | None:
        """How Gymnasium makes the environment."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None:
            spec = replace(spec, max_episode_steps=self.worlds.config.episode_steps)
        self._spec = spec

    def render(self) -> Any:
        """Return the frame of the first world, (height, width, 3) uint8, if there is a render mode."""
        if self.render_mode is None:
            return None
        return self._frame(0, 0)

    def get_images(self) -> tuple[np.ndarray, ...]:
        """Return a frame for each slot, of its world with its player in view."""
        return tuple(self._frame(*slot) for slot in np.ndindex(*self.worlds.players.shape))

    def _frame(self, world_index: int, player_index: int) -> np.ndarray:
        if self._renderer is None:
            self._renderer = Renderer(self.worlds, self._camera, env_id=self._env_id)
        return self._renderer.frame(world_index, player_index)


def read_options(options: Mapping[str, Any] | None, *allowed: str) -> dict[str, Any]:
    """Return the options of a reset; refuse those that are not allowed."""
    reset_options = dict(options or {})
    for option_name in reset_options:
        if option_name not in allowed:
            raise unknown_name("option of reset", option_name, allowed)
    return reset_options


def world_seeds(seed: int | Sequence[int | None] | np.ndarray | None, world_count: int) -> list[int | None]:
    """Return a seed for each of `world_count` worlds, None where its random stream goes on."""
    if seed is None:
        return [None] * world_count
    if isinstance(seed, int | np.integer):
        return list(range(int(seed), int(seed) + world_count))
    if len(seed) != world_count:
        raise ValueError(f"{len(seed)} seeds for {world_count} worlds")
    return [None if own_seed is None else operator.index(own_seed) for own_seed in seed]
