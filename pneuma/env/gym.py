"""Gymnasium's interface to one world; to N worlds: `gym_vector.py`."""

from __future__ import annotations

import operator
from typing import Any

import gymnasium
import numpy as np
from gymnasium.error import ResetNeeded

from pneuma.env.fields import ENVIRONMENTS
from pneuma.env.interface import Interface, read_options
from pneuma.env.watch import keys_to_action
from pneuma.errors import UserError


class PneumaEnv(Interface, gymnasium.Env[np.ndarray, np.int64]):
    """PneumaRL: one player against the monsters of a level.

    A top-down island of snow, field and desert (thesis chapter 5). Monsters notice a player within 300
    pixels, chase and bite it; the player kills them with a sword for experience points (XP) and HP. A step
    lasts 8 ticks of 1/60 s. `copy.deepcopy` and `pickle` copy all, the random stream included.

    ## Actions

    `Discrete(5)`, or 7 with magic:

    | action | | with |
    | --- | --- | --- |
    | 0, 1, 2, 3 | walk down, left, up, right, 40 px | |
    | 4 | attack towards the last direction walked, for 24 ticks | |
    | 5 | flame: 5 damage plus the class's magic in a box of 320 x 64 px ahead; 20 energy | `magic` |
    | 6 | heal: 20 HP up to full; 10 energy | `magic` |

    `info["action_mask"]` is 0 for actions without effect: into terrain, a spell without enough energy, and
    all but attack while an attack or spell lasts for the whole step. Attack is always 1.

    ## Observations

    A `Box` of float32. The 64 numbers of `pneuma/PneumaArena-v0`, with i from 0 to 13:

    | number | what | from | to |
    | --- | --- | --- | --- |
    | 0, 1 | x and y, over the land | -1 | 1 |
    | 2 | HP over full HP; kills heal, also above it | 0 | 1.98 |
    | 3 | XP over that of all monsters | 0 | 1.07 |
    | 4, 5, 6, 7 | whether it faces down, left, up, right | 0 | 1 |
    | 8 + 4i | distance to the nearest living monster, the next, ...; in its notice radii | 0 | 16.2 |
    | 9 + 4i, 10 + 4i | direction to it, x and y | -1 | 1 |
    | 11 + 4i | its HP over its full HP | 0 | 1 |

    Rows of the dead are zeros, at the end. `pneuma/Pneuma-v0` has 60 numbers, without the facing, and
    `pneuma/PneumaGodot-v0` 74, by `observation`, the layout:

    | `observation` | the player | each monster | by default |
    | --- | --- | --- | --- |
    | `thesis` | x, y, HP, XP | distance, direction x and y, HP | all, nearest first, unit: 60 |
    | `pygame` | x, y, facing x and y, HP, energy | the same, XP it is worth | the 5 nearest, map: 31 |
    | `godot` | x, y, HP, XP | x, y, HP, direction x and y to the player | all, fixed order, raw: 74 |

    `scale` is `unit` in the first table; the land of random levels is the whole grid. With `map` positions
    are 0 to 1 over the grid, and distances over its longer side; with `raw` all is in pixels and points.

    With `perceive = "rays:16"` each ray has a row in place of each monster: the distance to the first thing
    that it meets (in the largest notice radius), then 1 for what that is, else 0: terrain, another player,
    each kind of monster of the level. The first ray leads to the right, the others follow clockwise. They
    end at living bodies and at terrain that stops players; HP are not seen.

    ## Rewards

    xp and hp are the values after the step, hp0 is full HP, and Δ is the change in the step:

    | `reward` | formula | source |
    | --- | --- | --- |
    | `thesis` | xp - hp / hp0 | section 5.3, as printed |
    | `pygame` | xp + hp / hp0 | the PyGame version |
    | `godot` | by events, below | the Godot version |
    | `kills` | Δxp - HP lost / hp0 | what section 5.3's words ask for |
    | `distance-sigmoid` | Δxp + S, below | after footnote 4 |
    | `module:function` | a function of yours | |

    `godot`: +1 for entering a notice circle, +1 for an attack circle; a kill with credit for the player, and
    an ending that costs XP, set what the step has paid so far to its XP. S is an algebraic sigmoid,
    1/2 + z / (2 sqrt(1 + z^2)) with z = (150 - distance to the nearest living monster) / 50; 0 without one.

    ## Starting and ending

    An episode starts at one of the level's start places; `reset(options={"start": i})` chooses the i-th. It
    terminates when the player's HP are gone, and with `end_on_clear` when every monster is dead. It is
    truncated after `episode_steps` steps, or terminated with `time_limit = "terminate"`. `info` then holds
    `ending` (killed, cleared or time-limit), `kills`, `xp` and `hp`.

    ## Arguments

    Three defaults are those of Pneuma-v0, PneumaGodot-v0 and PneumaArena-v0.

    | argument | default | meaning |
    | --- | --- | --- |
    | `level` | thesis | a shipped level, a folder of tables, `random:train:N` or `random:test:N` |
    | `random_levels` | 1 | number of random levels, from N on; each episode draws one |
    | `monsters` | bamboo | on random levels: `bamboo` only, or `mixed`: 8 of them, and 2 of each other kind |
    | `characters` | none | a file that overrides and extends the shipped ones; or `pygame` |
    | `players` | 1 | 1 to 8 in a world; more than one not here, but in the other interfaces |
    | `classes` | base | `base`, `tank`, `mage`, `warrior`, or a list of one per player |
    | `magic` | false | whether there are the actions flame and heal |
    | `reward` | thesis, godot, kills | a formula, or a list of one per player |
    | `shared_reward` | false | whether each player gets the mean of all players' rewards |
    | `observation` | thesis, godot, thesis | the layout |
    | `perceive` | all | `all`, `nearest:K`, or `rays:N`, 1 to 64 |
    | `order` | nearest, fixed, nearest | dead monsters are left out, or rows of zeros (HP 0 in `godot`) |
    | `scale` | unit, raw, unit | scale of what is observed |
    | `observe_facing` | false, false, true | whether a player observes its facing: four numbers |
    | `start` | random, first, random | a random start place of the level, or always the first |
    | `trees` | wall, pass, wall | whether trees and other obstacles stop bodies |
    | `terrain_stops` | all, players, all | which bodies trees and coast stop: all, or players only |
    | `attack_ticks` | 0 | length of every attack; 0: the weapon's, 24 for `blade` |
    | `blow` | attack | a sword hits a monster once per attack, or on each `entry` into its box |
    | `kill_credit` | striker, near, striker | who gains: the striker, or all within the attack circle |
    | `xp_scope` | episode, forever, episode | `forever`: XP is kept until `reset(seed=...)` |
    | `ending_cost` | 0, 1, 0 | XP lost by death, clearing the level and the time limit |
    | `episode_steps` | 1000, 7500, 1000 | the world's time limit |
    | `time_limit` | truncate, terminate, truncate | whether it truncates or terminates |
    | `end_on_clear` | false, true, false | whether the last kill ends the episode |
    | `render_mode` | none | `rgb_array` |
    | `camera` | map | `follow` shows the player's surroundings |

    ## Versions

    v0 alone. A change of what equal seeds and actions give raises `pneuma.config.RULES_VERSION`.

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
        if settings.get("players", 1) != 1:
            alternative = "make the vector environment, or pneuma.env.pettingzoo.parallel_env"
            raise UserError(
                f"players = {settings['players']}: this environment has one player; {alternative}"
            )
        self._set_up(1, env_id, render_mode, camera, settings)
        self.observation_space = self.worlds.space
        self.action_space = self.worlds.action_space
        self._actions = np.zeros((1, 1), np.int64)
        self._is_playing = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """Start an episode; see `gymnasium.Env.reset`. The same seed starts the same world."""
        own_options = read_options(options, "start")
        super().reset(seed=seed)
        self._begin([seed], own_options.get("start"))
        self._is_playing = True
        return self._observation_and_info()

    def _observation_and_info(self) -> tuple[np.ndarray, dict[str, Any]]:
        return self.worlds.observations[0, 0].copy(), {"action_mask": self.worlds.masks[0, 0].copy()}

    def step(self, action: np.int64) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Play one action; see `gymnasium.Env.step`."""
        action_index = operator.index(action)
        if not 0 <= action_index < self.worlds.action_space.n:
            raise ValueError(f"action {action!r} is outside {self.action_space}")
        if not self._is_playing:
            raise ResetNeeded("no episode is under way: call reset first")
        self._actions[0, 0] = action_index
        has_ended = self.worlds.advance(self._actions) > 0
        self._is_playing = not has_ended
        observation, info = self._observation_and_info()
        truncated = False
        if has_ended:
            info |= self.slots.ending_info()
            truncated = bool(self.worlds.truncated[0])
        reward = self.worlds.events["reward"].item()
        return observation, reward, has_ended and not truncated, truncated, info

    def get_keys_to_action(self) -> dict[tuple[int, ...], int]:
        """Return the keys that `gymnasium.utils.play.play` asks for; see `pneuma.env.watch.KEYS`."""
        return keys_to_action(self.worlds.action_names)
