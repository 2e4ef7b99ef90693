"""Conformance checks of an environment.

Runs the checkers of Gymnasium, Stable-Baselines3 and PettingZoo, and Pneuma's own: same seed same bits,
observations inside their space, worlds that continue with the same bits when restored. Also for a user's own
levels, characters and rewards.
"""

from __future__ import annotations

import contextlib
import io
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import gymnasium
import numpy as np

from pneuma.algorithms import MAILMAN
from pneuma.env import MO_ENVIRONMENTS, REGISTERED
from pneuma.env.parallel import parallel_env
from pneuma.env.single import PneumaMOEnv
from pneuma.env.worlds import Worlds
from pneuma.env_fields import make_env_config
from pneuma.errors import UserError, unknown_name

STEPS = 400

Settings = Mapping[str, Any]


def check_environment(env_id: str, settings: Settings) -> Iterator[tuple[str, str]]:
    """Run all checks that apply to an environment; yield each one's name and its finding, "" for none.

    For several players the PettingZoo environment is checked.

    Raises:
        UserError: when the environment cannot be made at all.
    """
    players = _check_settings(env_id, settings)
    checks: dict[str, Callable[[str, Settings], None]] = {}
    if players == 1:
        checks |= {"Gymnasium": _check_gymnasium, "same seed, same bits": _check_seeds}
    if env_id != MAILMAN:
        checks |= {"observations inside": _check_bounds, "saved and put back": check_restore}
    if env_id != MAILMAN and env_id not in MO_ENVIRONMENTS:
        checks |= ({"Stable-Baselines3": _check_sb3} if players == 1 else {}) | {
            "PettingZoo": _check_pettingzoo
        }
    for name, check in checks.items():
        problem = ""
        with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("error")
            try:
                check(env_id, settings)
            except Exception as error:  # any error or warning is a finding
                problem = " ".join(str(error).split()) or type(error).__name__
        yield name, problem


def _check_settings(env_id: str, settings: Settings) -> int:
    """Make the environment once and return its number of players."""
    if env_id not in REGISTERED:
        raise unknown_name("environment", env_id, REGISTERED)
    several = env_id != MAILMAN and make_env_config(settings, _world_id(env_id)).players
    if several > 1 and env_id not in MO_ENVIRONMENTS:
        return len(parallel_env(env_id=env_id, **dict(settings)).possible_agents)
    try:
        _make(env_id, settings).close()
    except TypeError as error:  # an unknown key, or no number
        raise UserError(f"{env_id}: {error}") from None
    return 1


def _world_id(env_id: str) -> str:
    """Return the id of the environment with the same world and a scalar reward."""
    return env_id.replace("/mo-", "/")


def _make(env_id: str, settings: Settings) -> Any:
    """Make an environment without Gymnasium's wrappers."""
    return gymnasium.make(env_id, disable_env_checker=True, **dict(settings)).unwrapped


# --- The libraries' checks ------------------------------------------------------------------------


def _check_gymnasium(env_id: str, settings: Settings) -> None:
    from gymnasium.utils.env_checker import check_env

    env = _make(env_id, settings)
    if isinstance(env, PneumaMOEnv):
        env._reward = lambda: 0.0  # type: ignore[method-assign]  # Gymnasium's checker knows no vectors
    check_env(env, skip_render_check=True)  # which would open a window


def _check_sb3(env_id: str, settings: Settings) -> None:
    from stable_baselines3.common.env_checker import check_env

    check_env(_make(env_id, settings))


def _check_pettingzoo(env_id: str, settings: Settings) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # PettingZoo's tests import deprecated games
        from pettingzoo.test import parallel_api_test, parallel_seed_test
    several: dict[str, Any] = {"players": 3, **settings}
    parallel_api_test(parallel_env(env_id=env_id, **several), num_cycles=STEPS)
    parallel_seed_test(lambda: parallel_env(env_id=env_id, **several), num_cycles=STEPS)


# --- Pneuma's laws --------------------------------------------------------------------------------


def _check_seeds(env_id: str, settings: Settings) -> None:
    """Play one seed twice and compare; check vector rewards against their space."""
    first, again = (_play(_make(env_id, settings)) for _ in range(2))
    if first != again:
        raise UserError("two plays of one seed differ")


def _play(env: Any) -> list[bytes]:
    """Return everything that a random player observes in some steps from a seed."""
    seen: list[bytes] = [np.asarray(env.reset(seed=1)[0]).tobytes()]
    for action in np.random.default_rng(1).integers(env.action_space.n, size=STEPS):
        *results, _ = env.step(action)
        if isinstance(env, PneumaMOEnv) and not env.reward_space.contains(results[1]):
            raise UserError(f"the vector reward {results[1]} is outside {env.reward_space}")
        seen += [np.asarray(each).tobytes() for each in results]
        if results[2] or results[3]:
            seen.append(np.asarray(env.reset()[0]).tobytes())
    env.close()
    return seen


def _check_bounds(env_id: str, settings: Settings) -> None:
    worlds = _begin(8, env_id, settings)
    actions = np.random.default_rng(0)
    for _ in range(STEPS):
        worlds.step(actions.integers(int(worlds.action_space.n), size=worlds.players.shape))
        for world, player in np.ndindex(*worlds.players.shape):
            if not worlds.spaces[player].contains(worlds.observations[world, player]):
                raise UserError(f"an observation is outside its space: {worlds.observations[world, player]}")
        worlds.reset(worlds.worlds["ending"] != 0)


def check_restore(env_id: str, settings: Settings) -> None:
    """Restore a world in another slot and object, and check that it continues with the same bits."""
    worlds = _begin(2, env_id, settings)
    shape = 120, worlds.players.shape[1]
    actions = np.random.default_rng(0).integers(int(worlds.action_space.n), size=shape)
    _step_all(worlds, actions[:60])
    saved = worlds.save(0)
    other = Worlds(1, worlds.config)
    worlds.restore(1, saved)
    other.restore(0, saved)
    for each in (worlds, other):
        _step_all(each, actions[60:])
    for where, bits in (("slot", _bits(worlds, 1)), ("object", _bits(other, 0))):
        if bits != _bits(worlds, 0):
            raise UserError(f"a world that was put back into another {where} went another way")


def _begin(count: int, env_id: str, settings: Settings) -> Worlds:
    worlds = Worlds(count, make_env_config(settings, _world_id(env_id)))
    worlds.seed(range(count))
    worlds.reset()
    return worlds


def _step_all(worlds: Worlds, actions: np.ndarray) -> None:
    """Play actions (steps, players), the same in every world, with resets where episodes end."""
    for chosen in actions:
        worlds.step(np.stack([chosen] * len(worlds)))
        worlds.reset(worlds.worlds["ending"] != 0)


def _bits(worlds: Worlds, world: int) -> list[bytes]:
    """Return all bits of one world's state and of its last step's results."""
    state = (worlds.worlds, worlds.players, worlds.monsters, worlds.events)
    fields = [array[world][name] for array in state for name in array.dtype.names or ()]
    return [np.ascontiguousarray(each).tobytes() for each in (*fields, worlds.observations[world])]
