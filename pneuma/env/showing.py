"""Rendering as Gymnasium's and PettingZoo's faces offer it: `rgb_array` and `human`, a frame a step.

`watch.py` is for people: several frames a step, and a keyboard.
"""

from __future__ import annotations

from typing import Any, ClassVar

import numpy as np

from pneuma.env.characters import TICKS_PER_SECOND, TICKS_PER_STEP
from pneuma.env.worlds import Worlds
from pneuma.errors import UserError, unknown_name

STEPS_PER_SECOND = TICKS_PER_SECOND / TICKS_PER_STEP
RENDER_MODES = ("rgb_array", "human")
CAMERAS = ("map", "follow")


class ShowsWorld:
    """What the faces share: a world to show, drawn only when somebody looks.

    `rgb_array` gives the frame of the first world, or one a slot for a vector environment: that slot's
    world, with its player followed and told of. `human` opens a window, which needs the extra `play`.
    """

    metadata: ClassVar[dict[str, Any]] = {
        "name": "pneuma",
        "render_modes": list(RENDER_MODES),
        "render_fps": round(STEPS_PER_SECOND),
        "is_parallelizable": True,
    }
    render_mode: str | None = None
    camera: str = "map"
    """`CAMERAS`: the whole map, or a view that follows a player."""
    _renderer: Any = None
    _window: Any = None

    @property
    def rendered(self) -> Worlds:
        """The worlds that `render` shows."""
        return self.state  # type: ignore[attr-defined]

    def _set_up_rendering(self, render_mode: str | None, camera: str = "map") -> None:
        if render_mode is not None and render_mode not in RENDER_MODES:
            allowed = ", ".join(RENDER_MODES)
            raise UserError(f"render_mode = {render_mode!r} is not allowed: one of {allowed}, or none")
        if camera not in CAMERAS:
            raise unknown_name("camera", camera, CAMERAS)
        self.render_mode = render_mode
        self.camera = camera

    def render(self) -> Any:
        """Return the frame, (height, width, 3) uint8, for `rgb_array`; nothing for `human`."""
        if self.render_mode == "human":
            self._show()
            return None
        if self.render_mode is None:
            return None
        if hasattr(self, "num_envs"):
            return tuple(self._frames())
        return self._frame(0)

    def _frames(self) -> list[np.ndarray]:
        """Return a frame for every slot, as recorders of vector environments want them."""
        worlds, players = self.rendered.players.shape
        return [self._frame(world, player) for world in range(worlds) for player in range(players)]

    def _frame(self, world: int, player: int = 0) -> np.ndarray:
        if self._renderer is None:
            from pneuma.env.render import Renderer

            self._renderer = Renderer(self.rendered, self.camera)
        return self._renderer.frame(world, player)

    def _show(self) -> None:
        """Bring the window up to date, if there is to be one."""
        if self.render_mode != "human" or (self._window is not None and self._window.closed):
            return
        frame = self._frame(0)
        if self._window is None:
            from pneuma.env.window import Window

            self._window = Window((frame.shape[1], frame.shape[0]), "Pneuma")
        self._window.show(frame, STEPS_PER_SECOND)

    def close(self, **keywords: Any) -> None:
        """Close the window, if there is one."""
        if self._window is not None:
            self._window.close()
            self._window = None
        super().close(**keywords)  # type: ignore[misc]
