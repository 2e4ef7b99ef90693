"""Rewards: named formulas (`PneumaEnv` describes them), and users' own functions.

`module:function` names a user's own reward. It is called after every step as

    function(events, players, player_stats) -> (N, P) numbers

with read-only arrays of dtypes `pneuma.env.state.EVENTS` and `PLAYER`, both (N, P), and `PLAYER_STATS`, (P,).
Its values for players that were not alive are not used. It is called once when an environment is made, with
the events of a step in which nothing happened. `events["distance"]` is infinite if no monster is alive.
"""

from __future__ import annotations

import math
import traceback
from collections.abc import Callable
from typing import Any

import numpy as np

from pneuma.env.compiling import inlined
from pneuma.env.fields import REWARDS
from pneuma.env.state import Array
from pneuma.errors import OwnCodeError, UserError
from pneuma.own_modules import load_module

THESIS, PYGAME, _GODOT, KILLS, SIGMOID = range(len(REWARDS))
SIGMOID_MIDDLE, SIGMOID_WIDTH = 150.0, 50.0  # pixels

RewardFunction = Callable[[np.ndarray, np.ndarray, np.ndarray], Any]


class OwnReward:
    """A user's own reward."""

    def __init__(self, reward_name: str) -> None:
        self.name = reward_name
        module_name, _, function_name = reward_name.partition(":")
        try:
            module = load_module(module_name)
        except (Exception, SystemExit) as error:  # whatever a user's module does when it is imported
            raise UserError(f"reward {reward_name!r}: {type(error).__name__}: {error}") from None
        function: Any = getattr(module, function_name, None)
        if not callable(function):
            raise UserError(f"reward {reward_name!r}: module {module_name} has no function {function_name}")
        self.function: RewardFunction = function

    def pay(self, events: np.ndarray, players: np.ndarray, player_stats: np.ndarray) -> np.ndarray:
        """Call the function and check its result: (N, P) numbers, finite for living players."""
        try:
            rewards = np.asarray(self.function(events, players, player_stats), np.float64)
        except (Exception, SystemExit) as error:  # whatever a user's function does
            description = " ".join(f"{type(error).__name__}: {error}".split()).removesuffix(":")
            raise OwnCodeError(f"reward {self.name!r}: {_raised_at(error)}{description}") from error
        if rewards.shape != events.shape:
            raise UserError(f"reward {self.name!r}: returned shape {rewards.shape}, not {events.shape}")
        was_present = events["present"] > 0
        rewards = np.where(was_present, rewards, 0.0)
        if not np.isfinite(rewards).all():
            hint = "events['distance'] is infinite where no monster lives"
            raise UserError(f"reward {self.name!r}: returned a number that is not finite; {hint}")
        return rewards


def _raised_at(error: BaseException) -> str:
    """Return file and line of the user's function in which an error was raised; empty if it is compiled."""
    stack_frames = traceback.extract_tb(error.__traceback__)
    if len(stack_frames) < 2:
        return ""
    return f"{stack_frames[1].filename}, line {stack_frames[1].lineno}: "


# --- The named formulas (compiled) -----------------------------------------------------------------


@inlined
def write_reward(player: Array, player_stats: Array, event: Array) -> None:
    """Write a player's reward by its formula."""
    formula = player_stats.reward
    if formula == THESIS:
        event.reward = player.xp - player.hp / player_stats.hp
    elif formula == PYGAME:
        event.reward = player.xp + player.hp / player_stats.hp
    elif formula == KILLS:
        event.reward = event.xp_gained - event.hp_lost / player_stats.hp
    elif formula == SIGMOID:
        event.reward = event.xp_gained + _closeness(event.distance)
    # Godot's has been kept event by event by the rules; a user's own is computed outside.


@inlined
def share_reward(events: Array) -> None:
    """Give each player who was there the mean of all players' rewards."""
    reward_sum = 0.0
    for player_index in range(len(events)):
        reward_sum += events[player_index].reward
    for player_index in range(len(events)):
        if events[player_index].present > 0:
            events[player_index].reward = reward_sum / len(events)


@inlined
def _closeness(distance: float) -> float:
    """Return an algebraic sigmoid of the distance: 1 at a monster, 1/2 in the middle, 0 far away."""
    if distance == math.inf:
        return 0.0
    nearness = (SIGMOID_MIDDLE - distance) / SIGMOID_WIDTH
    return 0.5 + 0.5 * nearness / math.sqrt(1.0 + nearness * nearness)
